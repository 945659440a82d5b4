"""Light in spherical harmonics: fit it, turn it, shine it on surfaces, keep it from ringing.

Conventions: real, orthonormal, no Condon-Shortley sign, index l*l + l + m, arrays ((order + 1)^2, 3), axes of the
Blender world, radiance coefficients: the integral of radiance x Y over the sphere. The basis is in `sh_basis` and
panoramas are in `panorama`; both are offered here as well, so that callers need this module alone. Every function
takes any order and any unit of linear radiance: twice the light gives twice the result.

Not here: what other platforms expect of the same numbers.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from xihenet.colour import srgb_to_linear
from xihenet.panorama import project_panorama as project_panorama
from xihenet.records import ArrayF64, UnitSphereCloud
from xihenet.sh_basis import band_slice, checked_sh, n_coefficients, per_coefficient
from xihenet.sh_basis import basis as basis
from xihenet.sphere import AnchorLattice

# Indoor light, LDR, order 2: the coefficients of l = 1 have a standard deviation of 0.10 to 0.21, those of l = 2 of
# 0.05 to 0.09. A variance of 0.021 / l^2 lies within both and goes on to higher bands.
L1_VARIANCE = 0.021
# Variance of the light that an order-2 fit leaves over, times the solid angle over which it stays alike (radiance^2 x
# sr). Lowest coefficient error between 20 % and 80 % coverage, for views of eight real panoramas clipped to [0, 1];
# a third or three times as much costs up to 20 % there.
RESIDUAL_NOISE = 0.001
# Bends a fit of full coverage by a billionth, and makes lattices of fewer anchors than coefficients solvable.
SMALLEST_PENALTY = 1e-9

# A surface that faces away shows a side that the position would not see, and one that is seen flat little of itself. Of
# 18 weights over seven rooms not trained on this lost nowhere more than 6 %, for 5 % (one view) to 7 % (merged) less
# error in the mean; weights of 0 lose more, since what faces away is often all that is known of a direction.
FACING_OFFSET, LEAST_WEIGHT = 0.3, 0.2

ROTATION_TOLERANCE = 1e-5  # float32 matrices, as Blender has them, stay within 1e-6.

N_CHECKED_NORMALS = 4096
NEGATIVE_TOLERANCE = 1e-12  # Share of the largest irradiance that counts as rounding.
N_BISECTIONS = 30


@lru_cache(maxsize=8)
def anchor_basis(lattice: AnchorLattice, order: int) -> ArrayF64:
    """(N, (order + 1)^2) `basis` in the lattice's directions, read-only, made once for a lattice."""
    table = np.ascontiguousarray(basis(lattice.directions, order))
    table.flags.writeable = False
    return table


def facing_weights(facing: ArrayLike) -> ArrayF64:
    """(...) how much anchors count that face the position by these cosines: 0.2 to 1, and 0.3 for unknown, 0 or NaN."""
    return np.clip(np.nan_to_num(np.asarray(facing, np.float64)) + FACING_OFFSET, LEAST_WEIGHT, 1.0)


def project_anchors(cloud: UnitSphereCloud, lattice: AnchorLattice, order: int = 2) -> ArrayF64:
    """Coefficients of the light that the set anchors saw, by regularised least squares.

    Minimises the mean squared error over the set anchors plus penalty_l x coefficient^2 for l >= 1. The constant band
    is free, so constant light comes out constant from any single anchor. The penalty is the maximum a posteriori one:
    variance of what order `order` cannot fit over the variance expected of band l (`RESIDUAL_NOISE`, `L1_VARIANCE` /
    l^2), times the share of the sphere that is not seen, because that residual is orthogonal to the basis on the whole
    sphere and leaks into the fit only through the hole. So at full coverage the fit is plain least squares; plain
    least squares at 5 % coverage is wrong by tens of times the light. Where the cloud has surfaces, an anchor counts by
    `facing_weights`, and as much less of the sphere as seen. Nothing here knows up from down: a rotated
    room gives rotated coefficients. Colours are decoded to linear; distances do not matter.

    ((order + 1)^2, 3) float64, linear, carrying the cloud's exposure; zeros if no anchor is set. ValueError if the
    cloud and the lattice differ in size. float64 throughout: with all anchors set within 1e-8 of a fit by SVD.
    """
    table = anchor_basis(lattice, order)
    if len(cloud) != len(table):
        raise ValueError(f"project_anchors: expected a cloud of the lattice's {len(table)} anchors, got {len(cloud)}")
    n_set = int(np.count_nonzero(cloud.is_set))
    if n_set == 0:
        return np.zeros((n_coefficients(order), 3))
    seen = table[cloud.is_set]
    n_seen: float = n_set
    weighted = seen
    weights = None
    if cloud.surfaces is not None:
        weights = facing_weights(cloud.surfaces.facing[cloud.is_set])
        n_seen, weighted = float(weights.sum()), seen * weights[:, None]
    radiance = srgb_to_linear(cloud.srgb[cloud.is_set].astype(np.float64))
    # The mean goes straight into the free constant band: constant light is then exact however ill-conditioned the fit.
    mean = radiance.mean(axis=0) if weights is None else weights @ radiance / n_seen
    penalty = (1 - n_seen / len(cloud)) * RESIDUAL_NOISE / L1_VARIANCE + SMALLEST_PENALTY
    per_anchor = 4 * np.pi / len(cloud)
    # einsum and not a matrix product: threaded BLAS wakes all cores for this little and stalls beside a busy renderer.
    gram = np.einsum("ni,nj->ij", weighted, seen) * per_anchor
    normal_matrix = gram + np.diag(penalty * per_coefficient(np.arange(order + 1.0)) ** 2)
    right_side = np.einsum("ni,nc->ic", weighted, radiance - mean) * per_anchor
    # By eigenvectors, since solve() is threaded too, whatever the size: 0.01 ms here against 8 ms on a busy machine.
    values, vectors = np.linalg.eigh(normal_matrix)
    coefficients: ArrayF64 = vectors @ ((vectors.T @ right_side) / values[:, None])
    coefficients[0] += mean * np.sqrt(4 * np.pi)
    return coefficients


@lru_cache(maxsize=32)
def cosine_lobe(order: int) -> ArrayF64:
    """What a cosine-weighted hemisphere makes of each band: (order + 1,) read-only, pi, 2 pi / 3, pi / 4, 0, -pi / 24.

    Ramamoorthi and Hanrahan 2001: odd bands above 1 vanish; even ones are 2 pi (-1)^(l/2 - 1) / ((l + 2)(l - 1)) times
    the central binomial coefficient of l over 2^l, here as a running product so that high bands stay in range.
    """
    if order < 0:
        raise ValueError(f"cosine lobe: expected an order of at least 0, got {order}")
    factors = np.zeros(order + 1)
    central = 1.0
    for band in range(0, order + 1, 2):
        central *= (band - 1) / band if band else 1.0
        factors[band] = 2 * np.pi * (-1) ** (band // 2 + 1) * central / ((band + 2) * (band - 1))
    factors[1:2] = 2 * np.pi / 3
    factors.flags.writeable = False
    return factors


def irradiance(sh_radiance: ArrayLike, normals: ArrayLike) -> ArrayF64:
    """Irradiance on surfaces; a white Lambert surface shows it divided by pi.

    `normals` (P, 3) are in world axes, of any finite length above 0; P may be 0. (P, 3) float64, pi times the radiance
    under constant light; may be negative where the finite series rings. ValueError for coefficients or normals that are
    not finite, and for normals of length 0.

    What order 2 cannot hold, root mean square over the normals: at most 7 % of the mean irradiance in the shipped test
    rooms, 14 % for a sun alone (docs/error_bounds.md).
    """
    coefficients, order = checked_sh(sh_radiance)
    return basis(normals, order) @ (per_coefficient(cosine_lobe(order))[:, None] * coefficients)


def _checked_rotation(rotation: ArrayLike) -> ArrayF64:
    matrix = np.asarray(rotation, dtype=np.float64)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise ValueError(f"rotate: expected a finite (3, 3) matrix, got shape {matrix.shape}: {matrix.tolist()}")
    largest = np.abs(matrix).max()
    # Rows of a rotation hold nothing above 1; the squares of what does may overflow.
    error = np.abs(matrix @ matrix.T - np.eye(3)).max() if largest < 2 else largest
    if error > ROTATION_TOLERANCE:
        raise ValueError(f"rotate: expected orthonormal rows within {ROTATION_TOLERANCE}, got an error of {error:.3g}")
    if np.linalg.det(matrix) < 0:
        raise ValueError("rotate: expected a rotation (determinant +1), got a mirroring (determinant -1)")
    return matrix


@lru_cache(maxsize=32)
def _quadrature(order: int) -> tuple[ArrayF64, ArrayF64]:
    """Directions (Q, 3) and weighted basis ((order + 1)^2, Q) that integrate products of two basis functions exactly.

    Gauss-Legendre in z, evenly spaced in azimuth: exact to degree 2 order + 1.
    """
    heights, height_weights = np.polynomial.legendre.leggauss(order + 1)  # type: ignore[no-untyped-call]
    n_azimuths = 2 * order + 2
    azimuths = 2 * np.pi * np.arange(n_azimuths) / n_azimuths
    z, azimuth = (grid.ravel() for grid in np.meshgrid(heights, azimuths, indexing="ij"))
    radius = np.sqrt(1 - z * z)
    directions = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
    weights = np.repeat(height_weights, n_azimuths) * (2 * np.pi / n_azimuths)
    return directions, basis(directions, order).T * weights


def rotate(sh_radiance: ArrayLike, rotation: ArrayLike) -> ArrayF64:
    """The same light after turning the room by a (3, 3): rotated(R d) = original(d).

    Each band's rotation matrix is the integral of basis(d) x basis(R^-1 d), by a quadrature that is exact for it: no
    Euler angles, no recurrence over bands, no fit.

    ((order + 1)^2, 3) float64. ValueError for coefficients not finite, and for a matrix that is no rotation:
    orthonormal within `ROTATION_TOLERANCE`, determinant +1; what it lacks passes into the result.
    """
    coefficients, order = checked_sh(sh_radiance)
    directions, weighted_basis = _quadrature(order)
    turned_back = basis(directions @ _checked_rotation(rotation), order)
    rotated = np.empty_like(coefficients)
    for band in range(order + 1):
        of_band = band_slice(band)
        rotated[of_band] = weighted_basis[of_band] @ (turned_back[:, of_band] @ coefficients[of_band])
    return rotated


@lru_cache(maxsize=8)
def _radiance_table(order: int) -> ArrayF64:
    """Basis at `N_CHECKED_NORMALS` directions, spread evenly by a Fibonacci spiral."""
    step = np.arange(N_CHECKED_NORMALS)
    z = 1 - (2 * step + 1) / N_CHECKED_NORMALS
    azimuth = step * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z * z)
    return basis(np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1), order)


def dering_with_strength(sh_radiance: ArrayLike) -> tuple[ArrayF64, float]:
    """The smallest window after which no surface receives negative light, and how strong it had to be.

    The window is the heat kernel. Under heat flow the lowest value on the sphere never falls, so strength and minimum
    rise together and a bisection finds the smallest window; for windows of the Hann and sinc families that is not
    given. A fixed window was rejected: it blurs the many lights that need none.

    All channels share one window, so hue does not shift. A channel whose mean is negative cannot be mended by any
    window; it becomes 0 (black), which removes light, and does not count for the strength.

    ValueError for coefficients not finite. The minimum is taken over `N_CHECKED_NORMALS` normals, some 3 degrees apart;
    between them an order-2 light can dip below 0 by 0.1 % of its largest irradiance.

    Returns
    -------
    coefficients : same shape, float64; equal to the input where its irradiance is nowhere negative
    strength : 0 to 1, the share taken off the bands of l = 1: 0 is no window, 1 leaves the constant light alone
    """
    coefficients, order = checked_sh(sh_radiance)
    coefficients = coefficients * (coefficients[0] >= 0)
    return _windowed(coefficients, _radiance_table(order) * per_coefficient(cosine_lobe(order)))


def dering(sh_radiance: ArrayLike) -> ArrayF64:
    """`dering_with_strength` without the strength: ((order + 1)^2, 3), same shape as the input."""
    return dering_with_strength(sh_radiance)[0]


def dering_for_display(sh_radiance: ArrayLike) -> ArrayF64:
    """The light with the smallest windows after which it is nowhere negative: for whoever looks at it.

    Radiance and not irradiance, as a backdrop and a mirror show it; since the cosine is nowhere negative, no surface
    receives negative light then either. `dering` would do next to nothing: of 2592 estimates in the 149 test rooms 11
    light a surface negatively, and 337 are negative somewhere. Windowed bands: Sloan, "Stupid Spherical Harmonics (SH)
    Tricks", 2008; a window for each light: Sloan, "Deringing Spherical Harmonics", SIGGRAPH Asia 2017 Technical Briefs.
    The window here is the heat kernel of `dering_with_strength`.

    Each channel has its own window. In nine of those estimates blue has at most an eighth of the mean of red and rings:
    one window for all channels takes 44 to 100 % of l = 1 off red too. The price is hue, where a channel is windowed.

    Same shape, float64; channels that are nowhere negative to the bit, l = 0 always, except that a channel whose mean
    is negative becomes 0. ValueError for coefficients not finite. Checked at `N_CHECKED_NORMALS` directions, as
    `dering_with_strength`: between them, 600 random channels of order 2 dipped below 0 by 0.08 % of their largest
    radiance at most. Takes 4 ms.
    """
    coefficients, order = checked_sh(sh_radiance)
    coefficients = coefficients * (coefficients[0] >= 0)
    table = _radiance_table(order)
    return np.concatenate([_windowed(coefficients[:, [channel]], table)[0] for channel in range(3)], axis=1)


def _windowed(coefficients: ArrayF64, table: ArrayF64) -> tuple[ArrayF64, float]:
    """After the smallest window for all columns after which `table` times none of them is negative; its strength.

    The factor of band l is that of the heat kernel, (1 - strength)^(l (l + 1) / 2).
    """
    band = np.arange(round(np.sqrt(len(coefficients))))
    by_band = np.stack([table[:, band_slice(one)] @ coefficients[band_slice(one)] for one in band])

    def window(strength: float) -> ArrayF64:
        return (1 - strength) ** (band * (band + 1) / 2)

    def lowest(strength: float) -> float:
        return float(np.tensordot(window(strength), by_band, axes=1).min())

    strength = 0.0
    if not lowest(0.0) >= -NEGATIVE_TOLERANCE * np.abs(by_band).sum(axis=0).max():
        too_weak, strength = 0.0, 1.0
        for _ in range(N_BISECTIONS):
            middle = (too_weak + strength) / 2
            too_weak, strength = (too_weak, middle) if lowest(middle) >= 0 else (middle, strength)
    return coefficients * per_coefficient(window(strength))[:, None], strength
