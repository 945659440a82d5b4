"""The manifest of a folder: whose is it? Work is taken up only where the same work was left.

All that decides its numbers (settings, versions, content of files) is written down before anything else. A folder that
holds something else is refused, not mixed and not overwritten.
"""

from __future__ import annotations

import contextlib
import functools
import glob
import hashlib
import json
import os
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import write_json
from xihenet.io.json_files import read_json

WORK = "work"  # the kind of work, where several keep a file of the same name; missing in files of before
HELD = "held"  # a file that is locked while somebody is at work
NOT_COMPARED = "software"  # written down for the reader alone
MOST_READ_BYTES = 10**9  # A second or two; baked caches of many gigabytes are read at their ends
END_BYTES = 2**16
WORDS = {
    "blend_sha256": "scene file",
    "linked_sha256": "library, image or other file that the scene reads",
    "weights": "training of its networks or code of an estimator",
    "others": "choice of other estimators",
    "effect_choices": "choice of effects",
    "between_estimates": "light between estimates",
    "n_anchors": "number of anchors",
    "machine": "machine or render device",
}


@dataclass(frozen=True)
class FolderManifest:
    """A folder, and what is to be done in it."""

    folder: Path
    file: Path  # in the folder; holds `provenance`, and belongs to nothing but this kind of work
    what: str  # the kind of work, as in "holds a run with another seed"
    provenance: dict[str, Any]  # all that decides the numbers, as JSON holds it; its "settings" are compared one by one
    results: Sequence[Path] = ()  # where they are there and `file` is not, the folder is somebody else's

    def check(self) -> bool:
        """Whether the folder is taken already, for the same; UserError if it holds anything else."""
        if self.folder.exists() and not self.folder.is_dir():
            raise UserError(f"{self.folder} is a file: give --out a folder")
        if self.file.exists():
            self._check_is_the_same()
            return True
        for file in self.results:
            if file.exists():
                raise UserError(
                    f"{file} is there and not from {self.what} that can be resumed: choose another folder for --out"
                )
        return False

    def take(self) -> bool:
        """Check, and write down what it is for; whether that was so before. UserError also if it cannot be written."""
        if self.check():
            return True
        try:
            write_json(self.file, self.provenance)
        except OSError as error:
            raise self._cannot_write(error) from error
        return False

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Take it, and keep all others from work in it during the block; UserError as of `take`, or where one is at it.

        All who work in a folder do so within this. Of two who come at once the first takes it and the other is refused.
        """
        self.check()
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            lock = self.file.with_name(HELD).open("ab")
        except OSError as error:
            raise self._cannot_write(error) from error
        with lock:
            if not take_lock(lock):
                raise self.under_way()
            try:
                self.take()
            except UserError:
                with contextlib.suppress(OSError):  # Windows keeps what is open.
                    self.file.with_name(HELD).unlink()
                raise
            yield

    @property
    def is_held(self) -> bool:
        """Whether somebody is at work in the folder."""
        return is_locked(self.file.with_name(HELD))

    def under_way(self) -> UserError:
        return UserError(
            f"{self.what} is under way in {self.folder}: wait for its end, or choose another folder for --out"
        )

    def _cannot_write(self, error: OSError) -> UserError:
        return UserError(f"cannot write to {self.folder} ({error.strerror}): choose another folder for --out")

    def _check_is_the_same(self) -> None:
        try:
            kept = read_json(self.file)
        except ValueError:
            kept = None
        if not isinstance(kept, dict) or not VERSIONS.keys() & self.provenance.keys() & kept.keys():
            raise UserError(
                f"{self.file} is damaged, so it is not known what {self.folder} holds: choose another folder for "
                "--out, or delete that one"
            )
        held = kept.get(WORK, self.what)
        if held != self.what:
            raise UserError(
                f"{self.folder} holds {held}, not {self.what}: choose another folder for --out, or delete that one"
            )
        different = differences(kept, json.loads(json.dumps(self.provenance)))
        if different:
            other = "other" if re.fullmatch(r"\w+s", different[0]) else "another"
            raise UserError(
                f"{self.folder} holds {self.what} with {other} {', '.join(different)}: choose another folder for "
                "--out, or delete that one"
            )


def is_locked(path: Path) -> bool:
    """Whether a living process holds the lock; False if there is no such file."""
    try:
        with path.open("r+b") as file:
            return not take_lock(file)
    except OSError:
        return False


def take_lock(file: IO[Any]) -> bool:
    """Lock `file` for as long as this process keeps it open; False if another has it.

    True also where the file system knows no locks: whoever else is at work there is not seen.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


def differences(kept: dict[str, Any], wanted: dict[str, Any]) -> list[str]:
    """In words: the versions if one differs, since settings have other names then; else the names of what differs."""
    versions = [said for name, said in VERSIONS.items() if kept.get(name) != wanted.get(name)]
    if versions:
        return list(dict.fromkeys(versions))
    of_kept = kept.get("settings")
    settings = _other_names(of_kept if isinstance(of_kept, dict) else {}, wanted.get("settings", {}))
    others = _other_names({**kept, "settings": None}, {**wanted, "settings": None})
    return [WORDS.get(name, name.replace("_", " ")) for name in (*settings, *others)]


def contents_sha256(patterns: Iterable[str]) -> str | None:
    """SHA-256 of the names and contents of all files that match absolute patterns of `glob`.

    Where they hold more than MOST_READ_BYTES together, of those larger than two ends the size, the second of the last
    change and both ends stand for the content. None where there is no such file, or none that can be read.
    """
    states = {}
    # By the name first, then the nearest folder: in folders that were moved apart the order stays.
    for path in sorted({path for pattern in patterns for path in matching(pattern)}, key=lambda path: path.parts[::-1]):
        with contextlib.suppress(OSError):
            states[path] = path.stat()
    are_too_many = sum(state.st_size for state in states.values()) > MOST_READ_BYTES
    whole, digest = hashlib.sha256(), None
    for path, state in states.items():
        of_content = _ends_digest if are_too_many and state.st_size > 2 * END_BYTES else _content_digest
        with contextlib.suppress(OSError):  # Nor can Blender read it.
            content = of_content(path, state.st_size, state.st_mtime_ns)
            whole.update(os.fsencode(path.name) + b"/" + content)
            digest = whole.hexdigest()
    return digest


@functools.cache
def _content_digest(path: Path, _size: int, _mtime_ns: int) -> bytes:
    """Volumes are large, and a batch asks about each of its units more than once."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


@functools.cache
def _ends_digest(path: Path, size: int, mtime_ns: int) -> bytes:
    # By the second: some disks and networks keep no more of it.
    digest = hashlib.sha256(f"{size} {mtime_ns // 10**9}".encode())
    with path.open("rb") as file:
        digest.update(file.read(END_BYTES))
        file.seek(-END_BYTES, os.SEEK_END)
        digest.update(file.read(END_BYTES))
    return digest.digest()


def absolute_pattern(pattern: str, folder: Path) -> str:
    """A pattern of `glob` that may be relative to `folder`."""
    return str(Path(glob.escape(str(folder)), pattern))


def matching(pattern: str) -> list[Path]:
    """All files and folders that match an absolute pattern of `glob`; none where a name is longer than there can be."""
    path = Path(pattern)
    below = str(path.relative_to(path.anchor))
    with contextlib.suppress(OSError):
        return [] if below == "." else list(Path(path.anchor).glob(below))
    return []


VERSIONS = {"xihe": "version of xihe", "format": "version of xihe", "blender": "version of Blender"}


def _other_names(kept: dict[str, Any], wanted: dict[str, Any]) -> list[str]:
    return [
        name for name in {**wanted, **kept} if name not in (NOT_COMPARED, WORK) and kept.get(name) != wanted.get(name)
    ]
