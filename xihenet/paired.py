"""Paired values: by how much do two methods differ that were tried on the same things, and how sure is that?

Differences are taken pair by pair, so that what makes one scene harder than another falls out. Pairs of one group, such
as two seeds of one scene, are not independent: whole groups are drawn anew, which answers "what about other scenes?".
With few groups a plain bootstrap is too sure of itself; its percentiles are moved outwards by what Student's t says for
that number of groups. Means of what was drawn never leave what was seen, so that G groups hold the truth in at most
1 - 2^(1 - G) of all cases, whatever is done: 75 % with three, 94 % with five.

Rejected: a t-test, which takes the differences for normal; those of scenes are not.

Whether two values put things in one order, the rank correlation says.

Source: Hesterberg, "What teachers should know about the bootstrap" (2015), expanded percentile interval.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from xihenet.records import ArrayF64, ArrayInt

N_DRAWS = 10_000
CONFIDENCE = 0.95
T_975 = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131)
"""Student's t that 2.5 % lie above, for 1, 2, ... degrees of freedom."""

FEWEST_RANKED = 8
"""Pairs of a rank correlation from which on its interval holds the truth as often as it says."""


@dataclass(frozen=True)
class PairedDifference:
    """How much the first of two methods has more than the second."""

    mean: float  # of first - second over pairs
    low: float | None  # of the 95 % confidence interval of that mean; None for a single pair
    high: float | None
    n_pairs: int
    n_groups: int  # one says nothing of others
    share_lower: float  # of the pairs in which the first is lower; those in which both are equal are in neither share
    share_higher: float

    @property
    def is_clear(self) -> bool:
        """Whether the interval leaves 0 out, and stands on enough to be one of 95 %: six groups, or pairs of one."""
        n_drawn = self.n_groups if self.n_groups > 1 else self.n_pairs
        if self.low is None or self.high is None or held_at_most(n_drawn) < CONFIDENCE:
            return False
        return self.low > 0 or self.high < 0


def held_at_most(n_groups: int) -> float:
    """In how many of all cases an interval over so many groups can hold the truth, whatever is done."""
    return 1 - 2.0 ** (1 - n_groups)


def paired_difference(
    first: Sequence[float], second: Sequence[float], groups: Sequence[Hashable], rng: np.random.Generator
) -> PairedDifference:
    """The mean difference of `first` and `second`, and its 95 % confidence interval.

    All are of the same P things: finite values, and which `groups` belong together; with one group alone pairs are
    drawn instead. The same seed of `rng` gives the same interval. ValueError for lengths that differ, no pair at all,
    or values that are not finite.
    """
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if not len(a) == len(b) == len(groups) or not len(a):
        raise ValueError(
            f"paired_difference: expected as many of each and one at least, got {len(a)}, {len(b)}, {len(groups)}"
        )
    difference = a - b
    if not np.isfinite(difference).all():
        raise ValueError("paired_difference: expected finite values")
    names = {group: index for index, group in enumerate(dict.fromkeys(groups))}
    drawn = [names[group] for group in groups] if len(names) > 1 else list(range(len(a)))
    low, high = _interval(difference, np.array(drawn), rng)
    lower, higher = float(np.mean(difference < 0)), float(np.mean(difference > 0))
    return PairedDifference(float(difference.mean()), low, high, len(a), len(names), lower, higher)


def _interval(difference: ArrayF64, groups: ArrayInt, rng: np.random.Generator) -> tuple[float | None, float | None]:
    """(low, high) of the mean of `difference` when whole `groups`, numbered from 0, are drawn with replacement."""
    n_groups = int(groups.max()) + 1
    if n_groups < 2:
        return None, None
    sums, counts = np.bincount(groups, difference), np.bincount(groups)
    draws = rng.integers(n_groups, size=(N_DRAWS, n_groups))
    means = sums[draws].sum(axis=1) / counts[draws].sum(axis=1)
    tail = expanded_tail(n_groups)
    low, high = np.quantile(means, [tail, 1 - tail])
    return float(low), float(high)


def expanded_tail(n_groups: int) -> float:
    """Share of the bootstrap's draws below the 95 % interval, and as much above it; for two groups or more."""
    return NormalDist().cdf(-math.sqrt(n_groups / (n_groups - 1)) * t_975(n_groups - 1))


def t_975(degrees: int) -> float:
    """Student's t that 2.5 % lie above, for 1 degree of freedom or more.

    Of the table, and behind it by Cornish and Fisher's series (0.1 % off at its end).
    """
    if degrees <= len(T_975):
        return T_975[degrees - 1]
    z = NormalDist().inv_cdf(0.975)
    return z + (z**3 + z) / (4 * degrees) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * degrees**2)


def rank_correlation(first: ArrayF64, second: ArrayF64) -> float:
    """Spearman's: the correlation of ranks, ties sharing theirs. NaN for fewer than two, or where one is constant."""
    a, b = (_ranks(np.asarray(values, np.float64)) for values in (first, second))
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return float("nan")
    return float(np.corrcoef(a, b)[0, 1])


def rank_correlation_interval(first: ArrayF64, second: ArrayF64, rng: np.random.Generator) -> tuple[float, float]:
    """The 95 % bootstrap interval of `rank_correlation` over pairs.

    NaN where that is undefined, and for fewer than FEWEST_RANKED pairs: of four places such intervals held the true
    correlation in half to three quarters of simulated cases, and in their order each says 1 to 1.
    """
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if len(a) < FEWEST_RANKED:
        return float("nan"), float("nan")
    draws = rng.integers(0, len(a), (2000, len(a)))
    found = np.array([rank_correlation(a[draw], b[draw]) for draw in draws])
    found = found[np.isfinite(found)]
    if not len(found):
        return float("nan"), float("nan")
    low, high = np.percentile(found, (2.5, 97.5))
    return float(low), float(high)


def _ranks(values: ArrayF64) -> ArrayF64:
    _, index, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return (last - (counts - 1) / 2)[index.reshape(-1)]
