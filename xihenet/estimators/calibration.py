"""The calibration of a network's raw expected error, so that it can be believed.

A mean of it and of the size of the light; a power law of that and what was seen of the sphere, three numbers kept
in the weights file; and multiples of the expected error that hold a share of the clouds. `xihenet.training.calibration`
fits them and says why.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from xihenet.records import ArrayF64

SHARES_ASKED = (0.5, 0.68, 0.9)
STEEPEST = 3.0
STEEPEST_IN_COVERAGE = 5.0
SMALLEST_RAW = 1e-6
OF_SIZE = 0.75
DARKEST = 0.02  # Size of a light below which an error does not shrink any more with it; white from everywhere has 1.2.


def raw_error(network_error: ArrayLike, sh_radiance: ArrayLike) -> ArrayF64:
    """(M,) what is calibrated, of the error that a network expects of itself (M,) and its lights (M, 9, 3).

    A geometric mean of the error and, with a weight of `OF_SIZE`, the root mean square of the light. What a network
    expects is of all that it guessed, of which the estimator believes a part (`lattice_network`); a light is seldom
    more wrong than it is bright. Both scale with the exposure. Light of less than `DARKEST` counts as that: that hardly
    anything was seen, or that it was dark, is no reason to be sure.
    """
    # Not by squares, which overflow from 1e154 on.
    size = np.hypot.reduce(np.reshape(sh_radiance, (-1, 27)).astype(np.float64), axis=1) / np.sqrt(27)
    return np.asarray(network_error, np.float64) ** (1 - OF_SIZE) * np.maximum(size, DARKEST) ** OF_SIZE


@dataclass(frozen=True)
class Calibration:
    """Expected SHC RMSE = factor x raw^power x exp(slope x coverage), of a `raw_error`."""

    factor: float
    power: float
    slope: float
    quantiles: tuple[float, ...]  # multiples of the expected error below which each of `SHARES_ASKED` stays

    def __post_init__(self) -> None:
        numbers = (self.factor, *self.quantiles)
        is_sound = np.isfinite([*numbers, self.power, self.slope]).all() and min(numbers) >= 0
        if not (is_sound and 0 <= self.power <= STEEPEST and abs(self.slope) <= STEEPEST_IN_COVERAGE):
            raise ValueError(
                f"calibration: expected numbers >= 0, a power of at most {STEEPEST} and a slope of at most "
                f"{STEEPEST_IN_COVERAGE}, got {self}"
            )

    def expected(self, raw: ArrayLike, coverage: ArrayLike) -> ArrayF64:
        """(M,) expected SHC RMSE of raw expected errors (M,) at coverages (M,) from 0 to 1."""
        powered = np.maximum(np.asarray(raw, np.float64), SMALLEST_RAW) ** self.power
        return self.factor * powered * np.exp(self.slope * np.asarray(coverage, np.float64))

    def as_figures(self) -> dict[str, Any]:
        """What a weights file keeps in its header: `error_law` and `error_quantiles`."""
        quantiles = {f"{share:.2f}": multiple for share, multiple in zip(SHARES_ASKED, self.quantiles, strict=True)}
        return {"error_law": [self.factor, self.power, self.slope], "error_quantiles": quantiles}

    @classmethod
    def from_figures(cls, figures: Mapping[str, Any]) -> Calibration:
        """What `as_figures` wrote; without it, raw errors stay as they are. ValueError for anything else."""
        if "error_scale" in figures:
            raise ValueError("figures: calibrated before the light's size counted; run `xihe train export` on it again")
        if "error_law" not in figures:
            return cls(1.0, 1.0, 0.0, tuple(-np.log1p(-np.array(SHARES_ASKED))))
        try:
            factor, power, slope = map(float, figures["error_law"])
            quantiles = tuple(float(figures["error_quantiles"][f"{share:.2f}"]) for share in SHARES_ASKED)
            return cls(factor, power, slope, quantiles)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"figures: expected error_law and error_quantiles ({error})") from None
