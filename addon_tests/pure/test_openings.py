"""Pixels without a distance lie in the hole that they are in, on a plane through its rim."""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, label

from addon_tests.pure.made import frame_of
from xihenet.camera import unproject_frame, valid_plane_depth
from xihenet.openings import N_ROUNDS, QUANTILE, SLOPE_PENALTY, SMALLEST_RESIDUAL, SMALLEST_RIM, with_openings
from xihenet.records import Intrinsics

CAMERA = Intrinsics(96, 72, 60.0, 60.0, 48.0, 36.0)


def filled(plane_depth_m):
    return with_openings(plane_depth_m, valid_plane_depth(plane_depth_m))


def _rim_of(holes, number, is_valid):
    """Valid pixels beside those of a hole, each as often as it is beside one."""
    rim = []
    for row, column in np.argwhere(holes == number):
        for beside in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
            if 0 <= beside[0] < holes.shape[0] and 0 <= beside[1] < holes.shape[1] and is_valid[beside]:
                rim.append(beside)
    return rim


def plainly_filled(plane_depth_m):
    """Hole after hole, which another library finds, and pixel after pixel of its rim."""
    is_valid, width = valid_plane_depth(plane_depth_m), plane_depth_m.shape[1]
    holes, n_holes = label(~is_valid & ~np.isnan(plane_depth_m))
    result = plane_depth_m.copy()
    rims = {number: _rim_of(holes, number, is_valid) for number in range(1, n_holes + 1)}
    large = [1 / float(plane_depth_m[beside]) for rim in rims.values() if len(rim) >= SMALLEST_RIM for beside in rim]
    for number in range(1, n_holes + 1):
        inside, rim = np.argwhere(holes == number), rims[number]
        if not rim:
            continue
        values = np.array([1 / float(plane_depth_m[beside]) for beside in rim])
        middle = inside.mean(axis=0)
        plane = np.array([values.mean(), 0, 0])
        places = np.column_stack([np.ones(len(rim)), (np.array(rim) - middle) / width])
        weights = np.full(len(rim), 1 / np.median(large or 1))
        for _ in range(N_ROUNDS if len(rim) >= SMALLEST_RIM else 0):
            penalty = np.diag([0, SLOPE_PENALTY, SLOPE_PENALTY]) * len(rim) / np.median(large)
            plane = np.linalg.solve(places.T @ np.diag(weights) @ places + penalty, places.T @ (weights * values))
            off = values - places @ plane
            weights = np.where(off > 0, QUANTILE, 1 - QUANTILE) / np.maximum(
                abs(off), SMALLEST_RESIDUAL * np.median(large)
            )
        for row, column in inside:
            inverse = plane @ [1, (row - middle[0]) / width, (column - middle[1]) / width]
            result[row, column] = 1 / min(max(inverse, values.min()), values.max())
    return result


@pytest.mark.parametrize("seed", range(8))
def test_holes_are_filled_as_by_the_plain_loop(seed):
    rng = np.random.default_rng(seed)
    plane_depth_m = rng.uniform(0.3, 9, (24, 36)).astype(np.float32)
    blocks = rng.random((24, 36)) < (0.05, 0.3, 0.6, 0.9)[seed % 4]
    plane_depth_m[binary_dilation(blocks, iterations=seed % 2 + 1) if seed < 4 else blocks] = rng.choice(
        [0, np.inf, -1]
    )
    plane_depth_m[rng.random((24, 36)) < 0.02] = np.nan
    np.testing.assert_allclose(filled(plane_depth_m), plainly_filled(plane_depth_m), rtol=1e-5)


def test_a_hole_in_a_wall_is_in_the_wall_and_what_is_broken_stays_unknown():
    wall = np.full((72, 96), 2.5, np.float32)
    holes = wall.copy()
    holes[10:20, 30:70], holes[30:40, 30:70], holes[50:52], holes[60, :5] = 0, np.nan, np.inf, 0
    cloud, whole = (unproject_frame(frame_of(depth, CAMERA)) for depth in (holes, wall))
    seen = ~np.isnan(holes.ravel())
    np.testing.assert_array_equal(np.isfinite(cloud.points_m).all(axis=1), seen)
    np.testing.assert_allclose(cloud.points_m[seen], whole.points_m[seen], rtol=1e-6, atol=1e-7)
    assert cloud.invalid == {"not_finite": 10 * 40}
    assert cloud.grid.far is None
    np.testing.assert_array_equal(
        np.isin(np.arange(72 * 96), cloud.grid.openings), (holes == 0).ravel() | np.isinf(holes.ravel())
    )


@pytest.mark.parametrize(("ends_m", "within"), [((3.33, 2.0), 0.01), ((5.0, 1.25), 0.12)])
def test_a_hole_in_a_slanted_wall_follows_it(ends_m, within):
    """The inverse of depth is affine along it; a slope costs something, which a steep one feels."""
    wall = np.tile(1 / np.linspace(*np.reciprocal(ends_m), 96), (72, 1)).astype(np.float32)
    holes = wall.copy()
    holes[10:50, 20:80] = 0
    np.testing.assert_allclose(filled(holes), wall, rtol=within)


def test_what_stands_before_a_window_or_shows_through_it_moves_it_little():
    """A chair before a fifth of its rim, and a tree behind another fifth, in a wall 3 m ahead."""
    depth = np.full((72, 96), 3.0, np.float32)
    depth[20:50, 30:70] = 0
    depth[50:60, 35:60], depth[20:32, 60:70] = 1.2, 9.0
    hole = depth == 0
    assert 2.6 < np.median(filled(depth)[hole]) < 3.6


@pytest.mark.parametrize("nothing", [np.zeros((5, 7)), np.full((5, 7), np.nan), np.ones((5, 7)), np.zeros((0, 7))])
def test_where_there_is_nothing_to_fill_the_same_array_comes_back(nothing):
    plane_depth_m = nothing.astype(np.float32)
    assert filled(plane_depth_m) is plane_depth_m


def test_a_hole_with_nothing_beside_it_stays_as_it_is():
    plane_depth_m = np.full((9, 9), 2.0, np.float32)
    plane_depth_m[2:7, 2:7], plane_depth_m[4, 4] = np.nan, 0
    np.testing.assert_array_equal(filled(plane_depth_m), plane_depth_m)
