"""Shadows compared: how close does the shadow of an object come to the real one, in the picture?

The captured frame is multiplied by what Cycles says of the catchers: the light on the surface with the object
over that without it (differential rendering, after Debevec, 1998). It counts in a ring around the objects, where there
is nothing of them but their shadow and the light that they throw on the room.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from xihenet.camera import unproject_frame, valid_plane_depth
from xihenet.camera_path.surfaces import Surface, clear_of, on_surfaces, points_within, surfaces_around
from xihenet.metrics import image_rmse
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, Intrinsics, RgbdFrame

REACH = 4.0
"""Half diagonals of an object's box, from its middle: so far its shadow is looked for."""

FARTHEST_M = 3.0

RING = 0.5
"""Width of the ring, in roots of the area that an object covers in the picture."""

BRIGHTEST = 1.2
"""By so much an object may brighten the room with the light that it throws on it; above that it is noise."""

COLOUR = 0.25
"""By so much the ratio of a channel may differ from that of the middle one. Spherical harmonics can be near 0, or
negative, in a channel and a direction, and a ratio to that says nothing."""

SHADOW_CHANNELS = tuple(f"Shadow Catcher.{channel}" for channel in "RGB")


def surfaces_seen(frames: Sequence[RgbdFrame], corners_m: ArrayF64) -> list[Surface]:
    """The surfaces around the object whose box has these corners (K, 3), world, metres, as far as `frames` show them.

    Where the object sinks into one a little, as measured ones are a little off, that is moved back below it.
    Empty where they show none: in the air, or where nobody has looked.
    """
    centre_m, reach_m = surroundings(corners_m)
    if not reach_m > 0:
        return []
    points_m, seen_from_m = points_within(frames, centre_m, reach_m)
    found = surfaces_around(points_m, seen_from_m, centre_m, reach_m)
    return [clear_of(surface, corners_m) for surface in found]


def surroundings(corners_m: ArrayF64) -> tuple[ArrayF64, float]:
    """Middle (3,) of an object whose box has these corners (K, 3), and how far from there its shadow is looked for."""
    low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
    return (low_m + high_m) / 2, min(REACH * float(np.linalg.norm(high_m - low_m)) / 2, FARTHEST_M)


def around_object(captured: RgbdFrame, middle_m: ArrayF64, reach_m: float) -> ArrayBool:
    """(H, W) which pixels of a frame show what is no farther than `reach_m` from `middle_m` (3,), world, metres."""
    is_valid = valid_plane_depth(captured.plane_depth_m)
    points_m = unproject_frame(captured).points_m.reshape(*is_valid.shape, 3).astype(np.float64)
    is_around: ArrayBool = is_valid & (np.linalg.norm(points_m - middle_m, axis=-1) < reach_m)
    return is_around


def touches_view(middle_m: ArrayF64, reach_m: float, k: Intrinsics, world_from_camera: ArrayF64) -> bool:
    """Whether a ball lies, at least in part, within the four sides of a camera's view and not all behind it.

    Some that are beside a corner of the view count as well.
    """
    middle = world_from_camera[:3, :3].T @ (middle_m - world_from_camera[:3, 3])
    sides = np.array(
        [[k.fx, 0, -k.cx], [-k.fx, 0, k.cx - k.width], [0, -k.fy, -k.cy], [0, k.fy, k.cy - k.height], [0, 0, -1.0]]
    )
    return bool((sides @ middle >= -reach_m * np.linalg.norm(sides, axis=1)).all())


def surfaces_in_view(captured: RgbdFrame, surfaces: Mapping[str, Sequence[Surface]]) -> dict[str, ArrayBool]:
    """By object, which pixels (H, W) of a frame show a surface that its shadow falls on; none for one without any."""
    is_valid = valid_plane_depth(captured.plane_depth_m)
    points_m = unproject_frame(captured).points_m.reshape(*is_valid.shape, 3).astype(np.float64)
    return {name: on_surfaces(points_m, found) & is_valid for name, found in surfaces.items() if found}


def shadow_of_all(layers: Mapping[str, Mapping[str, ArrayF32]], in_view: Mapping[str, ArrayBool]) -> ArrayF64 | float:
    """(H, W, 3) by what the captured frame is multiplied for the shadows of all objects; 1 where there is none.

    `layers` and `in_view`, as `surfaces_in_view` has it, are by object. Objects that hold out in a layer cast their
    shadow in it as well. So of the layers of all the darkest counts: in their product one shadow would be there as
    often as there are objects.
    """
    each = [shadow_on(layers[name], is_in_view) for name, is_in_view in in_view.items() if name in layers]
    if not each:
        return 1.0
    darkest: ArrayF64 = np.min(each, axis=0)
    return np.where(darkest < 1, darkest, np.max(each, axis=0))


def shadow_on(passes: Mapping[str, ArrayF32], is_in_view: ArrayBool) -> ArrayF64:
    """(H, W, 3) by what a layer with a catcher multiplies the captured frame: 1 where its surfaces are not in view."""
    ratio = np.ones((*is_in_view.shape, 3))
    # Where no catcher is rendered the denoiser makes up a ratio.
    is_seen = is_in_view & valid_plane_depth(passes["Depth.Z"]) & (passes["Combined.A"] < 1)
    caught = np.stack([passes[name] for name in SHADOW_CHANNELS], axis=-1).astype(np.float64)
    middle = np.median(caught, axis=-1, keepdims=True)
    caught = np.clip(caught, middle - COLOUR, middle + COLOUR).clip(0.0, BRIGHTEST)
    ratio[is_seen] = _without_speckles(caught, is_seen)
    return ratio


def _without_speckles(ratio: ArrayF64, is_seen: ArrayBool) -> ArrayF64:
    """(K, 3) of (H, W, 3) at the K pixels that are seen: the median of those among a pixel and its eight neighbours."""
    known = np.pad(np.where(is_seen[..., None] & np.isfinite(ratio), ratio, np.nan), ((1, 1), (1, 1), (0, 0)), "edge")
    around = np.lib.stride_tricks.sliding_window_view(known, (3, 3, 1))[is_seen].reshape(-1, 3, 9)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # Where Cycles gave no number at all.
        medians = np.nanmedian(around, axis=-1)
    smooth: ArrayF64 = np.nan_to_num(medians, nan=1.0)
    return smooth


def ring_around(weights: ArrayF64) -> ArrayBool:
    """(H, W) which pixels are around an object that covers `weights` (H, W) of each: near it, and none of it."""
    is_covered = weights > 0
    width_px = max(2, round(RING * float(np.sqrt(weights.sum()))))
    near = is_covered
    for axis in (0, 1):
        padded = np.pad(near, [(width_px,) * 2 if axis == own else (0, 0) for own in (0, 1)])
        near = np.lib.stride_tricks.sliding_window_view(padded, 2 * width_px + 1, axis=axis).any(axis=-1)
    ring: ArrayBool = near & ~is_covered if is_covered.any() else is_covered
    return ring


def ring_rmse(prediction: ArrayF64, ground_truth: ArrayF64, ring: ArrayBool) -> float | None:
    """Root mean square error of linear colour as a display shows it, clipped at white, in `ring`; None if empty."""
    return image_rmse(np.clip(prediction, 0.0, 1.0), np.clip(ground_truth, 0.0, 1.0), ring.astype(np.float64))
