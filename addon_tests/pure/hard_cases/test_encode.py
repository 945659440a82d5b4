"""Hard cases of the wire: distances beyond half floats, every half float, and bytes that anyone may have sent."""

import struct
from functools import cache, partial
from typing import Any

import numpy as np

from addon_tests.hard_case import each, equal, near, refused, row, that
from addon_tests.pure.hard_cases.random_payloads import random_payload, taken_for_something_else
from xihenet.codec import METHODS, EncodingMethod, decode_cloud, encode_cloud
from xihenet.records import UnitSphereCloud

STAGE = "encode"
N = 1280
STRIPPED: EncodingMethod = "uint8_float16_stripped"
WHOLE: EncodingMethod = "uint8_float16"
RECORD = struct.Struct("<HBBBe")


def full_cloud(n: int, srgb: float = 0.5, distance_m: float = 1.0) -> UnitSphereCloud:
    return UnitSphereCloud(np.full((n, 3), srgb), np.full(n, distance_m), np.ones(n, bool))


def records(*rows: tuple[int, int, float]) -> bytes:
    """A stripped payload of (index, grey, distance)."""
    return b"".join(RECORD.pack(anchor, grey, grey, grey, distance_m) for anchor, grey, distance_m in rows)


def decoded_by_hand(payload: bytes, n: int = N) -> dict[int, tuple[float, float]]:
    """Naive: whatever whole records there are, the last one of an anchor winning, an index beyond the end wrapping."""
    rows = [RECORD.unpack_from(payload, start) for start in range(0, len(payload) - 6, 7)]
    return {anchor % n: (grey / 255, distance_m) for anchor, grey, _, _, distance_m in rows}


def carried(distance_m: float) -> float:
    """A distance after the wire; 0 says that the anchor came back unset."""
    return float(decode_cloud(encode_cloud(full_cloud(1, 0.5, distance_m)), 1).distance_m[0])


def carried_by_hand(distance_m: float) -> float:
    """Naive: cast to a half float, with 0 for "not set"."""
    return float(np.float32(distance_m).astype(np.float16))


PATTERNS = np.arange(65536, dtype=np.uint16)
VALUES = PATTERNS.view(np.float16).astype(np.float32)
LEGAL = np.isfinite(VALUES) & (VALUES >= 0)


def wrong_patterns(method: EncodingMethod) -> int:
    """How many of the 65,536 half floats are not read as their distance, or not refused where they are none."""
    good = PATTERNS[LEGAL]
    payload = np.zeros(len(good), METHODS[method].record)
    payload["distance_m"] = good.view(np.float16)
    if METHODS[method].is_stripped:
        payload["anchor"] = np.arange(len(good))
    cloud = decode_cloud(payload.tobytes(), len(good), method)
    is_wrong = (cloud.distance_m != VALUES[LEGAL]) | np.signbit(cloud.distance_m)
    is_wrong |= cloud.is_set != (METHODS[method].is_stripped | (VALUES[LEGAL] > 0))
    return int(is_wrong.sum()) + sum(is_accepted(pattern, method) for pattern in PATTERNS[~LEGAL])


def is_accepted(pattern: np.uint16, method: EncodingMethod) -> bool:
    payload = np.zeros(1, METHODS[method].record)
    payload["distance_m"] = pattern.view(np.float16)
    try:
        decode_cloud(payload.tobytes(), 1, method)
    except ValueError as error:
        return "distance" not in str(error)
    return True


def wrong_patterns_by_hand(method: EncodingMethod) -> int:
    """Naive: every pattern is a distance."""
    return int((~LEGAL).sum())


def codes_of(srgb: list[float]) -> list[int]:
    cloud = UnitSphereCloud(np.repeat(np.array(srgb)[:, None], 3, axis=1), np.ones(len(srgb)), np.ones(len(srgb), bool))
    return np.frombuffer(encode_cloud(cloud, WHOLE), METHODS[WHOLE].record)["srgb"][:, 0].tolist()


def read(payload: bytes, n: int = N, method: EncodingMethod = STRIPPED) -> tuple[int, float]:
    """Set anchors and the largest distance."""
    cloud = decode_cloud(payload, n, method)
    return int(cloud.is_set.sum()), float(cloud.distance_m.max(initial=0))


read_whole, read_one = partial(read, method=WHOLE), partial(read, n=1, method=WHOLE)


def read_by_hand(payload: bytes, n: int = N) -> tuple[int, float]:
    found = decoded_by_hand(payload, n)
    return len(found), max((distance_m for _, distance_m in found.values()), default=-1.0)


def float_record(**changes: Any) -> bytes:
    """One record of float32_stripped."""
    record = np.zeros(1, METHODS["float32_stripped"].record)
    record["srgb"], record["distance_m"] = 0.5, 1.0
    for name, value in changes.items():
        record[name] = value
    return record.tobytes()


def taken_by_hand(given: tuple[int, EncodingMethod]) -> int:
    """Naive: how many payloads the reader without checks takes for another number of records."""
    return stripped_taken_by_hand(given[0])


@cache
def stripped_taken_by_hand(n_payloads: int) -> int:
    rng = np.random.default_rng(2)
    payloads = [random_payload(rng, STRIPPED) for _ in range(n_payloads)]
    return sum(len(decoded_by_hand(payload, 40)) * 7 != len(payload) for payload in payloads)


def changed_since(value: float) -> list[float]:
    """A cloud whose caller changes the array after the record was checked."""
    srgb = np.full((1, 3), 0.5, np.float32)
    cloud = UnitSphereCloud(srgb, np.ones(1), np.ones(1, bool))
    srgb[0] = value
    return decode_cloud(encode_cloud(cloud), 1).srgb[0].tolist()


def wrapped(value: float) -> list[float]:
    return (np.rint(np.full(3, value, np.float32) * 255).astype(np.uint8) / 255).tolist()


def whole_length(cloud: UnitSphereCloud) -> int:
    return len(decode_cloud(encode_cloud(cloud, WHOLE), len(cloud), WHOLE))


def colour_of(payload: bytes) -> float:
    return float(decode_cloud(payload, 1, WHOLE).srgb.max())


def at_3_and_7(payload: bytes) -> list[float]:
    return decode_cloud(payload, N).distance_m[[3, 7]].tolist()


def minus_0(payload: bytes) -> tuple[tuple[int, float], bool]:
    return read(payload), bool(np.signbit(decode_cloud(payload, N).distance_m[3]))


def minus_0_by_hand(payload: bytes) -> tuple[tuple[int, float], bool]:
    return (1, 0.0), bool(np.signbit(decoded_by_hand(payload)[3][1]))


def n_set(cloud: UnitSphereCloud) -> int:
    """After the wire."""
    return int(decode_cloud(encode_cloud(cloud), len(cloud)).is_set.sum())


TWO = records((3, 10, 1.0), (7, 20, 2.0))
EDGES = [0.0, 0.49 / 255, 0.51 / 255, 254.51 / 255, 1 - 1e-7, 1.0]
LARGEST, SMALLEST = 65504.0, 2.0**-24
SENT = {
    65520.0: LARGEST, 65535.0: LARGEST, 1e10: LARGEST, 3e38: LARGEST,
    2.9e-8: SMALLEST, 1e-30: SMALLEST, float(np.float32(1e-45)): SMALLEST, 0.0: SMALLEST,
}  # fmt: skip
NO_DISTANCE, NO_COLOUR = refused("a finite distance"), refused("colours in [0, 1]")
NO_FLOATS = [
    ("distance of NaN", {"distance_m": np.nan}, NO_DISTANCE),
    ("distance of infinity", {"distance_m": np.inf}, NO_DISTANCE),
    ("distance just below 0", {"distance_m": np.float32(-1e-45)}, NO_DISTANCE),
    ("colour of NaN", {"srgb": np.nan}, NO_COLOUR),
    ("colour just above 1", {"srgb": np.nextafter(np.float32(1), np.float32(2))}, NO_COLOUR),
    ("colour just below 0", {"srgb": np.float32(-1e-45)}, NO_COLOUR),
]
TWICE, BEYOND = records((3, 10, 1.0), (3, 20, 2.0)), records((0, 1, 1.0), (1280, 1, 1.0))
EMPTY, FIVE = "expected 6400 bytes, got 0", "at most 28 bytes, got 35"
RANGE, TOO_MANY = "expected an anchor below 1280", "at most 65536 anchors, got 65537"
TURNED_NAN, WHITE = "expected a cloud without NaN", near([1.0] * 3, 0)
SET_WITHOUT_SIGN = that("one anchor set, no sign", lambda came: came == ((1, 0.0), False))
TAKEN = taken_for_something_else, equal(0), taken_by_hand
N_RANDOM = {method: 3000 if "facing" in method else 1000 for method in METHODS}
"""Of payloads of those with facing it takes so many to draw one of -128."""
CASES = [
    *(
        row(f"a distance of {sent:g} m arrives as {arrives:g} m", sent, carried, equal(arrives), carried_by_hand)
        for sent, arrives in SENT.items()
    ),
    *(
        row(f"every half float is a distance or refused in {m}", m, wrong_patterns, equal(0), wrong_patterns_by_hand)
        for m in (STRIPPED, WHOLE)
    ),
    row("colours at the edges of codes are rounded", EDGES, codes_of, equal([0, 0, 1, 255, 255, 255])),
    row("a black anchor is carried and not dropped", full_cloud(3, 0.0), n_set, equal(3)),
    row("an empty payload sets nothing", b"", read, equal((0, 0.0)), read_by_hand),
    row("anchor 65535 of 65536 is carried", full_cloud(65_536), lambda cloud: n_set(cloud) == 65_536, equal(True)),
    row("65537 anchors are carried where there is no index", full_cloud(65_537), whole_length, equal(65_537)),
    row("a distance of minus 0 is not set where there is no index", b"\x09\x09\x09\x00\x80", read_one, equal((0, 0.0))),
    row(
        "a colour beside distance 0 is dropped where there is no index", b"\xff\xff\xff\x00\x00", colour_of, equal(0.0)
    ),
    row("unsorted anchors are the same cloud", records((7, 20, 2.0), (3, 10, 1.0)), at_3_and_7, equal([1.0, 2.0])),
    row("a distance of minus 0 is 0 and set", records((3, 10, -0.0)), minus_0, SET_WITHOUT_SIGN, minus_0_by_hand),
    row("an empty payload is refused where each anchor has a record", b"", read_whole, refused(EMPTY)),
    row("more records than anchors are refused", records(*[(0, 0, 1.0)] * 5), partial(read, n=4), refused(FIVE)),
    row("65537 anchors are refused where an index has 16 bits", full_cloud(65_537), n_set, refused(TOO_MANY)),
    row("a payload cut short by one byte is refused", TWO[:-1], read, refused("multiple of 7 bytes, got 13")),
    row("a payload with one byte too many is refused", TWO + b"\0", read, refused("multiple of 7 bytes, got 15")),
    row("an anchor that comes twice is refused", TWICE, read, refused("record 1: expected each anchor once, got 3")),
    row("the first anchor out of range is refused", BEYOND, read, refused(f"record 1: {RANGE}, got 1280")),
    row("anchor 65,535 is out of range", records((65535, 1, 1.0)), read, refused(f"record 0: {RANGE}")),
    *(
        row(f"a float32 {name} is refused", float_record(**change), partial(read, method="float32_stripped"), must)
        for name, change, must in NO_FLOATS
    ),
    *(
        row(f"none of {n:,} random payloads of {m} is taken for something else", (n, m), *TAKEN)
        for m, n in N_RANDOM.items()
    ),
    row("a colour that turned nan since it was checked is refused", np.nan, changed_since, refused(TURNED_NAN)),
    row("a colour that grew beyond 1 since it was checked does not wrap", 1.2, changed_since, WHITE, wrapped),
]

test_hard_case = each(CASES)
