"""Ambient light and a mirror sphere in the room: what do they know that our estimate does not, and the reverse?"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import write_picture
from xihe_blender.lab.paper.clouds import View, views, walked, with_truth
from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, measured, measured_ratio, of_rooms
from xihenet import estimators
from xihenet.colour import linear_to_srgb
from xihenet.estimators import EstimateContext
from xihenet.light.light_picture import three_spheres
from xihenet.metrics import shc_rmse
from xihenet.mirror_sphere import mirror_sphere_cloud
from xihenet.records import ArrayBool, ArrayF64
from xihenet.sphere import AnchorLattice

TRUE, WALK, VIEW = "true light", "estimate of the walk", "estimate of one view"
SPHERE, AMBIENT = "mirror sphere", "ambient"
METHODS = (WALK, VIEW, SPHERE, AMBIENT)
LIGHT = (
    "The paper shows pictures and no figure. Ambient light is the mean of what the camera sees, as ARKit gives one "
    "intensity and colour; the mirror sphere is read as GLEAM reads its probe."
)
PICTURE = (
    "Three spheres under nine coefficients are compared with path-traced ones, in sRGB, clipped at white. The error "
    "under the true light comes from the nine coefficients, and from clipping."
)
TIMES = "The paper compares times (19.9 % less than GLEAM); here errors in the same room are compared."
SAMPLES = 16
RIM = 0.95
"""Of a sphere's radius."""


def measure(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    errors: dict[str, list[float]] = defaultdict(list)
    pictures: dict[str, list[float]] = defaultdict(list)
    rooms = []
    for session in with_truth(sessions):
        if session.blend_file is None:
            continue
        found = _lights(session, options)
        rooms += [session.name] * len(found)
        for view, lights in found:
            for method, light in lights.items():
                errors[method].append(shc_rmse(light, view.place.true_ldr))
            truth = path_traced(view)
            for method, light in (lights | {TRUE: view.place.true_ldr}).items():
                pictures[method].append(spheres_error(shown(light, len(truth)), truth))
        if found:
            write_picture(options.folder / f"{session.name}.png", _strip(*found[0]))
    if len(rooms) < 2:
        raise UserError("fewer than two places in view of rooms with a .blend file: give more --scenes")
    cases = of_rooms("views", rooms)
    for method in METHODS:
        of_all = measured(errors[method], options.rng, groups=rooms)
        yield Row(f"{method}: light", "SHC RMSE", *of_all, "cannot be compared", LIGHT, cases=cases)
    for method in (TRUE, *METHODS):
        of_all = measured(pictures[method], options.rng, groups=rooms)
        yield Row(f"{method}: picture", "sRGB RMSE", *of_all, "cannot be compared", PICTURE, cases=cases)
    for other in (SPHERE, AMBIENT):
        over = measured_ratio(errors[WALK], errors[other], options.rng, groups=rooms)
        yield Row(f"{WALK} over {other}, light", "times", *over, "cannot be compared", TIMES, cases=cases)


def _lights(session: Session, options: StudyOptions) -> list[tuple[View, dict[str, ArrayF64]]]:
    """Views in which something is seen in the sphere, and each method's light at their places."""
    from xihe_blender.capture.mirror_sphere import RADIUS_M, open_mirror_sphere
    from xihe_blender.capture.render import RenderSettings
    from xihe_blender.lab.paper.sessions import open_walk

    assert session.blend_file is not None
    lattice, projection = AnchorLattice(1280), estimators.load("projection", 1280, "ldr")
    network, ambient = estimators.load("lattice", 1280, "ldr"), estimators.load("ambient", 1280, "ldr")
    names = [place.name for place in session.places]
    walks = dict(zip(names, walked(session, lattice), strict=True))
    camera = session.frames[0].intrinsics
    settings = RenderSettings((camera.width, camera.height), SAMPLES, options.seed)
    found = []
    with open_mirror_sphere(open_walk(session.blend_file, session.n_between), settings) as sphere:
        for view in views([session], 4 if options.quick else 20):
            place_m = view.place.position_m
            seen = sphere.seen_at(view.frame.frame, place_m, session.exposure)
            if seen is None:
                continue
            reflected = mirror_sphere_cloud(seen[0], place_m, RADIUS_M, lattice)
            if not reflected.is_set.any():  # Too far away or hidden but for a rim: nothing can be read off it.
                continue
            one_view = view.cloud(lattice)
            context = EstimateContext(view.frame, view.points, place_m, None, session.exposure)
            lights = {
                WALK: network.estimate(walks[view.place.name], context),
                VIEW: network.estimate(one_view, context),
                SPHERE: projection.estimate(reflected, context),
                AMBIENT: ambient.estimate(one_view, context),
            }
            found.append((view, lights))
    return found


def shown(light: ArrayF64, size: int) -> ArrayF64:
    """(S, 3 S, 3) sRGB of the three spheres under a light."""
    return np.asarray(linear_to_srgb(np.concatenate(list(three_spheres(light, size)), axis=1).clip(0, 1)))


def path_traced(view: View) -> ArrayF64:
    """The same of the spheres in the room."""
    assert view.place.spheres is not None
    return np.asarray(linear_to_srgb(view.place.spheres.clip(0, 1)))


def spheres_error(seen: ArrayF64, truth: ArrayF64) -> float:
    """Root mean square over the pixels of spheres side by side (S, N S, 3)."""
    mask = np.tile(inside_rim(len(truth)), (1, truth.shape[1] // len(truth)))
    return float(np.sqrt(np.mean((seen - truth)[mask] ** 2)))


def inside_rim(size: int) -> ArrayBool:
    """(S, S) the pixels of a sphere that fills its picture, without those at its rim that show what is behind."""
    across = (2 * np.arange(size) + 1) / size - 1
    return np.asarray(np.hypot(across, across[:, None]) < RIM)


def _strip(view: View, lights: dict[str, ArrayF64]) -> ArrayF64:
    """Rows: path-traced, the true light, and each method."""
    truth = path_traced(view)
    return np.concatenate([truth, *(shown(one, len(truth)) for one in (view.place.true_ldr, *lights.values()))])


STUDY = Study(
    "probes",
    "Ambient light, mirror sphere",
    15,
    "The paper renders three objects with ARKit's ambient light and with its own, and compares its time with GLEAM, "
    "which reads a mirror sphere.",
    measure,
    caption=f"From above: path-traced in the room, {TRUE} as nine coefficients, {', '.join(METHODS)}.",
)
