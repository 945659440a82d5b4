"""The room below the phone, seen from above with +Y up, as its frames show it: a picture to draw on.

Points are painted in order of their height, as large as a few pixels, since they lie sparser than those.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from xihenet.camera import unproject_frame
from xihenet.records import ArrayF32, ArrayF64, ArrayInt, RgbdFrame

WIDTH_PX, HEIGHT_PX = 960, 720
EDGE_PX = 14
PIXELS_A_POINT = 3
"""Across: points lie sparser than its pixels."""


class RoomFromAbove:
    """`picture` (H, W, 3), 0 to 255, of the room around `positions` (K, 3) and `rim_m` beyond them; world, metres.

    `colours_of` gives the colours (P, 3), 0 to 255, of points (P, 3) that have (P, 3) sRGB in [0, 1].
    """

    def __init__(
        self,
        frames: Sequence[RgbdFrame],
        positions: ArrayF64,
        rim_m: float,
        colours_of: Callable[[ArrayF64, ArrayF32], ArrayF64],
    ) -> None:
        low, high = positions[:, :2].min(axis=0) - rim_m, positions[:, :2].max(axis=0) + rim_m
        self.pixels_per_m = float(min(WIDTH_PX / (high[0] - low[0]), HEIGHT_PX / (high[1] - low[1])))
        self.width, self.height = (max(1, int(side)) for side in (high - low) * self.pixels_per_m)
        self.low, self.high = low, high
        self.picture = np.full((self.height, self.width, 3), 24.0)
        points, srgb = self._below_the_phone(frames, float(positions[:, 2].max()))
        column, row = self.pixels(points)
        colours = colours_of(points, srgb)
        for down in range(PIXELS_A_POINT):
            for across in range(PIXELS_A_POINT):
                at = np.minimum(row + down, self.height - 1), np.minimum(column + across, self.width - 1)
                self.picture[at] = colours

    def _below_the_phone(self, frames: Sequence[RgbdFrame], highest_m: float) -> tuple[ArrayF64, ArrayF32]:
        """Points (P, 3) and their colours, the highest last; what is above the phone would hide the room."""
        clouds = [unproject_frame(frame) for frame in frames]
        eyes = float(np.mean([frame.world_from_camera[2, 3] for frame in frames]))
        points = np.concatenate([cloud.points_m for cloud in clouds]).astype(np.float64)
        srgb = np.concatenate([cloud.srgb for cloud in clouds])
        kept = np.isfinite(points).all(axis=1) & (points[:, 2] < max(eyes, highest_m))
        kept &= ((points[:, :2] > self.low) & (points[:, :2] < self.high)).all(axis=1)
        order = np.argsort(points[kept][:, 2], kind="stable")
        return points[kept][order], srgb[kept][order]

    def pixels(self, points: ArrayF64) -> tuple[ArrayInt, ArrayInt]:
        """Column and row of points (K, 3), at the rim for those beyond it."""
        column = ((points[:, 0] - self.low[0]) * self.pixels_per_m).astype(int).clip(0, self.width - 1)
        row = ((self.high[1] - points[:, 1]) * self.pixels_per_m).astype(int).clip(0, self.height - 1)
        return column, row

    def square(self, place: ArrayF64, colour: ArrayLike, half: int) -> None:
        """A square of 2 x `half` + 1 pixels."""
        (x,), (y,) = self.pixels(place[None])
        self.picture[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1] = colour

    def disc(self, place: ArrayF64, colour: ArrayLike, radius: float) -> None:
        (x,), (y,) = self.pixels(place[None])
        rows, columns = np.ogrid[: self.height, : self.width]
        self.picture[(rows - y) ** 2 + (columns - x) ** 2 <= radius**2] = colour

    def metre(self) -> None:
        """A bar of a metre at the lower left, white with a black rim."""
        bottom, length = self.height - EDGE_PX, int(self.pixels_per_m)
        self.picture[bottom - 8 : bottom, EDGE_PX - 3 : EDGE_PX + length + 3] = 0.0
        self.picture[bottom - 6 : bottom - 2, EDGE_PX : EDGE_PX + length] = 255.0

    def line(self, first: ArrayF64, last: ArrayF64, colour: ArrayLike, width: int) -> None:
        n = max(2, int(2 * self.pixels_per_m * np.linalg.norm((last - first)[:2])))
        for share in np.linspace(0, 1, n):
            self.square(first + share * (last - first), colour, width // 2)
