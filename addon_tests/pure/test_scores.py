"""The errors the training's report states: known answers, and one by one what `xihenet.metrics` says."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xihenet.light.light_picture import SPHERES, sphere_mask, three_spheres
from xihenet.metrics import angular_error, image_rmse, shc_rmse, si_rmse
from xihenet.sh import rotate
from xihenet.training.scores import (
    COVERAGE_EDGES,
    DOMINANT_SHARE,
    SPHERE_SIZE,
    UNDIRECTED_DEG,
    Scores,
    coverage_groups,
    dominant_light,
    pooled_rms,
    ratio,
    rmse_of_each,
    sphere_errors,
)


def lights(n, seed=0):
    """Bright enough to be lights, with directions and a few negative lobes."""
    rng = np.random.default_rng(seed)
    made = rng.normal(size=(n, 9, 3)) * np.repeat([0.1, 0.3, 0.15], [1, 3, 5])[:, None]
    made[:, 0] += 1.0
    return made


def nasty_pairs():
    """Black, negative, very dim, without direction, one colour only, equal, and scaled."""
    truth = lights(8, seed=3)
    made = lights(8, seed=4)
    made[0] = 0
    made[1] = -truth[1]
    made[2] *= 1e-200
    made[3, 1:] = 0
    made[4, :, 1:] = 0
    made[5] = truth[5]
    made[6] = 0.25 * truth[6]
    truth[7] = 0
    return made, truth


def test_a_perfect_prediction_is_wrong_by_nothing():
    truth = lights(20)
    scores = Scores.of(truth, truth, np.full(20, 0.5))
    assert scores.n_clouds == 20 and scores.rmse == 0 and scores.by_band == (0, 0, 0)
    assert scores.irradiance == 0 and scores.irradiance_percent == 0 and scores.dominant.median_deg == 0
    for sphere in scores.spheres.values():
        assert sphere.rmse == 0 and sphere.si_rmse < 1e-15 and sphere.angular_deg == 0 and sphere.black_share == 0


def test_a_light_wrong_by_a_constant_is_wrong_in_its_band_alone():
    truth = lights(30)
    made = truth.copy()
    made[:, 0] += 0.4
    scores = Scores.of(made, truth, np.linspace(0, 1, 30))
    np.testing.assert_allclose(scores.by_band, (0.4, 0, 0), atol=1e-12)
    np.testing.assert_allclose(scores.rmse, 0.4 / 3)
    np.testing.assert_allclose([error for error in scores.by_coverage if error is not None], 0.4 / 3)
    np.testing.assert_allclose(scores.spheres["grey diffuse"].rmse, 0.4 / np.sqrt(4 * np.pi), rtol=0.02)


def test_irradiance_is_relative_to_the_true_one():
    truth = lights(10)
    scores = Scores.of(1.1 * truth, truth, np.zeros(10))
    np.testing.assert_allclose([scores.irradiance, scores.irradiance_percent], [0.1, 10.0])


@pytest.mark.parametrize("degrees", [30.0, 120.0])
def test_a_turned_dominant_light_is_wrong_by_the_turn(degrees):
    truth = np.zeros((5, 9, 3))
    truth[:, 0], truth[:, 1], truth[:, 2] = 1.0, 0.3, 0.4  # towards +Y and up, across the axis it is turned about
    turn = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
    turned = np.array([rotate(light, turn) for light in truth])
    found = dominant_light(turned, truth)
    np.testing.assert_allclose(found.median_deg, degrees)
    assert found.n_left_out == 0


def test_light_from_everywhere_is_left_out_and_counted():
    truth = np.zeros((3, 9, 3))
    truth[:, 0] = 1.0
    truth[0, 3], truth[1, 3] = 1.01 * DOMINANT_SHARE, 0.99 * DOMINANT_SHARE
    made = truth.copy()
    made[1:, 1] = 5.0
    assert dominant_light(made, truth).median_deg == 0 and dominant_light(made, truth).n_left_out == 2
    assert dominant_light(made[1:], truth[1:]).median_deg is None


def test_a_prediction_without_direction_is_held_to_be_a_guess():
    truth = lights(9)
    truth[:, 3] += 1
    made = np.zeros_like(truth)
    made[:, 0] = 1
    assert dominant_light(made, truth).median_deg == UNDIRECTED_DEG


def test_the_vectorised_scores_are_those_of_the_metrics_one_by_one():
    for made, truth in ((lights(20, 1), lights(20, 2)), nasty_pairs()):
        expected = {name: [] for name in SPHERES}
        for light, true in zip(made, truth, strict=True):
            pictures = [np.maximum(three_spheres(one, SPHERE_SIZE), 0) for one in (light, true)]
            for name, predicted, right in zip(SPHERES, *pictures, strict=True):
                mask = sphere_mask(SPHERE_SIZE)
                angle = angular_error(predicted, right, mask)
                errors = image_rmse(predicted, right, mask), si_rmse(predicted, right, mask), angle.mean_deg
                expected[name].append((*errors, angle.n_black_prediction / angle.n_pixels))
        for name, sphere in sphere_errors(made, truth).items():
            columns = [[v for v in column if v is not None] for column in zip(*expected[name], strict=True)]
            got = (sphere.rmse, sphere.si_rmse, sphere.angular_deg, sphere.black_share)
            np.testing.assert_allclose(got, [np.mean(column) for column in columns], rtol=1e-9, atol=1e-12)
        one_by_one = [shc_rmse(light, true) for light, true in zip(made, truth, strict=True)]
        np.testing.assert_allclose(rmse_of_each(made, truth), one_by_one)
        np.testing.assert_allclose(Scores.of(made, truth, np.zeros(len(made))).rmse, shc_rmse(made, truth))


def test_many_clouds_give_what_their_parts_give():
    made, truth = lights(600, 5), lights(600, 6)
    whole = sphere_errors(made, truth)
    parts = [sphere_errors(made[i : i + 100], truth[i : i + 100]) for i in range(0, 600, 100)]
    for name in SPHERES:
        np.testing.assert_allclose(whole[name].rmse, np.mean([part[name].rmse for part in parts]))


def test_an_empty_group_gives_none():
    empty = Scores.of(np.zeros((0, 9, 3)), np.zeros((0, 9, 3)), np.zeros(0))
    assert empty.n_clouds == 0 and empty.rmse is None and empty.by_band == (None,) * 3
    assert empty.irradiance is None and empty.irradiance_percent is None and empty.dominant.median_deg is None
    assert all(sphere.rmse is None and sphere.angular_deg is None for sphere in empty.spheres.values())
    some = Scores.of(lights(4), lights(4, 1), np.full(4, 0.3))
    assert [error is None for error in some.by_coverage] == [True, False, True, True, True]
    assert pooled_rms([]) is None and ratio(None, 1.0) is None and ratio(1.0, None) is None and ratio(1.0, 0.0) is None


def test_a_black_truth_has_no_relative_error():
    scores = Scores.of(lights(2), np.zeros((2, 9, 3)), np.zeros(2))
    assert scores.irradiance is None and scores.irradiance_percent is None
    assert all(sphere.angular_deg is None for sphere in scores.spheres.values())


def test_each_cloud_is_in_one_group_of_coverage():
    coverage = np.array([0.0, 0.1, *COVERAGE_EDGES, 0.999])
    assert (np.sum(coverage_groups(coverage), axis=0) == 1).all()


def with_one(bad):
    made = lights(3)
    made[1, 4, 2] = bad
    return made


@pytest.mark.parametrize(
    ("made", "truth", "n_coverages", "words"),
    [
        (with_one(np.nan), lights(3), 3, "got 1 lights with NaN or infinity"),
        (with_one(np.inf), lights(3), 3, "got 1 lights with NaN or infinity"),
        (lights(3), with_one(np.nan), 3, "truth: expected finite"),
        (lights(3), lights(4), 3, "two equal shapes"),
        (lights(3), lights(3), 4, "coverage: expected shape"),
    ],
)
def test_lights_that_are_not_finite_or_of_another_shape_are_refused(made, truth, n_coverages, words):
    with pytest.raises(ValueError, match=words):
        Scores.of(made, truth, np.zeros(n_coverages))
