"""Was a recording read with the right conventions? Its own surfaces tell: what is seen twice must lie in one place.

Files do not say whether poses are camera to world, along which axis the camera looks, or in which unit depth is. Read
wrongly, everything still runs and gives a light that looks right. Here `self_fit` says which share of the points that
frames see twice lies in one place, as read and under each other convention.

A convention is accused only if another one fits better by far, and if the walk could tell the two apart: a phone that
only pitches looks the same with either camera axes, and one that only turns in place fits every scale of depth. A scale
must therefore explain parallax, which is to fit better than the same turns do without any steps. Chosen: depth alone.
Rejected: colour as well, which drifts with the phone's exposure and agrees by chance on plain walls. Not here: which
way is up, errors of intrinsics, a scale of the poses (it looks like one of depth), and a depth that is off by another
factor than 5 or a power of ten: one of 4 is taken for 5, and one of 12 for 10.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from xihenet.captures.capture import Capture
from xihenet.captures.self_fit import AS_READ, DEPTHS, MOST_FRAMES, POSES, Fit, Recording
from xihenet.records import ArrayF64, RgbdFrame

SMALLEST_SHARE = 0.6  # Less is no good fit, whatever the others are: wrong conventions agree on 10 to 70 % by chance
SMALLEST_LEAD = 0.15  # Over the recording as read, which must be left at least this much, and disagree twice as often
AT_MOST_OF_TWO_MISTAKES = 0.5  # What agrees more often as read has no two of them
LEAD_OVER_NEXT = 0.05  # Over all other conventions: two that fit as well cannot be told apart

AXES = ("along -Z with +Y up", "along +Z with +Y down")
SAID_OF_POSES = {
    "camera axes": ("The cameras seem to look {axes}", "turned so they fit"),
    "transposed": ("The rotations of the poses look transposed", "transposed again they fit"),
    "inverse": ("The poses look like camera-from-world", "their inverse fits"),
    "inverse, camera axes": ("The poses look like camera-from-world of cameras that look {axes}", "their inverse fits"),
    "w first": ("The poses' quaternions look as if w came first", "as w x y z they fit"),
    "left-handed": ("The poses look left-handed, as Unity's are", "with z mirrored in world and camera they fit"),
    "turned right": ("The pictures look turned by a quarter to the right beside their poses", "turned back they fit"),
    "turned left": ("The pictures look turned by a quarter to the left beside their poses", "turned back they fit"),
    "upside down": ("The pictures look upside down beside their poses", "turned by half they fit"),
}
SAID_OF_DEPTH = {
    "5 x": ("The depth looks 5 times too large", "divided by 5 it fits"),
    "0.2 x": ("The depth looks 5 times too small", "times 5 it fits"),
    "10 x": ("The depth looks 10 times too large", "divided by 10 it fits"),
    "0.1 x": ("The depth looks 10 times too small", "times 10 it fits"),
    "1000 x": ("The depth looks 1000 times too large", "divided by 1000 it fits"),
    "0.001 x": ("The depth looks 1000 times too small", "times 1000 it fits"),
    "ray distance": ("The depth looks like distance along each pixel's ray", "as plane depth it fits"),
}


@dataclass(frozen=True)
class Suspected:
    """A convention under which a recording fits itself better by far than as it was read.

    Parameters
    ----------
    poses, depth : of POSES and of DEPTHS, what the file seems to hold; AS_READ where nothing is wrong
    share, share_as_read : of the points that fell on a measured surface, those that lie on it, 0 to 1
    sentence : for a person
    """

    poses: str
    depth: str
    share: float
    share_as_read: float
    sentence: str


def suspicion(capture: Capture) -> str | None:
    """A sentence where another convention fits the recording better by far, from some of its frames; else None.

    Raises as `CapturedFrame.read`.
    """
    n = len(capture.frames)
    chosen = np.unique(np.linspace(0, n - 1, min(n, MOST_FRAMES)).astype(int))
    frames = (capture.frames[k].read() for k in chosen)
    found = suspect(frames, blender_from_file=capture.blender_from_file, is_opencv=capture.is_opencv)
    return None if found is None else found.sentence


def suspect(
    frames: Iterable[RgbdFrame], *, blender_from_file: ArrayF64 | None = None, is_opencv: bool = False
) -> Suspected | None:
    """The convention that a recording seems to hold instead of that under which it was read.

    None if it was read rightly, and where nobody can say: no frame at all, none with a depth, frames that share no
    surface, a camera that hardly moves, or two conventions that fit alike. Two mistakes at once, of the poses and of
    the depth, are looked for only where no single one explains the recording. Poses are taken to be rotations and
    translations, as the readers see to.

    Parameters
    ----------
    frames : in any number; at most MOST_FRAMES of them are kept
    blender_from_file : (3, 3) that was put before the poses of the file to turn its world upright; None for nothing
    is_opencv : whether the camera's axes were turned from OpenCV's when the poses were read
    """
    recording = Recording(frames, blender_from_file, is_opencv)
    as_read = recording.fit(AS_READ, AS_READ)
    if as_read.can_tell and as_read.share > 1 - SMALLEST_LEAD:
        return None
    single = [(poses, AS_READ) for poses in POSES[1:]] + [(AS_READ, depth) for depth in DEPTHS if depth != AS_READ]
    double = [(poses, depth) for poses in POSES[1:] for depth in DEPTHS if depth != AS_READ]
    fits: dict[tuple[str, str], Fit] = {}
    for asked in (single, double) if as_read.share < AT_MOST_OF_TWO_MISTAKES else (single,):
        fits |= {one: fit for one in asked if (fit := recording.fit(*one)).can_tell}
        found = _best(recording, fits, as_read)
        if found is not None:
            (poses, depth), share = found
            sentence = _sentence(poses, depth, share, as_read.share, AXES[0 if is_opencv else 1])
            return Suspected(poses, depth, share, as_read.share, sentence)
    return None


def _best(recording: Recording, fits: dict[tuple[str, str], Fit], as_read: Fit) -> tuple[tuple[str, str], float] | None:
    """Which of these conventions fits better by far than the recording as read, and how well; None if none does."""
    if not fits:
        return None
    (poses, depth), best = max(fits.items(), key=lambda one: one[1].share)
    others = [as_read.share, *(fit.share for one, fit in fits.items() if one != (poses, depth))]
    if best.share < SMALLEST_SHARE or best.share < max(others) + LEAD_OVER_NEXT or not _is_far_better(best, as_read):
        return None
    # Poses that make the cameras look at walls that they never saw twice are right by chance in a square room.
    if poses != AS_READ and not as_read.can_tell:
        return None
    if DEPTHS[depth] != 1 and not _is_far_better(best, recording.fit(poses, AS_READ, has_steps=False)):
        return None
    return (poses, depth), best.share


def _is_far_better(fit: Fit, other: Fit) -> bool:
    return fit.share >= other.share + SMALLEST_LEAD and 1 - fit.share <= (1 - other.share) / 2


def _sentence(poses: str, depth: str, share: float, share_as_read: float, axes: str) -> str:
    said = [of[name] for of, name in ((SAID_OF_POSES, poses), (SAID_OF_DEPTH, depth)) if name != AS_READ]
    claims = ", and ".join([said[0][0], *(claim[0].lower() + claim[1:] for claim, _ in said[1:])]).format(axes=axes)
    fix = said[0][1] if len(said) == 1 else "with both put right they fit"
    return f"{claims}: {fix} {share:.0%} of the surfaces seen twice, as read {share_as_read:.0%}.".replace("%", " %")
