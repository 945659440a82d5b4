"""The script of a run's second Blender, given with `--python`, and with `-- COPY.blend FOLDER...` behind it.

Run by its path, before anything of ours can be imported: the folders hold our packages. Writes work/progress.json
beside the copy after each step of the run, and holds work/lock while it lives, however it ends.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from pathlib import Path
from typing import Any

N_TRIES = 20
"""Ten a second, to take the lock."""


def main(copy: Path) -> None:
    """Do or resume the run that the folder of `copy` asks for."""
    import bpy

    from xihe_blender.addon.background_run import BackgroundRun, RunState
    from xihe_blender.addon.failures import FAILURES, format_error
    from xihe_blender.io.folder_manifest import take_lock
    from xihe_blender.io.json_records import as_json
    from xihe_blender.io.outputs import write_json
    from xihe_blender.jobs import Progress
    from xihe_blender.previs.previs import previs
    from xihe_blender.previs.settings import settings_of

    run = BackgroundRun(copy.parent)
    lock = run.outputs.lock.open("ab")
    # A panel that looks whether the lock is held holds it itself for a moment.
    for _ in range(N_TRIES):
        if take_lock(lock):
            break
        time.sleep(0.1)
    else:
        return  # Another Blender is at it.

    def say(progress: Progress, error: str = "") -> None:
        state = RunState(**vars(progress), pid=os.getpid(), host=platform.node(), error=error)
        write_json(run.outputs.progress, as_json(state))

    last = Progress(0, 1, "surveying the path")
    say(last)
    try:
        choices: dict[str, Any] = run.request.choices
        scene, settings = bpy.data.scenes[run.request.scene], settings_of(choices)
        for last in previs(scene, run.folder, settings, blend_file=copy, command=run.request.command):
            say(last)
    except FAILURES as error:
        say(last, format_error(error))


if __name__ == "__main__":
    _copy, *_packages = sys.argv[sys.argv.index("--") + 1 :]
    sys.path[:0] = [path for path in dict.fromkeys(_packages) if path not in sys.path]
    from xihe_blender.io.blender_output import exit_code_of, leave_blender

    leave_blender(exit_code_of(lambda: main(Path(_copy))))
