"""Hard cases of networks in batches and in files, and of sessions that cannot know the light."""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from addon_tests.hard_case import at_most, each, equal, refused, row
from addon_tests.pure.hard_cases.hard_clouds import CLOUDS, N, estimator
from xihenet.backend import LocalBackend
from xihenet.controller import XiheController
from xihenet.estimators.lattice import Lattice
from xihenet.estimators.lattice_format import LatticeWeights, load_weights
from xihenet.estimators.weights_format import WEIGHTS_FOLDER, save_weights
from xihenet.records import Intrinsics, LightEstimate, RgbdFrame, UnitSphereCloud

STAGE = "estimate"
BATCH = list(CLOUDS.values())


def half_seen(cloud: UnitSphereCloud) -> UnitSphereCloud:
    """Without the first half of its anchors, which is the upper one: there a network has something to add."""
    seen = cloud.is_set & (np.arange(len(cloud)) >= len(cloud) // 2)
    return UnitSphereCloud(cloud.srgb * seen[:, None], cloud.distance_m * seen, seen)


HALF_SEEN = [half_seen(cloud) for cloud in BATCH]


def stacked(clouds: list[UnitSphereCloud]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return tuple(np.stack([getattr(cloud, part) for cloud in clouds]) for part in ("srgb", "distance_m", "is_set"))


def shipped(target: str = "ldr") -> LatticeWeights:
    return load_weights(WEIGHTS_FOLDER / f"lattice_{target}.npz")


def light_after_saving(weights: LatticeWeights, is_half: bool) -> np.ndarray:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "weights.npz"
        save_weights(path, weights, is_half=is_half)
        return Lattice(N, weights.target, weights=path).estimate_batch(*stacked(HALF_SEEN))


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


def half_of_weight(value: float) -> float:
    weights = shipped()
    arrays = dict(weights.arrays) | {"gate.bias": np.full(6, value, np.float32)}
    return float(np.abs(light_after_saving(replace(weights, arrays=arrays), True)).max())


CAMERA = Intrinsics(16, 12, 8.0, 8.0, 8.0, 6.0)
AHEAD = [0.0, 0.0, -1.0]


ONE_PIXEL = Intrinsics(1, 1, 1.0, 1.0, 0.5, 0.5)


def frame(plane_depth_m: float, camera: Intrinsics = CAMERA) -> RgbdFrame:
    shape = (camera.height, camera.width)
    return RgbdFrame(np.full((*shape, 3), 180, np.uint8), np.full(shape, plane_depth_m), camera, np.eye(4))


def session(plane_depths: list[float], camera: Intrinsics = CAMERA) -> tuple[bool, int, bool]:
    """After frames of these plane depths: whether a light is in use, skipped points, validity of what is asked."""
    controller = XiheController(LocalBackend(estimator("projection")))
    controller.add_position("ball", AHEAD)
    skipped = sum(controller.step(frame(value, camera))["ball"].n_invalid_points for value in plane_depths)
    return controller.light("ball") is not None, skipped, controller.estimate_at(AHEAD).is_valid


def n_estimates(plane_depths: list[float]) -> int:
    controller = XiheController(LocalBackend(estimator("projection")))
    controller.add_position("ball", AHEAD)
    return sum(controller.step(frame(value))["ball"].decision.fire for value in plane_depths)


def session_by_hand(plane_depths: list[float]) -> tuple[bool, int, bool]:
    """Naive: every frame makes a light, and nothing is counted."""
    return bool(plane_depths), 0, True


def made(changes: dict[str, Any]) -> LightEstimate:
    fields = {"sh_radiance": np.zeros((9, 3)), "exposure": 1.0, "coverage": 0.5, "estimator": "none"}
    return LightEstimate(**(fields | changes))


NAN_WITHIN = np.where(np.arange(27).reshape(9, 3) == 13, np.nan, 0)
WRONG_ESTIMATES = {
    "an exposure of 0": {"exposure": 0.0},
    "an exposure of NaN": {"exposure": np.nan},
    "a coverage above 1": {"coverage": 1.5},
    "an expected error of infinity": {"expected_error": np.inf},
    "one NaN among its coefficients": {"sh_radiance": NAN_WITHIN},
}
SESSIONS = [
    ("of frames without plane depth has no light and says so", [np.nan, 0.0, 1e10], (False, 576, False)),
    ("keeps its light through frames without plane depth", [2.0, np.nan, np.inf], (True, 384, False)),
]
CASES = [
    row("weights in half floats give the light of those in float32", 3, half_against_float, at_most(0.005), in_8_bits),
    row("a weight beyond half floats is refused", 1e6, half_of_weight, refused("gate.bias does not fit into float16")),
    row("a weight of nan is refused", np.nan, half_of_weight, refused("gate.bias: expected finite weights")),
    *(
        row(f"a session {name}", plane_depths, session, equal(outcome), session_by_hand)
        for name, plane_depths, outcome in SESSIONS
    ),
    row("a session that sees a wall has a valid light", [2.0], session, equal((True, 0, True))),
    row(
        "so has one whose frames have one pixel",
        [2.0],
        lambda depths: session(depths, ONE_PIXEL),
        equal((True, 0, True)),
    ),
    row("a path that stands still is estimated once", [2.0] * 100, n_estimates, equal(1), len),
    *(
        row(f"an estimate with {name} is refused", wrong, made, refused(f"LightEstimate.{next(iter(wrong))}"))
        for name, wrong in WRONG_ESTIMATES.items()
    ),
]

test_hard_case = each(CASES)
