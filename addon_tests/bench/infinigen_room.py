"""A room of Infinigen, made one that estimators are judged by: places for objects, and a walk that looks at them.

    python addon_tests/bench/infinigen_room.py OUT/scene.blend ROOM.blend --room living-room --seed 1
    xihe dataset scene ROOM.blend --out FOLDER --at place_0,place_1,place_2,place_3

The first file is what Infinigen 1.15 leaves, in an environment of its own. Nobody here made these rooms and nothing is
trained on them. Infinigen's placeholders, which its own rendering hides, are removed. Places float 5 to 10 cm above
whatever faces up in the room; the phone stands where nothing is near it and jumps between views, most of them pointed
at a place that it sees. Exit 1 with a line if the room offers too few of either.
"""

from __future__ import annotations

import sys

import bpy
import numpy as np
from given import given
from mathutils import Matrix

from xihe_blender.lab.rooms.views import (
    MAX_BEHIND_SHARE,
    MIN_CLEARANCE_M,
    POSITION_SPACING_M,
    PhoneView,
    RoomRays,
    hand_held_pose,
    sees_something,
)

N_PLACES, N_VIEWS, TRIES = 4, 12, 4000
FOV_DEG = 66.0
HIGHEST_M, HELD_M, EDGE_M = 1.4, (1.0, 1.7), 0.3
PLACEHOLDERS = ("placeholders", "assets", "door_base_elements")


def remove_placeholders() -> None:
    """What Infinigen only plans with, and what it keeps to copy from."""
    for collection in list(bpy.data.collections):
        if collection.name.startswith(PLACEHOLDERS):
            for thing in list(collection.all_objects):
                bpy.data.objects.remove(thing)
            bpy.data.collections.remove(collection)


def floor_of(room: str) -> tuple[np.ndarray, float]:
    """(2, 2) lowest and highest x and y of the floor of the first room of that kind, and its height."""
    floors = [o for o in bpy.data.objects if o.name.startswith(room) and o.name.endswith(".floor")]
    if not floors:
        known = sorted(o.name for o in bpy.data.objects if o.name.endswith(".floor"))
        sys.exit(f"no floor of a room {room!r}; there are {', '.join(known)}")
    corners = np.array([floors[0].matrix_world @ vertex.co for vertex in floors[0].data.vertices])
    return np.array([corners[:, :2].min(0), corners[:, :2].max(0)]), float(corners[:, 2].max())


def find_places(rng: np.random.Generator, rays: RoomRays, area: np.ndarray, floor_m: float) -> np.ndarray:
    """(4, 3) half of them, if there are any, above furniture."""
    found: list[np.ndarray] = []
    for attempt in range(TRIES):
        x, y = rng.uniform(area[0] + EDGE_M, area[1] - EDGE_M)
        below = rays.floor_below(x, y, floor_m + HIGHEST_M)
        is_raised = below is not None and below > floor_m + 0.25
        if below is None or below < floor_m - 0.05 or (not is_raised and len(found) < 2 and attempt < TRIES // 2):
            continue
        place = np.array([x, y, below + rng.uniform(0.05, 0.1)])
        distances, behind = rays.cast_around(place, 128)
        is_apart = all(np.linalg.norm(place - other) > POSITION_SPACING_M for other in found)
        if is_apart and distances.min() > MIN_CLEARANCE_M and behind.mean() < MAX_BEHIND_SHARE:
            found.append(place)
        if len(found) == N_PLACES:
            return np.array(found)
    sys.exit(f"only {len(found)} of {N_PLACES} places found: take another room or seed")


def find_views(rng: np.random.Generator, rays: RoomRays, area: np.ndarray, floor_m: float, places: np.ndarray) -> list:
    """Poses (4, 4) of the phone, each of which sees the place that it is pointed at."""
    found: list[np.ndarray] = []
    for attempt in range(TRIES):
        stand = np.array([*rng.uniform(area[0] + EDGE_M, area[1] - EDGE_M), floor_m + rng.uniform(*HELD_M)])
        gap = places[len(found) % len(places)] - stand
        ahead = float(np.hypot(*gap[:2]))
        if not 0.5 < ahead < 4.5 or not rays.reach(stand, stand[None] + gap)[0]:
            continue
        yaw = np.arctan2(-gap[0], gap[1]) + np.radians(rng.normal(0, 11))
        pitch = np.clip(np.arctan2(gap[2], ahead) + np.radians(rng.normal(6, 8)), -1.1, 0.5)
        pose = hand_held_pose(tuple(stand), float(yaw), float(pitch), float(np.radians(rng.normal(0, 4))))
        if sees_something(rays, PhoneView(pose, FOV_DEG), 1.1 - 0.6 * attempt / TRIES):
            found.append(pose)
        if len(found) == N_VIEWS:
            return found
    sys.exit(f"only {len(found)} of {N_VIEWS} views found: take another room or seed")


def main() -> None:
    asked = given(__doc__, "scene", "out", room=str, seed=0)
    bpy.ops.wm.open_mainfile(filepath=str(asked.scene))
    remove_placeholders()
    scene, rng = bpy.context.scene, np.random.default_rng(asked.seed)
    area, floor_m = floor_of(asked.room)
    rays = RoomRays.of(scene)
    places = find_places(rng, rays, area, floor_m)
    poses = find_views(rng, rays, area, floor_m, places)
    for i, place in enumerate(places):
        empty = bpy.data.objects.new(f"place_{i}", None)
        scene.collection.objects.link(empty)
        empty.location = place
    phone = bpy.data.objects.new("Phone", bpy.data.cameras.new("Phone"))
    phone.data.angle = np.radians(FOV_DEG)
    phone.rotation_mode = "QUATERNION"
    scene.collection.objects.link(phone)
    scene.camera = phone
    scene.frame_start, scene.frame_end, scene.frame_step = 1, N_VIEWS, 1
    for frame, pose in enumerate(poses, start=1):
        phone.matrix_world = Matrix(pose.tolist())
        phone.keyframe_insert("location", frame=frame)
        phone.keyframe_insert("rotation_quaternion", frame=frame)
    bpy.ops.wm.save_as_mainfile(filepath=str(asked.out.resolve()), copy=True, compress=True)


if __name__ == "__main__":
    main()
