"""The camera, which unprojects: how do pixels become points in the world, and points become pixels?

A pinhole camera with separate focal lengths and any principal point (so lens shift and non-square pixels are covered),
exposure and the sRGB transfer. Row 0 is the top row and pixel centres lie at +0.5; the camera looks down -Z with +Y up,
so the sign of y flips here and nowhere else. The phone's ambient light sensor is here too: it only reads pictures.

Chosen: a point for every pixel, NaN where the sensor saw nothing, so that point i is pixel i in every stage. Rejected:
dropping invalid pixels, which costs a gather over the whole frame and hides how many there were. Not here: lens
distortion, rolling shutter. Paper: section 4.1.1, `GeneratePointCloud`.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from xihenet.colour import LINEAR_OF_CODE, linear_to_srgb
from xihenet.invalid import counted, left_out
from xihenet.openings import with_openings
from xihenet.records import (
    FLOAT32_TO_M,
    ArrayBool,
    ArrayF32,
    ArrayF64,
    ArrayInt,
    ArrayU8,
    FarPixels,
    PixelGrid,
    PointCloud,
    RgbdFrame,
)
from xihenet.records import Intrinsics as Intrinsics

DEFAULT_SIZE = 256, 192  # Of captures in pixels, as a phone's LiDAR sensor delivers depth
MISS_PLANE_DEPTH_M = 1e9  # At and beyond this a plane depth is a miss: Cycles writes 1e10 where no surface was hit
NEGLIGIBLE_M = 1e-6  # What rounding a camera's place to float32 costs stays below it within 16 m of the origin
BEHIND = 1.1  # A point at so many times the depth of what is seen there lies behind it: sensors err by less
THROUGH_FROM = 1.1  # Depth, times that of a point, from which there is nothing at the point
ENCODED_AT_ONCE = 2**18  # Values of a picture; all of one of 8192x8192 pixels together would take 10 GB
SMALLEST_VOLUME = 1e-12  # Of the box of a camera's axes of length near 1; flatter ones cannot be inverted


def valid_plane_depth(plane_depth_m: ArrayF32) -> ArrayBool:
    """Where a sensor saw a surface: finite, positive and nearer than a renderer's miss. Any shape; NaN is invalid."""
    return (plane_depth_m > 0) & (plane_depth_m < MISS_PLANE_DEPTH_M)


def sound_plane_depth(plane_depth_m: ArrayF32, radiance: ArrayF32 | None = None) -> tuple[ArrayF32, dict[str, int]]:
    """What a frame keeps of plane depth (H, W), and what is wrong with its pixels, for `RgbdFrame.invalid`.

    (H, W), 0 wherever there is no surface, and NaN where that or the radiance (H, W, 3) is NaN: a broken pixel says
    nothing of the light, and black is an answer. Negative and infinite colours are clamped later, and counted here.
    """
    valid = valid_plane_depth(plane_depth_m)
    invalid = _reasons_by_value(plane_depth_m, valid)
    says_nothing = np.isnan(plane_depth_m)
    if radiance is not None:
        is_broken = np.isnan(radiance).any(axis=-1)
        says_nothing |= is_broken
        invalid |= counted(colour_not_finite=np.count_nonzero(valid & is_broken))
        valid &= ~is_broken
        invalid |= counted(
            negative_colour=np.count_nonzero((radiance < 0).any(axis=-1) & valid),
            infinite_colour=np.count_nonzero(np.isposinf(radiance).any(axis=-1) & valid),
        )
    return np.where(valid, plane_depth_m, np.where(says_nothing, np.float32(np.nan), np.float32(0))), invalid


def invalid_pixels(frame: RgbdFrame) -> dict[str, int]:
    """How many pixels of `frame` give no point, by reason: in all those without a valid plane depth.

    First the reasons that whoever made the frame knows, `frame.invalid`; others are told by their values.
    """
    valid = valid_plane_depth(frame.plane_depth_m)
    n_left = valid.size - int(np.count_nonzero(valid))
    known = left_out(frame.invalid)
    by_value = _reasons_by_value(frame.plane_depth_m, valid) if n_left > sum(known.values()) else {}
    named: dict[str, int] = {}
    for reason, n in (*known.items(), *by_value.items()):
        more = min(n, n_left)
        named |= counted(**{reason: named.get(reason, 0) + more})
        n_left -= more
    return named


def _reasons_by_value(plane_depth_m: ArrayF32, valid: ArrayBool) -> dict[str, int]:
    """Reasons of all pixels that are not `valid`; a 0, which may stand for another reason, comes last."""
    refused = plane_depth_m[~valid]
    n_nan, n_missed = np.count_nonzero(np.isnan(refused)), np.count_nonzero(refused >= MISS_PLANE_DEPTH_M)
    return counted(not_finite=n_nan, no_surface=n_missed, no_distance=refused.size - n_nan - n_missed)


def unproject_frame(frame: RgbdFrame, *, reference_exposure: float | None = None) -> PointCloud:
    """Every pixel of `frame` as a coloured point: H * W points in row order, world frame, metres.

    Colours are decoded, multiplied by `reference_exposure / frame.exposure`, divided by the frame's white balance,
    clipped at 1 and encoded again; None leaves the frame's own exposure. ValueError for a reference that is not
    positive and finite. Pixels without a valid plane depth (0, negative, NaN, infinite, or a renderer's miss) still say
    what light comes from there, unless it is NaN. Beside surfaces they are an opening, such as a window, and their
    points lie in it, see `xihenet.openings`. The others are the `far` pixels of the cloud's grid; their points are NaN,
    as where the depth is NaN, and counted by reason. A frame without any valid plane depth has neither, since a sensor
    that sees nothing may be broken.

    float32 arithmetic: the error of a point is about 2e-7 of its distance from the camera plus that of storing it, 6e-8
    of its distance from the world's origin, or 1e-16 for a camera beyond FLOAT32_TO_M. A point is infinite or NaN where
    the camera's place, or the point as seen from there, is beyond the range of float32.
    """
    valid = valid_plane_depth(frame.plane_depth_m)
    depth_m = with_openings(frame.plane_depth_m, valid)
    points = _unprojected(frame, depth_m)
    gain = 1.0 if reference_exposure is None else reference_exposure / frame.exposure
    if frame.white_balance is not None:
        each = [_reencoded_bytes(gain / float(factor)) for factor in frame.white_balance]
        srgb = np.stack([table.take(frame.srgb_u8[..., channel]) for channel, table in enumerate(each)], axis=-1)
    elif gain == 1.0:  # The same bits as the table's, in a quarter of the time of asking it.
        srgb = np.divide(frame.srgb_u8, np.float32(255), dtype=np.float32)
    else:
        srgb = _reencoded_bytes(gain).take(frame.srgb_u8)
    height, width, camera_m = frame.intrinsics.height, frame.intrinsics.width, frame.world_from_camera[:3, 3]
    openings, invalid = None, invalid_pixels(frame)
    if depth_m is not frame.plane_depth_m:
        openings = np.flatnonzero(valid_plane_depth(depth_m) & ~valid)
        invalid = _without(invalid, len(openings))
    grid = PixelGrid(height, width, camera_m, _far_pixels(frame, depth_m), openings)
    return PointCloud(points.reshape(3, -1).T, srgb.reshape(-1, 3), invalid, grid)


def _without(invalid: dict[str, int], n_points: int) -> dict[str, int]:
    """Counts by reason, less `n_points` pixels that have a point after all; those that may be NaN come last."""
    left = dict(invalid)
    for reason in sorted(invalid, key=lambda reason: reason in ("not_finite", "colour_not_finite")):
        n = min(left[reason], n_points)
        left[reason], n_points = left[reason] - n, n_points - n
    return counted(**left)


def _far_pixels(frame: RgbdFrame, depth_m: ArrayF32) -> FarPixels | None:
    """None where there are none."""
    valid = valid_plane_depth(depth_m)
    pixels = np.flatnonzero(~(valid | np.isnan(depth_m)))
    if not len(pixels) or not valid.any():
        return None
    row, column = np.divmod(pixels, frame.intrinsics.width)
    across, up = _ray_slopes(frame.intrinsics)
    rays = frame.world_from_camera[:3, :3] @ np.stack([across[column], up[row], np.full(len(row), -1.0)])
    return FarPixels(pixels, (rays / np.linalg.norm(rays, axis=0)).astype(np.float32))


def _unprojected(frame: RgbdFrame, depth_m: ArrayF32) -> ArrayF32 | ArrayF64:
    """(3, H, W): one contiguous plane per axis, since sampling reads the axes one at a time."""
    across, up = _ray_slopes(frame.intrinsics)
    seen = np.where(valid_plane_depth(depth_m), depth_m, np.float32(np.nan))
    points = np.empty((3, *seen.shape), np.float32)
    camera_m = frame.world_from_camera[:3, 3]
    # A camera that float32 cannot hold gives points that are not finite; sampling skips and counts them.
    with np.errstate(over="ignore", invalid="ignore"):
        rounded = camera_m.astype(np.float32)
        is_far = FLOAT32_TO_M < np.abs(rounded).max() < np.inf
        axes = frame.world_from_camera[:3, :3].astype(np.float32)
        for axis, plane in enumerate(points):
            np.add(across * axes[axis, 0], (up * axes[axis, 1] - axes[axis, 2])[:, None], out=plane)
            plane *= seen
            if is_far:
                continue
            # Far from the origin the camera's place is rounded by as much as the points are: once is enough.
            if abs(camera_m[axis] - rounded[axis]) > NEGLIGIBLE_M:
                plane += np.float32(camera_m[axis] - rounded[axis])
            plane += rounded[axis]
    return points + camera_m[:, None, None] if is_far else points


def project_points(
    points_m: ArrayLike, intrinsics: Intrinsics, world_from_camera: ArrayLike
) -> tuple[ArrayF64, ArrayF64]:
    """Where points of the world (P, 3), metres, appear in the image.

    ValueError for a wrong shape, or a (4, 4) that cannot be inverted: with an axis of length 0, or axes in one plane.

    Returns
    -------
    pixels : (P, 2) float64, from the top left corner of the image, pixel centres at +0.5; NaN in the camera's own
        plane and for points that are not finite
    plane_depth_m : (P,) float64, negative behind the camera (the pixel is then a mirror image: check the sign)
    """
    points = np.asarray(points_m, np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"project_points: expected points of shape (P, 3), got {points.shape}")
    pose = np.asarray(world_from_camera, np.float64)
    if pose.shape != (4, 4):
        raise ValueError(f"project_points: expected world_from_camera of shape (4, 4), got {pose.shape}")
    inverse = _inverse_3x3(pose[:3, :3])
    pixels = np.empty((len(points), 2))
    # Points that are not finite, or so far that float64 overflows, have no pixel: NaN or infinite says so.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        in_camera = (points - pose[:3, 3]) @ inverse.T
        plane_depth_m = -in_camera[:, 2]
        # Not `np.divide` with `where`, which takes several times as long.
        per_metre = 1.0 / plane_depth_m
        per_metre[plane_depth_m == 0] = np.nan
        pixels[:, 0] = intrinsics.cx + intrinsics.fx * in_camera[:, 0] * per_metre
        pixels[:, 1] = intrinsics.cy - intrinsics.fy * in_camera[:, 1] * per_metre
    return pixels, plane_depth_m


class PicturePart(NamedTuple):
    """A rectangle of whole pixels; `right` and `bottom` are the first that are no more of it."""

    left: int
    top: int
    right: int
    bottom: int


def part_around(
    points_m: ArrayLike, intrinsics: Intrinsics, world_from_camera: ArrayLike, margin_px: int = 0
) -> PicturePart | None:
    """The part of a picture that shows points (P, 3), one at least, world, metres, and `margin_px` around it.

    A part beside the picture has left = right or top = bottom. None where a point is not before the camera, or is not
    finite: what lies between may be anywhere.
    """
    pixels, plane_depth_m = project_points(points_m, intrinsics, world_from_camera)
    if not (np.isfinite(pixels).all() and (plane_depth_m > 0).all()):
        return None
    size = (intrinsics.width, intrinsics.height)
    left, top = np.clip(np.floor(pixels.min(axis=0)) - margin_px, 0, size).astype(int).tolist()
    right, bottom = np.clip(np.ceil(pixels.max(axis=0)) + margin_px, 0, size).astype(int).tolist()
    return PicturePart(left, top, right, bottom)


def _inverse_3x3(matrix: ArrayF64) -> ArrayF64:
    """By cross products. numpy.linalg.inv wakes BLAS threads for any size: 8 ms beside a busy renderer, this 0.05.

    Axes are brought near length 1 first, so that the scale of a camera neither overflows nor passes for flatness.
    """
    largest = np.abs(matrix).max(axis=0)
    if not (np.isfinite(largest).all() and (largest > 0).all()):
        raise ValueError("project_points: world_from_camera cannot be inverted; is the camera scaled to 0?")
    x, y, z = (matrix / largest).T
    across = np.array([_cross(y, z), _cross(z, x), _cross(x, y)])
    volume = float(np.dot(x, across[0]))
    if abs(volume) < SMALLEST_VOLUME:
        raise ValueError("project_points: world_from_camera cannot be inverted; its axes lie in one plane")
    return across / volume / largest[:, None]


def _cross(a: ArrayF64, b: ArrayF64) -> tuple[float, float, float]:
    """numpy.cross takes ten times as long for three numbers."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def in_view(points_m: ArrayLike, intrinsics: Intrinsics, world_from_camera: ArrayLike) -> ArrayBool:
    """(P,) bool: which points of the world lie inside the image and in front of the camera; occlusion is not judged."""
    return _is_inside(*project_points(points_m, intrinsics, world_from_camera), intrinsics)


def pixels_in_view(
    points_m: ArrayLike, intrinsics: Intrinsics, world_from_camera: ArrayLike
) -> tuple[ArrayInt, ArrayInt, ArrayF64]:
    """Points of the world (P, 3), metres, that a camera would see if nothing were in the way.

    Returns
    -------
    points, pixels : (K,) which points lie in the picture and before the camera, and `row * width + column` of each
    plane_depth_m : (K,) of each
    """
    pixels, plane_depth_m = project_points(points_m, intrinsics, world_from_camera)
    points = np.flatnonzero(_is_inside(pixels, plane_depth_m, intrinsics))
    column, row = pixels[points].astype(np.intp).T
    return points, row * intrinsics.width + column, plane_depth_m[points]


def _is_inside(pixels: ArrayF64, plane_depth_m: ArrayF64, intrinsics: Intrinsics) -> ArrayBool:
    x, y = pixels.T
    return (x >= 0) & (x < intrinsics.width) & (y >= 0) & (y < intrinsics.height) & (plane_depth_m > 0)


def behind_m(point_m: ArrayLike, frame: RgbdFrame) -> float:
    """How far a point of the world, (3,), lies behind the surface that its pixel shows, along the optical axis.

    0 where it does not, or by less than sensors err, where its pixel shows no surface, and out of view.
    """
    points_m = np.asarray(point_m, np.float64)[None]
    _, pixels, plane_depth_m = pixels_in_view(points_m, frame.intrinsics, frame.world_from_camera)
    if not len(pixels):
        return 0.0
    surface_m, own_m = float(frame.plane_depth_m.flat[pixels[0]]), float(plane_depth_m[0])
    return own_m - surface_m if surface_m > 0 and own_m > BEHIND * surface_m else 0.0


def sees_through(points_m: ArrayLike, frame: RgbdFrame) -> ArrayBool:
    """(P,) bool: at which points (P, 3) of the world there is nothing, since the frame sees surfaces behind them.

    All nine pixels about a point have to be clearly behind it, or an edge of the surface would not count. False where
    the frame does not look, something is in between, or one of the nine has no plane depth.
    """
    pixels, plane_depth_m = project_points(points_m, frame.intrinsics, frame.world_from_camera)
    height, width = frame.plane_depth_m.shape
    with np.errstate(invalid="ignore"):  # What lies behind the camera has no pixel.
        inside = ((pixels >= 1) & (pixels < [width - 1, height - 1])).all(axis=1) & (plane_depth_m > 0)
    looked_at = np.flatnonzero(inside)
    column, row = pixels[looked_at].astype(np.intp).T[..., None, None]
    around = np.arange(-1, 2)
    nearby_m = frame.plane_depth_m[row + around[:, None], column + around]
    limit_m = plane_depth_m[looked_at, None, None] * THROUGH_FROM
    result = np.zeros(len(inside), np.bool_)
    result[looked_at] = ((nearby_m > limit_m) & valid_plane_depth(nearby_m)).all(axis=(1, 2))
    return result


def encode_exposed(radiance: ArrayLike, exposure: float) -> ArrayU8:
    """8-bit sRGB of linear radiance as a phone delivers it: times `exposure`, clipped to [0, 1], encoded, rounded.

    Any shape with any values; infinite becomes 1, NaN 0 (a renderer's broken pixel is black, as it is on a screen).
    An exposure of 0 gives black; ValueError for one that is negative, infinite or NaN.
    """
    if not (np.isfinite(exposure) and exposure >= 0):
        raise ValueError(f"encode_exposed: expected a finite exposure >= 0, got {exposure}")
    light = np.asarray(radiance)
    encoded: ArrayU8 = np.empty(light.shape, np.uint8)
    values, codes = light.reshape(-1), encoded.reshape(-1)
    for start in range(0, len(values), ENCODED_AT_ONCE):
        finite = np.nan_to_num(values[start : start + ENCODED_AT_ONCE].astype(np.float64), posinf=1e30, neginf=0.0)
        with np.errstate(over="ignore"):  # What overflows is clipped in the next line.
            exposed = np.clip(finite * exposure, 0.0, 1.0)
        codes[start : start + ENCODED_AT_ONCE] = np.rint(linear_to_srgb(exposed) * 255.0)
    return encoded


def sensed_ambient(srgb_u8: ArrayU8, exposure: float) -> ArrayF64:
    """(3,) mean scene radiance of the phone's own picture (H, W, 3), clipped where the picture is.

    AR toolkits derive their ambient estimate from the camera's picture, so light beyond white is lost to it as well.
    """
    counts = np.stack([np.bincount(srgb_u8[..., channel].reshape(-1), minlength=256) for channel in range(3)])
    shares = counts / srgb_u8[..., 0].size
    return (shares * LINEAR_OF_CODE).sum(axis=1) / exposure


def pixel_rays(intrinsics: Intrinsics) -> ArrayF64:
    """(H, W, 3) the ray through each pixel, in camera axes, at plane depth 1."""
    across = (np.arange(intrinsics.width) + 0.5 - intrinsics.cx) / intrinsics.fx
    up = -(np.arange(intrinsics.height) + 0.5 - intrinsics.cy) / intrinsics.fy
    return np.stack(np.broadcast_arrays(across[None, :], up[:, None], np.float64(-1)), axis=-1)


@functools.lru_cache(maxsize=8)
def _ray_slopes(intrinsics: Intrinsics) -> tuple[ArrayF32, ArrayF32]:
    """x per column (W,) and y per row (H,) of the ray with plane depth 1 through each pixel centre, in the camera."""
    rays = pixel_rays(intrinsics).astype(np.float32)
    return rays[0, :, 0].copy(), rays[:, 0, 1].copy()


@functools.lru_cache(maxsize=64)
def _reencoded_bytes(gain: float) -> ArrayF32:
    """(256,) float32: the encoded colour of each byte after its light was multiplied by `gain` and clipped."""
    if not (np.isfinite(gain) and gain > 0):
        raise ValueError(f"unproject_frame: expected a positive, finite exposure, got a ratio of {gain}")
    return linear_to_srgb(LINEAR_OF_CODE * gain).astype(np.float32)
