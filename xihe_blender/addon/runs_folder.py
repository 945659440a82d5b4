"""The folder of runs from the panel: where are they kept, and which of them does the open file show?

Nothing heavy is imported: panels and preferences ask at every redraw. Results, with thousands of numbers, are read once
per file, so that a redraw costs a look at its date. Rejected: copies of the numbers that the panel shows as properties
of the scene, which would still be there when the run's folder is gone.
"""

from __future__ import annotations

import contextlib
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from xihe_blender.addon.preferences import RUNS, folders_with_runs, runs_folder
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import cut_stem
from xihe_blender.scene.units import metres_per_unit

if TYPE_CHECKING:
    from xihe_blender.io.budget_results import BudgetResults
    from xihe_blender.io.run_results import RunResults

RUN_IS_GONE = f"The last run's folder is not here: put the folder {RUNS} beside this file, or run again"
"""As a colleague reads it who was sent the .blend alone."""


def new_run_folder(scene: bpy.types.Scene) -> Path:
    """A new, empty folder for a run, named by the file and the time.

    UserError if it cannot be made. A run from the panel always begins anew: the open file may hold changes that are
    nowhere on disk, and then nothing could tell whether an earlier run was the same.
    """
    parent = runs_folder()
    stem = Path(bpy.data.filepath).stem or "untitled"
    name = f"{cut_stem(stem)}_{time.strftime('%Y%m%d-%H%M%S')}"
    try:
        parent.mkdir(parents=True, exist_ok=True)
        number, folder = 1, parent / name
        while True:
            with contextlib.suppress(FileExistsError):  # From the same second, maybe of another Blender.
                folder.mkdir()
                return folder
            number, folder = number + 1, parent / f"{name}_{number + 1}"
    except OSError as error:
        raise UserError(
            f"cannot write to {parent} ({error.strerror}): choose another Runs Folder in the add-on's preferences"
        ) from error


def remove_if_empty(parent: Path) -> None:
    """Remove the folder for runs if it is ours and holds nothing any more."""
    if parent.name == RUNS:
        with contextlib.suppress(OSError):  # It holds something.
            parent.rmdir()


def shown_runs() -> set[Path]:
    """Folders of the runs, and of the error budgets, that scenes of the open file show."""
    shown = [scene.xihe.budget_folder for scene in bpy.data.scenes] + [s.xihe.run_folder for s in bpy.data.scenes]
    return {found_folder(folder) for folder in shown if folder}


def found_folder(folder: str) -> Path:
    """Where a run or an error budget lies that a scene remembers in `folder`, as an absolute path.

    If that is gone, it is sought by its name where runs are kept now, and beside the file: the two were moved together.
    The file may also lie in it, as the lit file of a run does. The path may be of Windows, on another system.
    """
    remembered = Path(bpy.path.abspath(folder))
    if not folder or remembered.is_dir():
        return remembered
    name, own = last_part(folder), Path(bpy.path.abspath("//"))
    moved = [*(parent / name for parent in folders_with_runs()), *([own] if own.name == name else [])]
    return next((place for place in moved if place.is_dir()), remembered)


def last_part(path: str) -> str:
    """The last part of a path of any system."""
    return re.split(r"[/\\]", path.rstrip("/\\"))[-1]


def last_run(folder: str) -> RunResults | None:
    """The run in `folder`, as a scene remembers it; None without one, or where its results are gone or unreadable."""
    from xihe_blender.io.run_results import read_results

    try:
        return read_results(found_folder(folder)) if folder else None
    except UserError:
        return None


def other_unit(scene: bpy.types.Scene, run: RunResults | None) -> str | None:
    """That the unit of `scene` was another one in `run`, and all that it knows of places is of that; else None."""
    was = None if run is None else run.scene.unit_m
    if was is None or was == metres_per_unit(scene):
        return None
    return f"The run was made with a Unit Scale of {was:.6g}: set it back in the scene's Units, or run again"


def last_budget(folder: str) -> BudgetResults | None:
    """The error budget in `folder`, as a scene remembers it; None without one, or where it is gone or unreadable."""
    from xihe_blender.io.budget_results import read_budget

    try:
        return read_budget(found_folder(folder)) if folder else None
    except UserError:
        return None
