"""Error bounds: what does each stage's arithmetic cost? The table of docs/error_bounds.md; exit 1 if one does not hold.

Run it as `python addon_tests/bench/error_bounds.py`. Every figure is the largest error found on seeded input, against
the same formula in float64, all pairs, or an integral by brute force.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from xihenet.camera import unproject_frame
from xihenet.codec import decode_cloud, encode_cloud
from xihenet.colour import srgb_to_linear
from xihenet.estimators.lattice import Lattice
from xihenet.estimators.lattice_format import (
    GATE_OF,
    LEVELS,
    LatticeWeights,
    load_weights,
    pooling_matrix,
    pooling_table,
    quadrature_matrix,
)
from xihenet.estimators.lattice_network import (
    BRIGHT_GUESS_LDR,
    CLIPPED_FROM,
    CONTRAST_SCALE,
    FARTHEST_M,
    MOST_ADDED,
    NEAREST_M,
    SMALLEST_ERROR,
    SMALLEST_MEAN,
    SMALLEST_SHARE,
    _linear,
)
from xihenet.estimators.ring_grid import ring_grid, turns_of_light
from xihenet.estimators.weights_format import WEIGHTS_FOLDER
from xihenet.metrics import shc_rmse
from xihenet.mirror_ball import panorama_of_ball
from xihenet.panorama import panorama_directions, project_panorama, solid_angles
from xihenet.records import ArrayF64, Intrinsics, PointCloud, RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import basis, dering, irradiance, project_anchors
from xihenet.sphere import AnchorLattice

ROOMS = Path(__file__).parents[1] / "data" / "test_rooms"
LATTICE = AnchorLattice(1280)
NORMALS = np.random.default_rng(9).normal(size=(400, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)


class Row(NamedTuple):
    """One line of the table: what was measured against what, and the bound that the stage states."""

    stage: str
    cost: str
    reference: str
    measured: float
    bound: float
    unit: str = ""


# -------------------------------------------------------------------------------------------------- points and anchors


def unprojecting() -> Iterator[Row]:
    for name, place_m, bound_m in (
        ("in a room", 3.0, 2e-6), ("1 km away", 1e3, 6e-5), ("8 km away", 8e3, 5e-4),
        ("5,000 km away, kept in float64,", 5e6, 2e-6),
    ):  # fmt: skip
        error_m = max(unprojecting_error_m(place_m, seed) for seed in range(5))
        yield Row("unproject", f"float32, {name} on each axis", "float64", error_m, bound_m, "m")


def unprojecting_error_m(place_m: float, seed: int) -> float:
    rng = np.random.default_rng(seed)
    camera = Intrinsics(256, 192, 200.0, 200.0, 128.0, 96.0)
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pose[:3, 3] = place_m + rng.uniform(-0.01, 0.01, 3)
    frame = RgbdFrame(np.zeros((192, 256, 3), np.uint8), rng.uniform(0.2, 5, (192, 256)), camera, pose)
    row, column = np.mgrid[:192, :256] + 0.5
    rays = np.stack([(column - 128) / 200, -(row - 96) / 200, -np.ones_like(row)], axis=-1)
    seen = rays * frame.plane_depth_m.astype(float)[..., None]
    points = (seen @ pose[:3, :3].T + pose[:3, 3]).reshape(-1, 3)
    return float(np.linalg.norm(unproject_frame(frame).points_m - points, axis=1).max())


def room_points(n: int = 50_000, seed: int = 0) -> PointCloud:
    """Points on the walls of a room of 6 x 5 x 3 m, in colours that change slowly."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (n, 3))
    wall = rng.integers(0, 3, n)
    points[np.arange(n), wall] = np.sign(points[np.arange(n), wall])
    colours = 0.5 + 0.5 * np.sin(points @ rng.normal(0, 2, (3, 3)))
    return PointCloud(points * [3, 2.5, 1.5], colours)


def sampling() -> Iterator[Row]:
    points = np.random.default_rng(1).normal(size=(200_000, 3)).astype(np.float32)
    best = LATTICE.nearest(points.astype(float), "brute")
    for method, bound_share, bound_deg in (("exact", 1e-4, 0.01), ("table", 0.03, 0.6)):
        found = LATTICE.nearest(points, method)
        units = points / np.linalg.norm(points.astype(float), axis=1, keepdims=True)
        angles = [np.degrees(angle_between(units, LATTICE.directions[anchors])) for anchors in (found, best)]
        cost = "float32 look-up" if method == "exact" else "the paper's table of 1024 x 512"
        elsewhere, farther = float((found != best).mean()), (angles[0] - angles[1]).max()
        yield Row("sample", f"{cost}: points at another anchor", "all pairs", elsewhere, bound_share)
        yield Row("sample", f"{cost}: farther than the nearest", "all pairs", farther, bound_deg, "deg")
    yield Row("sample", "the table, on the light of a room (SHC RMSE)", "exact", table_on_light(), 0.01)
    yield Row("sample", "float32 distance, relative", "float64", sampling_error(), 4e-7)


def angle_between(a: ArrayF64, b: ArrayF64) -> ArrayF64:
    angles: ArrayF64 = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("pi,pi->p", a, b))
    return angles


def table_on_light() -> float:
    errors = []
    for seed in range(5):
        points, at = room_points(seed=seed), [0.4, 0.3, 0.2]
        clouds = [sample_unit_sphere(points, at, LATTICE, method=method) for method in ("exact", "table")]
        errors.append(shc_rmse(*(project_anchors(cloud, LATTICE) for cloud in clouds)))
    return max(errors)


def sampling_error() -> float:
    position = np.array([10_000.0003, 0.1, -0.2])
    far = (room_points().points_m[:500] + position).astype(np.float32)
    clouds = [PointCloud(point[None], np.zeros((1, 3))) for point in far]
    measured = [sample_unit_sphere(cloud, position, LATTICE).distance_m.max() for cloud in clouds]
    true = np.linalg.norm(far.astype(float) - position, axis=1)
    return float((np.abs(measured - true) / true).max())


# -------------------------------------------------------------------------------------------------------- the wire


def random_cloud(seed: int) -> UnitSphereCloud:
    rng = np.random.default_rng(seed)
    known = rng.random(1280) < 0.5
    return UnitSphereCloud(rng.random((1280, 3)) * known[:, None], 10 ** rng.uniform(-2, 3, 1280) * known, known)


def encoding() -> Iterator[Row]:
    colour, distance, light, network = np.zeros(20), np.zeros(20), np.zeros(20), np.zeros(20)
    for seed in range(20):
        cloud = random_cloud(seed)
        again = decode_cloud(encode_cloud(cloud), 1280)
        known = cloud.is_set
        colour[seed] = np.abs(again.srgb - cloud.srgb).max() * 255
        distance[seed] = (np.abs(again.distance_m - cloud.distance_m)[known] / cloud.distance_m[known]).max()
        light[seed] = shc_rmse(project_anchors(again, LATTICE), project_anchors(cloud, LATTICE))
        network[seed] = shc_rmse(Lattice().estimate(again), Lattice().estimate(cloud))
    yield Row("merge", "nothing: anchors are replaced whole", "float64", 0.0, 0.0)
    yield Row("encode", "8 bits of colour, in codes", "float32", colour.max(), 0.501)
    yield Row("encode", "half floats of distance, relative", "float32", distance.max(), 2.0**-11)
    yield Row("encode", "both, on the light of least squares (SHC RMSE)", "before the wire", light.max(), 5e-4)
    yield Row("encode", "both, on the light of lattice (SHC RMSE)", "before the wire", network.max(), 5e-3)


# ------------------------------------------------------------------------------------------------------- the estimate


def estimating() -> Iterator[Row]:
    codes = np.linspace(0, 1, 100_001)
    for cost, decode, bound in (("in float32", srgb_to_linear, 3e-7), ("as lattice does", _linear, 1e-6)):
        error = np.abs(decode(codes.astype(np.float32)) - srgb_to_linear(codes)).max()
        yield Row("estimate", f"sRGB decoded {cost}", "float64", error, bound)
    yield Row("estimate", "least squares by eigenvectors, all anchors set", "SVD", least_squares_error(), 1e-8)
    for name, share in (("half of the anchors", 0.5), ("a twentieth", 0.05)):
        cost, error = f"lattice's least squares in float32, {name} set", network_projection_error(share)
        yield Row("estimate", cost, "float64", error, 2e-5)
    cost = "the lattice network in float32, with all its short cuts"
    yield Row("estimate", cost, "float64, plainly", network_error(), 2e-5)


def least_squares_error() -> float:
    """The penalty of a fit of the whole sphere is 1e-9; nothing else parts it from plain least squares."""
    srgb = np.random.default_rng(3).random((1280, 3))
    cloud = UnitSphereCloud(srgb, np.ones(1280), np.ones(1280, bool))
    light = srgb_to_linear(cloud.srgb.astype(float))
    plain = np.linalg.lstsq(basis(LATTICE.directions), light, rcond=None)[0]
    return float(np.abs(project_anchors(cloud, LATTICE) - plain).max())


def network_projection_error(share: float) -> float:
    """The projection inside the network, float32 but for its small systems, against `project_anchors`."""
    worst, network = 0.0, Lattice()._network
    for seed in range(10):
        rng = np.random.default_rng(seed)
        known = np.einsum("ni,i->n", LATTICE.directions, rng.normal(size=3)) > 0
        known &= np.cumsum(known) <= share * 1280
        cloud = UnitSphereCloud(rng.random((1280, 3)) * known[:, None], known * 1.0, known)
        worst = max(worst, float(np.abs(projection_of(network, cloud) - project_anchors(cloud, LATTICE)).max()))
    return worst


def projection_of(network: Any, cloud: UnitSphereCloud) -> ArrayF64:
    order = network._to_fine.anchors
    known = cloud.is_set[order].astype(np.float32)[None]
    linear = _linear(cloud.srgb[order].T[:, None].copy())
    counted = known * network._to_fine.is_first
    mean = np.einsum("cbn,bn->cb", linear, counted) / counted.sum(axis=1)
    residual = (linear - mean[..., None]) * counted
    return np.asarray(network._project(residual, counted, mean)[0], float)


def network_error() -> float:
    weights = load_weights(WEIGHTS_FOLDER / "lattice_ldr.npz")
    clouds = [random_cloud(seed) for seed in range(10)]
    return max(float(np.abs(Lattice().estimate(cloud) - light_in_float64(weights, cloud)).max()) for cloud in clouds)


def light_in_float64(weights: LatticeWeights, cloud: UnitSphereCloud) -> ArrayF64:
    """The network as its layers are defined, in float64: (9, 3)."""

    def layer(name: str, inputs: ArrayF64) -> ArrayF64:
        outputs: ArrayF64 = inputs @ weights.arrays[f"{name}.weight"].T.astype(float) + weights.arrays[f"{name}.bias"]
        return outputs

    def rectified(name: str, *inputs: ArrayF64) -> ArrayF64:
        return np.maximum(layer(name, np.concatenate(inputs, axis=-1)), 0)

    def squeezed(light: ArrayF64) -> ArrayF64:
        return light / (np.abs(light) + 1)

    def placed(directions: ArrayF64) -> tuple[ArrayF64, ArrayF64]:
        return squeezed(basis(directions) @ relative), directions[:, 2:]

    linear, known = srgb_to_linear(cloud.srgb.astype(float)), cloud.is_set[:, None].astype(float)
    mean = linear.sum(axis=0) / known.sum()
    level = np.maximum(mean, SMALLEST_MEAN)
    variance = (((linear - mean) * known / level) ** 2).sum() / (3 * known.sum())
    contrast = variance / (variance + CONTRAST_SCALE**2)
    projection = project_anchors(cloud, LATTICE)
    relative = projection / level
    is_clipped = (cloud.srgb.max(axis=1, keepdims=True) >= CLIPPED_FROM).astype(float)
    log_distance = np.log(np.minimum(cloud.distance_m.astype(float), FARTHEST_M) + NEAREST_M)[:, None]
    looks = linear / (linear + level), is_clipped, log_distance, np.zeros_like(known)
    features = rectified("stem", *looks, *placed(LATTICE.directions))
    share, levels = known, []
    table = pooling_table(len(cloud))
    pooling = np.zeros((len(cloud) + 1, LEVELS[0]))
    pooling[table.members, np.arange(LEVELS[0])[:, None]] = 1
    matrices = pooling[:-1] / table.counts, pooling_matrix(*LEVELS[:2]), pooling_matrix(*LEVELS[1:])
    for name, n, matrix in zip(("fine", "middle", "coarse"), LEVELS, matrices, strict=True):
        total = matrix.T.astype(float) @ share
        pooled = matrix.T.astype(float) @ (features * share) / np.maximum(total, SMALLEST_SHARE)
        share = total
        features = rectified(name, pooled, share, *placed(ring_grid(n).directions))
        levels.append((features, share))
    (middle, middle_share), (coarse, _) = levels[1:]
    narrow, hidden = rectified("narrow", coarse), []
    for cells, turn in zip(ring_grid(LEVELS[2]).turned, turns_of_light(), strict=True):
        hidden.append(rectified("dense", narrow[cells].ravel(), squeezed(turn @ relative).ravel(), [known.mean()]))
    code = np.stack([rectified("code", one, np.mean(hidden, axis=0)) for one in hidden])
    spread = np.zeros((LEVELS[1], weights.architecture.spread))
    for one, cells in zip(code, ring_grid(LEVELS[1]).turned_back, strict=True):
        spread += layer("spread", one).reshape(spread.shape)[cells] / len(code)
    decoded = rectified("decoder", middle, spread, middle_share, *placed(ring_grid(LEVELS[1]).directions))
    radiance = layer("radiance", decoded) * (1 - middle_share)
    gate = np.tanh(layer("gate", code.mean(axis=0)))[GATE_OF] * (1 - known.mean())
    added = contrast * (gate[:, None] * projection + quadrature_matrix().astype(float) @ radiance * level)
    raw = float(layer("error", rectified("error_hidden", code.mean(axis=0)))[0])
    expected_error = np.logaddexp(raw, 0) * level.mean() + SMALLEST_ERROR
    added *= min(1, MOST_ADDED * expected_error / np.sqrt(np.mean(added**2)))
    unit = BRIGHT_GUESS_LDR * (1 - known.mean()) ** 2 * np.sqrt(np.mean(relative**2))
    excess = np.sqrt(np.mean((added / level) ** 2)) / unit
    light: ArrayF64 = projection + added * np.log1p(excess) / excess
    light[0] = np.maximum(light[0], 0)
    return light


# -------------------------------------------------------------------------------------------- what order 2 can hold


def panoramas() -> list[ArrayF64]:
    files = sorted(ROOMS.glob("room_*.npz"))
    return [panorama_of_ball(ball, 32).astype(float) for file in files for ball in np.load(file)["balls"]]


def brute_irradiance(panorama: ArrayF64) -> ArrayF64:
    height, width, _ = panorama.shape
    light = (panorama * solid_angles(height, width)[..., None]).reshape(-1, 3)
    cosines = np.maximum(NORMALS @ panorama_directions(height, width).reshape(-1, 3).T, 0)
    total: ArrayF64 = cosines @ light
    return total


def order_errors(panorama: ArrayF64, order: int, *, is_deringed: bool = False) -> tuple[float, float]:
    """Root mean square and largest error of the irradiance, relative to its mean."""
    coefficients = project_panorama(panorama, order)
    error = irradiance(dering(coefficients) if is_deringed else coefficients, NORMALS) - brute_irradiance(panorama)
    mean = brute_irradiance(panorama).mean()
    return float(np.sqrt((error**2).mean()) / mean), float(np.abs(error).max() / mean)


def ordering() -> Iterator[Row]:
    errors = np.array([order_errors(panorama, 2) for panorama in panoramas()])
    sun = np.zeros((64, 128, 3))
    sun[16, 40] = 2e5
    for cost, error, bound in (
        (f"order 2, {len(errors)} panoramas of rooms: irradiance, RMS, median", np.median(errors[:, 0]), 0.05),
        ("order 2, the same: RMS, worst", errors[:, 0].max(), 0.1),
        ("order 2, the same: largest error, worst", errors[:, 1].max(), 0.4),
        ("order 2, a sun alone: RMS", order_errors(sun, 2)[0], 0.2),
        ("order 2 without ringing, a sun alone: RMS", order_errors(sun, 2, is_deringed=True)[0], 0.4),
        ("order 10, a sun alone: RMS", order_errors(sun, 10)[0], 0.03),
    ):
        yield Row("apply", cost, "integral over the hemisphere", float(error), bound)
    lowest = irradiance(dering(project_panorama(sun)), NORMALS).min() / brute_irradiance(sun).mean()
    yield Row("apply", "what the window leaves below 0, of the mean", "0", max(0.0, -float(lowest)), 1e-3)


def main() -> bool:
    """Print the whole table, in the order of the chain; whether a bound does not hold."""
    print("| stage | what it costs | against | largest found | bound |")
    print("| --- | --- | --- | --- | --- |")
    is_broken = False
    for stage, cost, reference, measured, bound, unit in itertools.chain(
        unprojecting(), sampling(), encoding(), estimating(), ordering()
    ):
        numbers = " | ".join(f"{number:.2g} {unit}".strip() for number in (measured, bound))
        holds = "" if measured <= bound else " DOES NOT HOLD"
        print(f"| {stage} | {cost} | {reference} | {numbers} |{holds}", flush=True)
        is_broken |= bool(holds)
    return is_broken


if __name__ == "__main__":
    sys.exit(main())
