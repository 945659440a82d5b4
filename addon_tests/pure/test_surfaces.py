"""Surfaces around an object, from points of planes that are known."""

from __future__ import annotations

import numpy as np
import pytest

from xihenet.camera_path.surfaces import Surface, clear_of, on_surfaces, surfaces_around

CENTRE = np.array([1.0, 2.0, 0.9])
CAMERA = np.array([0.5, 1.0, 1.6])


def surfaces_of(points, reach_m, seed=0, camera=CAMERA):
    return surfaces_around(points, np.broadcast_to(camera, points.shape), CENTRE, reach_m, seed)


def plane_points(rng, n, normal, offset, extent=0.5, noise=0.0):
    """Points on the plane normal . p = offset around CENTRE's foot on it."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    foot = CENTRE - normal * (CENTRE @ normal - offset)
    across = np.cross(normal, [0.3, 0.5, 0.81])
    across /= np.linalg.norm(across)
    along = np.cross(normal, across)
    u, v = rng.uniform(-extent, extent, (2, n))
    return foot + u[:, None] * across + v[:, None] * along + noise * rng.normal(size=(n, 1)) * normal


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.2, -0.1, 1), (1, 0, 0)])
def test_plane_is_found_among_clutter(normal):
    rng = np.random.default_rng(3)
    normal = np.array(normal) / np.linalg.norm(normal)
    points = plane_points(rng, 900, normal, CENTRE @ normal - 0.1, noise=0.002)
    clutter = CENTRE + rng.uniform(-0.5, 0.5, (300, 3))
    surface = surfaces_of(np.concatenate([clutter, points]), 0.6, camera=CENTRE + 0.7 * normal)[0]
    assert surface.normal @ normal > np.cos(np.radians(1.0))
    assert (CENTRE - surface.outline_m[0]) @ surface.normal == pytest.approx(0.1, abs=0.003)


def test_floor_and_wall_are_both_found_and_the_largest_is_first():
    rng = np.random.default_rng(4)
    floor = plane_points(rng, 1200, (0, 0, 1), 0.8)
    wall = plane_points(rng, 500, (-1, 0, 0), -1.3)
    surfaces = surfaces_of(np.concatenate([wall, floor]), 0.6)
    assert len(surfaces) == 2
    np.testing.assert_allclose([one.normal for one in surfaces], [[0, 0, 1], [-1, 0, 0]], atol=0.01)


def test_outline_is_convex_and_holds_its_points():
    rng = np.random.default_rng(5)
    points = plane_points(rng, 500, (0.1, 0.3, 1), CENTRE @ (np.array([0.1, 0.3, 1]) / np.sqrt(1.1)) - 0.2)
    surface = surfaces_of(points, 1.0)[0]
    edges = np.roll(surface.outline_m, -1, axis=0) - surface.outline_m
    turns = np.cross(edges, np.roll(edges, -1, axis=0)) @ surface.normal
    assert (turns > 0).all() or (turns < 0).all()
    # Every point is on the same side of every edge.
    sides = np.cross(edges[:, None], points[None] - surface.outline_m[:, None]) @ surface.normal
    assert (sides * np.sign(turns[0]) > -1e-9).all()


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.full((100, 3), np.nan),
        np.tile(CENTRE, (100, 1)),
        CENTRE + np.linspace(0, 0.3, 100)[:, None] * [1, 0, 0],
        CENTRE + np.linspace(0, 0.3, 100)[:, None] * [0.27, 0.53, 0.81],
        CENTRE
        + np.linspace(0, 0.3, 100)[:, None] * [0.27, 0.53, 0.81]
        + np.random.default_rng(0).normal(size=(100, 3)) * 0.004,
        CENTRE + np.random.default_rng(0).normal(size=(30, 3)) * 0.1,
    ],
    ids=["none", "not finite", "one place", "a line", "a line askew", "a cable", "too few"],
)
def test_nothing_flat_is_no_surface(points):
    assert surfaces_of(points, 0.5) == []


def test_seed_decides():
    rng = np.random.default_rng(6)
    points = np.concatenate(
        [plane_points(rng, 9000, (0, 0, 1), 0.8, noise=0.003), CENTRE + rng.uniform(-0.4, 0.4, (900, 3))]
    )
    first, again = (surfaces_of(points, 0.6, seed=1)[0] for _ in range(2))
    np.testing.assert_array_equal(first.outline_m, again.outline_m)


def test_reach_must_be_positive():
    with pytest.raises(ValueError, match="positive reach, got 0"):
        surfaces_of(np.zeros((0, 3)), 0)


def test_points_on_a_plane():
    surface = Surface(np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]), np.array([0.0, 0, 1]), 0.02)
    points = np.array([[0.3, 0.3, 1.01], [0.3, 0.3, 1.1], [5, 5, 1], [np.nan, 0, 1], [0.3, 0.3, np.inf]])
    np.testing.assert_array_equal(on_surfaces(points, [surface]), [True, False, False, False, False])
    turned = Surface(surface.outline_m[::-1], surface.normal, 0.02)
    np.testing.assert_array_equal(on_surfaces(points, [turned]), on_surfaces(points, [surface]))
    assert not on_surfaces(points, []).any()


@pytest.mark.parametrize(("lowest", "moved_to"), [(1.5, 1.0), (1.0, 1.0), (0.97, 0.97), (0.9, 1.0)])
def test_surface_is_moved_below_a_box_that_sinks_into_it_a_little(lowest, moved_to):
    surface = Surface(np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]), np.array([0.0, 0, 1]), 0.02)
    box = np.array([[0.2, 0.2, lowest], [0.4, 0.4, lowest + 0.5]])
    np.testing.assert_allclose(clear_of(surface, box).outline_m, surface.outline_m * [1, 1, moved_to])


def test_surface_looks_at_those_who_have_seen_it():
    """Rims of cups just above a ball, seen from above, are no ceiling."""
    rng = np.random.default_rng(7)
    points = plane_points(rng, 900, (0, 0, 1), 1.0)
    assert len(surfaces_of(points, 0.6, camera=np.array([1.0, 1.0, 0.5]))) == 1
    assert surfaces_of(points, 0.6, camera=np.array([1.0, 1.0, 1.5])) == []


def test_plane_with_more_holes_than_points_is_no_surface():
    rng = np.random.default_rng(8)
    cups = [CENTRE + [x, y, -0.1] for x, y in ((-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4))]
    points = np.concatenate([cup + rng.uniform(-0.04, 0.04, (200, 3)) * [1, 1, 0.05] for cup in cups])
    assert surfaces_of(points, 0.7) == []
    floor = plane_points(rng, 800, (0, 0, 1), 0.7)
    (surface,) = surfaces_of(np.concatenate([points, floor]), 0.7)
    assert surface.offset_m == pytest.approx(0.7, abs=1e-6)
