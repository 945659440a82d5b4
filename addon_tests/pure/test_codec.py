"""The wire formats: bytes as documented, and round trips; odd bytes are in test_any_bytes.py and in hard_cases."""

import dataclasses
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from addon_tests.pure.made import looked_at
from xihenet.codec import (
    MAX_DISTANCE_M,
    METHODS,
    MIN_DISTANCE_M,
    decode_cloud,
    encode_cloud,
    facing_codes,
    facing_of_codes,
)
from xihenet.records import AnchorSurfaces, UnitSphereCloud

ALL = pytest.mark.parametrize("method", list(METHODS))


def cloud_of(srgb, distance_m, is_set):
    """A cloud from values for every anchor; what is not set is blanked."""
    seen = np.asarray(is_set, bool)
    return UnitSphereCloud(np.where(seen[:, None], srgb, 0), np.where(seen, distance_m, 0), seen)


@st.composite
def clouds(draw):
    n = draw(st.integers(0, 40))
    unit = st.floats(0, 1, width=32)
    distance = st.floats(0, float(np.finfo(np.float32).max), width=32)
    return cloud_of(
        draw(hnp.arrays(np.float32, (n, 3), elements=unit)),
        draw(hnp.arrays(np.float32, n, elements=distance)),
        draw(hnp.arrays(np.bool_, n)),
    )


def test_a_client_in_another_language_reads_the_records_in_the_docs():
    page = (Path(__file__).parents[2] / "docs" / "edge.md").read_text(encoding="utf-8")
    told = re.findall(r"^\| (`\w*float\w*`.*?) \| ([\d, ]+) \|", page, re.MULTILINE)
    pairs = [zip(re.findall(r"`(\w+)`", names), sizes.split(", "), strict=True) for names, sizes in told]
    assert {name: int(size) for row in pairs for name, size in row} == {
        name: wire_format.bytes_per_record for name, wire_format in METHODS.items()
    }


def test_every_format_is_what_struct_writes_with_the_sizes_of_the_papers_table():
    cloud = cloud_of(np.tile([0.25, 0.5, 1.0], (259, 1)), np.full(259, 2.5), np.arange(259) == 258)
    assert encode_cloud(cloud, "float32") == bytes(258 * 16) + struct.pack("<4f", 0.25, 0.5, 1, 2.5)
    assert encode_cloud(cloud, "float32_stripped") == struct.pack("<H4f", 258, 0.25, 0.5, 1, 2.5)
    assert encode_cloud(cloud, "uint8_float16") == bytes(258 * 5) + struct.pack("<3Be", 64, 128, 255, 2.5)
    assert encode_cloud(cloud, "uint8_float16_stripped") == struct.pack("<H3Be", 258, 64, 128, 255, 2.5)
    facing = dataclasses.replace(cloud, surfaces=AnchorSurfaces.of_facing(np.full(259, -1.0)))
    eight, sixteen = struct.pack("<H3Beb", 258, 64, 128, 255, 2.5, -127), (258, 16384, 32768, 65535, 2.5, -32767)
    assert encode_cloud(facing, "uint8_float16_facing_stripped") == eight
    assert encode_cloud(facing, "uint16_float16_facing_stripped") == struct.pack("<4Heh", *sixteen)


@given(cloud=clouds())
def test_a_round_trip_keeps_set_anchors_and_is_within_a_rounding_step(cloud):
    clipped = np.where(cloud.is_set, np.clip(cloud.distance_m.astype(float), MIN_DISTANCE_M, MAX_DISTANCE_M), 0)
    for method in METHODS:
        again = looked_at(decode_cloud(encode_cloud(cloud, method), len(cloud), method))
        np.testing.assert_array_equal(again.is_set, cloud.is_set, method)
        if method.startswith("float32"):
            np.testing.assert_array_equal(again.srgb, cloud.srgb, method)
            np.testing.assert_array_equal(again.distance_m, clipped.astype(np.float32), method)
        else:
            codes = 65535 if method.startswith("uint16") else 255
            assert np.abs(again.srgb - cloud.srgb).max(initial=0) <= 0.5 / codes + 1e-7, method
            off_m = np.abs(again.distance_m - clipped)
            assert (off_m <= np.maximum(clipped * 2.0**-11, 2.0**-25)).all(), method


@ALL
def test_bytearray_and_memoryview_are_read_like_bytes_and_may_be_written_over(method):
    payload = encode_cloud(cloud_of(np.full((3, 3), 0.2), [1, 2, 3], [True, False, True]), method)
    read, reused = decode_cloud(payload, 3, method), bytearray(payload)
    for same in (decode_cloud(reused, 3, method), decode_cloud(memoryview(payload), 3, method)):
        reused[:] = bytes(len(payload))
        for field in ("is_set", "srgb", "distance_m"):
            np.testing.assert_array_equal(getattr(same, field), getattr(read, field), err_msg=field)


def test_facing_is_stored_within_half_a_step():
    facing = np.linspace(-1, 1, 1001).astype(np.float32)
    np.testing.assert_allclose(facing_of_codes(facing_codes(facing)), facing, rtol=0, atol=0.5 / 127 + 1e-6)


def test_an_unknown_method_or_a_negative_size_is_refused():
    with pytest.raises(ValueError, match=r"float32, float32_stripped.*got 'png'"):
        encode_cloud(UnitSphereCloud.empty(1), "png")
    with pytest.raises(ValueError, match="got 'png'"):
        decode_cloud(b"", 1, "png")
    with pytest.raises(ValueError, match="at least 0, got -1"):
        decode_cloud(b"", -1)


def test_the_formats_cannot_be_changed():
    with pytest.raises(TypeError):
        METHODS["float32"] = METHODS["uint8_float16"]
    with pytest.raises(dataclasses.FrozenInstanceError):
        METHODS["float32"].is_stripped = True
