"""The process with Blender in it, which evaluates one unit and ends.

Started by a worker as `python -m xihe_blender.lab.batch.blender_process SCENE SEED FOLDER SHA256`, with its settings as
JSON on stdin; it tells its share of the work on stdout, a number from 0 to 1 a line. The result is a file. A process
for each unit: loading Blender takes a second of the minute that a unit takes, memory is always given back, and a crash
of Blender costs one unit, which is handed out again. The scene may be saved anew while others are done: one that has
not the content any more by which its folder goes is refused.

Exit codes: 0 done, 2 the unit cannot be done, and the last line on stderr says why; anything else is a crash. Where the
worker is gone, however it ended, nobody reads the shares, and the process ends within a second or two.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import signal
import sys
from pathlib import Path
from typing import IO

from xihe_blender.errors import UserError, format_disk_error
from xihe_blender.io.blender_output import blender_output_aside
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.io.outputs import write_json
from xihe_blender.jobs import Progress, run_blocking
from xihe_blender.lab.batch.grid import BatchSettings
from xihe_blender.lab.batch.results import BatchFolder, read_result, result_file
from xihe_blender.lab.workers.dask_workers import EXIT_CANNOT_BE_DONE


def main() -> int:
    # Ctrl-C reaches the whole group of processes; the batch decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from xihe_blender.lab.workers.processes import only_with_a_reader

    scene, seed, folder, sha256 = sys.argv[1:]
    settings = from_json(BatchSettings, json.load(sys.stdin))
    with blender_output_aside() as (stdout, stderr), only_with_a_reader(stdout.fileno()):
        try:
            if hashlib.sha256(Path(scene).read_bytes()).hexdigest() != sha256:
                raise UserError("it has changed since the batch began: run the same command again")
            write_result(Path(scene), int(seed), Path(folder), settings, stdout)
        except (UserError, OSError) as error:
            words = format_disk_error(error) if isinstance(error, OSError) else str(error)
            print(" ".join(words.split()), file=stderr)
            return EXIT_CANNOT_BE_DONE
    return 0


def write_result(scene: Path, seed: int, folder: Path, settings: BatchSettings, shares: IO[str]) -> None:
    """Evaluate the unit and leave its result, and the pictures of worst frames, in its folder; tell `shares`.

    Nothing is done where the result is there: a scheduler may still have finished it for a batch that was stopped. It
    may do so during this, too, and removes what was rendered.
    """
    from xihe_blender.lab.batch.unit import evaluate_unit

    def tell(progress: Progress, _elapsed_s: float) -> None:
        print(f"{progress.done / progress.total:.4f}", file=shares, flush=True)

    if read_result(folder, scene) is not None:
        return
    batch = BatchFolder(folder.resolve().parents[1])
    batch.check_phones(settings)
    result_file(folder).unlink(missing_ok=True)  # One that is damaged: should this one fail, nobody reads it again.
    try:
        done = run_blocking(evaluate_unit(scene, folder, settings, seed), tell)
    except (OSError, UserError):
        if read_result(folder, scene) is not None:
            return
        raise
    try:
        batch.check_phones(settings)
    except UserError:
        shutil.rmtree(folder, ignore_errors=True)  # It may be of both phones.
        raise
    write_json(result_file(folder), as_json(done))
    for intermediate in ("work", "radiance", "pictures"):
        shutil.rmtree(folder / intermediate, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
