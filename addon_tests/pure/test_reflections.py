"""The picture that glossy things reflect: what was seen as it was seen, the estimate elsewhere, no seam between."""

from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.made import constant, frame_of
from addon_tests.pure.sh_samples import random_directions, random_light
from xihenet.camera import unproject_frame
from xihenet.colour import linear_to_srgb
from xihenet.light.key_light import rest_of, sh_of_key_light
from xihenet.light.reflections import (
    fill_reflections,
    light_of_rough,
    reflection_panorama,
    rendered_reflections,
    thinned,
    without_key_light,
)
from xihenet.mirror_ball import ball_directions
from xihenet.panorama import panorama_directions, solid_angles
from xihenet.records import FarPixels, Intrinsics, KeyLight, ObjectLight, PointCloud, Reflections, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import basis
from xihenet.sphere import AnchorLattice

LATTICE = AnchorLattice(2048)
FLAT = constant(0.3)


def cloud_of(radiance, is_set):
    srgb = linear_to_srgb(np.clip(radiance, 0, 1)) * is_set[:, None]
    return UnitSphereCloud(srgb, is_set * 2.0, is_set)


def half(axis=2):
    return LATTICE.directions[:, axis] > 0


@pytest.mark.parametrize("seed", range(5))
def test_what_was_seen_is_shown_as_it_was_seen_and_white_twice_as_bright(seed):
    rng = np.random.default_rng(seed)
    radiance, is_set = rng.random((len(LATTICE), 3)), rng.random(len(LATTICE)) < 0.4
    cloud = cloud_of(radiance, is_set)
    found = fill_reflections(cloud, LATTICE, ObjectLight(random_light(seed=seed)))
    is_white = (cloud.srgb >= 0.95).any(axis=1)
    assert found.radiance[is_set & ~is_white] == pytest.approx(radiance[is_set & ~is_white], abs=1e-5)
    assert found.radiance[is_white] == pytest.approx(2 * radiance[is_white], abs=1e-5)
    assert found.seen_share == pytest.approx(is_set.mean())
    assert np.isfinite(found.radiance).all() and found.radiance.min() >= 0


def test_what_was_never_seen_is_the_estimate():
    light = random_light(seed=3)
    nothing = UnitSphereCloud.empty(len(LATTICE))
    found = fill_reflections(nothing, LATTICE, ObjectLight(light))
    assert found.radiance == pytest.approx(np.maximum(basis(LATTICE.directions) @ light, 0), abs=1e-5)
    assert found.seen_share == 0


def test_there_is_no_seam_and_far_away_it_is_halfway_between_the_estimate_and_what_was_seen():
    """Seen half 0.8, estimate 0.3: neighbours across the border differ little, the far pole has the mean of ratios."""
    is_set = half()
    found = fill_reflections(cloud_of(np.full((len(LATTICE), 3), 0.8), is_set), LATTICE, ObjectLight(FLAT)).radiance
    steps = np.abs(found[LATTICE.neighbours(7)[:, 1:]] - found[:, None]).max(axis=(1, 2))
    assert steps.max() < 0.1
    assert found[LATTICE.directions[:, 2].argmin()] == pytest.approx(np.sqrt(0.3 * 0.8), abs=0.02)


@pytest.mark.parametrize("n", [1, 6, 200])
def test_it_fades_ring_by_ring_and_is_smoothed_as_the_plain_loop_does(n):
    rng, lattice = np.random.default_rng(n), AnchorLattice(n)
    radiance, is_set = rng.uniform(0.3, 0.6, (n, 3)), np.arange(n) % 40 == 0
    guess = (np.log(0.3) + np.log(np.median(radiance[is_set], axis=0))) / 2
    around, kept = lattice.neighbours(min(7, n)), np.exp(-np.sqrt(4 * np.pi / n) / np.radians(20))
    known = {anchor: np.log(radiance[anchor]) - guess for anchor in np.flatnonzero(is_set)}
    while len(known) < n:
        beside = {a: [known[b] for b in around[a, 1:] if b in known] for a in range(n) if a not in known}
        known |= {anchor: kept * np.mean(values, axis=0) for anchor, values in beside.items() if values}
    faded = np.array([known[anchor] for anchor in range(n)])
    for _ in range(6):
        faded[~is_set] = faded[around[~is_set]].mean(axis=1)
    found = fill_reflections(cloud_of(radiance, is_set), lattice, ObjectLight(FLAT)).radiance
    assert found == pytest.approx(np.exp(guess + faded), abs=1e-5)


def test_a_window_draws_no_streak_beyond_what_was_seen_of_it():
    """The wall goes on in the dark half, a bright window at the border does not."""
    radiance = np.full((len(LATTICE), 3), 0.1)
    is_window = half() & (LATTICE.directions[:, 0] > 0.9) & (LATTICE.directions[:, 2] < 0.3)
    radiance[is_window] = 1.0
    light = ObjectLight(constant(0.1))
    found = fill_reflections(cloud_of(radiance, half()), LATTICE, light).radiance
    assert is_window.sum() > 10 and found[~half()].max() < 0.12


@pytest.mark.parametrize("seed", range(4))
def test_a_thinned_frame_shows_the_same_in_a_third_of_the_directions_and_more(seed):
    """Every other pixel of a picture: where both have seen something it is the same surface, and little is lost."""
    rng = np.random.default_rng(seed)
    camera = Intrinsics(256, 192, 220.0, 220.0, 128.0, 96.0)
    depth = np.full((192, 256), 3.0, np.float32)
    depth[60:90, 40:80], depth[100:, 200:] = 0, np.inf
    colours = np.repeat((255 * (np.indices((192, 256))[1] / 255)).astype(np.uint8)[..., None], 3, axis=2)
    cloud = unproject_frame(frame_of(depth, camera, np.eye(4), colours))
    few = thinned(cloud)
    assert len(few.points_m) * 4 == len(cloud.points_m) and (few.grid.height, few.grid.width) == (96, 128)
    were = np.arange(192 * 256).reshape(192, 256)[::2, ::2].ravel()
    np.testing.assert_array_equal(few.points_m, cloud.points_m[were])
    np.testing.assert_array_equal(few.srgb, cloud.srgb[were])
    np.testing.assert_array_equal(were[few.grid.openings], np.intersect1d(cloud.grid.openings, were))
    far = FarPixels(cloud.grid.openings, rng.normal(size=(3, len(cloud.grid.openings))).astype(np.float32))
    left = thinned(PointCloud(cloud.points_m, cloud.srgb, grid=replace(cloud.grid, far=far))).grid.far
    np.testing.assert_array_equal(were[left.pixels], np.intersect1d(far.pixels, were))
    np.testing.assert_array_equal(left.rays, far.rays[:, np.isin(far.pixels, were)])
    position_m, lattice = rng.uniform(-0.3, 0.3, 3), AnchorLattice(8192)
    whole, thin = sample_unit_sphere(cloud, position_m, lattice), sample_unit_sphere(few, position_m, lattice)
    both = whole.is_set & thin.is_set
    assert both.sum() > 0.95 * whole.is_set.sum()
    assert np.median(np.abs(whole.srgb - thin.srgb)[both]) < 0.02
    assert ((whole.distance_m > 30) == (thin.distance_m > 30))[both].mean() > 0.97


def test_a_frame_that_is_small_or_has_no_grid_is_not_thinned():
    points = PointCloud(np.ones((5, 3)), np.ones((5, 3)))
    assert thinned(points) is points
    small = unproject_frame(frame_of(np.ones((8, 8)), Intrinsics(8, 8, 8.0, 8.0, 4.0, 4.0)))
    assert thinned(small) is small


def test_a_rendered_mirror_ball_gives_the_light_that_it_shows():
    light = random_light(seed=2)
    light[0] += 6
    directions, on_ball = ball_directions(192)
    shown = (basis(directions.reshape(-1, 3)) @ light).reshape(192, 192, 3)
    ball = np.where(on_ball[..., None], shown, 0).astype(np.float32)
    found = rendered_reflections(ball, LATTICE)
    expected = np.maximum(basis(LATTICE.directions) @ light, 0)
    # Straight down is the rim of the ball, of which little is known.
    assert np.abs(found.radiance - expected)[LATTICE.directions[:, 2] > -0.92].max() < 0.02 * expected.max()
    assert found.seen_share == 1


def test_a_lamp_that_was_seen_gives_the_light_of_the_key_light():
    direction, radius = random_directions(1, 5)[0], 0.2
    cosine = LATTICE.directions @ direction
    picture = np.where((cosine > np.cos(radius))[:, None], 1.0, 0.3 * np.ones(3))
    key = KeyLight(direction, np.array([0.8, 0.6, 0.4]), radius, True)
    cloud = cloud_of(picture, np.ones(len(LATTICE), bool))
    found = fill_reflections(cloud, LATTICE, ObjectLight(FLAT + sh_of_key_light(key), key)).radiance
    patch = cosine > np.cos(radius)
    given = (found[patch] * cosine[patch, None]).sum(axis=0) * 4 * np.pi / len(LATTICE)
    assert given == pytest.approx(key.irradiance, rel=1e-3)
    sun = KeyLight(direction, 100 * key.irradiance, radius, True)
    assert fill_reflections(cloud, LATTICE, ObjectLight(FLAT, sun)).radiance.max() == pytest.approx(16.0, abs=1e-3)
    unseen = KeyLight(direction, 100 * key.irradiance, radius, False)
    assert fill_reflections(cloud, LATTICE, ObjectLight(FLAT, unseen)).radiance.max() == pytest.approx(2.0, abs=1e-5)


def test_a_lamp_that_the_estimate_implies_is_shown_where_nothing_was_seen():
    key = KeyLight(np.array([0.0, 0.6, 0.8]), np.array([4.0, 3.0, 2.0]), 0.2, False)
    light, cosine = ObjectLight(FLAT + sh_of_key_light(key), key), LATTICE.directions @ key.direction
    below = cloud_of(np.full((len(LATTICE), 3), 0.3), ~half())
    found = fill_reflections(below, LATTICE, light).radiance
    patch = cosine > np.cos(0.2)
    given = (found[patch] * cosine[patch, None]).sum(axis=0) * 4 * np.pi / len(LATTICE)
    assert given == pytest.approx(0.6 * key.irradiance, rel=1e-3)
    without = fill_reflections(below, LATTICE, ObjectLight(light.sh)).radiance
    assert np.array_equal(found[~patch], without[~patch])
    assert np.all(found[~half()] == pytest.approx(0.3, abs=1e-5))
    unsure = ObjectLight(light.sh, replace(key, certainty=0.1))
    given = (fill_reflections(below, LATTICE, unsure).radiance[patch] * cosine[patch, None]).sum(axis=0)
    assert given * 4 * np.pi / len(LATTICE) == pytest.approx(0.25 * key.irradiance, rel=1e-3)


def test_a_lamp_that_is_implied_is_as_bright_where_most_of_its_disc_was_seen_to_be_dark():
    key = KeyLight(np.array([0.0, 0.6, 0.8]), np.array([4.0, 3.0, 2.0]), 0.35, False)
    light, cosine = ObjectLight(FLAT + sh_of_key_light(key), key), LATTICE.directions @ key.direction
    sliver = (cosine > np.cos(0.35)) & (LATTICE.directions[:, 0] > 0.25)
    found = fill_reflections(cloud_of(np.full((len(LATTICE), 3), 0.3), ~sliver), LATTICE, light).radiance
    disc = 0.6 * key.irradiance / (np.pi * np.sin(0.35) ** 2)
    assert sliver.sum() >= 5 and found[sliver].mean(axis=0) == pytest.approx(disc, rel=0.05)


@pytest.mark.parametrize("n", [1, 2, 3, 8])
@pytest.mark.parametrize("direction", [*np.eye(3), *-np.eye(3)])
def test_a_lamp_that_is_implied_is_finite_among_a_few_directions(n, direction):
    lattice, key = AnchorLattice(n), KeyLight(direction, np.ones(3), 0.35, False)
    for is_set in (np.arange(n) % 2 == 0, np.arange(n) % 2 == 1, np.zeros(n, bool)):
        cloud = cloud_of(np.full((n, 3), 0.3), is_set)
        found = fill_reflections(cloud, lattice, ObjectLight(FLAT + sh_of_key_light(key), key)).radiance
        assert np.isfinite(found).all() and (found >= 0).all()


@pytest.mark.parametrize(("share", "radius"), [(0.3, 0.2), (1.0, 0.2), (2.0, 0.2), (1.0, 0.6)])
def test_a_sun_takes_as_much_light_out_of_the_picture_as_it_gives_and_none_from_elsewhere(share, radius):
    direction = random_directions(1, 7)[0]
    cosine = LATTICE.directions @ direction
    radiance = np.where((cosine > np.cos(radius))[:, None], [9.0, 6.0, 3.0], 0.3)
    radiance[LATTICE.directions @ -direction > np.cos(radius)] = 20.0
    whole = Reflections(radiance.astype(np.float32), 0.4)
    facing, solid_angle = np.maximum(cosine, 0)[:, None], 4 * np.pi / len(cosine)
    lamp = (radiance * facing * (cosine > np.cos(radius))[:, None]).sum(axis=0) * solid_angle
    key = KeyLight(direction, share * lamp, radius, True)
    rest = without_key_light(whole, key)
    taken = ((whole.radiance - rest.radiance) * facing).sum(axis=0) * solid_angle
    assert taken == pytest.approx(min(share, 1) * lamp, rel=1e-4)
    beside = cosine < min(np.cos(radius), 0.9)
    assert np.array_equal(rest.radiance[beside], whole.radiance[beside]) and rest.radiance.min() >= 0
    assert rest.seen_share == 0.4 and without_key_light(whole, None) is whole


def test_rough_things_have_the_sure_part_of_the_key_light_and_a_picture_with_the_rest_of_its_lamp():
    direction = random_directions(1, 7)[0]
    cosine = LATTICE.directions @ direction
    whole = Reflections(np.where((cosine > np.cos(0.2))[:, None], [9.0, 6.0, 3.0], 0.3).astype(np.float32), 0.4)
    key = KeyLight(direction, np.ones(3), 0.2, False, certainty=0.1)
    rough = light_of_rough(ObjectLight(FLAT + sh_of_key_light(key), key, whole))
    assert rough.key.irradiance == pytest.approx(np.full(3, 0.25))
    assert rest_of(rough) == pytest.approx(FLAT + 0.75 * sh_of_key_light(key))
    assert np.array_equal(rough.reflections.radiance, without_key_light(whole, rough.key).radiance)
    assert light_of_rough(ObjectLight(FLAT, key)).reflections is None


def test_lights_of_which_metal_shows_more_or_less_of_the_sun_are_not_the_same():
    key = KeyLight(np.array([0, 0, 1.0]), np.ones(3), 0.1, is_seen=False, certainty=0.1)
    lights = [ObjectLight(FLAT, one) for one in (key, replace(key, certainty=0.2), replace(key, is_seen=True))]
    assert len({light_of_rough(light).key.irradiance.tobytes() for light in lights}) == 3
    assert len({light.tobytes() for light in lights}) == 3


def test_the_panorama_shows_the_same_light_where_it_comes_from():
    light = random_light(seed=7)
    shown = np.maximum(basis(LATTICE.directions) @ light, 0).astype(np.float32)
    nothing = fill_reflections(UnitSphereCloud.empty(len(LATTICE)), LATTICE, ObjectLight(light))
    panorama = reflection_panorama(nothing, 32)
    expected = np.maximum(basis(panorama_directions(32, 64).reshape(-1, 3)) @ light, 0).reshape(32, 64, 3)
    assert panorama == pytest.approx(expected, abs=0.05 * expected.max())
    mean = (panorama * solid_angles(32, 64)[..., None]).sum(axis=(0, 1)) / (4 * np.pi)
    assert mean == pytest.approx(shown.mean(axis=0), rel=0.01)


def test_a_cloud_of_another_lattice_is_refused():
    with pytest.raises(ValueError, match="2048 anchors, got 12"):
        fill_reflections(UnitSphereCloud.empty(12), LATTICE, ObjectLight(FLAT))
