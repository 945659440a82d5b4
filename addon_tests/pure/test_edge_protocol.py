"""What travels between phone and server: the published records with their quirks, the clean form, and axes."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addon_tests.fuzz import some_examples
from addon_tests.pure.any_requests import TEXTS, changed
from addon_tests.pure.edge_servers import published_body
from addon_tests.pure.made import random_cloud, random_rotation
from xihenet.codec import METHODS, encode_cloud
from xihenet.edge import protocol
from xihenet.edge.axes import AXES, coefficients_in, sh_from, vector_from, vector_in
from xihenet.edge.openapi import openapi_document
from xihenet.records import UnitSphereCloud
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice


def record(anchor, srgb=(10, 20, 30), distance_m=2.0):
    return struct.pack("<HBBBe", anchor, *srgb, distance_m)


def test_published_records_are_those_of_the_codec():
    cloud = random_cloud(np.random.default_rng(1), 512)
    sent = protocol.read_published(encode_cloud(cloud), 512, "unity")
    assert np.array_equal(sent.cloud.is_set, cloud.is_set) and sent.quirks == {}
    assert np.abs(sent.cloud.srgb - cloud.srgb).max() <= 0.5 / 255 + 1e-6


def test_dropped_records_are_no_anchor_and_the_lost_tail_is_counted():
    n = 64
    srgb = np.full((n, 3), 0.5, np.float32)
    srgb[[3, 10, 11]] = 0.01
    cloud = UnitSphereCloud(srgb, np.full(n, 2.0, np.float32), np.ones(n, bool))
    body = published_body(cloud)
    sent = protocol.read_published(body, n, "unity")
    assert len(body) == 7 * (n - 3)
    assert sent.quirks == {"dropped": 3, "lost": 3}
    assert np.flatnonzero(~sent.cloud.is_set).tolist() == [3, 10, 11, 61, 62, 63]


def test_anchor_0_is_kept_where_it_is_there():
    sent = protocol.read_published(record(0) + bytes(7), 8, "unity")
    assert sent.cloud.is_set.tolist() == [True] + 7 * [False]


def test_a_distance_of_0_is_not_initialised_and_infinity_is_the_farthest():
    sent = protocol.read_published(record(1, distance_m=0.0) + record(2, distance_m=np.inf), 8, "unity")
    assert np.flatnonzero(sent.cloud.is_set).tolist() == [2]
    assert sent.cloud.distance_m[2] == 65504 and sent.quirks == {"uninitialised": 1, "too_far": 1}


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"123456", "multiple of 7"),
        (bytes(7 * 9), "at most 56"),
        (record(8), "an anchor below 8"),
        (record(1) + record(1), "each anchor once"),
        (record(1, distance_m=-1.0), "finite distance"),
        (record(1, distance_m=np.nan), "finite distance"),
        (bytes(7) + b"\0\0\0\0\0\0\x7d", "finite distance"),  # A NaN at which processors complain
    ],
)
def test_what_is_wrong_in_records_is_said(body, said):
    with pytest.raises(ValueError, match=said):
        protocol.read_published(body, 8, "unity")


DISTANCES_M = st.sampled_from([0.0, 2.0, np.inf, -1.0, np.nan])
RECORD = st.just(bytes(7)) | st.builds(record, st.integers(0, 12), distance_m=DISTANCES_M)


@some_examples()
@given(st.binary(max_size=7 * 12) | st.lists(RECORD, max_size=6).map(b"".join), st.integers(1, 12))
def test_any_bytes_are_a_legal_cloud_or_a_value_error(body, n):
    try:
        sent = protocol.read_published(body, n, "unity")
    except ValueError:
        return
    assert len(sent.cloud) == n and set(sent.quirks) <= {"dropped", "lost", "uninitialised", "too_far"}
    n_left_out = sum(sent.quirks.get(name, 0) for name in ("dropped", "uninitialised"))
    assert sent.cloud.is_set.sum() + n_left_out == len(body) / 7


@some_examples()
@given(
    st.integers(0, 2**32),
    st.sampled_from(list(METHODS)),
    st.sampled_from([{protocol.EXPOSURE_HEADER: "1"}, {}]),
    st.dictionaries(st.sampled_from(protocol.OUR_HEADERS), st.sampled_from(TEXTS) | st.text(max_size=30), max_size=2),
)
def test_any_clean_request_is_a_legal_cloud_or_a_value_error(seed, method, headers, odd):
    rng, kind = np.random.default_rng(seed), protocol.content_type_of(method)
    body = encode_cloud(random_cloud(rng, 12), method)
    try:
        sent = protocol.read_clean(changed(rng, body) if seed % 2 else body, 12, kind, headers | odd)
    except ValueError:
        return
    assert len(sent.cloud) == 12 and sent.exposure > 0


def test_the_clean_form_says_what_the_published_one_cannot():
    cloud = random_cloud(np.random.default_rng(2), 512)
    headers = {"Xihe-Axes": "y-up", "Xihe-Exposure": "0.25", "Xihe-Position": "1,2,3", "Xihe-Ambient": "0.1,0.2,0.3"}
    method = protocol.content_type_of("float32")
    sent = protocol.read_clean(encode_cloud(cloud, "float32"), 512, method, headers)
    assert np.array_equal(sent.cloud.srgb, cloud.srgb) and sent.exposure == 0.25
    assert sent.position_m.tolist() == [1, -3, 2] and sent.ambient.tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("headers", "said"),
    [
        ({}, "Xihe-Exposure"),
        ({"Xihe-Exposure": "0"}, "Xihe-Exposure"),
        ({"Xihe-Exposure": "nan"}, "Xihe-Exposure: expected a finite number, got"),
        ({"Xihe-Exposure": "2e9"}, r"Xihe-Exposure: expected 1e-06 to 1e\+06, got"),
        ({"Xihe-Exposure": "1", "Xihe-Position": "1,2"}, "Xihe-Position: expected 3"),
        ({"Xihe-Exposure": "1", "Xihe-Position": "-1e308,0,0"}, r"Xihe-Position: expected 3 numbers from -1e\+09"),
        ({"Xihe-Exposure": "1", "Xihe-Ambient": "1,2,-3"}, "Xihe-Ambient"),
        ({"Xihe-Exposure": "1", "Xihe-Axes": "x-up"}, "unity, y-up, z-up"),
    ],
)
def test_a_wrong_header_is_named(headers, said):
    with pytest.raises(ValueError, match=said):
        protocol.read_clean(b"", 12, protocol.CLOUD_TYPE, headers)


@some_examples()
@given(st.data())
def test_what_openapi_describes_of_a_position_is_taken(data):
    operation = openapi_document((12,), has_bearer=False)["paths"][
        protocol.SESSIONS + "/{session}/positions/{position}"
    ]
    schemas = {one["name"]: one["schema"] for one in operation["post"]["parameters"]}
    sent = {name: data.draw(from_schema(schemas[name]), name) for name in ("position", *protocol.OUR_HEADERS)}
    name = protocol.checked_name(sent.pop("position"))
    assert protocol.read_clean(b"", 12, protocol.CLOUD_TYPE, sent).exposure == float(sent["Xihe-Exposure"]) and name


def from_schema(schema):
    """Text of what a schema of a parameter allows, as headers and paths have it."""
    if "enum" in schema:
        return st.sampled_from(schema["enum"])
    if "pattern" in schema:
        return st.from_regex(schema["pattern"], fullmatch=True)
    if schema["type"] == "number":
        return st.floats(schema["minimum"], schema["maximum"]).map(repr)
    return st.just("a token")


@pytest.mark.parametrize("name", ["", "x" * 65, "a\n", "\x00", "\x85"])
def test_a_position_has_a_name_without_controls(name):
    with pytest.raises(ValueError, match="1 to 64 characters without control characters"):
        protocol.checked_name(name)


def test_an_unknown_encoding_is_named():
    with pytest.raises(ValueError, match="there is no encoding 'zip'"):
        protocol.method_of("application/vnd.xihe.cloud; method=zip")


@pytest.mark.parametrize("text", [None, "", "abc", "-1", "1280.0", "99999999999", "511", "²"])
def test_other_numbers_of_anchors_are_refused(text):
    with pytest.raises(ValueError, match="anchors"):
        protocol.anchors_wanted(text, (512, 1280))
    assert protocol.anchors_wanted(" 1280 ", (512, 1280)) == 1280


@pytest.mark.parametrize("axes", AXES)
def test_coefficients_are_the_same_light_in_the_clients_axes(axes):
    rng = np.random.default_rng(3)
    sh, directions = rng.normal(size=(9, 3)), random_rotation(4)
    theirs = np.array(coefficients_in(sh, axes)).reshape(3, 9).T
    in_theirs = np.array([vector_in(direction, axes) for direction in directions])
    assert np.allclose(basis(in_theirs) @ theirs, basis(directions) @ sh)
    assert np.allclose(sh_from(coefficients_in(sh, axes), axes), sh)
    assert np.allclose(vector_from(in_theirs[0], axes), directions[0])


def test_the_published_anchors_are_ours_with_y_and_z_swapped():
    ours = AnchorLattice(512).directions
    i = np.arange(512)
    up, azimuth = 1 - 2 * i / 511, i * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - up * up)
    published = np.stack([radius * np.cos(azimuth), up, radius * np.sin(azimuth)], axis=1)
    assert np.allclose(ours @ AXES["unity"].T, published)
    assert np.allclose(ours @ AXES["y-up"].T, published * [1, 1, -1])
