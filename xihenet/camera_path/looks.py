"""Looks: how a phone may turn away from its path for a second, and back.

A turn starts and ends softly and takes the shortest way. Frames are captured on the way there and of what is looked at;
the way back sees nothing new. Chosen: level views, as a hand holds a phone, whatever the path's own tilt.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from xihenet.camera_path.placement import evenly_chosen
from xihenet.phone.motion import turns_by
from xihenet.records import ArrayF64

PITCHES_DEG = (-40.0, 0.0, 40.0, 75.0)
YAW_STEP_DEG = 30.0


@dataclass(frozen=True)
class LookSettings:
    """How the phone may look away from its path.

    Parameters
    ----------
    hold_s : seconds for which it looks at what it has turned to
    largest_turn_deg : from the path's own view, in any direction
    turn_deg_per_s : mean speed of the turn, which starts and ends softly and is half as fast again in its middle
    frame_step_deg : between two captured frames of the turn
    most_frames : of the path at which looks are tried
    """

    hold_s: float = 1.0
    largest_turn_deg: float = 90.0
    turn_deg_per_s: float = 75.0
    frame_step_deg: float = 30.0
    most_frames: int = 8

    def __post_init__(self) -> None:
        for name in ("hold_s", "turn_deg_per_s", "frame_step_deg"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"LookSettings.{name}: expected a positive number, got {getattr(self, name)}")
        if not 0 < self.largest_turn_deg <= 180:
            raise ValueError(f"LookSettings.largest_turn_deg: expected up to 180 degrees, got {self.largest_turn_deg}")
        if self.most_frames < 1:
            raise ValueError(f"LookSettings.most_frames: expected at least 1, got {self.most_frames}")


@dataclass(frozen=True, eq=False)
class Look:
    """A turn away from the path.

    Parameters
    ----------
    frame : of the path, at which the phone turns
    yaw_deg : to the left about the vertical, from the heading of the path
    pitch_deg : above the horizon, where the phone looks then
    start, end : (4, 4) world_from_camera of the path's view and of what is looked at; they share their place
    """

    frame: int
    yaw_deg: float
    pitch_deg: float
    start: ArrayF64
    end: ArrayF64

    @property
    def turn_deg(self) -> float:
        """Degrees between the first view and the last, by whichever axis is shortest."""
        return math.degrees(float(np.linalg.norm(_rotation_vector(self.start[:3, :3], self.end[:3, :3]))))

    def turn_s(self, settings: LookSettings) -> float:
        """Seconds that turning there takes."""
        return self.turn_deg / settings.turn_deg_per_s

    def pose(self, share: float) -> ArrayF64:
        """(4, 4) world_from_camera where `share` of the turn is done, 0 to 1."""
        turned = self.start.copy()
        whole = _rotation_vector(self.start[:3, :3], self.end[:3, :3])
        turned[:3, :3] = self.start[:3, :3] @ turns_by(whole, np.array([share]))[0]
        return turned

    def poses(self, settings: LookSettings) -> list[ArrayF64]:
        """World_from_camera of the frames that are captured: on the turn, and of what is looked at, which is last."""
        n = math.ceil(self.turn_deg / settings.frame_step_deg)
        return [self.pose(k / n) for k in range(1, n)] + [self.end]

    @property
    def words(self) -> str:
        """Where to look, such as "up left", as someone says who stands beside the phone."""
        return direction_words(self.yaw_deg, self.pitch_deg, self.start)


def direction_words(yaw_deg: float, pitch_deg: float, start: ArrayF64) -> str:
    """Such as "up left" or "straight up", seen from the view `start`, (4, 4) world_from_camera."""
    if pitch_deg >= 60:
        return "straight up"
    rise = pitch_deg - pitch_of(start)
    upright = "up" if rise > 15 else "down" if rise < -15 else ""
    side = "" if abs(yaw_deg) < 20 else "back" if abs(yaw_deg) > 135 else "left" if yaw_deg > 0 else "right"
    return " ".join(filter(None, (upright, side))) or "ahead"


def pitch_of(world_from_camera: ArrayF64) -> float:
    """Degrees above the horizon at which a camera looks."""
    return math.degrees(math.asin(float(np.clip(-world_from_camera[2, 2], -1, 1))))


# ---------------------------------------------------------------------------------------------------- looks to be tried


def turned_view(world_from_camera: ArrayF64, yaw_deg: float, pitch_deg: float) -> ArrayF64:
    """(4, 4) of a level camera at the same place: its heading `yaw_deg` to the left, `pitch_deg` above the horizon.

    A camera that looks straight up or down has as heading the direction of its upper edge, or away from it.
    """
    ahead = -world_from_camera[:3, 2]
    if np.hypot(*ahead[:2]) < 1e-6:
        ahead = -np.sign(ahead[2]) * world_from_camera[:3, 1]
    heading, pitch = math.atan2(ahead[1], ahead[0]) + math.radians(yaw_deg), math.radians(pitch_deg)
    level = np.array([math.cos(heading), math.sin(heading), 0.0])
    vertical = np.array([0.0, 0.0, 1.0])
    forwards = math.cos(pitch) * level + math.sin(pitch) * vertical
    upwards = math.cos(pitch) * vertical - math.sin(pitch) * level
    turned = np.eye(4)
    turned[:3, :3] = np.stack([np.cross(forwards, upwards), upwards, -forwards], axis=1)
    turned[:3, 3] = world_from_camera[:3, 3]
    return turned


def looks_of(path: Sequence[tuple[int, ArrayF64]], settings: LookSettings) -> list[Look]:
    """The looks that are tried: at frames evenly spread over the path, (number, world_from_camera) each."""
    chosen = evenly_chosen(path, settings.most_frames)
    return [look for frame, pose in chosen for look in _looks_at(frame, pose, settings)]


def _looks_at(frame: int, pose: ArrayF64, settings: LookSettings) -> Iterator[Look]:
    n = int(settings.largest_turn_deg // YAW_STEP_DEG)
    for pitch_deg in PITCHES_DEG:
        for k in range(-n, n + 1):
            yaw_deg = k * YAW_STEP_DEG
            look = Look(frame, yaw_deg, pitch_deg, pose, turned_view(pose, yaw_deg, pitch_deg))
            if look.turn_deg <= settings.largest_turn_deg + 1e-6:
                yield look


def random_looks(
    path: Sequence[tuple[int, ArrayF64]], n: int, rng: np.random.Generator, settings: LookSettings
) -> list[Look]:
    """`n` looks at random frames of the path, each into a direction that is evenly spread over those within reach."""
    found: list[Look] = []
    while len(found) < n:
        frame, pose = path[int(rng.integers(len(path)))]
        yaw_deg, pitch_deg = float(rng.uniform(-180, 180)), math.degrees(math.asin(float(rng.uniform(-1, 1))))
        look = Look(frame, yaw_deg, pitch_deg, pose, turned_view(pose, yaw_deg, pitch_deg))
        if look.turn_deg <= settings.largest_turn_deg:
            found.append(look)
    return found


# ------------------------------------------------------------------------------------------------------------ rotations


def _rotation_vector(first: ArrayF64, last: ArrayF64) -> ArrayF64:
    """(3,) axis times angle in radians, in the axes of `first`, of the turn from one (3, 3) rotation to another."""
    turn = first.T @ last
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    sine, cosine = float(np.linalg.norm(axis)), (float(np.trace(turn)) - 1) / 2
    if sine > 1e-9:
        return axis / sine * math.atan2(sine, cosine)
    if cosine > 0:
        return np.zeros(3)
    return np.linalg.svd(turn + np.eye(3))[0][:, 0] * math.pi
