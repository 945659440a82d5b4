"""How good is an estimator where no light probe has been? What a frame shows that it was not given, tells.

Of a session, some frames are given and the others left out. The light is estimated from those that are given, and in
the directions that only the others show it is held against what they show. That needs no truth, so it can be asked of
frames from anywhere. It judges the light by its order-2 radiance in single directions, where every estimator errs much
by what order 2 cannot hold: differences between estimators mean something, the size of the error little.

Colours are linear, at the session's exposure, clipped at white as the pictures are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import reduce

import numpy as np

from xihenet.buffers import merge
from xihenet.colour import srgb_to_linear
from xihenet.records import ArrayF64, UnitSphereCloud
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

N_PARTS = 3
SMALLEST_SHARE = 0.02
"""Of the sphere, that left-out frames have to show alone to be asked."""


def left_out_error(sh_radiance: ArrayF64, given: UnitSphereCloud, left_out: UnitSphereCloud) -> float | None:
    """RMSE of the light (9, 3) in the directions that `left_out` shows and `given` does not; radiance is cut to 0 to 1.

    The light carries the session's exposure. None where these directions are less than `SMALLEST_SHARE` of the sphere.
    ValueError for clouds of different numbers of anchors.
    """
    if len(given) != len(left_out):
        raise ValueError(f"left out: expected as many anchors in both clouds, got {len(given)} and {len(left_out)}")
    is_asked = left_out.is_set & ~given.is_set
    if is_asked.mean() < SMALLEST_SHARE:
        return None
    said = basis(AnchorLattice(len(given)).directions[is_asked], 2) @ sh_radiance
    shown = srgb_to_linear(left_out.srgb[is_asked].astype(np.float64))
    return float(np.sqrt(np.mean((said.clip(0, 1) - shown) ** 2)))


def left_out_errors(
    frames: Sequence[UnitSphereCloud], estimate: Callable[[UnitSphereCloud], ArrayF64], *, is_merged: bool = False
) -> Iterator[float]:
    """Errors over a session: of the light from each frame alone, by all others; or from two thirds, by the other third.

    `frames` are what each of them shows of one position, in their order, a third of which is left out in turn;
    `estimate` gives (9, 3) of a cloud. What cannot be asked is left out, so that there may be none.
    """
    parts = np.array_split(np.arange(len(frames)), N_PARTS if is_merged else len(frames)) if frames else []
    for part in parts:
        inside = [frame for i, frame in enumerate(frames) if i in part]
        outside = [frame for i, frame in enumerate(frames) if i not in part]
        if inside and outside:
            given, left_out = (reduce(merge, some) for some in ((outside, inside) if is_merged else (inside, outside)))
            error = left_out_error(estimate(given), given, left_out) if given.is_set.any() else None
            if error is not None:
                yield error
