"""Views of the phone and places of virtual objects: both by trial, judged by rays cast in the room.

A phone is held 1.0 to 1.8 m high, yaw free, pitch and roll like a hand's, most often pointed at a place where an object
stands. A placement position floats 5 to 10 cm above a surface that faces up. Neither may be inside a thing: no ray from
it may end soon, and few may meet a surface from behind.

Frames: world, metres. Rejected: testing the inside by parity of crossings, since curtains, leaves and shades are open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector

from xihe_blender.lab.rooms.draws import Rng, draw_point, one_of, span
from xihe_blender.lab.rooms.outline import Rect
from xihe_blender.lab.rooms.room_data import Room, Sun
from xihenet.records import ArrayBool, ArrayF64
from xihenet.sphere import AnchorLattice

N_VIEWS, N_POSITIONS = 5, 4
N_SUNLIT = 2  # Of the positions, where the sun shines in and reaches places for them: chance finds one in fifty
N_BY_LAMP = 1  # The last of the positions, where a lamp is lit and a surface is near it
BY_LAMP_M = 0.6  # How far, across, a position by a lamp may be from it
VIEW_TRIES, POSITION_TRIES = 300, 300
MIN_CLEARANCE_M = 0.035  # Nearer than this nothing may be to a position: the surface below is 5 cm away at least
PHONE_CLEARANCE_M = 0.25
MAX_BEHIND_SHARE = 0.12
POSITION_SPACING_M = 0.35
N_CLEARANCE_RAYS, N_PHONE_RAYS = 128, 48


class RoomTooFull(ValueError):
    """A room offers too few places for the phone or for virtual objects."""


@dataclass(frozen=True)
class RoomRays:
    """Casts rays in a scene that stays as it is."""

    scene: bpy.types.Scene
    depsgraph: bpy.types.Depsgraph

    @classmethod
    def of(cls, scene: bpy.types.Scene) -> RoomRays:
        layer = scene.view_layers[0]
        layer.update()
        return cls(scene, layer.depsgraph)

    def cast(self, origin: ArrayF64, directions: ArrayF64) -> tuple[ArrayF64, ArrayBool]:
        """Distances (D,) along unit directions (D, 3), infinite for none, and whether a surface was met from behind."""
        distances = np.full(len(directions), np.inf)
        from_behind = np.zeros(len(directions), bool)
        start = Vector(origin.tolist())
        for i, direction in enumerate(directions.tolist()):
            hit, place, normal, *_ = self.scene.ray_cast(self.depsgraph, start, direction)
            if hit:
                distances[i] = (place - start).length
                from_behind[i] = normal.dot(direction) > 0
        return distances, from_behind

    def cast_around(self, origin: ArrayF64, n_rays: int) -> tuple[ArrayF64, ArrayBool]:
        """As `cast`, evenly in all directions."""
        return self.cast(origin, AnchorLattice(n_rays).directions.astype(np.float64))

    def reach(self, place_m: ArrayF64, positions_m: ArrayF64) -> ArrayBool:
        """(P,) bool: nothing stands between a place (3,) and positions (P, 3)."""
        gaps = positions_m - place_m
        distances = np.linalg.norm(gaps, axis=1)
        return np.asarray(self.cast(place_m, gaps / distances[:, None])[0] > distances)

    def see(self, place_m: ArrayF64, sun: Sun) -> bool:
        """Whether nothing stands between a place (3,) and the sun."""
        return bool(np.isinf(self.cast(place_m, np.array([sun.towards]))[0][0]))

    def floor_below(self, x: float, y: float, from_z: float) -> float | None:
        """Height of the surface below a point, or None if it does not face up."""
        hit, place, normal, *_ = self.scene.ray_cast(self.depsgraph, (x, y, from_z), (0.0, 0.0, -1.0))
        return float(place.z) if hit and normal.z > 0.92 else None


def sample_positions(rng: Rng, room: Room, rays: RoomRays) -> ArrayF64:
    """(N_POSITIONS, 3) placement positions, half of them over furniture. RoomTooFull if there are not as many.

    The first N_SUNLIT of them are in the sun and the last N_BY_LAMP by a lit lamp, where half of the tries find such.
    """
    found: list[ArrayF64] = []
    pieces = [p for p in room.pieces if p.z < 0.1 and 0.2 < p.top_m < 1.25]
    sun, lit = room.daylight.sun, [lamp for lamp in room.lamps if lamp.watts > 0]
    for n_tried in range(POSITION_TRIES):
        has_tries = n_tried < POSITION_TRIES // 2
        is_over_a_piece = pieces and rng.random() < 0.6
        area = one_of(rng, pieces).footprint if is_over_a_piece else room.outline.bounds.grown(-0.1)
        if lit and has_tries and len(found) >= N_POSITIONS - N_BY_LAMP:
            lamp = one_of(rng, lit)
            area = Rect.around((lamp.x, lamp.y), (2 * BY_LAMP_M, 2 * BY_LAMP_M))
        position = _draw_position(rng, room, rays, area)
        if position is None or any(np.linalg.norm(position - other) < POSITION_SPACING_M for other in found):
            continue
        if sun is not None and has_tries and len(found) < N_SUNLIT and not rays.see(position, sun):
            continue
        distances, from_behind = rays.cast_around(position, N_CLEARANCE_RAYS)
        if distances.min() > MIN_CLEARANCE_M and from_behind.mean() < MAX_BEHIND_SHARE:
            found.append(position)
        if len(found) == N_POSITIONS:
            return np.array(found)
    raise RoomTooFull(f"only {len(found)} of {N_POSITIONS} placement positions found")


def _draw_position(rng: Rng, room: Room, rays: RoomRays, area: Rect) -> ArrayF64 | None:
    """A point 5 to 10 cm above whatever is highest below 1.4 m at a random place of `area`, or None."""
    x, y = draw_point(rng, area)
    lift = span(rng, 0.05, 0.1)
    if not room.outline.holds_rect(Rect.around((x, y), (0.12, 0.12))):
        return None
    surface = rays.floor_below(x, y, min(1.4, room.ceiling_at((x, y)) - 0.1))
    return None if surface is None else np.array([x, y, surface + lift])


@dataclass(frozen=True, eq=False)
class PhoneView:
    """A pose (4, 4) world_from_camera and the field of view across the picture."""

    world_from_camera: ArrayF64
    fov_deg: float

    @property
    def place_m(self) -> ArrayF64:
        """(3,) where the phone is."""
        return self.world_from_camera[:3, 3]


def sample_views(
    rng: Rng, room: Room, rays: RoomRays, positions_m: ArrayF64, n_views: int = N_VIEWS
) -> list[PhoneView]:
    """Views of which each position has one that is pointed at it, and of the others every second; the last is free.

    RoomTooFull if there are not as many.
    """
    fov_deg = span(rng, 60, 72)
    views: list[PhoneView] = []
    n_tries = VIEW_TRIES * n_views // N_VIEWS
    for attempt in range(n_tries):
        is_pointed = len(views) < N_POSITIONS or (len(views) % 2 and len(views) < n_views - 1)
        target = positions_m[len(views) % len(positions_m)] if is_pointed else None
        view = _draw_view(rng, room, target, fov_deg)
        # A small room has no place from which all is far away: ask for less as the tries go on.
        if view is not None and sees_something(rays, view, 1.1 - 0.6 * attempt / n_tries):
            views.append(view)
        if len(views) == n_views:
            return views
    raise RoomTooFull(f"only {len(views)} of {n_views} views found")


def _draw_view(rng: Rng, room: Room, target: ArrayF64 | None, fov_deg: float) -> PhoneView | None:
    """A hand-held pose somewhere in the room, or None where there is no room for it."""
    area = room.outline.bounds.grown(-PHONE_CLEARANCE_M)
    if area.x1 <= area.x0 or area.y1 <= area.y0:
        return None
    x, y = draw_point(rng, area)
    height = span(rng, 1.0, 1.8)
    yaw, pitch = span(rng, 0, 2 * math.pi), math.radians(float(rng.normal(-18, 12)))
    roll = math.radians(float(rng.normal(0, 4)))
    if target is not None:
        ahead, below = target[:2] - (x, y), target[2] - height
        if not 0.5 < float(np.hypot(*ahead)) < 4.5:
            return None
        yaw = math.atan2(-ahead[0], ahead[1]) + math.radians(float(rng.normal(0, 11)))
        pitch = math.atan2(below, float(np.hypot(*ahead))) + math.radians(float(rng.normal(6, 8)))
    if not room.outline.holds((x, y)) or height > room.ceiling_at((x, y)) - 0.15:
        return None
    near = [piece for piece in room.pieces if piece.footprint.grown(0.08).holds((x, y))]
    if any(piece.z - 0.1 < height < piece.top_m + 0.2 for piece in near):
        return None
    return PhoneView(hand_held_pose((x, y, height), yaw, min(max(pitch, -1.1), 0.5), roll), fov_deg)


def hand_held_pose(place: tuple[float, float, float], yaw: float, pitch: float, roll: float) -> ArrayF64:
    """(4, 4) world_from_camera. Radians: yaw anticlockwise from +Y, pitch up from the horizon, roll about the view."""
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    c, s = math.cos(math.pi / 2 + pitch), math.sin(math.pi / 2 + pitch)
    tilt = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    c, s = math.cos(roll), math.sin(roll)
    pose = np.eye(4)
    pose[:3, :3] = turn @ tilt @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    pose[:3, 3] = place
    return pose


def sees_something(rays: RoomRays, view: PhoneView, median_m: float) -> bool:
    """Whether the phone is free of things and its picture is not filled by something close."""
    around, behind = rays.cast_around(view.place_m, N_PHONE_RAYS)
    if around.min() < PHONE_CLEARANCE_M or behind.mean() > MAX_BEHIND_SHARE:
        return False
    slope = math.tan(math.radians(view.fov_deg) / 2)
    u, v = np.meshgrid(np.linspace(-1, 1, 7) * slope, np.linspace(-0.75, 0.75, 5) * slope)
    directions = np.stack([u.ravel(), v.ravel(), np.full(u.size, -1.0)], -1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distances, _ = rays.cast(view.place_m, directions @ view.world_from_camera[:3, :3].T)
    return bool(np.median(distances) > median_m and (distances < 0.4).mean() < 0.1)
