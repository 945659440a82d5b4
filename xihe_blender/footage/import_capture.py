"""A recording becomes a part of the open file: what File > Import > Phone Recording and `xihe import` do.

One new collection holds a camera on the phone's path with the pictures behind it, a scan of what they show, and an
empty where the phone looked first. Of the scene only what belongs to playing the recording is set: frames, rate, size
of the picture, camera, the markers that would switch it, transparent film. All else stays as it was. Gravity is down,
as far as the recording knows it.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.apply.keyed_camera import add_camera, pixel_aspect
from xihe_blender.errors import UserError
from xihe_blender.footage.pictures import Footage, new_footage_folder, show_behind
from xihe_blender.jobs import Job, Progress, part_of
from xihe_blender.scene.colour_management import in_working_space
from xihe_blender.scene.mesh_arrays import fill_mesh
from xihe_blender.scene.phone_capture import (
    SCAN,
    ChosenCapture,
    frames_a_second,
    frames_of_times,
    remember_capture,
    remembered_capture,
)
from xihe_blender.scene.shader_nodes import new_material
from xihe_blender.scene.units import metres_per_unit
from xihenet.camera import valid_plane_depth
from xihenet.captures import open_capture
from xihenet.captures.capture import Capture, CapturedFrame
from xihenet.captures.conventions import suspicion
from xihenet.captures.drift import steadied
from xihenet.captures.reading import READERS, xihe_session
from xihenet.captures.scan import FARTHEST_M, Scan, ScanMesh
from xihenet.formats import format_bytes, format_count
from xihenet.io.recording import SessionFacts, SessionRecorder
from xihenet.records import ArrayF64, RgbdFrame

COLLECTION, CAMERA, SCAN_NAME, LOOKED_AT = "Phone Recording", "Phone", "Phone Scan", "Xihe looked here first"
LOOKED_AT_M = 1.0
"""In front of the camera, where its first frame has no depth."""

READING_SHARE = 0.4  # Of the time, where frames are kept as well
COARSEST_M = 1e-3  # Steps of Blender's coordinates above which an import is said to lie too far away
DEEPEST = 3  # Folders above a file of a recording, as of Polycam's keyframes/images/1.jpg
OUTSIDE = "this Blender cannot read it: run `xihe import` outside of Blender, with the package installed"

COLOURS = "Seen Colour"
SOLID_COLOUR = (0.8, 0.8, 0.8, 0.2)
"""Of a solid view, with its opacity: the pictures behind the camera show through the scan."""

MOVED_M, TURNED_RAD = 0.08, np.radians(6)
"""Frames that differ from the last one that was taken in by less add nothing to the scan that it does not have."""


@dataclass(frozen=True, eq=False)
class ImportedCapture:
    """What an import made: a collection with camera, scan (None without any depth) and empty; and sentences on it."""

    collection: bpy.types.Collection
    camera: bpy.types.Object
    scan: bpy.types.Object | None
    looked_at: bpy.types.Object
    pictures: Path
    said: tuple[str, ...]


@contextlib.contextmanager
def as_user_error(of: str = "") -> Iterator[None]:
    """UserError, which begins with `of`, for a recording that is broken, or that this Python cannot read."""
    try:
        yield
    except ImportError as error:
        raise UserError(f"{of}{OUTSIDE} ({error})") from error
    except ValueError as error:
        raise UserError(str(error)) from error


def opened_capture(chosen: ChosenCapture) -> Capture:
    """The recording that was chosen; UserError for none and for a broken one, as of `open_capture`."""
    with as_user_error(f"{chosen.path}: "):
        return open_capture(chosen.path, chosen.up, scale=chosen.scale, floor_m=chosen.floor_m)


def recording_at(path: Path) -> Path:
    """The recording that was chosen: a file or folder in one stands for it, if it is none itself."""
    for place in (path, *path.parents[:DEEPEST]) if path.exists() else ():
        if any(is_in(place) for is_in, _ in READERS.values()):
            return place
    return path


def capture_of(scene: bpy.types.Scene) -> Capture | None:
    """The recording that `scene` shows; None where captures are rendered. UserError where it is gone or broken."""
    remembered = remembered_capture(scene)
    if remembered is None:
        return None
    if not remembered.path.exists():
        raise UserError(
            f"the recording of scene {scene.name!r} is gone from {remembered.path}: put it back, or import it again"
        )
    return opened_capture(remembered)


def captured_frames(capture: Capture) -> dict[int, CapturedFrame]:
    """The frames of a recording by frame of the timeline."""
    indices = frames_of_times([one.time_s for one in capture.frames])
    return {number: capture.frames[index] for number, index in indices.items()}


def read_captured(captured: CapturedFrame) -> RgbdFrame:
    """Its pixels; UserError where they cannot be read."""
    with as_user_error():
        return captured.read()


def steadied_frames(capture: Capture) -> dict[int, CapturedFrame]:
    """As `captured_frames`, with the drift of exposure and white balance followed where frames do not say theirs.

    For that every frame is read. UserError where one cannot be.
    """
    if capture.is_exposure_known:
        return captured_frames(capture)
    with as_user_error():
        return captured_frames(steadied(capture.kept_once_read())[0])


def import_capture(
    scene: bpy.types.Scene, chosen: ChosenCapture, *, blend_folder: Path | None = None, keeps_frames: bool = False
) -> Job[ImportedCapture]:
    """A job, a step per frame: bring a recording into `scene`.

    Parameters
    ----------
    blend_folder : where the .blend is or will be, and the folder of pictures beside it; None takes the open file's, or
        for one that was never saved the place of the recording
    keeps_frames : whether a recording that takes packages to be read is kept below the pictures in our own form too,
        for runs in a Blender without them

    UserError for a recording that cannot be read, with the scene as it was; OSError where no pictures can be written.
    """
    capture = opened_capture(chosen).kept_once_read()
    numbered = captured_frames(capture)
    if blend_folder is None and bpy.data.filepath:
        blend_folder = Path(bpy.data.filepath).parent
    name = chosen.path.resolve().stem
    pictures = new_footage_folder(blend_folder or chosen.path.resolve().parent, name)
    remembered, is_kept = chosen, keeps_frames and capture.format_name != xihe_session.FORMAT_NAME
    reading = READING_SHARE if is_kept else 1.0
    try:
        footage = Footage(pictures, numbered)
        scan, first = yield from part_of(1, 0, 0.99 * reading, _read(capture, numbered, footage))
        yield Progress(0.99 * reading, 1, "making the mesh")
        with as_user_error():
            doubt = suspicion(capture)
        notes = capture.notes if doubt is None else (*capture.notes, doubt)
        if is_kept:
            remembered = yield from part_of(1, reading, 1 - reading, _keep_frames(capture, pictures / name))
        imported = _build(scene, capture, numbered, footage, scan, first, blend_folder)
    except BaseException:
        shutil.rmtree(pictures, ignore_errors=True)
        raise
    remember_capture(scene, remembered, blend_folder)
    kept = () if remembered is chosen else (_format_frames(remembered.path),)
    return replace(imported, said=(*imported.said, *kept, *notes))


def _read(capture: Capture, numbered: Mapping[int, CapturedFrame], footage: Footage) -> Job[tuple[Scan, RgbdFrame]]:
    """A job: the pictures, the surfaces they show, and the first frame."""
    chosen = {id(capture.frames[index]) for index in frames_to_scan(capture)}
    first = read_captured(next(iter(numbered.values())))
    places_m = [captured.camera.world_from_camera[:3, 3] for captured in capture.frames]
    # The middle one: a phone that loses its way may tell of places far away.
    scan = Scan(capture.reference_exposure or first.exposure, origin_m=np.median(places_m, axis=0))
    for done, (number, captured) in enumerate(numbered.items()):
        yield Progress(done, len(numbered), f"reading frame {number}")
        is_scanned = id(captured) in chosen
        frame = read_captured(captured) if is_scanned or not footage.links else None
        if frame is not None and is_scanned:
            scan.add(frame)
        footage.add(number, frame)
    footage.close_gaps()
    return scan, first


def _keep_frames(capture: Capture, folder: Path) -> Job[ChosenCapture]:
    """A job, a step per frame: the recording in our own form in `folder`, as a run would read it.

    Up, scale and floor are as in `capture`; exposure and white balance that drifted unsaid are followed.
    """
    n, n_before, frames = len(capture.frames), 0, capture.frames
    if not capture.is_exposure_known:
        yield Progress(0, 2 * n, "following the exposure")
        with as_user_error():
            n_before, frames = n, steadied(capture)[0].frames
    source = f"a recording of the kind {capture.format_name}"
    recorder = SessionRecorder(folder, SessionFacts(source, capture.notes, capture.reference_exposure, capture.trigger))
    for done, captured in enumerate(frames):
        yield Progress(n_before + done, n_before + n, f"keeping frame {captured.number} for Blender")
        recorder.record(read_captured(captured))
    return ChosenCapture(folder)


def _format_frames(folder: Path) -> str:
    n_bytes = sum(path.stat().st_size for path in folder.iterdir())
    return f"Run reads its own copy of the frames in {folder}, {format_bytes(n_bytes)}: keep it."


def _build(
    scene: bpy.types.Scene, capture: Capture, numbered: Mapping[int, CapturedFrame], footage: Footage, scan: Scan,
    first: RgbdFrame, blend_folder: Path | None,
) -> ImportedCapture:  # fmt: skip
    unit_m = metres_per_unit(scene)
    collection = bpy.data.collections.new(COLLECTION)
    camera = add_camera(CAMERA, {number: one.camera for number, one in numbered.items()}, unit_m)
    size = show_behind(camera.data, footage, f"{COLLECTION} Pictures", blend_folder)
    mesh = scan.mesh()
    scanned = add_scan(SCAN_NAME, mesh, unit_m) if len(mesh.quads) else None
    looked_at = bpy.data.objects.new(LOOKED_AT, None)
    looked_at.location, looked_at.empty_display_size = (first_looked_at_m(first) / unit_m).tolist(), 0.2 / unit_m
    for item in (camera, scanned, looked_at):
        if item is not None:
            collection.objects.link(item)
    scene.collection.children.link(collection)
    changed = _play(scene, camera, capture, numbered, size)
    n_frames = format_count(len(numbered), "frame")
    said = [f"Imported {n_frames} as {collection.name!r}; the recording is: {capture.format_name}.", changed]
    n_left_out = len(capture.frames) - len(numbered)
    if n_left_out:
        said.append(f"{n_left_out} that follow too closely for the timeline, or go back in time, were left out.")
    if scanned is None:
        said.append(f"There is no scan: no surface within {FARTHEST_M:g} m was seen clearly.")
    elif mesh.is_cut:
        said.append("The scan ends where it had grown too large.")
    farthest_m = float(max(np.abs(one.camera.world_from_camera[:3, 3]).max() for one in numbered.values()))
    step_m = float(np.spacing(np.float32(farthest_m / unit_m))) * unit_m
    if step_m > COARSEST_M:
        said.append(
            f"The recording lies {farthest_m / 1000:,.0f} km from the origin of its world, where Blender's coordinates "
            f"have steps of {step_m:.2g} m: subtract a place near it from all its poses, and import it again."
        )
    said.append(f"Pictures are in {footage.folder}.")
    return ImportedCapture(collection, camera, scanned, looked_at, footage.folder, tuple(said))


def _play(
    scene: bpy.types.Scene, camera: bpy.types.Object, capture: Capture, numbered: Mapping[int, CapturedFrame],
    size: tuple[int, int],
) -> str:  # fmt: skip
    """Set what playing the recording needs; a sentence that names it."""
    render = scene.render
    scene.frame_start, scene.frame_end, scene.frame_step = min(numbered), max(numbered), 1
    render.fps, render.fps_base = frames_a_second([one.time_s for one in capture.frames]), 1.0
    render.resolution_x, render.resolution_y = size
    render.pixel_aspect_x, render.pixel_aspect_y = pixel_aspect([one.camera for one in numbered.values()])
    render.film_transparent = True
    scene.camera = camera
    has_marker = _keep_markers_away(scene, camera)
    scene.frame_set(scene.frame_start)
    aspect = ""
    if render.pixel_aspect_x != render.pixel_aspect_y:
        aspect = f" with a pixel aspect of {render.pixel_aspect_x:.4g} to {render.pixel_aspect_y:.4g}"
    return (
        f"Set for it: frames {scene.frame_start} to {scene.frame_end} at {render.fps} a second, {size[0]}x{size[1]} "
        f"pixels{aspect}, its camera{', with a marker' if has_marker else ''}, a transparent film."
    )


def _keep_markers_away(scene: bpy.types.Scene, camera: bpy.types.Object) -> bool:
    """Have no marker switch to another camera in the scene's range; whether one of its own was needed for that."""
    bound = [marker for marker in scene.timeline_markers if marker.camera is not None]
    for marker in bound:
        if scene.frame_start <= marker.frame <= scene.frame_end:
            marker.camera = None
    if bound:  # Before the first marker, Blender looks through its camera too.
        scene.timeline_markers.new(camera.name, frame=scene.frame_start).camera = camera
    return bool(bound)


def first_looked_at_m(frame: RgbdFrame) -> ArrayF64:
    """(3,) world, metres: what is in the middle of the picture, at the depth that is known next to its middle."""
    k, valid = frame.intrinsics, valid_plane_depth(frame.plane_depth_m)
    depth_m = LOOKED_AT_M
    if valid.any():
        rows, columns = np.nonzero(valid)
        nearest = ((rows + 0.5 - k.height / 2) ** 2 + (columns + 0.5 - k.width / 2) ** 2).argmin()
        depth_m = float(frame.plane_depth_m[rows[nearest], columns[nearest]])
    ray = np.array([(k.width / 2 - k.cx) / k.fx, (k.cy - k.height / 2) / k.fy, -1.0])
    place_m: ArrayF64 = frame.world_from_camera[:3, :3] @ (ray * depth_m) + frame.world_from_camera[:3, 3]
    return place_m


# ------------------------------------------------------------------------------------------------------------ the scan


def frames_to_scan(capture: Capture) -> set[int]:
    """Places in the recording of the frames that are scanned: those after the camera has moved or turned."""
    chosen: set[int] = set()
    last = None
    for index, frame in enumerate(capture.frames):
        pose = frame.camera.world_from_camera
        if last is not None:
            turned_rad = np.arccos(np.clip((np.trace(last[:3, :3].T @ pose[:3, :3]) - 1) / 2, -1, 1))
            if turned_rad < TURNED_RAD and np.linalg.norm(pose[:3, 3] - last[:3, 3]) < MOVED_M:
                continue
        chosen.add(index)
        last = pose
    return chosen


def add_scan(name: str, scan: ScanMesh, unit_m: float) -> bpy.types.Object:
    """An object, in no collection yet, of `scan`; `unit_m` are metres in a Blender unit."""
    mesh = bpy.data.meshes.new(name)
    fill_mesh(mesh, scan.points_m / np.float32(unit_m), scan.quads.ravel(), 4 * np.arange(len(scan.quads)))
    colours = mesh.color_attributes.new(COLOURS, "BYTE_COLOR", "POINT")
    opaque = np.column_stack([in_working_space(scan.colours.clip(0, 1)), np.ones(len(scan.colours), np.float32)])
    colours.data.foreach_set("color", opaque.astype(np.float32).ravel())  # Linear; Blender encodes it
    mesh.materials.append(_showing_colours(name))
    item = bpy.data.objects.new(name, mesh)
    item[SCAN] = name
    item.is_shadow_catcher = True
    return item


def _showing_colours(name: str) -> bpy.types.Material:
    """A dull material in the colours of the mesh's points, and see-through where a solid view shows no colours."""
    material = new_material(name)
    material.diffuse_color = SOLID_COLOUR
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    colour = tree.nodes.new("ShaderNodeVertexColor")
    colour.layer_name, colour.location = COLOURS, (-250, 250)
    tree.links.new(colour.outputs["Color"], shader.inputs["Base Color"])
    return material
