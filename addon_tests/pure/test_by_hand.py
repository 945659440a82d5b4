"""Scale and floor of a recording, set by hand: the room is as large as said, and its floor at 0."""

from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.commands import assert_refused, xihe_here
from addon_tests.pure.recordings import HALF, walk
from addon_tests.pure.test_estimate_command import read_strictly
from xihe_blender.cli.main import main
from xihenet.camera import unproject_frame
from xihenet.captures import open_capture, set_by_hand
from xihenet.captures.writing import WRITERS
from xihenet.records import Intrinsics

CAMERA = Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)


@pytest.fixture
def folder(tmp_path):
    WRITERS["nerfstudio"](tmp_path / "in", walk(CAMERA))
    return tmp_path / "in"


def test_the_room_is_as_large_as_said_and_its_floor_at_0(folder):
    placed = set_by_hand(open_capture(folder), scale=2.0, floor_m=-2 * HALF[2])
    points_m = np.concatenate([unproject_frame(frame).points_m for frame in placed])
    np.testing.assert_allclose(points_m.min(axis=0), (-2 * HALF[0], -2 * HALF[1], 0), atol=0.01)
    np.testing.assert_allclose(points_m.max(axis=0), (2 * HALF[0], 2 * HALF[1], 4 * HALF[2]), atol=0.01)
    for frame in placed.frames:
        assert (frame.camera.world_from_camera == frame.read().world_from_camera).all()


def test_nothing_by_hand_is_the_recording_itself(folder):
    capture = open_capture(folder)
    assert set_by_hand(capture) is capture


def test_what_has_no_distance_has_none_in_another_scale(folder):
    capture = open_capture(folder)
    missed = np.tile(np.float32([0, np.nan, np.inf, 1e10]), (48, 16))
    frames = [frame.changed(lambda read: replace(read, plane_depth_m=missed)) for frame in capture.frames]
    placed = set_by_hand(replace(capture, frames=frames), scale=1e-3)
    np.testing.assert_array_equal(placed.frames[0].read().plane_depth_m, missed)


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        *((f"--scale={scale}", "positive factor from 1e-6 to 1e6") for scale in ("0", "nan", "1e300")),
        ("--floor=inf", "a height in metres"),
    ],
)
def test_what_is_no_scale_and_no_floor_is_one_line(folder, tmp_path, typed, said):
    assert_refused(xihe_here("replay", folder, "--at", "0,0,0", "--out", tmp_path / "out", typed), said)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_light_does_not_depend_on_the_unit_of_length(folder, tmp_path):
    """A place in the room of twice the size has the light of that place."""
    lights = []
    for name, at, more in (("one", "0.4,0.3,-0.5", []), ("two", "0.8,0.6,1.4", ["--scale", "2", "--floor", "-2.4"])):
        # Networks are told distances in metres, and so may say a little else.
        common = ["--at", at, "--out", str(tmp_path / name), "--estimator", "projection"]
        assert main(["replay", str(folder), *common, *more]) == 0
        content = read_strictly((tmp_path / name / "replay.json").read_text())
        lights.append(np.array(content["positions"][0]["lights"][-1]["sh_radiance"]))
    assert np.linalg.norm(lights[1] - lights[0]) < 1e-6 * np.linalg.norm(lights[0])
