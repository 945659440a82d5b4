"""What must never happen to anything that reads bytes: a crash, a warning, or an answer that is no answer.

Each reader gets files that were right once and are cut, changed or spliced, and files that never were. It may refuse
them with the errors that its docstring names; what it accepts must hold what it promises. `make fuzz` tries more.
"""

import io
import json
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addon_tests.fuzz import CORPUS, kept_where_it_breaks, some_examples
from addon_tests.pure.frame_makers import box_radiance_and_plane_depth, write_exr, write_image
from addon_tests.pure.hard_cases.random_payloads import is_taken_for_something_else
from addon_tests.pure.weights_files import random_arrays
from xihenet.codec import METHODS, encode_cloud
from xihenet.estimators.lattice import Lattice
from xihenet.estimators.lattice_format import LatticeArchitecture, LatticeWeights, load_weights
from xihenet.estimators.weights_format import save_weights
from xihenet.io.frame_files import read_camera, read_frame
from xihenet.io.recording import load_frame, save_frame
from xihenet.phone.profile import PROFILES_FOLDER, load_profile
from xihenet.records import Intrinsics, RgbdFrame, UnitSphereCloud

Reader = Callable[[bytes], object]
N_ANCHORS = 40
SMALLEST = LatticeArchitecture(*[1] * 9)


@cache
def written(write: Callable[[Path], object], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"right{suffix}"
        write(path)
        return path.read_bytes()


def some_frame() -> RgbdFrame:
    rng = np.random.default_rng(0)
    colours = rng.integers(0, 256, (3, 4, 3), np.uint8)
    return RgbdFrame(colours, rng.uniform(0, 5, (3, 4)), Intrinsics(4, 3, 2.0, 2.0, 2.0, 1.5), np.eye(4), 0.3)


def write_frame(path: Path) -> None:
    save_frame(path, some_frame())


def write_weights(path: Path) -> None:
    save_weights(path, LatticeWeights(SMALLEST, "ldr", random_arrays(SMALLEST)))


def write_colour(path: Path) -> None:
    write_image(path, some_frame().srgb_u8)


def write_plane_depth(path: Path) -> None:
    write_image(path, np.full((3, 4), 2000, np.uint16))


def write_linear_frame(path: Path) -> None:
    write_exr(path, *box_radiance_and_plane_depth())


CAMERA: dict[str, Any] = {"width": 4, "height": 3, "fx": 2.0, "fy": 2.0, "cx": 2.0, "cy": 1.5}
CAMERA |= {"world_from_camera": np.eye(4).tolist(), "convention": "opencv", "up": "y"}


def some_payload(method: Any) -> bytes:
    rng = np.random.default_rng(0)
    known = rng.random(N_ANCHORS) < 0.3
    colours = rng.random((N_ANCHORS, 3)) * known[:, None]
    return encode_cloud(UnitSphereCloud(colours, rng.random(N_ANCHORS) * known, known), method)


def from_file(read: Callable[[Path], object], suffix: str) -> Reader:
    """A reader of files as a reader of bytes; ValueError and OSError are what readers may raise."""

    def reader(content: bytes) -> object:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"any{suffix}"
            path.write_bytes(content)
            try:
                return read(path)
            except (ValueError, OSError) as error:
                assert str(error), "an error that says nothing"
                return None

    return reader


def wire_reader(method: Any) -> Reader:
    def reader(payload: bytes) -> None:
        assert not is_taken_for_something_else(payload, method, N_ANCHORS)

    return reader


def camera_of(path: Path) -> object:
    camera = read_camera(path)
    assert np.isfinite(camera.world_from_camera).all()
    return camera


def network_of(path: Path) -> object:
    weights = load_weights(path)
    light = Lattice(10, weights.target, weights=path).estimate(UnitSphereCloud.empty(10))
    assert np.isfinite(light).all()
    return light


def colour_frame_of(path: Path) -> object:
    plane_depth = path.with_name("plane_depth.png")
    plane_depth.write_bytes(written(write_plane_depth, ".png"))
    return read_frame(path, right_camera(path), plane_depth=plane_depth)


def plane_depth_frame_of(path: Path) -> object:
    colour = path.with_name("colour.png")
    colour.write_bytes(written(write_colour, ".png"))
    return read_frame(colour, right_camera(path), plane_depth=path)


def linear_frame_of(path: Path) -> object:
    return read_frame(path, right_camera(path))


def right_camera(beside: Path) -> Any:
    path = beside.with_name("camera.json")
    path.write_text(json.dumps(CAMERA))
    return read_camera(path)


@st.composite
def broken(draw: st.DrawFn, right: bytes) -> bytes:
    """Bytes that were right once: a few of them others, some cut out or doubled, the end missing; or any bytes."""
    kind = draw(st.integers(0, 9))
    if kind == 0:
        return draw(st.binary(max_size=300))
    content = bytearray(right)
    # Places from a generator: hypothesis likes the first ones best, and files break anywhere.
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    for index in rng.integers(0, len(content), draw(st.integers(0, 4))):
        content[index] = rng.integers(256)
    if kind > 6:
        start, length = rng.integers(0, len(content)), rng.integers(1, 50)
        content[start : start + length] = bytes(content[start : start + length]) * int(rng.integers(0, 3))
    return bytes(content[: rng.integers(0, len(content) + 1)] if kind > 7 else content)


ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=20,
)


@st.composite
def broken_camera(draw: st.DrawFn) -> bytes:
    """A camera file with some entries changed to any JSON."""
    content = dict(CAMERA)
    for name in draw(st.lists(st.sampled_from(sorted(content)), max_size=3)):
        content[name] = draw(ANY_JSON | st.lists(st.lists(st.floats(), min_size=4, max_size=4), min_size=4, max_size=4))
    return json.dumps(content if draw(st.integers(0, 9)) else draw(ANY_JSON)).encode()


ANY_ARRAY = st.one_of(
    st.floats().map(np.float64),
    st.integers(-(2**62), 2**62).map(np.int64),
    st.text(max_size=5).map(np.array),
    st.tuples(
        st.sampled_from(["u1", "f2", "f4", "f8", "i8", "c16", "?", "U3", "M8[s]"]),
        st.lists(st.integers(0, 4), max_size=4),
    ).map(lambda given: np.ones(given[1], given[0]) if given[0] != "U3" else np.full(given[1], "abc")),
)


def unpacked(right: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(right)) as stored:
        return dict(stored)


def packed(content: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    np.savez(file, **content)
    return file.getvalue()


@st.composite
def changed_members(draw: st.DrawFn, right: bytes) -> bytes:
    """An .npz of the right form, some of whose arrays are others, or missing, or more."""
    content = unpacked(right)
    for name in draw(st.lists(st.sampled_from([*sorted(content), "more"]), min_size=1, max_size=3)):
        content[name] = draw(ANY_ARRAY)
    if draw(st.integers(0, 3)) == 0:
        content.pop(draw(st.sampled_from(sorted(content))))
    return packed(content)


@st.composite
def changed_header(draw: st.DrawFn) -> bytes:
    """A weights file whose JSON header says something else."""
    content = unpacked(written(write_weights, ".npz"))
    header = json.loads(content["header"].item())
    for name in draw(st.lists(st.sampled_from(sorted(header)), min_size=1, max_size=2)):
        header[name] = draw(ANY_JSON)
    if draw(st.booleans()):
        header["architecture"] = dict(json.loads(content["header"].item())["architecture"])
        header["architecture"][draw(st.sampled_from(sorted(header["architecture"])))] = draw(ANY_JSON)
    content["header"] = np.array(json.dumps(header if draw(st.integers(0, 9)) else draw(ANY_JSON)))
    return packed(content)


def readers() -> dict[str, tuple[st.SearchStrategy[bytes], Reader]]:
    """Every reader by name: what it is given, and the reader."""
    frame, weights = written(write_frame, ".exr"), written(write_weights, ".npz")
    profile = sorted(PROFILES_FOLDER.glob("*.toml"))[0].read_bytes()
    cameras = broken_camera() | broken(json.dumps(CAMERA).encode())
    return {
        **{f"wire_{method}": (broken(some_payload(method)), wire_reader(method)) for method in METHODS},
        "recorded_frame": (broken(frame), from_file(load_frame, ".exr")),
        "weights": (broken(weights) | changed_members(weights) | changed_header(), from_file(network_of, ".npz")),
        "camera": (cameras, from_file(camera_of, ".json")),
        "phone_profile": (broken(profile), from_file(load_profile, ".toml")),
        "colour_image": (broken(written(write_colour, ".png")), from_file(colour_frame_of, ".png")),
        "linear_frame": (broken(written(write_linear_frame, ".exr")), from_file(linear_frame_of, ".exr")),
        "plane_depth_image": (broken(written(write_plane_depth, ".png")), from_file(plane_depth_frame_of, ".png")),
    }


READERS = readers()
FOUND = sorted(CORPUS.glob("*.bin"))


@pytest.mark.parametrize("name", list(READERS))
@some_examples()
@given(data=st.data())
def test_any_bytes_are_read_rightly_or_refused(name, data):
    files, reader = READERS[name]
    content = data.draw(files)
    with kept_where_it_breaks(name, content):
        reader(content)


@pytest.mark.parametrize("file", FOUND, ids=lambda file: file.stem)
def test_what_was_found_once_is_mended(file):
    _, reader = READERS[file.stem.split("-")[0]]
    assert reader(file.read_bytes()) is None


def test_the_corpus_is_there_and_small():
    assert FOUND
    assert all(file.stat().st_size < 10_000 for file in FOUND)
