"""Motion, as a frame shows it: rows that are read one after the other, and a pose that is no longer quite true.

Rolling shutter: the rows of a picture are read from top to bottom; the middle one has the frame's pose. Chosen: each
pixel of the result looks up the rendered frame, through the plane depth, at the place that its row's camera saw
(gather, three fixed-point steps). Rejected: scattering the rendered pixels forward, which leaves cracks between rows
that look like dropout; and rendering every row, which costs a render per row. Near depth edges a pixel whose
surface was hidden from the middle row shows its neighbour instead.

Pose drift: tracking walks away at random in position and in yaw; gravity holds pitch and roll. The walk is a function
of seed and time alone, so frames can be asked for in any order. Not here: jumps when tracking recognises a place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from xihenet.camera import pixel_rays, valid_plane_depth
from xihenet.phone.settings import Required, Section, SessionFacts, known, number, switch
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt, RgbdFrame

DRIFT_STEP_S = 0.05  # grid of the random walk; between its nodes the drift is a straight line
LONGEST_WALK_S = 1e6  # Twelve days, of 20 million steps; times since 1970 would take a terabyte
N_FIXED_POINT_STEPS = 3

SMALL_SHIFT_PX = 0.5  # rows that are off by less than this show the same pixels


@dataclass(frozen=True, kw_only=True)
class RollingShutter(Section):
    """The time from the first row to the last, and whether plane depth is read with the colour."""

    readout_s: float = number("s", 0.0, 1.0)
    reads_plane_depth: bool = switch()

    def required_by(self, facts: SessionFacts) -> Required:
        """A camera that moves while the rows are read, by more than SMALL_SHIFT_PX at the nearest surface."""
        if facts.is_still:
            return False, "the camera does not move"
        what = "how fast the camera moves past the nearest surface"
        speed, turn = known(facts.fastest_m_per_s, what), known(facts.fastest_turn_deg_per_s, what)
        focal_px, nearest_m = known(facts.focal_px, what), known(facts.nearest_m or None, what)
        shift_px = 0.5 * self.readout_s * focal_px * (math.radians(turn) + speed / nearest_m)
        if shift_px > SMALL_SHIFT_PX:
            return True, f"while one picture is read the camera moves by up to {shift_px:.1f} pixels"
        return False, f"while one picture is read the camera moves by {shift_px:.2f} pixels at most"


@dataclass(frozen=True, kw_only=True)
class PoseDrift(Section):
    """Root mean square of the walk after one second; it grows with the square root of time."""

    position_m_per_sqrt_s: float = number("m per square root of s", 0.0, 10.0)
    yaw_deg_per_sqrt_s: float = number("degrees per square root of s", 0.0, 90.0)

    def required_by(self, facts: SessionFacts) -> Required:
        if facts.is_still:
            return False, "the camera does not move"
        duration_s = known(facts.duration_s, "how long the session is")
        walked = 2 * math.sqrt(duration_s)
        turned_deg = self.yaw_deg_per_sqrt_s * walked
        if math.radians(self.yaw_deg_per_sqrt_s) * walked > facts.small_angle:
            return True, f"within {duration_s:.0f} s tracking turns away by up to {turned_deg:.1f} degrees"
        return facts.moves_points(self.position_m_per_sqrt_s * walked, "tracking")


@dataclass(frozen=True, eq=False)
class CameraMotion:
    """How the camera moves while a frame is read: both (3,) in the world; the turn about its axis, right-handed."""

    velocity_m_per_s: ArrayF64
    turn_rad_per_s: ArrayF64

    def __post_init__(self) -> None:
        for name, vector in tuple(vars(self).items()):
            object.__setattr__(self, name, np.asarray(vector, np.float64).reshape(3))

    @property
    def is_still(self) -> bool:
        return not (np.any(self.velocity_m_per_s) or np.any(self.turn_rad_per_s))


def motion_between(world_from_camera: ArrayLike, later: ArrayLike, elapsed_s: float) -> CameraMotion:
    """The even motion that takes one rigid pose (4, 4) to a later one. ValueError without time, or for half a turn."""
    if not elapsed_s > 0:
        raise ValueError(f"motion_between: expected some time between two poses, got {elapsed_s} s")
    before, after = np.asarray(world_from_camera, np.float64), np.asarray(later, np.float64)
    angle, twice_sine = turn_between(before, after)
    if angle > np.radians(177):
        raise ValueError("motion_between: a turn by half a circle has no direction; give poses that lie closer")
    length = float(np.linalg.norm(twice_sine))
    axis = twice_sine / length if length > 0 else np.zeros(3)
    return CameraMotion((after[:3, 3] - before[:3, 3]) / elapsed_s, axis * (angle / elapsed_s))


def turn_between(before: ArrayF64, after: ArrayF64) -> tuple[float, ArrayF64]:
    """Angle in radians, 0 to pi, between two rigid poses (4, 4), and its axis times twice the angle's sine, world."""
    turn = after[:3, :3] @ before[:3, :3].T
    twice_sine = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return float(np.arctan2(np.linalg.norm(twice_sine), np.trace(turn) - 1)), twice_sine


def row_poses(world_from_camera: ArrayLike, motion: CameraMotion, n_rows: int, readout_s: float) -> ArrayF64:
    """(n_rows, 4, 4) the pose at which each row is read; the middle of the picture has `world_from_camera`."""
    pose = np.asarray(world_from_camera, np.float64)
    after_s = ((np.arange(n_rows) + 0.5) / n_rows - 0.5) * readout_s
    poses = np.broadcast_to(pose, (n_rows, 4, 4)).copy()
    poses[:, :3, :3] = turns_by(motion.turn_rad_per_s, after_s) @ pose[:3, :3]
    poses[:, :3, 3] += after_s[:, None] * motion.velocity_m_per_s
    return poses


def read_rows(
    frame: RgbdFrame, motion: CameraMotion | None, settings: RollingShutter | None
) -> tuple[RgbdFrame, ArrayInt | None]:
    """The frame as it is read row by row, and for each pixel (H, W) the place in row order that it shows.

    A still camera, or no shutter, gives the frame itself and None. Where a row saw beyond the rendered picture, the
    nearest pixel's colour is repeated and the plane depth is 0. The camera's pose must be rigid.
    """
    if settings is None or motion is None or motion.is_still or settings.readout_s == 0:
        return frame, None
    rotation, offset = _frame_from_rows(frame, motion, settings.readout_s)
    source, plane_depth_m, is_inside = _looked_up(frame, rotation, offset)
    colour = frame.srgb_u8.reshape(-1, 3)[source]
    if not settings.reads_plane_depth:
        return replace(frame, srgb_u8=colour), source
    return replace(frame, srgb_u8=colour, plane_depth_m=np.where(is_inside, plane_depth_m, np.float32(0))), source


def drift_at(time_s: float, settings: PoseDrift, seed: int | Sequence[int]) -> tuple[ArrayF64, float]:
    """Position error (3,) in metres and yaw error in radians, by seed and time alone; none at and before the start.

    ValueError from LONGEST_WALK_S on.
    """
    if not time_s > 0:
        return np.zeros(3), 0.0
    if time_s >= LONGEST_WALK_S:
        raise ValueError(f"drift_at: expected seconds since the start of the session, got {time_s:g}: count from there")
    place = time_s / DRIFT_STEP_S
    n_steps = int(place) + 1
    steps = np.random.default_rng(seed).normal(size=(n_steps, 4))
    walked = steps[:-1].sum(axis=0) + (place - (n_steps - 1)) * steps[-1]
    walked *= np.sqrt(DRIFT_STEP_S)
    yaw = float(walked[3] * np.radians(settings.yaw_deg_per_sqrt_s))
    return walked[:3] * (settings.position_m_per_sqrt_s / np.sqrt(3)), yaw


def drift_pose(frame: RgbdFrame, settings: PoseDrift | None, seed: int | Sequence[int]) -> RgbdFrame:
    """The frame with the pose that tracking believes; its picture is still what the true pose saw."""
    if settings is None:
        return frame
    offset_m, yaw = drift_at(frame.time_s, settings, seed)
    if yaw == 0 and not offset_m.any():
        return frame
    pose = frame.world_from_camera.copy()
    pose[:3, :3] = turns_by(np.array([0.0, 0.0, yaw]), np.ones(1))[0] @ pose[:3, :3]
    pose[:3, 3] += offset_m
    return replace(frame, world_from_camera=pose)


def turns_by(turn: ArrayF64, shares: ArrayF64) -> ArrayF64:
    """(N, 3, 3) rotations by `turn` (axis times angle) times each share (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    if angle == 0:
        return np.broadcast_to(np.eye(3), (len(shares), 3, 3))
    x, y, z = np.asarray(turn, np.float64) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, rest = np.sin(angle * shares)[:, None, None], (1 - np.cos(angle * shares))[:, None, None]
    return np.eye(3) + sine * cross + rest * (cross @ cross)


def _frame_from_rows(frame: RgbdFrame, motion: CameraMotion, readout_s: float) -> tuple[ArrayF64, ArrayF64]:
    """Rotation (H, 3, 3) and offset (H, 3) from each row's camera to the frame's."""
    poses = row_poses(frame.world_from_camera, motion, frame.intrinsics.height, readout_s)
    camera_from_world = frame.world_from_camera[:3, :3].T
    offset = (poses[:, :3, 3] - frame.world_from_camera[:3, 3]) @ camera_from_world.T
    return camera_from_world @ poses[:, :3, :3], offset


def _looked_up(frame: RgbdFrame, rotation: ArrayF64, offset: ArrayF64) -> tuple[ArrayInt, ArrayF32, ArrayBool]:
    """For each pixel: which rendered pixel its row saw, that point's plane depth for the row, and whether it is inside.

    A rendered pixel without a valid plane depth keeps its value, and is taken to be as far as the middle of the rest.
    """
    k, z = frame.intrinsics, frame.plane_depth_m.ravel()
    valid = valid_plane_depth(z)
    assumed = np.where(valid, z, np.median(z[valid]) if valid.any() else np.float32(1)).astype(np.float64)
    rays = pixel_rays(k)
    flat_rays, row_z = rays.reshape(-1, 3), assumed.reshape(k.height, k.width)
    for _ in range(N_FIXED_POINT_STEPS):
        seen = np.einsum("hij,hwj->hwi", rotation, rays * row_z[..., None]) + offset[:, None]
        ahead = np.maximum(-seen[..., 2], 1e-6)
        column = np.floor(k.cx + k.fx * seen[..., 0] / ahead)
        row = np.floor(k.cy - k.fy * seen[..., 1] / ahead)
        inside = (column >= 0) & (column < k.width) & (row >= 0) & (row < k.height) & (seen[..., 2] < 0)
        column, row = np.clip(column, 0, k.width - 1), np.clip(row, 0, k.height - 1)
        source = (row * k.width + column).astype(np.intp)
        points = flat_rays[source] * assumed[source][..., None] - offset[:, None]
        row_z = np.maximum(-np.einsum("hi,hwi->hw", rotation[:, :, 2], points), 1e-6)
    return source, np.where(valid[source], row_z.astype(np.float32), z[source]), inside
