"""Axes of clients: how a direction, and a light in spherical harmonics, read in theirs and in ours.

Anchor i is one direction in the room for every client, that of `AnchorLattice` in our axes. In the published client's,
Unity's, its y and z are swapped, which is the published formula; in right-handed axes with +Y up, its z changes sign as
well. Radiance coefficients are those of the same light with the basis evaluated in the client's own axes. All three
matrices are orthonormal, so nothing is lost on the way there and back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from xihenet.light.platforms import Y_UP, Z_MIRRORED, in_axes
from xihenet.records import ArrayF64

PUBLISHED_AXES, OUR_AXES = "unity", "z-up"

AXES: Mapping[str, ArrayF64] = MappingProxyType({PUBLISHED_AXES: Z_MIRRORED, "y-up": Y_UP, OUR_AXES: np.eye(3)})
"""By name, (3, 3): a direction in our axes times this is the same direction in the client's.

`unity` is left-handed, x right, y up, z forward: ours is (x, z, y). `y-up` is right-handed, as of three.js, ARKit,
WebXR and glTF: (x, z, -y). `z-up` is ours, Blender's.
"""


def checked_axes(name: str) -> str:
    """`name`; ValueError, naming the choices, for one that is not among them."""
    if name not in AXES:
        raise ValueError(f"there are no axes {name!r}: choose one of {', '.join(AXES)}")
    return name


@lru_cache(maxsize=len(AXES))
def _coefficient_matrix(axes: str) -> ArrayF64:
    """(9, 9) orthogonal: our coefficients to the client's."""
    columns = [in_axes(np.eye(9)[:, first : first + 3], AXES[axes]) for first in (0, 3, 6)]
    # Band 2 mixes where z becomes another axis, so the entries are not all 0 and 1.
    return np.asarray(np.round(np.concatenate(columns, axis=1), 14), np.float64)


def coefficients_in(sh_radiance: ArrayF64, axes: str) -> list[float]:
    """27 numbers, nine of red, then green, then blue, in the client's axes, of (9, 3) in ours."""
    return (_coefficient_matrix(axes) @ sh_radiance).T.ravel().tolist()


def sh_from(coefficients: Sequence[float], axes: str) -> ArrayF64:
    """(9, 3) in our axes of what `coefficients_in` gave; ValueError unless they are 27 finite numbers."""
    own = np.asarray(coefficients, np.float64)
    if own.shape != (27,) or not np.isfinite(own).all():
        raise ValueError(f"coefficients: expected 27 finite numbers, got an array of shape {own.shape}")
    return _coefficient_matrix(axes).T @ own.reshape(3, 9).T


def vector_in(vector: ArrayLike, axes: str) -> list[float]:
    """(3,) in our axes as the client has it."""
    return (AXES[axes] @ np.asarray(vector, np.float64)).tolist()


def vector_from(vector: ArrayLike, axes: str) -> ArrayF64:
    """(3,) of the client in our axes."""
    return AXES[axes].T @ np.asarray(vector, np.float64)
