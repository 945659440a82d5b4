"""Errors of the user's input, said in one line that names the fix."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator
from pathlib import Path


class UserError(Exception):
    """A mistake of the user's. Command line: the message and exit 2. Operator: the message in red and CANCELLED."""


@contextlib.contextmanager
def of_file(file: Path) -> Iterator[None]:
    """A UserError from within names `file` first: of several scenes, most are called "Scene"."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{file}: {error}") from error


def format_disk_error(error: OSError) -> str:
    """What is wrong with which file, and the fix; the words of an error that was raised by ourselves, which have it."""
    if error.errno is None:
        return str(error)
    place = "" if error.filename is None else f"{error.filename}: "
    fix = "free some space" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "fix that"
    return f"{place}{error.strerror or error}; {fix}"
