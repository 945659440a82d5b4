"""The lattice network in NumPy: what its form promises whatever the weights, and which files it refuses."""

import numpy as np
import pytest

from addon_tests.pure.cloud_batches import nasty_clouds, random_clouds
from addon_tests.pure.made import frame_of
from addon_tests.pure.weights_files import changed_file, random_arrays, with_arrays, with_header, without
from xihenet.colour import linear_to_srgb
from xihenet.estimators.ambient import constant_light
from xihenet.estimators.base import EstimateContext
from xihenet.estimators.calibration import Calibration, raw_error
from xihenet.estimators.lattice import FAINTEST, Lattice, of_one_shape
from xihenet.estimators.lattice_format import (
    LEVELS,
    LatticeArchitecture,
    LatticeWeights,
    load_weights,
    pooling_matrix,
    pooling_table,
    quadrature_matrix,
    slot_order,
)
from xihenet.estimators.lattice_network import LatticeNetwork
from xihenet.estimators.projection import Projection
from xihenet.estimators.ring_grid import ring_grid, turns_of_light
from xihenet.estimators.weights_format import save_weights
from xihenet.records import FAR_M, AnchorSurfaces, UnitSphereCloud
from xihenet.sh_basis import basis

SIZES = (512, 777, 1280, 2048)


def random_weights(seed, target="ldr", architecture=None):
    architecture = architecture or LatticeArchitecture()
    return LatticeWeights(architecture, target, random_arrays(architecture, seed), data="none", seed=seed)


@pytest.fixture(scope="module")
def weights_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "random.npz"
    save_weights(path, random_weights(1))
    return path


@pytest.mark.parametrize("n", SIZES)
def test_any_number_of_anchors_gives_finite_light_and_a_positive_expected_error(weights_file, n):
    estimator = Lattice(n, weights=weights_file)
    for clouds in (random_clouds(n), nasty_clouds(n)):
        light, expected_error = estimator.estimate_batch_with_error(*clouds)
        assert np.isfinite(light).all() and np.isfinite(expected_error).all() and (expected_error > 0).all()
        assert (light[:, 0] >= 0).all()


OTHER_SIZES = LatticeArchitecture(stem=5, fine=11, middle=7, coarse=13, narrow=3, hidden=40, code=9, opens_clipped=True)


@pytest.mark.parametrize(("n", "target", "sizes"), [(512, "ldr", None), (1280, "ldr", None), (300, "hdr", OTHER_SIZES)])
def test_a_batch_equals_single_estimates(tmp_path, n, target, sizes):
    save_weights(tmp_path / "w.npz", random_weights(1, target, sizes))
    estimator = Lattice(n, target, weights=tmp_path / "w.npz")
    clouds = [np.concatenate(parts) for parts in zip(random_clouds(n, 3, 12), nasty_clouds(n), strict=True)]
    facing = np.random.default_rng(0).uniform(-1, 1, clouds[2].shape).astype(np.float32)
    light, expected_error = estimator.estimate_batch_with_error(*clouds, facing=facing)
    for k, parts in enumerate(zip(*clouds, strict=True)):
        cloud = UnitSphereCloud(*parts, surfaces=AnchorSurfaces.of_facing(facing[k]))
        single, error = estimator.estimate_with_error(cloud)
        np.testing.assert_allclose(light[k], single, atol=1e-5)
        np.testing.assert_allclose(expected_error[k], error, rtol=1e-4)
        np.testing.assert_array_equal(estimator.estimate(cloud), single)


@pytest.mark.parametrize("n_clouds", [1, 2, 8])
def test_no_product_of_matrices_wakes_the_threads_of_blas(weights_file, monkeypatch, n_clouds):
    """OpenBLAS computes up to 2^18 multiplications in one thread, and up to 9216 where one side is a vector."""
    estimator, clouds, sizes, matmul = (
        Lattice(1280, weights=weights_file),
        random_clouds(1280, 0, n_clouds),
        [],
        np.matmul,
    )

    def observed(a, b, **kwargs):
        (rows, inner), columns = a.shape[-2:], b.shape[-1]
        sizes.append((rows * inner * columns, 9216 if min(rows, columns) == 1 else 2**18))
        return matmul(a, b, **kwargs)

    monkeypatch.setattr(np, "matmul", observed)
    estimator.estimate_batch(*clouds)
    assert len(sizes) > 20 and all(size <= most for size, most in sizes)


@pytest.mark.parametrize("n", SIZES)
def test_constant_light_stays_constant_whatever_the_weights(tmp_path, n):
    save_weights(tmp_path / "w.npz", random_weights(5))
    is_set = np.random.default_rng(n).random((1, n)) < 0.4
    radiance = np.array([0.2, 0.5, 0.8])
    light = Lattice(n, weights=tmp_path / "w.npz").estimate_batch(
        linear_to_srgb(radiance) * is_set[..., None], 2.0 * is_set, is_set
    )
    np.testing.assert_allclose(light[0], constant_light(radiance), atol=2e-6)


def test_weights_of_zero_give_the_projection(tmp_path):
    weights = random_weights(2)
    for name in ("radiance", "gate"):
        weights.arrays[f"{name}.weight"][:] = 0
        weights.arrays[f"{name}.bias"][:] = 0
    save_weights(tmp_path / "w.npz", weights)
    clouds = random_clouds(1280, 4)
    for facing in (None, np.random.default_rng(0).uniform(-1, 1, clouds[2].shape)):
        expected = Projection(1280).estimate_batch(*clouds, facing=facing)
        expected[:, 0] = expected[:, 0].clip(0)
        made = Lattice(1280, weights=tmp_path / "w.npz").estimate_batch(*clouds, facing=facing)
        np.testing.assert_allclose(made, expected, atol=1e-5)


def test_where_all_was_seen_light_is_added_to_clipped_lamps_alone_and_only_to_all_of_the_light(tmp_path):
    """Not to the sky in a window, which is as far away as what has no distance."""
    rng = np.random.default_rng(3)
    srgb = rng.uniform(0.1, 0.9, (3, 1280, 3)).astype(np.float32)
    distance_m, known = np.ones((3, 1280), np.float32), np.ones((3, 1280), bool)
    srgb[1:, :40], distance_m[2, :40] = 1, FAR_M
    for target, is_added in (("ldr", [False] * 3), ("hdr", [False, True, False])):
        weights = random_weights(5, target, LatticeArchitecture(opens_clipped=target == "hdr"))
        weights.arrays["radiance.weight"][:] *= 10
        save_weights(tmp_path / f"{target}.npz", weights)
        made = Lattice(1280, target, weights=tmp_path / f"{target}.npz").estimate_batch(srgb, distance_m, known)
        added = np.abs(made - Projection(1280, target).estimate_batch(srgb, distance_m, known)).max(axis=(1, 2))
        assert (added > 1e-3).tolist() == is_added and (added > 1e-5).tolist() == is_added


def test_light_that_is_added_has_the_colour_of_what_is_not_clipped(tmp_path):
    """Grey from the network, in a room of one colour with a lamp that the picture shows as white."""
    weights, colour = random_weights(5, "hdr", LatticeArchitecture(opens_clipped=True)), (0.6, 0.4, 0.2)
    for part in ("weight", "bias"):
        weights.arrays[f"radiance.{part}"][:] = weights.arrays[f"radiance.{part}"][0]
        weights.arrays[f"gate.{part}"][:] = 0
    save_weights(tmp_path / "grey.npz", weights)
    linear = np.random.default_rng(3).uniform(0.2, 1, (1, 1280, 1)) * colour
    linear[:, :90] = 1
    given = linear_to_srgb(linear).astype(np.float32), np.ones((1, 1280), np.float32), np.ones((1, 1280), bool)
    made = Lattice(1280, "hdr", weights=tmp_path / "grey.npz").estimate_batch(*given)
    added = (made - Projection(1280, "hdr").estimate_batch(*given))[0]
    assert np.abs(added).max() > 1e-3
    np.testing.assert_allclose(added / added[:, :1], np.tile(colour, (9, 1)) / colour[0], rtol=0.02)


def test_what_is_added_is_at_most_twice_the_error_that_is_expected(tmp_path):
    weights = random_weights(4, "hdr")
    weights.arrays["radiance.weight"][:] = 100 * np.abs(weights.arrays["radiance.weight"])
    weights.arrays["error.bias"][:] = -3  # much smaller than what was seen, so that all of it counts
    save_weights(tmp_path / "w.npz", weights)
    clouds = random_clouds(1280, 3)
    light, network_error = LatticeNetwork(load_weights(tmp_path / "w.npz"), 1280).run(*clouds)
    added = np.sqrt(np.mean((light - Projection(1280, "hdr").estimate_batch(*clouds)) ** 2, axis=(1, 2)))
    assert (added < 2.001 * network_error).all() and (added > 1.9 * network_error).any()
    given, expected_error = Lattice(1280, "hdr", weights=tmp_path / "w.npz").estimate_batch_with_error(*clouds)
    size = np.linalg.norm(given, axis=(1, 2)) / np.sqrt(27)  # of the light, with which the estimator averages it
    np.testing.assert_allclose(np.log(expected_error), (np.log(network_error) + 3 * np.log(size)) / 4, atol=1e-6)


@pytest.mark.parametrize("size", [1e-1, 1e20, 1e200])
def test_the_size_of_the_light_counts_in_its_error_however_large_it_is(size):
    light = np.random.default_rng(0).normal(size=(2, 9, 3))
    np.testing.assert_allclose(raw_error([size] * 2, size * light), size * raw_error([1.0] * 2, light))


@pytest.mark.parametrize("gains", [4.0, 0.25, [1.3, 1.0, 0.6], [0.5, 0.9, 2.0]])
def test_exposure_and_white_balance_act_on_the_light_as_on_the_pictures(weights_file, gains):
    srgb, distance_m, is_set = random_clouds(1280, 9)
    linear, estimator = 0.02 + 0.2 * srgb * is_set[..., None], Lattice(1280, weights=weights_file)
    known = is_set[..., None]
    plain = estimator.estimate_batch(linear_to_srgb(linear) * known, distance_m, is_set)
    changed = estimator.estimate_batch(linear_to_srgb(linear * gains) * known, distance_m, is_set)
    np.testing.assert_allclose(changed, plain * gains, atol=1e-4)


def test_a_room_turned_by_an_eighth_or_mirrored_gives_the_light_turned_so(weights_file):
    """By construction, from the middle cells on: a turn moves cells onto cells, but anchors onto none."""
    network, rng = LatticeNetwork(load_weights(weights_file), 1280), np.random.default_rng(0)
    middle, coarse = ring_grid(LEVELS[1]), ring_grid(LEVELS[2])
    n_middle = LatticeArchitecture().middle
    features = rng.random((n_middle + 4, 3, LEVELS[1])).astype(np.float32)
    of_cells = rng.random((LatticeArchitecture().coarse, 3, LEVELS[2])).astype(np.float32)
    relative, n_set = rng.normal(size=(3, 9, 3)).astype(np.float32), np.float32([100, 640, 1280])

    def light(features, of_cells, relative):
        spread = network._spread(network._code(of_cells, relative, n_set))
        return network._light_of(network._radiance(features, spread), 1 - features[-4])

    plain = light(features, of_cells, relative)
    for i, turn in enumerate(turns_of_light()):
        given = features[..., middle.turned[i]], of_cells[..., coarse.turned[i]], (turn @ relative).astype(np.float32)
        np.testing.assert_allclose(light(*given), turn @ plain, atol=2e-5)


def test_an_unset_anchors_place_says_nothing(weights_file):
    srgb, distance_m, is_set = random_clouds(512, 6)
    estimator = Lattice(512, weights=weights_file)
    filled = np.where(is_set[..., None], srgb, 0.9), np.where(is_set, distance_m, 3.0), is_set
    np.testing.assert_array_equal(estimator.estimate_batch(*filled), estimator.estimate_batch(srgb, distance_m, is_set))


@pytest.mark.parametrize(
    ("part", "value"), [(0, np.nan), (0, 1.5), (0, -0.1), (0, np.inf), (1, np.inf), (1, -1.0), (1, np.nan), (1, 1e39)]
)
def test_input_out_of_range_is_refused(weights_file, part, value):
    clouds = [array.astype(np.float64) for array in random_clouds(512)]
    clouds[part][2, 5] = value
    with pytest.raises(ValueError, match="lattice: expected"):
        Lattice(512, weights=weights_file).estimate_batch(*clouds)


@pytest.mark.parametrize(
    "law", [(np.nan, 1, 0), (-1, 1, 0), (1, np.nan, 0), (1, -0.1, 0), (1, 3.1, 0), (1, 1, -5.1), (1, 1, 5.1)]
)
def test_an_expected_error_that_no_calibration_gives_is_refused(law):
    Calibration(1.0, 3.0, -5.0, (0.0, 1.0))
    for figures in ((*law, (1.0,)), (1.0, 1.0, 0.0, (1.0, -1.0)), (1.0, 1.0, 0.0, (np.inf,))):
        with pytest.raises(ValueError, match="calibration: expected"):
            Calibration(*figures)


@pytest.mark.parametrize("facing", [np.zeros((6, 511)), np.eye(6, 512) * 1.5, np.full((6, 512), np.nan)])
def test_facing_out_of_range_is_refused(weights_file, facing):
    with pytest.raises(ValueError, match="lattice: expected facing"):
        Lattice(512, weights=weights_file).estimate_batch(*random_clouds(512), facing=facing)


def test_another_number_of_anchors_is_refused(weights_file):
    with pytest.raises(ValueError, match="n = 1280"):
        Lattice(1280, weights=weights_file).estimate_batch(*random_clouds(512))


def test_a_saved_file_comes_back_as_it_was(tmp_path):
    weights = random_weights(3, "hdr")
    save_weights(tmp_path / "w.npz", weights)
    back = load_weights(tmp_path / "w.npz")
    assert (back.architecture, back.target, back.data, back.seed) == (weights.architecture, "hdr", "none", 3)
    for name, array in weights.arrays.items():
        np.testing.assert_array_equal(back.arrays[name], array)


def test_a_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(ValueError, match=r"none\.npz: expected an \.npz of lattice weights"):
        load_weights(tmp_path / "none.npz")


CHANGES = {
    "another format": (with_header(format=99), "expected format 1, got 99"),
    "a target that is none": (with_header(target="sdr"), "expected 'ldr' or 'hdr'"),
    "an unknown size": (with_header(architecture={"depth": 3}), "depth"),
    "sizes that are no numbers": (with_header(architecture={"stem": "x"}), "expected sizes of 1"),
    "a header of brackets": (with_arrays(header=np.array("[" * 200_000)), "nested too deeply"),
    "a size of 400 digits": (with_header(architecture={"stem": 10**400}), "expected sizes of 1"),
    "no header": (without("header"), "expected a header"),
    "a missing array": (without("stem.bias"), "arrays: expected"),
    "one array too many": (with_arrays(more=np.zeros(1, np.float32)), "arrays: expected"),
    "a wrong shape": (with_arrays(gate__bias=np.zeros(8, np.float32)), r"shape \(6,\)"),
    "NaN": (lambda content: content["code.weight"].fill(np.nan), "code.weight: expected finite weights"),
    "whole numbers": (with_arrays(gate__bias=np.zeros(6, int)), "expected float16 or float32"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_file_is_refused_with_what_was_expected(weights_file, name):
    change, message = CHANGES[name]
    with pytest.raises(ValueError, match=rf"changed\.npz: .*{message}"):
        load_weights(changed_file(weights_file, change))


@pytest.mark.parametrize("n", [1, 20, 319, 512, 1280, 2048])
def test_pooling_leaves_no_cell_empty_and_counts_each_anchor_once(n):
    table = pooling_table(n)
    assert ((table.members < n).sum(axis=1) == table.counts).all() and (table.counts >= 1).all()
    owners = np.bincount(table.members[table.members < n], minlength=n)
    assert (owners >= 1).all() and (n < 1280 or (owners == 1).all())


def test_pooling_of_cells_is_a_mean_of_what_is_near_and_knows_no_turn_from_another():
    for n_fine, n_coarse in ((320, 80), (80, 24)):
        matrix, fine, coarse = pooling_matrix(n_fine, n_coarse), ring_grid(n_fine), ring_grid(n_coarse)
        assert matrix[matrix > 0].min() >= np.finfo(np.float32).tiny, "denormal numbers take thirty times as long"
        np.testing.assert_allclose(matrix.sum(axis=0), 1, rtol=1e-5)
        nearest = np.argmax(fine.directions @ coarse.directions.T, axis=0)
        np.testing.assert_array_equal(matrix[nearest, np.arange(n_coarse)], matrix.max(axis=0))
        for of_fine, of_coarse in zip(fine.turned, coarse.turned, strict=True):
            np.testing.assert_allclose(matrix[of_fine][:, of_coarse], matrix, atol=1e-7)


def test_the_quadrature_gives_back_every_light_of_order_two():
    light = np.random.default_rng(0).normal(size=(9, 3))
    radiance = basis(ring_grid(LEVELS[1]).directions) @ light
    np.testing.assert_allclose(quadrature_matrix() @ radiance, light, atol=1e-5)


@pytest.mark.parametrize("n", [1, 20, 319, 512, 1280])
def test_adding_blocks_pools_as_the_table_does(n):
    table, order, values = pooling_table(n), slot_order(n), np.random.default_rng(n).random((3, n + 1))
    values[:, n] = 0
    expected = values[:, table.members].sum(axis=2)
    np.testing.assert_allclose(order.sums(values[:, order.anchors]), expected[:, order.cells])
    assert order.is_first.sum() == n and sorted(order.cells) == list(range(len(table.counts)))


@pytest.mark.parametrize("name", ["shape", "is_set"])
def test_clouds_in_the_wrong_place_or_shape_are_refused(weights_file, name):
    srgb, distance_m, is_set = random_clouds(512)
    wrong = {
        "shape": [
            (srgb[:, :, :2], distance_m, is_set),
            (srgb, distance_m[:2], is_set),
            (srgb[0], distance_m[0], is_set[0]),
            (0.5, 1.0, True),
        ],
        "is_set": [(srgb, is_set, distance_m)],
    }
    for clouds in wrong[name]:
        with pytest.raises(ValueError, match="lattice: expected"):
            Lattice(512, weights=weights_file).estimate_batch(*clouds)


@pytest.mark.parametrize("n", SIZES)
def test_poor_input_degrades_gently_also_with_a_network_that_acts_strongly(tmp_path, n):
    weights = random_weights(7)
    for name in ("radiance", "gate"):
        weights.arrays[f"{name}.weight"][:] *= 5
    save_weights(tmp_path / "w.npz", weights)
    rng = np.random.default_rng(n)
    is_set = np.ones((5, n), bool)
    is_set[0], is_set[1], is_set[4] = rng.random(n) < 0.05, np.arange(n) == 3, rng.random(n) < 0.5
    srgb = rng.random((5, n, 3))
    srgb[2], srgb[3] = 0, 1
    light = Lattice(n, weights=tmp_path / "w.npz").estimate_batch(srgb * is_set[..., None], 2.0 * is_set, is_set)
    plain = Projection(n).estimate_batch(srgb * is_set[..., None], 2.0 * is_set, is_set)
    assert np.isfinite(light).all() and np.abs(light).max() < 40
    assert np.abs(light - plain)[4].max() > 0.01
    np.testing.assert_allclose(light[1:4], plain[1:4], atol=1e-5)


def test_next_to_nothing_seen_leans_on_the_phones_sensor_and_constant_light_stays(weights_file):
    estimator, rng = Lattice(1280, weights=weights_file), np.random.default_rng(0)
    sensed = np.array([0.3, 0.2, 0.1])
    context, far = EstimateContext(frame=frame_of(np.ones((1, 1)), ambient=sensed)), []
    for n_set in (1, 64, 600):
        is_set = np.zeros(1280, bool)
        is_set[rng.permutation(1280)[:n_set]] = True
        cloud = UnitSphereCloud(rng.random((1280, 3)) * is_set[:, None], 2.0 * is_set, is_set)
        alone, with_sensor = estimator.estimate(cloud), estimator.estimate(cloud, context)
        far.append(np.abs(with_sensor - alone).max() / np.abs(constant_light(sensed) - alone).max())
        constant = UnitSphereCloud(linear_to_srgb(sensed) * is_set[:, None], 2.0 * is_set, is_set)
        np.testing.assert_allclose(estimator.estimate(constant, context), constant_light(sensed), atol=1e-5)
    assert far[0] > 0.9 and far[1] < 0.01 and far[2] < 1e-12


# ----------------------------------------------------------------------------------------------- one shape of channels


def lights_and_coverage(seed, n=6):
    rng = np.random.default_rng(seed)
    lights = rng.normal(0, 0.4, (n, 9, 3)) * rng.uniform(0.01, 30, (n, 1, 3))
    lights[:, 0] = np.abs(lights[:, 0]) + rng.uniform(0.1, 5, (n, 3))
    return lights, rng.uniform(0, 1, n)


@pytest.mark.parametrize("seed", range(10))
def test_channels_are_of_one_shape_as_the_plain_sum_says(seed):
    lights, coverage = lights_and_coverage(seed)
    found = of_one_shape(lights, coverage)
    for light, seen, of_light in zip(lights, coverage, found, strict=True):
        for coefficient in range(9):
            shapes = [light[coefficient, c] / light[0, c] for c in range(3)]
            common = sum(shapes) / 3
            wanted = [light[0, c] * (seen * shapes[c] + (1 - seen) * common) for c in range(3)]
            assert of_light[coefficient] == pytest.approx(wanted, rel=1e-12, abs=1e-12)


def test_light_with_a_channel_without_light_stays_as_it_is():
    lights, coverage = lights_and_coverage(0)
    for nasty in (0.0, -1.0, FAINTEST / 2, 1e-310, np.inf):
        odd = lights / lights[:, :1]
        odd[:, 0, 2] = nasty
        np.testing.assert_array_equal(of_one_shape(odd, coverage), odd)
    np.testing.assert_array_equal(of_one_shape(np.zeros((2, 9, 3)), np.zeros(2)), 0)
