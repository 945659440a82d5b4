"""The inspection of a scene as Cycles would be given it, frame by frame, without rendering.

Chosen: a render engine of our own, registered for a moment, that looks instead of rendering. Blender hands it what it
hands Cycles: the dependency graph in render mode, with render visibility, excluded collections, instances, modifiers as
they render, geometry nodes, animation and drivers already worked out. Rejected: the view layer's own graph, which is
the viewport's (an object hidden in the viewport but not in renders is missing there), and rules of our own.

A look costs 10 to 30 ms per frame in the example scenes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import bpy

from xihe_blender.capture.render import RenderSettings, exclude_collection, render_scene, working_scene
from xihe_blender.errors import UserError
from xihe_blender.scene.state import scene_kept
from xihe_blender.scene.virtual_objects import virtual_collection

SCENE_NAME = "Xihe Effects"
ENGINE = "XIHE_INSPECTION"


class SceneInspection:
    """A working scene to be looked at, with the virtual objects until they are excluded; made by `open_inspection`."""

    def __init__(self, working: bpy.types.Scene, virtual: bpy.types.Collection | None) -> None:
        self.working, self.virtual = working, virtual
        self.exclude_virtual_objects(is_excluded=False)

    def look_at(self, frame: int, *looks: Callable[[bpy.types.Depsgraph], None]) -> None:
        """Call each of `looks` with the render dependency graph at `frame`, which is gone when this returns.

        UserError where Blender cannot evaluate the scene; what a look raises is raised here.
        """
        self.working.frame_current = frame
        failures: list[BaseException] = []

        class Inspection(bpy.types.RenderEngine):  # type: ignore[misc]
            bl_idname = ENGINE
            bl_label = "Xihe Inspection"

            def render(self, depsgraph: bpy.types.Depsgraph) -> None:
                try:
                    for look in looks:
                        look(depsgraph)
                except BaseException as error:  # noqa: BLE001 - Blender would print it and go on; it is raised below
                    failures.append(error)

        bpy.utils.register_class(Inspection)
        try:
            self.working.render.engine = ENGINE
            render_scene(self.working)
        except RuntimeError as error:
            raise UserError(f"Blender could not evaluate {self.working.name!r}: {str(error).strip()}") from error
        finally:
            self.working.render.engine = "CYCLES"
            bpy.utils.unregister_class(Inspection)
        if failures:
            # Its frames hold the graph, which is gone: a debugger that showed it would crash Blender.
            raise failures[0].with_traceback(None)

    def exclude_virtual_objects(self, *, is_excluded: bool) -> None:
        """Whether from now on there is only the room, as captures and light probes show it."""
        if self.virtual is not None:
            root = self.working.view_layers[0].layer_collection
            exclude_collection(root, self.virtual, is_excluded=is_excluded)


@contextlib.contextmanager
def open_inspection(scene: bpy.types.Scene) -> Iterator[SceneInspection]:
    """An inspection of `scene`, which stays as it is.

    The virtual objects are in it even where the user's view layer excludes them, since the comparison renders them.
    """
    with scene_kept(), contextlib.ExitStack() as stack:
        # Blender renders no scene without a camera. With its data the object goes too.
        data = bpy.data.cameras.new(SCENE_NAME)
        stack.callback(bpy.data.cameras.remove, data)
        working = stack.enter_context(working_scene(scene, SCENE_NAME, RenderSettings((4, 4), samples=1)))
        working.camera = working.camera or bpy.data.objects.new(SCENE_NAME, data)
        # A kept graph would outlive the engine that it belongs to.
        working.render.use_persistent_data = False
        yield SceneInspection(working, virtual_collection(scene))
