"""OpenEXR files, read and written with NumPy and zlib alone.

Chosen: what Blender writes and what we write, scan lines without compression or with ZIP, in one part or many, after
the file layout at openexr.com. Rejected: the OpenEXR package. Its library has the same symbols as the one that a
whole Blender brings, the two are mixed up inside that process, and it crashes. Files of other programs with other
compressions are left to that package by `frame_files`, outside Blender. Not here: tiles, deep data, subsampling.
"""

from __future__ import annotations

import contextlib
import math
import struct
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from xihenet.io.picture_size import LONGEST_SIDE, TooLarge, picked_pixels
from xihenet.records import ArrayF32, ArrayF64

MAGIC = b"\x76\x2f\x31\x01"
PIXEL_TYPES: tuple[str, ...] = ("<u4", "<f2", "<f4")  # NumPy's names of UINT, HALF and FLOAT, by their numbers

# At the numbers that stand for them; newer ones are called by their number.
COMPRESSIONS = (
    "none", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB", "HTJ2K256", "HTJ2K32", "LJ2K", "ZSTD"
)  # fmt: skip

ROWS_IN_CHUNK = {"none": 1, "ZIPS": 1, "ZIP": 16}  # Rows that are stored together, where they can be read here
LARGEST_CHUNK = 2**28  # Bytes, unpacked: 16 rows of 500 channels that are 8192 pixels wide
TILED, LONG_NAMES, DEEP, MULTI_PART = 0x200, 0x400, 0x800, 0x1000
MAX_SHORT_NAME = 31

UNPACKED_TOGETHER = 256  # Rows without compression that are read at once: one by one takes longer than their pixels do

CHECKSUM = "xiheCrc32"
"""Attribute with CRC-32 of all after the table of offsets, which we write where pixels are not compressed: such files
have nothing else to tell a damaged one by."""

ZLIB_LEVEL = 4  # Of 256x192 pixels of noise, levels 1 to 4 take the same time and space

CHROMATICITIES: Mapping[str, tuple[float, ...]] = {
    "lin_rec709_scene": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
    "lin_rec2020_scene": (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329),
    "lin_ap1_scene": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767),
}
"""x and y of red, green, blue and white, by Color Interop ID."""

SAME_PRIMARIES = 0.002

HEADER_BYTES = 2**16
"""As many are read of a file whose header alone is asked for; those with more are read whole."""

Attribute = str | int | float | ArrayF64
"""What a header says of its picture: text, a whole number of 32 bits, a float64, or an array of one of `SHAPES`."""

SHAPES: Mapping[str, tuple[int, ...]] = {"v2d": (2,), "v3d": (3,), "m33d": (3, 3), "m44d": (4, 4)}

_T = TypeVar("_T")
_Channels = list[tuple[str, np.dtype[Any]]]


class OtherExr(ValueError):
    """A good OpenEXR file in a form that is not read here."""


@dataclass(frozen=True)
class _Part:
    """One part of a file: channels in the order in which each row holds them; `other` is why it is not read here,
    and `checksum` what we wrote of pixels that are not compressed, None elsewhere."""

    channels: _Channels
    compression: str
    width: int
    height: int
    first_row: int
    displayed: tuple[int, int]  # (H, W) of the whole picture, of which its pixels may be a part
    other: str = ""
    checksum: bytes | None = None

    @property
    def row_bytes(self) -> int:
        return self.width * sum(kind.itemsize for _, kind in self.channels)

    @property
    def n_chunks(self) -> int:
        return math.ceil(self.height / ROWS_IN_CHUNK[self.compression])


def exr_sizes(path: Path) -> dict[str, tuple[int, int]]:
    """(H, W) of every channel by its full name, as the header says it, of any OpenEXR file; raises as `read_exr`."""
    return _of_header(path, lambda content: _by_channel(content, lambda part: (part.height, part.width)))


def exr_displayed_sizes(path: Path) -> dict[str, tuple[int, int]]:
    """(H, W) of the picture that every channel shows all of, or a part, or more; raises as `read_exr`."""
    return _of_header(path, lambda content: _by_channel(content, lambda part: part.displayed))


def exr_attributes(path: Path) -> dict[str, Attribute]:
    """What the first header says beside its channels and its checksum, in the types of `Attribute`; no others.

    Raises as `read_exr`.
    """
    return _of_header(path, _attributes_of)


def exr_colour_space(path: Path) -> str:
    """The Color Interop ID of the first header, as Blender writes from 5.0 on, such as "lin_ap1_scene"; "" without.

    Other programs, and files of the ACES standard, give chromaticities instead, or beside "unknown": then it is that of
    these, or says that it is another one's. Raises as `read_exr`.
    """
    header = _of_header(path, lambda content: _header_at(content, 8)[0])
    space = header.get("colorInteropID", ("", b""))[1].decode(errors="replace")
    if space not in ("", "unknown") or "chromaticities" not in header:
        return space
    with _errors_of(path):
        found = struct.unpack("<8f", header["chromaticities"][1])
    told = (space for space, known in CHROMATICITIES.items() if np.allclose(found, known, rtol=0, atol=SAME_PRIMARIES))
    return next(told, f"of primaries at {', '.join(f'{one:.4g}' for one in found[:6])}")


def _by_channel(content: bytes, of: Callable[[_Part], _T]) -> dict[str, _T]:
    """What each channel's part says; of parts with channels of one name the first."""
    found: dict[str, _T] = {}
    for part in _parts(content)[0]:
        found |= {name: of(part) for name, _ in part.channels if name not in found}
    return found


def _of_header(path: Path, read: Callable[[bytes], _T]) -> _T:
    """What `read` finds in the first bytes of a file, or in all of them where these do not hold the whole header."""
    with path.open("rb") as file:
        content = file.read(HEADER_BYTES)
        try:
            with _errors_of(path):
                return read(_checked(path, content))
        except ValueError:
            content += file.read()
            if len(content) <= HEADER_BYTES:
                raise
    with _errors_of(path):
        return read(content)


def read_exr(
    path: Path, names: Collection[str] | None = None, *, most_pixels: int | None = None
) -> dict[str, ArrayF32]:
    """Channels as (H, W) float32 by their full names, such as "ViewLayer.Combined.R"; row 0 is the top.

    All parts come as one table: Blender 4.x writes all passes as one part, 5.x one part for each. Of several channels
    of one name, as parts for two eyes have them, the first counts. Of `names`, those that are not there are left out,
    None reads all; parts of more than `most_pixels` are thinned, see `picked_pixels`.

    OSError if the file cannot be opened; OtherExr if it is tiled, deep, subsampled or compressed otherwise than with
    ZIP; ValueError if it is no OpenEXR file, is cut short, is broken or has rows of gigabytes.
    """
    content = _content(path)
    with _errors_of(path):
        return {name: _as_float32(pixels) for name, pixels in _stored_channels(content, names, most_pixels)}


def read_stored_exr(path: Path) -> tuple[dict[str, Attribute], dict[str, NDArray[Any]]]:
    """What `exr_attributes` says, and all channels (H, W) in the types in which they are stored; raises as `read_exr`.

    For files that are read by the thousand: numbers that a caller looks up by their bits need no other type first.
    """
    content = _content(path)
    with _errors_of(path):
        found = _stored_channels(content, None, None)
        return _attributes_of(content), {n: _as_float32(p) if p.dtype == np.float32 else p for n, p in found}


def _stored_channels(
    content: bytes, names: Collection[str] | None, most_pixels: int | None
) -> Iterator[tuple[str, NDArray[Any]]]:
    parts, at = _parts(content)
    for part in parts:
        if part.other:
            raise OtherExr(part.other)
    is_multi_part = bool(_flags(content) & MULTI_PART)
    if parts[0].checksum not in (None, _checksum(content[at + 8 * parts[0].n_chunks :])):
        raise ValueError("the pixels are not those that were written")
    known: set[str] = set()
    for number, part in enumerate(parts):
        offsets = np.frombuffer(content, "<u8", part.n_chunks, at).tolist()
        at += 8 * part.n_chunks
        chunks = _chunks(content, part, offsets, number if is_multi_part else None)
        wanted = [name for name, _ in part.channels if name not in known and (names is None or name in names)]
        known.update(wanted)
        if wanted:
            yield from _channels_of(part, chunks, wanted, most_pixels).items()


def _as_float32(pixels: NDArray[Any]) -> ArrayF32:
    values = pixels.astype(np.float32, copy=False)
    # The same for every NaN: one that signals would warn at the first cast, far from here.
    values[np.isnan(values)] = np.nan
    return values


def write_exr(
    path: Path,
    channels: Mapping[str, NDArray[Any]],
    *,
    compression: str = "ZIP",
    attributes: Mapping[str, Attribute] | None = None,
) -> None:
    """Write channels (H, W) of float16, float32 or uint32 as one part; `compression` is "none", "ZIPS" or "ZIP".

    `attributes` are put into the header, arrays as rows of float64. ValueError without a channel, for other types or
    for sizes that differ; OSError if the file cannot be written.
    """
    said = [(name, *_stored_attribute(name, value)) for name, value in (attributes or {}).items()]
    arrays = {name: np.asarray(values) for name, values in sorted(channels.items())}
    sizes = {values.shape for values in arrays.values()}
    if len(sizes) != 1 or len(next(iter(sizes))) != 2 or 0 in next(iter(sizes)):
        raise ValueError(f"write_exr: expected channels of one size (H, W), got {sorted(sizes)}")
    height, width = next(iter(sizes))
    kinds = [(name, _stored_kind(name, values)) for name, values in arrays.items()]
    rows = [np.ascontiguousarray(arrays[name], kind).view(np.uint8).reshape(height, -1) for name, kind in kinds]
    part = _Part(kinds, compression, width, height, 0, (height, width))
    path.write_bytes(_file(part, np.concatenate(rows, axis=1), said))


def _content(path: Path) -> bytes:
    return _checked(path, path.read_bytes())


def _checked(path: Path, content: bytes) -> bytes:
    if not content.startswith(MAGIC):
        raise ValueError(f"{path}: expected an OpenEXR file, it begins with {content[:4]!r}")
    return content


@contextlib.contextmanager
def _errors_of(path: Path) -> Iterator[None]:
    """What goes wrong in the bytes of a file, as `read_exr` raises it."""
    try:
        yield
    except (OtherExr, TooLarge) as error:
        raise type(error)(f"{path}: {error}") from error
    except (ValueError, KeyError, IndexError, OverflowError, struct.error, zlib.error) as error:
        raise ValueError(f"{path}: its pixels cannot be read, it may be cut short: copy or save it again") from error


def _flags(content: bytes) -> int:
    return int(struct.unpack_from("<i", content, 4)[0])


def _parts(content: bytes) -> tuple[list[_Part], int]:
    """All headers, and where they end."""
    flags, at = _flags(content), 8
    is_multi_part = bool(flags & MULTI_PART)
    parts: list[_Part] = []
    while not parts or (is_multi_part and content[at]):
        stored, at = _header_at(content, at)
        parts.append(_part({name: value for name, (_, value) in stored.items()}, flags))
    return parts, at + is_multi_part


def _header_at(content: bytes, at: int) -> tuple[dict[str, tuple[str, bytes]], int]:
    """The type and the bytes of each attribute by name, and where the header ends."""
    stored: dict[str, tuple[str, bytes]] = {}
    while content[at]:
        name, at = _text(content, at)
        kind, at = _text(content, at)
        size = struct.unpack_from("<i", content, at)[0]
        value = content[at + 4 : at + 4 + size]
        if len(value) != size:
            raise ValueError("an attribute has a negative size, or is cut short")
        stored[name] = kind, value
        at += 4 + size
    return stored, at + 1


def _attributes_of(content: bytes) -> dict[str, Attribute]:
    stored, _ = _header_at(content, 8)
    found: dict[str, Attribute] = {}
    stored.pop(CHECKSUM, None)
    for name, (kind, value) in stored.items():
        if kind == "string":
            found[name] = value.decode()
        elif kind in ("int", "double"):
            found[name] = struct.unpack("<i" if kind == "int" else "<d", value)[0]
        elif kind in SHAPES:
            found[name] = np.frombuffer(value, "<f8").reshape(SHAPES[kind]).astype(np.float64)
    return found


def _stored_attribute(name: str, value: Attribute) -> tuple[str, bytes]:
    """Its type and its bytes."""
    if isinstance(value, str):
        return "string", value.encode()
    if isinstance(value, int):
        return "int", struct.pack("<i", value)
    if isinstance(value, float):
        return "double", struct.pack("<d", value)
    kind = next((kind for kind, shape in SHAPES.items() if shape == value.shape), None)
    if kind is None:
        raise ValueError(
            f"write_exr: attribute {name} has shape {value.shape}, expected one of {list(SHAPES.values())}"
        )
    return kind, value.astype("<f8").tobytes()


def _text(content: bytes, at: int) -> tuple[str, int]:
    end = content.index(b"\0", at)
    return content[at:end].decode(), end + 1


def _part(attributes: Mapping[str, bytes], flags: int) -> _Part:
    number = attributes["compression"][0]
    compression = COMPRESSIONS[number] if number < len(COMPRESSIONS) else f"number {number}"
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    if right < left or bottom < top:
        raise ValueError("the picture has no pixels")
    shown = struct.unpack("<4i", attributes.get("displayWindow", attributes["dataWindow"]))
    displayed = shown[3] - shown[1] + 1, shown[2] - shown[0] + 1
    channels, is_subsampled = _channel_list(attributes["channels"])
    kind = attributes.get("type", b"scanlineimage").decode(errors="replace")
    other = ""
    if flags & (TILED | DEEP):
        other = "tiles and deep pixels cannot be read"
    elif kind != "scanlineimage":
        other = f"parts of type {kind} cannot be read"
    elif compression not in ROWS_IN_CHUNK:
        other = f"its compression, {compression}, cannot be read"
    elif is_subsampled:
        other = "subsampled channels cannot be read"
    checksum = attributes.get(CHECKSUM) if compression == "none" else None
    size = right - left + 1, bottom - top + 1
    return _Part(channels, compression, *size, top, displayed, other, checksum)


def _channel_list(content: bytes) -> tuple[_Channels, bool]:
    """The channels, and whether any has fewer pixels than the part."""
    channels, at, is_subsampled = [], 0, False
    while content[at]:
        name, at = _text(content, at)
        kind, _, across, down = struct.unpack_from("<4i", content, at)
        is_subsampled |= (across, down) != (1, 1)
        channels.append((name, np.dtype(PIXEL_TYPES[kind])))
        at += 16
    return channels, is_subsampled


_Chunk = tuple[int, int, bytes]  # The first row, how many there are, and what they are packed into


def _chunks(content: bytes, part: _Part, offsets: list[int], number: int | None) -> Iterator[_Chunk]:
    """The chunks of one part from top to bottom, packed; `number` of the part where there are many."""
    size = part.height * part.row_bytes
    # A header may promise more than there can be: no compression makes anything a thousand times smaller.
    if size > 1100 * len(content):
        raise ValueError("the pixels are missing")
    if part.compression == "none":
        yield from _rows_as_they_are(content, part, offsets, number)
        return
    n_together = ROWS_IN_CHUNK[part.compression]
    if n_together * part.row_bytes > LARGEST_CHUNK:
        raise TooLarge(f"{n_together} of its rows take {n_together * part.row_bytes >> 20} MB: save fewer channels")
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
        yield first, min(n_together, part.height - first), packed


def _rows_as_they_are(content: bytes, part: _Part, offsets: list[int], number: int | None) -> Iterator[_Chunk]:
    """Chunks that are not packed, many at once: as of `_chunks`."""
    n_head = 2 if number is None else 3
    size = 4 * n_head + part.row_bytes
    for first in range(0, part.height, UNPACKED_TOGETHER):
        starts = offsets[first : first + UNPACKED_TOGETHER]
        if (np.diff(starts) == size).all():
            chunks = np.frombuffer(content, np.uint8, size * len(starts), starts[0]).reshape(-1, size)
        else:  # Rows may lie anywhere.
            chunks = np.stack([np.frombuffer(content, np.uint8, size, start) for start in starts])
        rows = part.first_row + np.arange(first, first + len(starts))
        expected = [] if number is None else [np.full_like(rows, number)]
        heads = np.ascontiguousarray(chunks[:, : 4 * n_head]).view("<i4")
        if (heads != np.stack([*expected, rows, np.full_like(rows, part.row_bytes)], axis=1)).any():
            raise ValueError("a chunk is not where it belongs")
        yield first, len(chunks), np.ascontiguousarray(chunks[:, 4 * n_head :]).tobytes()


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


def _channels_of(
    part: _Part, chunks: Iterable[_Chunk], wanted: Collection[str], most_pixels: int | None
) -> dict[str, NDArray[Any]]:
    """Unpacked chunk by chunk, so that no more is in memory than is asked for."""
    if max(part.height, part.width) > LONGEST_SIDE:  # Without channels a file of any size may say so.
        raise TooLarge(f"it has {part.width}x{part.height} pixels: save it with at most {LONGEST_SIDE} along a side")
    rows, columns = picked_pixels(part.height, part.width, most_pixels)
    channels = {name: np.empty((len(rows), len(columns)), kind) for name, kind in part.channels if name in wanted}
    is_whole = (len(rows), len(columns)) == (part.height, part.width)  # Then nothing is picked, which takes a copy.
    for first, n_rows, packed in chunks:
        start, end = (first, first + n_rows) if is_whole else np.searchsorted(rows, [first, first + n_rows])
        if start == end:
            continue
        lines = _unpacked(packed, n_rows * part.row_bytes).reshape(n_rows, part.row_bytes)
        lines = lines if is_whole else lines[rows[start:end] - first]
        at = 0
        for name, kind in part.channels:
            after = at + part.width * kind.itemsize
            if name in channels:
                values = np.ascontiguousarray(lines[:, at:after]).view(kind)
                channels[name][start:end] = values if is_whole else values[:, columns]
            at = after
    return channels


def _stored_kind(name: str, values: NDArray[Any]) -> np.dtype[Any]:
    kind = values.dtype.newbyteorder("<")
    if kind.str not in PIXEL_TYPES:
        raise ValueError(f"write_exr: expected float16, float32 or uint32, channel {name} has {values.dtype}")
    return kind


def _file(part: _Part, rows: NDArray[np.uint8], said: list[tuple[str, str, bytes]]) -> bytes:
    n_together = ROWS_IN_CHUNK[part.compression]
    chunks = []
    for first in range(0, part.height, n_together):
        packed = _packed(rows[first : first + n_together].reshape(-1), part.compression)
        chunks.append(struct.pack("<2i", first, len(packed)) + packed)
    if part.compression == "none":
        said = [*said, (CHECKSUM, "int", _checksum(b"".join(chunks)))]
    names = [*(name for name, _ in part.channels), *(name for name, _, _ in said)]
    has_long_names = any(len(name.encode()) > MAX_SHORT_NAME for name in names)
    start = MAGIC + struct.pack("<i", 2 | (LONG_NAMES if has_long_names else 0)) + _header(part, said)
    ends = np.cumsum([len(start) + 8 * len(chunks), *(len(chunk) for chunk in chunks)])
    return start + ends[:-1].astype("<u8").tobytes() + b"".join(chunks)


def _checksum(content: bytes) -> bytes:
    return struct.pack("<I", zlib.crc32(content))


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


def _header(part: _Part, said: list[tuple[str, str, bytes]]) -> bytes:
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
        *said,
    ]
    written = [f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value for name, kind, value in attributes]
    return b"".join(written) + b"\0"
