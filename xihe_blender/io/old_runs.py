"""Old runs: how much space do runs from the panel take, and which of them can go?

Each run from the panel is a folder of its own, named by file and time, in one that the user may share with other
things. So a run is known by its name and by what only a run writes, and nothing else is ever touched. One that has not
ended may be under way in another Blender: it counts as a run once it has lain untouched for a day and nobody is at it.

Nothing here needs NumPy: the preferences ask at every redraw. The size of a run is measured once.
"""

from __future__ import annotations

import functools
import re
import shutil
import time
from collections.abc import Collection, Sequence
from pathlib import Path

from xihe_blender.io.folder_manifest import is_locked
from xihe_blender.io.outputs import RunOutputs
from xihenet.formats import format_bytes, format_count

NAME = re.compile(r".+_\d{8}-\d{6}(_\d+)?")
ABANDONED_S = 24 * 3600.0


def runs_in(parent: Path) -> list[Path]:
    """The runs in `parent`, by name; none if there is no such folder, or it cannot be read."""
    try:
        return sorted(path for path in parent.iterdir() if _is_run(path))
    except OSError:
        return []


def old_runs(parent: Path, shown: Collection[Path]) -> list[Path]:
    """Those of `runs_in` that are not among `shown`."""
    kept = {path.resolve() for path in shown}
    return [run for run in runs_in(parent) if run.resolve() not in kept]


def remove_old_runs(parent: Path, shown: Collection[Path]) -> list[Path]:
    """Remove the folders of `old_runs`; those that are gone. OSError for one that cannot be removed."""
    old = old_runs(parent, shown)
    for run in old:
        shutil.rmtree(run)
    return old


def format_old_runs(runs: Sequence[Path]) -> str:
    """ "1 run, 0.3 MB"."""
    n_bytes = sum(_bytes_of(run, run.stat().st_mtime_ns) for run in runs)
    return f"{format_count(len(runs), 'run')}, {format_bytes(n_bytes, 2)}"


def _is_run(path: Path) -> bool:
    if path.is_symlink() or not (NAME.fullmatch(path.name) and RunOutputs(path).settings.is_file()):
        return False
    lies_s = time.time() - (path / "work").stat().st_mtime
    return RunOutputs(path).results.is_file() or (lies_s > ABANDONED_S and not is_locked(RunOutputs(path).lock))


@functools.cache
def _bytes_of(run: Path, _changed_ns: int) -> int:
    """Of all files below `run`; a run that has ended changes no more."""
    return sum(path.lstat().st_size for path in run.rglob("*") if path.is_file())
