"""Pictures along the path: which frames are compared with the ground truth, and what is left of each?

Every n-th frame in which the chain ran, by the preset, and the last. A comparison is read where an earlier part of the
run kept it, taken over from an earlier frame where scene, camera, capture and lights are the same, else rendered; see
`compare.methods`. Comparisons are set up only when the first one has to be rendered.

Of a phone's recording nothing can be compared: every frame shows the virtual objects in it, as a film. Their shadows
fall on the scan of the recording, or on flat surfaces in it where the scene has none any more. Frames before there is
any light show the recording alone.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from xihe_blender.apply.shadow_catchers import triangles_of
from xihe_blender.compare import methods
from xihe_blender.compare.methods import Comparer, Comparison, OverRecording
from xihe_blender.compare.side_by_side import save_film
from xihe_blender.io.exr import write_radiance
from xihe_blender.io.json_records import Json, as_json, read_record
from xihe_blender.io.kept_files import kept_json, kept_record, read_kept
from xihe_blender.io.outputs import RunOutputs, copy_whole, write_json, write_picture
from xihe_blender.io.run_lights import as_surface_result
from xihe_blender.io.run_results import ComparedFrame
from xihe_blender.jobs import Job, Progress
from xihe_blender.previs.plan import compared_frames
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.run_chain import ChainResult, Lights
from xihe_blender.scene.phone_capture import scan_of
from xihenet.camera_path.placement import evenly_chosen
from xihenet.camera_path.surfaces import Surface
from xihenet.io.recording import load_frame
from xihenet.records import ArrayF64, ArrayU8, ObjectLight

OBJECTS = "objects"
"""Beside the radiance of each method: the share of each pixel that objects cover, by which metrics weigh."""

LIT_BY = "lit_by"
"""Beside a comparison that is kept: the lights that it is of."""

SAME_LIGHT = 1e-4
"""Coefficients that differ by no more are of one light: two computers differ by less than a hundredth of it."""

MOST_SEEN = 12
"""Captures in which surfaces are looked for, evenly spread: more show no more of a table."""

Compared = TypeVar("Compared")


def compare_path(run: PreparedRun, chain: ChainResult) -> Job[dict[int, ComparedFrame]]:
    """A job: the comparison of each compared frame, by its number; pictures are written on the way."""
    active = [frame.frame for frame in chain.frames if frame.active]
    frames = compared_frames(active, run.settings.preset_values.comparison_step)
    read, record = functools.partial(kept_comparison, run.outputs), functools.partial(_record_frame, run)
    lights = {frame: chain.lights[frame] for frame in frames}
    compared, sources = yield from compare_frames(run, run.methods, lights, read, record)
    for frame in frames:
        if sources[frame] != frame:
            kept = _kept(run.outputs, frame, lights[frame], read)
            compared[frame] = kept or _take_over(run.outputs, sources[frame], frame, lights[frame])
    return compared


def compare_frames(
    run: PreparedRun,
    names: Sequence[str],
    lights: Mapping[int, Lights],
    read: Callable[[int], Compared | None],
    record: Callable[[int, Comparison, Mapping[int, Compared]], Compared],
) -> Job[tuple[dict[int, Compared], dict[int, int]]]:
    """A job: the comparison of each frame of `lights` that is not the same as an earlier one, and which one that is.

    What `read` does not find is rendered, with all methods `names`, and what `record` makes of it, and of what is kept
    of others, is kept. A method without a light stays dark.
    """
    first: dict[tuple[Any, ...], int] = {}
    sources = {frame: first.setdefault(_made_from(run, frame, own), frame) for frame, own in lights.items()}
    own = [frame for frame, source in sources.items() if source == frame]
    done = {frame: one for frame in own if (one := _kept(run.outputs, frame, lights[frame], read)) is not None}
    missing = [frame for frame in own if frame not in done]
    if not missing:
        return done, sources
    dark = {item.name: ObjectLight(np.zeros((9, 3))) for item in run.plan.objects}
    # All ground truths, then all methods, so that Cycles builds each of the two scenes once.
    with run.open_comparer(names) as comparer:
        yield from _render_ground_truths(run, missing, comparer)
        for number, frame in enumerate(missing):
            yield run.progress("methods", number / len(missing), f"comparing frame {frame}")
            truth = methods.load_ground_truth(run.outputs.ground_truth(frame))
            captured, surfaces = load_frame(run.outputs.capture(frame)), surfaces_known(run, frame, comparer)
            of_all = {name: lights[frame].get(name, dark) for name in names}
            one = record(frame, comparer.render_methods(captured, of_all, truth, surfaces), done)
            _keep(run.outputs, frame, one, lights[frame])
            run.outputs.ground_truth(frame).unlink()
            done[frame] = read_record(type(one), run.outputs.compared(frame))
    return done, sources


def _keep(outputs: RunOutputs, frame: int, compared: object, lights: Lights) -> None:
    write_json(outputs.compared(frame), as_json(compared) | {LIT_BY: _noted(lights)})


def _kept(outputs: RunOutputs, frame: int, lights: Lights, read: Callable[[int], Compared | None]) -> Compared | None:
    """What `read` finds of `frame` if it is of these lights: an edge service may have answered otherwise before a stop.

    Earlier versions did not note the lights.
    """
    kept = read(frame)
    return kept if kept is not None and _is_lit_by(outputs, frame, lights) else None


def _is_lit_by(outputs: RunOutputs, frame: int, lights: Lights) -> bool:
    def is_the_same(kept: Json) -> bool:
        was, now = kept.get(LIT_BY), _noted(lights)
        if was is None:
            return True
        return was.keys() == now.keys() and all(np.allclose(was[of], now[of], atol=SAME_LIGHT) for of in now)

    return bool(kept_json(outputs.compared(frame), is_the_same))


def _noted(lights: Lights) -> dict[str, Json]:
    """The coefficients by method and object."""
    return {f"{method} {name}": one.sh.round(6).tolist() for method, of in lights.items() for name, one in of.items()}


def kept_comparison(outputs: RunOutputs, frame: int) -> ComparedFrame | None:
    """What an earlier part of the run kept; None where its radiance is not all there, as an earlier version left it."""
    kept = kept_record(ComparedFrame, outputs.compared(frame))
    return kept if kept is not None and all(path.exists() for path in _radiance(outputs, kept, frame)) else None


def _radiance(outputs: RunOutputs, compared: ComparedFrame, frame: int) -> list[Path]:
    return [outputs.radiance(name, frame) for name in ("ground_truth", OBJECTS, *compared.comparison)]


def _render_ground_truths(run: PreparedRun, frames: Sequence[int], comparer: Comparer) -> Iterator[Progress]:
    """Those of `frames` that are not kept yet."""
    for done, frame in enumerate(frames):
        yield run.progress("ground truth", done / len(frames), f"rendering the ground truth of frame {frame}")
        path = run.outputs.ground_truth(frame)
        if read_kept(path, methods.load_ground_truth) is None:
            methods.save_ground_truth(path, comparer.render_ground_truth(frame))


def _made_from(run: PreparedRun, frame: int, lights: Lights) -> tuple[Any, ...]:
    """The same where a comparison is: scene, camera, capture and the lights by method."""
    captured = load_frame(run.outputs.capture(frame))
    of_all = [light.tobytes() for of_method in lights.values() for light in of_method.values()]
    pixels = captured.srgb_u8.tobytes(), captured.plane_depth_m.tobytes()
    room = frames_seen(run, frame) if run.settings.has_key_light else ()
    return run.reuse.comparison(frame, *pixels, ",".join(lights).encode(), repr(room).encode(), *of_all)


def _take_over(outputs: RunOutputs, source: int, frame: int, lights: Lights) -> ComparedFrame:
    compared = read_record(ComparedFrame, outputs.compared(source))
    for kept, path in zip(*(_radiance(outputs, compared, one) for one in (source, frame)), strict=True):
        copy_whole(kept, path)
    # What the phone saw has been written before; its exposure may differ.
    for kind in compared.pictures.keys() - {"captured"}:
        copy_whole(outputs.picture(kind, source), outputs.picture(kind, frame))
    pictures = {kind: outputs.relative(outputs.picture(kind, frame)) for kind in compared.pictures}
    taken_over = replace(compared, pictures=pictures, comparison_render_s=0.0, comparison_same_as=source)
    _keep(outputs, frame, taken_over, lights)
    return taken_over


def _record_frame(run: PreparedRun, frame: int, compared: Comparison, _done: object) -> ComparedFrame:
    metrics, n_hueless = {}, {}
    for name, picture in compared.methods.items():
        metrics[name] = methods.measure(picture, compared.ground_truth, compared.weights, compared.ring)
        n_hueless[name] = methods.hueless_pixels(picture, compared.ground_truth, compared.weights)
    return ComparedFrame(
        pictures=_write_pictures(run, frame, compared),
        comparison=metrics,
        n_hueless_pixels=n_hueless,
        object_pixels=float(compared.weights.sum()),
        comparison_render_s=compared.render_s,
        comparison_same_as=None,
        surfaces={name: tuple(map(as_surface_result, found)) for name, found in compared.surfaces.items()},
    )


def surfaces_known(run: PreparedRun, frame: int, comparer: Comparer) -> dict[str, list[Surface]]:
    """By object, the surfaces around it that the phone has seen up to `frame`; nothing where no shadow is caught."""
    if not comparer.catchers:
        return {}
    chosen = evenly_chosen(frames_seen(run, frame), MOST_SEEN)
    seen = [load_frame(run.outputs.capture(one)) for one in chosen]
    return comparer.surfaces_around_objects(seen, frame)


def frames_seen(run: PreparedRun, frame: int) -> list[int]:
    """The captures up to `frame`, without those that are the same as one before."""
    sources = [run.reuse.captures[one] for one in run.plan.frames if one <= frame and one in run.needs.captured]
    return list(dict.fromkeys(sources))


def _write_pictures(run: PreparedRun, frame: int, compared: Comparison) -> dict[str, str]:
    """Paths by kind of picture, as results name them."""
    shown = {"ground_truth": compared.ground_truth, **compared.methods}
    pictures = {kind: methods.display(picture) for kind, picture in shown.items()}
    for method, picture in compared.methods.items():
        pictures[f"error_{method}"] = methods.error_map(picture, compared.ground_truth, compared.weights)
    for kind, picture in shown.items():
        write_radiance(run.outputs.radiance(kind, frame), (picture / run.exposure).astype(np.float32))
    share = np.repeat(compared.weights[..., None], 3, axis=-1)
    write_radiance(run.outputs.radiance(OBJECTS, frame), share.astype(np.float32))
    for kind, picture in pictures.items():
        write_picture(run.outputs.picture(kind, frame), picture)
    return {kind: run.outputs.relative(run.outputs.picture(kind, frame)) for kind in ("captured", *pictures)}


# ---------------------------------------------------------------------------------------------------- over a recording


def composite_path(run: PreparedRun, chain: ChainResult) -> Job[dict[int, dict[str, str]]]:
    """A job: the paths of the pictures by frame and method, as results name them; pictures and film are written."""
    shown = [run.settings.estimator, *run.settings.others]
    frames = [frame for frame in sorted(run.needs.captured) if frame in chain.lights]
    pictures = {frame: {method: run.outputs.picture(method, frame) for method in shown} for frame in frames}
    are_there = [frame for frame in frames if all(path.exists() for path in pictures[frame].values())]
    kept = [frame for frame in are_there if _is_lit_by(run.outputs, frame, chain.lights[frame])]
    missing = [frame for frame in frames if frame not in kept]
    yield from _render_missing(run, chain, shown, missing)
    captured = {frame: run.outputs.picture("captured", frame) for frame in sorted(run.needs.captured)}
    film = captured | {frame: of_frame[shown[0]] for frame, of_frame in pictures.items()}
    if len(film) > 1:
        yield run.progress("methods", 1, "writing the film")
        render = run.scene.render
        save_film(film, run.plan.size, render.fps / render.fps_base, run.outputs.composited)
    named = run.outputs.relative
    return {frame: {name: named(path) for name, path in of_frame.items()} for frame, of_frame in pictures.items()}


def _render_missing(run: PreparedRun, chain: ChainResult, shown: list[str], missing: list[int]) -> Iterator[Progress]:
    if not missing:
        return
    scan = scan_of(run.scene) if run.settings.has_key_light else None
    over = OverRecording(run.exposure, None if scan is None else triangles_of(scan))
    with run.open_comparer(shown, over) as comparer:
        for done, frame in enumerate(missing):
            yield run.progress("methods", done / len(missing), f"putting the objects into frame {frame}")
            captured = load_frame(run.outputs.capture(frame))
            pictures: dict[str, ArrayU8 | ArrayF64] = dict.fromkeys(shown, captured.srgb_u8)
            if comparer.shows_an_object(captured):
                surfaces = {} if comparer.has_scan else surfaces_known(run, frame, comparer)
                lights = {method: chain.lights[frame][method] for method in shown}
                composited, _, _ = comparer.render_over(captured, lights, surfaces)
                pictures |= {method: methods.display(picture) for method, picture in composited.items()}
            for method, picture in pictures.items():
                write_picture(run.outputs.picture(method, frame), picture)
            _keep(run.outputs, frame, {}, chain.lights[frame])
