"""Do two renderings of a scene show the same picture, up to noise? Asked where a setting should not have mattered.

Given is a picture per seed for each setting. A single pixel decides nothing: of a thousand pixels some fifty differ by
more than two standard errors by chance. Chosen: two numbers of the whole picture, each with a known distribution.

- The mean of the picture, per channel: its difference in standard errors of that difference. Sees what is missing
  everywhere by a little. Of three channels, which rise and fall together, the worst counts.
- The means of blocks: the sum of squares of their differences in standard errors, which without a difference is a sum
  of squares of Student-distributed numbers. Sees what is missing in one place, or added in one and missing in another.

The standard errors are those of independent seeds. With the same seeds on both sides the noise that both share drops
out: chance then fails a true agreement more rarely, and hides no difference larger than two standard errors. Rejected:
errors of the paired differences, by which a missing millionth of the light counts, since it is so at every seed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xihenet.records import ArrayF32, ArrayF64

BLOCKS_ALONG = 4
ROUNDING = 1e-6  # A difference this small, relative to the picture's mean, is rounding and not light


@dataclass(frozen=True)
class Agreement:
    """How two sets of pictures agree."""

    relative_difference: float  # of the mean over all pixels and channels, second less first, over the first
    mean_errors: float  # the largest difference of a channel's mean, in standard errors
    block_errors: float  # the block statistic, less what is expected without a difference, in standard deviations

    @property
    def holds(self) -> bool:
        """Whether neither number is beyond two of its standard errors."""
        return self.mean_errors <= 2.0 and self.block_errors <= 2.0


def agreement(first: ArrayF32 | ArrayF64, second: ArrayF32 | ArrayF64) -> Agreement:
    """Compare the means over seeds of two sets of pictures.

    `first` and `second` are (S, H, W, 3) linear radiance of S seeds, S >= 4. ValueError for other shapes, or values
    that are not finite.
    """
    if first.shape != second.shape or first.ndim != 4 or first.shape[-1] != 3 or len(first) < 4:
        raise ValueError(f"agreement: expected two (S, H, W, 3) with S >= 4, got {first.shape} and {second.shape}")
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise ValueError("agreement: expected finite pictures, got NaN or infinity")
    sides = (first.astype(np.float64), second.astype(np.float64))
    scale = max(float(sides[0].mean()), float(sides[1].mean()))
    channels = [side.mean(axis=(1, 2)) for side in sides]
    blocks = [_block_means(side) for side in sides]
    squares = _differences_in_errors(blocks[0], blocks[1], scale) ** 2
    # Mean and variance of t^2 for Student's t of so many degrees of freedom, more than 4.
    freedom = 2 * (len(first) - 1)
    expected = freedom / (freedom - 2)
    variance = 3 * freedom**2 / ((freedom - 2) * (freedom - 4)) - expected**2
    excess = (squares.sum() - expected * squares.size) / np.sqrt(variance * squares.size)
    relative = (sides[1].mean() - sides[0].mean()) / scale if scale > 0 else 0.0
    errors = np.abs(_differences_in_errors(channels[0], channels[1], scale)).max()
    return Agreement(float(relative), float(errors), float(excess))


def _block_means(pictures: ArrayF64) -> ArrayF64:
    """(S, blocks): mean over the pixels and channels of each of some 16 blocks."""
    rows = np.array_split(np.arange(pictures.shape[1]), BLOCKS_ALONG)
    columns = np.array_split(np.arange(pictures.shape[2]), BLOCKS_ALONG)
    cells = [pictures[:, row][:, :, column] for row in rows for column in columns if row.size and column.size]
    return np.stack([cell.mean(axis=(1, 2, 3)) for cell in cells], axis=1)


def _differences_in_errors(first: ArrayF64, second: ArrayF64, scale: float) -> ArrayF64:
    """Differences of the means over seeds (axis 0), in standard errors; infinite where there is one but no noise."""
    difference = second.mean(axis=0) - first.mean(axis=0)
    error = np.sqrt((first.var(axis=0, ddof=1) + second.var(axis=0, ddof=1)) / len(first))
    is_light = np.abs(difference) > ROUNDING * scale
    # Without any spread a difference is infinitely many errors; 0 / 0 is no light, and taken for 0.
    with np.errstate(divide="ignore", invalid="ignore"):
        found: ArrayF64 = np.where(is_light, difference / error, 0.0)
    return found
