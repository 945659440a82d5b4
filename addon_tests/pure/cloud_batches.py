"""Batches of clouds for networks, as arrays: colours (C, N, 3), distances (C, N), which anchors are set (C, N)."""

import numpy as np

from xihenet.records import FAR_M

NASTY = ("nothing set", "one anchor", "few anchors", "black", "white", "bright in black", "one far")
ALIKE = ("sky and a lamp", "at no distance", "beyond measure")
"""Nasty as well, with many points at one place or at one distance."""


def random_clouds(n, seed=0, n_clouds=6):
    """Any share of `n` anchors, of any colour at up to 6 m."""
    rng = np.random.default_rng(seed)
    is_set = rng.random((n_clouds, n)) < rng.random((n_clouds, 1))
    srgb = rng.random((n_clouds, n, 3)) * is_set[..., None]
    return srgb.astype(np.float32), (rng.random((n_clouds, n)) * 6 * is_set).astype(np.float32), is_set


def nasty_clouds(n, kinds=NASTY + ALIKE):
    """One of each kind, of random colours at 1 to 3 m but for what its name says; `n` is at least 6."""
    rng = np.random.default_rng(1)
    made = []
    for kind in kinds:
        srgb, distance_m, is_set = rng.random((n, 3)), rng.uniform(1, 3, n), np.ones(n, bool)
        match kind:
            case "nothing set":
                is_set[:] = False
            case "one anchor":
                is_set = np.arange(n) == n // 3
            case "few anchors":
                is_set = np.arange(n) < 6
            case "black":
                srgb[:] = 0
            case "white":
                srgb[:] = 1
            case "bright in black":
                srgb[:] = np.arange(n)[:, None] == 7
            case "sky and a lamp":
                srgb[: n // 4], distance_m[: n // 5] = 1, FAR_M
            case "one far":
                distance_m[0] = 6e4
            case "at no distance":
                distance_m[:] = 0
            case "beyond measure":
                distance_m[:] = 3e38
        made.append(((srgb * is_set[:, None]).astype(np.float32), (distance_m * is_set).astype(np.float32), is_set))
    return tuple(np.stack(parts) for parts in zip(*made, strict=True))
