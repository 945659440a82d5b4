"""Was a recording read with the right conventions? Its own surfaces tell: what is seen twice must lie in one place.

Files do not say whether poses are camera to world, along which axis the camera looks, or in which unit depth is. Read
wrongly, everything still runs and gives a light that looks right. Here the points of each frame are projected into the
others, as read and under each other convention, and the share of them that lie where the other frame measured a surface
is compared.

A convention is accused only if another one fits better by far, and if the walk could tell the two apart: a phone that
only pitches looks the same with either camera axes, and one that only turns in place fits every scale of depth. A scale
must therefore explain parallax, which is to fit better than the same turns do without any steps. Chosen: depth alone.
Rejected: colour as well, which drifts with the phone's exposure and agrees by chance on plain walls. Not here: which way
is up, errors of intrinsics, a scale of the poses (it looks like one of depth), and a depth of another unit than a power
of ten.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from xihenet.camera import pixel_rays
from xihenet.captures.seen_again import away_from_edges, pixels_of_points, thinned
from xihenet.frame_files import BLENDER_FROM_OPENCV_CAMERA
from xihenet.records import ArrayF64, ArrayInt, Intrinsics, RgbdFrame

MOST_FRAMES = 24  # Of the recording, evenly over it: 276 pairs tell more than enough
MOST_POINTS = 120  # Of each of them
AGREEING = 0.05  # Share of the measured plane depth by which a point may miss it: noise of 1 %, and half a pixel aslant
SMALLEST_TURN = np.radians(10)  # Two frames are compared from here on, or from SMALLEST_STEP_M on: others always agree
SMALLEST_STEP_M = 0.15
FEWEST_POINTS = 300  # That fell on a measured surface, of all pairs
FEWEST_PAIRS = 3  # With at least FEWEST_OF_PAIR of them each
FEWEST_OF_PAIR = 20
SMALLEST_SHARE = 0.6  # Less is no good fit, whatever the others are: wrong conventions agree on 10 to 70 % by chance
SMALLEST_LEAD = 0.15  # Over the recording as read, which must be left at least this much, and disagree twice as often
AT_MOST_OF_TWO_MISTAKES = 0.5  # What agrees more often as read has no two of them
LEAD_OVER_NEXT = 0.05  # Over all other conventions: two that fit as well cannot be told apart

AS_READ = "as read"
POSES = (AS_READ, "camera axes", "transposed", "inverse", "inverse, camera axes")
DEPTHS = {AS_READ: 1.0, "10 x": 10.0, "0.1 x": 0.1, "1000 x": 1000.0, "0.001 x": 0.001, "ray distance": 1.0}
"""By how many times depth is too large; distances along rays are made plane depths instead."""

AXES = ("along -Z with +Y up", "along +Z with +Y down")
SAID_OF_POSES = {
    "camera axes": ("The cameras seem to look {axes}", "turned so they fit"),
    "transposed": ("The rotations of the poses look transposed", "transposed again they fit"),
    "inverse": ("The poses look like camera-from-world", "their inverse fits"),
    "inverse, camera axes": ("The poses look like camera-from-world of cameras that look {axes}", "their inverse fits"),
}
SAID_OF_DEPTH = {
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


@dataclass(frozen=True)
class Fit:
    """How well a recording fits itself: of `n_points` that fell on a measured surface, the share that lies on it."""

    n_points: int
    n_pairs: int
    share: float

    @property
    def can_tell(self) -> bool:
        return self.n_points >= FEWEST_POINTS and self.n_pairs >= FEWEST_PAIRS


@dataclass(frozen=True, eq=False)
class _View:
    """What is kept of a frame."""

    intrinsics: Intrinsics
    pose: ArrayF64  # (4, 4) in the file's world, with the camera's axes as they were read
    plane_depth_m: ArrayF64  # (H * W,), NaN where there is none, or an edge
    rays: ArrayF64  # (H * W, 3) in the camera, at plane depth 1
    lengths: ArrayF64  # (H * W,) of these
    picked: ArrayInt  # (K,) pixels whose points are compared


def suspect(
    frames: Iterable[RgbdFrame], *, blender_from_file: ArrayF64 | None = None, is_opencv: bool = False
) -> Suspected | None:
    """The convention that a recording seems to hold instead of that under which it was read.

    None if it was read rightly, and where nobody can say: no frame at all, none with a depth, frames that share no
    surface, a camera that hardly moves, or two conventions that fit alike. Two mistakes at once, of the poses and of the
    depth, are looked for only where no single one explains the recording. ValueError for a pose that cannot be inverted.

    Parameters
    ----------
    frames : in any number; at most MOST_FRAMES of them are kept, as plane depth alone
    blender_from_file : (3, 3) that was put before the poses of the file to turn its world upright; None for nothing
    is_opencv : whether the camera's axes were turned from OpenCV's when the poses were read
    """
    recording = _Recording(frames, blender_from_file, is_opencv)
    as_read = recording.fit(AS_READ, AS_READ)
    if as_read.can_tell and as_read.share > 1 - SMALLEST_LEAD:
        return None
    single = [(poses, AS_READ) for poses in POSES[1:]] + [(AS_READ, depth) for depth in DEPTHS if depth != AS_READ]
    double = [(poses, depth) for poses in POSES[1:] for depth in DEPTHS if depth != AS_READ]
    for asked in (single, double) if as_read.share < AT_MOST_OF_TWO_MISTAKES else (single,):
        found = _best(recording, asked, as_read)
        if found is not None:
            (poses, depth), share = found
            sentence = _sentence(poses, depth, share, as_read.share, AXES[0 if is_opencv else 1])
            return Suspected(poses, depth, share, as_read.share, sentence)
    return None


def _best(
    recording: _Recording, asked: list[tuple[str, str]], as_read: Fit
) -> tuple[tuple[str, str], float] | None:
    """Which of these conventions fits better by far than the recording as read, and how well; None if none does."""
    every = {one: fit for one in asked if (fit := recording.fit(*one)).can_tell}
    if not every:
        return None
    (poses, depth), best = max(every.items(), key=lambda one: one[1].share)
    others = [as_read.share, *(fit.share for one, fit in every.items() if one != (poses, depth))]
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


def fits(
    frames: Iterable[RgbdFrame], *, blender_from_file: ArrayF64 | None = None, is_opencv: bool = False
) -> Mapping[tuple[str, str], Fit]:
    """How well a recording fits itself under each convention of POSES with each of DEPTHS; for `suspect` and people.

    Parameters as of `suspect`.
    """
    recording = _Recording(frames, blender_from_file, is_opencv)
    return {(poses, depth): recording.fit(poses, depth) for poses in POSES for depth in DEPTHS}


class _Recording:
    """Views of a recording, of which each can be compared with the others under any convention."""

    def __init__(self, frames: Iterable[RgbdFrame], blender_from_file: ArrayF64 | None, is_opencv: bool) -> None:
        file_from_blender = np.eye(4)
        if blender_from_file is not None:
            file_from_blender[:3, :3] = np.asarray(blender_from_file, np.float64).T
        self.views = _spread_views(frames, file_from_blender)
        self.read_axes = BLENDER_FROM_OPENCV_CAMERA if is_opencv else np.eye(4)
        self.compared = _far_enough_apart([view.pose for view in self.views])

    def fit(self, poses: str, depth: str, *, has_steps: bool = True) -> Fit:
        """Under one convention; without steps all cameras are in one place, turned as they were."""
        cameras = [_corrected(view.pose @ self.read_axes, poses) @ self.read_axes for view in self.views]
        if poses.endswith("camera axes"):
            cameras = [camera @ BLENDER_FROM_OPENCV_CAMERA for camera in cameras]
        if not has_steps:
            for camera in cameras:
                camera[:3, 3] = 0
        depths = [_corrected_depth(view, depth) for view in self.views]
        clouds = [
            (view.rays[view.picked] * depth_m[view.picked, None]) @ camera[:3, :3].T + camera[:3, 3]
            for view, depth_m, camera in zip(self.views, depths, cameras, strict=True)
        ]
        n_points = n_pairs = n_agreeing = 0
        for number, (view, camera, depth_m) in enumerate(zip(self.views, cameras, depths, strict=True)):
            others = np.flatnonzero(self.compared[number])
            if not len(others):
                continue
            owner = np.repeat(others, [len(clouds[i]) for i in others])
            points, pixels, expected_m = pixels_of_points(
                np.concatenate([clouds[i] for i in others]), view.intrinsics, camera
            )
            is_known = np.isfinite(depth_m[pixels])
            measured_m, expected_m = depth_m[pixels][is_known], expected_m[is_known]
            n_of_each = np.bincount(owner[points][is_known], minlength=len(clouds))
            n_pairs += int(np.count_nonzero(n_of_each >= FEWEST_OF_PAIR))
            n_points += len(measured_m)
            n_agreeing += int(np.count_nonzero(np.abs(expected_m - measured_m) < AGREEING * measured_m))
        return Fit(n_points, n_pairs, n_agreeing / max(n_points, 1))


def _spread_views(frames: Iterable[RgbdFrame], file_from_blender: ArrayF64) -> list[_View]:
    """At most MOST_FRAMES, evenly over a recording whose length shows only at its end."""
    views: list[_View] = []
    every = 1
    for number, frame in enumerate(frames):
        if number % every:
            continue
        view = _view(frame, file_from_blender)
        if len(view.picked):
            views.append(view)
        if len(views) > MOST_FRAMES:
            views, every = views[::2], 2 * every
    return views


def _view(frame: RgbdFrame, file_from_blender: ArrayF64) -> _View:
    is_used = away_from_edges(frame.plane_depth_m)
    rays = pixel_rays(frame.intrinsics).reshape(-1, 3)
    return _View(
        frame.intrinsics,
        file_from_blender @ frame.world_from_camera,
        np.where(is_used, frame.plane_depth_m, np.nan).astype(np.float64).ravel(),
        rays,
        np.linalg.norm(rays, axis=1),
        thinned(np.flatnonzero(is_used), MOST_POINTS),
    )


def _far_enough_apart(poses: list[ArrayF64]) -> ArrayF64:
    """(N, N) bool; the angle between two cameras is the same under every convention."""
    if not poses:
        return np.zeros((0, 0), bool)
    stacked = np.stack(poses)
    axes, places = stacked[:, :3, :3], stacked[:, :3, 3]
    cosine = (np.einsum("aij,bij->ab", axes, axes) - 1) / 2
    steps = np.linalg.norm(places[:, None] - places, axis=-1)
    return (cosine < np.cos(SMALLEST_TURN)) | (steps > SMALLEST_STEP_M)


def _corrected(pose: ArrayF64, poses: str) -> ArrayF64:
    pose = pose.copy()
    if poses.startswith(("transposed", "inverse")):
        pose[:3, :3] = pose[:3, :3].T.copy()
    if poses.startswith("inverse"):
        pose[:3, 3] = -pose[:3, :3] @ pose[:3, 3]
    return pose


def _corrected_depth(view: _View, depth: str) -> ArrayF64:
    if depth == "ray distance":
        return view.plane_depth_m / view.lengths
    return view.plane_depth_m / DEPTHS[depth]
