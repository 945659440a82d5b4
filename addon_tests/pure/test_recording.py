"""A session that was kept can be run again."""

from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.frame_makers import NEEDS_OPENEXR
from addon_tests.pure.made import random_rotation
from xihenet.colour import srgb_to_linear
from xihenet.io.exr import read_stored_exr, write_exr
from xihenet.io.recording import ReplayScanner, SessionRecorder, load_frame, save_frame
from xihenet.records import Intrinsics, RgbdFrame


def random_frame(seed, ambient=None):
    rng = np.random.default_rng(seed)
    depths = rng.uniform(0, 5, (6, 8)).astype(np.float32)
    depths[0, :3] = [0, np.nan, np.inf]
    colours = rng.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    intrinsics = Intrinsics(8, 6, *rng.uniform(1, 9, 4))
    said = {} if ambient is None else {"white_balance": rng.uniform(0.5, 2, 3)}
    said |= {} if ambient is None else {"confidence": rng.integers(0, 3, (6, 8), dtype=np.uint8)}
    pose = np.vstack([np.column_stack([random_rotation(seed), rng.normal(size=3)]), [0, 0, 0, 1]])
    invalid = {"range": 3, "no_surface": 1}
    return RgbdFrame(colours, depths, intrinsics, pose, 0.3, ambient, 1.5, seed, invalid, **said)


def assert_same(a, b):
    for name in ("srgb_u8", "plane_depth_m", "world_from_camera", "ambient", "white_balance", "confidence"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    for name in ("intrinsics", "exposure", "time_s", "frame", "invalid"):
        assert getattr(a, name) == getattr(b, name)


@pytest.mark.parametrize("ambient", [None, [0.1, 0.2, 0.3]])
def test_a_frame_comes_back_bit_by_bit(tmp_path, ambient):
    frame = random_frame(1, ambient)
    save_frame(tmp_path / "frame.exr", frame)
    loaded = load_frame(tmp_path / "frame.exr")
    assert_same(loaded, frame)
    assert (loaded.ambient is None) == (ambient is None)
    assert [path.name for path in tmp_path.iterdir()] == ["frame.exr"]


@NEEDS_OPENEXR
def test_every_byte_comes_back_and_others_read_its_light(tmp_path):
    import OpenEXR

    every = np.arange(256, dtype=np.uint8).reshape(16, 16)
    colours = np.stack([every, every.T, every[::-1]], axis=-1)
    k = Intrinsics(16, 16, 9.0, 9.5, 8.25, 7.5)
    frame = RgbdFrame(colours, np.full((16, 16), 2.5), k, np.eye(4), 0.7, frame=-3, invalid={"range": 2})
    save_frame(tmp_path / "frame.exr", frame)
    assert_same(load_frame(tmp_path / "frame.exr"), frame)
    with OpenEXR.File(str(tmp_path / "frame.exr"), separate_channels=True) as file:
        header, channels = file.header(), file.channels()
        light = np.stack([channels[name].pixels for name in "RGB"], axis=-1)
        np.testing.assert_allclose(light, srgb_to_linear(colours / 255.0), rtol=1e-3)
        np.testing.assert_array_equal(header["worldFromCamera"], np.eye(4))
        assert (header["fy"], header["cx"], header["frame"], header["exposure"]) == (9.5, 8.25, -3, 0.7)
        assert header["invalid"] == "range 2" and (channels["Z"].pixels == 2.5).all()


def test_replay_gives_the_frames_in_the_order_of_recording(tmp_path):
    recorder = SessionRecorder(tmp_path / "walk")
    frames = [random_frame(seed) for seed in (7, 3, 5)]
    for frame in frames:
        recorder.record(frame)
    scanner = ReplayScanner(str(tmp_path / "walk"))
    assert len(scanner) == 3
    for frame in frames:
        assert_same(scanner.acquire_environment_scan(), frame)
    with pytest.raises(StopIteration):
        scanner.acquire_environment_scan()


def test_a_recording_is_never_overwritten(tmp_path):
    SessionRecorder(tmp_path).record(random_frame(0))
    with pytest.raises(FileExistsError, match="already holds a recording"):
        SessionRecorder(tmp_path)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 but no archive", b"nonsense"])
def test_a_file_that_is_no_frame_is_named(tmp_path, content):
    (tmp_path / "frame_000000.exr").write_bytes(content)
    with pytest.raises(ValueError, match=r"frame_000000\.exr: not a recorded frame"):
        ReplayScanner(tmp_path).acquire_environment_scan()


@pytest.mark.parametrize("level", [np.nan, -1, 1000])
def test_a_confidence_that_is_none_is_refused(tmp_path, level):
    path = tmp_path / "frame_000000.exr"
    save_frame(path, random_frame(0, [0.1, 0.2, 0.3]))
    said, channels = read_stored_exr(path)
    write_exr(path, channels | {"confidence": np.full((6, 8), level, np.float16)}, attributes=said)
    with pytest.raises(ValueError, match=r"not a recorded frame \(confidence: expected 0, 1 or 2"):
        load_frame(path)


def test_a_frame_that_is_cut_short_is_named_once_with_what_to_do(tmp_path):
    path = tmp_path / "frame_000000.exr"
    save_frame(path, random_frame(0))
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(ValueError) as caught:
        load_frame(path)
    assert str(caught.value).count(path.name) == 1 and "cut short: copy or save it again" in str(caught.value)


def test_a_folder_without_frames_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no recorded frames"):
        ReplayScanner(tmp_path)


def test_a_bit_that_turned_anywhere_in_the_pixels_is_noticed(tmp_path):
    recorded = random_frame(3)
    bits = recorded.plane_depth_m.view(np.uint32).copy()
    bits[0, :2] = 0xFFC00000, 0x7F800001  # A NaN with a sign, as some sums give, and one that signals.
    recorded = replace(recorded, plane_depth_m=bits.view(np.float32))
    path = tmp_path / "frame_000000.exr"
    save_frame(path, recorded)
    assert np.isnan(load_frame(path).plane_depth_m[0, :2].astype(np.float64)).all()
    content = path.read_bytes()
    n_pixel_bytes = recorded.plane_depth_m.size * (3 * 2 + 4)
    for at in np.random.default_rng(0).integers(len(content) - n_pixel_bytes, len(content), 40).tolist():
        path.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
        with pytest.raises(ValueError, match=r"frame_000000\.exr"):
            load_frame(path)
