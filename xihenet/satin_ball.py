"""A satin ball: how far is a light from the true one, where the true one is more than nine coefficients?

Half of what a satin ball shows in a direction is a matte ball's, half the mean of the light within HALF_ANGLE of it: a
white ball with a broad sheen. Between a matte ball, which hides most of what order 2 lacks, and a mirror, which shows
little else, it stands for the objects that are put into rooms. All errors of an error budget are differences of two
pictures of it: of the estimated light and of the true one.

In spherical harmonics the ball is a factor for each band, so that the mean square over all directions is a sum over
coefficients (Parseval). What lies beyond order 2 is one part of that sum, which no estimate changes. Rejected: the RMSE
of nine coefficients, which cannot see it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from xihenet.records import ArrayF64
from xihenet.sh import cosine_lobe
from xihenet.sh_basis import checked_sh, per_coefficient

HALF_ANGLE = math.radians(36.0)
"""That of the cones by which the reference probe measures all light, so that its pictures are those of this ball."""

ORDER = 8
"""Of the true picture. The ball keeps 0.26 of band 3 and 0.12 of band 4. Of what a point of light makes it show order 2
holds 80 % of the mean square, and order 8 95 %."""

N_OF_ORDER_2 = 9


@cache
def cone_factors(order: int) -> ArrayF64:
    """(order + 1,) what the mean over a cone leaves of each band: the mean of Legendre's polynomial P_l over it."""
    c = math.cos(HALF_ANGLE)
    p = np.polynomial.legendre.legvander(np.array([c]), order + 1)[0]  # type: ignore[no-untyped-call]
    factors = [(p[band - 1] - p[band + 1]) / ((2 * band + 1) * (1 - c)) for band in range(1, order + 1)]
    return np.array([1.0, *factors])


@cache
def satin_factors(order: int) -> ArrayF64:
    """(order + 1,) what the ball leaves of each band."""
    return (cosine_lobe(order) / np.pi + cone_factors(order)) / 2


def satin_of_cones(cones: ArrayLike) -> ArrayF64:
    """((order + 1)^2, 3) coefficients of what the ball shows, from those of the light's means over cones."""
    picture, order = checked_sh(cones)
    return picture * per_coefficient(satin_factors(order) / cone_factors(order))[:, None]


def satin_picture(sh_radiance: ArrayLike) -> ArrayF64:
    """((order + 1)^2, 3) coefficients of what the ball shows under a light of the same shape; ValueError as `sh`."""
    light, order = checked_sh(sh_radiance)
    return light * per_coefficient(satin_factors(order))[:, None]


def mean_square(picture: ArrayF64) -> float:
    """Of a picture given by its coefficients (n, 3), over all directions and channels."""
    return float(np.square(picture).sum() / (4 * np.pi * picture.shape[1]))


@dataclass(frozen=True, eq=False)
class SatinBall:
    """The ball under the true light of one position.

    Parameters
    ----------
    picture : ((order + 1)^2, 3) coefficients of what it shows, order 2 or more
    noise_beyond : mean square that rendering noise adds to what lies beyond order 2, 0 or more
    """

    picture: ArrayF64
    noise_beyond: float = 0.0

    def __post_init__(self) -> None:
        picture, order = checked_sh(self.picture)
        if order < 2:
            raise ValueError(f"SatinBall: expected a picture of order 2 or more, got order {order}")
        if not (math.isfinite(self.noise_beyond) and self.noise_beyond >= 0):
            raise ValueError(f"SatinBall: expected noise of 0 or more, got {self.noise_beyond}")
        object.__setattr__(self, "picture", picture)

    @property
    def brightness(self) -> float:
        """Root mean square of what it shows."""
        return math.sqrt(mean_square(self.picture))

    @property
    def light(self) -> ArrayF64:
        """(9, 3) the true light as far as order 2 holds it."""
        return self.picture[:N_OF_ORDER_2] / per_coefficient(satin_factors(2))[:, None]

    @property
    def beyond_order_2(self) -> float:
        """Mean square of what no light of order 2 can show, without noise."""
        return max(0.0, mean_square(self.picture[N_OF_ORDER_2:]) - self.noise_beyond)

    def squared_error(self, sh_radiance: ArrayF64, *, has_all_orders: bool = False) -> float:
        """Mean squared difference to the ball under a light (9, 3).

        `has_all_orders` gives that light what the true one has beyond order 2.
        """
        within = mean_square(satin_picture(sh_radiance) - self.picture[:N_OF_ORDER_2])
        return within if has_all_orders else within + self.beyond_order_2
