"""Blender's own output, kept away from ours at the level of file descriptors, since Cycles writes there from C++.

And the way out of Blender, after which nothing is printed.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import io
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn


class _Heedless(io.RawIOBase):
    """A stream whose reader may leave before the job is done, as `head` does: what nobody reads is dropped.

    It writes to a raw stream that `open` chooses: a console of Windows takes other calls than a file, and UTF-8 alone.

    What is worth `keeping`, the result, raises OSError where it is refused for another reason, such as a full disk;
    progress never does.
    """

    def __init__(self, descriptor: int, *, keeping: bool) -> None:
        self.raw = open(descriptor, "wb", buffering=0)  # noqa: SIM115
        self.keeping = keeping

    def fileno(self) -> int:
        return self.raw.fileno()

    def isatty(self) -> bool:
        return self.raw.isatty()

    def writable(self) -> bool:
        return True

    def close(self) -> None:
        self.raw.close()
        super().close()

    def write(self, text: Any, /) -> int:
        try:
            return self.raw.write(text)
        except OSError as error:
            # Of a pipe without a reader, Windows says the second.
            if self.keeping and error.errno not in (errno.EPIPE, errno.EINVAL):
                raise OSError(error.errno, error.strerror, "standard output") from error
            return len(text)


def open_closed_streams() -> None:
    """Have stdin, stdout and stderr lead nowhere where they were closed when the process was started.

    Else the next file that is opened would get the number of one, and with it all that is printed.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)


@contextlib.contextmanager
def blender_output_aside() -> Iterator[tuple[Any, Any]]:
    """Send what is written to file descriptors 1 and 2 nowhere during the block; give the real stdout and stderr.

    With XIHE_VERBOSE set in the environment it goes to stderr instead. OSError if what was written to the real stdout
    could not be, unless its reader has left.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        # A name may hold what the terminal has no sign for: it is not worth the end of a run.
        streams = [
            io.TextIOWrapper(
                io.BufferedWriter(_Heedless(os.dup(descriptor), keeping=descriptor == 1)),
                encoding=stream.encoding,
                errors="backslashreplace",
                line_buffering=os.isatty(descriptor),
            )
            for descriptor, stream in ((1, sys.stdout), (2, sys.stderr))
        ]
        for descriptor, stream in enumerate(streams, start=1):
            stack.callback(stream.close)
            stack.callback(os.dup2, stream.fileno(), descriptor)
        aside = os.dup(2) if os.environ.get("XIHE_VERBOSE") else os.open(os.devnull, os.O_WRONLY)
        stack.callback(os.close, aside)
        os.dup2(aside, 1)
        os.dup2(aside, 2)
        try:
            yield streams[0], streams[1]
        finally:
            _forget_imported_files()
            # Registered after Blender was loaded, it runs before Blender ends: 4.5 prints a line to stdout as it ends.
            atexit.unregister(close_stdout)
            atexit.register(close_stdout)
            # Blender's operators write what they report through Python's own stream.
            with contextlib.suppress(OSError):
                sys.stdout.flush()
                sys.stderr.flush()


def _forget_imported_files() -> None:
    """Empty Blender's cache of what geometry nodes imported: it outlives Python, and 4.5 then crashes as it ends."""
    bpy = sys.modules.get("bpy")
    if bpy is not None:
        system = bpy.context.preferences.system
        limit, system.memory_cache_limit = system.memory_cache_limit, 0
        system.memory_cache_limit = limit


@contextlib.contextmanager
def only_our_output() -> Iterator[None]:
    """As `blender_output_aside`, for a script that prints: what it does in the block goes to the real streams."""
    with blender_output_aside() as (out, err), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        yield


def close_stdout() -> None:
    """Send what still comes from this process' C++ nowhere."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)


def exit_code_of(work: Callable[[], object]) -> int:
    """What a process that only does `work` ends with: the number it gives or ends itself with, 1 after an error.

    The error is shown. None counts as 0, and Ctrl-C goes on.
    """
    try:
        code = work()
    except SystemExit as end:
        code = end.code
        return code if isinstance(code, int) else int(code is not None)
    except Exception:  # noqa: BLE001  # Whatever it is, the process ends with it.
        sys.excepthook(*sys.exc_info())
        return 1
    return code if isinstance(code, int) else 0


def leave_blender(code: int) -> NoReturn:
    """End this Blender with `code`, at once.

    On its own way out Blender 4.3 was seen to wait for ever after renders, and 4.5 after a run that had loaded torch.
    """
    import bpy

    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # Nobody reads any more.
            stream.flush()
    if Path(bpy.app.tempdir).name.startswith("blender_"):  # Where it could make none, it is that of everybody's.
        shutil.rmtree(bpy.app.tempdir, ignore_errors=True)
    os._exit(code)
