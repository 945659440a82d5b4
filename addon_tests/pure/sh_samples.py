"""Lights, lattices and directions that the tests of spherical harmonics share."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from xihenet.colour import linear_to_srgb
from xihenet.records import UnitSphereCloud
from xihenet.sh import basis
from xihenet.sphere import AnchorLattice

F64 = NDArray[np.float64]

AXES = {"+X": (1, 0, 0), "-X": (-1, 0, 0), "+Y": (0, 1, 0), "-Y": (0, -1, 0), "+Z": (0, 0, 1), "-Z": (0, 0, -1)}
CONSTANT = np.sqrt(4 * np.pi)


@dataclass(frozen=True, eq=False)
class Lattice:
    """The anchors of a lattice turned by `rotation`."""

    n: int
    rotation: F64 = field(default_factory=lambda: np.eye(3))

    @property
    def directions(self) -> F64:
        return AnchorLattice(self.n).directions @ self.rotation.T


LATTICE = Lattice(1280)


def random_directions(n: int, seed: int = 0) -> F64:
    vectors = np.random.default_rng(seed).normal(size=(n, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def random_light(order: int = 2, seed: int = 1) -> F64:
    return np.random.default_rng(seed).normal(size=((order + 1) ** 2, 3))


def light(order: int = 2, **coefficients: float) -> F64:
    """((order + 1)^2, 3) grey; coefficients by index: c0=1 is the constant one."""
    sh = np.zeros(((order + 1) ** 2, 3))
    for name, value in coefficients.items():
        sh[int(name[1:])] = value
    return sh


def sunny(value: float, height: int = 64, width: int = 128, sky: float = 0.2) -> F64:
    """One texel of sun in a constant sky."""
    radiance = np.full((height, width, 3), sky)
    radiance[height // 4, width // 3] = value
    return radiance


def windowed(light: F64, kept: float) -> F64:
    """Light whose band l = 1 keeps this share, and band l that to the power of l (l + 1) / 2."""
    order = round(np.sqrt(len(light))) - 1
    bands = np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)
    return light * kept ** (bands * (bands + 1) / 2)[:, None]


def distant_light(direction: tuple[float, float, float] | F64, order: int = 2) -> F64:
    """White light of irradiance 1 from one direction, cut off at `order`."""
    return np.repeat(basis(np.array([direction], float), order).T, 3, axis=1)


def cloud_of(radiance: F64, is_set: NDArray[np.bool_]) -> UnitSphereCloud:
    srgb = np.where(is_set[:, None], linear_to_srgb(radiance), 0)
    return UnitSphereCloud(srgb.astype(np.float32), is_set.astype(np.float32), is_set)


def cap(lattice: Lattice, coverage: float, towards: tuple[float, float, float] = (0.6, 0.7, 0.2)) -> NDArray[np.bool_]:
    """The anchors nearest to one direction, `coverage` of all and at least one."""
    cosine = lattice.directions @ np.array(towards)
    return np.asarray(cosine >= np.sort(cosine)[::-1][max(round(coverage * lattice.n), 1) - 1])
