"""How sessions and positions lie in a store outside the process: compact bytes that carry a version.

No pickle, which would run what it reads: a store may hold anything. Reading trusts nothing, and a ValueError says that
the bytes are none of ours. A session is JSON behind its version, a position packed little endian:

    version (1 byte), mark (8), frames (4), flags (1), anchors (4), exposure (8), position if known (3 x 8),
    key light if known (7 x 8 and 1), a bit for each anchor that says whether it is set, and for the set ones colours
    (12 each), distances (4) and, where surfaces are known, facing (4)

Colours and distances keep all bits of float32, so that the light is what one process would give. What a cloud's frame
left out (`invalid`) and surfaces other than facing are not kept: no cloud that arrives has them, and nothing asks.
"""

from __future__ import annotations

import functools
import json
import math
import re
import struct

import numpy as np

from xihenet.codec import MAX_STRIPPED_ANCHORS
from xihenet.edge.axes import checked_axes
from xihenet.edge.sessions import SeenPosition, Session
from xihenet.records import AnchorSurfaces, ArrayF64, KeyLight, UnitSphereCloud

VERSION = 1
_HEAD, _VECTOR, _KEY = struct.Struct("<BQIBId"), struct.Struct("<3d"), struct.Struct("<7d?")
_HAS_POSITION, _HAS_KEY, _HAS_SURFACES = 1, 2, 4
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
    except (TypeError, RecursionError) as error:
        raise ValueError(f"session: expected its fields ({error})") from None
    if not is_right:
        raise ValueError("session: expected its fields, got others")
    return Session(session_id, n_anchors, target, checked_axes(axes), owner, frozenset(clients), is_joinable, created_s)


def position_to_bytes(seen: SeenPosition) -> bytes:
    """A position, which begins with what `mark_bytes` gives."""
    cloud, key = seen.cloud, seen.key
    flags = (
        _HAS_POSITION * (seen.position_m is not None)
        + _HAS_KEY * (key is not None)
        + _HAS_SURFACES * (cloud.surfaces is not None)
    )
    parts = [_HEAD.pack(VERSION, seen.mark, seen.n_frames, flags, len(cloud), seen.exposure)]
    if seen.position_m is not None:
        parts.append(_VECTOR.pack(*seen.position_m))
    if key is not None:
        parts.append(_KEY.pack(*key.direction, *key.irradiance, key.angular_radius, key.is_seen))
    parts.append(np.packbits(cloud.is_set).tobytes())
    columns = [cloud.srgb, cloud.distance_m] + ([cloud.surfaces.facing] if cloud.surfaces else [])
    parts += [column[cloud.is_set].astype("<f4", copy=False).tobytes() for column in columns]
    return b"".join(parts)


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
    if version != VERSION or flags > 7 or n_anchors > MAX_STRIPPED_ANCHORS or not 0 < exposure < math.inf:
        raise ValueError(f"position: expected version {VERSION} and its fields, got others")
    seen = SeenPosition(
        _cloud_from(stored, at, n_anchors, bool(flags & _HAS_SURFACES)), exposure, position_m, key, n_frames
    )
    object.__setattr__(seen, "mark", mark)
    return seen


def mark_bytes(seen: SeenPosition) -> bytes:
    """What the bytes of this record begin with, and those of no other."""
    return struct.pack("<BQ", VERSION, seen.mark)


def _cloud_from(stored: bytes, at: int, n_anchors: int, has_surfaces: bool) -> UnitSphereCloud:
    n_bits = -(-n_anchors // 8)
    bits = np.frombuffer(stored[at : at + n_bits], np.uint8)
    is_set = np.unpackbits(bits, count=n_anchors).astype(bool)
    n_set, n_columns = int(np.count_nonzero(is_set)), 5 if has_surfaces else 4
    if len(bits) != n_bits or len(stored) != at + n_bits + 4 * n_columns * n_set:
        raise ValueError(f"position: expected the bytes of {n_set} anchors, got {len(stored)} in all")
    values = np.frombuffer(stored, "<f4", n_columns * n_set, at + n_bits)
    srgb, distance_m = np.zeros((n_anchors, 3), np.float32), np.zeros(n_anchors, np.float32)
    srgb[is_set], distance_m[is_set] = values[: 3 * n_set].reshape(-1, 3), values[3 * n_set : 4 * n_set]
    surfaces = None
    if has_surfaces:
        facing = np.zeros(n_anchors, np.float32)
        facing[is_set] = _finite(values[4 * n_set :])
        surfaces = AnchorSurfaces.of_facing(facing)
    return UnitSphereCloud(srgb, distance_m, is_set, surfaces=surfaces)


def _finite(numbers: object) -> ArrayF64:
    array = np.array(numbers, np.float64)
    if not np.isfinite(array).all():
        raise ValueError("position: expected finite numbers")
    return array
