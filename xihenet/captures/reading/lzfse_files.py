"""Bytes that Apple's LZFSE has packed, unpacked by the package lzfse, and never more of them than were expected.

The package takes as much memory as a file asks for: a block of fifty bytes may stand for 27 MB. So the blocks are
walked first, by their headers (lzfse_internal.h), and what they say in all must be what is expected. A block of one
kind may still lie, so that some blocks are unpacked at a time, until all that came is as long as they said.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

RAW, LZVN, LZFSE_1, LZFSE_2, END = b"bvx-", b"bvxn", b"bvx1", b"bvx2", b"bvx$"
SIZE_OF_HEADER_1 = 772
BLOCKS_AT_A_TIME = 8  # Each of them at most 27 MB: 10,000 matches of 2,359 and 315 bytes
MOST_BLOCKS = 512
EXTRA = "pip install 'xihe-blender[captures]'"


def unpack_lzfse(content: bytes, name: str, most_bytes: int) -> bytes:
    """What `content` holds, at most `most_bytes`.

    ValueError that begins with `name` if it is no LZFSE, is cut short, or holds more; ImportError without the package.
    """
    try:
        import lzfse
    except ImportError as error:
        raise ImportError(f"the depth of Record3D is unpacked by lzfse: {EXTRA}") from error
    blocks = list(_blocks(content, name))
    said = sum(n for n, _ in blocks)
    if said > most_bytes:
        raise ValueError(f"{name}: it says that it unpacks to {said} bytes: expected at most {most_bytes}")
    unpacked = b""
    for first in range(0, len(blocks), BLOCKS_AT_A_TIME):
        some = blocks[: first + BLOCKS_AT_A_TIME]
        n_bytes = sum(n for n, _ in some)
        try:
            unpacked = lzfse.decompress(content[: some[-1][1]] + END) if n_bytes else b""
        except (lzfse.error, MemoryError, ValueError):
            raise ValueError(f"{name}: expected LZFSE, and could not unpack it: copy the file again") from None
        if len(unpacked) != n_bytes:
            raise ValueError(f"{name}: it unpacks to another size than it says: copy the file again")
    return bytes(unpacked)


def _blocks(content: bytes, name: str) -> Iterator[tuple[int, int]]:
    """Bytes that each block unpacks to, as it says, and where it ends. ValueError where the last is no end."""
    at, n_blocks = 0, 0
    while (magic := content[at : at + 4]) != END:
        n_blocks += 1
        try:
            n_bytes, size = _block(magic, content, at)
        except (struct.error, KeyError):
            raise ValueError(f"{name}: expected LZFSE that is not cut short: copy the file again") from None
        if n_blocks > MOST_BLOCKS:
            raise ValueError(f"{name}: it has more than {MOST_BLOCKS} blocks of LZFSE, which no picture has")
        at += size
        yield n_bytes, at


def _block(magic: bytes, content: bytes, at: int) -> tuple[int, int]:
    """Bytes unpacked and packed, header included. KeyError for no block, struct.error for one that is cut short."""
    (n_bytes,) = struct.unpack_from("<I", content, at + 4)
    if magic == RAW:
        return n_bytes, 8 + n_bytes
    if magic in (LZVN, LZFSE_1):
        (n_packed,) = struct.unpack_from("<I", content, at + 8)
        return n_bytes, n_packed + (12 if magic == LZVN else SIZE_OF_HEADER_1)
    if magic != LZFSE_2:
        raise KeyError(magic)
    first, second, third = struct.unpack_from("<QQQ", content, at + 8)
    n_literals, n_matches, n_header = (first >> 20) & 0xFFFFF, (second >> 40) & 0xFFFFF, third & 0xFFFFFFFF
    return n_bytes, n_header + n_literals + n_matches
