"""What the second Blender of a run does, given this script with `--python`, and `-- COPY.blend FOLDER...` behind it.

Run by its path, before anything of ours can be imported: the folders hold our packages. Writes work/progress.json
beside the copy after each step of the run, and holds work/lock while it lives, however it ends.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import IO, Any

N_TRIES = 20
"""Ten a second, to take the lock."""


def main(copy: Path, *packages: str) -> None:
    """Do or resume the run that the folder of `copy` asks for."""
    request = json.loads((copy.parent / "work" / "request.json").read_text(encoding="utf-8"))
    sys.path[:0] = [path for path in dict.fromkeys(packages) if path not in sys.path]
    import bpy

    from xihe_blender.addon.failures import FAILURES, format_error
    from xihe_blender.io.outputs import RunOutputs, write_json
    from xihe_blender.jobs import Progress
    from xihe_blender.previs.previs import previs
    from xihe_blender.previs.settings import PrevisSettings

    outputs = RunOutputs(copy.parent, "")
    lock = outputs.lock.open("ab")
    # A panel that looks whether the lock is held holds it itself for a moment.
    for _ in range(N_TRIES):
        if _take(lock):
            break
        time.sleep(0.1)
    else:
        return  # Another Blender is at it.

    def say(progress: Progress, error: str = "") -> None:
        state = {"done": progress.done, "total": progress.total, "doing": progress.doing, "left": dict(progress.left)}
        write_json(outputs.progress, {**state, "pid": os.getpid(), "error": error})

    last = Progress(0, 1, "surveying the path")
    choices: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in request["choices"].items()
    }
    try:
        scene = bpy.data.scenes[request["scene"]]
        for last in previs(scene, copy.parent, PrevisSettings(**choices), blend_file=copy, command=request["command"]):
            say(last)
    except FAILURES as error:
        say(last, format_error(error))


def is_locked(path: Path) -> bool:
    """Whether a living process holds the lock; False if there is no such file."""
    try:
        with path.open("r+b") as file:
            return not _take(file)
    except OSError:
        return False


def _take(file: IO[Any]) -> bool:
    """Lock `file` for as long as this process keeps it open; False if another has it.

    True also where the file system knows no locks: a run there is seen as long as its window follows it.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


if __name__ == "__main__":
    _copy, *_packages = sys.argv[sys.argv.index("--") + 1 :]
    main(Path(_copy), *_packages)
