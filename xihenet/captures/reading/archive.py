"""Members of a zip file that anyone may have written, read one at a time and never unpacked to disk.

What a member says of its size is judged before it is unpacked, and what is read is bounded whatever it says. Names that
lead elsewhere are refused although nothing is written by them: no app makes such a file.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

MAGIC = b"PK"
WAYS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # LZMA takes the memory that a file asks for
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, LookupError)
"""What zipfile raises for files that are none, are cut short, or are encrypted."""


@dataclass(frozen=True, eq=False)
class Archive:
    """An open zip file and its members by name; it is closed when nothing refers to it any more."""

    path: Path
    file: zipfile.ZipFile
    members: Mapping[str, zipfile.ZipInfo]

    def read(self, name: str, most_bytes: int) -> bytes:
        """The content of a member. ValueError if it is not there, is longer, or is broken."""
        member = self.members.get(name)
        if member is None:
            raise ValueError(f"{self.path}: {name} is missing")
        if member.file_size > most_bytes or member.compress_type not in WAYS:
            raise ValueError(
                f"{self.path}: {name} says that it has {member.file_size} bytes, packed by method "
                f"{member.compress_type}: expected at most {most_bytes}, and no method but deflate"
            )
        try:
            with self.file.open(member) as opened:
                content = opened.read(most_bytes + 1)
        except BROKEN as error:
            raise ValueError(f"{self.path}: {name} cannot be read ({error}): copy the file again") from None
        if len(content) != member.file_size:
            raise ValueError(f"{self.path}: {name} is not as long as it says: copy the file again")
        return content


def open_archive(path: Path) -> Archive:
    """OSError if the file cannot be read; ValueError if it is no zip file, or has names that lead elsewhere."""
    try:
        file = zipfile.ZipFile(path)
    except BROKEN as error:
        raise ValueError(f"{path}: no whole zip file ({error}): copy it again") from None
    members = {member.filename: member for member in file.infolist() if not member.is_dir()}
    for name in members:
        parts = PurePosixPath(name.replace("\\", "/"))
        if parts.is_absolute() or ".." in parts.parts or ":" in name:
            file.close()
            raise ValueError(f"{path}: {name!r:.80} lies outside of it: a recording has only what is inside")
    return Archive(path, file, members)
