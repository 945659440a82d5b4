"""A build of a data set: a job that shares the missing rooms out to processes and watches their files.

Resumable by room: a file that exists is whole and is not made again, and a room is the same whoever makes it. So a
build may be stopped at any time, and may grow later. Rejected: a pool in this process, since Blender holds one scene.

On one machine the processes are started here, which needs nothing installed; with a scheduler's address its workers
start them, as `xihe evaluate` does, and see the folder under the same path.
"""

from __future__ import annotations

import contextlib
import json
import tempfile
import time
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from subprocess import DEVNULL, Popen
from typing import IO, Any

from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import NOT_COMPARED, FolderManifest
from xihe_blender.io.json_records import as_json
from xihe_blender.jobs import Job, Progress
from xihe_blender.lab.rooms.settings import BuildSettings
from xihe_blender.lab.rooms.store import room_path, stored_indices
from xihe_blender.lab.workers.dask_workers import Work, open_dask_workers
from xihe_blender.lab.workers.one_core import last_line, process_on_one_core
from xihe_blender.lab.workers.processes import module_command
from xihenet import __version__
from xihenet.child_processes import n_cores
from xihenet.training.rooms import MANIFEST

POLL_S = 0.25
LEFT_BEHIND_S = 600.0  # A room is written in a second.
WORKER = "xihe_blender.lab.rooms.worker"
ROOMS_AT_A_TIME = 8  # That a worker of a scheduler is asked for: half a minute of work for a second of loading Blender


def build_dataset(folder: Path, settings: BuildSettings) -> Job[int]:
    """Build the rooms that are missing in `folder`; returns how many were made now.

    UserError if the folder holds another data set or a damaged room or cannot be written, or a worker fails.
    """
    with rooms_held(folder, settings.provenance):
        wanted = settings.wanted()
        for index in stored_indices(folder):
            # Its end is missing; what else is wrong with it is found where it is read whole.
            if not zipfile.is_zipfile(room_path(folder, index)):
                raise UserError(f"{room_path(folder, index)} is damaged: delete it and build again")
        missing = missing_rooms(folder, wanted)
        make = _in_processes if settings.scheduler is None else _over_dask
        yield from make(folder, settings, missing)
        left = missing_rooms(folder, wanted)
        if left:
            raise UserError(f"{len(left)} rooms were not made, the first is {left[0]}: run the same command again")
        return len(missing)


def _in_processes(folder: Path, settings: BuildSettings, missing: Sequence[int]) -> Iterator[Progress]:
    """Make the `missing` rooms in processes of this machine. UserError, in its own words, if one failed."""
    n_workers = min(settings.n_workers or n_cores(), len(missing))
    command = [*module_command(WORKER), *_arguments(folder, settings)]
    with contextlib.ExitStack() as stack:
        workers = []
        for share in (missing[i::n_workers] for i in range(n_workers)):
            numbers = stack.enter_context(tempfile.TemporaryFile())  # A command line would be too long for them.
            numbers.write(",".join(map(str, share)).encode())
            numbers.seek(0)
            workers.append(stack.enter_context(process_on_one_core(command, stdin=numbers, stdout=DEVNULL)))
        try:
            yield from _watched(folder, len(settings.wanted()), missing, workers)
        finally:
            # All are told before any is waited for: each finishes the room that it is at.
            for process, _ in workers:
                process.terminate()


def _over_dask(folder: Path, settings: BuildSettings, missing: Sequence[int]) -> Iterator[Progress]:
    """Make the `missing` rooms, some at a time, on the workers of a scheduler. UserError if one fails."""
    if not missing:
        return
    folder = folder.resolve()
    shares = [missing[i : i + ROOMS_AT_A_TIME] for i in range(0, len(missing), ROOMS_AT_A_TIME)]
    work = [Work(f"room {share[0]}", WORKER, _arguments(folder, settings, share)) for share in shares]
    with open_dask_workers(None, settings.scheduler) as workers:
        workers.check_workers(str(folder), [])
        yield from workers.run(work, "share of rooms")
    for reason in workers.failed.values():
        raise UserError(f"a worker ended: {reason}; run the same command again to resume")


@contextlib.contextmanager
def rooms_held(folder: Path, provenance: dict[str, Any]) -> Iterator[None]:
    """`FolderManifest.held` of a data set that is made with `provenance`; clears what killed workers left.

    What was written a moment ago may be a worker's of a build that was killed itself.
    """
    decides = {**provenance, NOT_COMPARED: f"xihe {__version__}"}
    with FolderManifest(folder, folder / MANIFEST, "a build of rooms", decides).held():
        for part in folder.glob(".room_*.npz"):
            with contextlib.suppress(FileNotFoundError):
                if time.time() - part.stat().st_mtime > LEFT_BEHIND_S:
                    part.unlink()
        yield


def missing_rooms(folder: Path, wanted: Iterable[int]) -> list[int]:
    """The numbers among `wanted` for which there is no file."""
    there = set(stored_indices(folder))
    return [i for i in wanted if i not in there]


def _watched(
    folder: Path, n_wanted: int, missing: Sequence[int], workers: Sequence[tuple[Popen[Any], IO[bytes]]]
) -> Iterator[Progress]:
    """Progress until all workers have ended."""
    while True:
        codes = [process.poll() for process, _ in workers]
        left = len(missing_rooms(folder, missing))
        yield Progress(len(missing) - left, max(len(missing), 1), f"{n_wanted - left} of {n_wanted} rooms")
        for code, (_, errors) in zip(codes, workers, strict=True):
            if code not in (None, 0):
                words = (last_line(errors) if code > 0 else "") or f"exit code {code}"
                raise UserError(f"a worker ended: {words}; run the same command again to resume")
        if None not in codes:
            return
        time.sleep(POLL_S)


def _arguments(folder: Path, settings: BuildSettings, rooms: Sequence[int] = ()) -> tuple[str, ...]:
    """What `worker` is told: the numbers of the rooms, or that they are on stdin."""
    return str(folder), json.dumps(as_json(settings)), ",".join(map(str, rooms)) or "-"
