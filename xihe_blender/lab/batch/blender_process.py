"""The process with Blender in it, which evaluates one unit and ends.

Started by a worker as `python -m xihe_blender.lab.batch.blender_process`. It is told what to do by one JSON
object on stdin, and tells its share of the work on stdout, a number from 0 to 1 a line. The result is a file. A process
for each unit: loading Blender takes a second of the minute that a unit takes, memory is always given back, and a crash
of Blender costs one unit, which is handed out again.

Exit codes: 0 done, 2 the unit cannot be done, and the last line on stderr says why; anything else is a crash.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from xihe_blender.errors import UserError
from xihe_blender.io.blender_output import blender_output_aside
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.io.outputs import write_json
from xihe_blender.lab.batch.grid import UnitAsked
from xihe_blender.lab.batch.results import result_file
from xihe_blender.lab.workers.dask_workers import EXIT_CANNOT_BE_DONE

EXIT_ABANDONED = 3


class AbandonedError(Exception):
    """The worker that started this process is gone."""


def main() -> int:
    # Ctrl-C reaches the whole group of processes; the batch decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asked = from_json(UnitAsked, json.load(sys.stdin))
    with blender_output_aside() as (stdout, stderr):
        try:
            write_result(asked, lambda share: print(f"{share:.4f}", file=stdout, flush=True))
        except (UserError, OSError) as error:
            print(" ".join(str(error).split()), file=stderr)
            return EXIT_CANNOT_BE_DONE
        except (AbandonedError, BrokenPipeError):
            return EXIT_ABANDONED
    return 0


def write_result(asked: UnitAsked, tell: Callable[[float], None]) -> None:
    """Evaluate the unit and leave its result, and the pictures of worst frames, in its folder."""
    from xihe_blender.jobs import Progress, run_blocking
    from xihe_blender.lab.batch.unit import evaluate_unit

    folder, parent = Path(asked.folder), os.getppid()

    def tell_share(progress: Progress, _elapsed_s: float) -> None:
        if os.getppid() != parent:
            raise AbandonedError
        tell(progress.done / progress.total)

    result_file(folder).unlink(missing_ok=True)  # One that is damaged: should this one fail, nobody reads it again.
    done = run_blocking(evaluate_unit(Path(asked.scene), folder, asked.settings, asked.seed), tell_share)
    write_json(result_file(folder), as_json(done))
    for intermediate in ("work", "radiance", "pictures"):
        shutil.rmtree(folder / intermediate, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
