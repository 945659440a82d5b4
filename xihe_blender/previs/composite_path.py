"""Composites along the path: the virtual objects in a phone's recording, under the estimated light, as a film.

Of a recording nothing can be compared, so every frame is shown. Shadows fall on the scan of the recording, or on flat
surfaces in it where the scene has none any more. Frames before there is any light show the recording alone.
"""

from __future__ import annotations

from collections.abc import Iterator

from xihe_blender.apply.shadow_catchers import triangles_of
from xihe_blender.compare import methods
from xihe_blender.compare.methods import Comparer, OverRecording
from xihe_blender.compare.side_by_side import save_film
from xihe_blender.io.outputs import write_picture
from xihe_blender.jobs import Job, Progress
from xihe_blender.previs.compare_path import surfaces_known
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.run_chain import ChainResult
from xihe_blender.scene.phone_capture import scan_of
from xihenet.io.recording import load_frame


def composite_path(run: PreparedRun, chain: ChainResult) -> Job[dict[int, dict[str, str]]]:
    """A job: the paths of the pictures by frame and method, as results name them; pictures and film are written."""
    shown = list(dict.fromkeys([run.settings.estimator, *run.settings.others]))
    frames = [frame for frame in run.plan.frames if frame in run.needs.captured and frame in chain.lights]
    pictures = {frame: {method: run.outputs.picture(method, frame) for method in shown} for frame in frames}
    missing = [frame for frame in frames if not all(path.exists() for path in pictures[frame].values())]
    yield from _render_missing(run, chain, shown, missing)
    captured = {f: run.outputs.picture("captured", f) for f in run.plan.frames if f in run.needs.captured}
    film = {frame: pictures.get(frame, {}).get(shown[0], picture) for frame, picture in captured.items()}
    if len(film) > 1:
        yield run.progress("methods", 1, "writing the film")
        render = run.scene.render
        save_film(film, run.plan.size, render.fps / render.fps_base, run.outputs.composited)
    return {
        frame: {method: run.outputs.relative(path) for method, path in of_frame.items()}
        for frame, of_frame in pictures.items()
    }


def _render_missing(run: PreparedRun, chain: ChainResult, shown: list[str], missing: list[int]) -> Iterator[Progress]:
    if not missing:
        return
    scan = scan_of(run.scene) if run.settings.has_key_light else None
    over = OverRecording(run.exposure, None if scan is None else triangles_of(scan))
    with run.open_comparer(shown, over) as comparer:
        for done, frame in enumerate(missing):
            yield run.progress("methods", done / len(missing), f"putting the objects into frame {frame}")
            _composite(run, chain, shown, frame, comparer)


def _composite(run: PreparedRun, chain: ChainResult, shown: list[str], frame: int, comparer: Comparer) -> None:
    captured = load_frame(run.outputs.capture(frame))
    if not comparer.shows_an_object(captured):
        for method in shown:
            write_picture(run.outputs.picture(method, frame), captured.srgb_u8)
        return
    lights = {method: chain.lights[frame][method] for method in shown}
    surfaces = {} if comparer.has_scan else surfaces_known(run, frame, comparer)
    pictures, _, _ = comparer.render_over(captured, lights, surfaces)
    for method, picture in pictures.items():
        write_picture(run.outputs.picture(method, frame), methods.display(picture))
