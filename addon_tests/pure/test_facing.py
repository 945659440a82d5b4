"""What facing does to `projection`, and how it travels."""

from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.made import random_cloud, random_rotation, without_surfaces
from addon_tests.pure.sh_samples import Lattice
from xihenet import estimators
from xihenet.codec import METHODS, decode_cloud, encode_cloud
from xihenet.light_change import LightFollowing, follow_light
from xihenet.records import AnchorSurfaces, UnitSphereCloud
from xihenet.sh import facing_weights, project_anchors, rotate
from xihenet.sphere import AnchorLattice

LATTICE = AnchorLattice(1280)
OURS = "uint8_float16_facing_stripped"


def faced_cloud(seed, share=0.5, n=1280, facing=None):
    rng = np.random.default_rng(seed)
    facing = rng.uniform(-1, 1, n) if facing is None else np.full(n, facing)
    cloud = random_cloud(rng, n, share)
    return replace(cloud, surfaces=AnchorSurfaces.of_facing(facing * cloud.is_set))


def test_weights_rise_with_facing_and_are_never_0():
    weights = facing_weights(np.linspace(-1, 1, 201))
    assert (np.diff(weights) >= 0).all() and weights[0] == 0.2 and weights[-1] == 1


@pytest.mark.parametrize("name", ["projection", "lattice"])
def test_facing_that_is_nan_counts_as_unknown(name):
    known = random_cloud(np.random.default_rng(0), LATTICE.n)
    unknown, nan = (
        replace(known, surfaces=AnchorSurfaces.of_facing(np.full(LATTICE.n, facing))) for facing in (0, np.nan)
    )
    estimator = estimators.load(name)
    np.testing.assert_array_equal(estimator.estimate(nan), estimator.estimate(unknown))


@pytest.mark.parametrize("share", [0.001, 0.1, 0.5, 1.0])
def test_constant_light_stays_constant_whatever_faces_where(share):
    cloud = faced_cloud(0, share)
    cloud = UnitSphereCloud(
        cloud.is_set[:, None] * np.full(3, 0.5), cloud.distance_m, cloud.is_set, surfaces=cloud.surfaces
    )
    light = project_anchors(cloud, LATTICE)
    expected = project_anchors(without_surfaces(cloud), LATTICE)
    np.testing.assert_allclose(light, expected, atol=1e-12)
    np.testing.assert_allclose(light[1:], 0, atol=1e-12)


def test_surfaces_that_all_face_alike_and_fully_change_nothing():
    cloud = faced_cloud(1, facing=1.0)
    np.testing.assert_allclose(
        project_anchors(cloud, LATTICE), project_anchors(without_surfaces(cloud), LATTICE), atol=1e-12
    )


def test_nothing_but_surfaces_that_face_away_gives_a_finite_light_near_that_of_points():
    cloud = faced_cloud(2, facing=-1.0)
    light, plain = project_anchors(cloud, LATTICE), project_anchors(without_surfaces(cloud), LATTICE)
    assert np.isfinite(light).all()
    np.testing.assert_allclose(light[0], plain[0], rtol=0.05)


def test_what_faces_away_counts_less():
    """Half of what is seen is white and faces the position, half is black and faces away."""
    is_white = LATTICE.directions[:, 0] > 0
    facing = np.where(is_white, 1.0, -1.0)
    srgb, ones = np.repeat(is_white[:, None], 3, axis=1) * 1.0, np.ones(1280)
    # In the same directions, so that the fit has to choose between the two.
    order = np.random.default_rng(0).permutation(1280)
    plain = UnitSphereCloud(srgb[order], ones, ones > 0)
    cloud = UnitSphereCloud(srgb[order], ones, ones > 0, surfaces=AnchorSurfaces.of_facing(facing[order]))
    assert project_anchors(cloud, LATTICE)[0, 0] > 1.5 * project_anchors(plain, LATTICE)[0, 0]


def test_a_turned_room_gives_the_turned_light():
    rotation = random_rotation(3)
    cloud = faced_cloud(4)
    turned = project_anchors(cloud, Lattice(1280, rotation))
    np.testing.assert_allclose(turned, rotate(project_anchors(cloud, LATTICE), rotation), atol=1e-9)


def test_a_batch_takes_facing_by_name_and_equals_single_estimates():
    clouds = [faced_cloud(seed) for seed in range(3)]
    projection = estimators.load("projection")
    arrays = [np.stack([getattr(c, name) for c in clouds]) for name in ("srgb", "distance_m", "is_set")]
    facing = np.stack([c.surfaces.facing for c in clouds])
    np.testing.assert_array_equal(
        projection.estimate_batch(*arrays, facing=facing), [projection.estimate(c) for c in clouds]
    )
    np.testing.assert_array_equal(
        projection.estimate_batch(*arrays), [projection.estimate(without_surfaces(c)) for c in clouds]
    )
    for estimator in (projection, estimators.load("lattice")):
        assert estimator.estimate_batch(*(array[:0] for array in arrays)).shape == (0, 9, 3)


def test_facing_travels_in_one_more_byte_and_the_papers_records_stay_as_they_are():
    cloud = faced_cloud(5)
    assert METHODS[OURS].bytes_per_record == 8
    again = decode_cloud(encode_cloud(cloud, OURS), 1280, OURS)
    assert np.abs(again.surfaces.facing - cloud.surfaces.facing).max() <= 0.5 / 127 + 1e-6
    for method in set(METHODS) - {OURS, "uint16_float16_facing_stripped"}:
        assert encode_cloud(cloud, method) == encode_cloud(without_surfaces(cloud), method)
        assert decode_cloud(encode_cloud(cloud, method), 1280, method).surfaces is None


def test_where_nobody_looked_the_wire_says_so():
    cloud = without_surfaces(faced_cloud(6))
    assert decode_cloud(encode_cloud(cloud, OURS), 1280, OURS).surfaces is None


def test_a_facing_that_no_encoder_writes_is_refused():
    with pytest.raises(ValueError, match="record 0: expected a facing of -127 to 127, got -128"):
        decode_cloud(bytes([0, 0, 1, 2, 3, 0, 60, 128]), 4, OURS)


def test_following_the_light_keeps_surfaces():
    old = faced_cloud(7)
    dark = UnitSphereCloud(old.srgb * 0.3, old.distance_m, old.is_set)
    half = np.arange(1280) < 640
    new = UnitSphereCloud(dark.srgb * half[:, None], dark.distance_m * half, dark.is_set & half)
    followed = follow_light(old, new, LightFollowing())
    assert followed is not old and followed.surfaces is old.surfaces
