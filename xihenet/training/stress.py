"""Disturbances of clouds, which ask whether an estimator degrades gently: nearly nothing, or nothing true, is seen.

Each disturbance makes new clouds of test clouds and leaves their truth, the light of the undisturbed room, as it is.
What is asked is whether an estimator is then worse than what a phone gives without any: so each comes with what the
phone's sensor would say. A disturbed picture reaches the sensor too; a cloud of which only a part is left does not, as
the frame is still seen whole, and only its distances are missing.

Not here: other numbers of anchors and rolled cameras, which need the rooms and come as sampled clouds of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from xihenet.colour import srgb_to_linear
from xihenet.records import ArrayF64
from xihenet.sphere import AnchorLattice
from xihenet.training.dataset import CloudSet

STRESS_LIMIT = 1.10
"""No group may be worse than `ambient` by more than a tenth."""

CAP_SHARE = 0.05
COLOUR_NOISE = 0.15
"""Standard deviation of encoded colour, as of a phone's picture in a dark room, pushed far."""

DISTANCE_NOISE = 0.1
"""Standard deviation relative to the distance: ten times a phone's sensor."""

Disturbance = Callable[[CloudSet, np.random.Generator], CloudSet]


def leave_cap(clouds: CloudSet, rng: np.random.Generator, share: float = CAP_SHARE) -> CloudSet:
    """Of each cloud, the anchors nearest to a set one drawn at random, `share` of the sphere and at least one.

    A cloud with less than that stays as it is, one without any set anchor too.
    """
    directions = AnchorLattice(clouds.is_set.shape[1]).directions
    n_left = max(1, round(share * len(directions)))
    is_set = np.zeros_like(clouds.is_set)
    for left, known in zip(is_set, clouds.is_set, strict=True):
        members = np.flatnonzero(known)
        if len(members):
            nearness = directions[members] @ directions[rng.choice(members)]
            left[members[np.argsort(-nearness, kind="stable")[:n_left]]] = True
    shown = is_set[..., None]
    srgb_u8, points_m, facing_i8 = clouds.srgb_u8 * shown, clouds.points_m * shown, clouds.facing_i8 * is_set
    # The sensor's reading stays the frame's own.
    return replace(clouds, srgb_u8=srgb_u8, points_m=points_m, facing_i8=facing_i8, is_set=is_set)


leave_one_anchor = partial(leave_cap, share=0.0)
"""Of each cloud, one set anchor drawn at random."""


def blacken(clouds: CloudSet, rng: np.random.Generator) -> CloudSet:
    """Every anchor that is set is black: a covered lens."""
    return _coloured(clouds, np.zeros_like(clouds.srgb_u8))


def blow_out(clouds: CloudSet, rng: np.random.Generator) -> CloudSet:
    """Every anchor that is set is at the end of the range: a frame exposed far too long."""
    return _coloured(clouds, np.full_like(clouds.srgb_u8, 255))


def add_noise(clouds: CloudSet, rng: np.random.Generator) -> CloudSet:
    """Noise on the encoded colour and the distance of every set anchor, then rounded and clipped as a camera does."""
    noise = rng.normal(0.0, 255 * COLOUR_NOISE, clouds.srgb_u8.shape)
    colours = np.clip(np.rint(clouds.srgb_u8 + noise), 0, 255).astype(np.uint8)
    stretch = np.maximum(rng.normal(1.0, DISTANCE_NOISE, (*clouds.is_set.shape, 1)), 0.1)
    return replace(_coloured(clouds, colours), points_m=(clouds.points_m * stretch).astype(np.float16))


DISTURBANCES: dict[str, Disturbance] = {
    "5 % coverage": leave_cap,
    "one set anchor": leave_one_anchor,
    "black frame": blacken,
    "blown-out frame": blow_out,
    "noise": add_noise,
}


def _coloured(clouds: CloudSet, srgb_u8: NDArray[np.uint8]) -> CloudSet:
    """The sensor's reading is the mean linear colour of what is seen now; of nothing, as it was."""
    colours = srgb_u8 * clouds.is_set[..., None]
    n_set = clouds.is_set.sum(axis=1)[:, None]
    total: ArrayF64 = np.einsum("mnc->mc", srgb_to_linear(colours / 255.0))
    sensed = np.where(n_set > 0, total / np.maximum(n_set, 1), clouds.ambient).astype(np.float32)
    return replace(clouds, srgb_u8=colours, ambient=sensed)
