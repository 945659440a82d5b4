"""What does the phone of this run make of a perfect capture, and which of its effects can this session show?

Captures are rendered first, the whole path, and kept as they are; from them come the facts by which effects are
planned, and then the phone's own frames. So nothing is rendered for the phone, an effect is left out only on the
evidence of every captured frame, and a run that is resumed gets the same bytes. Rejected: facts from small previews,
which miss what is small, and keeping the phone's frames, since the report also shows them without one effect.

Poses are known for all frames of the scene without rendering; see `phone_motion`. While no virtual object is in view
nothing is captured, so exposure and light sensor know nothing of it. The perfect phone is no special case here, but its
`sees` is false, and whoever asks that need not ask for more.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from xihe_blender.capture.phone_motion import camera_motions, fastest
from xihe_blender.capture.phone_surfaces import (
    ask_for_surfaces,
    load_surfaces,
    save_surfaces,
    smoothest_in_view,
    surfaces_in,
)
from xihe_blender.capture.scanner import CyclesScanner, first_layer
from xihe_blender.io.exr import read_radiance, write_radiance
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.previs.phone_room import RoomLook, look_at_room
from xihe_blender.previs.plan import PrevisPlan
from xihe_blender.previs.settings import PrevisSettings
from xihenet.camera import valid_plane_depth
from xihenet.effects import Effect, names_that_are_on, plan_effects
from xihenet.metering import metered_exposure
from xihenet.phone import (
    NETWORK,
    CameraMotion,
    FrameFacts,
    Link,
    PhoneCamera,
    SessionFacts,
    SessionTrack,
    facts_of_frame,
    facts_of_session,
)
from xihenet.phone.frame_rate import FrameRate, delivered_frames
from xihenet.records import ArrayF64, RgbdFrame

SURFACE_EFFECTS = frozenset({"dark_holes", "glossy_holes", "transparent_holes"})


@dataclass(frozen=True)
class _Noticed:
    """What is remembered of one capture."""

    facts: FrameFacts
    smoothest_roughness: float | None
    highest_transmission: float
    metered: float
    ambient: ArrayF64


class PhoneCapture:
    """The phone of one run. In this order: `prepare`; `keep` after each render; `notice` each capture; `plan`; `see`.

    Parameters
    ----------
    scene : the user's
    plan : frames and positions of the run
    outputs : where captures are kept
    settings : phone, network, choices, seed
    exposure : of the session
    """

    def __init__(
        self,
        scene: bpy.types.Scene,
        plan: PrevisPlan,
        outputs: RunOutputs,
        settings: PrevisSettings,
        exposure: float,
    ) -> None:
        self.scene, self.outputs, self.exposure = scene, outputs, exposure
        self.frames, self.n_anchors, self.seed = plan.frames, settings.n_anchors, settings.seed
        self.positions_m = np.array([probe.position_m for probe in plan.probes]).reshape(-1, 3)
        self.profile, self.link = settings.profile, settings.link
        self.metering = settings.metering_in_force
        self.choices = overrides_in_force(scene, settings.effect_choices)
        self.times_s = [(f - scene.frame_start) * scene.render.fps_base / scene.render.fps for f in self.frames]
        self.motions: dict[int, CameraMotion] = {}
        self.effects: dict[str, Effect] = {}
        self.camera = PhoneCamera(self.profile, self.seed, effects=())
        self.track = SessionTrack()
        self._noticed: dict[int, _Noticed] = {}
        self._room = RoomLook()
        self.delivered = self._delivered()

    @property
    def sees(self) -> bool:
        """Whether this phone can see anything but a perfect capture."""
        return any(self._may_be_on(effect) for effect in self.profile.effects)

    @property
    def has_session_effects(self) -> bool:
        return self.sees or self.link is not None

    def _may_be_on(self, effect: str) -> bool:
        return effect in self.profile.effects and self.choices.get(effect) != "off"

    @property
    def _wants_surfaces(self) -> bool:
        return any(self._may_be_on(effect) for effect in SURFACE_EFFECTS)

    @property
    def _wants_radiance(self) -> bool:
        return self._may_be_on("auto_exposure")

    # --------------------------------------------------------------------------------------- before and while capturing

    def prepare(self, scanner: CyclesScanner) -> None:
        """Find out how the camera moves and what the room's lights do, and have `scanner` bring what is needed."""
        if not self.has_session_effects:
            return
        self.motions = camera_motions(scanner, self.frames, self.scene.frame_start, self.scene.frame_end)
        if self._wants_surfaces or self._may_be_on("light_sensor") or self.link is not None:
            self._room = look_at_room(self.scene, self.frames)
        if self._wants_surfaces:
            ask_for_surfaces(scanner.scene.view_layers[0])

    def keep(self, scanner: CyclesScanner, frame: int) -> None:
        """Store what the last render of `scanner` has for the phone, beside the capture itself."""
        if self._wants_radiance:
            write_radiance(self.outputs.radiance("captured", frame), first_layer(scanner.rendered)[0])
        if self._wants_surfaces:
            passes = next(iter(scanner.rendered.layers.values()))
            save_surfaces(self.outputs.surfaces(frame), surfaces_in(passes, self._room.roughness.get(frame, {})))

    def take_over(self, source: int, frame: int) -> None:
        """Store for `frame` what was kept for `source`: nothing has changed between the two."""
        if self._wants_radiance:
            radiance = read_radiance(self.outputs.radiance("captured", source))
            write_radiance(self.outputs.radiance("captured", frame), radiance)
        if self._wants_surfaces:
            save_surfaces(self.outputs.surfaces(frame), load_surfaces(self.outputs.surfaces(source)))

    def notice(self, captured: RgbdFrame) -> None:
        """Remember what a perfect capture, kept before, says about the session."""
        facts, roughness, transmission = facts_of_frame(captured, self.positions_m), None, 0.0
        if self._wants_surfaces:
            surfaces, valid = load_surfaces(self.outputs.surfaces(captured.frame)), self._valid(captured)
            assert surfaces.reflectance is not None and surfaces.transmission is not None
            facts = replace(facts, darkest_grey=float(surfaces.reflectance[valid].min(initial=1.0)))
            roughness = smoothest_in_view(surfaces, valid)
            transmission = float(surfaces.transmission[valid].max(initial=0.0))
        metered = self.exposure
        if self._wants_radiance:
            radiance = read_radiance(self.outputs.radiance("captured", captured.frame))
            metered = metered_exposure([radiance], self.metering)
            facts = replace(facts, stops=float(np.log2(metered)))
        ambient = np.zeros(3) if captured.ambient is None else captured.ambient
        self._noticed[captured.frame] = _Noticed(facts, roughness, transmission, metered, ambient)

    @staticmethod
    def _valid(captured: RgbdFrame) -> Any:
        return valid_plane_depth(captured.plane_depth_m)

    # ------------------------------------------------------------------------------------------------------ what is on

    def plan(self) -> None:
        """Decide which effects are simulated, from all that was noticed."""
        required = self.profile.required_effects(self._session_facts(), self.link)
        self.effects = plan_effects(required, self.choices)
        self.camera = self.camera_with(self.on - {NETWORK})
        self.track = self.follow(self.camera)

    @property
    def on(self) -> frozenset[str]:
        """Names of the effects that are simulated."""
        return names_that_are_on(self.effects)

    @property
    def link_in_use(self) -> Link | None:
        return self.link if NETWORK in self.on else None

    def notes(self) -> list[str]:
        """What a reader has to know of the session, in plain sentences."""
        link, step_s = self.link_in_use, float(np.diff(self.times_s).min(initial=np.inf))
        usual_s = 0.0 if link is None else link.processing_s + link.median_s
        if not 0 < usual_s < step_s < np.inf:
            return []
        return [
            f"The path has a frame every {1e3 * step_s:.0f} ms: "
            f"an estimate that takes {1e3 * usual_s:.0f} ms lights its object only then."
        ]

    def _session_facts(self) -> SessionFacts:
        noticed = list(self._noticed.values())
        known: dict[str, Any] = {
            **self._times(),
            "n_anchors": self.n_anchors,
            "fastest_m_per_s": fastest([motion.velocity_m_per_s for motion in self.motions.values()]),
            "fastest_turn_deg_per_s": fastest([np.degrees(m.turn_rad_per_s) for m in self.motions.values()]),
            "light_changes": self._room.light_changes,
        }
        if not noticed:
            return SessionFacts(**known)
        roughness = [one.smoothest_roughness for one in noticed if one.smoothest_roughness is not None]
        known["smoothest_roughness"] = min(roughness) if len(roughness) == len(noticed) else None
        known["highest_transmission"] = max(one.highest_transmission for one in noticed)
        return facts_of_session([one.facts for one in noticed], **known)

    def _times(self) -> dict[str, Any]:
        render = self.scene.render
        steps_s = np.diff(self.times_s)
        rate_hz = 1 / float(steps_s.min()) if len(steps_s) else render.fps / render.fps_base
        return {"frame_rate_hz": rate_hz, "duration_s": self.times_s[-1] - self.times_s[0]}

    def _delivered(self) -> frozenset[int]:
        """Frames of the path that reach the app at all."""
        section = self.profile.sections.get("frame_rate")
        required = self.profile.required_effects(SessionFacts(**self._times()))
        is_on = plan_effects(required, self.choices)["frame_rate"].state == "on"
        reaches = delivered_frames(self.times_s, section if is_on and isinstance(section, FrameRate) else None)
        return frozenset(frame for frame, is_there in zip(self.frames, reaches, strict=True) if is_there)

    # ---------------------------------------------------------------------------------------------- the phone's frames

    def camera_with(self, effects: Collection[str]) -> PhoneCamera:
        """This phone with `effects` alone."""
        return PhoneCamera(self.profile, self.seed, effects=effects)

    def follow(self, camera: PhoneCamera) -> SessionTrack:
        """Exposure and light sensor of `camera` over the captured frames."""
        frames, noticed = list(self._noticed), list(self._noticed.values())
        return camera.follow(
            frames,
            [one.facts.time_s for one in noticed],
            metered=[one.metered for one in noticed],
            ambient=np.array([one.ambient for one in noticed]).reshape(-1, 3),
            reference=self.exposure,
        )

    def see(
        self, captured: RgbdFrame, camera: PhoneCamera | None = None, track: SessionTrack | None = None
    ) -> tuple[RgbdFrame, dict[str, int]]:
        """The phone's frame, and how many pixels each effect took; with another `camera`, what that one would see."""
        phone, followed = camera or self.camera, track or self.track
        if not phone.effects:
            return captured, {}
        facts = radiance = None
        if phone.effects & SURFACE_EFFECTS:
            facts = load_surfaces(self.outputs.surfaces(captured.frame))
        if "auto_exposure" in phone.effects:
            radiance = read_radiance(self.outputs.radiance("captured", captured.frame))
        motion = self.motions.get(captured.frame)
        return phone.see_and_count(captured, facts=facts, motion=motion, radiance=radiance, track=followed)
