"""The satin probe: what a satin ball shows under all the light that arrives at a position, rendered.

The reference probe measures the light by its means over cones (`reference_probe`). Here these are kept to a higher
order, where they tell what the ball shows, and their spread says how much of that is noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xihe_blender.capture.reference_probe import ReferenceProbe, finite_rgb
from xihenet.mirror_ball import project_mirror_ball
from xihenet.records import ArrayF32, ArrayF64
from xihenet.satin_ball import N_OF_ORDER_2, ORDER, SatinBall, mean_square, satin_of_cones

N_PICTURES = 8
"""Each second one is turned over; their spread tells the noise."""


def satin_ball_at(probe: ReferenceProbe, index: int, frame: int, *, exposure: float, samples: int) -> SatinBall:
    """The ball at the `index`-th position of `probe` in `frame`, `samples` rays in each pixel of all pictures."""
    probe.scene.frame_set(frame)
    cones = [probe.cones(index, number, max(1, samples // N_PICTURES)) for number in range(N_PICTURES)]
    return satin_ball_of([finite_rgb(seen.passes, "Combined") for seen in cones], exposure)


def satin_ball_of(pictures: Sequence[ArrayF32], exposure: float) -> SatinBall:
    """From an even number of pictures (N, N, 3) of cones, each second one turned over about X."""
    of_pictures = np.array([_projected(pictures, number) for number in range(len(pictures))]) * exposure
    variance = of_pictures.var(axis=0, ddof=1) / len(pictures)
    noise = mean_square(np.sqrt(variance[N_OF_ORDER_2:]))
    return SatinBall(of_pictures.mean(axis=0), noise)


def _projected(pictures: Sequence[ArrayF32], number: int) -> ArrayF64:
    """((ORDER + 1)^2, 3) of one picture; what lies on its rim is seen in the middle of the one beside it."""
    seen = project_mirror_ball(pictures[number], ORDER, turned=pictures[number ^ 1])
    opposite, turned_over = _signs()
    upright = seen * turned_over[:, None] if number % 2 else seen
    return satin_of_cones(upright * opposite[:, None])


def _signs() -> tuple[ArrayF64, ArrayF64]:
    """What becomes of coefficients in the opposite direction, and after half a turn about X."""
    bands = np.concatenate([np.full(2 * band + 1, band) for band in range(ORDER + 1)])
    m = np.concatenate([np.arange(-band, band + 1) for band in range(ORDER + 1)])
    return (-1.0) ** bands, np.where(m < 0, -1.0, 1.0) * (-1.0) ** (bands + m)
