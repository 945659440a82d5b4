"""A run in a Blender of its own: the window stays free, and edits cannot reach the run.

A copy of the open file is saved into the run's folder. A second Blender opens it in the background and does there what
`xihe previs` would; see `background_script`. It says in a file how far it is, and holds a lock while it lives. So a run
goes on when the window is closed, is found again when its file is opened, and resumes after it was stopped.

Rejected: `blender --command xihe`, which a Blender whose preferences were never saved does not know, and asking for a
process by its number, which another program may have by then.
"""

from __future__ import annotations

import contextlib
import functools
import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy

from xihe_blender.addon.preferences import folders_with_runs
from xihe_blender.addon.runs_folder import found_folder, last_part, remove_if_empty
from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import is_locked
from xihe_blender.io.json_records import Parameters, as_json, read_record
from xihe_blender.io.outputs import RunOutputs, cut_stem, write_json
from xihe_blender.jobs import Job, Progress
from xihe_blender.scene.blend_file import ROOM, save_copy

COMMAND = "Run in Blender's panel"
SCRIPT = Path(__file__).with_name("background_script.py")
LOOK_EVERY_S = 0.2
OF_WINDOWS = ("BELOW_NORMAL_PRIORITY_CLASS", "CREATE_NO_WINDOW")
ENDS_WITHIN_S = 5.0
"""Of a second Blender that was ended."""

NICENESS = 19
"""Of the second Blender, the most there is: it has what the window and all else that is open leave."""
EDITABLE = (bpy.types.Object, bpy.types.Material, bpy.types.Light, bpy.types.World, bpy.types.Camera, bpy.types.Mesh)
"""Kinds of data whose change makes the open scene another than the run's."""


@dataclass(frozen=True)
class RunRequest:
    """What a second Blender is to do, as work/request.json holds it.

    Parameters
    ----------
    blend, copy : the open file, and its copy in the run's folder
    started : when the scene looked as the run knows it
    choices : parameters of PrevisSettings
    """

    blend: str
    copy: str
    scene: str
    started: float
    command: str
    choices: Parameters


@dataclass(frozen=True, kw_only=True)
class RunState(Progress):
    """How far the second Blender is, as work/progress.json holds it: `error` says why it could not go on.

    `host` is the computer whose process `pid` it is: others may see the folder too.
    """

    pid: int
    host: str
    error: str


@dataclass
class BackgroundRun:
    """A run in `folder`, begun by this Blender or an earlier one.

    Parameters
    ----------
    process : None for a run that another Blender has begun
    is_edited : whether the open scene was changed since, or may have been while nobody looked, as before a Resume
    """

    folder: Path
    process: subprocess.Popen[bytes] | None = None
    is_edited: bool = False

    @property
    def outputs(self) -> RunOutputs:
        return RunOutputs(self.folder)

    @functools.cached_property
    def request(self) -> RunRequest:
        """What it does; UserError if nothing tells any more, so that it cannot be taken up."""
        try:
            return read_record(RunRequest, self.outputs.request)
        except (OSError, TypeError, ValueError) as error:
            raise UserError(f"{self.folder} is gone or damaged: discard it, and run again") from error

    @property
    def state(self) -> RunState | None:
        """What the second Blender said last; None before it has said anything."""
        try:
            return read_record(RunState, self.outputs.progress)
        except (OSError, TypeError, ValueError):
            return None

    @property
    def begun(self) -> float | None:
        """When it was begun; None if it is gone. Looks at no more than the file's date."""
        try:
            return self.outputs.request.stat().st_mtime
        except OSError:
            return None

    @property
    def is_under_way(self) -> bool:
        """Whether it is being worked on, by whichever Blender."""
        if self.process is not None and self.process.poll() is None:
            return True
        return is_locked(self.outputs.lock)

    @property
    def has_ended(self) -> bool:
        """Whether it has reached its end, and only its results are to be shown."""
        return self.outputs.results.exists()

    def start(self) -> None:
        """Have a second Blender begin or resume it; OSError if none can be started. Nothing if it is under way."""
        if self.is_under_way:
            return
        copy = self.folder / self.request.copy
        self.outputs.progress.unlink(missing_ok=True)
        trust = "--disable-autoexec" if bpy.app.autoexec_fail else "--enable-autoexec"
        # The window, and whatever else is open, goes first.
        first = ["nice", "-n", str(NICENESS)] if sys.platform != "win32" and shutil.which("nice") else []
        # Where this Blender has the add-on's packages, its preferences saved or not.
        paths = [str(Path(sys.modules[name].__file__ or "").parents[1]) for name in ("xihe_blender", "xihenet")]
        with self.outputs.console.open("ab") as console:
            self.process = subprocess.Popen(
                [*first, bpy.app.binary_path, "--background", trust, copy, "--python", SCRIPT, "--", copy, *paths],
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
                # Neither Ctrl-C in a terminal nor its end reaches it. On Windows it has a console of its own for that.
                start_new_session=True,
                creationflags=sum(getattr(subprocess, name, 0) for name in OF_WINDOWS),
            )
        _let_go_first(self.process.pid)

    def stop(self) -> None:
        """End the second Blender at once; what it has finished is kept, file by file. Not one of another computer."""
        state = self.state
        if self.process is not None:
            # Not terminate: Blender 5 then waits for the script's end.
            self.process.kill()
            self.process.wait()
        elif self.is_under_way and state is not None and state.host == platform.node():
            with contextlib.suppress(OSError):
                # On Windows any signal ends a process at once.
                os.kill(state.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
            until = time.perf_counter() + ENDS_WITHIN_S
            while self.is_under_way and time.perf_counter() < until:  # Until then its files are open.
                time.sleep(0.02)

    def discard(self) -> None:
        """Stop it, if it is under way, and delete its folder, and the folder for runs if it was the last.

        UserError if it cannot be stopped from here.
        """
        self.stop()
        if self.is_under_way:
            raise UserError(f"{self.folder} is under way in another Blender: stop it there, and discard it then")
        shutil.rmtree(self.folder, ignore_errors=True)
        remove_if_empty(self.folder.parent)

    def follow(self) -> Job[None]:
        """Yield its Progress until its end, then show its results in the open file. Closing this leaves it running.

        UserError for a run that failed, and where its scene is not in the open file any more.
        """
        shown = Progress(0, 1, "starting Blender in the background")
        with _edits_noted(self):
            looked = 0.0
            while self.is_under_way:
                if time.perf_counter() - looked >= LOOK_EVERY_S:
                    looked, shown = time.perf_counter(), self.state or shown
                yield shown
        if not self.has_ended:
            state = self.state
            said = "" if state is None else state.error
            code = None if self.process is None else self.process.returncode
            ended = "the run ended early" if code is None else f"the run ended early (exit code {code})"
            raise UserError(said or f"{ended}: Resume goes on with it. Its console is in {self.outputs.console}")
        from xihe_blender.addon.results_in_blender import apply_results

        apply_results(self.find_scene(), self.folder)

    def find_scene(self) -> bpy.types.Scene:
        """The scene of the open file that it is a run of: that of its name, or else that in which it was begun.

        UserError where neither is there.
        """
        name, own = self.request.scene, [s for s in bpy.data.scenes if s.library is None and ROOM not in s]
        found = [scene for scene in own if scene.name == name]
        found += [scene for scene in own if found_folder(scene.xihe.begun_run) == self.folder]
        if not found:
            raise UserError(
                f"no scene is called {name!r} any more: give the run's scene that name and show it again, or discard it"
            )
        return found[0]


def saved_for_run(scene: bpy.types.Scene, folder: Path, choices: Parameters) -> BackgroundRun:
    """Save what a run of `scene` needs into `folder`; the run is not started yet. OSError if that cannot be written."""
    copy, started = f"{cut_stem(Path(bpy.data.filepath).stem) or 'untitled'}.blend", time.time()
    with _no_file_previews():
        save_copy(scene, folder / copy)
    request = RunRequest(bpy.data.filepath, copy, scene.name, started, COMMAND, choices)
    write_json(RunOutputs(folder).request, as_json(request))
    return BackgroundRun(folder)


def newest_run(blend: str, begun: Iterable[str] = ()) -> Path | None:
    """Folder of the newest run of the file `blend`, whatever became of it; None without one.

    A run beside the file is of the file of that name, wherever both were when it was begun. Those in the folders
    `begun`, as scenes remember them, are the file's by whatever name it had then, or if it had none.
    """
    asked = (path for parent in folders_with_runs() for path in parent.glob("*/work/request.json"))
    runs = [BackgroundRun(path.parents[1]) for path in asked] if blend else []
    remembered = [BackgroundRun(found_folder(folder)) for folder in begun if folder]
    found = []
    for run in (*runs, *remembered):
        with contextlib.suppress(UserError):
            is_beside = run.folder.parent.parent == Path(blend).parent
            is_named = run.request.blend == blend or (is_beside and last_part(run.request.blend) == Path(blend).name)
            if is_named or run in remembered:
                found.append((run.request.started, run.folder))
    return max(found, default=(0.0, None))[1]


def _let_go_first(pid: int) -> None:
    """Let other sessions of Linux go before that of process `pid`: its niceness counts within its own session alone.

    At once, not by the second Blender itself: what slows the window most is its start.
    """
    with contextlib.suppress(OSError):
        Path(f"/proc/{pid}/autogroup").write_text(str(NICENESS), encoding="ascii")


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
