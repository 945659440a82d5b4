"""Hard cases of the estimators: light at both ends of its range, next to nothing seen, half-float weights, sessions."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from addon_tests.pure.hard_cases.hard_case import HardCase, at_most, equal, near, refused
from xihenet.backend import LocalBackend
from xihenet.colour import srgb_to_linear
from xihenet.controller import XiheController
from xihenet.estimators import EstimateContext, Estimator, load
from xihenet.estimators.lattice import Lattice
from xihenet.estimators.lattice_format import LatticeWeights, load_weights
from xihenet.estimators.weights_format import WEIGHTS_FOLDER, save_weights
from xihenet.records import Intrinsics, LightEstimate, RgbdFrame, UnitSphereCloud
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

STAGE = "estimate"
N = 1280
WHITE_LIGHT = float(np.sqrt(4 * np.pi))
"""The coefficient of white light from everywhere; clipped light has no larger one."""

HDR_BOUND = 4 * WHITE_LIGHT
"""Light that was clipped at white may have been brighter; four times white from everywhere is beyond any room."""


@cache
def estimator(name: str = "lattice", n: int = N, target: Any = "ldr") -> Estimator:
    return load(name, n, target)


def cloud_of(srgb: Any, distance_m: Any = 2.0, is_set: Any = True, n: int = N) -> UnitSphereCloud:
    known = np.broadcast_to(is_set, n)
    colours = np.broadcast_to(np.asarray(srgb, float), (n, 3)) * known[:, None]
    return UnitSphereCloud(colours, np.broadcast_to(distance_m, n) * known, known)


RNG = np.random.default_rng(0)
NOISE = RNG.random((N, 3))
ANCHORS = np.arange(N)
ONE, HALF, EVEN = ANCHORS == 400, ANCHORS < N // 2, ANCHORS % 2 == 0
DARK = {
    "all black": cloud_of(0.0),
    "denormal colours": cloud_of(NOISE * 1e-40),
    "colours of 1e-30": cloud_of(NOISE * 1e-30),
    "colours of a single code": cloud_of((NOISE > 0.5) / 255),
}
PATTERNS = {
    "one white anchor in black": cloud_of(ONE[:, None] * 1.0),
    "one black anchor in white": cloud_of(~ONE[:, None] * 1.0),
    "a white half beside a black one": cloud_of(HALF[:, None] * 1.0),
    "black and white by turns": cloud_of(EVEN[:, None] * 1.0),
    "one white anchor in a black half": cloud_of(ONE[:, None] * 1.0, 2.0, HALF),
    "saturated colours by turns": cloud_of(np.eye(3)[ANCHORS % 3]),
}
DISTANCES = {
    "noise at no distance": cloud_of(NOISE, 0.0),
    "noise at 1e-45 m": cloud_of(NOISE, 1e-45),
    "noise at 65,504 m": cloud_of(NOISE, 65504.0),
    "noise at 1e10 m": cloud_of(NOISE, 1e10),
    "noise at 3e38 m": cloud_of(NOISE, 3e38),
    "noise at 1e-30 m and 3e38 m": cloud_of(NOISE, np.where(HALF, 1e-30, 3e38)),
}
CLOUDS = DARK | PATTERNS | DISTANCES


def largest(cloud: UnitSphereCloud, target: str) -> float:
    """The largest coefficient; NaN and infinity are refused on the way."""
    sh_radiance, expected_error = estimator("lattice", len(cloud), target).estimate_with_error(cloud)
    assert expected_error is not None and np.isfinite(expected_error) and expected_error >= 0
    return float(np.abs(sh_radiance).max())


def relative_in_half(cloud: UnitSphereCloud) -> float:
    """Naive: light relative to its mean in half floats, as a network likes it, and never scaled back."""
    light = srgb_to_linear(cloud.srgb).astype(np.float16)
    return float((light / light.mean()).max())


def sun_where_clipped(cloud: UnitSphereCloud) -> float:
    """Naive: an anchor at white is taken for a sun of 2e5."""
    light = np.where(cloud.srgb >= 1, 2e5, srgb_to_linear(cloud.srgb))
    return float(np.abs(basis(AnchorLattice(len(cloud)).directions).T @ light * 4 * np.pi / len(cloud)).max())


def by_log_distance(cloud: UnitSphereCloud) -> float:
    """Naive: log distances enter as they come."""
    return float(np.abs(basis(AnchorLattice(N).directions).T @ np.log(cloud.distance_m)).max() * 4 * np.pi / N)


EXTREMES = [
    HardCase(
        STAGE, f"{name} gives plausible light ({target})", cloud, partial(largest, target=target), at_most(bound), naive
    )
    for group, naive, of_ldr, of_hdr in (
        (DARK, relative_in_half, 0.01, 0.01),
        (PATTERNS, sun_where_clipped, WHITE_LIGHT, HDR_BOUND),
        (DISTANCES, by_log_distance, WHITE_LIGHT, WHITE_LIGHT),
    )
    for name, cloud in group.items()
    for target, bound in (("ldr", of_ldr), ("hdr", of_hdr))
]

# ------------------------------------------------------------------------------------------------- what must come out


def light_of(name: str) -> Callable[[UnitSphereCloud], np.ndarray]:
    return lambda cloud: estimator(name, len(cloud)).estimate(cloud)


def mean_of_all(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: the mean over all anchors, unset ones black."""
    return np.concatenate([[cloud.srgb.mean(axis=0) * WHITE_LIGHT], np.zeros((8, 3))])


def mean_of_set(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: the mean over the set anchors, of which there may be none."""
    return np.concatenate([[cloud.srgb[cloud.is_set].sum(axis=0) / cloud.is_set.sum()], np.zeros((8, 3))])


def constant(radiance: float) -> np.ndarray:
    return np.concatenate([np.full((1, 3), radiance * WHITE_LIGHT), np.zeros((8, 3))])


def summed_over_set(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: what is set stands for the whole sphere."""
    seen = basis(AnchorLattice(len(cloud)).directions)[cloud.is_set]
    return seen.T @ cloud.srgb[cloud.is_set] * (4 * np.pi / cloud.is_set.sum())


NOTHING = UnitSphereCloud.empty(N)
WHITE_ABOVE, ONE_WHITE = cloud_of(1.0, 2.0, HALF), cloud_of(1.0, 2.0, ONE)
KNOWN = [
    *(
        HardCase(
            STAGE,
            f"white above and nothing known of below is white to {name}",
            WHITE_ABOVE,
            light_of(name),
            near(constant(1.0), 1e-5),
            summed_over_set,
        )
        for name in ("lattice", "projection", "ambient")
    ),
    *(
        HardCase(
            STAGE, f"nothing seen is black to {name}", NOTHING, light_of(name), equal(np.zeros((9, 3))), mean_of_set
        )
        for name in ("lattice", "projection", "ambient")
    ),
    *(
        HardCase(
            STAGE,
            f"white seen in one anchor is white from everywhere to {name}",
            ONE_WHITE,
            light_of(name),
            near(constant(1.0), 1e-5),
            mean_of_all,
        )
        for name in ("lattice", "projection", "ambient")
    ),
    *(
        HardCase(
            STAGE,
            f"a lattice of {n:,} anchors sees white as white",
            cloud_of(1.0, 2.0, np.arange(n) % 2 == 0, n),
            light_of("lattice"),
            near(constant(1.0), 1e-5),
            mean_of_all,
        )
        for n in (2, 3, 512, 65_535)
    ),
    HardCase(
        STAGE,
        "a lattice of one anchor sees white as white",
        cloud_of(1.0, n=1),
        light_of("lattice"),
        near(constant(1.0), 1e-5),
        lambda cloud: light_by_formula(cloud),
    ),
    HardCase(
        STAGE,
        "a cloud of another size is refused",
        UnitSphereCloud.empty(640),
        lambda cloud: estimator().estimate(cloud),
        refused("made for 1280 anchors, got a cloud of 640"),
        lambda cloud: cloud.srgb.sum(),
    ),
]


def light_by_formula(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: anchors by the lattice's formula, which divides by the number of anchors less one."""
    z = 1 - 2 * np.arange(len(cloud)) / np.float64(len(cloud) - 1)
    return constant(float(z.mean()))


# ------------------------------------------------------------------------------------------------ batches and weights

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


NETWORKS = [
    HardCase(
        STAGE,
        "a batch of extremes is its clouds one by one",
        BATCH,
        batch_against_single,
        at_most(1e-4),
        batch_normalised_together,
    ),
    HardCase(STAGE, "the order of a batch makes no difference", BATCH, shuffled, at_most(1e-4), running_mean),
    HardCase(
        STAGE,
        "weights in half floats give the light of those in float32",
        3,
        half_against_float,
        at_most(0.02),
        in_8_bits,
    ),
    *(
        HardCase(
            STAGE,
            f"saved and loaded weights give the same light ({target})",
            target,
            saved_and_loaded,
            equal(0.0),
            saved_as_text,
        )
        for target in ("ldr", "hdr")
    ),
    HardCase(
        STAGE,
        "a weight beyond half floats is refused",
        1e6,
        half_of_weight,
        refused("gate.bias does not fit into float16"),
        lambda value: float(np.float32(value).astype(np.float16)),
    ),
    HardCase(
        STAGE,
        "a weight of NaN is refused",
        np.nan,
        half_of_weight,
        refused("gate.bias: expected finite weights"),
        lambda value: float(np.float32(value).astype(np.float16)),
    ),
]

# ----------------------------------------------------------------------------------------- sessions, and what is known

CAMERA = Intrinsics(16, 12, 8.0, 8.0, 8.0, 6.0)
AHEAD = [0.0, 0.0, -1.0]


def frame(plane_depth_m: float, code: int = 180) -> RgbdFrame:
    return RgbdFrame(np.full((12, 16, 3), code, np.uint8), np.full((12, 16), plane_depth_m), CAMERA, np.eye(4))


def session(plane_depths: list[float]) -> tuple[bool, int, bool]:
    """After frames of these plane depths: whether a light is in force, skipped points, validity of what is asked."""
    controller = XiheController(LocalBackend(estimator("projection")))
    controller.add_position("ball", AHEAD)
    skipped = sum(controller.step(frame(value))["ball"].n_skipped_points for value in plane_depths)
    return controller.light("ball") is not None, skipped, controller.estimate_at(AHEAD).is_valid


def session_by_hand(plane_depths: list[float]) -> tuple[bool, int, bool]:
    """Naive: every frame makes a light, and nothing is counted."""
    return bool(plane_depths), 0, True


def made(changes: dict[str, Any]) -> LightEstimate:
    fields = {"sh_radiance": np.zeros((9, 3)), "exposure": 1.0, "coverage": 0.5, "estimator": "none"}
    return LightEstimate(**(fields | changes))


def scene_light(changes: dict[str, Any]) -> float:
    """Naive: divides by whatever exposure comes."""
    return 1.0 / float(changes.get("exposure", 1.0) or 1e-300)


def sensed(ambient: list[float]) -> float:
    """What the sensor's light of a frame with nothing known is, clipped at white."""
    seen = replace(frame(np.nan), ambient=np.array(ambient))
    return float(estimator("ambient").estimate(NOTHING, EstimateContext(seen)).max())


SESSIONS = [
    HardCase(
        STAGE,
        "a session of frames without plane depth has no light and says so",
        [np.nan, 0.0, 1e10],
        session,
        equal((False, 576, False)),
        session_by_hand,
    ),
    HardCase(
        STAGE,
        "a session keeps its light through frames without plane depth",
        [2.0, np.nan, np.inf],
        session,
        equal((True, 384, False)),
        session_by_hand,
    ),
    HardCase(
        STAGE,
        "a session that sees a wall has a valid light",
        [2.0],
        session,
        equal((True, 0, True)),
        lambda depths: session_by_hand(depths[1:]),
    ),
    HardCase(
        STAGE,
        "a sun of 2e5 on the sensor is white to clipped light",
        [2e5] * 3,
        sensed,
        near(WHITE_LIGHT, 1e-12),
        lambda ambient: ambient[0] * WHITE_LIGHT,
    ),
    *(
        HardCase(STAGE, f"an estimate with {name} is refused", changes, made, refused(words), scene_light)
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
    ),
    HardCase(
        STAGE,
        "an estimator without anchors is refused",
        0,
        partial(load, "lattice"),
        refused("expected at least one anchor"),
        lambda n: AnchorLattice(max(n, 1)).n,
    ),
]

CASES = [*EXTREMES, *KNOWN, *NETWORKS, *SESSIONS]
