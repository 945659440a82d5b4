"""The PointConv estimators and their weights files, with random weights; those of torch are compared elsewhere."""

import numpy as np
import pytest

from addon_tests.pure.cloud_batches import ALIKE, NASTY, nasty_clouds, random_clouds
from addon_tests.pure.weights_files import changed_file, random_arrays, with_header
from xihenet.backend import LocalBackend, estimate_light
from xihenet.estimators.base import EstimateContext
from xihenet.estimators.lattice_format import load_weights
from xihenet.estimators.pointconv import PointAR, XiheNet
from xihenet.estimators.pointconv_network import (
    PointConvArchitecture,
    PointConvWeights,
    _farthest_points,
    _squared_distances,
)
from xihenet.estimators.weights_format import save_weights
from xihenet.records import PointCloud, UnitSphereCloud
from xihenet.sphere import AnchorLattice

N = 256
ESTIMATORS = {"xihenet": XiheNet, "pointar": PointAR}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Files of weights by estimator."""
    folder, small = tmp_path_factory.mktemp("weights"), PointConvArchitecture((32, 8), 8)
    paths = {name: folder / f"{name}.npz" for name in ESTIMATORS}
    for name, path in paths.items():
        save_weights(path, PointConvWeights(small, "ldr", random_arrays(small), estimator=name, n_points=N))
    return paths


def test_pointar_knows_no_light_without_a_point_in_the_frame_whatever_was_seen_before(files):
    estimator, cloud = PointAR(N, weights=files["pointar"]), UnitSphereCloud(*(part[5] for part in random_clouds(N)))
    seen = PointCloud([[1.0, 2.0, 3.0], [np.nan] * 3], [[0.5] * 3] * 2)
    blind = PointCloud([[np.nan] * 3, [1.0, 2.0, 3.0]], [[0.5] * 3, [np.inf] * 3])
    reasons = [
        estimator.unknown_because(cloud, EstimateContext(points=p, position_m=np.zeros(3))) for p in (seen, blind)
    ]
    assert reasons == ["", "no_points"]
    light = estimate_light(LocalBackend(estimator), cloud, EstimateContext(points=blind, position_m=np.zeros(3)), 1.0)
    assert not light.is_valid and light.unknown_because == "no_points" and not light.sh_radiance.any()


def test_nasty_clouds_give_finite_light_and_no_clouds_none(files):
    estimator = XiheNet(N, weights=files["xihenet"])
    light = estimator.estimate_batch(*nasty_clouds(N))
    assert light.shape == (len(NASTY + ALIKE), 9, 3) and np.isfinite(light).all()
    assert estimator.estimate_batch(*(part[:0] for part in nasty_clouds(N))).shape == (0, 9, 3)


def test_what_stands_at_unset_anchors_changes_nothing(files):
    srgb, distance_m, is_set = random_clouds(N, 6)
    estimator = XiheNet(N, weights=files["xihenet"])
    light = estimator.estimate_batch(srgb, distance_m, is_set)
    for colour, metres in ((0.9, 3.0), (np.nan, -7.0)):
        garbage = np.where(is_set[..., None], srgb, colour), np.where(is_set, distance_m, metres), is_set
        np.testing.assert_array_equal(estimator.estimate_batch(*garbage), light)


@pytest.mark.parametrize(("part", "value"), [(0, np.nan), (0, 1.5), (1, np.inf), (1, -1.0), (1, np.nan)])
def test_input_out_of_range_is_refused(files, part, value):
    clouds = [array.copy() for array in random_clouds(N)]
    clouds[2][2, 5] = True
    clouds[part][2, 5] = value
    with pytest.raises(ValueError, match="expected"):
        XiheNet(N, weights=files["xihenet"]).estimate_batch(*clouds)


def test_another_number_of_anchors_is_refused(files):
    with pytest.raises(ValueError, match="n = 512"):
        XiheNet(512, weights=files["xihenet"]).estimate_batch(*random_clouds(N))


def raw_points(n=2000, seed=0):
    rng = np.random.default_rng(seed)
    return PointCloud(rng.normal(size=(n, 3)) * 2, rng.random((n, 3)))


def light_of(estimator, points, position=(0.5, 0.0, 1.0)):
    context = EstimateContext(points=points, position_m=np.array(position))
    return estimator.estimate(UnitSphereCloud.empty(estimator.n_anchors), context)


def test_pointar_sees_points_from_the_position(files):
    estimator, points = PointAR(N, weights=files["pointar"]), raw_points()
    shift = np.array([4.0, -2.0, 8.0])
    moved = PointCloud(points.points_m + shift, points.srgb)
    light = light_of(estimator, points, (0, 0, 0))
    np.testing.assert_allclose(light_of(estimator, moved, shift), light, atol=1e-5)
    assert np.abs(light_of(estimator, moved, (0, 0, 0)) - light).max() > 1e-4


@pytest.mark.parametrize("n", [0, 1, 3])
def test_pointar_is_finite_with_hardly_any_points_and_leaves_out_broken_ones(files, n):
    estimator, points = PointAR(N, weights=files["pointar"]), raw_points(n)
    broken = PointCloud(
        np.concatenate([points.points_m, [[np.nan, 0, 0], [np.inf, 0, 0]]]),
        np.concatenate([points.srgb, np.ones((2, 3))]),
    )
    light = light_of(estimator, points)
    assert np.isfinite(light).all()
    np.testing.assert_array_equal(light_of(estimator, broken), light)


def test_pointar_says_what_it_needs(files):
    estimator = PointAR(N, weights=files["pointar"])
    cloud = UnitSphereCloud.empty(N)
    with pytest.raises(ValueError, match="pointar: needs the raw points"):
        estimator.estimate(cloud)
    with pytest.raises(ValueError, match="pointar: needs the raw points"):
        estimator.estimate(cloud, EstimateContext(points=raw_points()))
    with pytest.raises(ValueError, match="three finite numbers"):
        light_of(estimator, raw_points(), (np.nan, 0, 0))
    with pytest.raises(ValueError, match="pointar: needs the raw points"):
        estimator.estimate_batch(*random_clouds(N))


CHANGES = {
    "no number of points": (with_header(n_points=0), "n_points: expected"),
    "three blocks": (with_header(architecture={"centroids": [32, 8, 4]}), "expected two blocks"),
    "another size": (with_header(architecture={"centroids": [32, 8], "n_weights": 4}), "expected float32 of shape"),
    "no bandwidth": (with_header(architecture={"centroids": [32, 8], "bandwidth": 0.0}), "positive bandwidth"),
    "a switch that is a word": (
        with_header(architecture={"centroids": [32, 8], "keeps_unset_at_origin": "no"}),
        "true or false",
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_file_is_refused_with_what_was_expected(files, name):
    change, message = CHANGES[name]
    with pytest.raises(ValueError, match=rf"changed\.npz: .*{message}"):
        XiheNet(N, weights=changed_file(files["xihenet"], change))


@pytest.mark.parametrize("name", ESTIMATORS)
def test_weights_of_another_target_estimator_or_kind_are_refused(files, name):
    path, other = files[name], files["pointar" if name == "xihenet" else "xihenet"]
    with pytest.raises(ValueError, match=rf"{name}\.npz: expected weights for the target 'hdr', got 'ldr'"):
        ESTIMATORS[name](N, "hdr", weights=path)
    with pytest.raises(ValueError, match=rf"{other.name}: .*expected weights of '{name}'"):
        ESTIMATORS[name](N, weights=other)
    with pytest.raises(ValueError, match=rf"{name}\.npz: .*expected weights of 'lattice', got '{name}'"):
        load_weights(path)


def test_points_that_stand_where_another_stands_are_no_centroids_of_their_own():
    places = np.array([[1, 0, 0], [1, 0, 0], [0, 2, 0], [0, 2, 0], [0, 0, 0]], np.float32)
    assert _farthest_points(places, _squared_distances(places), 5).tolist() == [2, 0, 4]


def test_the_order_of_the_points_changes_nothing(files):
    srgb, distance_m, is_set = (part[4] for part in random_clouds(N))
    estimator = XiheNet(N, weights=files["xihenet"])
    light = estimator.estimate(UnitSphereCloud(srgb, distance_m, is_set))
    points = AnchorLattice(N).directions.astype(np.float32) * distance_m[:, None]
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(N)
        np.testing.assert_allclose(estimator._light(points[order], srgb[order], is_set[order]), light, atol=1e-5)
