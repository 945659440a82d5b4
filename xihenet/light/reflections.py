"""What glossy things reflect: a finer sphere of directions, filled from the same frames by the same sampling.

An estimate of order 2 shows a mirror broad stripes. The phone has seen much of what the mirror would show, though: each
frame is sampled into more anchors and merged as the estimate's are. What was never seen is the estimate itself, and the
difference between both at the border fades into it, so that there is no seam.

A phone's picture ends at white. Where the key light of the estimate was seen, its patch is made as bright as the key
light is: a rough metal shows a lamp by its light and not by its picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from xihenet.colour import srgb_to_linear
from xihenet.panorama import panorama_directions
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt, ObjectLight, UnitSphereCloud
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

N_DIRECTIONS = 8192

N_NEIGHBOURS = 7
FADES_OVER = float(np.radians(20))
"""Angle over which the difference at the border of what was seen falls to 1 / e."""

N_SMOOTHED = 6
"""Rounds of smoothing what was filled, so that no anchor at the border draws a streak."""

SHARPNESS = 1.5
"""Of the picture between anchors: their distance over the width of the bell that weights them."""


@dataclass(frozen=True, eq=False)
class Reflections:
    """What arrives from each direction of a lattice.

    Parameters
    ----------
    radiance : (N, 3) float32, not negative, linear Rec.709, carrying the estimate's exposure
    seen_share : of the directions that the phone has seen, 0 to 1
    """

    radiance: ArrayF32
    seen_share: float


def fill_reflections(cloud: UnitSphereCloud, lattice: AnchorLattice, light: ObjectLight) -> Reflections:
    """What was seen, and the estimate `light` elsewhere; both carry the same exposure.

    ValueError for a cloud that is not the lattice's.
    """
    if len(cloud) != len(lattice):
        raise ValueError(f"fill_reflections: expected a cloud of {len(lattice)} anchors, got {len(cloud)}")
    estimated = np.maximum(basis(lattice.directions) @ light.sh, 0.0)
    difference = np.zeros_like(estimated)
    seen = cloud.is_set
    difference[seen] = srgb_to_linear(cloud.srgb[seen].astype(np.float64)) - estimated[seen]
    around = lattice.neighbours(min(N_NEIGHBOURS, len(lattice)))
    radiance = estimated + _faded(difference, seen, around)
    radiance = _with_lamp(np.maximum(radiance, 0.0), seen, lattice, light)
    return Reflections(radiance.astype(np.float32), float(seen.mean()) if len(seen) else 0.0)


def _faded(difference: ArrayF64, seen: ArrayBool, around: ArrayInt) -> ArrayF64:
    """(N, 3) `difference` where it is known, fading away from there: ring by ring, then smoothed."""
    faded, known = difference.copy(), seen.copy()
    kept = float(np.exp(-np.sqrt(4 * np.pi / max(1, len(seen))) / FADES_OVER))
    left = np.flatnonzero(~seen)
    beside = around[left, 1:]
    while len(left) and known.any():
        is_known = known[beside]
        n_known = is_known.sum(axis=1)
        ring = n_known > 0
        if not ring.any():
            break
        total = (faded[beside[ring]] * is_known[ring, :, None]).sum(axis=1)
        faded[left[ring]] = kept * total / n_known[ring, None]
        known[left[ring]] = True
        left, beside = left[~ring], beside[~ring]
    filled = np.flatnonzero(~seen)
    for _ in range(N_SMOOTHED if seen.any() else 0):
        faded[filled] = faded[around[filled]].mean(axis=1)
    return faded


def _with_lamp(radiance: ArrayF64, seen: ArrayBool, lattice: AnchorLattice, light: ObjectLight) -> ArrayF64:
    """With the key light, where it was seen, as bright as it is: never darker than its picture."""
    key = light.key
    if key is None or not key.is_seen:
        return radiance
    cosine = lattice.directions @ key.direction
    spacing = np.sqrt(4 * np.pi / len(lattice))
    patch = seen & (cosine > np.cos(max(key.angular_radius, spacing)))
    shown = (radiance[patch] * cosine[patch, None]).sum(axis=0) * 4 * np.pi / len(lattice)
    gain = np.divide(key.irradiance, shown, out=np.ones(3), where=shown > 0)
    brighter = radiance.copy()
    brighter[patch] *= np.maximum(gain, 1.0)
    return brighter


def reflection_panorama(reflections: Reflections, lattice: AnchorLattice, height: int = 128) -> ArrayF32:
    """(H, 2H, 3) float32, laid out as `xihenet.panorama` does, smooth between anchors."""
    around, weights = _between_anchors(len(lattice), height)
    smooth = np.einsum("pk,pkc->pc", weights, reflections.radiance[around])
    panorama: ArrayF32 = smooth.reshape(height, 2 * height, 3).astype(np.float32)
    return panorama


@lru_cache(maxsize=4)
def _between_anchors(n: int, height: int) -> tuple[ArrayInt, ArrayF64]:
    """(P, k) the anchors around each texel, and their weights: a bell as wide as anchors are apart."""
    lattice, directions = AnchorLattice(n), panorama_directions(height, 2 * height).reshape(-1, 3)
    around = lattice.neighbours(min(N_NEIGHBOURS, n))[lattice.nearest(directions)]
    cosine = np.einsum("pkc,pc->pk", lattice.directions[around], directions)
    weights = np.exp((cosine - 1) * n * SHARPNESS**2 / (4 * np.pi))
    return around, weights / weights.sum(axis=1, keepdims=True)
