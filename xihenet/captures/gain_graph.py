"""The gain graph: which gain has each frame, if ratios are known for some pairs of frames?

Least squares of logarithms over the graph of pairs, each channel by itself, with that of a reference held at 0. Pairs
that contradict the others, such as those on both sides of a moved lamp, are weighed down as Huber does. Sums along the
fewest pairs from the reference give the start, which is the answer where no pair closes a loop; conjugate gradients do
the rest, in memory that grows with the pairs alone. Rejected: a dense solution, 800 MB for 10,000 frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from xihenet.records import ArrayBool, ArrayF64, ArrayInt

N_WEIGHINGS = 20  # The start may follow pairs that contradict the others; after four weighings it still shows.
HUBER = 2.0  # Times its own standard error from which on a pair is weighed down
MOST_ITERATIONS = 500
PRECISE_TO = 1e-10  # Of the squared gradient at the start, of logarithms: far below what pictures of 8 bits tell


@dataclass(frozen=True, eq=False)
class Pair:
    """Two frames that show the same surfaces.

    Parameters
    ----------
    earlier, later : indices of the frames
    log_ratio : (3,) natural logarithm of the later frame's gain over the earlier one's
    sure_to : (3,) its standard error, above 0
    n_samples : points of which it is made
    """

    earlier: int
    later: int
    log_ratio: ArrayF64
    sure_to: ArrayF64
    n_samples: int


def solve_gains(n: int, pairs: Sequence[Pair], reference: int = 0) -> tuple[ArrayF64, ArrayBool, ArrayF64]:
    """Gains of n frames, relative to the one with the index `reference`; n may be 0.

    Returns
    -------
    logs : (n, 3) natural logarithms of the gains; 0 for the reference and where no pairs lead to it
    is_known : (n,) the reference, and the frames to which pairs lead from it
    residual : (n,) root mean square, over a frame's pairs and channels, of what the gains leave; NaN without a pair
    """
    logs, is_known = _along_fewest_pairs(n, pairs, reference)
    residual = np.full(n, np.nan)
    tied = [pair for pair in pairs if is_known[pair.earlier]]
    if not tied:
        return logs, is_known, residual
    earlier, later = (np.array([getattr(pair, name) for pair in tied], np.intp) for name in ("earlier", "later"))
    ratios, sure_to = (np.array([getattr(pair, name) for pair in tied]) for name in ("log_ratio", "sure_to"))
    for _ in range(N_WEIGHINGS):
        off = np.abs(logs[later] - logs[earlier] - ratios) / sure_to
        weights = np.minimum(1.0, HUBER / np.maximum(off, 1e-12)) / sure_to**2
        for channel in range(3):
            logs[:, channel] = _least_squares(
                logs[:, channel], reference, earlier, later, ratios[:, channel], weights[:, channel]
            )
    squares = ((logs[later] - logs[earlier] - ratios) ** 2).mean(axis=1)
    sums, counts = (_summed(earlier, of, n) + _summed(later, of, n) for of in (squares, np.ones(len(squares))))
    has_pair = counts > 0
    residual[has_pair] = np.sqrt(sums[has_pair] / counts[has_pair])
    return logs, is_known, residual


def _along_fewest_pairs(n: int, pairs: Sequence[Pair], reference: int) -> tuple[ArrayF64, ArrayBool]:
    """(n, 3) logarithms, summed along the fewest pairs from the reference; (n,) bool whether any lead there."""
    logs, is_known = np.zeros((n, 3)), np.zeros(n, bool)
    neighbours: list[list[tuple[int, ArrayF64]]] = [[] for _ in range(n)]
    for pair in pairs:
        neighbours[pair.earlier].append((pair.later, pair.log_ratio))
        neighbours[pair.later].append((pair.earlier, -pair.log_ratio))
    reached = [reference] if n else []
    is_known[reached] = True
    for index in reached:  # It grows while it is walked through.
        for other, ratio in neighbours[index]:
            if not is_known[other]:
                is_known[other] = True
                logs[other] = logs[index] + ratio
                reached.append(other)
    return logs, is_known


def _least_squares(
    start: ArrayF64, reference: int, earlier: ArrayInt, later: ArrayInt, ratios: ArrayF64, weights: ArrayF64
) -> ArrayF64:
    """(n,) that minimises the sum of weights * (x[later] - x[earlier] - ratios)^2, with x[reference] as in `start`.

    Conjugate gradients with the diagonal as preconditioner: Shewchuk, An Introduction to the Conjugate Gradient Method
    Without the Agonizing Pain (1994), appendix B3.
    """
    n = len(start)

    def spread(of_pairs: ArrayF64) -> ArrayF64:
        of_frames = _summed(later, of_pairs, n) - _summed(earlier, of_pairs, n)
        of_frames[reference] = 0
        return of_frames

    diagonal = _summed(later, weights, n) + _summed(earlier, weights, n)
    scale = np.divide(1.0, diagonal, out=np.zeros(n), where=diagonal > 0)
    x = start.copy()
    left = spread(weights * (ratios - x[later] + x[earlier]))
    step = scale * left
    size = first_size = float(left @ step)
    for _ in range(MOST_ITERATIONS):
        if size <= PRECISE_TO * first_size or size < 1e-20:
            break
        moved = spread(weights * (step[later] - step[earlier]))
        reach = size / float(step @ moved)
        x += reach * step
        left -= reach * moved
        scaled = scale * left
        size, before = float(left @ scaled), size
        step = scaled + (size / before) * step
    return x


def _summed(frames: ArrayInt, of_pairs: ArrayF64, n: int) -> ArrayF64:
    """(n,) sums, by frame, of what the pairs have."""
    return np.bincount(frames, of_pairs, minlength=n).astype(np.float64)
