"""The light at many places of a kept path, found on all cores: this process and helpers share one list of places.

Helpers are plain interpreters that run this module: they get the path and then one batch of places after the other
through a pipe, and know no Blender. Threads were rejected, since the chain is many short NumPy calls that wait for one
another. Nothing depends on a helper: what one that cannot start, ends or hangs does not answer, this process finds.
Light is the same whoever finds it, to the last bit: a helper has one thread and this process several, but no estimator
of ours adds in another order for that.
"""

from __future__ import annotations

import contextlib
import pickle
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Generator, Iterator, Mapping
from typing import Any

from numpy.typing import ArrayLike

from xihenet.broken_pipes import broken_pipes_raise
from xihenet.camera_path.kept_path import FoundLight, KeptPath
from xihenet.child_processes import child_environment, n_cores

AT_ONCE = 5
"""Places of a batch: half a second of work or so, which is how long cores may wait for the last one."""

MOST_HELPERS = 3
"""Each keeps a copy of the path, some 1.5 MB for each of its frames, or a quarter of that on a long one."""

WORTH_IT = 40
"""Places; a helper takes about a second to start."""

_NO_WINDOW: dict[str, Any] = {"creationflags": getattr(subprocess, "CREATE_NO_WINDOW", 0)}

Places = Mapping[str, ArrayLike]


def find_light_on_all_cores(
    path: KeptPath, places_m: Places, n_helpers: int | None = None
) -> Generator[int, None, dict[str, FoundLight]]:
    """As `KeptPath.find_light`, in the order of `places_m`; each step says how many places are done.

    `n_helpers` are processes beside this one; None takes one for each other core, and none for few places. They have
    ended when the generator has, or is closed.
    """
    if n_helpers is None:
        n_helpers = min(MOST_HELPERS, n_cores() - 1) if len(places_m) >= WORTH_IT else 0
    names, found = list(places_m), dict[str, FoundLight]()
    batches = deque(names[start : start + AT_ONCE] for start in range(0, len(names), AT_ONCE))
    packed = _packed(path) if n_helpers else b""
    with contextlib.ExitStack() as stack:
        for _ in range(n_helpers if packed else 0):
            stack.enter_context(helper(packed, places_m, batches, found))
        while len(found) < len(names):
            yield len(found)
            try:
                batch = batches.popleft()
            except IndexError:  # Helpers have the rest: what they do not answer is found here.
                batch = [name for name in names if name not in found][:AT_ONCE]
            steps = path.find_light({name: places_m[name] for name in batch})
            while not all(name in found for name in batch):
                try:
                    next(steps)
                except StopIteration as finished:
                    found.update(finished.value)
                yield len(found)
    return {name: found[name] for name in names}


def _packed(path: KeptPath) -> bytes:
    """Empty for a path whose estimator cannot be sent, such as one that runs elsewhere."""
    try:
        return pickle.dumps(path, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError):
        return b""


@contextlib.contextmanager
def helper(
    packed: bytes, places_m: Places, batches: deque[list[str]], found: dict[str, FoundLight]
) -> Iterator[threading.Thread]:
    """The thread that keeps a helper busy until there are no `batches`; both have ended when the block has.

    `packed` is the pickled path, and lights are put into `found`.
    """
    quiet, piped = subprocess.DEVNULL, subprocess.PIPE
    command = [sys.executable, "-P", "-m", "xihenet.camera_path.other_cores"]
    try:
        process = subprocess.Popen(
            command, stdin=piped, stdout=piped, stderr=quiet, env=child_environment(), **_NO_WINDOW
        )
    except OSError:
        yield threading.Thread()
        return
    assert process.stdin is not None and process.stdout is not None
    to_helper, from_helper = process.stdin, process.stdout

    def keep_busy() -> None:
        # There are no more batches, or the helper has ended.
        nothing_left = contextlib.suppress(IndexError, OSError, EOFError, ValueError, pickle.UnpicklingError)
        with nothing_left, broken_pipes_raise():
            to_helper.write(packed)
            to_helper.flush()
            pickle.load(from_helper)  # That it is ready.
            while True:
                batch = batches.popleft()
                pickle.dump({name: places_m[name] for name in batch}, to_helper)
                to_helper.flush()
                found.update(pickle.load(from_helper))

    thread = threading.Thread(target=keep_busy, daemon=True)
    thread.start()
    try:
        yield thread
    finally:
        process.kill()
        process.wait()
        thread.join()
        for pipe in (to_helper, from_helper):
            with contextlib.suppress(OSError), broken_pipes_raise():
                pipe.close()


def _serve() -> None:
    """Be a helper: a path and then places come in, lights go out, until the pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; whoever started this one ends it.
    places_in, lights_out = sys.stdin.buffer, sys.stdout.buffer
    path: KeptPath = pickle.load(places_in)
    pickle.dump(True, lights_out)
    lights_out.flush()
    while True:
        try:
            places_m = pickle.load(places_in)
        except EOFError:
            return
        steps = path.find_light(places_m)
        while True:
            try:
                next(steps)
            except StopIteration as finished:
                pickle.dump(finished.value, lights_out, pickle.HIGHEST_PROTOCOL)
                lights_out.flush()
                break


if __name__ == "__main__":
    _serve()
