"""Live light: after a run, a virtual object that is moved or added gets the light of its new place.

The chain runs again on the frames that the run kept, for that object alone; nothing is rendered. In a window this
happens by itself, in a thread beside Blender's drawing, and goes on while an object is dragged: what is done is shown,
and the newest place comes next. The thread touches no data of Blender's. Scripts call `bpy.ops.xihe.update_light()`.

Objects that move along the path are not followed: where they are in each frame, a run finds out. What was rendered for
the old place, ground truth and reference light, stays as it is; the panel says so.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import FAILURES, Action, format_error
from xihe_blender.addon.modal_job import redraw
from xihe_blender.addon.polls import may_move
from xihe_blender.addon.properties import last_run_folder
from xihe_blender.addon.runs_folder import last_run, other_unit
from xihe_blender.apply.datablocks import LightOf, applied_worlds, lights_by_sh
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.scene.blend_file import room_of
from xihe_blender.scene.virtual_objects import virtual_objects

if TYPE_CHECKING:
    from xihe_blender.previs.kept_session import KeptSession
    from xihenet.camera_path.kept_path import FoundLight
    from xihenet.records import ArrayF64

LOOK_EVERY_S = 0.01
Places = Mapping[str, "Mapping[str, ArrayF64]"]
"""Estimation positions, (3,) in metres, by name, of virtual objects."""


class KeptFrames:
    """The session of the last run that light was estimated from, kept until another run is shown.

    One at a time: the window's own thread and another may ask for different runs.
    """

    def __init__(self) -> None:
        self._at_work = threading.Lock()
        self._kept: tuple[Path, KeptSession] | None = None

    def find_light(self, folder: Path, places: Places) -> dict[str, dict[str, FoundLight]]:
        """By virtual object and position, from the run in `folder`. UserError where its frames are gone."""
        from xihe_blender.previs.kept_session import open_kept_session

        with self._at_work:
            if self._kept is None or self._kept[0] != folder:
                self._kept = None
                self._kept = folder, run_blocking(open_kept_session(folder))
                run_blocking(self._kept[1].find_light({}))  # Loads the estimator.
            session = self._kept[1]
            return {name: run_blocking(session.find_light(of_object)) for name, of_object in places.items()}


_kept = KeptFrames()
_task: Task | None = None


def misplaced(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> dict[str, dict[str, ArrayF64]]:
    """The virtual objects that are not where their light is of, or have none: positions (3,) in metres by object.

    Those that may move along the path are left out; all are where the scene's unit is not that of the run.
    """
    from xihe_blender.scene.estimation_positions import all_box_corners_m, named_positions

    if other_unit(scene, last_run(scene.xihe.run_folder)):
        return {}
    worlds, found = applied_worlds(scene), {}
    objects = virtual_objects(scene)
    corners_m = all_box_corners_m(objects, depsgraph)
    for item in objects:
        known = LightOf.read(worlds[item.name]) if item.name in worlds else LightOf()
        if known is None or known.moves or may_move(item):
            continue
        try:
            places = named_positions(item, corners_m=corners_m[item])
        except UserError:  # A run would say why.
            continue
        if not known.is_of({name: place.tolist() for name, place in places.items()}):
            found[item.name] = places
    return found


def show_found(
    scene: bpy.types.Scene, folder: Path, places: Places, found: Mapping[str, Mapping[str, FoundLight]]
) -> None:
    """Light the virtual objects of `scene` that are still there with what was found."""
    from xihe_blender.addon.results_in_blender import show_found_light

    here, looks = {item.name for item in virtual_objects(scene)}, bpy.context.window_manager.xihe.looks
    for name in [name for name in places if name in here]:
        show_found_light(scene, folder, name, places[name], found[name])
        if name in looks:  # Where to look was asked for the place that it had.
            looks.remove(looks.find(name))


class XIHE_OT_update_light(Action, bpy.types.Operator):
    bl_idname = "xihe.update_light"
    bl_label = "Update Light"
    bl_description = "Estimate the light of objects that were moved since the run, from its frames; nothing is rendered"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.has_cycles, polls.has_last_run)

    def act(self, context: bpy.types.Context) -> str:
        scene = room_of(context.scene)
        folder, places = last_run_folder(scene), misplaced(scene, context.evaluated_depsgraph_get())
        if said := other_unit(scene, last_run(scene.xihe.run_folder)):
            raise UserError(said)
        if not places:
            return "Every object is where its light was estimated"
        show_found(scene, folder, places, _kept.find_light(folder, places))
        return f"Light estimated again: {', '.join(places)}"


# ---------------------------------------------------------------------------------------------------------- in a window


class Task(threading.Thread):
    """Finds the light of `places` from the run in `folder`; then there is `found`, or an `error`."""

    def __init__(self, folder: Path, places: Places) -> None:
        super().__init__(daemon=True)
        self.folder, self.places, self.kept = folder, places, _kept
        self.found: dict[str, dict[str, FoundLight]] | None = None
        self.error: Exception | None = None

    def run(self) -> None:
        try:
            # With what will show it: the window would wait for the import.
            import xihe_blender.addon.results_in_blender  # noqa: F401

            self.found = self.kept.find_light(self.folder, self.places)
        except Exception as error:  # noqa: BLE001 - raised in the main thread, which tells the user's from ours
            self.error = error


def follows(scene: bpy.types.Scene) -> bool:
    """Whether the objects of `scene` are followed now."""
    job, settings = bpy.context.window_manager.xihe, scene.xihe
    is_free = not (job.is_running and job.works_here) and not bpy.app.is_job_running("RENDER")
    is_wanted = settings.follows_objects and settings.run_folder
    return is_wanted and is_free and any(map(lights_by_sh, bpy.data.worlds))


def _look() -> float | None:
    """Show what the thread has found, and send it after what is misplaced still; called by Blender's timer."""
    global _task
    scene, window_manager = room_of(bpy.context.scene), bpy.context.window_manager
    if _task is not None and _task.is_alive():
        return LOOK_EVERY_S
    task, _task = _task, None
    if not follows(scene):
        return None
    try:
        if task is not None and task.folder == last_run_folder(scene):
            # Of frames that were only read ahead nobody needs to know yet that they are gone.
            if task.error is not None and task.places:
                raise task.error
            show_found(scene, task.folder, task.places, task.found or {})
            redraw(window_manager)
        is_at_work = _send_after(scene, bpy.context.evaluated_depsgraph_get())
    except FAILURES as error:
        window_manager.xihe.error = f"The light of moved objects is not updated: {format_error(error)}"
        redraw(window_manager)
        return None
    return LOOK_EVERY_S if is_at_work else None


def _send_after(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> bool:
    """Have a thread find the light of what is misplaced, if anything is."""
    global _task
    places = misplaced(scene, depsgraph)
    if places:
        _task = Task(last_run_folder(scene), places)
        _task.start()
    return bool(places)


def read_ahead(scene: bpy.types.Scene) -> None:
    """Read the last run's frames before anything in `scene` moves: the first light would wait a second for it."""
    global _task
    if not bpy.app.background and _task is None and follows(scene):
        _task = Task(last_run_folder(scene), {})
        _task.start()
        _begin()


def light_the_new(scene: bpy.types.Scene) -> str | None:
    """Find the light of virtual objects that have none where they are, for what shows all of them; else why not."""
    places = misplaced(scene, bpy.context.evaluated_depsgraph_get()) if follows(scene) else {}
    if not places:
        return None
    try:
        show_found(scene, last_run_folder(scene), places, _kept.find_light(last_run_folder(scene), places))
    except FAILURES as error:
        return f"{', '.join(places)} has no light where it is now: {format_error(error)}"
    return None


def _begin() -> None:
    if not bpy.app.timers.is_registered(_look):
        bpy.app.timers.register(_look, first_interval=0.0)


@bpy.app.handlers.persistent
def _scene_changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    room = room_of(scene)
    if not follows(room) or not any(
        # Of a collection: an object that is in it now, which moves nothing.
        isinstance(update.id, bpy.types.Object | bpy.types.Collection)
        and (update.is_updated_transform or update.is_updated_geometry)
        for update in depsgraph.updates
    ):
        return
    # Before the view is drawn, which the thread does not wait for.
    if _task is not None or _send_after(room, depsgraph):
        _begin()


@bpy.app.handlers.persistent
def _after_undo(*_: Any) -> None:
    if follows(room_of(bpy.context.scene)):
        _begin()


@bpy.app.handlers.persistent
def _before_render(*_: Any) -> None:
    """With Python 3.11 and older, Blender can crash where it renders while another thread runs Python."""
    if _task is not None:
        _task.join()


@bpy.app.handlers.persistent
def _after_load(*_: Any) -> None:
    global _task, _kept
    # A thread that is still at work goes on with the old ones, which go with it.
    _task, _kept = None, KeptFrames()


HANDLERS = {
    "depsgraph_update_post": _scene_changed,
    "undo_post": _after_undo,
    "redo_post": _after_undo,
    "render_init": _before_render,
    "load_post": _after_load,
}


def register() -> None:
    bpy.utils.register_class(XIHE_OT_update_light)


def unregister() -> None:
    if bpy.app.timers.is_registered(_look):
        bpy.app.timers.unregister(_look)
    _after_load()
    bpy.utils.unregister_class(XIHE_OT_update_light)
