"""By how much may a network's word about its own error be believed, and what makes it better?

A network's raw expected error comes from training rooms, which it knows better than others: it is too small, and says
too much of what it learned by heart. On the validation rooms a power law maps it to the error that was made: two
numbers, positive and monotone for any raw value. They maximise the likelihood of exponential errors, as in training,
whose mean is the best guess; so expected errors average to those made. Multiples of the expected error that hold a
share of the validation clouds then make promises: of 90 % of the clouds the error is below so many times the expected.

Rejected: a line a + b x raw, which may be negative for an odd raw value; isotonic regression, which is no two numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from xihenet.estimators.calibration import SHARES_ASKED, SMALLEST_RAW, STEEPEST, Calibration
from xihenet.records import ArrayBool, ArrayF64

N_BINS = 8
_N_STEPS = 60


def fit_calibration(raw: ArrayLike, made: ArrayLike) -> Calibration:
    """The power law and the quantiles of validation clouds.

    Parameters
    ----------
    raw, made : (M,) what the network expected and what came, M at least 2

    Returns
    -------
    Calibration whose expected errors have made / expected = 1 in the mean. Raises ValueError for too few, other
    shapes, negative errors, NaN or infinity.
    """
    expected, errors = _checked(raw, made)
    power = _best_power(np.log(np.maximum(expected, SMALLEST_RAW)), errors)
    powered = np.maximum(expected, SMALLEST_RAW) ** power
    factor = float(np.mean(errors / powered))
    quantiles = np.quantile(errors / np.maximum(factor * powered, SMALLEST_RAW), SHARES_ASKED)
    return Calibration(factor, power, tuple(map(float, quantiles)))


def calibration_figures(
    expected: ArrayF64, promised: ArrayF64, made: ArrayF64, groups: Mapping[str, ArrayBool]
) -> dict[str, Any]:
    """How well promises are kept by clouds that nothing was fitted to.

    Parameters
    ----------
    expected, made : (M,) calibrated expected errors, and the errors
    promised : (S, M) for each of `SHARES_ASKED` the error that so many clouds should stay below
    groups : masks (M,) by name

    Returns
    -------
    For all clouds and each group the mean of both errors, the shares kept and the number; over quantiles of the
    expected error, the mean of both; and the correlation. None where there are no clouds.
    """
    everything = np.ones(len(made), bool)
    is_varied = len(made) > 1 and np.ptp(expected) > 0 and np.ptp(made) > 0
    return {
        "all": _kept(expected, promised, made, everything),
        "groups": {name: _kept(expected, promised, made, mask) for name, mask in groups.items()},
        "bins": _bins(expected, made),
        "correlation": float(np.corrcoef(expected, made)[0, 1]) if is_varied else None,
    }


def _kept(expected: ArrayF64, promised: ArrayF64, made: ArrayF64, mask: ArrayBool) -> dict[str, Any]:
    n = int(np.count_nonzero(mask))
    if n == 0:
        return {"n_clouds": 0, "expected": None, "made": None, "kept": [None] * len(promised)}
    kept = [float(np.mean(made[mask] <= limit[mask])) for limit in promised]
    return {"n_clouds": n, "expected": float(expected[mask].mean()), "made": float(made[mask].mean()), "kept": kept}


def _bins(expected: ArrayF64, made: ArrayF64) -> list[dict[str, float]]:
    """Clouds in order of their expected error, in bins of equal number."""
    parts = np.array_split(np.argsort(expected, kind="stable"), N_BINS)
    return [{"expected": float(expected[p].mean()), "made": float(made[p].mean())} for p in parts if len(p)]


def _best_power(log_raw: ArrayF64, made: ArrayF64) -> float:
    """The power of the highest likelihood, by golden section: with the factor put in, what is minimised is convex."""
    centred = log_raw - log_raw.mean()

    def unlikeliness(power: float) -> float:
        return float(np.log(np.mean(made * np.exp(-power * centred))))

    if not (np.ptp(log_raw) > 0 and made.any()):
        return 0.0
    low, high, golden = 0.0, STEEPEST, (np.sqrt(5) - 1) / 2
    for _ in range(_N_STEPS):
        a, b = high - golden * (high - low), low + golden * (high - low)
        low, high = (low, b) if unlikeliness(a) < unlikeliness(b) else (a, high)
    return float((low + high) / 2)


def _checked(raw: ArrayLike, made: ArrayLike) -> tuple[ArrayF64, ArrayF64]:
    expected, errors = np.asarray(raw, np.float64), np.asarray(made, np.float64)
    if expected.ndim != 1 or expected.shape != errors.shape or len(errors) < 2:
        raise ValueError(f"calibration: expected two arrays (M,) of 2 or more, got {expected.shape}, {errors.shape}")
    both = np.concatenate([expected, errors])
    if not (np.isfinite(both).all() and both.min() >= 0):
        raise ValueError("calibration: expected finite errors >= 0, got negative, infinite or NaN")
    return expected, errors
