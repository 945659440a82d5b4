"""Frames as this phone delivers them, made of those that a perfect camera saw.

The effects that are on, in the order in which light and electronics meet them: rows are read while the camera moves;
the colour is exposed; the range sensor smooths over edges, errs, and finds no answer where too little comes back; its
numbers are cut and stepped; tracking adds a pose and the light sensor its reading.

Everything random comes from (seed, effect, frame number), and what has a memory (exposure, light sensor, drift) is a
function of the session's times, so a frame is the same bytes in any order and after a resume. Rejected: a camera that
remembers the frame before, which would make a resumed run another run.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from xihenet.camera import valid_plane_depth
from xihenet.invalid import added, counted
from xihenet.phone import depth
from xihenet.phone.depth_dropout import DepthDropout, SeenSurfaces, SurfaceFacts
from xihenet.phone.exposure import AutoExposure, FrameRate, expose, follow_exposure
from xihenet.phone.light_sensor import LightSensor, ambient_of_reading, follow_light, read_light
from xihenet.phone.motion import CameraMotion, PoseDrift, RollingShutter, drift_pose, read_rows
from xihenet.phone.profile import PhoneProfile
from xihenet.phone.settings import Section
from xihenet.records import ArrayF32, ArrayF64, RgbdFrame

SectionT = TypeVar("SectionT", bound=Section)
TrackedT = TypeVar("TrackedT")

DROPOUTS = ("dark_dropout", "transparent_dropout", "glossy_dropout", "grazing_dropout", "span_dropout")
"""In the order in which they are counted: a pixel that several take counts for the first."""

SEEDS = {"noise": 1, "pose_drift": 2, "light_sensor": 3, "light_sensor_gain": 4}
"""What tells the random numbers of one effect from another's. Never renumber: old seeds would give new sessions."""


@dataclass(frozen=True)
class SessionTrack:
    """What has a memory, for each frame number of a session; made by `PhoneCamera.follow`."""

    exposure: Mapping[int, float] = field(default_factory=dict)
    ambient: Mapping[int, ArrayF64] = field(default_factory=dict)


class PhoneCamera:
    """The device of `profile` with the `seed` (0 or more) of a session.

    `effects` are names of those to simulate; None takes all that the device has. ValueError for one that it has not.
    """

    def __init__(self, profile: PhoneProfile, seed: int, *, effects: Collection[str] | None = None) -> None:
        chosen = profile.effects if effects is None else frozenset(effects)
        missing = sorted(chosen - profile.effects)
        if missing:
            raise ValueError(f"{profile.name} has no {', '.join(missing)}; it has {', '.join(profile.sections)}")
        if seed < 0:
            raise ValueError(f"PhoneCamera: expected a seed of 0 or more, got {seed}")
        self.profile, self.seed, self.effects = profile, seed, chosen

    def settings(self, kind: type[SectionT]) -> SectionT | None:
        """Of an effect that is on, else None."""
        found = (self.profile.sections[effect] for effect in self.effects)
        return next((section for section in found if isinstance(section, kind)), None)

    def follow(
        self, frames: Sequence[int], times_s: Sequence[float], *, metered: Sequence[float], ambient: ArrayLike,
        reference: float,
    ) -> SessionTrack:  # fmt: skip
        """Exposure and light sensor over a session of N frames. A longer session has the same beginning.

        `frames` are their numbers; the rest is as in `follow_exposure`, and `ambient` (N, 3), linear scene radiance,
        is what each frame's light sensor would read at once.
        """
        exposure: dict[int, float] = {}
        light: dict[int, ArrayF64] = {}
        if auto_exposure := self.settings(AutoExposure):
            followed = follow_exposure(times_s, metered, reference=reference, settings=auto_exposure)
            exposure = dict(zip(frames, followed.tolist(), strict=True))
        if sensor := self.settings(LightSensor):
            light = dict(zip(frames, follow_light(times_s, ambient, sensor), strict=True))
        return SessionTrack(exposure, light)

    def see(
        self, frame: RgbdFrame, *, facts: SurfaceFacts | None = None, motion: CameraMotion | None = None,
        radiance: ArrayF32 | None = None, track: SessionTrack | None = None,
    ) -> tuple[RgbdFrame, dict[str, int]]:  # fmt: skip
        """What the phone delivers, `frame` itself if nothing changes it, and how many pixels each effect took away.

        Each pixel is counted once.

        Parameters
        ----------
        frame : as a perfect camera saw it
        facts : of the surfaces in it, as far as they are known
        motion : of the camera while it is read; None for a still one
        radiance : (H, W, 3) linear scene radiance, for an exact exposure; else the picture is decoded
        track : `follow` of the session; None leaves exposure and light as they are, without lag

        ValueError if `track` lacks the frame.
        """
        known = (facts or SurfaceFacts()).checked_for(frame.intrinsics)
        shutter = self.settings(RollingShutter)
        seen, source = read_rows(frame, motion, shutter)
        ranged, n_lost = frame, {}
        if source is not None and radiance is not None:
            radiance = radiance.reshape(-1, 3)[source]
        if source is not None and shutter is not None and shutter.reads_plane_depth:
            ranged, known = seen, known.taken_from(source)
            n_lost["rolling_shutter"] = max(_n_lost(frame.plane_depth_m, seen.plane_depth_m), 0)
        plane_depth_m, n_dropped = self._measured(ranged, known)
        if plane_depth_m is not seen.plane_depth_m:
            seen = replace(seen, plane_depth_m=plane_depth_m)
        if track is not None and self.settings(AutoExposure):
            seen = expose(seen, _tracked(track.exposure, seen.frame, "exposure"), radiance)
        seen = drift_pose(seen, self.settings(PoseDrift), [self.seed, SEEDS["pose_drift"]])
        n_lost |= n_dropped
        if any(n_lost.values()):
            # Rows read elsewhere may hold fewer invalid pixels than the capture: those it gives up come last.
            seen = replace(seen, invalid=added([counted(**n_lost), frame.invalid]))
        return self._with_light(seen, track), n_lost

    def _measured(self, frame: RgbdFrame, facts: SurfaceFacts) -> tuple[ArrayF32, dict[str, int]]:
        """The plane depth that the range sensor gives, and how many pixels each effect took, counted once."""
        z, scale = frame.plane_depth_m, self._pixel_scale(frame)
        if bleeding := self.settings(depth.EdgeBleeding):
            z = depth.bleed_edges(z, bleeding, pixel_scale=scale)
        if noise := self.settings(depth.DistanceNoise):
            z = depth.add_noise(z, noise, self._rng("noise", frame.frame), pixel_scale=scale)
        seen, n_lost = SeenSurfaces(frame, facts, z), {}
        for effect in DROPOUTS:
            section = self.profile.sections[effect] if effect in self.effects else None
            if isinstance(section, DepthDropout):
                before, z = z, depth.cleared(z, section.mask(seen))
                n_lost[effect] = _n_lost(before, z)
        if limits := self.settings(depth.RangeLimits):
            before, z = z, depth.cut_range(z, limits)
            n_lost["range"] = _n_lost(before, z)
        if steps := self.settings(depth.Quantisation):
            z = depth.quantise(z, steps)
        return z, n_lost

    def _with_light(self, frame: RgbdFrame, track: SessionTrack | None) -> RgbdFrame:
        sensor = self.settings(LightSensor)
        if sensor is None or frame.ambient is None:
            return frame
        light = frame.ambient if track is None else _tracked(track.ambient, frame.frame, "ambient light")
        device = np.random.default_rng([self.seed, SEEDS["light_sensor_gain"]])
        reading = read_light(light, sensor, device_rng=device, rng=self._rng("light_sensor", frame.frame))
        return replace(frame, ambient=ambient_of_reading(reading))

    def _pixel_scale(self, frame: RgbdFrame) -> float:
        """The picture's width over the range sensor's; 1 where the profile does not say."""
        section = self.profile.sections.get("frame_rate")
        return frame.intrinsics.width / section.width_px if isinstance(section, FrameRate) else 1.0

    def _rng(self, effect: str, frame: int) -> np.random.Generator:
        """Of one effect in one frame; frame numbers may be negative.

        NumPy pads seeds with 0, so that [a, b] is [a, b, 0]: what has no frame needs an effect number of its own.
        """
        return np.random.default_rng([self.seed, SEEDS[effect], 2 * frame if frame >= 0 else -2 * frame - 1])


def _tracked(values: Mapping[int, TrackedT], frame: int, what: str) -> TrackedT:
    if frame not in values:
        raise ValueError(f"PhoneCamera: the session's track has no {what} for frame {frame}; follow the whole session")
    return values[frame]


def _n_lost(before_m: ArrayF32, after_m: ArrayF32) -> int:
    """How many more pixels were valid before."""
    return int(np.count_nonzero(valid_plane_depth(before_m)) - np.count_nonzero(valid_plane_depth(after_m)))
