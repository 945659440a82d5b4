"""What turns a network's raw expected error into one that can be believed?

A power law, two numbers kept in the weights file, and multiples of the expected error that hold a share of the clouds.
`xihenet.training.calibration` fits them to the validation rooms and says why.
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
SMALLEST_RAW = 1e-6


@dataclass(frozen=True)
class Calibration:
    """From a raw expected error to one that can be believed.

    Parameters
    ----------
    factor, power : expected SHC RMSE = factor x raw^power
    quantiles : for each of `SHARES_ASKED`, the multiple of the expected error below which that share stays
    """

    factor: float
    power: float
    quantiles: tuple[float, ...]

    def __post_init__(self) -> None:
        numbers = (self.factor, *self.quantiles)
        if not (np.isfinite([*numbers, self.power]).all() and min(numbers) >= 0 and 0 <= self.power <= STEEPEST):
            raise ValueError(f"calibration: expected numbers >= 0 and a power of at most {STEEPEST}, got {self}")

    def expected(self, raw: ArrayLike) -> ArrayF64:
        """(M,) expected SHC RMSE of raw expected errors."""
        errors: ArrayF64 = self.factor * np.maximum(np.asarray(raw, np.float64), SMALLEST_RAW) ** self.power
        return errors

    def as_figures(self) -> dict[str, Any]:
        """What a weights file keeps in its header: `error_scale` and `error_quantiles`."""
        quantiles = {f"{share:.2f}": multiple for share, multiple in zip(SHARES_ASKED, self.quantiles, strict=True)}
        return {"error_scale": [self.factor, self.power], "error_quantiles": quantiles}

    @classmethod
    def from_figures(cls, figures: Mapping[str, Any]) -> Calibration:
        """What `as_figures` wrote; without it, raw errors stay as they are. ValueError for anything else."""
        if "error_scale" not in figures:
            return cls(1.0, 1.0, tuple(-np.log1p(-np.array(SHARES_ASKED))))
        try:
            factor, power = map(float, figures["error_scale"])
            return cls(factor, power, tuple(float(figures["error_quantiles"][f"{s:.2f}"]) for s in SHARES_ASKED))
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"figures: expected error_scale and error_quantiles ({error})") from None
