"""Sessions and positions, stored outside the process: compact bytes that carry a version.

No pickle, which would run what it reads: a store may hold anything. Reading trusts nothing, and a ValueError says that
the bytes are none of ours. A session is JSON behind its version, a position packed little endian:

    version (1 byte), mark (8), frames (4), flags (1), anchors (4), exposure (8), position if known (3 x 8),
    key light if known (7 x 8 and 1), a bit for each anchor that says whether it is set, and for the set ones colours
    (6 each, or 12), distances (2, or 4) and, where surfaces are known, facing (4); where the position has moved, by how
    much what they show lies beside their direction (3 x 4)

Colours and distances lose nothing, so that the light is what one process would give: as they come from phones, 16 bits
hold them, and they are float32 where they were moved or re-exposed. What a cloud's frame left out (`invalid`) and
surfaces other than facing are not kept: no cloud that arrives has them, and nothing asks.
"""

from __future__ import annotations

import functools
import json
import math
import re
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.codec import MAX_STRIPPED_ANCHORS
from xihenet.edge.axes import checked_axes
from xihenet.edge.sessions import SeenPosition, Session
from xihenet.records import AnchorSurfaces, ArrayF32, ArrayF64, KeyLight, UnitSphereCloud

VERSION = 1
_HEAD, _VECTOR, _KEY = struct.Struct("<BQIBId"), struct.Struct("<3d"), struct.Struct("<7d?")
_HAS_POSITION, _HAS_KEY, _HAS_SURFACES, _IS_SHORT, _HAS_MOVED = 1, 2, 4, 8, 16
_CODES = np.float32(65535)
_HASH = re.compile("[0-9a-f]{64}")


def session_to_bytes(session: Session) -> bytes:
    """All but its id, under which it is kept. Equal sessions have equal bytes."""
    fields = [
        session.n_anchors,
        session.target,
        session.axes,
        session.owner,
        sorted(session.clients),
        session.is_joinable,
        session.created_s,
    ]
    return bytes([VERSION]) + json.dumps(fields, separators=(",", ":"), allow_nan=False).encode()


@functools.lru_cache(maxsize=4096)  # A session is read for every request, and hardly ever changes.
def session_from_bytes(session_id: str, stored: bytes) -> Session:
    """The session that `session_to_bytes` wrote; ValueError for other bytes."""
    if stored[:1] != bytes([VERSION]):
        raise ValueError(f"session: expected version {VERSION}, got {stored[:1]!r}")
    try:
        n_anchors, target, axes, owner, clients, is_joinable, created_s = json.loads(stored[1:])
        is_right = (
            type(n_anchors) is int
            and 0 < n_anchors <= MAX_STRIPPED_ANCHORS
            and target in ("ldr", "hdr")
            and type(is_joinable) is bool
            and type(created_s) is float
            and math.isfinite(created_s)
            and isinstance(axes, str)
            and isinstance(owner, str)
            and all(_HASH.fullmatch(hashed) for hashed in (*clients, owner or "0" * 64))
        )
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"session: expected its fields ({error})") from None
    if not is_right:
        raise ValueError("session: expected its fields, got others")
    return Session(session_id, n_anchors, target, checked_axes(axes), owner, frozenset(clients), is_joinable, created_s)


def position_to_bytes(seen: SeenPosition) -> bytes:
    """A position, which begins with what `mark_bytes` gives."""
    cloud, key = seen.cloud, seen.key
    anchors = np.flatnonzero(cloud.is_set)
    columns, is_short = _columns(cloud.srgb.take(anchors, axis=0), cloud.distance_m.take(anchors))
    flags = (
        _IS_SHORT * is_short
        + _HAS_POSITION * (seen.position_m is not None)
        + _HAS_KEY * (key is not None)
        + _HAS_SURFACES * (cloud.surfaces is not None)
        + _HAS_MOVED * (cloud.beside_m is not None)
    )
    parts = [_HEAD.pack(VERSION, seen.mark, seen.n_frames, flags, len(cloud), seen.exposure)]
    if seen.position_m is not None:
        parts.append(_VECTOR.pack(*seen.position_m))
    if key is not None:
        parts.append(_KEY.pack(*key.direction, *key.irradiance, key.angular_radius, key.is_seen))
    parts.append(np.packbits(cloud.is_set).tobytes())
    parts += [column.tobytes() for column in columns]
    if cloud.surfaces is not None:
        parts.append(cloud.surfaces.facing[anchors].astype("<f4", copy=False).tobytes())
    if cloud.beside_m is not None:
        parts.append(cloud.beside_m[anchors].astype("<f4", copy=False).tobytes())
    return b"".join(parts)


def _columns(srgb: ArrayF32, distance_m: ArrayF32) -> tuple[list[NDArray[Any]], bool]:
    """(K, 3) colours and (K,) distances as they are stored, and whether 16 bits hold them."""
    codes = np.rint(srgb * _CODES).astype("<u2")
    with np.errstate(over="ignore"):  # What is too far for 16 bits differs, and takes 32.
        half = distance_m.astype("<f2")
    if (codes / _CODES == srgb).all() and (half == distance_m).all():
        return [codes, half], True
    return [srgb.astype("<f4", copy=False), distance_m.astype("<f4", copy=False)], False


def position_from_bytes(stored: bytes) -> SeenPosition:
    """The position that `position_to_bytes` wrote; ValueError for other bytes."""
    try:
        version, mark, n_frames, flags, n_anchors, exposure = _HEAD.unpack_from(stored)
        at, position_m, key = _HEAD.size, None, None
        if flags & _HAS_POSITION:
            position_m = _finite(_VECTOR.unpack_from(stored, at))
            at += _VECTOR.size
        if flags & _HAS_KEY:
            *numbers, is_seen = _KEY.unpack_from(stored, at)
            told = _finite(numbers)
            key = KeyLight(told[:3], told[3:6], float(told[6]), is_seen)
            at += _KEY.size
    except struct.error as error:
        raise ValueError(f"position: {error}") from None
    if version != VERSION or flags > 31 or n_anchors > MAX_STRIPPED_ANCHORS or not 0 < exposure < math.inf:
        raise ValueError(f"position: expected version {VERSION} and its fields, got others")
    with np.errstate(invalid="ignore"):  # A NaN that signals is refused as any other is.
        cloud = _cloud_from(stored, at, n_anchors, flags)
    seen = SeenPosition(cloud, exposure, position_m, key, n_frames)
    object.__setattr__(seen, "mark", mark)
    return seen


def mark_bytes(seen: SeenPosition) -> bytes:
    """What the bytes of this record begin with, and those of no other."""
    return struct.pack("<BQ", VERSION, seen.mark)


def _cloud_from(stored: bytes, at: int, n_anchors: int, flags: int) -> UnitSphereCloud:
    n_bits = -(-n_anchors // 8)
    bits = np.frombuffer(stored[at : at + n_bits], np.uint8)
    is_set = np.unpackbits(bits, count=n_anchors).astype(bool)
    n_set = int(np.count_nonzero(is_set))
    has_surfaces, has_moved = bool(flags & _HAS_SURFACES), bool(flags & _HAS_MOVED)
    colour, distance = ("<u2", "<f2") if flags & _IS_SHORT else ("<f4", "<f4")
    record = np.dtype(
        [
            ("srgb", colour, (3 * n_set,)),
            ("distance_m", distance, (n_set,)),
            ("facing", "<f4", (n_set * has_surfaces,)),
            ("beside_m", "<f4", (3 * n_set * has_moved,)),
        ]
    )
    at += n_bits
    if len(stored) != at + record.itemsize:
        raise ValueError(f"position: expected the bytes of {n_set} anchors, got {len(stored)} in all")
    srgb, distance_m = np.zeros((n_anchors, 3), np.float32), np.zeros(n_anchors, np.float32)
    if n_set:
        columns = np.frombuffer(stored, record, 1, at)[0]
        srgb[is_set] = columns["srgb"].reshape(-1, 3) / (_CODES if flags & _IS_SHORT else np.float32(1))
        distance_m[is_set] = columns["distance_m"]
    surfaces, beside_m = None, None
    if has_surfaces:
        facing = np.zeros(n_anchors, np.float32)
        facing[is_set] = _finite(columns["facing"]) if n_set else 0
        surfaces = AnchorSurfaces.of_facing(facing)
    if has_moved:
        beside_m = np.zeros((n_anchors, 3), np.float32)
        beside_m[is_set] = _finite(columns["beside_m"]).reshape(-1, 3) if n_set else 0
    return UnitSphereCloud(srgb, distance_m, is_set, surfaces=surfaces, beside_m=beside_m)


def _finite(numbers: object) -> ArrayF64:
    array = np.array(numbers, np.float64)
    if not np.isfinite(array).all():
        raise ValueError("position: expected finite numbers")
    return array
