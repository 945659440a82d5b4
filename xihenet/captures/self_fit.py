"""The fit of a recording with itself, under the conventions as read and under others.

Points of each frame are projected into the others; those that fall on a measured surface should lie on it. Compared are
frames that are turned or moved against each other: others agree under any convention. Everything is kept as thin as the
answer allows: the plane depth of a few frames, and no colours.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from xihenet.camera import pixel_rays, pixels_in_view
from xihenet.captures.reading.values import quaternion_of, rotation_of
from xihenet.captures.seen_again import away_from_edges, thinned
from xihenet.io.frame_files import BLENDER_FROM_OPENCV_CAMERA
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt, Intrinsics, RgbdFrame

MOST_FRAMES = 24  # Of the recording, evenly over it: 276 pairs tell more than enough
MOST_POINTS = 120  # Of each of them
AGREEING = 0.05  # Share of the measured plane depth by which a point may miss it: noise of 1 %, and half a pixel aslant
SMALLEST_TURN = np.radians(10)  # Two frames are compared from here on, or from SMALLEST_STEP_M on: others always agree
SMALLEST_STEP_M = 0.15
FEWEST_POINTS = 300  # That fell on a measured surface, of all pairs
FEWEST_PAIRS = 3  # With at least FEWEST_OF_PAIR of them each
FEWEST_OF_PAIR = 20

AS_READ = "as read"
MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
QUARTER = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])  # To the left, about the optical axis
TURNED = {"turned right": QUARTER, "turned left": QUARTER.T, "upside down": QUARTER @ QUARTER}
"""What poses lack where pictures were turned so, as phones show them upright, and the poses are of the sensor."""

POSES = (AS_READ, "camera axes", "transposed", "inverse", "inverse, camera axes", "w first", "left-handed", *TURNED)
DEPTHS = {
    AS_READ: 1.0,
    "5 x": 5.0,
    "0.2 x": 0.2,
    "10 x": 10.0,
    "0.1 x": 0.1,
    "1000 x": 1000.0,
    "0.001 x": 0.001,
    "ray distance": 1.0,
}
"""By how many times depth is too large; distances along rays are made plane depths instead. 5: TUM's, of 0.2 mm."""


@dataclass(frozen=True)
class Fit:
    """How well a recording fits itself: of `n_points` that fell on a measured surface, the share that lies on it.

    `n_pairs` frames in pairs of at least FEWEST_OF_PAIR such points; 0 of all where nothing is seen twice.
    """

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
    plane_depth_m: ArrayF32  # (H * W,) as it was read, NaN where there is none, or an edge
    picked: ArrayInt  # (K,) pixels whose points are compared
    rays: ArrayF64  # (K, 3) through these, in the camera, at plane depth 1


class Recording:
    """Views of a recording, of which each can be compared with the others under any convention."""

    def __init__(self, frames: Iterable[RgbdFrame], blender_from_file: ArrayF64 | None, is_opencv: bool) -> None:
        file_from_blender = np.eye(4)
        if blender_from_file is not None:
            file_from_blender[:3, :3] = np.asarray(blender_from_file, np.float64).T
        self.views = _spread_views(frames, file_from_blender)
        self.read_axes = BLENDER_FROM_OPENCV_CAMERA if is_opencv else np.eye(4)
        self.alike: dict[Intrinsics, list[int]] = {}
        for number, view in enumerate(self.views):
            self.alike.setdefault(view.intrinsics, []).append(number)
        self.compared = _far_enough_apart([view.pose for view in self.views])

    def fit(self, poses: str, depth: str, *, has_steps: bool = True) -> Fit:
        """Under one convention; without steps all cameras are in one place, turned as they were."""
        cameras = [_corrected(view.pose @ self.read_axes, poses) @ self.read_axes for view in self.views]
        if poses.endswith("camera axes"):
            cameras = [camera @ BLENDER_FROM_OPENCV_CAMERA for camera in cameras]
        if poses in TURNED:
            cameras = [camera @ TURNED[poses] for camera in cameras]
        if poses == "left-handed":  # x right, y up, z forward, whatever was said of the camera
            cameras = [MIRROR @ view.pose @ self.read_axes @ MIRROR for view in self.views]
        if not has_steps:
            for camera in cameras:
                camera[:3, 3] = 0
        clouds = [
            (view.rays * _corrected_depth(view, view.picked, depth)[:, None]) @ camera[:3, :3].T + camera[:3, 3]
            for view, camera in zip(self.views, cameras, strict=True)
        ]
        n_pairs, expected_m, measured_m = 0, [np.zeros(0)], [np.zeros(0)]
        for intrinsics, numbers in self.alike.items():
            # All that these cameras are asked for, in the axes of each: one projection instead of one for each.
            asked = [(i, of) for i in numbers for of in np.flatnonzero(self.compared[i])]
            in_camera = [(clouds[of] - cameras[i][:3, 3]) @ cameras[i][:3, :3] for i, of in asked]
            if not asked:
                continue
            pair = np.repeat(np.arange(len(asked)), [len(points) for points in in_camera])
            points, pixels, depth_m = pixels_in_view(np.concatenate(in_camera), intrinsics, np.eye(4))
            camera_of = np.array([i for i, _ in asked])[pair[points]]
            measured = np.empty(len(points))
            for i in numbers:
                measured[camera_of == i] = _corrected_depth(self.views[i], pixels[camera_of == i], depth)
            is_known = np.isfinite(measured)
            n_pairs += int(np.count_nonzero(np.bincount(pair[points][is_known]) >= FEWEST_OF_PAIR))
            expected_m.append(depth_m[is_known])
            measured_m.append(measured[is_known])
        expected, measured = np.concatenate(expected_m), np.concatenate(measured_m)
        is_agreeing = np.abs(expected - measured) < AGREEING * measured
        return Fit(len(measured), n_pairs, float(is_agreeing.mean()) if len(measured) else 0.0)


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
    picked = thinned(np.flatnonzero(is_used), MOST_POINTS)
    return _View(
        frame.intrinsics,
        file_from_blender @ frame.world_from_camera,
        np.where(is_used, frame.plane_depth_m, np.float32(np.nan)).ravel(),
        picked,
        pixel_rays(frame.intrinsics).reshape(-1, 3)[picked],
    )


def _far_enough_apart(poses: list[ArrayF64]) -> ArrayBool:
    """(N, N) bool; the angle between two cameras is the same under every convention but that of quaternions."""
    if not poses:
        return np.zeros((0, 0), bool)
    stacked = np.stack(poses)
    axes, places = stacked[:, :3, :3], stacked[:, :3, 3]
    cosine = (np.einsum("aij,bij->ab", axes, axes) - 1) / 2
    steps = np.linalg.norm(places[:, None] - places, axis=-1)
    return (cosine < np.cos(SMALLEST_TURN)) | (steps > SMALLEST_STEP_M)


def _corrected(pose: ArrayF64, poses: str) -> ArrayF64:
    """(4, 4) camera to world, if the pose of the file holds what `poses` says; the camera's axes are as they were."""
    pose = pose.copy()
    if poses.startswith(("transposed", "inverse")):
        pose[:3, :3] = pose[:3, :3].T.copy()
    if poses == "w first":
        pose[:3, :3] = rotation_of(np.roll(quaternion_of(pose[:3, :3]), -1))
    if poses.startswith("inverse"):
        pose[:3, 3] = -pose[:3, :3] @ pose[:3, 3]
    return pose


def _corrected_depth(view: _View, pixels: ArrayInt, depth: str) -> ArrayF64:
    """(K,) plane depth of pixels (K,), metres, if the view's holds what `depth` says."""
    read = view.plane_depth_m[pixels].astype(np.float64)
    if depth == "ray distance":
        lengths: ArrayF64 = np.linalg.norm(pixel_rays(view.intrinsics).reshape(-1, 3)[pixels], axis=1)
        return read / lengths
    return read / DEPTHS[depth]
