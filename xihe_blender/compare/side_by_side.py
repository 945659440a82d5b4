"""Captured picture, ground truth, estimate and a wipe between the two: what of a run an artist shows to others.

Each compared frame becomes one labelled picture, and all of them an .mp4 that plays as fast as the walk was. Blender's
sequencer writes the labels and encodes, so that no font and no encoder has to be installed. Pictures are enlarged by
whole pixels, and nothing else is done to them.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.capture.render import choose_format
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs, copy_whole, write_picture
from xihe_blender.io.run_results import RunResults
from xihe_blender.scene.colour_management import show_as_it_is
from xihe_blender.scene.state import WORKING, no_render_result_left
from xihenet.records import ArrayF32

WIPE_LINE = 1.0
"""sRGB brightness of the line between estimate and ground truth."""

SMALLEST_WIDTH_PX = 480
"""To which small pictures are enlarged, so that a label fits above each."""

BAR_PX = 36
BAR = 0.06
SCENE, FILM_SCENE = "Xihe Side by Side", "Xihe Film"


def save_side_by_side(results: RunResults, folder: Path, method: str | None = None) -> Path:
    """Write pictures/side_by_side_*.png and side_by_side.mp4 of the run in `folder`; the path of the latter.

    `method` is the one beside the ground truth, by default the run's estimator. UserError if the run compared no frame,
    did not compare that method, or if its pictures are gone; OSError where they cannot be written.
    """
    method = method or results.settings.estimator
    compared = results.compared_frames
    if results.recording is not None:
        raise UserError(f"{results.recording.said} {folder / 'composited.mp4'} is the video of this run.")
    if not compared:
        raise UserError(f"{folder} has no compared frames, so there is nothing to show side by side")
    known = [name for name in results.comparison if name in next(iter(compared.values())).pictures]
    if method not in known:
        raise UserError(f"{folder} has no pictures of {method}: choose one of {', '.join(known)}")
    outputs = RunOutputs(folder, "")
    with tempfile.TemporaryDirectory(prefix="xihe_") as temporary:
        unlabelled = []
        for number, (frame, shown) in enumerate(compared.items(), start=1):
            kinds = ("captured", "ground_truth", method)
            pictures = [enlarged(read_picture(folder / shown.pictures[kind])) for kind in kinds]
            unlabelled.append(Path(temporary) / f"{frame:04d}.png")
            # The line sweeps right once, and never stands at an edge.
            write_picture(unlabelled[-1], composed(*pictures, wipe=number / (len(compared) + 1)))
        height, width, _ = pictures[0].shape
        labels = ("Captured by the phone", "Ground truth", f"Estimate: {method}", f"{method} | ground truth")
        fps = results.scene.fps * (len(compared) - 1) / max(max(compared) - min(compared), 1)
        size = (2 * width, 2 * (height + BAR_PX))
        with sequence(SCENE, unlabelled, size, fps or 1.0) as (scene, strips, _):
            add_labels(strips, labels, (width, height), len(unlabelled))
            labelled = render_pictures(scene, Path(temporary))
            film = render_film(scene, Path(temporary))
        for frame, picture in zip(compared, labelled, strict=True):
            copy_whole(picture, outputs.picture("side_by_side", frame))
        copy_whole(film, outputs.side_by_side)
    return outputs.side_by_side


def save_film(pictures: Mapping[int, Path], size: tuple[int, int], fps: float, path: Path) -> None:
    """Write `pictures`, by frame and in order, to `path` (.mp4), with each shown until the next.

    Small ones are enlarged by whole pixels; encoders take even numbers of these. UserError if this Blender cannot.
    """
    larger = math.ceil(SMALLEST_WIDTH_PX / size[0])
    larger += larger % 2 if any(side % 2 for side in size) else 0
    first, last = min(pictures), max(pictures)
    shown = [pictures[first]]
    for frame in range(first + 1, last + 1):
        shown.append(pictures.get(frame, shown[-1]))
    with sequence(FILM_SCENE, shown, (larger * size[0], larger * size[1]), fps) as (scene, _, strip):
        strip.transform.scale_x = strip.transform.scale_y = larger
        strip.transform.filter = "NEAREST"
        with tempfile.TemporaryDirectory(prefix="xihe_") as temporary:
            copy_whole(render_film(scene, Path(temporary)), path)


def wiped(estimate: ArrayF32, truth: ArrayF32, wipe: float) -> ArrayF32:
    """(H, W, 3) `estimate` on the left, `truth` on the right, and a white line of one pixel between them.

    `wipe` is the line's place, 0 at the left edge, where all is truth, and 1 at the right; neither has a line.
    """
    width = truth.shape[1]
    place = round(min(max(wipe, 0.0), 1.0) * width)
    picture: ArrayF32 = truth.copy()
    picture[:, :place] = estimate[:, :place]
    if 0 < place < width:
        picture[:, place] = WIPE_LINE
    return picture


def middle_of_change(before: ArrayF32, after: ArrayF32) -> float:
    """Column, from 0 to 1, that has half of what differs between two (H, W, 3) on either side; 0.5 if nothing does."""
    changed = np.cumsum(np.abs(after - before).sum((0, 2), dtype=np.float64))
    if changed[-1] == 0:
        return 0.5
    return float((np.searchsorted(changed, changed[-1] / 2) + 0.5) / len(changed))


def enlarged(picture: ArrayF32) -> ArrayF32:
    """`picture` (H, W, 3), each of its pixels repeated as often as `SMALLEST_WIDTH_PX` needs."""
    factor = math.ceil(SMALLEST_WIDTH_PX / picture.shape[1])
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def composed(captured: ArrayF32, truth: ArrayF32, estimate: ArrayF32, *, wipe: float) -> ArrayF32:
    """The four pictures, (H, W, 3) each, two by two, with a dark bar above each: (2 * (H + BAR_PX), 2 * W, 3)."""
    bar = np.full((BAR_PX, *truth.shape[1:]), BAR, np.float32)
    columns = [[bar, captured, bar, estimate], [bar, truth, bar, wiped(estimate, truth, wipe)]]
    return np.concatenate([np.concatenate(column) for column in columns], axis=1)


@contextlib.contextmanager
def sequence(
    name: str, pictures: Sequence[Path], size: tuple[int, int], fps: float
) -> Iterator[tuple[bpy.types.Scene, Any, Any]]:
    """A scene of that name whose sequencer plays `pictures`, all its strips, and theirs; then it is gone.

    It writes what is shown as it is, in sRGB with no look, of `size` (width, height), `fps` pictures a second.
    """
    scene = bpy.data.scenes.new(name)
    try:
        scene[WORKING] = True
        render = scene.render
        render.resolution_x, render.resolution_y = size
        render.resolution_percentage = 100
        render.fps = max(1, round(fps))
        render.fps_base = render.fps / fps
        show_as_it_is(scene)
        scene.frame_start, scene.frame_end = 1, len(pictures)
        editor = scene.sequence_editor_create()
        strips = editor.strips if hasattr(editor, "strips") else editor.sequences  # Blender 4.3
        strip = strips.new_image("Pictures", str(pictures[0]), channel=1, frame_start=1)
        for picture in pictures[1:]:
            strip.elements.append(picture.name)
        yield scene, strips, strip
    finally:
        bpy.data.scenes.remove(scene)


def add_labels(strips: Any, labels: Sequence[str], size: tuple[int, int], n_frames: int) -> None:
    """Write `labels` on the bars of four pictures of `size` each, for so many frames."""
    width, height = size
    for number, label in enumerate(labels):
        row, column = divmod(number, 2)
        above_px = row * (height + BAR_PX) + BAR_PX / 2
        given = {"name": label, "type": "TEXT", "channel": 2 + number, "frame_start": 1}
        try:
            strip = strips.new_effect(**given, length=n_frames)
        except TypeError:  # Blender 4
            strip = strips.new_effect(**given, frame_end=1 + n_frames)
        strip.text, strip.font_size = label, 0.6 * BAR_PX
        strip.location = column / 2 + 10 / (2 * width), 1 - above_px / (2 * (height + BAR_PX))
        anchors = ("anchor_x", "anchor_y") if hasattr(strip, "anchor_x") else ("align_x", "align_y")  # Blender 4.3
        for anchor, side in zip(anchors, ("LEFT", "CENTER"), strict=True):
            setattr(strip, anchor, side)


def render_pictures(scene: bpy.types.Scene, folder: Path) -> list[Path]:
    """What the sequencer of `scene` shows, as PNG."""
    choose_format(scene.render.image_settings, "IMAGE", "PNG")
    render(scene, folder / "labelled_")
    return sorted(folder.glob("labelled_*.png"))


def render_film(scene: bpy.types.Scene, folder: Path) -> Path:
    """What the sequencer of `scene` shows, as H.264 in .mp4."""
    choose_format(scene.render.image_settings, "VIDEO", "FFMPEG")
    encoder = scene.render.ffmpeg
    encoder.format, encoder.codec, encoder.audio_codec = "MPEG4", "H264", "NONE"
    encoder.constant_rate_factor = "HIGH"
    render(scene, folder / "film.mp4")
    return folder / "film.mp4"


def render(scene: bpy.types.Scene, path: Path) -> None:
    """Render all of `scene`. UserError if this Blender cannot."""
    scene.render.filepath = str(path)
    try:
        with no_render_result_left(), bpy.context.temp_override(scene=scene):
            bpy.ops.render.render(animation=True)
    except (RuntimeError, TypeError) as error:
        raise UserError(f"Blender could not write {path.name}: {str(error).strip()}") from error


def read_picture(path: Path) -> ArrayF32:
    """(H, W, 3) of a PNG of a run, sRGB-encoded in [0, 1], row 0 at the top. UserError if it cannot be read."""
    try:
        image = bpy.data.images.load(str(path))
    except RuntimeError as error:
        raise UserError(f"{path} cannot be read: run again") from error
    try:
        width, height = image.size
        pixels = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        picture: ArrayF32 = pixels.reshape(height, width, -1)[::-1, :, :3]
        return picture
    finally:
        bpy.data.images.remove(image)
