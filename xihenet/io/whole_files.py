"""A file that exists is whole: it is written beside its place, and renamed. Needs no NumPy."""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Iterator
from pathlib import Path

RENAMED_WITHIN = 10
"""Times that a file is renamed if the system refuses, 20 ms apart."""


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; rename it to `path` on success, remove it on any error.

    The temporary name keeps the suffix, since writers choose a format by it. Whatever a writer says of a disk that
    fails it, Python's or one in C++, comes out as an OSError that names `path`.
    """
    beside = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield beside
        _rename(beside, path)
    except OSError as error:
        raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(path)) from error
    except RuntimeError as error:
        raise _from_cpp(error, path) from error
    finally:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)


def _rename(source: Path, target: Path) -> None:
    """Windows refuses while somebody reads the target, as the panel does five times a second."""
    for _ in range(RENAMED_WITHIN):
        with contextlib.suppress(PermissionError):
            source.replace(target)
            return
        time.sleep(0.02)
    source.replace(target)


def _from_cpp(error: RuntimeError, path: Path) -> OSError:
    """Blender puts the system's words for what went wrong into a RuntimeError."""
    words = " ".join(str(error).split())
    code = next((code for code in errno.errorcode if os.strerror(code) in words), errno.EIO)
    return OSError(code, words if code == errno.EIO else os.strerror(code), str(path))
