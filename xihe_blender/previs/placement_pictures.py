"""The pictures of a placement map: the room from above and through the phone, surfaces in the colour of their error.

The room is grey and as bright as it takes to see it, so that colour means the map alone. What is neither near a place
nor known stays grey. Places in free air have no surface to colour: they are squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xihe_blender.io.outputs import write_picture
from xihe_blender.io.placement_results import N_EXTREMES, PlacementResults, best_first, error_range
from xihe_blender.previs.room_from_above import WIDTH_PX, RoomFromAbove
from xihenet.camera import project_points, unproject_frame, valid_plane_depth
from xihenet.colour import LUMINANCE
from xihenet.records import ArrayF32, ArrayF64, ArrayInt, ArrayU8, RgbdFrame

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

    def paint(self, points: ArrayF64, srgb: ArrayF32 | ArrayF64, white: float) -> ArrayF64:
        """(P, 3), 0 to 255: points (P, 3) of a room of which `white` is the brightness of what is bright."""
        grey = np.minimum(srgb @ LUMINANCE / white, 1.0) * BRIGHT
        place, shade = self.place_of(points), SHADE + (1 - SHADE) * grey / BRIGHT
        room = np.repeat(grey[:, None], 3, axis=1)
        return np.where(place[:, None] < 0, room, self.colours[place] * shade[:, None])


def _white(srgb: ArrayF32 | ArrayF64) -> float:
    """The brightness of what is bright in (P, 3) sRGB-encoded colours."""
    return max(float(np.percentile(srgb @ LUMINANCE, WHITE_AT)) if len(srgb) else 1.0, 1e-3)


def _from_above(frames: Sequence[RgbdFrame], painter: Painter) -> ArrayU8:
    positions = painter.positions
    room = RoomFromAbove(frames, positions, AROUND_M, lambda p, srgb: painter.paint(p, srgb, _white(srgb)))
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
    painted = painter.paint(np.nan_to_num(clouds[best], nan=1e9, posinf=1e9, neginf=-1e9), srgb, _white(srgb))
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
