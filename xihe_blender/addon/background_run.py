"""A run in a Blender of its own: the window stays free, and edits cannot reach the run.

A copy of the open file is saved into the run's folder. A second Blender opens it in the background and does there what
`xihe previs` would; see `background_script`. It says in a file how far it is, and holds a lock while it lives. So a run
goes on when the window is closed, is found again when its file is opened, and resumes after it was stopped.

Rejected: `blender --command xihe`, which a Blender whose preferences were never saved does not know, and asking for a
process by its number, which another program may have by then.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.addon.background_script import is_locked
from xihe_blender.addon.results_in_blender import apply_results
from xihe_blender.addon.shown_run import COMMAND
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs, write_json, written_whole
from xihe_blender.io.run_results import read_results
from xihe_blender.jobs import Job, Progress
from xihenet.json_files import read_json

SCRIPT = Path(__file__).with_name("background_script.py")
LOOK_EVERY_S = 0.2
EDITABLE = (bpy.types.Object, bpy.types.Material, bpy.types.Light, bpy.types.World, bpy.types.Camera, bpy.types.Mesh)
"""Kinds of data whose change makes the open scene another than the run's."""


@dataclass
class BackgroundRun:
    """A run in `folder`, of the scene `scene_name` as it was at `started`; begun by this Blender or an earlier one.

    Parameters
    ----------
    process : None for a run that another Blender has begun
    is_edited : whether the open scene was changed since
    """

    folder: Path
    scene_name: str
    started: float
    process: subprocess.Popen[bytes] | None = None
    is_edited: bool = False

    @property
    def is_under_way(self) -> bool:
        """Whether it is being worked on, by whichever Blender."""
        if self.process is not None and self.process.poll() is None:
            return True
        return is_locked(RunOutputs(self.folder, "").lock)

    @property
    def has_ended(self) -> bool:
        """Whether it has reached its end, and only its results are to be shown."""
        return RunOutputs(self.folder, "").results.exists()

    def start(self) -> None:
        """Have a second Blender begin or resume it; OSError if none can be started. Nothing if it is under way."""
        if self.is_under_way:
            return
        outputs = RunOutputs(self.folder, "")
        copy = self.folder / read_json(outputs.request)["copy"]
        outputs.progress.unlink(missing_ok=True)
        trust = "--disable-autoexec" if bpy.app.autoexec_fail else "--enable-autoexec"
        # Where this Blender has the add-on's packages, its preferences saved or not.
        paths = [str(Path(sys.modules[name].__file__ or "").parents[1]) for name in ("xihe_blender", "xihenet")]
        with outputs.console.open("ab") as console:
            self.process = subprocess.Popen(
                [bpy.app.binary_path, "--background", trust, copy, "--python", SCRIPT, "--", copy, *paths],
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
                # Neither Ctrl-C in a terminal nor its end reaches it.
                start_new_session=True,
            )

    def stop(self) -> None:
        """End the second Blender at once; what it has finished is kept, file by file."""
        if self.process is not None:
            # Not terminate: Blender 5 then waits for the script's end.
            self.process.kill()
            self.process.wait()
        elif self.is_under_way:
            with contextlib.suppress(OSError, KeyError, ValueError):
                # On Windows any signal ends a process at once.
                os.kill(_state(self.folder)["pid"], getattr(signal, "SIGKILL", signal.SIGTERM))

    def follow(self) -> Job[None]:
        """Yield its Progress until its end, then show its results in the open file. Closing this leaves it running.

        UserError for a run that failed, and where its scene is not in the open file any more.
        """
        shown: Any = Progress(0, 1, "starting Blender in the background")
        with _edits_noted(self):
            looked = 0.0
            while self.is_under_way:
                if time.perf_counter() - looked < LOOK_EVERY_S:
                    yield shown
                    continue
                looked = time.perf_counter()
                with contextlib.suppress(OSError, KeyError, ValueError):
                    state = _state(self.folder)
                    shown = Progress(state["done"], state["total"], state["doing"], state["left"])
                yield shown
        if not self.has_ended:
            raise UserError(_why_it_ended(self.folder))
        scene = bpy.data.scenes.get(self.scene_name)
        if scene is None:
            raise UserError(f"the scene {self.scene_name!r} is not in this file any more; its run is in {self.folder}")
        apply_results(scene, read_results(self.folder), self.folder, wipe=scene.xihe.wipe)
        request = RunOutputs(self.folder, "").request
        write_json(request, {**read_json(request), "is_shown": True})


def saved_for_run(scene: bpy.types.Scene, folder: Path, choices: dict[str, Any]) -> BackgroundRun:
    """Save what a run of `scene` needs into `folder`; the run is not started yet. OSError if that cannot be written.

    `choices` are parameters of PrevisSettings, as JSON holds them.
    """
    outputs = RunOutputs(folder, "")
    copy, started = f"{Path(bpy.data.filepath).stem or 'untitled'}.blend", time.time()
    with written_whole(folder / copy) as beside, _no_file_previews():
        bpy.ops.wm.save_as_mainfile(filepath=str(beside), copy=True)
    write_json(
        outputs.request,
        {
            "blend": bpy.data.filepath,
            "copy": copy,
            "scene": scene.name,
            "started": started,
            "command": COMMAND,
            "choices": choices,
        },
    )
    return BackgroundRun(folder, scene.name, started)


def unshown_run(folder: Path) -> BackgroundRun:
    """The run in `folder`, which another Blender has begun; UserError if it cannot be taken up."""
    try:
        request = read_json(RunOutputs(folder, "").request)
        return BackgroundRun(folder, str(request["scene"]), float(request["started"]))
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{folder} is gone or damaged: discard it, and run again") from error


def discard(folder: Path) -> None:
    """Stop the run in `folder`, if it is under way, and delete the folder."""
    BackgroundRun(folder, "", 0.0).stop()
    shutil.rmtree(folder, ignore_errors=True)


def _state(folder: Path) -> dict[str, Any]:
    """What the second Blender said last; ValueError before it has said anything."""
    state = read_json(RunOutputs(folder, "").progress)
    if not isinstance(state, dict):
        raise ValueError("expected an object")
    return state


def _why_it_ended(folder: Path) -> str:
    try:
        error = str(_state(folder).get("error") or "")
    except (OSError, ValueError):
        error = ""
    return error or f"the run ended early: {RunOutputs(folder, '').console} says why"


@contextlib.contextmanager
def _no_file_previews() -> Iterator[None]:
    """Save without a picture of the file, for which Blender renders the view; the preferences are as they were."""
    preferences = bpy.context.preferences
    before, was_dirty = preferences.filepaths.file_preview_type, preferences.is_dirty
    preferences.filepaths.file_preview_type = "NONE"
    try:
        yield
    finally:
        preferences.filepaths.file_preview_type, preferences.is_dirty = before, was_dirty


@contextlib.contextmanager
def _edits_noted(run: BackgroundRun) -> Iterator[None]:
    """Have `run.is_edited` set when something in the open file is changed; going to another frame changes nothing."""

    def note(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
        updates = () if depsgraph is None else depsgraph.updates
        changed = (u for u in updates if u.is_updated_geometry or u.is_updated_transform or u.is_updated_shading)
        run.is_edited = run.is_edited or any(isinstance(update.id, EDITABLE) for update in changed)

    bpy.app.handlers.depsgraph_update_post.append(note)
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):  # Loading a file takes it away.
            bpy.app.handlers.depsgraph_update_post.remove(note)
