"""One process of a data set's build: makes the rooms it is told, one file after the other.

Started by `build`, as `python -m xihe_blender.lab.rooms.worker`. It talks through the files it leaves: a room that is
there is whole. Rendering uses one thread: two processes with one thread each beat one with two.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from xihe_blender.errors import UserError
from xihe_blender.lab.rooms.render_room import RoomRenderSettings, make_room
from xihe_blender.lab.rooms.store import room_path, save_room


def make_rooms(options: argparse.Namespace, is_stopped: Callable[[], bool]) -> None:
    """Make the rooms that are not there yet; stops between rooms when told to, or when its parent process is gone."""
    parent, settings = os.getppid(), RoomRenderSettings.of(options.settings)
    numbers = sys.stdin.read() if options.rooms == "-" else options.rooms
    for index in map(int, numbers.split(",")):
        if is_stopped() or os.getppid() != parent:
            return
        path = room_path(options.out, index)
        if not path.exists():
            shares = {"varied": options.varied, "by_day": options.by_day}
            save_room(path, make_room(options.seed, index, settings, walk=options.walk, views=options.views, **shares))


def main() -> int:
    """The command line; what went wrong is the last line on stderr."""
    parser = argparse.ArgumentParser(prog="python -m xihe_blender.lab.rooms.worker", description="Make rooms.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--rooms", required=True, help="numbers, separated by commas; - for those on stdin")
    parser.add_argument("--settings", type=int, nargs=6, required=True, metavar="N", help="sizes and samples")
    parser.add_argument("--varied", type=float, default=0.0, help="share of the training rooms that are varied")
    parser.add_argument("--by-day", type=float, default=0.0, help="share of the training rooms lit by windows alone")
    parser.add_argument("--walk", type=int, metavar="F", help="frames of a walk in place of free views")
    parser.add_argument("--views", type=int, metavar="N", help="free views of each room")
    options = parser.parse_args()
    # Ctrl-C reaches the whole group of processes; the build decides what it means. Told to end, finish the room:
    # a process that dies while Cycles renders leaves its temporary files behind.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # No threading.Event: told once more while it is set, the process would wait for its lock for ever.
    told: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _frame: told.append(number))
    try:
        make_rooms(options, lambda: bool(told))
    except (UserError, OSError) as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
