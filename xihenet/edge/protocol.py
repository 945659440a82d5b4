"""The protocol: the published client's records and answers, and a clean form of our own.

Published: records of seven bytes (`uint8_float16_stripped` of `xihenet.codec`), answered with 27 numbers. Two quirks of
the published client are read and counted, since phones that are out there have them:

- It writes record i at byte 7 i and leaves out each anchor with r + g + b below 0.05, dark ones and those never seen,
  so that seven zero bytes stand there. The reference server takes these for anchor 0 at a distance of 0; here they are
  no anchor.
- It sends as many records as it wrote, from the start. So each seven zero bytes have pushed one written record over the
  end, and that one is lost: as many as there are zero records, while what is lost is nowhere to be read.

A distance of 0 beside a colour is "not initialised" for the reference server, and so it is here. An infinite one, which
float16 makes of all beyond 65,504 m, is taken for that farthest. All else that is wrong is a ValueError.

The clean form is any payload of `xihenet.codec`, under a content type of its own, with what the published form cannot
say in headers: exposure, axes, position, ambient light.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from xihenet.codec import MAX_DISTANCE_M, METHODS, EncodingMethod, decode_cloud
from xihenet.edge.axes import OUR_AXES, checked_axes, vector_from
from xihenet.invalid import Counts, counted
from xihenet.records import ArrayF64, UnitSphereCloud

PORT = 8550
PUBLISHED_SESSION, PUBLISHED_ESTIMATION = "/api/v2/session/", "/api/v2/lighting-estimation/"
SESSIONS = "/api/v3/sessions"
SESSION_FIELDS = ("n_anchors", "target", "joinable")

CLOUD_TYPE = "application/vnd.xihe.cloud"
DEFAULT_METHOD: EncodingMethod = "uint16_float16_facing_stripped"

AXES_HEADER, TOKEN_HEADER, EXPOSURE_HEADER = "Xihe-Axes", "Xihe-Token", "Xihe-Exposure"
POSITION_HEADER, AMBIENT_HEADER = "Xihe-Position", "Xihe-Ambient"
OUR_HEADERS = (AXES_HEADER, TOKEN_HEADER, EXPOSURE_HEADER, POSITION_HEADER, AMBIENT_HEADER)

_PUBLISHED_METHOD: EncodingMethod = "uint8_float16_stripped"
_INFINITE = 0x7C00  # As float16; above it are NaN and whatever has a sign
RECORD_BYTES = METHODS[_PUBLISHED_METHOD].bytes_per_record
MAX_EXPOSURE = 1e6
"""And its inverse: the limits of what is believed to be an exposure."""

MOST = 1e9
"""Largest coordinate in metres, and largest ambient light."""

POSITION_NAME = r"^[^\x00-\x1f\x7f-\x9f]{1,64}$"

NUMBER = r"[0-9]{1,9}(\.[0-9]{1,20})?"
"""Digits as every client can write them, without a sign; the service also reads what `float` does."""


@dataclass(frozen=True, eq=False)
class CloudSent:
    """What one request says was seen.

    Parameters
    ----------
    cloud : in our order of anchors
    exposure : that its colours carry
    axes : in which the client has vectors and wants its answer, one of `AXES`
    position_m : (3,) where it was seen from, the session's world in our axes, or None if the client does not say
    ambient : (3,) radiance of the phone's light sensor, carrying `exposure`, or None
    quirks : what was read otherwise than it stands there, by reason, see `read_published`
    """

    cloud: UnitSphereCloud
    exposure: float = 1.0
    axes: str = OUR_AXES
    position_m: ArrayF64 | None = None
    ambient: ArrayF64 | None = None
    quirks: Counts = field(default_factory=dict)


def read_published(body: bytes, n_anchors: int, axes: str) -> CloudSent:
    """The published client's records, its quirks counted.

    `quirks` counts `dropped` records of seven zero bytes, `lost` ones (as many, see above), `uninitialised` ones with a
    colour and a distance of 0, and `too_far` ones with an infinite distance. ValueError for a length that is no
    multiple of seven or more than one record for each anchor, and as of `decode_cloud` for the other records.
    """
    if len(body) % RECORD_BYTES or len(body) > RECORD_BYTES * n_anchors:
        limits = f"a multiple of {RECORD_BYTES} and at most {RECORD_BYTES * n_anchors}"
        raise ValueError(f"expected a body whose bytes are {limits}, got {len(body)}")
    records, quirks = np.frombuffer(body, METHODS[_PUBLISHED_METHOD].record), {}
    # Zero and infinity are the smallest and the largest codes of float16 but for those that `decode_cloud` refuses.
    codes = records["distance_m"].view("<u2")
    if len(codes) and (codes.min() == 0 or codes.max() >= _INFINITE):
        is_zero, is_far = records["distance_m"] == 0, records["distance_m"] == np.inf
        is_dropped = is_zero & (records["anchor"] == 0) & ~records["srgb"].any(axis=1)
        n_dropped, n_zero = int(np.count_nonzero(is_dropped)), int(np.count_nonzero(is_zero))
        quirks = counted(
            dropped=n_dropped, lost=n_dropped, uninitialised=n_zero - n_dropped, too_far=np.count_nonzero(is_far)
        )
        records = records.copy()
        records["distance_m"][is_far] = MAX_DISTANCE_M
        body = records[~is_zero].tobytes()
    return CloudSent(decode_cloud(body, n_anchors, _PUBLISHED_METHOD), 1.0, checked_axes(axes), quirks=quirks)


def read_clean(body: bytes, n_anchors: int, content_type: str, headers: Mapping[str, str]) -> CloudSent:
    """The clean form: `body` encoded as the content type's `method` says, and what the headers say of it.

    ValueError that names the header for one that is missing or wrong, and as of `decode_cloud`.
    """
    axes = checked_axes(headers.get(AXES_HEADER, OUR_AXES))
    (exposure,) = _numbers(headers, EXPOSURE_HEADER, 1) or (None,)
    if exposure is None:
        raise ValueError(f"{EXPOSURE_HEADER}: expected the exposure that the colours carry, got no such header")
    if not 1 / MAX_EXPOSURE <= exposure <= MAX_EXPOSURE:
        raise ValueError(f"{EXPOSURE_HEADER}: expected {1 / MAX_EXPOSURE:g} to {MAX_EXPOSURE:g}, got {exposure:g}")
    position, ambient = _numbers(headers, POSITION_HEADER, 3), _numbers(headers, AMBIENT_HEADER, 3)
    if ambient is not None and min(ambient) < 0:
        raise ValueError(f"{AMBIENT_HEADER}: expected radiance of 0 or more, got {ambient}")
    return CloudSent(
        decode_cloud(body, n_anchors, method_of(content_type)),
        exposure,
        axes,
        None if position is None else vector_from(position, axes),
        None if ambient is None else np.array(ambient),
    )


def is_clean(content_type: str) -> bool:
    """Whether a request of this content type has the clean form."""
    return content_type.partition(";")[0].strip().lower() == CLOUD_TYPE


def method_of(content_type: str) -> EncodingMethod:
    """The encoding that a content type names; ValueError, naming the choices, for another."""
    parts = (part.partition("=") for part in content_type.split(";")[1:])
    named = {name.strip().lower(): value.strip().strip('"') for name, _, value in parts}
    method = named.get("method", DEFAULT_METHOD)
    if method not in METHODS:
        raise ValueError(f"there is no encoding {method!r}: choose one of {', '.join(METHODS)}")
    return cast(EncodingMethod, method)


def content_type_of(method: EncodingMethod) -> str:
    """Of a payload in the clean form."""
    return f"{CLOUD_TYPE}; method={method}"


def _numbers(headers: Mapping[str, str], name: str, n: int) -> tuple[float, ...] | None:
    """`n` numbers with commas between them, several up to `MOST` each; None without the header."""
    text = headers.get(name)
    if text is None:
        return None
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    most = sys.float_info.max if n == 1 else MOST
    if len(numbers) != n or not all(abs(number) <= most for number in numbers):
        expected = "a finite number" if n == 1 else f"{n} numbers from -{MOST:g} to {MOST:g} with commas between them"
        raise ValueError(f"{name}: expected {expected}, got {text[:80]!r}")
    return numbers


def anchors_wanted(text: str | None, sizes: tuple[int, ...], name: str = "Anchor-Size") -> int:
    """The number of anchors of a header or field `name`; ValueError, with it and the sizes served, for another."""
    choices = ", ".join(map(str, sizes))
    if text is None:
        raise ValueError(f"{name}: expected the number of anchors, one of {choices}, got no such header")
    if not text.strip().isascii() or not text.strip().isdigit() or len(text.strip()) > 6:
        raise ValueError(f"{name}: expected the number of anchors, one of {choices}, got {text[:80]!r}")
    if int(text) not in sizes:
        raise ValueError(f"{int(text)} anchors are not served here: choose one of {choices}")
    return int(text)


def checked_name(name: str) -> str:
    """`name` of a position; ValueError for one that cannot be."""
    if not re.fullmatch(POSITION_NAME, name):
        expected = "the name of a position, 1 to 64 characters without control characters"
        raise ValueError(f"expected {expected}, got {name[:80]!r}")
    return name


def failure(message: str) -> dict[str, Any]:
    """The answer to a request that could not be answered, in both forms."""
    return {"ok": False, "error": message}
