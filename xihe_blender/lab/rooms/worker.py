"""A worker, one process of a data set's build: makes the rooms it is told, one file after the other.

Started by `build`, as `python -m xihe_blender.lab.rooms.worker`. It talks through the files it leaves: a room that is
there is whole. Rendering uses one thread: two processes with one thread each beat one with two.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from xihe_blender.errors import UserError, format_disk_error
from xihe_blender.io.json_records import from_json
from xihe_blender.lab.rooms.render_room import make_room
from xihe_blender.lab.rooms.settings import BuildSettings
from xihe_blender.lab.rooms.store import room_path, save_room
from xihe_blender.lab.workers.dask_workers import EXIT_CANNOT_BE_DONE


def make_rooms(folder: Path, settings: BuildSettings, rooms: Iterable[int], is_stopped: Callable[[], bool]) -> None:
    """Make the rooms that are not there yet; stops between rooms when told to, or when its parent process is gone."""
    parent = os.getppid()
    for index in rooms:
        if is_stopped() or os.getppid() != parent:
            return
        path = room_path(folder, index)
        if not path.exists():
            save_room(path, make_room(settings, index))


def main() -> int:
    """Takes the folder, the settings as JSON, and numbers of rooms with commas between them; - for those on stdin.

    What went wrong is the last line on stderr.
    """
    folder, said, rooms = sys.argv[1:]
    # Ctrl-C reaches the whole group of processes; the build decides what it means. Told to end, finish the room:
    # a process that dies while Cycles renders leaves its temporary files behind.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # No threading.Event: told once more while it is set, the process would wait for its lock for ever.
    told: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _frame: told.append(number))
    try:
        settings = from_json(BuildSettings, json.loads(said))
        numbers = sys.stdin.read() if rooms == "-" else rooms
        make_rooms(Path(folder), settings, map(int, numbers.split(",")), lambda: bool(told))
    except (UserError, OSError) as error:
        words = format_disk_error(error) if isinstance(error, OSError) else str(error)
        print(" ".join(words.split()), file=sys.stderr)
        return EXIT_CANNOT_BE_DONE
    return 0


if __name__ == "__main__":
    sys.exit(main())
