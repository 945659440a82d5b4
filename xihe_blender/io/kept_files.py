"""Kept pieces of a run: what an earlier part of it has left in its folder, or makes again where a file is damaged.

A disk that was full, a copy that was cut short or a hand that edited leaves files that are there and say nothing. All
that a run keeps can be made again, so none of them stops it: a warning is logged that names the file, which the command
line shows, and its work is done once more.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TypeVar

from xihe_blender.io.json_records import Json, Record, as_json, read_record
from xihe_blender.io.outputs import write_json
from xihenet.io.json_files import read_json

Kept = TypeVar("Kept")
Step = TypeVar("Step")

DAMAGED = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""What readers raise for content that is not what they wrote."""


def read_kept(path: Path, read: Callable[[Path], Kept]) -> Kept | None:
    """What `read` makes of the file; None if it is not there or is damaged. OSError if it cannot be opened."""
    try:
        return read(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except DAMAGED:
        logging.getLogger(__name__).warning("%s is damaged and is made again", path)
        return None


def kept_json(path: Path, read: Callable[[Json], Kept]) -> Kept | None:
    """What `read` makes of the JSON in the file, as `read_kept`."""
    return read_kept(path, lambda file: read(read_json(file)))


def kept_record(kind: type[Record], path: Path, is_whole: Callable[[Record], bool] = lambda _: True) -> Record | None:
    """The record in the JSON file, as `read_kept`; one that is not whole is damaged."""

    def read(file: Path) -> Record:
        record = read_record(kind, file)
        if not is_whole(record):
            raise ValueError(f"{file}: expected all parts of {kind}")
        return record

    return read_kept(path, read)


def kept_or_done(
    kind: type[Record],
    path: Path,
    job: Generator[Step, None, Record],
    is_whole: Callable[[Record], bool] = lambda _: True,
) -> Generator[Step, None, Record]:
    """A job: the record in the JSON file, which `job` makes if it is not there, is damaged or is not whole."""
    kept = kept_record(kind, path, is_whole)
    if kept is None:
        write_json(path, as_json((yield from job)))
        kept = read_record(kind, path)
    return kept
