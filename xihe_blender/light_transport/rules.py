"""Rules of light transport: by which signs does a scene require an effect? One for each, in `RULES`.

A rule says on or off, why, and what Cycles is set to. An effect is off only where nothing that light can survey would
show it, so that leaving it out cannot change the picture; "may" counts as on. Effects that belong to materials, objects
or cameras (no setting of a scene switches them) have a rule as well, since a reader wants to know; see
`SWITCHED_ELSEWHERE`.

What is required is simulated in full, with the bounces of Blender's preset "Full Global Illumination". Only diffuse
bounces have a number in between, since every matt surface requires them; see `enclosure`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import bpy

from xihe_blender.light_transport.enclosure import MAX_BOUNCES, bounces_needed
from xihe_blender.light_transport.nodes import Interaction
from xihe_blender.light_transport.transport_survey import TransportSurvey
from xihenet.effects import Requirement, Setting

N_NAMED = 2


@dataclass(frozen=True, eq=False)
class SceneFacts:
    """What the rules judge by: what light can survey, the scene's own settings, and whether the build can denoise."""

    survey: TransportSurvey
    scene: bpy.types.Scene
    has_denoiser: bool


Rule = Callable[[SceneFacts], Requirement]


def _diffuse_bounces(s: SceneFacts) -> Requirement:
    worst = max(s.survey.carried, key=bounces_needed)
    on, off = {"diffuse_bounces": bounces_needed(worst)}, {"diffuse_bounces": 0}
    if not s.survey.which(Interaction.DIFFUSE):
        return Requirement(False, "no surface spreads light in all directions: there is no matt material", on, off)
    kept = worst[1] / worst[0] if worst[0] > 0 else 0.0
    where = "closed and bright" if kept > 0.5 else "partly open or dark" if kept > 0.15 else "open or very dark"
    reason = f"the surroundings are {where}: {kept:.0%} of the light goes on from a surface to the next"
    return Requirement(True, reason, on, off)


def _by_surface(kind: str, *interactions: Interaction, bounces: str | None = None) -> Rule:
    """On where anything that light reaches has one of `interactions`; `bounces` is the setting that limits them."""

    def rule(s: SceneFacts) -> Requirement:
        found = s.survey.which(*interactions)
        reason = f"{kind.removesuffix(' material')}: {_named(found)}" if found else _none_reached(kind)
        on: Mapping[str, Setting] = {} if bounces is None else {bounces: MAX_BOUNCES}
        return Requirement(bool(found), reason, on, dict.fromkeys(on, 0))

    return rule


def _transparency(s: SceneFacts) -> Requirement:
    # A ray through the bounds of a volume counts as one through a transparent surface.
    interactions = (Interaction.TRANSPARENT, Interaction.VOLUME)
    required = _by_surface("transparent material", *interactions, bounces="transparent_max_bounces")(s)
    # So does each time that light meets a lamp and goes on behind it, without anything being transparent.
    return replace(required, left_out=required.on) if s.survey.has_lamps else required


def _caustics(kind: str, caster: Interaction, does: str, setting: str) -> Rule:
    """On where something throws light onto something matt."""

    def rule(s: SceneFacts) -> Requirement:
        casters, receivers = s.survey.which(caster), s.survey.which(Interaction.DIFFUSE)
        if casters and receivers:
            reason = f"{does} light onto matt surfaces: {_named(casters)}"
        elif casters:
            reason = "there is no matt surface for the light to fall on"
        else:
            reason = _none_reached(f"{kind} material")
        return Requirement(bool(casters and receivers), reason, {setting: True}, {setting: False})

    return rule


def _hair(s: SceneFacts) -> Requirement:
    strands = s.survey.strands + s.survey.which(Interaction.HAIR)
    return Requirement(bool(strands), _named(strands) if strands else "no hair or fur is rendered", {}, {})


def _motion_blur(s: SceneFacts) -> Requirement:
    on, off = {"use_motion_blur": True}, {"use_motion_blur": False}
    if not s.scene.render.use_motion_blur:
        return Requirement(False, "the scene has it switched off", on, off)
    if not s.survey.is_moving:
        return Requirement(False, "the scene asks for it, but neither the camera nor anything else moves", on, off)
    return Requirement(True, "the scene asks for it, and the camera or something else moves", on, off)


def _depth_of_field(s: SceneFacts) -> Requirement:
    cameras = s.survey.defocused
    reason = f"camera {_named(cameras)} has it" if cameras else "no camera of the run has it switched on"
    return Requirement(bool(cameras), reason, {}, {})


def _light_tree(s: SceneFacts) -> Requirement:
    n = s.survey.n_lights
    is_on = n > 1 or bool(s.survey.emitters)
    reason = f"{n} lights to choose among, glowing objects and the world included" if n > 1 else "a single light"
    if n == 1 and s.survey.emitters:
        reason = f"{_named(s.survey.emitters)} glows, which makes each of its faces a light"
    elif n == 0:
        reason = "there is no light"
    return Requirement(is_on, reason, {"use_light_tree": True}, {"use_light_tree": False})


def _environment_sampling(s: SceneFacts) -> Requirement:
    if not s.survey.world & Interaction.EMISSION:
        return Requirement(False, "the world gives no light", {}, {})
    if not s.survey.world & Interaction.VARYING_EMISSION:
        return Requirement(False, "the world is equally bright in all directions", {}, {})
    return Requirement(True, "the world is brighter in some directions than in others", {}, {})


def _denoising(s: SceneFacts) -> Requirement:
    off = {"use_denoising": False}
    if not s.has_denoiser:
        reason = "this build of Blender has no OpenImageDenoise: noise may trigger estimates, more samples help"
        return Requirement(False, reason, off, off)
    if s.survey.n_lights == 0:
        return Requirement(False, "there is no light, so there is no noise", {}, off)
    return Requirement(True, "OpenImageDenoise cleans pictures; light probes are left as they are", {}, off)


def _fast_gi(s: SceneFacts) -> Requirement:
    asked = "the scene asks for it, but " if s.scene.cycles.use_fast_gi else ""
    reason = f"{asked}it only approximates bounces, and the ground truth must not"
    return Requirement(False, reason, {"use_fast_gi": True}, {"use_fast_gi": False})


RULES: dict[str, Rule] = {
    "diffuse bounces": _diffuse_bounces,
    "glossy bounces": _by_surface("glossy material", Interaction.GLOSSY, bounces="glossy_bounces"),
    "transmission": _by_surface(
        "transmissive material", Interaction.REFRACTION, Interaction.TRANSLUCENT, bounces="transmission_bounces"
    ),
    "transparency": _transparency,
    "volumes": _by_surface("smoke, fog or other volume", Interaction.VOLUME, bounces="volume_bounces"),
    "reflective caustics": _caustics("glossy", Interaction.GLOSSY, "reflecting", "caustics_reflective"),
    "refractive caustics": _caustics("refracting", Interaction.REFRACTION, "refracting", "caustics_refractive"),
    "subsurface": _by_surface("subsurface material", Interaction.SUBSURFACE),
    "hair": _hair,
    "displacement": _by_surface("displacing material", Interaction.DISPLACEMENT),
    "motion blur": _motion_blur,
    "depth of field": _depth_of_field,
    "light tree": _light_tree,
    "environment sampling": _environment_sampling,
    "denoising": _denoising,
    "Fast GI": _fast_gi,
}
"""Every effect of light transport, in the order in which they are shown."""

SWITCHED_ELSEWHERE = {
    "subsurface": "the materials' subsurface weight",
    "hair": "what the objects' particle or hair settings render",
    "displacement": "the materials' displacement method",
    "depth of field": "the camera's depth of field",
    "environment sampling": "the sampling in the world's settings",
}
"""What switches those effects that no setting of a scene does."""


def _none_reached(what: str) -> str:
    return f"no {what} is visible to the camera, the probes or the virtual objects"


def _named(found: Sequence[str]) -> str:
    """The first few, and how many more."""
    more = f" and {len(found) - N_NAMED} more" if len(found) > N_NAMED else ""
    return ", ".join(found[:N_NAMED]) + more
