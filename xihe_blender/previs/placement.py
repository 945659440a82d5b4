"""The placement map: where in the room will AR light fail? At every place for an object, at the end of the path.

The path is captured once, without virtual objects; then the chain runs on the captures for each place, and nothing more
is rendered (`kept_session`). What cannot be known so, the true error, is measured at a few places on request.

Its pictures are the room from above and through the phone, surfaces in the colour of their error. The room is grey and
as bright as it takes to see it, so that colour means the map alone. What is neither near a place nor known stays grey.
Places in free air have no surface to colour: they are squares.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.io.json_records import as_json
from xihe_blender.io.outputs import write_csv, write_json, write_picture
from xihe_blender.io.placement_results import N_EXTREMES, Place, PlacementResults, Verified, best_first, error_range
from xihe_blender.io.run_lights import as_rgb
from xihe_blender.jobs import Job, Progress
from xihe_blender.previs.kept_session import KeptSession, capture_path, measured_lights, path_facts
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.room_from_above import WIDTH_PX, RoomFromAbove
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.report.placement import write_placement_report
from xihe_blender.scene.state import scene_kept
from xihenet.camera import project_points, unproject_frame, valid_plane_depth
from xihenet.camera_path.kept_path import FoundLight
from xihenet.camera_path.placement import REACH_M, air_places, evenly_chosen, places_among, seen_extent, upward_points
from xihenet.colour import LUMINANCE
from xihenet.estimators import Estimator
from xihenet.metrics import shc_rmse
from xihenet.paired import rank_correlation, rank_correlation_interval
from xihenet.records import ArrayF32, ArrayF64, ArrayInt, ArrayU8, RgbdFrame
from xihenet.sh import irradiance

FINEST_M, GROWTH, N_SPACINGS = 0.05, 1.15, 40
UP = np.array([[0.0, 0.0, 1.0]])

BRIGHT, WHITE_AT = 200.0, 95.0
"""Grey of what only `100 - WHITE_AT` percent of the room exceed in brightness."""

SHADE = 0.45
"""Share of a coloured surface's brightness that is not taken from the room."""

AROUND_M = 0.4
"""Of the room that is shown beyond the outermost places."""

BEST_RING, WORST_RING, RING_PX = 255.0, 0.0, 10
"""Grey, and the radius, of the rings around the ten best and the ten worst places in the picture from above."""

SURFACE_M = 0.1
"""A point so far above or below a place is of another surface."""


@dataclass(frozen=True)
class PlacementSettings:
    """Which places are looked at.

    Parameters
    ----------
    height_m : a grid in free air at this height; None takes upward surfaces
    spacing_m : between places; None takes the finest that gives at most `most`
    most : places
    clearance_m : of a place above its surface, where the middle of a small object would be
    reach_m : of a place from the camera, in some frame
    n_verified : places whose reference light is rendered, to say how far the prediction is right
    """

    height_m: float | None = None
    spacing_m: float | None = None
    most: int = 1000
    clearance_m: float = 0.1
    reach_m: float = REACH_M
    n_verified: int = 0

    def __post_init__(self) -> None:
        for name, value in (("spacing", self.spacing_m), ("clearance", self.clearance_m), ("reach", self.reach_m)):
            if value is not None and not (0 < value < math.inf):
                raise UserError(f"a {name} of {value:g} m is not usable: give a positive number of metres")
        if self.height_m is not None and not math.isfinite(self.height_m):
            raise UserError(f"a height of {self.height_m:g} m is not usable: give metres above the world's origin")
        if self.most < 1 or self.n_verified < 0:
            raise UserError("--places: give 1 or more; --verify: give 0 or more")


def placement(
    scene: bpy.types.Scene,
    out: Path,
    settings: PrevisSettings,
    wanted: PlacementSettings,
    *,
    blend_file: Path,
    command: str = "",
) -> Job[PlacementResults]:
    """A job: the placement map of `scene`, in the folder `out`: placement.json, .csv, pictures and report.

    The captures are kept there and resumed. UserError for a scene without a camera, or where nothing is to be placed,
    and as of `check_expects_error`.
    """
    check_expects_error(settings)
    with contextlib.ExitStack() as held, scene_kept():
        captured = yield from capture_path(scene, out, settings, "a placement map", held, blend_file=blend_file)
        run, session = captured.run, captured.session
        mapped = yield from map_places(session, wanted)
        places, verified = yield from _verified(run, mapped, wanted.n_verified)
        results = PlacementResults(
            **path_facts(captured.run, blend_file, command, asdict(wanted)),
            spacing_m=mapped.spacing_m,
            clearance_m=wanted.clearance_m if wanted.height_m is None else None,
            n_unknown=sum(place.expected_error is None for place in places),
            places=places,
            verified=verified,
        )
        yield Progress(1, 1, "writing the report")
        pictures = write_pictures(out, [one.seen for one in session.frames], results)
        write_placement_report(out / "report.html", results, pictures)
        write_csv(out / "placement.csv", [_row(place) for place in results.places], list(_row(results.places[0])))
        write_json(out / "placement.json", as_json(results))
        return results


def check_expects_error(settings: PrevisSettings) -> None:
    """UserError for an estimator that does not say what error it expects, which is what the map shows."""
    (estimator, *_) = load_estimators(settings)
    if type(estimator).estimate_with_error is Estimator.estimate_with_error:
        raise UserError(
            f"estimator {settings.estimator!r} does not say what error it expects, so that a map of it would show "
            "nothing: choose lattice"
        )


def _row(place: Place) -> dict[str, Any]:
    x, y, z = place.position_m
    red, green, blue = place.irradiance or (None, None, None)
    own = {"coverage": place.coverage, "expected_error": place.expected_error, "true_error": place.true_error}
    return {"x_m": x, "y_m": y, "z_m": z, **own, "irradiance_r": red, "irradiance_g": green, "irradiance_b": blue}


# --------------------------------------------------------------------------------------------------------------- places


@dataclass(frozen=True, eq=False)
class MappedPlaces:
    """Places `spacing_m` apart, and the (9, 3) light at each, carrying the session's exposure."""

    places: tuple[Place, ...]
    lights: tuple[ArrayF64, ...]
    spacing_m: float


def map_places(session: KeptSession, wanted: PlacementSettings) -> Job[MappedPlaces]:
    """A job: the light at every place that the frames of `session` show. Nothing is rendered.

    UserError where there is no place, and as of `check_expects_error`.
    """
    check_expects_error(session.settings)
    # A map shows irradiance alone: with the key light it takes 1.7 times as long.
    session = replace(session, settings=replace(session.settings, light="sh"))
    places_m, spacing_m = yield from find_places(session, wanted)
    found = yield from session.find_light_on_all_cores({str(k): place for k, place in enumerate(places_m)})
    places = (_place(place, light, session.exposure) for place, light in zip(places_m, found.values(), strict=True))
    lights = (light.sh[next(reversed(light.sh))] for light in found.values())
    return MappedPlaces(tuple(places), tuple(lights), spacing_m)


def find_places(session: KeptSession, wanted: PlacementSettings) -> Job[tuple[ArrayF64, float]]:
    """A job: (K, 3) positions, in metres, and their spacing; UserError where there are none."""
    yield Progress(0, 1, "looking for places")
    frames = [one.seen for one in session.frames]
    if wanted.height_m is not None:
        extent_m = seen_extent(frames)
        find = functools.partial(air_places, frames, wanted.height_m, reach_m=wanted.reach_m, extent_m=extent_m)
        what = f"the air at {wanted.height_m:g} m"
    else:
        find, what = functools.partial(places_among, upward_points(frames, wanted.reach_m)), "an upward surface"
    best: tuple[ArrayF64, float] | None = None
    fewest: tuple[ArrayF64, float] | None = None
    finest_first = [FINEST_M * GROWTH**k for k in range(N_SPACINGS)]
    for spacing_m in finest_first if wanted.spacing_m is None else [wanted.spacing_m]:
        yield Progress(0, 1, "looking for places")
        try:
            found = find(spacing_m)
        except ValueError as error:  # Too many places to look at.
            if wanted.spacing_m is not None:
                raise UserError(str(error)) from error
            continue
        # Where cells are smaller than pixels are apart, wider ones have more places.
        if best is not None and len(found) < len(best[0]):
            break
        if len(found) and (len(found) <= wanted.most or wanted.spacing_m is not None):
            best = found, spacing_m
        elif len(found):
            fewest = found, spacing_m
    if best is None and fewest is not None:
        best = np.array(evenly_chosen(list(fewest[0]), wanted.most)), fewest[1]
    if best is None:
        fix = "" if wanted.height_m is None else "give another --height, "
        raise UserError(
            f"there is no place for an object: no frame of the path shows {what} within {wanted.reach_m:g} m "
            f"of the camera; {fix}bring the camera nearer to it, or give a larger --reach"
        )
    clearance_m = 0.0 if wanted.height_m is not None else wanted.clearance_m
    return best[0] + (0, 0, clearance_m), best[1]


def _place(position_m: ArrayF64, light: FoundLight, exposure: float) -> Place:
    last = next(reversed(light.sh))
    error = light.expected_error[last]
    return Place(
        position_m=as_rgb(position_m),
        coverage=light.coverage[last] if light.was_in_view else 0.0,
        expected_error=error,
        irradiance=as_rgb(irradiance(light.sh[last], UP)[0] / exposure) if error is not None else None,
    )


# --------------------------------------------------------------------------------------------------------- verification


def _verified(run: PreparedRun, mapped: MappedPlaces, n: int) -> Job[tuple[tuple[Place, ...], Verified | None]]:
    """The places, `n` of them with their true error, chosen evenly over the expected one; and what follows."""
    places = list(mapped.places)
    ranked = best_first(places)
    chosen = evenly_chosen(ranked, n) if n and ranked else []
    if not chosen:
        return mapped.places, None
    # Against a light probe in the last frame; probes are kept.
    truths = yield from measured_lights(run, [places[k].position_m for k in chosen])
    errors = [shc_rmse(mapped.lights[k], truth) for k, truth in zip(chosen, truths, strict=True)]
    for k, error in zip(chosen, errors, strict=True):
        places[k] = replace(places[k], true_error=error)
    expected = np.array([places[k].expected_error for k in chosen])
    return tuple(places), _verdict(expected, np.array(errors), np.random.default_rng(run.settings.seed))


def _verdict(expected: ArrayF64, true: ArrayF64, rng: np.random.Generator) -> Verified:
    """Of errors (K,) in ascending order of the expected ones."""
    correlation, (low, high) = rank_correlation(expected, true), rank_correlation_interval(expected, true, rng)
    n_ends = min(N_EXTREMES, len(true) // 2)
    return Verified(
        n_places=len(true),
        rank_correlation=correlation if math.isfinite(correlation) else None,
        interval=(low, high) if math.isfinite(low) else None,
        mean_error_of_best=float(true[:n_ends].mean()) if n_ends else None,
        mean_error_of_worst=float(true[-n_ends:].mean()) if n_ends else None,
    )


# -------------------------------------------------------------------------------------------------------- the pictures


def write_pictures(folder: Path, frames: Sequence[RgbdFrame], results: PlacementResults) -> list[Path]:
    """`above.png` and `camera.png`; their paths."""
    paths = [folder / "pictures" / "above.png", folder / "pictures" / "camera.png"]
    painter = Painter(results)
    write_picture(paths[0], _from_above(frames, painter))
    write_picture(paths[1], _through_camera(frames, painter))
    return paths


class Painter:
    """Which place a point of the room belongs to, and the colour of either."""

    def __init__(self, results: PlacementResults) -> None:
        self.positions = np.array([place.position_m for place in results.places])
        shown = error_range(results.places)
        self.colours = np.array([place.colour(shown) for place in results.places])
        ordered = best_first(results.places)
        self.best, self.worst = ordered[:N_EXTREMES], ordered[::-1][:N_EXTREMES]
        self.spacing_m, self.clearance_m = results.spacing_m, results.clearance_m
        self.keys = self._cells(self.positions)
        self.order = np.lexsort((self.positions[:, 2], self.keys))

    @property
    def are_in_air(self) -> bool:
        return self.clearance_m is None

    def _cells(self, points: ArrayF64) -> ArrayInt:
        """(P,) a number for each cell of the floor plan, as the places were found."""
        x, y = np.floor(points[:, :2] / self.spacing_m).astype(np.int64).T
        cells: ArrayInt = x * (1 << 31) + y
        return cells

    def place_of(self, points: ArrayF64) -> ArrayInt:
        """(P,) index of the place on whose surface each point (P, 3) lies, -1 for none."""
        found = np.full(len(points), -1)
        if self.clearance_m is None:
            return found
        sorted_keys, keys = self.keys[self.order], self._cells(points)
        first, after = (np.searchsorted(sorted_keys, keys, side) for side in ("left", "right"))
        surface_m = self.positions[self.order, 2] - self.clearance_m
        for layer in range(int((after - first).max(initial=0))):
            at = np.minimum(first + layer, len(sorted_keys) - 1)
            is_it = (first + layer < after) & (np.abs(points[:, 2] - surface_m[at]) < SURFACE_M)
            found[is_it] = self.order[at[is_it]]
        return found

    def paint(self, points: ArrayF64, srgb: ArrayF32 | ArrayF64) -> ArrayF64:
        """(P, 3), 0 to 255: points (P, 3) of the room, in sRGB-encoded colours (P, 3)."""
        brightness = srgb @ LUMINANCE
        white = max(float(np.percentile(brightness, WHITE_AT)) if len(srgb) else 1.0, 1e-3)
        grey = np.minimum(brightness / white, 1.0) * BRIGHT
        place, shade = self.place_of(points), SHADE + (1 - SHADE) * grey / BRIGHT
        room = np.repeat(grey[:, None], 3, axis=1)
        return np.where(place[:, None] < 0, room, self.colours[place] * shade[:, None])


def _from_above(frames: Sequence[RgbdFrame], painter: Painter) -> ArrayU8:
    positions = painter.positions
    room = RoomFromAbove(frames, positions, AROUND_M, painter.paint)
    if painter.are_in_air:
        half = max(1, int(0.28 * painter.spacing_m * room.pixels_per_m))
        for place, colour in zip(positions, painter.colours, strict=True):
            room.square(place, colour, half)
    for ends, grey in ((painter.best, BEST_RING), (painter.worst, WORST_RING)):
        for x, y in zip(*room.pixels(positions[ends]), strict=True):
            _draw_ring(room.picture, x, y, grey)
    room.metre()
    return room.picture.round().astype(np.uint8)


def _draw_ring(picture: ArrayF64, x: int, y: int, grey: float) -> None:
    rows, columns = np.ogrid[: picture.shape[0], : picture.shape[1]]
    away = np.hypot(rows - y, columns - x)
    picture[np.abs(away - RING_PX) < 3.5] = 255 - grey
    picture[np.abs(away - RING_PX) < 2] = grey


def _through_camera(frames: Sequence[RgbdFrame], painter: Painter) -> ArrayU8:
    """The captured frame in which the map is largest."""
    clouds = [unproject_frame(frame).points_m.astype(np.float64) for frame in frames]
    in_frame = [_in_picture(painter.positions, frame) for frame in frames]
    if painter.are_in_air:
        best = int(np.argmax([len(pixels) for _, pixels, _ in in_frame]))
    else:
        best = int(np.argmax([(painter.place_of(np.nan_to_num(cloud, nan=1e9)) >= 0).sum() for cloud in clouds]))
    frame, (which, pixels, distance_m) = frames[best], in_frame[best]
    srgb = frame.srgb_u8.reshape(-1, 3) / 255
    painted = painter.paint(np.nan_to_num(clouds[best], nan=1e9, posinf=1e9, neginf=-1e9), srgb)
    larger = max(1, round(WIDTH_PX / frame.intrinsics.width))
    picture = painted.reshape(frame.srgb_u8.shape).repeat(larger, axis=0).repeat(larger, axis=1)
    if painter.are_in_air:
        halves = np.clip(0.03 * frame.intrinsics.fx * larger / distance_m, 2, 14).astype(int).tolist()
        middles = (pixels * larger).astype(int).tolist()
        for (x, y), half, colour in zip(middles, halves, painter.colours[which], strict=True):
            picture[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1] = colour
    return picture.round().astype(np.uint8)


def _in_picture(positions: ArrayF64, frame: RgbdFrame) -> tuple[ArrayInt, ArrayF64, ArrayF64]:
    """Which positions (K, 3) nothing hides in a frame, their pixels and plane depths, the farthest first."""
    pixels, distance_m = project_points(positions, frame.intrinsics, frame.world_from_camera)
    inside = (distance_m > 0) & (pixels >= 0).all(axis=1)
    inside &= (pixels < (frame.intrinsics.width, frame.intrinsics.height)).all(axis=1)
    column, row = np.where(inside[:, None], pixels, 0).astype(int).T
    behind = np.where(valid_plane_depth(frame.plane_depth_m), frame.plane_depth_m, np.inf)[row, column]
    which = np.flatnonzero(inside & (distance_m < behind))
    which = which[np.argsort(-distance_m[which], kind="stable")]
    return which, pixels[which], distance_m[which]
