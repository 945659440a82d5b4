"""Keys of what we animate: worlds, suns, cameras. Many at a time, since Blender's own way takes each by itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihenet.records import ArrayF64


def key_values(
    owner: bpy.types.ID, path: str, frames: Sequence[int], values: ArrayF64, *, is_held: bool = False
) -> None:
    """Key a property at `frames`, rising, with `values` (N, K), K of its elements or 1, linear between them.

    With `is_held` only between neighbours: else each holds until the next.
    """
    is_array = hasattr(getattr(owner, path), "__len__")
    setattr(owner, path, values[0].tolist() if is_array else float(values[0, 0]))
    owner.keyframe_insert(path, frame=frames[0])
    for curve in [curve for curve in f_curves(owner) if curve.data_path == path]:
        add_keys(curve, frames, values[:, curve.array_index])
        for point, after in zip(curve.keyframe_points, np.diff(frames, append=frames[-1]), strict=True):
            point.interpolation = "CONSTANT" if is_held and after > 1 else "LINEAR"


def add_keys(curve: bpy.types.FCurve, frames: Sequence[int], values: ArrayLike) -> None:
    """Give `curve`, which is keyed at the first of `frames` alone, its key (N,) at each of them, in order."""
    points = curve.keyframe_points
    points.add(len(frames) - 1)
    points.foreach_set("co", np.stack([frames, values], axis=1).astype(np.float32).ravel())
    curve.update()


def hold_keys(owner: bpy.types.ID) -> None:
    """Keep each keyed value of `owner` until its next key."""
    for curve in f_curves(owner):
        for point in curve.keyframe_points:
            point.interpolation = "CONSTANT"


def clear_keys(owner: bpy.types.ID) -> None:
    """Take away the keys of `owner`; its action stays, empty, for those that follow.

    An action that goes while a window is open may still be evaluated for a view or a render.
    """
    for curves in curve_lists(owner):
        for curve in list(curves):
            curves.remove(curve)


def remove_animation(owner: bpy.types.ID) -> None:
    """Take away the keys of `owner`, and their action if nothing else uses it."""
    action = owner.animation_data.action if owner.animation_data else None
    owner.animation_data_clear()
    if action is not None and action.users == 0:
        bpy.data.actions.remove(action)


def f_curves(owner: bpy.types.ID) -> list[bpy.types.FCurve]:
    """The F-curves that key `owner`, such as a world, a node tree, an object or a light."""
    return [curve for curves in curve_lists(owner) for curve in curves]


def curve_lists(owner: bpy.types.ID) -> list[Any]:
    """What holds the F-curves of `owner`: Blender 4.4 moved them into layers and slots, 5.0 left only those."""
    animation = owner.animation_data
    if animation is None or animation.action is None:
        return []
    action = animation.action
    # From 4.4 to 4.5 an action also lists the curves of its first slot, which may be another owner's.
    if not hasattr(action, "layers"):
        return [action.fcurves]
    bags = (strip.channelbag(animation.action_slot) for layer in action.layers for strip in layer.strips)
    return [bag.fcurves for bag in bags if bag is not None]
