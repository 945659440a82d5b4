"""Hard cases of networks in batches and in files, and of sessions that cannot know the light."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from addon_tests.hard_case import at_most, case, equal, near, refused
from addon_tests.pure.hard_cases.hard_clouds import CLOUDS, NOTHING, WHITE_LIGHT, N, estimator
from xihenet.backend import LocalBackend
from xihenet.controller import XiheController
from xihenet.estimators import EstimateContext, load
from xihenet.estimators.lattice import Lattice
from xihenet.estimators.lattice_format import LatticeWeights, load_weights
from xihenet.estimators.weights_format import WEIGHTS_FOLDER, save_weights
from xihenet.records import Intrinsics, LightEstimate, RgbdFrame, UnitSphereCloud

# ------------------------------------------------------------------------------------------------ batches and weights

STAGE = "estimate"
BATCH = list(CLOUDS.values())


def stacked(clouds: list[UnitSphereCloud]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return tuple(np.stack([getattr(cloud, part) for cloud in clouds]) for part in ("srgb", "distance_m", "is_set"))


def batch_against_single(clouds: list[UnitSphereCloud]) -> float:
    """The largest difference between a batch and its clouds one by one."""
    together = estimator().estimate_batch(*stacked(clouds))
    return float(np.abs(together - [estimator().estimate(cloud) for cloud in clouds]).max())


def batch_normalised_together(clouds: list[UnitSphereCloud]) -> float:
    """Naive: colours relative to the mean of the whole batch."""
    means = np.array([cloud.srgb.mean() for cloud in clouds])
    return float(np.abs(means / means.mean() - means / means).max())


def shuffled(clouds: list[UnitSphereCloud]) -> float:
    """The largest difference that the order of a batch makes."""
    order = np.random.default_rng(1).permutation(len(clouds))
    there = estimator().estimate_batch(*stacked(clouds))[order]
    return float(np.abs(there - estimator().estimate_batch(*stacked([clouds[i] for i in order]))).max())


def running_mean(clouds: list[UnitSphereCloud]) -> float:
    """Naive: a state that is carried from cloud to cloud."""
    means = np.array([cloud.srgb.mean() for cloud in clouds])
    order = np.random.default_rng(1).permutation(len(clouds))
    carried, shuffled_too = (np.cumsum(m) / np.arange(1, len(m) + 1) for m in (means, means[order]))
    return float(np.abs(carried[order] - shuffled_too).max())


def shipped(target: str = "ldr") -> LatticeWeights:
    return load_weights(WEIGHTS_FOLDER / f"lattice_{target}.npz")


def light_after_saving(weights: LatticeWeights, is_half: bool) -> np.ndarray:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "weights.npz"
        save_weights(path, weights, is_half=is_half)
        return Lattice(N, weights.target, weights=path).estimate_batch(*stacked(BATCH))


def changed(weights: LatticeWeights, change: Callable[[np.ndarray], np.ndarray]) -> LatticeWeights:
    return replace(weights, arrays={name: change(array).astype(np.float32) for name, array in weights.arrays.items()})


def half_against_float(seed: int) -> float:
    """What half floats cost: weights a little off what a half float holds, saved as both."""
    rng = np.random.default_rng(seed)
    weights = changed(shipped(), lambda array: array * (1 + rng.uniform(-1, 1, array.shape) * 2.0**-11))
    return float(np.abs(light_after_saving(weights, True) - light_after_saving(weights, False)).max())


def in_8_bits(seed: int) -> float:
    """Naive: weights in 8 bits, one scale per array."""
    coarse = changed(shipped(), lambda array: np.rint(array / np.abs(array).max() * 127) / 127 * np.abs(array).max())
    return float(np.abs(light_after_saving(coarse, False) - light_after_saving(shipped(), False)).max())


def saved_and_loaded(target: str) -> float:
    weights = shipped(target)
    once = Lattice(N, weights.target).estimate_batch(*stacked(BATCH))
    return float(np.abs(light_after_saving(weights, True) - once).max())


def saved_as_text(target: str) -> float:
    """Naive: weights printed with three digits."""
    rounded = changed(shipped(target), lambda array: np.round(array, 3))
    return float(
        np.abs(light_after_saving(rounded, False) - Lattice(N, rounded.target).estimate_batch(*stacked(BATCH))).max()
    )


def half_of_weight(value: float) -> float:
    weights = shipped()
    arrays = dict(weights.arrays) | {"gate.bias": np.full(9, value, np.float32)}
    return float(np.abs(light_after_saving(replace(weights, arrays=arrays), True)).max())


def test_a_batch_of_extremes_is_its_clouds_one_by_one(comes_out):
    assert comes_out(BATCH, batch_against_single, at_most(1e-4), batch_normalised_together)


def test_the_order_of_a_batch_makes_no_difference(comes_out):
    assert comes_out(BATCH, shuffled, at_most(1e-4), running_mean)


def test_weights_in_half_floats_give_the_light_of_those_in_float32(comes_out):
    assert comes_out(3, half_against_float, at_most(0.02), in_8_bits)


SAVED = [case(f"saved and loaded weights give the same light ({target})", target) for target in ("ldr", "hdr")]


@pytest.mark.parametrize("given", SAVED)
def test_saved_weights_are_the_same_weights(given, comes_out):
    assert comes_out(given, saved_and_loaded, equal(0.0), saved_as_text)


def test_a_weight_beyond_half_floats_is_refused(comes_out):
    assert comes_out(1e6, half_of_weight, refused("gate.bias does not fit into float16"))


def test_a_weight_of_nan_is_refused(comes_out):
    assert comes_out(np.nan, half_of_weight, refused("gate.bias: expected finite weights"))


# ----------------------------------------------------------------------------------------- sessions, and what is known

CAMERA = Intrinsics(16, 12, 8.0, 8.0, 8.0, 6.0)
AHEAD = [0.0, 0.0, -1.0]


def frame(plane_depth_m: float, code: int = 180) -> RgbdFrame:
    return RgbdFrame(np.full((12, 16, 3), code, np.uint8), np.full((12, 16), plane_depth_m), CAMERA, np.eye(4))


def session(plane_depths: list[float]) -> tuple[bool, int, bool]:
    """After frames of these plane depths: whether a light is in force, skipped points, validity of what is asked."""
    controller = XiheController(LocalBackend(estimator("projection")))
    controller.add_position("ball", AHEAD)
    skipped = sum(controller.step(frame(value))["ball"].n_invalid_points for value in plane_depths)
    return controller.light("ball") is not None, skipped, controller.estimate_at(AHEAD).is_valid


def session_by_hand(plane_depths: list[float]) -> tuple[bool, int, bool]:
    """Naive: every frame makes a light, and nothing is counted."""
    return bool(plane_depths), 0, True


def made(changes: dict[str, Any]) -> LightEstimate:
    fields = {"sh_radiance": np.zeros((9, 3)), "exposure": 1.0, "coverage": 0.5, "estimator": "none"}
    return LightEstimate(**(fields | changes))


def sensed(ambient: list[float]) -> float:
    """What the sensor's light of a frame with nothing known is, clipped at white."""
    seen = replace(frame(np.nan), ambient=np.array(ambient))
    return float(estimator("ambient").estimate(NOTHING, EstimateContext(seen)).max())


SESSIONS = [
    case(
        "a session of frames without plane depth has no light and says so",
        [np.nan, 0.0, 1e10],
        equal((False, 576, False)),
        session_by_hand,
    ),
    case(
        "a session keeps its light through frames without plane depth",
        [2.0, np.nan, np.inf],
        equal((True, 384, False)),
        session_by_hand,
    ),
    case("a session that sees a wall has a valid light", [2.0], equal((True, 0, True)), None),
]


@pytest.mark.parametrize("given, must, naive", SESSIONS)
def test_a_session_says_whether_it_knows_the_light(given, must, naive, comes_out):
    assert comes_out(given, session, must, naive)


def test_a_sun_of_2e5_on_the_sensor_is_white_to_clipped_light(comes_out):
    assert comes_out([2e5] * 3, sensed, near(WHITE_LIGHT, 1e-12), lambda ambient: ambient[0] * WHITE_LIGHT)


WRONG_ESTIMATES = [
    case(f"an estimate with {name} is refused", changes, refused(words))
    for name, changes, words in (
        ("an exposure of 0", {"exposure": 0.0}, "LightEstimate.exposure"),
        ("an exposure of NaN", {"exposure": np.nan}, "LightEstimate.exposure"),
        ("a coverage above 1", {"coverage": 1.5}, "LightEstimate.coverage"),
        ("an expected error of infinity", {"expected_error": np.inf}, "LightEstimate.expected_error"),
        (
            "one NaN among its coefficients",
            {"sh_radiance": np.where(np.arange(27).reshape(9, 3) == 13, np.nan, 0)},
            "LightEstimate.sh_radiance",
        ),
    )
]


@pytest.mark.parametrize("given, must", WRONG_ESTIMATES)
def test_an_estimate_that_is_none_is_refused(given, must, comes_out):
    assert comes_out(given, made, must)


def test_an_estimator_without_anchors_is_refused(comes_out):
    assert comes_out(0, partial(load, "lattice"), refused("expected at least one anchor"))
