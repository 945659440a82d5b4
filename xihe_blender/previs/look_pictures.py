"""The picture of the better path: the room from above with the camera path, and an arrow for each look."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xihe_blender.io.look_results import LookAway, LookResults
from xihe_blender.io.outputs import write_picture
from xihe_blender.previs.room_from_above import RoomFromAbove
from xihenet.records import ArrayF64, RgbdFrame

PATH, LOOK, OBJECT = (240.0, 240.0, 240.0), (255.0, 140.0, 0.0), (80.0, 200.0, 255.0)
DIMMED = 0.7
"""Of the room's own brightness, so that what is drawn stands out."""

ARROW_M = 0.9
"""Of an arrow that points along the floor; one that points up is shorter, as seen from above."""


def write_above(folder: Path, frames: Sequence[RgbdFrame], results: LookResults) -> Path:
    """`above.png`; its path."""
    path = folder / "pictures" / "above.png"
    cameras = np.array([frame.world_from_camera[:3, 3] for frame in frames])
    objects = np.array([place for one in results.objects for place in one.positions_m]).reshape(-1, 3)
    room = RoomFromAbove(frames, np.concatenate([cameras, objects]), ARROW_M, lambda _, srgb: 255 * DIMMED * srgb)
    for first, last in itertools.pairwise(cameras):
        room.line(first, last, PATH, 2)
    for camera in cameras:
        room.disc(camera, PATH, 3)
    for place in objects:
        room.disc(place, OBJECT, 6)
    for one in results.objects:
        if one.look is not None:
            _arrow(room, one.look)
    room.metre()
    write_picture(path, room.picture.round().astype(np.uint8))
    return path


def _arrow(room: RoomFromAbove, look: LookAway) -> None:
    start, along = np.array(look.place_m), np.array(look.direction)
    tip = start + ARROW_M * along
    room.line(start, tip, LOOK, 4)
    room.disc(start, LOOK, 6)
    for side in (-1, 1):
        room.line(tip, tip - 0.25 * ARROW_M * _turned(along, side), LOOK, 4)


def _turned(along: ArrayF64, side: int) -> ArrayF64:
    """`along` turned by 30 degrees about the vertical, as one side of an arrow's head."""
    c, s = np.cos(np.pi / 6), side * np.sin(np.pi / 6)
    turned: ArrayF64 = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ along
    return turned
