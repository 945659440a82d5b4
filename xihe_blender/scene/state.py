"""The state of the user's scene: what does rendering a copy of it change there, and how is it put back?

A working scene shares its objects with the user's. Blender's render operator writes the values of F-curves, NLA and
drivers at the rendered frame into those shared objects, materials and worlds. A user who has moved an animated object
without keying it would lose that, and everything else would stand as in the last frame rendered. So every animated
value is noted before and put back after. Rejected: going back to the user's frame, which puts back what is keyed only.

Rendering also makes an image data-block for its result; it goes if it was not there.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from typing import Any

import bpy

WORKING = "xihe_working"
"""Custom property of working scenes, by which those are found that an Undo or a saved file brought back.

It is the name of the scene that one is a copy of."""


def copied_scene(scene: bpy.types.Scene) -> bpy.types.Scene:
    """A copy of `scene` that shares its objects, in which nothing is animated but custom properties.

    Keys and drivers of its settings would undo what is set of the copy. For `remove_copied_scene`.
    """
    copy = scene.copy()
    animation = copy.animation_data
    if animation is None or all(map(_is_custom, animated_paths(copy))):
        return copy
    for driver in [driver for driver in animation.drivers if not _is_custom(driver.data_path)]:
        animation.drivers.remove(driver)
    animation.use_tweak_mode = False  # In it actions cannot be changed.
    for holder in _with_an_action(copy):
        holder.action = holder.action.copy()
        holder.action[WORKING] = scene.name
        for curves in _curve_lists(holder.action):
            for curve in [curve for curve in curves if not _is_custom(curve.data_path)]:
                curves.remove(curve)
    return copy


def remove_copied_scene(copy: bpy.types.Scene) -> None:
    actions = {holder.action for holder in _with_an_action(copy) if WORKING in holder.action}
    bpy.data.scenes.remove(copy)
    for action in actions:
        bpy.data.actions.remove(action)
    look_through_own_cameras()


def look_through_own_cameras() -> None:
    """Have every 3D view look through the camera of the scene that its window shows.

    A copy that comes to a marker with another camera has all views look through that one.
    """
    for window in (window for manager in bpy.data.window_managers for window in manager.windows):
        views = [area.spaces.active for area in window.screen.areas if area.type == "VIEW_3D"]
        scene = window.scene
        following = [view for view in views if not view.use_local_camera and view.local_view is None]
        if scene.library is None and any(view.camera != scene.camera for view in following):
            scene.camera = scene.camera  # Views follow what is set, and what they look through cannot be set alone.


def users_name(scene: bpy.types.Scene) -> str:
    """The name of `scene`, or of the user's scene that it is a working copy of: one that the user knows."""
    name = scene.get(WORKING)
    return name if isinstance(name, str) else scene.name


def show_to_camera_alone(item: bpy.types.Object) -> None:
    """Have no other ray meet `item`, so that it lights nothing, shades nothing, and is reflected in nothing."""
    for ray in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(item, f"visible_{ray}", False)


@contextlib.contextmanager
def scene_kept() -> Iterator[None]:
    """Put back what renders during the block change in the open file, whatever happens in it."""
    before = animated_values()
    try:
        with no_render_result_left():
            yield
    finally:
        # A render leaves an evaluation pending, which would write over what is put back.
        evaluate_pending(layers_of(bpy.data.scenes))
        put_back(before)
        evaluate_pending(layers_of(bpy.data.scenes))


@contextlib.contextmanager
def no_render_result_left() -> Iterator[None]:
    """Take the image of a render's result away after the block, unless the file had one before."""
    had_result = any(image.type == "RENDER_RESULT" for image in bpy.data.images)
    try:
        yield
    finally:
        if not had_result:
            for image in [i for i in bpy.data.images if i.type == "RENDER_RESULT"]:
                bpy.data.images.remove(image)


def layers_of(scenes: Iterable[bpy.types.Scene]) -> list[bpy.types.ViewLayer]:
    return [layer for scene in scenes for layer in scene.view_layers]


def evaluate_pending(layers: Iterable[bpy.types.ViewLayer]) -> None:
    """Bring those of `layers` that are in use up to date, each at its own scene's frame."""
    for layer in layers:
        if layer.depsgraph is not None:
            layer.update()


def animated_values() -> dict[tuple[bpy.types.ID, str], Any]:
    """What every property of the file that an F-curve, an NLA strip or a driver moves has now, by owner and path."""
    values = {}
    for block in bpy.data.user_map():
        for owner in (block, getattr(block, "node_tree", None)):
            for path in animated_paths(owner) if owner is not None else ():
                # A path that leads nowhere belongs to something that was renamed or deleted.
                with contextlib.suppress(KeyError, ValueError):
                    values[owner, path] = _value(owner, path)
    return values


def put_back(values: dict[tuple[bpy.types.ID, str], Any]) -> None:
    """Set every property of `values` that has another value now; what has been deleted since is left out."""
    for (owner, path), value in values.items():
        with contextlib.suppress(AttributeError, KeyError, ReferenceError, ValueError):
            if _value(owner, path) != value:
                struct, key = _held(owner, path)
                if key is None:
                    setattr(struct, path.rpartition(".")[2], value)
                else:
                    struct[key] = value


def animated_paths(owner: bpy.types.ID) -> set[str]:
    """Of the properties of `owner` that an F-curve, an NLA strip or a driver moves."""
    animation = getattr(owner, "animation_data", None)
    if animation is None:
        return set()
    lists = [curves for holder in _with_an_action(owner) for curves in _curve_lists(holder.action)]
    return {curve.data_path for curves in (*lists, animation.drivers) for curve in curves}


def _with_an_action(owner: bpy.types.ID) -> list[Any]:
    """What of the animation of `owner` has an action: itself, and its strips in the NLA, those within others too."""
    animation = owner.animation_data
    if animation is None:
        return []
    strips = [strip for track in animation.nla_tracks for strip in track.strips]
    for strip in strips:
        strips += strip.strips
    return [holder for holder in (animation, *strips) if holder.action is not None]


def _curve_lists(action: bpy.types.Action) -> list[Any]:
    """All that hold F-curves of an action, those of other slots too. Blender 4.4 moved them into layers."""
    if not hasattr(action, "layers"):
        return [action.fcurves]
    strips = [strip for layer in action.layers for strip in layer.strips]
    return [bag.fcurves for strip in strips for bag in strip.channelbags]


def _is_custom(path: str) -> bool:
    return path.startswith("[")


def _value(owner: bpy.types.ID, path: str) -> Any:
    """A copy: vectors and arrays, which Blender hands out as views, become tuples."""
    struct, key = _held(owner, path)
    # A custom property read by its path would come out rounded to single precision.
    value = owner.path_resolve(path) if key is None else struct[key]
    return value if isinstance(value, str) or not hasattr(value, "__len__") else tuple(value)


def _held(owner: bpy.types.ID, path: str) -> tuple[Any, str | None]:
    """What holds the property at `path`, and the key if that is a custom property. ValueError if the path is broken."""
    is_custom = path.endswith('"]')
    holder, _, name = path[:-2].rpartition('["') if is_custom else path.rpartition(".")
    struct = owner.path_resolve(holder) if holder else owner
    return struct, bpy.utils.unescape_identifier(name) if is_custom else None
