"""The phone of a run: what it asks of perfect captures, which of its effects are simulated, and what it makes of them.

Captures are rendered first, the whole path, and kept as they are; from them come the facts by which effects are
planned, and then the phone's own frames. So nothing is rendered for the phone, an effect is left out only on the
evidence of every captured frame, and a run that is resumed gets the same bytes. Rejected: facts from small previews,
which miss what is small, and keeping the phone's frames, since the report also shows them without one effect.

    choose_phone -> ChosenPhone -> facts_of_capture, each frame -> simulate_phone -> SimulatedPhone.see

Where nothing is captured while no virtual object is in view, exposure and light sensor know nothing of it. The perfect
phone is no special case here, but its `sees` is false, and whoever asks that need not give facts.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from xihe_blender.capture.phone_surfaces import load_surfaces
from xihe_blender.io.exr import read_radiance
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.survey import SceneSurvey
from xihenet import phone as phones
from xihenet.camera import valid_plane_depth
from xihenet.effects import Effect, names_that_are_on, plan_effects
from xihenet.phone.depth_dropout import DepthDropout
from xihenet.phone.exposure import FrameRate, delivered_frames
from xihenet.phone.metering import Metering, metered_exposure
from xihenet.records import ArrayF32, ArrayF64, RgbdFrame

SURFACE_EFFECTS = frozenset(
    name for name, kind in phones.EFFECTS.items() if issubclass(kind, DepthDropout) and kind.asks_surfaces
)


@dataclass(frozen=True)
class CaptureNeeds:
    """What a phone, or several that share captures, asks of the path; `|` gives what any of two asks for.

    `delivered` are frames that reach the app at all, `captured` those of them that it takes in. With `radiance` the
    picture in scene radiance is kept beside a capture, for an exposure of the phone's own, with `surfaces` what a range
    sensor meets in each pixel.
    """

    delivered: frozenset[int]
    captured: frozenset[int]
    radiance: bool = False
    surfaces: bool = False

    def __or__(self, other: CaptureNeeds) -> CaptureNeeds:
        return CaptureNeeds(
            self.delivered | other.delivered,
            self.captured | other.captured,
            self.radiance or other.radiance,
            self.surfaces or other.surfaces,
        )


@dataclass(frozen=True, eq=False)
class ChosenPhone:
    """The phone and the network of `settings` on a surveyed path, its `profile` as it was then; see `choose_phone`.

    `choices` are "on" or "off" by effect, where the user decided; `frame_rate_hz` is the path's where it is fastest.
    """

    settings: PrevisSettings
    profile: phones.PhoneProfile
    survey: SceneSurvey
    choices: Mapping[str, str]
    frame_rate_hz: float

    @functools.cached_property
    def times_s(self) -> dict[int, float]:
        """Of the frames of the path, by number."""
        return {frame: one.time_s for frame, one in self.survey.frames.items()}

    @property
    def sees(self) -> bool:
        """Whether this phone can see anything but a perfect capture."""
        return any(map(self._may_be_on, self.profile.effects))

    @property
    def needs(self) -> CaptureNeeds:
        """What a run must capture and keep for it."""
        delivered = self._delivered()
        captured = delivered if self.settings.captured == "path" else delivered & self.survey.in_view.keys()
        surfaces = any(map(self._may_be_on, SURFACE_EFFECTS))
        return CaptureNeeds(delivered, captured, self._may_be_on("auto_exposure"), surfaces)

    @property
    def timing(self) -> dict[str, Any]:
        """What is known of a session without looking at anything, as fields of SessionFacts."""
        times_s = list(self.times_s.values())
        return {"frame_rate_hz": self.frame_rate_hz, "duration_s": times_s[-1] - times_s[0]}

    def _may_be_on(self, effect: str) -> bool:
        return effect in self.profile.effects and self.choices.get(effect) != "off"

    def _delivered(self) -> frozenset[int]:
        section = self.profile.sections.get("frame_rate")
        required = self.profile.required_effects(phones.SessionFacts(**self.timing))
        is_on = plan_effects(required, self.choices)["frame_rate"].state == "on"
        limit = section if is_on and isinstance(section, FrameRate) else None
        reaches = delivered_frames(list(self.times_s.values()), limit)
        return frozenset(frame for frame, is_there in zip(self.times_s, reaches, strict=True) if is_there)


def choose_phone(scene: bpy.types.Scene, survey: SceneSurvey, settings: PrevisSettings) -> ChosenPhone:
    """The phone of `settings` on a surveyed path; choices that `scene` remembers count. UserError as of `checked`."""
    choices = overrides_in_force(scene, settings.effect_choices)
    steps_s = np.diff([one.time_s for one in survey.frames.values()])
    rate_hz = 1 / float(steps_s.min()) if len(steps_s) else scene.render.fps / scene.render.fps_base
    return ChosenPhone(settings, settings.profile, survey, choices, rate_hz)


@dataclass(frozen=True, eq=False)
class CaptureFacts:
    """What one perfect capture says of the session, the exposure that it asks for, and what the light sensor (3,) would
    read at once.

    The smoothest roughness is None where that of any pixel is not known.
    """

    of_frame: phones.FrameFacts
    metered: float
    ambient: ArrayF64


def facts_of_capture(
    captured: RgbdFrame,
    positions_m: ArrayF64,
    metering: Metering,
    surfaces: phones.SurfaceFacts | None,
    radiance: ArrayF32 | None,
) -> CaptureFacts:
    """Of a capture; surfaces and radiance (H, W, 3) only where the phone needs them."""
    facts = replace(phones.facts_of_frame(captured, positions_m), highest_transmission=0.0)
    if surfaces is not None:
        valid = valid_plane_depth(captured.plane_depth_m)
        assert surfaces.reflectance is not None and surfaces.transmission is not None and surfaces.roughness is not None
        smoothest = float(surfaces.roughness[valid].min(initial=1.0))
        facts = replace(
            facts,
            darkest_grey=float(surfaces.reflectance[valid].min(initial=1.0)),
            smoothest_roughness=None if np.isnan(smoothest) else smoothest,
            highest_transmission=float(surfaces.transmission[valid].max(initial=0.0)),
        )
    metered = captured.exposure
    if radiance is not None:
        metered = metered_exposure([radiance], metering)
        facts = replace(facts, stops=float(np.log2(metered)))
    ambient = np.zeros(3) if captured.ambient is None else captured.ambient
    return CaptureFacts(facts, metered, ambient)


@dataclass(frozen=True, eq=False)
class SimulatedPhone:
    """The phone of a session, with the effects that are simulated; made by `simulate_phone`.

    `facts` are of each captured frame, in order, `effects` all that there are, by name, and `of_camera` the names of
    those that change its frames.
    """

    chosen: ChosenPhone
    facts: Mapping[int, CaptureFacts]
    exposure: float
    effects: Mapping[str, Effect]
    of_camera: frozenset[str]

    @functools.cached_property
    def camera(self) -> phones.PhoneCamera:
        return phones.PhoneCamera(self.chosen.profile, self.chosen.settings.seed, effects=self.of_camera)

    @functools.cached_property
    def track(self) -> phones.SessionTrack:
        """Exposure and light sensor over the captured frames."""
        facts = self.facts.values()
        return self.camera.follow(
            list(self.facts),
            [one.of_frame.time_s for one in facts],
            metered=[one.metered for one in facts],
            ambient=np.array([one.ambient for one in facts]).reshape(-1, 3),
            reference=self.exposure,
        )

    @property
    def on(self) -> frozenset[str]:
        return names_that_are_on(self.effects)

    @property
    def link_in_use(self) -> phones.Link | None:
        return self.chosen.settings.link if phones.NETWORK in self.on else None

    def notes(self) -> list[str]:
        """What a reader has to know of the session, in plain sentences."""
        link, step_s = self.link_in_use, float(np.diff(list(self.chosen.times_s.values())).min(initial=np.inf))
        usual_s = 0.0 if link is None else link.processing_s + link.median_s
        if not 0 < usual_s < step_s < np.inf:
            return []
        return [
            f"The frames of the path are {1e3 * step_s:.0f} ms apart: an estimate that takes {1e3 * usual_s:.0f} ms "
            "lights its object at the next of them."
        ]

    def see(self, captured: RgbdFrame, outputs: RunOutputs) -> tuple[RgbdFrame, dict[str, int]]:
        """The phone's frame, and how many pixels each effect took; `outputs` keep what stands beside the capture."""
        on, frame = self.camera.effects, captured.frame
        if not on:
            return captured, {}
        surfaces = load_surfaces(outputs.surfaces(frame)) if on & SURFACE_EFFECTS else None
        radiance = read_radiance(outputs.radiance("captured", frame)) if "auto_exposure" in on else None
        motion = self.chosen.survey.frames[frame].motion
        return self.camera.see(captured, facts=surfaces, motion=motion, radiance=radiance, track=self.track)


def simulate_phone(chosen: ChosenPhone, facts: Mapping[int, CaptureFacts], exposure: float) -> SimulatedPhone:
    """Decide which effects are simulated, from all that is known; without `facts` what they could rule out is on."""
    settings, survey = chosen.settings, chosen.survey
    motions = [one.motion for one in survey.frames.values()]
    known: dict[str, Any] = {
        **chosen.timing,
        "n_anchors": settings.n_anchors,
        "fastest_m_per_s": max(float(np.linalg.norm(motion.velocity_m_per_s)) for motion in motions),
        "fastest_turn_deg_per_s": max(float(np.linalg.norm(np.degrees(motion.turn_rad_per_s))) for motion in motions),
        "light_changes": survey.light_changes,
    }
    session = phones.SessionFacts(**known)
    if facts:
        of_frames = [one.of_frame for one in facts.values()]
        roughness = [one.smoothest_roughness for one in of_frames if one.smoothest_roughness is not None]
        known["smoothest_roughness"] = min(roughness) if len(roughness) == len(of_frames) else None
        session = phones.facts_of_session(of_frames, **known)
    effects = plan_effects(chosen.profile.required_effects(session, settings.link), chosen.choices)
    return SimulatedPhone(chosen, facts, exposure, effects, names_that_are_on(effects) - {phones.NETWORK})
