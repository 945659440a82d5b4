"""Unit-sphere sampling against its plain reference, and the two baselines."""

import sys
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addon_tests.pure.made import assert_same
from xihenet.records import PointCloud
from xihenet.sampling import sample_farthest, sample_uniform, sample_unit_sphere
from xihenet.sampling_reference import sample_unit_sphere_reference
from xihenet.sphere import AnchorLattice

LATTICE = AnchorLattice(1280)
ORIGIN = np.zeros(3)
NEEDS_FPSAMPLE = pytest.mark.wheel_only("fpsample, for one baseline, has no wheels that Blender's Python could load")
BASELINES = [sample_uniform, pytest.param(sample_farthest, marks=NEEDS_FPSAMPLE)]


def random_cloud(rng, n, size_m=5.0):
    return PointCloud(rng.uniform(-size_m, size_m, (n, 3)), rng.random((n, 3), np.float32))


def nasty_cloud(rng, dtype=np.float32):
    """Bad points and colours, points at the position, twins, and distances from 1e-30 to 1e30, among ordinary ones."""
    directions = rng.normal(size=(400, 3))
    lengths = 10.0 ** rng.uniform(-30, 30, (400, 1))
    points = np.concatenate([directions, directions * lengths, directions[:100], np.zeros((3, 3))]).astype(dtype)
    srgb = rng.random(points.shape, np.float32)
    points[5], points[50, 1], points[60, 2] = np.nan, np.inf, -np.inf
    points[70] = 0.9 * np.finfo(dtype).max  # its distance overflows
    srgb[80], srgb[90, 1] = np.nan, np.inf
    return PointCloud(points, srgb)


@settings(max_examples=15, deadline=None)
@given(n=st.sampled_from([1, 2, 7, 64, 1280]), n_points=st.integers(0, 2000), seed=st.integers(0, 2**32 - 1))
def test_sampling_agrees_with_the_reference_on_random_points(n, n_points, seed):
    rng = np.random.default_rng(seed)
    cloud, position, lattice = random_cloud(rng, n_points), rng.uniform(-4, 4, 3), AnchorLattice(n)
    assert_same(
        sample_unit_sphere(cloud, position, lattice), sample_unit_sphere_reference(cloud, position, lattice), rtol=4e-7
    )


@pytest.mark.parametrize("n", [1, 2, 64, 1280])
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_sampling_agrees_with_the_reference_on_nasty_points(n, seed, dtype):
    cloud, lattice = nasty_cloud(np.random.default_rng(seed), dtype), AnchorLattice(n)
    assert cloud.points_m.dtype == dtype
    sampled = sample_unit_sphere(cloud, ORIGIN, lattice)
    assert_same(sampled, sample_unit_sphere_reference(cloud, ORIGIN, lattice), rtol=4e-7)
    assert sampled.n_invalid_points == 3 + 1 + 2 + 3


def test_memory_layout_of_the_points_does_not_matter():
    cloud = random_cloud(np.random.default_rng(2), 5000)
    by_column = PointCloud(np.asfortranarray(cloud.points_m), np.asfortranarray(cloud.srgb))
    assert_same(sample_unit_sphere(cloud, ORIGIN, LATTICE), sample_unit_sphere(by_column, ORIGIN, LATTICE), rtol=0)


def test_table_sampling_differs_in_some_anchors_only():
    cloud = random_cloud(np.random.default_rng(10), 49_152)
    exact = sample_unit_sphere(cloud, ORIGIN, LATTICE)
    by_table = sample_unit_sphere(cloud, ORIGIN, LATTICE, method="table")
    by_brute = sample_unit_sphere(cloud, ORIGIN, LATTICE, method="brute")
    assert_same(exact, by_brute, rtol=0)
    assert 0 < (exact.distance_m != by_table.distance_m).mean() < 0.2


@pytest.mark.parametrize("position", [[0, 0], [np.nan, 0, 0], [0, np.inf, 0], [[0, 0, 0]]])
def test_position_must_be_three_finite_numbers(position):
    with pytest.raises(ValueError, match="position_m: expected three finite numbers"):
        sample_unit_sphere(random_cloud(np.random.default_rng(0), 3), position, LATTICE)


@pytest.mark.parametrize("sample", BASELINES)
def test_baselines_pick_different_usable_points_with_their_own_colours(sample):
    cloud = nasty_cloud(np.random.default_rng(11))
    cloud = PointCloud(cloud.points_m[:400], cloud.srgb[:400])
    picked = sample(cloud, 128, np.random.default_rng(12))
    assert len(picked.points_m) == 128
    assert np.isfinite(picked.points_m).all() and np.isfinite(picked.srgb).all()
    pairs = {(*point, *colour) for point, colour in zip(cloud.points_m, cloud.srgb, strict=True)}
    chosen = {(*point, *colour) for point, colour in zip(picked.points_m, picked.srgb, strict=True)}
    assert len(chosen) == 128 and chosen <= pairs


@pytest.mark.parametrize("sample", BASELINES)
def test_baselines_leave_out_points_that_float32_cannot_hold(sample):
    points_m = np.random.default_rng(11).normal(size=(40, 3))
    points_m[7] = 1e300
    picked = sample(PointCloud(points_m, np.zeros((40, 3))), 38, np.random.default_rng(12))
    assert np.abs(picked.points_m).max() < 10


@pytest.mark.parametrize("sample", BASELINES)
def test_baselines_repeat_for_a_seed_and_differ_for_another(sample):
    cloud = random_cloud(np.random.default_rng(13), 2000)
    first, same, other = (sample(cloud, 50, np.random.default_rng(seed)).points_m for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("sample", BASELINES)
@pytest.mark.parametrize(("n", "n_points", "expected"), [(0, 5, 0), (5, 5, 5), (9, 5, 5), (3, 0, 0)])
def test_baselines_give_all_points_where_there_are_no_more(sample, n, n_points, expected):
    cloud = random_cloud(np.random.default_rng(14), n_points)
    assert len(sample(cloud, n, np.random.default_rng(0)).points_m) == expected


@pytest.mark.parametrize("sample", BASELINES)
def test_baselines_refuse_a_negative_number(sample):
    with pytest.raises(ValueError, match="0 points or more, got -1"):
        sample(random_cloud(np.random.default_rng(0), 3), -1, np.random.default_rng(0))


def test_uniform_sampling_favours_no_point():
    cloud = PointCloud(np.arange(30).reshape(10, 3), np.zeros((10, 3)))
    rng = np.random.default_rng(15)
    counts = np.zeros(10)
    for _ in range(2000):
        counts[(sample_uniform(cloud, 3, rng).points_m[:, 0] / 3).astype(int)] += 1
    np.testing.assert_allclose(counts / 2000, 0.3, atol=0.05)


@NEEDS_FPSAMPLE
@pytest.mark.parametrize(("n_points", "origin_m"), [(3000, 0.0), (3000, 5e6), (61, 0.0)])
def test_each_farthest_point_is_the_farthest_from_those_before_it(n_points, origin_m):
    cloud = random_cloud(np.random.default_rng(16), n_points)
    cloud = PointCloud(cloud.points_m.astype(np.float64) + origin_m, cloud.srgb)
    picked = sample_farthest(cloud, 60, np.random.default_rng(17)).points_m.astype(np.float64)
    gap_m = np.full(n_points, np.inf)
    for point, following in pairwise(picked):
        gap_m = np.minimum(gap_m, np.linalg.norm(cloud.points_m - point, axis=1))
        gap_of_following_m = gap_m[(cloud.points_m == following).all(axis=1)]
        assert gap_of_following_m == pytest.approx([gap_m.max()], rel=1e-5)


def test_farthest_sampling_names_the_extra_that_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "fpsample", None)
    with pytest.raises(ImportError, match=r"xihe-blender\[bench\]"):
        sample_farthest(random_cloud(np.random.default_rng(0), 9), 3, np.random.default_rng(0))
