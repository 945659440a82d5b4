"""How do we see the scene as Cycles would be given it, frame by frame, without rendering?

Chosen: a render engine of our own, registered for a moment, that looks instead of rendering. Blender hands it what it
hands Cycles: the dependency graph in render mode, with render visibility, excluded collections, instances, modifiers as
they render, geometry nodes, animation and drivers already worked out. Rejected: the view layer's own graph, which is
the viewport's (an object hidden in the viewport but not in renders is missing there), and rules of our own.

A look costs 10 to 30 ms per frame in the example scenes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

import bpy

from xihe_blender.capture.render import RenderSettings, exclude_collection, working_scene
from xihe_blender.errors import UserError
from xihe_blender.scene.state import scene_kept
from xihe_blender.scene.virtual_objects import virtual_collection

SCENE_NAME = "Xihe Effects"
ENGINE = "XIHE_INSPECTION"

LookAt = Callable[[bpy.types.Depsgraph], None]


def look_at_frames(
    scene: bpy.types.Scene, frames: Sequence[int], look_at: LookAt, *, is_room_only: bool = False
) -> None:
    """Call `look_at` with the render dependency graph of `scene` at each of `frames`.

    The virtual objects are in it even where the user's view layer excludes them, since the comparison renders them, but
    not with `is_room_only`: captures and light probes leave them out. What is evaluated is gone when `look_at` returns.
    UserError where Blender cannot evaluate the scene; what `look_at` raises is raised here.
    """
    with scene_kept(), _scene_with_a_camera(scene) as working:
        virtual = virtual_collection(scene)
        if virtual is not None:
            exclude_collection(working.view_layers[0].layer_collection, virtual, is_excluded=is_room_only)
        # A kept graph would outlive the engine that it belongs to.
        working.render.use_persistent_data = False
        for frame in frames:
            working.frame_current = frame
            _look_once(working, look_at)


@contextlib.contextmanager
def _scene_with_a_camera(scene: bpy.types.Scene) -> Iterator[bpy.types.Scene]:
    """A working scene; Blender renders none without a camera, so that one without gets one for the time being."""
    data = bpy.data.cameras.new(SCENE_NAME)
    stand_in = bpy.data.objects.new(SCENE_NAME, data)
    try:
        with working_scene(scene, SCENE_NAME, RenderSettings((4, 4), samples=1)) as working:
            working.camera = working.camera or stand_in
            yield working
    finally:
        bpy.data.objects.remove(stand_in)
        bpy.data.cameras.remove(data)


def _look_once(working: bpy.types.Scene, look_at: LookAt) -> None:
    failures: list[BaseException] = []

    class Inspection(bpy.types.RenderEngine):  # type: ignore[misc]
        bl_idname = ENGINE
        bl_label = "Xihe Inspection"

        def render(self, depsgraph: bpy.types.Depsgraph) -> None:
            try:
                look_at(depsgraph)
            except BaseException as error:  # noqa: BLE001 - Blender would print it and go on; it is raised below
                failures.append(error)

    bpy.utils.register_class(Inspection)
    try:
        working.render.engine = ENGINE
        with bpy.context.temp_override(scene=working):
            bpy.ops.render.render()
    except RuntimeError as error:
        raise UserError(f"Blender could not evaluate {working.name!r}: {str(error).strip()}") from error
    finally:
        working.render.engine = "CYCLES"
        bpy.utils.unregister_class(Inspection)
    if failures:
        # Its frames hold the graph, which is gone: a debugger that showed it would crash Blender.
        raise failures[0].with_traceback(None)
