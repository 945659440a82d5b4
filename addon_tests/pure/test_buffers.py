"""Merging what was seen, and the two clouds of a position."""

import numpy as np
import pytest

from addon_tests.pure.made import looked_at, random_cloud
from xihenet.buffers import PositionBuffers, in_sight, merge, merge_views
from xihenet.records import AnchorSurfaces, PointCloud, UnitSphereCloud
from xihenet.sampling import SAME_SURFACE, sample_again, sample_unit_sphere
from xihenet.sh import project_anchors
from xihenet.sphere import AnchorLattice

N = 64


def same(a, b):
    return (a.srgb == b.srgb).all() and (a.distance_m == b.distance_m).all() and (a.is_set == b.is_set).all()


def test_firing_moves_what_was_seen_into_the_persistent_cloud_and_starts_anew():
    rng = np.random.default_rng(3)
    first, second, third = random_cloud(rng, N), random_cloud(rng, N), random_cloud(rng, N)
    buffers = PositionBuffers.empty(N).with_frame(first).with_frame(second)
    assert not buffers.persistent.is_set.any() and same(buffers.temporary, merge(first, second))
    fired = buffers.fired()
    assert same(fired.persistent, merge(first, second)) and not fired.temporary.is_set.any()
    assert same(fired.fired().persistent, fired.persistent)
    again = fired.with_frame(third)
    assert same(again.fired().persistent, merge(merge(first, second), third))
    assert same(again.last_seen(), again.fired().persistent)
    assert again.coverage() == again.fired().persistent.is_set.mean()


def with_surfaces(cloud, rng):
    n, known = len(cloud), cloud.is_set
    numbers = rng.random((5, n)) * known
    surfaces = AnchorSurfaces(numbers[0], numbers[1], numbers[2:].T)
    return UnitSphereCloud(cloud.srgb, cloud.distance_m, cloud.is_set, surfaces=surfaces)


@pytest.mark.parametrize("has_old", [False, True])
@pytest.mark.parametrize("has_new", [False, True])
def test_surfaces_go_with_their_anchors_and_are_unknown_where_nobody_looked(has_old, has_new):
    rng = np.random.default_rng(7)
    old, new = random_cloud(rng, N), random_cloud(rng, N)
    old, new = (with_surfaces(cloud, rng) if has else cloud for cloud, has in ((old, has_old), (new, has_new)))
    merged = looked_at(merge(old, new))
    if not (has_old or has_new):
        assert merged.surfaces is None
        return
    for name in ("facing", "camera_distance_m", "view_direction"):
        for anchor in range(N):
            source = (new if new.is_set[anchor] else old).surfaces
            expected = 0 if source is None else getattr(source, name)[anchor]
            assert (getattr(merged.surfaces, name)[anchor] == expected).all()


def merged_anchor_by_anchor(old, new):
    """What `merge_views` says, in a plain loop: colours alone, (N, 3)."""
    srgb = merge(old, new).srgb.astype(np.float64)
    for anchor in range(len(old)):
        near, far = sorted((float(old.distance_m[anchor]), float(new.distance_m[anchor])))
        if not (old.is_set[anchor] and new.is_set[anchor] and far <= SAME_SURFACE * near):
            continue
        if len({bool(max(cloud.srgb[anchor]) >= 253.5 / 255) for cloud in (old, new)}) == 2:
            continue
        facing = [0.0 if cloud.surfaces is None else float(cloud.surfaces.facing[anchor]) for cloud in (old, new)]
        before, after = (min(max(cosine + 0.3, 0.2), 1.0) for cosine in facing)
        srgb[anchor] = (before * old.srgb[anchor] + after * new.srgb[anchor]) / (before + after)
    return srgb


@pytest.mark.parametrize("seed", range(20))
def test_views_of_one_surface_are_averaged_by_how_it_faces_and_others_are_merged(seed):
    rng = np.random.default_rng(seed)
    old, new = (
        UnitSphereCloud(np.minimum(2 * cloud.srgb, 1), cloud.distance_m, cloud.is_set)
        for cloud in (random_cloud(rng, N), random_cloud(rng, N))
    )
    distances = old.distance_m * rng.choice([1 / 1.4, 1 / 1.2, 1.0, 1.2, 1.4], N).astype(np.float32)
    new = UnitSphereCloud(new.srgb, np.where(new.is_set & old.is_set, distances, new.distance_m), new.is_set)
    huge = np.float32(2e38) if seed % 2 else np.float32(1e-40)
    sizes = [np.where(cloud.is_set & (np.arange(N) % 5 == 0), huge, cloud.distance_m) for cloud in (old, new)]
    old, new = (UnitSphereCloud(c.srgb, d, c.is_set) for c, d in zip((old, new), sizes, strict=True))
    old, new = (with_surfaces(cloud, rng) if seed % 3 != k else cloud for k, cloud in enumerate((old, new)))
    merged, plain = looked_at(merge_views(old, new)), merge(old, new)
    np.testing.assert_allclose(merged.srgb, merged_anchor_by_anchor(old, new), atol=1e-6)
    assert (merged.distance_m == plain.distance_m).all() and (merged.is_set == plain.is_set).all()
    assert (merged.srgb != plain.srgb).any()


def test_a_view_that_shows_the_same_changes_nothing_to_the_last_bit():
    rng = np.random.default_rng(5)
    old = with_surfaces(random_cloud(rng, N), rng)
    assert same(merge_views(old, old), old)
    assert same(merge_views(old, UnitSphereCloud.empty(N)), old) and same(
        merge_views(UnitSphereCloud.empty(N), old), old
    )


def test_firing_averages_views_only_where_the_light_is_the_same():
    rng = np.random.default_rng(4)
    seen = random_cloud(rng, N)
    first, second = (UnitSphereCloud(np.float32(s) * seen.srgb, seen.distance_m, seen.is_set) for s in (0.9, 0.45))
    buffers = PositionBuffers.empty(N).with_frame(first).fired().with_frame(second)
    assert same(buffers.fired(is_changed=True).persistent, second)
    averaged = buffers.fired(is_changed=False).persistent
    np.testing.assert_allclose(averaged.srgb, 0.75 * first.srgb, atol=1e-6)


def seen_in_a_painted_box(position_m, lattice):
    """All of a box of 4 x 4 x 3 m whose colour is its place."""
    rays = np.random.default_rng(0).normal(size=(200_000, 3))
    corner = np.where(rays > 0, (2, 2, 1.5), (-2, -2, -1.5))
    points_m = position_m + rays * ((corner - position_m) / rays).min(axis=1, keepdims=True)
    return sample_unit_sphere(PointCloud(points_m, points_m / 8 + 0.5), position_m, lattice)


@pytest.mark.parametrize("moved_m", [(0.3, 0.2, -0.1), (0.0, -0.6, 0.4)])
def test_a_position_that_moves_sees_the_same_surfaces_from_its_new_place(moved_m):
    lattice, here = AnchorLattice(1280), np.array([0.2, 0.1, -0.2])
    stale, expected = seen_in_a_painted_box(here, lattice), seen_in_a_painted_box(here + moved_m, lattice)
    moved = sample_again(stale, moved_m, lattice)
    # What comes nearer is spread over more anchors than it had.
    assert 0.75 < moved.is_set.mean() < 1
    error_m, stale_m = (8 * np.abs(one.srgb - expected.srgb)[moved.is_set].max(axis=1) for one in (moved, stale))
    assert np.median(error_m) < min(0.15, np.median(stale_m) / 2) and np.quantile(error_m, 0.95) < 0.4
    ratio = moved.distance_m[moved.is_set] / expected.distance_m[moved.is_set]
    assert np.median(np.abs(ratio - 1)) < 0.03


@pytest.mark.parametrize("n_moves", [5, 40, 200])
def test_many_small_moves_are_as_one_large_one(n_moves):
    lattice, here, moved_m = AnchorLattice(1280), np.array([0.2, 0.1, -0.2]), np.array([0.5, -0.4, 0.1])
    start, expected = seen_in_a_painted_box(here, lattice), seen_in_a_painted_box(here + moved_m, lattice)
    # What was seen before a step and what came with it go on alike.
    buffers = PositionBuffers.empty(1280).with_frame(start).fired().with_frame(start)
    for _ in range(n_moves):
        buffers = buffers.moved(moved_m / n_moves, lattice).with_frame(UnitSphereCloud.empty(1280))
    for cloud in (buffers.persistent, buffers.temporary, buffers.fired(is_changed=False).persistent):
        assert cloud.is_set.mean() > 0.6
        error_m = 8 * np.abs(cloud.srgb - expected.srgb)[cloud.is_set].max(axis=1)
        assert np.median(error_m) < 0.15 and np.quantile(error_m, 0.95) < 0.5
        assert np.median(np.abs(cloud.distance_m / np.maximum(expected.distance_m, 1e-9) - 1)[cloud.is_set]) < 0.03
        light, true = (project_anchors(one, lattice) for one in (cloud, expected))
        assert np.abs(light - true).max() < 0.05


def test_a_position_that_does_not_move_keeps_what_it_knows():
    rng = np.random.default_rng(1)
    cloud = with_surfaces(random_cloud(rng, N), rng)
    again = sample_again(cloud, np.zeros(3), AnchorLattice(N))
    np.testing.assert_allclose(again.distance_m, cloud.distance_m, rtol=1e-6)
    assert (again.srgb == cloud.srgb).all() and (again.is_set == cloud.is_set).all()
    for name in vars(cloud.surfaces):
        np.testing.assert_array_equal(getattr(again.surfaces, name), getattr(cloud.surfaces, name))
    before = UnitSphereCloud(rng.random((N, 3)), np.full(N, 0.5), np.ones(N, bool))
    kept, expected = PositionBuffers(cloud, before).moved(np.zeros(3), AnchorLattice(N)), in_sight(before, cloud)
    for one, other in ((kept.persistent, before), (kept.temporary, expected)):
        assert (one.is_set == other.is_set).all() and (one.srgb == other.srgb).all()
    assert (expected.is_set != cloud.is_set).any()


def test_a_surface_that_a_position_passes_lies_behind_it_and_at_the_surface_itself_nothing_is_seen():
    lattice, is_set = AnchorLattice(N), np.arange(N) < 1
    up, cloud = lattice.directions[0], UnitSphereCloud(np.outer(is_set, [0.5] * 3), 2.0 * is_set, is_set)
    assert not sample_again(cloud, 2 * up, lattice).is_set.any()
    assert np.flatnonzero(sample_again(cloud, 3 * up, lattice).is_set) == lattice.nearest(-up[None])
    with pytest.raises(ValueError, match="anchors"):
        sample_again(cloud, up, AnchorLattice(N + 1))
