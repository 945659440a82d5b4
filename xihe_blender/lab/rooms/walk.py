"""A person's walk through a room, with a phone: frames of a path, about one a second.

They go from one place at which an object will stand to the next, look at each, and turn around now and then to take in
the room: looks and turns follow each other, the phone turns no faster than a hand does, and who turns around stands.
Chosen: a small simulation, since smooth motion, free floor and looking at something are then true by construction.
Rejected: splines through random poses, which look at nothing.

Frames of reference: world, metres, +Z up. Angles in degrees: yaw anticlockwise from +Y, pitch up from the horizon.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from xihe_blender.lab.rooms.draws import Rng, span
from xihe_blender.lab.rooms.free_floor import FreeFloor, Route
from xihe_blender.lab.rooms.room_data import Room
from xihe_blender.lab.rooms.views import N_PHONE_RAYS, PHONE_CLEARANCE_M, PhoneView, RoomRays, hand_held_pose
from xihenet.records import ArrayF64

MARGINS_M = (0.4, 0.3, 0.2)  # Between a walker and what stands around, the most comfortable first
MIN_AREA_M2 = 0.5
DRAWS = 6
STRUCK_RADIUS_M = 0.25
LOWEST_M, HIGHEST_M = 1.2, 1.7
LOOK_FROM_M = (0.9, 2.4)  # How far from a position, sideways, one stands to look at it
SPEED_M_S = (0.5, 0.8)
STANDING_SPEED = 0.15  # Share of the speed that is left while turning around: people shift their feet
MAX_TURN_DEG, MAX_TILT_DEG, EASE = 30.0, 16.0, 0.8
"""Per frame; `EASE` is the share of what is left to turn that is turned at once."""

LOWEST_PITCH_DEG, HIGHEST_PITCH_DEG = -35.0, 20.0
LOWEST_LOOK_DEG = -50.0  # To look at what is near, one looks further down than while turning around
SWEEP_DEG = (120.0, 220.0)
DWELL_FRAMES, PATIENCE_FRAMES = 2, 6  # Frames for which a look lasts once its aim is reached, and at most
REACHED_DEG = 12.0


@dataclass(frozen=True)
class Look:
    """Look at position `place`, a little beside it."""

    place: int
    aside_deg: float
    above_deg: float


@dataclass(frozen=True)
class Sweep:
    """Turn around by `turn_deg`, to the left if positive, while the phone goes up and down."""

    turn_deg: float
    phase: float


def sample_walk(
    rng: Rng, room: Room, rays: RoomRays, positions_m: ArrayF64, views: list[PhoneView], n_frames: int
) -> list[PhoneView]:
    """`n_frames` frames of a walk past positions (P, 3).

    `views` are free views of the same room: their phone is used, and where no floor is wide enough to walk on, one
    stands where one of them was taken. Of several walks the one is taken in which each position is seen most often.
    """
    heights_m = _heights(rng, n_frames)
    for margin_m in MARGINS_M:
        walks = list(_clear_walks(rng, room, rays, positions_m, heights_m, margin_m, views[0].fov_deg))
        if walks:
            return max(walks, key=lambda walk: _fewest_sightings(walk, positions_m))
    return _standing_walk(rng, positions_m, views, n_frames)


def _clear_walks(
    rng: Rng, room: Room, rays: RoomRays, positions_m: ArrayF64, heights_m: ArrayF64, margin_m: float, fov_deg: float
) -> Iterator[list[PhoneView]]:
    """Walks on which the phone meets nothing; none where the free floor is too small."""
    floor = FreeFloor.of(room, margin_m)
    for _ in range(DRAWS):
        if floor.area_m2 < MIN_AREA_M2:
            return
        order = [int(i) for i in rng.permutation(len(positions_m))]
        route = floor.route(_stops(rng, floor, rays, positions_m[order], float(heights_m.mean())))
        walk = _walked(rng, route, heights_m, positions_m, order, fov_deg)
        struck_m = _struck(rays, np.stack([view.place_m for view in walk]))
        if len(struck_m):
            floor = floor.without(struck_m[:, :2], STRUCK_RADIUS_M)
        else:
            yield walk


def _fewest_sightings(walk: list[PhoneView], positions_m: ArrayF64) -> int:
    """Number of frames in which the position that is in view least often is in view, in a picture of 4:3."""
    slope = math.tan(math.radians(walk[0].fov_deg) / 2)
    poses = np.stack([view.world_from_camera for view in walk])
    seen = np.einsum("fij,fpi->fpj", poses[:, :3, :3], positions_m[None] - poses[:, None, :3, 3])
    across, up, reach = np.abs(seen[..., 0]), np.abs(seen[..., 1]), -seen[..., 2] * slope
    return int(((across < reach) & (up < 0.75 * reach)).sum(axis=0).min())


def _struck(rays: RoomRays, places_m: ArrayF64) -> ArrayF64:
    """Those of places (F, 3) at which something is nearer to the phone than PHONE_CLEARANCE_M.

    Over free floor nothing is big enough for the phone to be inside of it and clear of it, so nothing else is asked.
    """
    nearest_m = np.array([rays.cast_around(place, N_PHONE_RAYS)[0].min() for place in places_m])
    return places_m[nearest_m < PHONE_CLEARANCE_M]


def _standing_walk(rng: Rng, positions_m: ArrayF64, views: list[PhoneView], n_frames: int) -> list[PhoneView]:
    """All frames from the place of the view that is nearest to the height of a walk."""
    middle_m = (LOWEST_M + HIGHEST_M) / 2
    place = min((view.place_m for view in views), key=lambda place: abs(place[2] - middle_m))
    order = [int(i) for i in rng.permutation(len(positions_m))]
    route = Route.through(place[None, :2])
    return _walked(rng, route, np.full(n_frames, place[2]), positions_m, order, views[0].fov_deg)


def _heights(rng: Rng, n_frames: int) -> ArrayF64:
    """(F,) how high the phone is held: as one person does, slowly up and down."""
    middle, swing = rng.uniform(LOWEST_M + 0.1, HIGHEST_M - 0.1), rng.uniform(0.03, 0.1)
    return np.asarray(middle + swing * np.sin(2 * math.pi * (np.arange(n_frames) / rng.uniform(9, 20) + rng.random())))


def _stops(rng: Rng, floor: FreeFloor, rays: RoomRays, positions_m: ArrayF64, height_m: float) -> ArrayF64:
    """(P + 1, 2) free places: from all but one a position can be looked at where that is possible, that one is far."""
    stops = [_stop(rng, floor, rays, position, height_m) for position in positions_m]
    gaps = np.linalg.norm(floor.places_m[:, None] - np.array(stops)[None], axis=-1).min(axis=1)
    return np.insert(np.array(stops), len(stops) // 2, floor.places_m[int(gaps.argmax())], axis=0)


def _stop(rng: Rng, floor: FreeFloor, rays: RoomRays, position: ArrayF64, height_m: float) -> ArrayF64:
    places = floor.places_m
    gaps = np.linalg.norm(places - position[:2], axis=1)
    near = places[(gaps > LOOK_FROM_M[0]) & (gaps < LOOK_FROM_M[1])]
    for place in rng.permutation(near)[:12]:
        if rays.reach(np.array((*place, height_m)), position[None]).all():
            return np.asarray(place)
    return np.asarray(places[int(np.abs(gaps - sum(LOOK_FROM_M) / 2).argmin())])


def _goals(rng: Rng, order: list[int]) -> Iterator[Look | Sweep]:
    """What is looked at, without an end: after every two positions one turns around."""
    for i, place in enumerate(itertools.cycle(order), start=1):
        yield Look(place, float(rng.normal(0, 7)), float(rng.normal(5, 5)))
        if i % 2 == 0:
            yield Sweep(float(rng.choice([-1.0, 1.0]) * rng.uniform(*SWEEP_DEG)), span(rng, 0, 2 * math.pi))


def _walked(
    rng: Rng, route: Route, heights_m: ArrayF64, positions_m: ArrayF64, order: list[int], fov_deg: float
) -> list[PhoneView]:
    """The frames of a walk along `route`, there and back again as long as it lasts."""
    speed_m = min(span(rng, *SPEED_M_S), route.length_m / 2)
    hand_deg = _hand(rng, len(heights_m))
    goals = _goals(rng, order)
    goal, n_frames, n_reached, swept_deg, walked_m, pace = next(goals), 0, 0, 0.0, 0.0, 1.0
    gaze: tuple[float, float] | None = None
    frames = []
    for frame, height_m in enumerate(heights_m.tolist()):
        place = np.array((*route.at(_there_and_back(walked_m, route.length_m)), height_m))
        wanted = _wanted(goal, gaze, place, positions_m, frame)
        gaze, turned_deg = (wanted, 0.0) if gaze is None else _followed(gaze, wanted)
        yaw, pitch, roll = np.radians(np.array((*gaze, 0.0)) + hand_deg[frame])
        frames.append(PhoneView(hand_held_pose(tuple(place.tolist()), yaw, pitch, roll), fov_deg))
        off_deg = max(abs(_turn_between(gaze[0], wanted[0])), abs(gaze[1] - wanted[1]))
        n_frames, n_reached, swept_deg = n_frames + 1, n_reached + (off_deg < REACHED_DEG), swept_deg + abs(turned_deg)
        is_looked_at = n_reached >= DWELL_FRAMES or n_frames >= PATIENCE_FRAMES
        if is_looked_at if isinstance(goal, Look) else swept_deg >= abs(goal.turn_deg):
            goal, n_frames, n_reached, swept_deg = next(goals), 0, 0, 0.0
        pace = 0.5 * pace + 0.5 * (1.0 if isinstance(goal, Look) else STANDING_SPEED)
        walked_m += speed_m * pace
    return frames


def _hand(rng: Rng, n_frames: int) -> ArrayF64:
    """(F, 3) degrees of yaw, pitch and roll by which a hand is off, each frame much like the one before."""
    off: ArrayF64 = rng.normal(0, 1, (n_frames, 3)) * (1.5, 1.2, 2.0)
    for frame in range(1, n_frames):
        off[frame] += 0.6 * off[frame - 1]
    return off


def _there_and_back(walked_m: float, length_m: float) -> float:
    """Metres along a route of `length_m` after so many metres on it in both directions."""
    if length_m == 0:
        return 0.0
    rest = walked_m % (2 * length_m)
    return min(rest, 2 * length_m - rest)


def _wanted(
    goal: Look | Sweep, gaze: tuple[float, float] | None, place: ArrayF64, positions_m: ArrayF64, frame: int
) -> tuple[float, float]:
    if isinstance(goal, Look):
        ahead = positions_m[goal.place] - place
        yaw = math.degrees(math.atan2(-ahead[0], ahead[1])) + goal.aside_deg
        pitch = math.degrees(math.atan2(ahead[2], float(np.hypot(*ahead[:2])))) + goal.above_deg
        return yaw, min(max(pitch, LOWEST_LOOK_DEG), HIGHEST_PITCH_DEG)
    assert gaze is not None
    middle = (LOWEST_PITCH_DEG + HIGHEST_PITCH_DEG) / 2
    wave = math.sin(2 * math.pi * frame / 7 + goal.phase)
    # Eased, this turns by MAX_TURN_DEG.
    ahead_deg = math.copysign(MAX_TURN_DEG / EASE, goal.turn_deg)
    return gaze[0] + ahead_deg, middle + wave * (HIGHEST_PITCH_DEG - middle)


def _followed(gaze: tuple[float, float], wanted: tuple[float, float]) -> tuple[tuple[float, float], float]:
    """Yaw and pitch one frame later, and the yaw turned."""
    turn = EASE * _turn_between(gaze[0], wanted[0])
    tilt = EASE * (wanted[1] - gaze[1])
    turn, tilt = (min(max(by, -most), most) for by, most in ((turn, MAX_TURN_DEG), (tilt, MAX_TILT_DEG)))
    return (gaze[0] + turn, gaze[1] + tilt), turn


def _turn_between(start_deg: float, end_deg: float) -> float:
    """The shorter turn from one yaw to another, -180 to 180."""
    return (end_deg - start_deg + 180) % 360 - 180
