"""Rows of numbers and places out of files that anyone may have written: what is not one is said in one line.

Poses come as quaternions in most formats. Their order is x, y, z, w here, as it is in all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from xihenet.records import POSE_TOLERANCE, ArrayF64

FARTHEST_M = 1e6  # From the origin of a recording; what is given in millimetres is still nearer
LONG_STEP_S = 5.0  # From one picture to the next: thirty a second in milliseconds are 33
SKEWED = 10 * POSE_TOLERANCE  # Poses are made of others, and rounded again
SHORTEST, LONGEST = 1e-6, 1e6  # Of a quaternion that still says a direction


def numbers(values: Any, n: int, name: str) -> ArrayF64:
    """(n,) finite numbers of a list or of texts. ValueError else."""
    array = pose_numbers(values, n, name)
    if array is None:
        raise ValueError(f"{name}: expected finite numbers, got {values!r:.80}")
    return array


def pose_numbers(values: Any, n: int, name: str) -> ArrayF64 | None:
    """As `numbers`, but None where one is not finite, as trackers write a pose while they are lost."""
    try:
        if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != n:
            raise TypeError
        array = np.array([float(value) for value in values])
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name}: expected {n} numbers, got {values!r:.80}") from None
    return array if np.isfinite(array).all() else None


def pose_of(place_m: ArrayF64, quaternion: ArrayF64, name: str = "pose") -> ArrayF64:
    """(4, 4) of a place (3,) and a rotation (4,). ValueError for a quaternion without length, or a place far away."""
    if np.abs(place_m).max() > FARTHEST_M:
        raise ValueError(f"{name}: expected a place within {FARTHEST_M:g} m of the origin, got {place_m.tolist()}")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_of(quaternion, name), place_m
    return pose


def rotation_of(quaternion: ArrayF64, name: str = "pose") -> ArrayF64:
    """(3, 3) of x, y, z, w, as of `of_length_1`."""
    x, y, z, w = of_length_1(quaternion, name)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def of_length_1(quaternion: ArrayF64, name: str = "pose") -> ArrayF64:
    """(4,) of one of any length that is not about 0 or beyond measure; ValueError else."""
    with np.errstate(over="ignore"):  # Numbers whose squares overflow have an infinite length, and are refused.
        length = float(np.linalg.norm(quaternion))
    if not SHORTEST < length < LONGEST:
        raise ValueError(f"{name}: expected a quaternion of length 1, got one of {length:.3g}")
    return quaternion / length


def quaternion_of(rotation: ArrayF64) -> ArrayF64:
    """(4,) x, y, z, w of length 1 of a rotation (3, 3): the largest eigenvector of Bar-Itzhack's matrix (2000).

    ValueError for axes that mirror or shear, which no quaternion says.
    """
    r = rotation
    if not (np.abs(r.T @ r - np.eye(3)).max() < SKEWED and np.linalg.det(r) > 0):
        raise ValueError("the camera is mirrored or sheared, which this layout cannot say: give it a scale of 1")
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r.trace()],
        ]
    )
    return np.linalg.eigh(k)[1][:, -1]


def notes_on_times(times_s: Sequence[float]) -> tuple[str, ...]:
    """Where times do not rise, and frames keep the order that they have; and where they may not be seconds."""
    steps_s, notes = np.diff(np.asarray(times_s, np.float64)), []
    if n := int(np.count_nonzero(steps_s < 0)):
        often = "once" if n == 1 else f"{n} times"
        notes.append(f"Times go back {often}: frames are taken in the order of their numbers.")
    if len(steps_s) and (usual_s := float(np.median(steps_s))) > LONG_STEP_S:
        notes.append(f"Times are taken for seconds, though a picture comes every {usual_s:g} s.")
    return tuple(notes)
