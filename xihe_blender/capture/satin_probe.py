"""The satin probe: what a satin ball shows under all the light that arrives at a position, rendered.

The reference probe measures the light by its means over cones (`reference_probe`). Here these are kept to a higher
order, where they tell what the ball shows, and their spread says how much of that is noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xihe_blender.capture.reference_probe import ReferenceProbe, finite_rgb, means_over_cones
from xihenet.records import ArrayF32
from xihenet.satin_ball import N_OF_ORDER_2, ORDER, SatinBall, mean_square, satin_of_cones
from xihenet.sh_basis import per_coefficient

N_PICTURES = 8
"""Each second one is turned over; their spread tells the noise."""


def satin_ball_at(probe: ReferenceProbe, index: int, frame: int, *, exposure: float, samples: int) -> SatinBall:
    """The ball at the `index`-th position of `probe` in `frame`, `samples` rays in each pixel of all pictures."""
    probe.scene.frame_set(frame)
    cones = [probe.cones(index, number, max(1, samples // N_PICTURES)) for number in range(N_PICTURES)]
    return satin_ball_of([finite_rgb(seen.passes, "Combined") for seen in cones], exposure)


def satin_ball_of(pictures: Sequence[ArrayF32], exposure: float) -> SatinBall:
    """From an even number of pictures (N, N, 3) of cones, each second one turned over about X."""
    opposite = per_coefficient((-1.0) ** np.arange(ORDER + 1))[:, None]
    of_pictures = exposure * np.array([satin_of_cones(mean * opposite) for mean in means_over_cones(pictures, ORDER)])
    variance = of_pictures.var(axis=0, ddof=1) / len(pictures)
    noise = mean_square(np.sqrt(variance[N_OF_ORDER_2:]))
    return SatinBall(of_pictures.mean(axis=0), noise)
