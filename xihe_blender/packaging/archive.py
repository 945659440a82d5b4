"""Zip files that are the same to the last byte whenever they are made from the same contents."""

from __future__ import annotations

import io
import zipfile

Contents = dict[str, bytes]
"""{name inside, with forward slashes: content} of all files of an archive."""

_TIME = (1980, 1, 1, 0, 0, 0)
"""The earliest that a zip can tell."""
_COMPRESSED = (".whl", ".png")


def packed(contents: Contents) -> bytes:
    """The zip of `contents`: sorted, without times and owners; what is compressed already is stored as it is."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in sorted(contents.items()):
            entry = zipfile.ZipInfo(name, _TIME)
            entry.create_system = 3  # Unix, on every system, so that the rights below are understood.
            entry.external_attr = 0o100644 << 16
            entry.compress_type = zipfile.ZIP_STORED if name.endswith(_COMPRESSED) else zipfile.ZIP_DEFLATED
            archive.writestr(entry, content, compresslevel=9)
    return buffer.getvalue()
