"""Clouds that are hard for any estimator: light at both ends of its range, next to nothing seen, odd distances."""

from functools import cache
from typing import Any

import numpy as np

from xihenet.estimators import Estimator, load
from xihenet.records import UnitSphereCloud

N = 1280
WHITE_LIGHT = float(np.sqrt(4 * np.pi))
"""The coefficient of white light from everywhere; clipped light has no larger one."""


@cache
def estimator(name: str = "lattice", n: int = N, target: Any = "ldr") -> Estimator:
    return load(name, n, target)


def cloud_of(srgb: Any, distance_m: Any = 2.0, is_set: Any = True, n: int = N) -> UnitSphereCloud:
    known = np.broadcast_to(is_set, n)
    colours = np.broadcast_to(np.asarray(srgb, float), (n, 3)) * known[:, None]
    return UnitSphereCloud(colours, np.broadcast_to(distance_m, n) * known, known)


RNG = np.random.default_rng(0)
NOISE = RNG.random((N, 3))
ANCHORS = np.arange(N)
ONE, HALF, EVEN = ANCHORS == 400, ANCHORS < N // 2, ANCHORS % 2 == 0
DARK = {
    "all black": cloud_of(0.0),
    "denormal colours": cloud_of(NOISE * 1e-40),
    "colours of 1e-30": cloud_of(NOISE * 1e-30),
    "colours of a single code": cloud_of((NOISE > 0.5) / 255),
}
PATTERNS = {
    "one white anchor in black": cloud_of(ONE[:, None] * 1.0),
    "one black anchor in white": cloud_of(~ONE[:, None] * 1.0),
    "a white half beside a black one": cloud_of(HALF[:, None] * 1.0),
    "black and white by turns": cloud_of(EVEN[:, None] * 1.0),
    "one white anchor in a black half": cloud_of(ONE[:, None] * 1.0, 2.0, HALF),
    "saturated colours by turns": cloud_of(np.eye(3)[ANCHORS % 3]),
}
DISTANCES = {
    "noise at no distance": cloud_of(NOISE, 0.0),
    "noise at 1e-45 m": cloud_of(NOISE, 1e-45),
    "noise at 65,504 m": cloud_of(NOISE, 65504.0),
    "noise at 1e10 m": cloud_of(NOISE, 1e10),
    "noise at 3e38 m": cloud_of(NOISE, 3e38),
    "noise at 1e-30 m and 3e38 m": cloud_of(NOISE, np.where(HALF, 1e-30, 3e38)),
}
CLOUDS = DARK | PATTERNS | DISTANCES
NOTHING = UnitSphereCloud.empty(N)
WHITE_ABOVE, ONE_WHITE = cloud_of(1.0, 2.0, HALF), cloud_of(1.0, 2.0, ONE)
