"""Merging what was seen, and the two clouds of a position."""

import numpy as np
import pytest

from addon_tests.pure.made import random_cloud
from xihenet.buffers import PositionBuffers, merge
from xihenet.records import AnchorSurfaces, UnitSphereCloud

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
    again = fired.with_frame(third)
    assert same(again.fired().persistent, merge(merge(first, second), third))
    assert same(again.last_seen(), again.fired().persistent)
    assert again.coverage() == again.fired().persistent.is_set.mean()


def with_surfaces(cloud, rng):
    n, known = len(cloud), cloud.is_set
    numbers = rng.random((6, n)) * known
    surfaces = AnchorSurfaces(numbers[0], numbers[1], numbers[2], numbers[3:].T, (rng.random(n) < 0.5) & known)
    return UnitSphereCloud(cloud.srgb, cloud.distance_m, cloud.is_set, surfaces=surfaces)


@pytest.mark.parametrize("has_old", [False, True])
@pytest.mark.parametrize("has_new", [False, True])
def test_surfaces_go_with_their_anchors_and_are_unknown_where_nobody_looked(has_old, has_new):
    rng = np.random.default_rng(7)
    old, new = random_cloud(rng, N), random_cloud(rng, N)
    old, new = (with_surfaces(cloud, rng) if has else cloud for cloud, has in ((old, has_old), (new, has_new)))
    merged = merge(old, new)
    if not (has_old or has_new):
        assert merged.surfaces is None
        return
    for name in ("facing", "incidence", "camera_distance_m", "view_direction", "is_edge"):
        for anchor in range(N):
            source = (new if new.is_set[anchor] else old).surfaces
            expected = 0 if source is None else getattr(source, name)[anchor]
            assert (getattr(merged.surfaces, name)[anchor] == expected).all()
