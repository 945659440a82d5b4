"""How far is one light from another: its coefficients, and what it does to surfaces?

Relative to the light it is held against, so that scenes can be compared: 0.1 is a tenth of the light. Lights of
different order are compared as if the bands that one lacks were 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xihe_blender.previs.sample_count import SMALLEST_LIGHT
from xihenet.records import ArrayF64
from xihenet.sh import irradiance
from xihenet.sphere import AnchorLattice

ORDER = 4
N_COEFFICIENTS = (ORDER + 1) ** 2
N_NORMALS = 256
KINDS = ("coefficients", "irradiance")


def padded(sh_radiance: ArrayF64) -> ArrayF64:
    """(25, 3): coefficients of any order up to 4 with zeros behind."""
    light = np.zeros((N_COEFFICIENTS, 3))
    light[: len(sh_radiance)] = sh_radiance
    return light


def square_errors(lights: Sequence[ArrayF64], references: Sequence[ArrayF64]) -> dict[str, list[float]]:
    """By kind of error, the squared relative error at each place.

    Parameters
    ----------
    lights, references : (25, 3) or less, one each for every place; a dark reference counts as grey light at the key
    """
    pairs = [(padded(light), padded(reference)) for light, reference in zip(lights, references, strict=True)]
    return {
        "coefficients": [_square(a, b, SMALLEST_LIGHT) for a, b in pairs],
        "irradiance": [_square(_on_surfaces(a), _on_surfaces(b), _SMALLEST_IRRADIANCE) for a, b in pairs],
    }


_SMALLEST_IRRADIANCE = SMALLEST_LIGHT * float(np.sqrt(np.pi * N_NORMALS / 4))
"""Of the same grey light: pi times its radiance on every normal."""


def _on_surfaces(light: ArrayF64) -> ArrayF64:
    return irradiance(light, AnchorLattice(N_NORMALS).directions)


def _square(light: ArrayF64, reference: ArrayF64, smallest: float) -> float:
    norm = max(float(np.sqrt((reference**2).sum())), smallest)
    return float(((light - reference) ** 2).sum()) / norm**2
