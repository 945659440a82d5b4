"""Materials: which look right under nine coefficients? A sphere of each, in the room and under the estimate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import write_picture
from xihe_blender.lab.paper.clouds import walked, with_truth
from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, measured, of_rooms
from xihe_blender.lab.paper.studies.probes import spheres_error
from xihenet import estimators
from xihenet.colour import linear_to_srgb
from xihenet.records import ArrayF32, ArrayF64
from xihenet.sphere import AnchorLattice

METALLIC, SMOOTHNESS = (0.0, 0.5, 1.0), (0.0, 0.33, 0.67, 1.0)
GRID = [(metallic, smoothness) for metallic in METALLIC for smoothness in SMOOTHNESS]
SIZE, SAMPLES = 64, 24
ESTIMATE, TRUE = "estimate", "true light"
SENTENCE = (
    "The paper shows pictures of a bunny and no figure. Here a white sphere under each light is compared with the "
    "same sphere path-traced in the room. The error under the true light comes from the nine coefficients, and from"
    " clipping."
)


def measure(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    errors: dict[str, list[list[float]]] = {ESTIMATE: [], TRUE: []}
    steady = [session for session in with_truth(sessions) if session.blend_file is not None]
    rooms = []
    for session in steady:
        n = (2 if len(steady) == 1 else 1) if options.quick else len(session.places)
        pictures = _pictures(session, n, options)
        write_picture(
            options.folder / f"{session.name}.png",
            np.concatenate([_sheet(one[0]) for one in pictures.values()], axis=1),
        )
        truths = pictures.pop("room")
        rooms += [session.name] * len(truths)
        for light, seen in pictures.items():
            for one, truth in zip(seen, truths, strict=True):
                errors[light].append([spheres_error(*pair) for pair in zip(one, truth, strict=True)])
    if len(rooms) < 2:
        raise UserError("fewer than two places in rooms with a .blend file: give more --scenes")
    for light, each in errors.items():
        for cell, (metallic, smoothness) in enumerate(GRID):
            of_all = measured([place[cell] for place in each], options.rng, groups=rooms)
            what = f"metallic {metallic:g}, smoothness {smoothness:g}: under the {light}"
            series = (f"{light}, metallic {metallic:g}", smoothness)
            is_detail, cases = metallic not in (METALLIC[0], METALLIC[-1]), of_rooms("places", rooms)
            yield Row(what, "sRGB RMSE", *of_all, "cannot be compared", SENTENCE, None, cases, *series, is_detail)


def _pictures(session: Session, n: int, options: StudyOptions) -> dict[str, list[ArrayF64]]:
    """Of the first `n` places, by light, and "room", (G, S, S, 3) of each place: the sphere of each material."""
    import bpy

    from xihe_blender.apply.sh_worlds import apply_sh_to_world, make_sh_world
    from xihe_blender.capture.render import RenderSettings
    from xihe_blender.capture.three_spheres import open_three_spheres
    from xihe_blender.lab.paper.sessions import open_walk

    assert session.blend_file is not None
    looks = {f"{m:g} {s:g}": {"Metallic": m, "Roughness": 1 - s} for m, s in GRID}
    settings = RenderSettings((SIZE, SIZE), SAMPLES, options.seed)
    places, frame = session.places[:n], session.frames[0].frame
    network = estimators.load("lattice", 1280, "ldr")
    lights = {
        ESTIMATE: [network.estimate(cloud) for cloud in walked(session, AnchorLattice(1280))[:n]],
        TRUE: [place.true_ldr for place in places],
    }
    scene = open_walk(session.blend_file, session.n_between)
    seen: dict[str, list[ArrayF64]] = {}
    with open_three_spheres(scene, settings, SIZE, looks=looks) as spheres:
        seen["room"] = [_cells(spheres.seen_at(frame, place.position_m, session.exposure)) for place in places]
    empty, world = bpy.data.scenes.new("Xihe Materials"), make_sh_world("Xihe Materials")
    empty.world = world
    try:
        with open_three_spheres(empty, settings, SIZE, looks=looks) as spheres:
            for name, each in lights.items():
                seen[name] = []
                for light in each:
                    apply_sh_to_world(world, light)
                    seen[name].append(_cells(spheres.seen_at(1, np.zeros(3), 1.0)))
    finally:
        bpy.data.scenes.remove(empty)
        bpy.data.worlds.remove(world)
    return seen


def _cells(row: ArrayF32) -> ArrayF64:
    """(G, S, S, 3) sRGB of spheres side by side."""
    return np.asarray(linear_to_srgb(np.stack(np.split(row.clip(0, 1), len(GRID), axis=1))))


def _sheet(cells: ArrayF64) -> ArrayF64:
    """A row per metallic, a column per smoothness."""
    rows = np.split(cells, len(METALLIC))
    return np.concatenate([np.concatenate(list(row), axis=1) for row in rows])


STUDY = Study(
    "materials",
    "Materials",
    130,
    "The paper renders a bunny with metallic and smoothness from low to high under its estimate, and says that metal "
    "needs light of higher frequency than its estimate has.",
    measure,
    "smoothness",
    "Error of the picture, sRGB RMSE.",
    caption=f"Left to right: in the room, under the {ESTIMATE}, under the {TRUE} as nine coefficients. In each, "
    "metallic grows downwards and smoothness to the right.",
)
