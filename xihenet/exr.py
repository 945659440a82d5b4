"""How are OpenEXR files read and written with NumPy and zlib alone?

Chosen: what Blender writes and what we write, scan lines without compression or with ZIP, in one part or many, after
the file layout at openexr.com. Rejected: the OpenEXR package. Its library has the same symbols as the one that a
whole Blender brings, the two are mixed up inside that process, and it crashes. Files of other programs with other
compressions are left to that package by `frame_files`, outside Blender. Not here: tiles, deep data, subsampling.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.records import ArrayF32

MAGIC = b"\x76\x2f\x31\x01"
PIXEL_TYPES: tuple[str, ...] = ("<u4", "<f2", "<f4")
"""NumPy's names of UINT, HALF and FLOAT, at the numbers that stand for them."""

COMPRESSIONS = ("none", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB")
ROWS_IN_CHUNK = {"none": 1, "ZIPS": 1, "ZIP": 16}
"""Rows that are stored together, for the compressions that can be read here."""

TILED, LONG_NAMES, DEEP, MULTI_PART = 0x200, 0x400, 0x800, 0x1000
MAX_SHORT_NAME = 31
ZLIB_LEVEL = 4
"""Of 256x192 pixels of noise, levels 1 to 4 take the same time and space."""

_Channels = list[tuple[str, np.dtype[Any]]]


class OtherExr(ValueError):
    """A good OpenEXR file in a form that is not read here."""


@dataclass(frozen=True)
class _Part:
    """One part of a file: the channels in the order in which each row holds them."""

    channels: _Channels
    compression: str
    width: int
    height: int
    first_row: int

    @property
    def row_bytes(self) -> int:
        return self.width * sum(kind.itemsize for _, kind in self.channels)

    @property
    def n_chunks(self) -> int:
        return math.ceil(self.height / ROWS_IN_CHUNK[self.compression])


def read_exr(path: Path) -> dict[str, ArrayF32]:
    """Every channel as (H, W) float32 by its full name, such as "ViewLayer.Combined.R"; row 0 is the top.

    All parts come as one table: Blender 4.x writes all passes as one part, 5.x one part for each.

    Raises
    ------
    OSError : if the file cannot be opened
    OtherExr : if it is tiled, deep, subsampled or compressed otherwise than with ZIP
    ValueError : if it is no OpenEXR file, is cut short or is broken
    """
    content = path.read_bytes()
    if not content.startswith(MAGIC):
        raise ValueError(f"{path}: expected an OpenEXR file, it begins with {content[:4]!r}")
    try:
        return _read(content)
    except OtherExr as error:
        raise OtherExr(f"{path}: {error}") from error
    except (ValueError, KeyError, IndexError, OverflowError, struct.error, zlib.error) as error:
        raise ValueError(f"{path}: its pixels cannot be read, it may be cut short: save it again") from error


def write_exr(path: Path, channels: Mapping[str, NDArray[Any]], *, compression: str = "ZIP") -> None:
    """Write channels (H, W) of float16, float32 or uint32 as one part; `compression` is "none", "ZIPS" or "ZIP".

    ValueError without a channel, for other types or for sizes that differ; OSError if the file cannot be written.
    """
    arrays = {name: np.asarray(values) for name, values in sorted(channels.items())}
    sizes = {values.shape for values in arrays.values()}
    if len(sizes) != 1 or len(next(iter(sizes))) != 2 or 0 in next(iter(sizes)):
        raise ValueError(f"write_exr: expected channels of one size (H, W), got {sorted(sizes)}")
    height, width = next(iter(sizes))
    kinds = [(name, _stored_kind(name, values)) for name, values in arrays.items()]
    rows = [np.ascontiguousarray(arrays[name], kind).view(np.uint8).reshape(height, -1) for name, kind in kinds]
    part = _Part(kinds, compression, width, height, 0)
    path.write_bytes(_file(part, np.concatenate(rows, axis=1)))


# ------------------------------------------------------------------------------------------------------------- reading


def _read(content: bytes) -> dict[str, ArrayF32]:
    flags = struct.unpack_from("<i", content, 4)[0]
    if flags & (TILED | DEEP):
        raise OtherExr("tiles and deep pixels cannot be read")
    is_multi_part = bool(flags & MULTI_PART)
    parts, at = _parts(content, 8, is_multi_part)
    channels: dict[str, ArrayF32] = {}
    for number, part in enumerate(parts):
        offsets = np.frombuffer(content, "<u8", part.n_chunks, at).tolist()
        at += 8 * part.n_chunks
        rows = _rows(content, part, offsets, number if is_multi_part else None)
        channels |= _channels_of(part, rows)
    return channels


def _parts(content: bytes, at: int, is_multi_part: bool) -> tuple[list[_Part], int]:
    """All headers, and where they end."""
    parts: list[_Part] = []
    while not parts or (is_multi_part and content[at]):
        attributes: dict[str, bytes] = {}
        while content[at]:
            name, at = _text(content, at)
            _, at = _text(content, at)
            size = struct.unpack_from("<i", content, at)[0]
            if size < 0:
                raise ValueError("an attribute has a negative size")
            attributes[name] = content[at + 4 : at + 4 + size]
            at += 4 + size
        at += 1
        parts.append(_part(attributes))
    return parts, at + is_multi_part


def _text(content: bytes, at: int) -> tuple[str, int]:
    end = content.index(b"\0", at)
    return content[at:end].decode(), end + 1


def _part(attributes: Mapping[str, bytes]) -> _Part:
    if attributes.get("type", b"scanlineimage") != b"scanlineimage":
        raise OtherExr(f"parts of type {attributes['type'].decode(errors='replace')} cannot be read")
    compression = COMPRESSIONS[attributes["compression"][0]]
    if compression not in ROWS_IN_CHUNK:
        raise OtherExr(f"its compression, {compression}, cannot be read")
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    if right < left or bottom < top:
        raise ValueError("the picture has no pixels")
    return _Part(_channel_list(attributes["channels"]), compression, right - left + 1, bottom - top + 1, top)


def _channel_list(content: bytes) -> _Channels:
    channels, at = [], 0
    while content[at]:
        name, at = _text(content, at)
        kind, _, across, down = struct.unpack_from("<4i", content, at)
        if (across, down) != (1, 1):
            raise OtherExr("subsampled channels cannot be read")
        channels.append((name, np.dtype(PIXEL_TYPES[kind])))
        at += 16
    return channels


def _rows(content: bytes, part: _Part, offsets: list[int], number: int | None) -> NDArray[np.uint8]:
    """(H, row_bytes) of one part; chunks may stand in any order. `number` of the part where there are many."""
    # A header may promise more than there can be: no compression makes anything a thousand times smaller.
    if part.height * part.row_bytes > 1100 * len(content):
        raise ValueError("the pixels are missing")
    rows = np.empty((part.height, part.row_bytes), np.uint8)
    n_together = ROWS_IN_CHUNK[part.compression]
    for chunk, start in enumerate(offsets):
        at = start
        if number is not None:
            if struct.unpack_from("<i", content, at)[0] != number:
                raise ValueError("a chunk belongs to another part")
            at += 4
        row, size = struct.unpack_from("<2i", content, at)
        first = n_together * chunk
        if row - part.first_row != first or size < 0:
            raise ValueError("a chunk is not where it belongs")
        packed = content[at + 8 : at + 8 + size]
        if len(packed) != size:
            raise ValueError("a chunk is cut short")
        target = rows[first : first + n_together].reshape(-1)
        target[:] = _unpacked(packed, len(target))
    return rows


def _unpacked(chunk: bytes, size: int) -> NDArray[np.uint8]:
    """`size` bytes of pixels; a chunk that would not get smaller is stored as it is."""
    if len(chunk) == size:
        return np.frombuffer(chunk, np.uint8)
    steps = np.frombuffer(zlib.decompressobj().decompress(chunk, size), np.uint8)
    if len(steps) != size:
        raise ValueError("a chunk is cut short")
    moved = steps - np.uint8(128)
    moved[0] = steps[0]
    halves = np.cumsum(moved, dtype=np.uint8)
    pixels = np.empty(size, np.uint8)
    pixels[0::2], pixels[1::2] = halves[: (size + 1) // 2], halves[(size + 1) // 2 :]
    return pixels


def _channels_of(part: _Part, rows: NDArray[np.uint8]) -> dict[str, ArrayF32]:
    channels, at = {}, 0
    for name, kind in part.channels:
        end = at + part.width * kind.itemsize
        pixels = np.ascontiguousarray(rows[:, at:end]).view(kind).astype(np.float32, copy=False)
        # The same for every NaN: one that signals would warn at the first cast, far from here.
        pixels[np.isnan(pixels)] = np.nan
        channels[name] = pixels
        at = end
    return channels


# ------------------------------------------------------------------------------------------------------------- writing


def _stored_kind(name: str, values: NDArray[Any]) -> np.dtype[Any]:
    kind = values.dtype.newbyteorder("<")
    if kind.str not in PIXEL_TYPES:
        raise ValueError(f"write_exr: expected float16, float32 or uint32, channel {name} has {values.dtype}")
    return kind


def _file(part: _Part, rows: NDArray[np.uint8]) -> bytes:
    n_together = ROWS_IN_CHUNK[part.compression]
    chunks = []
    for first in range(0, part.height, n_together):
        packed = _packed(rows[first : first + n_together].reshape(-1), part.compression)
        chunks.append(struct.pack("<2i", first, len(packed)) + packed)
    has_long_names = any(len(name.encode()) > MAX_SHORT_NAME for name, _ in part.channels)
    start = MAGIC + struct.pack("<i", 2 | (LONG_NAMES if has_long_names else 0)) + _header(part)
    ends = np.cumsum([len(start) + 8 * len(chunks), *(len(chunk) for chunk in chunks)])
    return start + ends[:-1].astype("<u8").tobytes() + b"".join(chunks)


def _packed(pixels: NDArray[np.uint8], compression: str) -> bytes:
    """The bytes of one chunk, even ones before odd ones, as differences, deflated; as they are if no shorter."""
    if compression == "none":
        return pixels.tobytes()
    halves = np.concatenate([pixels[0::2], pixels[1::2]])
    steps = halves.copy()
    steps[1:] -= halves[:-1]
    steps[1:] += np.uint8(128)
    packed = zlib.compress(steps, ZLIB_LEVEL)
    return packed if len(packed) < len(pixels) else pixels.tobytes()


def _header(part: _Part) -> bytes:
    kinds = b"".join(
        name.encode() + b"\0" + struct.pack("<4i", PIXEL_TYPES.index(kind.str), 0, 1, 1) for name, kind in part.channels
    )
    window = struct.pack("<4i", 0, 0, part.width - 1, part.height - 1)
    attributes = [
        ("channels", "chlist", kinds + b"\0"),
        ("compression", "compression", bytes([COMPRESSIONS.index(part.compression)])),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
    ]
    written = [f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value for name, kind, value in attributes]
    return b"".join(written) + b"\0"
