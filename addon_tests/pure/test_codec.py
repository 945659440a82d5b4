"""The wire formats: bytes as documented, round trips, and what is refused; any bytes are in test_any_bytes.py."""

from __future__ import annotations

import dataclasses
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from xihenet.codec import MAX_DISTANCE_M, METHODS, MIN_DISTANCE_M, EncodingMethod, decode_cloud, encode_cloud
from xihenet.records import UnitSphereCloud

ALL = pytest.mark.parametrize("method", list(METHODS))
STRIPPED: list[EncodingMethod] = [name for name in METHODS if METHODS[name].is_stripped]
UNSTRIPPED: list[EncodingMethod] = [name for name in METHODS if not METHODS[name].is_stripped]


def cloud_of(srgb: object, distance_m: object, is_set: object) -> UnitSphereCloud:
    """A cloud from values for every anchor; what is not set is blanked."""
    seen = np.asarray(is_set, bool)
    return UnitSphereCloud(
        np.where(seen[:, None], np.asarray(srgb), 0), np.where(seen, np.asarray(distance_m), 0), seen
    )


@st.composite
def clouds(draw: st.DrawFn) -> UnitSphereCloud:
    n = draw(st.integers(0, 40))
    unit = st.floats(0, 1, width=32)
    distance = st.floats(0, float(np.finfo(np.float32).max), width=32)
    return cloud_of(
        draw(hnp.arrays(np.float32, (n, 3), elements=unit)),
        draw(hnp.arrays(np.float32, n, elements=distance)),
        draw(hnp.arrays(np.bool_, n)),
    )


def assert_same(a: UnitSphereCloud, b: UnitSphereCloud) -> None:
    for field in ("is_set", "srgb", "distance_m"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field), err_msg=field)


# ---- what the bytes are


def test_the_7_byte_record_is_index_colour_half_distance() -> None:
    distance_m, srgb = np.zeros(300), np.zeros((300, 3))
    srgb[258], distance_m[258] = [1.0, 0.5, 0.0], 1.5
    srgb[1], distance_m[1] = [0.0, 0.0, 1 / 255], 65504.0
    payload = encode_cloud(cloud_of(srgb, distance_m, distance_m > 0))
    assert payload.hex(" ") == "01 00 00 00 01 ff 7b 02 01 ff 80 00 00 3e"
    again = decode_cloud(bytes.fromhex("02 01 ff 80 00 00 3e"), 300)
    assert np.flatnonzero(again.is_set).tolist() == [258]
    assert again.distance_m[258] == 1.5
    np.testing.assert_allclose(again.srgb[258], [1, 128 / 255, 0], atol=1e-7)


def test_every_format_is_what_struct_writes() -> None:
    cloud = cloud_of([[0.25, 0.5, 1.0], [0.0, 0.0, 0.0]], [2.5, 0.0], [True, False])
    assert encode_cloud(cloud, "float32") == struct.pack("<8f", 0.25, 0.5, 1, 2.5, 0, 0, 0, 0)
    assert encode_cloud(cloud, "float32_stripped") == struct.pack("<H4f", 0, 0.25, 0.5, 1, 2.5)
    assert encode_cloud(cloud, "uint8_float16") == struct.pack("<3Be3Be", 64, 128, 255, 2.5, 0, 0, 0, 0)
    assert encode_cloud(cloud, "uint8_float16_stripped") == struct.pack("<H3Be", 0, 64, 128, 255, 2.5)


@pytest.mark.parametrize(
    ("method", "bytes_per_record"),
    [("float32", 16), ("float32_stripped", 18), ("uint8_float16", 5), ("uint8_float16_stripped", 7)],
)
def test_payloads_have_the_sizes_of_the_papers_table(method: EncodingMethod, bytes_per_record: int) -> None:
    is_set = np.arange(1280) < 607
    payload = encode_cloud(cloud_of(np.full((1280, 3), 0.5), np.ones(1280), is_set), method)
    assert METHODS[method].bytes_per_record == bytes_per_record
    assert len(payload) == bytes_per_record * (607 if METHODS[method].is_stripped else 1280)


# ---- round trips


@ALL
@given(cloud=clouds())
def test_a_round_trip_keeps_set_anchors_and_is_within_a_rounding_step(
    method: EncodingMethod, cloud: UnitSphereCloud
) -> None:
    again = decode_cloud(encode_cloud(cloud, method), len(cloud), method)
    clipped = np.where(cloud.is_set, np.clip(cloud.distance_m.astype(float), MIN_DISTANCE_M, MAX_DISTANCE_M), 0)
    np.testing.assert_array_equal(again.is_set, cloud.is_set)
    if method.startswith("float32"):
        np.testing.assert_array_equal(again.srgb, cloud.srgb)
        np.testing.assert_array_equal(again.distance_m, clipped.astype(np.float32))
    else:
        assert np.abs(again.srgb - cloud.srgb).max(initial=0) <= 0.5 / 255 + 1e-7
        assert (np.abs(again.distance_m - clipped) <= np.maximum(clipped * 2.0**-11, 2.0**-25)).all()


@ALL
@given(cloud=clouds())
def test_a_second_round_trip_changes_nothing(method: EncodingMethod, cloud: UnitSphereCloud) -> None:
    first = encode_cloud(cloud, method)
    once = decode_cloud(first, len(cloud), method)
    second = encode_cloud(once, method)
    assert second == first
    assert_same(decode_cloud(second, len(cloud), method), once)


@ALL
def test_a_set_anchor_is_never_0_or_infinite_on_the_wire(method: EncodingMethod) -> None:
    cloud = cloud_of(np.zeros((4, 3)), [0.0, 1e-30, 1e30, 1.0], [True] * 4)
    again = decode_cloud(encode_cloud(cloud, method), 4, method)
    assert again.is_set.all()
    assert again.distance_m.tolist() == [2.0**-24, 2.0**-24, 65504.0, 1.0]


@ALL
def test_colours_that_changed_after_the_record_was_checked_are_clipped_and_not_wrapped(method: EncodingMethod) -> None:
    srgb = np.full((1, 3), 0.5, np.float32)
    cloud = UnitSphereCloud(srgb, np.ones(1, np.float32), np.ones(1, bool))
    srgb[0] = [-0.25, 1.25, 300.0]
    assert decode_cloud(encode_cloud(cloud, method), 1, method).srgb.tolist() == [[0, 1, 1]]


def test_colours_round_to_the_nearest_code() -> None:
    srgb = np.repeat((np.arange(255)[:, None] + np.array([0.49, 0.51])).reshape(-1, 1) / 255, 3, axis=1)
    payload = encode_cloud(cloud_of(srgb, np.ones(510), np.ones(510, bool)), "uint8_float16")
    codes = np.frombuffer(payload, np.uint8).reshape(510, 5)[:, 0]
    assert codes.tolist() == [code for low in range(255) for code in (low, low + 1)]


@pytest.mark.parametrize("method", STRIPPED)
def test_records_may_come_in_any_order(method: EncodingMethod) -> None:
    rng = np.random.default_rng(3)
    cloud = cloud_of(rng.random((50, 3)), rng.random(50), rng.random(50) < 0.5)
    payload, size = encode_cloud(cloud, method), METHODS[method].bytes_per_record
    shuffled = rng.permutation(np.frombuffer(payload, f"V{size}")).tobytes()
    assert shuffled != payload
    assert_same(decode_cloud(shuffled, 50, method), decode_cloud(payload, 50, method))


@ALL
def test_bytearray_and_memoryview_are_read_like_bytes(method: EncodingMethod) -> None:
    cloud = cloud_of(np.full((3, 3), 0.2), [1, 2, 3], [True, False, True])
    payload = encode_cloud(cloud, method)
    for same in (bytearray(payload), memoryview(payload)):
        assert_same(decode_cloud(same, 3, method), decode_cloud(payload, 3, method))


# ---- what is refused


@ALL
@pytest.mark.parametrize("off_by", [-1, 1])
def test_a_wrong_length_is_refused(method: EncodingMethod, off_by: int) -> None:
    payload = encode_cloud(cloud_of(np.full((4, 3), 0.5), np.ones(4), [True, True, False, False]), method)
    wrong = payload[:-1] if off_by < 0 else payload + b"\x00"
    with pytest.raises(ValueError, match=f"bytes, got {len(payload) + off_by}"):
        decode_cloud(wrong, 4, method)


@pytest.mark.parametrize("method", UNSTRIPPED)
def test_formats_without_an_index_need_one_record_per_anchor(method: EncodingMethod) -> None:
    size = METHODS[method].bytes_per_record
    for n_bytes in (0, size, 3 * size):
        with pytest.raises(ValueError, match=f"expected {2 * size} bytes, got {n_bytes}"):
            decode_cloud(bytes(n_bytes), 2, method)
    assert len(decode_cloud(b"", 0, method)) == 0


@pytest.mark.parametrize("method", STRIPPED)
def test_an_empty_stripped_payload_sets_nothing(method: EncodingMethod) -> None:
    assert_same(decode_cloud(b"", 5, method), UnitSphereCloud.empty(5))
    assert encode_cloud(UnitSphereCloud.empty(5), method) == b""


@pytest.mark.parametrize("method", STRIPPED)
def test_an_anchor_out_of_range_or_repeated_is_refused_with_its_record(method: EncodingMethod) -> None:
    def record(anchor: int) -> bytes:
        values = np.zeros(1, METHODS[method].record)
        values["anchor"], values["distance_m"] = anchor, 1
        return values.tobytes()

    assert decode_cloud(record(3) + record(0), 4, method).is_set.tolist() == [True, False, False, True]
    with pytest.raises(ValueError, match="record 1: expected an anchor below 4, got 4"):
        decode_cloud(record(0) + record(4), 4, method)
    with pytest.raises(ValueError, match="record 2: expected each anchor once, got 3"):
        decode_cloud(record(3) + record(1) + record(3), 4, method)


@pytest.mark.parametrize("method", ["float32", "float32_stripped"])
@pytest.mark.parametrize("field", ["srgb", "distance_m"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-6])
def test_float32_values_that_no_cloud_can_have_are_refused(method: EncodingMethod, field: str, value: float) -> None:
    records = np.zeros(3, METHODS[method].record)
    if METHODS[method].is_stripped:
        records["anchor"] = [0, 1, 2]
    records["distance_m"] = 1
    decode_cloud(records.tobytes(), 3, method)
    records[field].reshape(3, -1)[2, -1] = value
    with pytest.raises(ValueError, match="record 2: expected"):
        decode_cloud(records.tobytes(), 3, method)


def test_a_float32_colour_above_1_is_refused() -> None:
    with pytest.raises(ValueError, match="colours"):
        decode_cloud(struct.pack("<4f", 0.5, 1.0001, 0.5, 1), 1, "float32")


@pytest.mark.parametrize("method", STRIPPED)
def test_index_65535_is_carried_and_more_anchors_are_refused(method: EncodingMethod) -> None:
    last = np.arange(65536) == 65535
    cloud = cloud_of(np.full((65536, 3), 0.2), np.ones(65536), last)
    again = decode_cloud(encode_cloud(cloud, method), 65536, method)
    assert np.flatnonzero(again.is_set).tolist() == [65535]
    with pytest.raises(ValueError, match="65536 anchors, got 65537"):
        encode_cloud(UnitSphereCloud.empty(65537), method)
    with pytest.raises(ValueError, match="65536 anchors, got 65537"):
        decode_cloud(b"", 65537, method)


@pytest.mark.parametrize("method", UNSTRIPPED)
def test_formats_without_an_index_carry_any_number_of_anchors(method: EncodingMethod) -> None:
    cloud = cloud_of(np.full((65537, 3), 0.2), np.ones(65537), np.arange(65537) == 65536)
    assert decode_cloud(encode_cloud(cloud, method), 65537, method).is_set.nonzero()[0].tolist() == [65536]


def test_an_unknown_method_or_a_negative_size_is_refused() -> None:
    with pytest.raises(ValueError, match=r"float32, float32_stripped.*got 'png'"):
        encode_cloud(UnitSphereCloud.empty(1), "png")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="got 'png'"):
        decode_cloud(b"", 1, "png")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at least 0, got -1"):
        decode_cloud(b"", -1)


def test_the_formats_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        METHODS["float32"] = METHODS["uint8_float16"]  # type: ignore[index]
    with pytest.raises(dataclasses.FrozenInstanceError):
        METHODS["float32"].is_stripped = True  # type: ignore[misc]
