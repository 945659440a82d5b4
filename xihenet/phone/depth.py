"""Plane depth as a real range sensor measures it: range, noise, grain, steps and bleeding edges.

Each function takes a plane depth (H, W) in metres and one settings section and returns a new one, or the very array it
was given where that changes nothing. Pixels without a valid plane depth (0, negative, NaN, infinite, a renderer's miss)
come out with the same bytes: no effect makes up a surface where there was none.

Lengths in pixels belong to the sensor's own width; callers scale them (`pixel_scale`), so that a small preview shows
the same share of its width. Chosen: noise as a standard deviation that grows with distance, and a grain (the distance
in pixels over which it is smooth), since a phone's range sensor measures a few hundred dots and fills in the rest.
Rejected: white noise per pixel for all, which averages out over an anchor's pixels and so looks too harmless.
Not here: dropout (see `depth_dropout`), multipath, sunlight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.camera import MISS_PLANE_DEPTH_M, valid_plane_depth
from xihenet.phone.settings import Required, Section, SessionFacts, known, number
from xihenet.records import ArrayBool, ArrayF32, ArrayF64

FARTHEST_M = np.nextafter(np.float32(MISS_PLANE_DEPTH_M), np.float32(0))  # that is still a surface


@dataclass(frozen=True, kw_only=True)
class RangeLimits(Section):
    """The sensor answers from `nearest_m` to `farthest_m` of plane depth, both included."""

    nearest_m: float = number("m", 0.0, 100.0)
    farthest_m: float = number("m", 0.0, 1000.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.nearest_m >= self.farthest_m:
            raise ValueError(f"farthest_m: expected more than nearest_m ({self.nearest_m:g}), got {self.farthest_m:g}")

    def required_by(self, facts: SessionFacts) -> Required:
        farthest_m, nearest_m = (known(m, "how far the room goes") for m in (facts.farthest_m, facts.nearest_m))
        if farthest_m > self.farthest_m:
            return True, f"the room goes {farthest_m:.1f} m away, the sensor reaches {self.farthest_m:g} m"
        if nearest_m < self.nearest_m:
            return True, f"something is {nearest_m:.2f} m away, the sensor begins at {self.nearest_m:g} m"
        return False, f"everything lies within the sensor's {self.nearest_m:g} to {self.farthest_m:g} m"


@dataclass(frozen=True, kw_only=True)
class DistanceNoise(Section):
    """Standard deviation sigma_m + growth * max(z - growth_from_m, 0) ** growth_power, z in metres."""

    sigma_m: float = number("m", 0.0, 1.0)
    growth: float = number("m per m^power", 0.0, 1.0)
    growth_from_m: float = number("m", 0.0, 100.0)
    growth_power: float = number("", 1.0, 4.0)  # 1 for time of flight, 2 for triangulation
    grain_px: float = number("px", 0.0, 1000.0)  # over which it is smooth; 1 or less makes pixels independent
    shift_px: float = number("px", 0.0, 10.0)  # standard deviation of the place on the sensor that a pixel really reads

    def required_by(self, facts: SessionFacts) -> Required:
        beyond_m = max(known(facts.farthest_m, "how far the room goes") - self.growth_from_m, 0.0)
        if self.shift_px and known(facts.widest_step_m, "whether one object stands before another"):
            return True, "things stand before others, and at their edges the sensor mixes the two"
        return facts.moves_points(2 * (self.sigma_m + self.growth * beyond_m**self.growth_power), "the sensor's error")


@dataclass(frozen=True, kw_only=True)
class Quantisation(Section):
    """Plane depth comes in steps of `step_m`; 0 for none."""

    step_m: float = number("m", 0.0, 1.0)

    def required_by(self, facts: SessionFacts) -> Required:
        return facts.moves_points(self.step_m / 2, "rounding")


@dataclass(frozen=True, kw_only=True)
class EdgeBleeding(Section):
    """Where the plane depth spans more than `span_m` within `radius_px`, it is the mean over that window."""

    radius_px: float = number("px", 0.0, 100.0)
    span_m: float = number("m", 0.0, 100.0)

    def required_by(self, facts: SessionFacts) -> Required:
        return facts.has_step_over(self.span_m) if self.radius_px > 0 else (False, "the sensor keeps edges sharp")


def cut_range(plane_depth_m: ArrayF32, settings: RangeLimits) -> ArrayF32:
    """0 where the sensor does not reach; the rest, and what was invalid before, keeps its bytes."""
    beyond = (plane_depth_m < settings.nearest_m) | (plane_depth_m > settings.farthest_m)
    return cleared(plane_depth_m, beyond)


def cleared(plane_depth_m: ArrayF32, is_dropped: ArrayBool) -> ArrayF32:
    """0 at the valid pixels of `is_dropped`; the array itself if there are none."""
    lost = is_dropped & valid_plane_depth(plane_depth_m)
    return np.where(lost, np.float32(0), plane_depth_m) if lost.any() else plane_depth_m


def noise_sigma_m(plane_depth_m: ArrayF32, settings: DistanceNoise) -> ArrayF64:
    """Standard deviation at each plane depth, same shape, metres; 0 where the plane depth is invalid."""
    valid = valid_plane_depth(plane_depth_m)
    beyond_m = np.where(valid, plane_depth_m.astype(np.float64), 0.0) - settings.growth_from_m
    sigma_m = settings.sigma_m + settings.growth * np.maximum(beyond_m, 0.0) ** settings.growth_power
    return np.where(valid, sigma_m, 0.0)


def add_noise(
    plane_depth_m: ArrayF32, settings: DistanceNoise, rng: np.random.Generator, *, pixel_scale: float = 1.0
) -> ArrayF32:
    """Plane depth as the sensor measures it: each pixel reads a place nearby, with an error that grows with distance.

    A surface never comes nearer than half its true distance, nor as far as a miss: noise alone neither turns it behind
    the camera nor loses its depth. `pixel_scale` is the picture's width over the sensor's.
    """
    read_m = _shifted(plane_depth_m, settings.shift_px * pixel_scale, rng)
    sigma_m = noise_sigma_m(plane_depth_m, settings)
    if not sigma_m.any():
        return read_m
    error_m = sigma_m * grained_noise(plane_depth_m.shape, settings.grain_px * pixel_scale, rng)
    valid = valid_plane_depth(read_m)
    nearest_m = np.maximum(0.5 * np.where(valid, read_m, np.float32(0)), np.finfo(np.float32).smallest_subnormal)
    with np.errstate(invalid="ignore"):  # Readings that are none come back below as they were.
        noisy = np.clip(read_m + error_m, nearest_m, FARTHEST_M).astype(np.float32)
    return np.where(valid, noisy, plane_depth_m)


def grained_noise(shape: tuple[int, ...], grain_px: float, rng: np.random.Generator) -> ArrayF64:
    """(H, W) normal noise of standard deviation 1 at every pixel, smooth over `grain_px`.

    Independent values on a grid of that pitch, which lies at random, are interpolated bilinearly; dividing by the
    root of the summed squared weights keeps the standard deviation at 1 between the nodes too.
    """
    height, width = shape
    if grain_px <= 1.0:
        return rng.normal(size=(height, width))
    row, row_share = _split((np.arange(height) + 0.5) / grain_px + rng.random())
    column, column_share = _split((np.arange(width) + 0.5) / grain_px + rng.random())
    nodes = rng.normal(size=(int(row[-1]) + 2, int(column[-1]) + 2))
    along = _lerped(nodes[row], nodes[row + 1], row_share[:, None])
    return _lerped(along[:, column], along[:, column + 1], column_share[None, :])


def quantise(plane_depth_m: ArrayF32, settings: Quantisation) -> ArrayF32:
    """Plane depth rounded to the sensor's step; what is nearer than half a step keeps one step, so it stays valid."""
    if settings.step_m == 0:
        return plane_depth_m
    valid = valid_plane_depth(plane_depth_m)
    steps = np.rint(np.where(valid, plane_depth_m.astype(np.float64), 1.0) / settings.step_m)
    return np.where(valid, (np.maximum(steps, 1.0) * settings.step_m).astype(np.float32), plane_depth_m)


def bleed_edges(plane_depth_m: ArrayF32, settings: EdgeBleeding, *, pixel_scale: float = 1.0) -> ArrayF32:
    """Points that float between a near surface and the far one behind it, as a smoothed depth map has them.

    The window is 2 r + 1 pixels wide, r = radius_px * pixel_scale rounded, at least 1; its mean is over valid pixels.
    """
    if settings.radius_px == 0:
        return plane_depth_m
    radius = max(1, math.floor(settings.radius_px * pixel_scale + 0.5))
    valid = valid_plane_depth(plane_depth_m)
    is_edge = valid & (window_span_m(plane_depth_m, radius) > settings.span_m)
    if not is_edge.any():
        return plane_depth_m
    total = _over_window(np.where(valid, plane_depth_m, np.float32(0)).astype(np.float64), radius, np.add)
    n_valid = _over_window(valid.astype(np.float64), radius, np.add)
    mean_m = total / np.maximum(n_valid, 1.0)
    return np.where(is_edge, mean_m.astype(np.float32), plane_depth_m)


def window_span_m(plane_depth_m: ArrayF32, radius: int) -> ArrayF32:
    """(H, W) largest less smallest valid plane depth within `radius` pixels; 0 where none is valid."""
    valid = valid_plane_depth(plane_depth_m)
    highest = _over_window(np.where(valid, plane_depth_m, np.float32(-np.inf)), radius, np.maximum)
    lowest = _over_window(np.where(valid, plane_depth_m, np.float32(np.inf)), radius, np.minimum)
    seen = highest > -np.inf
    return np.subtract(highest, lowest, out=np.zeros_like(highest), where=seen)


def _over_window(values: NDArray[Any], radius: int, combine: np.ufunc) -> NDArray[Any]:
    """`combine` of all values within `radius`, one axis after the other."""
    for _ in range(2):
        result = values.copy()
        for shift in range(1, min(radius, len(values) - 1) + 1):
            combine(result[:-shift], values[shift:], out=result[:-shift])
            combine(result[shift:], values[:-shift], out=result[shift:])
        values = result.T
    return values


def _shifted(plane_depth_m: ArrayF32, shift_px: float, rng: np.random.Generator) -> ArrayF32:
    """Each pixel reads bilinearly at a random place nearby; where one of the four pixels there is invalid, its own."""
    if shift_px == 0:
        return plane_depth_m
    height, width = plane_depth_m.shape
    rows = np.arange(height)[:, None] + rng.normal(scale=shift_px, size=(height, width))
    columns = np.arange(width)[None, :] + rng.normal(scale=shift_px, size=(height, width))
    (row, down), (column, right) = _split(np.clip(rows, 0, height - 1)), _split(np.clip(columns, 0, width - 1))
    next_row, next_column = np.minimum(row + 1, height - 1), np.minimum(column + 1, width - 1)
    valid = valid_plane_depth(plane_depth_m)
    readable = valid & valid[row, column] & valid[row, next_column] & valid[next_row, column]
    readable &= valid[next_row, next_column]
    z = np.where(valid, plane_depth_m, np.float32(0)).astype(np.float64)
    upper = z[row, column] * (1 - right) + z[row, next_column] * right
    lower = z[next_row, column] * (1 - right) + z[next_row, next_column] * right
    read_m = (upper * (1 - down) + lower * down).astype(np.float32)
    return np.where(readable, read_m, plane_depth_m)


def _split(position: ArrayF64) -> tuple[NDArray[np.intp], ArrayF64]:
    """The whole place before each position >= 0, and the share towards the next."""
    whole = position.astype(np.intp)
    return whole, position - whole


def _lerped(before: ArrayF64, after: ArrayF64, share: ArrayF64) -> ArrayF64:
    """Between two independent normal values, scaled so that the standard deviation stays 1."""
    return (before * (1 - share) + after * share) / np.sqrt((1 - share) ** 2 + share**2)
