"""The study of joint entropy: what its switches do to a room of known walls."""

from dataclasses import replace

import numpy as np
import pytest

from xihe_blender.errors import UserError
from xihe_blender.lab.paper.records import Session, StudyOptions
from xihe_blender.lab.paper.studies.joint_entropy import PAPER_WAY, STUDY, Scan, relative_entropy, with_holes

pytestmark = pytest.mark.wheel_only("fpsample, for one baseline, has no wheels that Blender's Python could load")


@pytest.fixture(scope="module")
def scan():
    rng = np.random.default_rng(4)
    camera, rays = np.array([0, 0, 1.5]), rng.uniform((-0.6, 1, -0.7), (0.6, 1, 0.2), (6000, 3))
    reach = ((np.where(rays > 0, (3, 4, 3), (-3, -4, 0)) - camera) / rays).min(axis=1)
    return Scan("room", camera + rays * reach[:, None], camera, np.array([0, 2.5, 0]), 0.3)


def gain(scan, way):
    relative = relative_entropy(scan, way, seed=1)
    return relative["sphere"] - relative["uniform"]


def test_points_at_the_camera_make_the_gain_and_holes_left_out_do_not(scan):
    without = gain(scan, replace(PAPER_WAY, hole_share=0.0))
    few, many = (gain(scan, replace(PAPER_WAY, hole_share=share)) for share in (0.2, 0.5))
    assert without < few < many
    left_out = gain(scan, replace(PAPER_WAY, hole_share=0.5, holes_are_points=False))
    assert left_out == pytest.approx(without, abs=0.05)


def test_unset_anchors_kept_as_points_lose_entropy(scan):
    kept = relative_entropy(scan, replace(PAPER_WAY, unset_are_points=True), 1)["sphere"]
    assert kept < relative_entropy(scan, PAPER_WAY, 1)["sphere"] - 0.3


def test_equal_seeds_measure_the_same(scan):
    assert relative_entropy(scan, PAPER_WAY, 3) == relative_entropy(scan, PAPER_WAY, 3)
    assert relative_entropy(scan, PAPER_WAY, 3) != relative_entropy(scan, PAPER_WAY, 4)


def test_shares_of_holes_are_alike_for_views_of_any_depth(scan):
    shares = [one.hole_share for one in with_holes([scan] * 80, np.random.default_rng(5))]
    means = np.mean(np.split(np.array(shares), 4), axis=1)
    assert means == pytest.approx(2.4 / 6.9, abs=0.04)


def test_too_few_frames_are_refused(tmp_path):
    with pytest.raises(UserError, match="fewer than eight"):
        list(STUDY.measure([Session("room", (), 1.0, ())], StudyOptions(True, 0, tmp_path)))


def test_depth_range_is_of_the_farthest_point_over_the_middle_one(scan):
    along = np.array([[0, 1, 0], [0, 2, 0], [0, 6.0, 0]])
    assert replace(scan, points_m=scan.camera_m + along).depth_range == pytest.approx(3)
