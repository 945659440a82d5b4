"""Hard cases of the wire: distances beyond half floats, every half float, and bytes that anyone may have sent."""

from __future__ import annotations

import struct
from functools import partial
from typing import Any

import numpy as np
import pytest

from addon_tests.hard_case import at_most, case, equal, near, refused, that
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


# -------------------------------------------------------------------------------------------------------- distances


def carried(distance_m: float) -> float:
    """A distance after the wire; 0 says that the anchor came back unset."""
    return float(decode_cloud(encode_cloud(full_cloud(1, 0.5, distance_m)), 1).distance_m[0])


def carried_by_hand(distance_m: float) -> float:
    """Naive: cast to a half float, with 0 for "not set"."""
    return float(np.float32(distance_m).astype(np.float16))


LARGEST, SMALLEST = 65504.0, 2.0**-24
DISTANCES = [
    case(f"a distance of {sent:g} m arrives as {arrives:g} m", sent, equal(arrives))
    for sent, arrives in (
        (65520.0, LARGEST),
        (65535.0, LARGEST),
        (1e10, LARGEST),
        (3e38, LARGEST),
        (2.9e-8, SMALLEST),
        (1e-30, SMALLEST),
        (float(np.float32(1e-45)), SMALLEST),
        (0.0, SMALLEST),
    )
]


@pytest.mark.parametrize("given, must", DISTANCES)
def test_a_distance_beyond_half_floats_is_the_nearest_one_that_they_hold(given, must, comes_out):
    assert comes_out(given, carried, must, carried_by_hand)


# ------------------------------------------------------------------------------------------------------ half floats

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


HALVES = [case(f"every half float is a distance or refused in {method}", method) for method in (STRIPPED, WHOLE)]


@pytest.mark.parametrize("given", HALVES)
def test_every_half_float_is_a_distance_or_refused(given, comes_out):
    assert comes_out(given, wrong_patterns, equal(0), wrong_patterns_by_hand)


# ----------------------------------------------------------------------------------------------------- what is lost


def largest_error(method: EncodingMethod, part: str) -> float:
    rng = np.random.default_rng(1)
    cloud = UnitSphereCloud(rng.random((N, 3)), 10 ** rng.uniform(-3, 4, N), np.ones(N, bool))
    again = decode_cloud(encode_cloud(cloud, method), N, method)
    if part == "srgb":
        return float(np.abs(again.srgb - cloud.srgb).max())
    return float((np.abs(again.distance_m - cloud.distance_m) / cloud.distance_m).max())


def cut_off(_: object) -> float:
    """Naive: colours cut off instead of rounded."""
    srgb = np.random.default_rng(1).random((N, 3))
    return float(np.abs(np.floor(srgb * 255) / 255 - srgb).max())


def kept_distance(_: object) -> float:
    """Naive: distances as 16-bit millimetres, as depth cameras send them."""
    distance_m = 10 ** np.random.default_rng(1).uniform(-3, 4, N)
    return float((np.abs(np.minimum(np.floor(distance_m * 1000), 65535) / 1000 - distance_m) / distance_m).max())


def codes_of(srgb: list[float]) -> list[int]:
    cloud = UnitSphereCloud(np.repeat(np.array(srgb)[:, None], 3, axis=1), np.ones(len(srgb)), np.ones(len(srgb), bool))
    return np.frombuffer(encode_cloud(cloud, WHOLE), METHODS[WHOLE].record)["srgb"][:, 0].tolist()


def test_8_bits_lose_half_a_code_of_colour(comes_out):
    assert comes_out(STRIPPED, partial(largest_error, part="srgb"), at_most(0.5001 / 255), cut_off)


def test_half_floats_lose_a_2048th_of_a_distance(comes_out):
    assert comes_out(STRIPPED, partial(largest_error, part="distance_m"), at_most(2.0**-11), kept_distance)


def test_float32_loses_nothing(comes_out):
    assert comes_out("float32_stripped", partial(largest_error, part="distance_m"), equal(0.0), kept_distance)


def test_colours_at_the_edges_of_codes_are_rounded(comes_out):
    assert comes_out(
        [0.0, 0.49 / 255, 0.51 / 255, 254.51 / 255, 1 - 1e-7, 1.0], codes_of, equal([0, 0, 1, 255, 255, 255])
    )


def test_a_black_anchor_is_carried_and_not_dropped(comes_out):
    assert comes_out(full_cloud(3, 0.0), lambda cloud: int(decode_cloud(encode_cloud(cloud), 3).is_set.sum()), equal(3))


# ------------------------------------------------------------------------------------------------------------ bytes


def read(payload: bytes, n: int = N, method: EncodingMethod = STRIPPED) -> tuple[int, float]:
    """Set anchors and the largest distance."""
    cloud = decode_cloud(payload, n, method)
    return int(cloud.is_set.sum()), float(cloud.distance_m.max(initial=0))


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


def read_float(payload: bytes) -> tuple[int, float]:
    return read(payload, N, "float32_stripped")


TWO = records((3, 10, 1.0), (7, 20, 2.0))


def test_an_empty_payload_sets_nothing(comes_out):
    assert comes_out(b"", read, equal((0, 0.0)), read_by_hand)


BYTES = [
    case(
        "unsorted anchors are the same cloud",
        records((7, 20, 2.0), (3, 10, 1.0)),
        lambda payload: decode_cloud(payload, N).distance_m[[3, 7]].tolist(),
        equal([1.0, 2.0]),
        None,
    ),
    case(
        "a distance of minus 0 is 0 and set",
        records((3, 10, -0.0)),
        lambda payload: (read(payload), bool(np.signbit(decode_cloud(payload, N).distance_m[3]))),
        that("one anchor set, no sign", lambda came: came == ((1, 0.0), False)),
        lambda payload: ((1, 0.0), bool(np.signbit(decoded_by_hand(payload)[3][1]))),
    ),
]


def test_anchor_65535_of_65536_is_carried(comes_out):
    assert comes_out(65_536, lambda n: bool(decode_cloud(encode_cloud(full_cloud(n)), n).is_set[-1]), equal(True))


def test_65537_anchors_are_carried_where_there_is_no_index(comes_out):
    assert comes_out(65_537, lambda n: len(decode_cloud(encode_cloud(full_cloud(n), WHOLE), n, WHOLE)), equal(65_537))


def test_a_distance_of_minus_0_is_not_set_where_there_is_no_index(comes_out):
    assert comes_out(b"\x09\x09\x09\x00\x80", partial(read, n=1, method=WHOLE), equal((0, 0.0)))


def test_a_colour_beside_distance_0_is_dropped_where_there_is_no_index(comes_out):
    assert comes_out(
        b"\xff\xff\xff\x00\x00", lambda payload: float(decode_cloud(payload, 1, WHOLE).srgb.max()), equal(0.0)
    )


@pytest.mark.parametrize("given, ask, must, naive", BYTES)
def test_odd_bytes_are_read_as_they_are_meant(given, ask, must, naive, comes_out):
    assert comes_out(given, ask, must, naive)


def test_an_empty_payload_is_refused_where_each_anchor_has_a_record(comes_out):
    assert comes_out(b"", partial(read, method=WHOLE), refused("expected 6400 bytes, got 0"))


def test_more_records_than_anchors_are_refused(comes_out):
    assert comes_out(records(*[(0, 0, 1.0)] * 5), partial(read, n=4), refused("at most 28 bytes, got 35"))


def test_65537_anchors_are_refused_where_an_index_has_16_bits(comes_out):
    assert comes_out(65_537, lambda n: len(encode_cloud(full_cloud(n))), refused("at most 65536 anchors, got 65537"))


def test_an_unknown_method_is_refused(comes_out):
    assert comes_out(
        "uint8", lambda method: encode_cloud(full_cloud(1), method), refused("expected a method out of float32")
    )


WRONG_BYTES = [
    case("a payload cut short by one byte is refused", TWO[:-1], refused("multiple of 7 bytes, got 13")),
    case("a payload with one byte too many is refused", TWO + b"\0", refused("multiple of 7 bytes, got 15")),
    case(
        "an anchor that comes twice is refused",
        records((3, 10, 1.0), (3, 20, 2.0)),
        refused("record 1: expected each anchor once, got 3"),
    ),
    case(
        "the first anchor out of range is refused",
        records((0, 1, 1.0), (1280, 1, 1.0)),
        refused("record 1: expected an anchor below 1280, got 1280"),
    ),
    case("anchor 65,535 is out of range", records((65535, 1, 1.0)), refused("record 0: expected an anchor below 1280")),
]


@pytest.mark.parametrize("given, must", WRONG_BYTES)
def test_bytes_that_are_no_records_are_refused(given, must, comes_out):
    assert comes_out(given, read, must)


WRONG_FLOATS = [
    case(f"a float32 {name} is refused", float_record(**change), refused(words))
    for name, change, words in (
        ("distance of NaN", {"distance_m": np.nan}, "a finite distance"),
        ("distance of infinity", {"distance_m": np.inf}, "a finite distance"),
        ("distance just below 0", {"distance_m": np.float32(-1e-45)}, "a finite distance"),
        ("colour of NaN", {"srgb": np.nan}, "colours in [0, 1]"),
        ("colour just above 1", {"srgb": np.nextafter(np.float32(1), np.float32(2))}, "colours in [0, 1]"),
        ("colour just below 0", {"srgb": np.float32(-1e-45)}, "colours in [0, 1]"),
    )
]


@pytest.mark.parametrize("given, must", WRONG_FLOATS)
def test_floats_that_are_no_anchor_are_refused(given, must, comes_out):
    assert comes_out(given, read_float, must)


# ----------------------------------------------------------------------------- random bytes, and what changed since


def taken_by_hand(given: tuple[int, EncodingMethod]) -> int:
    """Naive: how many payloads the reader without checks takes for another number of records."""
    rng = np.random.default_rng(2)
    payloads = [random_payload(rng, STRIPPED) for _ in range(given[0])]
    return sum(len(decoded_by_hand(payload, 40)) * 7 != len(payload) for payload in payloads)


RANDOM = [
    case(f"none of 3,000 random payloads of {method} is taken for something else", (3000, method)) for method in METHODS
]


@pytest.mark.parametrize("given", RANDOM)
def test_random_bytes_are_not_taken_for_something_else(given, comes_out):
    assert comes_out(given, taken_for_something_else, equal(0), taken_by_hand)


def changed_since(value: float) -> list[float]:
    """A cloud whose caller changes the array after the record was checked."""
    srgb = np.full((1, 3), 0.5, np.float32)
    cloud = UnitSphereCloud(srgb, np.ones(1), np.ones(1, bool))
    srgb[0] = value
    return decode_cloud(encode_cloud(cloud), 1).srgb[0].tolist()


def changed_since_by_hand(value: float) -> list[float]:
    return (np.rint(np.full(3, value, np.float32) * 255).astype(np.uint8) / 255).tolist()


def test_a_colour_that_turned_nan_since_it_was_checked_is_refused(comes_out):
    assert comes_out(np.nan, changed_since, refused("expected a cloud without NaN"))


def test_a_colour_that_grew_beyond_1_since_it_was_checked_does_not_wrap(comes_out):
    assert comes_out(1.2, changed_since, near([1.0] * 3, 0), changed_since_by_hand)
