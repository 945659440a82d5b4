"""The key light of an estimate: found where it is, none where there is none, and nothing is added or lost."""

from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.made import constant, random_rotation
from addon_tests.pure.sh_samples import random_directions, random_light
from xihenet.buffers import merge
from xihenet.colour import linear_to_srgb
from xihenet.light.key_light import (
    UNSEEN_RADIUS,
    bright_patches,
    certainty_of,
    find_key_light,
    mean_light,
    rest_of,
    sh_of_key_light,
    sure_part,
)
from xihenet.records import KeyLight, ObjectLight, UnitSphereCloud
from xihenet.sh import basis, irradiance, rotate
from xihenet.sphere import AnchorLattice

LATTICE = AnchorLattice(1280)
FINE = AnchorLattice(60_000)


def lamp(direction, strength=1.0, radius=0.0, colour=(1.0, 1.0, 1.0)):
    """(9, 3) coefficients of a disc of that irradiance."""
    return sh_of_key_light(KeyLight(np.asarray(direction, float), strength * np.array(colour), radius, True))


def flat(radiance=0.1):
    return constant(radiance)


def seen(*lamps, radius=0.14, wall=0.2, share=1.0, shows=1.0, lattice=LATTICE):
    """A cloud of a grey room in which discs show a radiance, as far as `share` of the anchors from the top."""
    bright = np.zeros(len(lattice), bool)
    for direction in lamps:
        bright |= lattice.directions @ direction > np.cos(radius)
    is_set = np.arange(len(lattice)) < share * len(lattice)
    srgb = linear_to_srgb(np.where(bright, shows, wall))[:, None] * np.ones(3)
    return UnitSphereCloud(srgb * is_set[:, None], is_set * 2.0, is_set)


def only(cloud, direction, lattice=LATTICE):
    """What it shows within 15 degrees of a direction."""
    near = lattice.directions @ direction > np.cos(np.radians(15))
    near &= cloud.srgb[:, 0] == cloud.srgb[:, 0].max()
    return UnitSphereCloud(cloud.srgb * near[:, None], cloud.distance_m * near, near)


def apart_by(angle_deg, seed):
    """Two directions that far from each other."""
    one, other = random_directions(2, seed)
    side = other - (other @ one) * one
    angle = np.radians(angle_deg)
    return one, np.cos(angle) * one + np.sin(angle) * side / np.linalg.norm(side)


def apart(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


@pytest.mark.parametrize("radius_deg", [1, 10, 35])
def test_the_coefficients_of_a_disc_are_those_of_its_radiance(radius_deg):
    direction, radius = random_directions(1, radius_deg)[0], np.radians(radius_deg)
    rim = np.linspace(0, radius, 4001)
    middle = (rim[1:] + rim[:-1]) / 2
    around = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    side = np.cross(direction, [0.6, 0.5, -0.62])
    side /= np.linalg.norm(side)
    ring = np.cos(around)[:, None] * side + np.sin(around)[:, None] * np.cross(direction, side)
    weights = np.sin(middle) * np.diff(rim) * 2 * np.pi
    rings = np.cos(middle)[:, None, None] * direction + np.sin(middle)[:, None, None] * ring
    projected = weights @ basis(rings.reshape(-1, 3)).reshape(len(middle), 64, 9).mean(axis=1)
    radiance = 1 / (np.pi * np.sin(radius) ** 2)
    assert lamp(direction, 1.0, radius)[:, 0] == pytest.approx(radiance * projected, abs=1e-5)


@pytest.mark.parametrize("seed", range(20))
def test_key_light_and_rest_are_the_estimate(seed):
    estimate = random_light(seed=seed)
    key = find_key_light(estimate, seen(*random_directions(seed % 4, seed)), LATTICE)
    rest = rest_of(ObjectLight(estimate, key))
    assert rest + sh_of_key_light(key) == pytest.approx(estimate, rel=1e-12, abs=1e-12)
    if key is not None:
        assert (key.irradiance >= 0).all() and (rest[0][estimate[0] > 0] >= -1e-12).all()


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("ambient", [0.0, 0.3])
def test_a_lamp_alone_is_found_whole(seed, ambient):
    direction, colour = random_directions(1, seed)[0], np.array([1.0, 0.8, 0.5])
    estimate = flat(ambient) + lamp(direction, 3.0, UNSEEN_RADIUS, colour)
    key = find_key_light(estimate)
    assert apart(key.direction, direction) < 2
    assert key.irradiance == pytest.approx(3 * colour, rel=0.03)
    assert rest_of(ObjectLight(estimate, key)) == pytest.approx(flat(ambient), abs=0.1)
    point = find_key_light(flat(ambient) + lamp(direction, 3.0, colour=colour))
    assert apart(point.direction, direction) < 0.1 and point.irradiance == pytest.approx(3 * colour, rel=0.05)


@pytest.mark.parametrize("seed", range(10))
def test_it_turns_with_the_room(seed):
    estimate = flat(0.5) + 0.1 * random_light(seed=seed) + lamp(random_directions(1, seed)[0], 2.0)
    turn = random_rotation(seed)
    turned = rotate(estimate, turn)
    before, after = find_key_light(estimate), find_key_light(turned)
    assert apart(turn @ before.direction, after.direction) < 0.5
    rests = [rest_of(ObjectLight(sh, key)) for sh, key in ((estimate, before), (turned, after))]
    assert rests[1] == pytest.approx(rotate(rests[0], turn), abs=0.02)


@pytest.mark.parametrize("seed", range(10))
def test_a_lamp_that_was_seen_is_where_it_was_seen(seed):
    """An estimate points beside it: by its noise, and by light from elsewhere."""
    direction = random_directions(1, seed)[0]
    estimate = flat(0.4) + lamp(direction, 2.0) + 0.15 * random_light(seed=seed)
    key = find_key_light(estimate, seen(direction), LATTICE)
    assert key.is_seen and apart(key.direction, direction) < 2
    assert np.degrees(key.angular_radius) == pytest.approx(8, abs=1.7)


def test_bright_patches_near_each_other_are_one_light():
    lamps = [np.array([np.sin(a), 0, np.cos(a)]) for a in np.radians([0, 20])]
    assert len(bright_patches(seen(*lamps, radius=np.radians(6)), LATTICE)) == 1
    far = [np.array([np.sin(a), 0, np.cos(a)]) for a in np.radians([0, 60])]
    assert len(bright_patches(seen(*far, radius=np.radians(6)), LATTICE)) == 2
    assert bright_patches(UnitSphereCloud.empty(1280), LATTICE) == []


@pytest.mark.parametrize(
    ("angle_deg", "is_seen"), [(60, True), (90, True), (180, True), (90, False), (130, False), (180, False)]
)
def test_of_two_lamps_the_stronger_and_none_of_two_equal_ones(angle_deg, is_seen):
    """Unseen lamps nearer than a right angle look like one to an estimate of order 2."""
    angle = np.radians(angle_deg)
    lamps = [np.array([0.0, 0, 1]), np.array([np.sin(angle), 0, np.cos(angle)])]
    cloud = seen(*lamps) if is_seen else None
    for strength in (0.95, 1.0, 1.06):
        assert find_key_light(flat(0.1) + lamp(lamps[0]) + lamp(lamps[1], strength), cloud, LATTICE) is None
    key = find_key_light(flat(0.1) + lamp(lamps[0]) + lamp(lamps[1], 1.5), cloud, LATTICE)
    assert apart(key.direction, lamps[1]) < 5


def test_it_stays_with_one_of_two_lamps_that_change_places():
    lamps = random_directions(2, 3)
    cloud, key, directions = seen(*lamps), None, []
    for share in np.linspace(0.4, 1.6, 13):
        key = find_key_light(flat() + lamp(lamps[0], 2 - share) + lamp(lamps[1], share), cloud, LATTICE, key)
        directions.append(key.direction)
    at_second = [apart(direction, lamps[1]) < 5 for direction in directions]
    assert at_second == sorted(at_second) and not at_second[6] and at_second[-1]


@pytest.mark.parametrize("seed", range(10))
def test_on_a_finer_sphere_a_small_lamp_is_found_within_a_degree(seed):
    direction, fine = random_directions(1, seed)[0], AnchorLattice(8192)
    estimate = flat(0.4) + lamp(direction, 2.0) + 0.15 * random_light(seed=seed)
    key = find_key_light(estimate, seen(direction, radius=np.radians(3), lattice=fine), fine)
    assert key.is_seen and apart(key.direction, direction) < 1


@pytest.mark.parametrize("seed", range(10))
def test_a_lit_patch_that_is_not_clipped_is_no_lamp_that_nobody_saw(seed):
    """An estimate points somewhere near the lamp; what was seen elsewhere is as bright as it was seen, and not more."""
    unseen, patch = apart_by(90, seed)
    estimate = flat(0.4) + lamp(unseen, 3.0, UNSEEN_RADIUS) + 0.1 * random_light(seed=seed)
    fine = AnchorLattice(8192)
    cloud = seen(patch, shows=0.6, lattice=fine)
    key = find_key_light(estimate, cloud, fine)
    assert not key.is_seen and apart(key.direction, unseen) < 20
    (found,) = bright_patches(cloud, fine)
    assert not found.may_be_brighter and found.irradiance == pytest.approx(0.6 * np.pi * np.sin(0.14) ** 2, rel=0.1)


@pytest.mark.parametrize("seed", range(10))
def test_of_two_clipped_lamps_that_explain_as_much_the_one_that_showed_more_light(seed):
    large, small = apart_by(50, seed)
    cloud = merge(seen(large, radius=0.2, share=1), only(seen(small, radius=0.06), small))
    middle = (large + small) / np.linalg.norm(large + small)
    key = find_key_light(flat(0.2) + lamp(middle, 2.0) + 0.05 * random_light(seed=seed), cloud, LATTICE)
    assert key.is_seen and apart(key.direction, large) < 5


def test_a_lit_floor_is_no_lamp_and_a_window_is_one_with_its_bright_pane():
    down, fine = np.array([0.0, 0, -1]), AnchorLattice(8192)
    assert bright_patches(seen(down, radius=np.radians(50)), LATTICE) == []
    assert len(bright_patches(seen(down, radius=np.radians(22)), LATTICE)) == 1
    middle, pane = np.array([0.0, 1, 0]), np.array([np.sin(0.25), np.cos(0.25), 0])
    window = merge(seen(middle, radius=0.4, shows=0.55, lattice=fine), only(seen(pane, lattice=fine), pane, fine))
    (found,) = bright_patches(window, fine)
    assert apart(found.direction, middle) < apart(found.direction, pane) < apart(middle, pane)


@pytest.mark.parametrize("seed", range(10))
def test_an_unseen_key_light_stays_while_it_explains_the_estimate_nearly_as_well(seed):
    direction = random_directions(1, seed)[0]
    before = find_key_light(flat(0.3) + lamp(direction, 2.0))
    noisy = flat(0.3) + lamp(direction, 2.0) + 0.15 * random_light(seed=seed)
    assert np.array_equal(find_key_light(noisy, previous=before).direction, before.direction)
    away = -direction
    assert apart(find_key_light(flat(0.3) + lamp(away, 2.0), previous=before).direction, away) < 1


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("strength", "is_taken"), [(1.0, False), (4.0, True)])
def test_a_lamp_that_was_seen_gives_way_to_an_unseen_one_that_is_stronger_by_far(seed, strength, is_taken):
    one, unseen = apart_by(120, seed)
    cloud, alone = seen(one), flat(0.3) + lamp(one, 1.0)
    before = find_key_light(alone, cloud, LATTICE)
    for previous in (None, before):
        key = find_key_light(alone + lamp(unseen, strength, UNSEEN_RADIUS), cloud, LATTICE, previous)
        assert apart(key.direction, unseen if is_taken else one) < 12 and key.is_seen != is_taken


@pytest.mark.parametrize("scale", [0.3, 0.9])
def test_of_a_cloud_with_another_exposure_only_ratios_count(scale):
    estimate = flat(0.4) + lamp(random_directions(1, 3)[0], 2.0) + 0.1 * random_light(seed=3)
    lamps = random_directions(2, 3)
    splits = [
        find_key_light(estimate, seen(*lamps, shows=k, wall=0.2 * k), LATTICE, is_exposed=False) for k in (1, scale)
    ]
    assert splits[0].direction == pytest.approx(splits[1].direction, abs=1e-5)
    assert splits[0].irradiance == pytest.approx(splits[1].irradiance, rel=1e-4)


@pytest.mark.parametrize("light", [flat(), 0 * flat(), -flat(), flat() + 0.01 * random_light()])
def test_there_is_none_in_flat_light_and_in_the_dark(light):
    assert find_key_light(light) is None


@pytest.mark.parametrize(("strength", "is_found"), [(0.047, [0, 0, 0]), (0.08, [0, 0, 1]), (0.12, [1, 1, 1])])
def test_one_that_is_there_stays_with_half_the_light_that_another_needs(strength, is_found):
    up = np.array([0.0, 0, 1])
    weak, before = flat() + lamp(up, strength), (None, *(find_key_light(flat() + lamp(one)) for one in (-up, up)))
    assert [find_key_light(weak, previous=one) is not None for one in before] == is_found


@pytest.mark.parametrize("seed", range(5))
def test_a_white_surface_has_the_irradiance_of_the_estimate_in_the_mean(seed):
    """A key light shines on one side alone, and sharply: single normals differ, the sum of all does not."""
    normals = LATTICE.directions
    estimate = flat(0.3) + lamp(random_directions(1, seed)[0], 2.0)
    key = find_key_light(estimate)
    radius, direction, rest = key.angular_radius, key.direction, rest_of(ObjectLight(estimate, key))
    disc = FINE.directions[FINE.directions @ direction > np.cos(radius)]
    of_disc = np.maximum(normals @ disc.T, 0).sum(axis=1) / (disc @ direction).sum()
    lit = irradiance(rest, normals) + of_disc[:, None] * key.irradiance
    whole = irradiance(rest + sh_of_key_light(key), normals)
    assert lit.mean() == pytest.approx(whole.mean(), rel=0.01)


def test_nothing_that_is_not_light_is_taken_for_some():
    with pytest.raises(ValueError):
        find_key_light(np.full((9, 3), np.nan))
    with pytest.raises(ValueError, match="order 2"):
        find_key_light(np.ones((4, 3)))
    with pytest.raises(ValueError, match="lattice"):
        find_key_light(flat(), UnitSphereCloud.empty(1280), AnchorLattice(64))


def test_one_light_for_several_positions_is_their_mean_and_has_the_key_light_they_share():
    up, beside, away = np.array([0, 0, 1.0]), np.array([0.2, 0, 0.98]), np.array([1.0, 0, 0])
    keys = [KeyLight(d / np.linalg.norm(d), np.full(3, e), 0.1, False) for d, e in ((up, 3), (beside, 1), (away, 0.5))]
    lights = [ObjectLight(flat(1.0) + sh_of_key_light(key), key) for key in (*keys, None)]
    mean = mean_light(lights)
    assert mean.sh == pytest.approx(np.mean([light.sh for light in lights], axis=0))
    assert mean.key.irradiance == pytest.approx(1.0) and apart(mean.key.direction, up) < 4
    assert rest_of(mean) + sh_of_key_light(mean.key) == pytest.approx(mean.sh)
    assert mean_light([ObjectLight(flat())]).key is None
    with pytest.raises(ValueError, match="at least one"):
        mean_light([])


@pytest.mark.parametrize("expected_error", [0.02, 0.1, 0.5])
def test_times_its_certainty_a_key_light_with_noise_is_nearest_to_itself(expected_error):
    key = KeyLight(random_directions(1, 3)[0], np.array([1.0, 0.9, 0.7]), 0.1, True)
    bands = sh_of_key_light(key)[1:]
    noisy = bands + np.random.default_rng(0).normal(0, expected_error, (4000, *bands.shape))
    certainty = certainty_of(key, expected_error)
    errors = {times: np.square(times * certainty * noisy - bands).mean() for times in (0.9, 1, 1.1)}
    assert min(errors, key=errors.get) == 1 and 0 < certainty < 1
    assert certainty_of(key, None) == certainty_of(key, 0.0) == 1
    for unit in (1e-300, 1e200):
        assert certainty_of(replace(key, irradiance=key.irradiance * unit), expected_error * unit) == pytest.approx(
            certainty
        )
    dark = KeyLight(key.direction, np.zeros(3), 0.1, True)
    assert certainty_of(dark, 0.1) == certainty_of(dark, 0.0) == certainty_of(key, 1e300) == 0
    of_both = mean_light([ObjectLight(np.eye(9, 3), key), ObjectLight(np.eye(9, 3), key)]).key
    assert of_both.certainty == 1
    for certainty, share in ((0.0, 0.0), (0.1, 0.25), (0.4, 1.0), (1.0, 1.0)):
        implied = replace(key, certainty=certainty, is_seen=False)
        assert sure_part(implied).irradiance == pytest.approx(share * key.irradiance)
        assert sure_part(replace(implied, is_seen=True)).irradiance == pytest.approx(key.irradiance)
    found = [find_key_light(sh_of_key_light(key), expected_error=error) for error in (None, expected_error)]
    assert [one.certainty for one in found] == [1, certainty_of(found[1], expected_error)]
