"""The codec, which encodes: a unit-sphere cloud on the wire, in the paper's four encodings and two of ours, packed.

All are little endian, see `METHODS`: 16, 18, 5, 7, 8 and 12 bytes for each anchor or, with its index, for each set
anchor. The last two are ours. What facing costs is one byte in eight, 0.6 kB for half of 1280 anchors. It is the cosine
of `AnchorSurfaces` in steps of 1/127; 0 says that it is unknown or at a right angle, and a payload of zeros alone that
nobody looked. The rest of the surfaces stays with the sender, since no estimator asks it.

`uint16_float16_facing_stripped` is for a phone whose light must be that of its own estimator: colours that were scaled
to another exposure are no 8-bit codes any more, and rounding them moves the light of `lattice` by up to 2.3e-4 SHC
RMSE. Colours and facing have 16 bits there.

Colours are sRGB-encoded, distances in metres. The payload carries no header: both sides know the method and the number
of anchors from their session. Formats without an index say "not set" with distance 0, so encoding clips the distances
of set anchors to what float16 can tell from 0 and from infinity, in all methods alike. Values are rounded and
clipped, never wrapped, and dark anchors are kept, which the reference client drops.

Decoding trusts nothing: a payload is either a legal cloud or a ValueError that names what is wrong and in which
record. NumPy's structured types write and read records without a loop; `struct` was rejected as far slower.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from xihenet.invalid import counted
from xihenet.records import AnchorSurfaces, ArrayBool, ArrayF32, ArrayInt, UnitSphereCloud

EncodingMethod = Literal[
    "float32",
    "float32_stripped",
    "uint8_float16",
    "uint8_float16_stripped",
    "uint8_float16_facing_stripped",
    "uint16_float16_facing_stripped",
]

MIN_DISTANCE_M = 2.0**-24  # The smallest float16 above 0.
MAX_DISTANCE_M = 65504.0  # The largest finite float16.
MAX_STRIPPED_ANCHORS = 65536  # What a uint16 index reaches.


@dataclass(frozen=True)
class WireFormat:
    """One encoding: the packed record, and whether anchors that are not set are left out."""

    record: np.dtype[Any]
    is_stripped: bool

    @property
    def bytes_per_record(self) -> int:
        """Bytes for each anchor or, if stripped, for each set anchor."""
        return self.record.itemsize


_INDEX = ("anchor", "<u2")
_FLOAT32 = [("srgb", "<f4", (3,)), ("distance_m", "<f4")]
_UINT8_FLOAT16 = [("srgb", "u1", (3,)), ("distance_m", "<f2")]
_UINT16_FLOAT16 = [("srgb", "<u2", (3,)), ("distance_m", "<f2")]

METHODS: Mapping[EncodingMethod, WireFormat] = MappingProxyType(
    {
        "float32": WireFormat(np.dtype(_FLOAT32), is_stripped=False),
        "float32_stripped": WireFormat(np.dtype([_INDEX, *_FLOAT32]), is_stripped=True),
        "uint8_float16": WireFormat(np.dtype(_UINT8_FLOAT16), is_stripped=False),
        "uint8_float16_stripped": WireFormat(np.dtype([_INDEX, *_UINT8_FLOAT16]), is_stripped=True),
        "uint8_float16_facing_stripped": WireFormat(np.dtype([_INDEX, *_UINT8_FLOAT16, ("facing", "i1")]), True),
        "uint16_float16_facing_stripped": WireFormat(np.dtype([_INDEX, *_UINT16_FLOAT16, ("facing", "<i2")]), True),
    }
)


def _format_for(method: EncodingMethod, n_anchors: int) -> WireFormat:
    if method not in METHODS:
        raise ValueError(f"codec: expected a method out of {', '.join(METHODS)}, got {method!r}")
    wire_format = METHODS[method]
    if n_anchors < 0:
        raise ValueError(f"codec: expected a number of anchors of at least 0, got {n_anchors}")
    if wire_format.is_stripped and n_anchors > MAX_STRIPPED_ANCHORS:
        raise ValueError(f"codec: {method} carries at most {MAX_STRIPPED_ANCHORS} anchors, got {n_anchors}")
    return wire_format


def encode_cloud(cloud: UnitSphereCloud, method: EncodingMethod = "uint8_float16_stripped") -> bytes:
    """Write a cloud of N anchors as bytes; N may be 0.

    One record per anchor or, if stripped, per set anchor in rising order; empty where there is none. Distances of set
    anchors are clipped to [2^-24, 65504] m, 8-bit colours rounded to the nearest code. 8 bits are off by at most half a
    code, half floats from 2^-14 m on by at most 2^-11 of the distance, float32 by nothing. ValueError for an unknown
    method, for more than 65,536 anchors in a stripped one, and for NaN.
    """
    wire_format = _format_for(method, len(cloud))
    # The record checked its colours, but it views the caller's arrays, and those may have changed since.
    srgb = np.clip(cloud.srgb, 0.0, 1.0)
    distance_m = np.clip(cloud.distance_m, MIN_DISTANCE_M, MAX_DISTANCE_M)
    if np.isnan(srgb.sum()) or np.isnan(distance_m.sum()):
        raise ValueError("codec: expected a cloud without NaN; its arrays were changed after it was made")
    if wire_format.is_stripped:
        anchor = np.flatnonzero(cloud.is_set)
        records = np.empty(len(anchor), wire_format.record)
        records["anchor"] = anchor
        srgb, distance_m = srgb[anchor], distance_m[anchor]
        if "facing" in (wire_format.record.names or ()):
            steps = _largest_code(wire_format.record["facing"])
            records["facing"] = 0 if cloud.surfaces is None else _facing_steps(cloud.surfaces.facing[anchor], steps)
    else:
        records = np.empty(len(cloud), wire_format.record)
        distance_m *= cloud.is_set
    stored = wire_format.record["srgb"].base
    records["srgb"] = srgb if stored == np.float32 else np.rint(srgb * np.float64(_largest_code(stored)))
    records["distance_m"] = distance_m
    return records.tobytes()


def facing_codes(facing: ArrayF32) -> NDArray[np.int8]:
    """Cosines as whole steps of 1/127, as they travel and are stored; what is NaN counts as unknown, 0."""
    return _facing_steps(facing, 127).astype(np.int8)


def _facing_steps(facing: ArrayF32, steps: int) -> NDArray[Any]:
    """Cosines as whole steps of 1 / `steps`."""
    return np.rint(np.clip(np.nan_to_num(facing), -1, 1) * steps)


@functools.cache
def _largest_code(stored: np.dtype[Any]) -> int:
    """What stands for 1 in integers of this kind."""
    return int(np.iinfo(stored).max)


@functools.cache
def _code_of_infinity(stored: np.dtype[Any]) -> NDArray[Any]:
    """Infinity in floats of this kind, as a whole number of as many bits."""
    return np.array(np.inf, stored).view(f"<u{stored.itemsize}")


def facing_of_codes(codes: NDArray[np.int8]) -> ArrayF32:
    """The cosines that `facing_codes` gave, of the same shape."""
    return codes / np.float32(127)


def n_clamped_distances(cloud: UnitSphereCloud) -> int:
    """Set anchors whose distance no wire format can say: `encode_cloud` takes them for the nearest that it can."""
    sayable = (cloud.distance_m >= MIN_DISTANCE_M) & (cloud.distance_m <= MAX_DISTANCE_M)
    return int(np.count_nonzero(cloud.is_set & ~sayable))


def decode_cloud(
    payload: bytes | bytearray | memoryview, n_anchors: int, method: EncodingMethod = "uint8_float16_stripped"
) -> UnitSphereCloud:
    """Read a cloud of `n_anchors` from bytes that anyone may have sent.

    Stripped records may come in any order. Empty is legal for stripped methods (nothing is set) and otherwise only for
    0 anchors. Without an index, distance 0 means not set; a colour beside it is left out and counted. With one, the
    record's presence says that the anchor is set, and distance 0 is a distance: other clients send it.

    ValueError for a wrong length, an anchor out of range or repeated, a distance that is negative, infinite or NaN, a
    float32 colour that is NaN or outside [0, 1], a facing below -1, an unknown method, and more anchors than it can
    carry.
    """
    wire_format = _format_for(method, n_anchors)
    records = _records_of(payload, n_anchors, method)
    distance_m, stored = _decoded_distance(records["distance_m"]), records["srgb"]
    if stored.dtype.kind != "u":  # Codes cannot lie outside.
        _refuse(~((stored >= 0) & (stored <= 1)).all(axis=1), "colours in [0, 1]", stored)
    if not wire_format.is_stripped:
        is_set, srgb = distance_m > 0, _decoded_colour(stored)
        without = counted(colour_without_distance=np.count_nonzero(srgb[~is_set].any(axis=1)))
        return UnitSphereCloud(srgb * is_set[:, None], distance_m, is_set, without)
    anchor = records["anchor"].astype(np.intp)
    is_set = _checked_set(anchor, n_anchors)
    all_stored, all_distance_m = np.zeros((n_anchors, 3), stored.dtype), np.zeros(n_anchors, np.float32)
    # A colour is put as one piece, in half the time of three numbers.
    piece = f"V{3 * stored.itemsize}"
    all_stored.view(piece)[anchor], all_distance_m[anchor] = stored.view(piece), distance_m
    surfaces = (
        _decoded_facing(records["facing"], anchor, n_anchors) if "facing" in (records.dtype.names or ()) else None
    )
    return UnitSphereCloud.trusted(_decoded_colour(all_stored), all_distance_m, is_set, {}, surfaces)


def _records_of(payload: bytes | bytearray | memoryview, n_anchors: int, method: EncodingMethod) -> NDArray[Any]:
    """The payload as records, its length checked."""
    wire_format = METHODS[method]
    size, n_bytes = wire_format.bytes_per_record, memoryview(payload).nbytes
    if wire_format.is_stripped and n_bytes % size:
        raise ValueError(f"codec: {method} expected a multiple of {size} bytes, got {n_bytes}")
    if wire_format.is_stripped and n_bytes > n_anchors * size:
        raise ValueError(f"codec: {method} expected at most {n_anchors * size} bytes, got {n_bytes}")
    if not wire_format.is_stripped and n_bytes != n_anchors * size:
        raise ValueError(f"codec: {method} expected {n_anchors * size} bytes, got {n_bytes}")
    return np.frombuffer(payload, wire_format.record)


def _decoded_distance(stored: NDArray[Any]) -> ArrayF32:
    """(R,) float32, finite and >= 0."""
    distance_m = stored.astype(np.float32)
    infinite = _code_of_infinity(stored.dtype)
    # As whole numbers, floats from infinity on are those that are refused, and -0, which becomes 0.
    if stored.view(infinite.dtype).max(initial=0) >= infinite:
        _refuse(~((distance_m >= 0) & (distance_m < np.inf)), "a finite distance >= 0", distance_m)
        return np.abs(distance_m)
    return distance_m


def _decoded_colour(stored: NDArray[Any]) -> ArrayF32:
    """(R, 3) float32 in [0, 1]."""
    colour = stored.astype(np.float32)
    if stored.dtype.kind != "u":
        return np.abs(colour)  # -0 becomes 0, as it does for distances.
    colour /= np.float32(_largest_code(stored.dtype))
    return colour


def _decoded_facing(stored: NDArray[Any], anchor: ArrayInt, n_anchors: int) -> AnchorSurfaces | None:
    """Surfaces of which only facing is known; None where all of it is 0."""
    largest = _largest_code(stored.dtype)
    _refuse(stored < -largest, f"a facing of -{largest} to {largest}", stored)
    if not stored.any():
        return None
    facing = np.zeros(n_anchors, np.float32)
    facing[anchor] = stored / np.float32(largest)
    return AnchorSurfaces.of_facing(facing)


def _checked_set(anchor: ArrayInt, n_anchors: int) -> ArrayBool:
    """(n_anchors,) whether an anchor is among (R,), which are each in range and there once."""
    is_set = np.zeros(n_anchors, np.bool_)
    try:
        is_set[anchor] = True
    except IndexError:
        _refuse(anchor >= n_anchors, f"an anchor below {n_anchors}", anchor)
    if np.count_nonzero(is_set) < len(anchor):
        is_repeated = np.ones(len(anchor), np.bool_)
        is_repeated[np.unique(anchor, return_index=True)[1]] = False
        _refuse(is_repeated, "each anchor once", anchor)
    return is_set


def _refuse(is_wrong: ArrayBool, expected: str, values: NDArray[Any]) -> None:
    """ValueError that names the first wrong record, if there is one."""
    if np.count_nonzero(is_wrong):
        record = int(np.argmax(is_wrong))
        raise ValueError(f"codec: record {record}: expected {expected}, got {values[record].tolist()}")
