"""Rules of light transport: by which signs does a scene require an effect? One for each, in `RULES`.

A rule says on or off, why, and what Cycles is set to. An effect is off only where nothing that Cycles renders would
show it, so that leaving it out cannot change the picture; "may" counts as on. Effects that belong to materials, objects
or cameras (no setting of a scene switches them) have a rule as well, since a reader wants to know; see
`SWITCHED_ELSEWHERE`.

What is required is simulated in full, with the bounces of Blender's preset "Full Global Illumination". Only diffuse
bounces have a number in between, since every matt surface requires them; see `enclosure`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import bpy

from xihe_blender.light_transport.enclosure import MAX_BOUNCES, bounces_needed
from xihe_blender.light_transport.transport_survey import TransportSurvey
from xihe_blender.scene.shader_nodes import Interaction
from xihenet.effects import Requirement, Setting


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
        return Requirement(False, "no matt surfaces are rendered, so no light is spread in all directions", on, off)
    kept = worst[1] / worst[0] if worst[0] > 0 else 0.0
    where = "closed and bright" if kept > 0.5 else "partly open or dark" if kept > 0.15 else "open or very dark"
    reason = f"the surroundings are {where}: after a bounce, {kept:.0%} of the light reaches another surface"
    return Requirement(True, reason, on, off)


def _by_surface(kind: str, *interactions: Interaction, onto_matt: str = "", **on: Setting) -> Rule:
    """On, with Cycles set to `on`, where something that Cycles renders has one of `interactions`.

    With `onto_matt`, which says in words what it does to matt surfaces, something matt has to be there as well.
    """

    def rule(s: SceneFacts) -> Requirement:
        found = s.survey.which(*interactions)
        is_lost = bool(onto_matt) and not s.survey.which(Interaction.DIFFUSE)
        no_receiver = "no matt surfaces are rendered for the light to fall on"
        reason = no_receiver if found and is_lost else _rendered(kind, found, onto_matt)
        return Requirement(bool(found) and not is_lost, reason, on, {name: type(value)() for name, value in on.items()})

    return rule


def _transparency(s: SceneFacts) -> Requirement:
    # A ray through the bounds of a volume counts as one through a transparent surface.
    kind, interactions = "transparent surfaces or volumes", (Interaction.TRANSPARENT, Interaction.VOLUME)
    required = _by_surface(kind, *interactions, transparent_max_bounces=MAX_BOUNCES)(s)
    # So does each time that light meets a lamp and goes on behind it, without anything being transparent.
    return replace(required, left_out=required.on) if s.survey.has_lamps else required


def _subsurface(s: SceneFacts) -> Requirement:
    found, kind = s.survey.which(Interaction.SUBSURFACE), "surfaces with subsurface scattering"
    reason = _rendered(kind, found, "may be reached by rays from the camera or a light probe")
    if s.survey.unreached:
        never = "no ray from the camera or a light probe reaches them, directly or after diffuse bounces"
        reason = f"{kind} are out of reach: {_named(s.survey.unreached)}; {never}"
    return Requirement(bool(found), reason, {}, {})


def _hair(s: SceneFacts) -> Requirement:
    strands = [*s.survey.strands, *s.survey.which(Interaction.HAIR)]
    return Requirement(bool(strands), _rendered("hair or fur strands", strands), {}, {})


def _motion_blur(s: SceneFacts) -> Requirement:
    on, off = {"use_motion_blur": True}, {"use_motion_blur": False}
    if not s.scene.render.use_motion_blur:
        return Requirement(False, "motion blur is off in the scene", on, off)
    what_moves = "and the camera or an object moves" if s.survey.is_moving else "but no camera or object moves"
    return Requirement(s.survey.is_moving, f"motion blur is on in the scene, {what_moves}", on, off)


def _depth_of_field(s: SceneFacts) -> Requirement:
    cameras = list(s.survey.defocused)
    reason = f"camera {_named(cameras)} has depth of field" if cameras else "no camera of the run has depth of field"
    return Requirement(bool(cameras), reason, {}, {})


def _light_tree(s: SceneFacts) -> Requirement:
    n, emitters = s.survey.n_lights, list(s.survey.emitters)
    reason = "the scene has one light" if n else "the scene has no light"
    if n > 1:
        reason = f"the scene has {n} lights, counting glowing objects and the world"
    elif n == 1 and emitters:
        reason = f"the only light is {_named(emitters)}, which glows: each of its faces counts as a light"
    return Requirement(n > 1 or bool(emitters), reason, {"use_light_tree": True}, {"use_light_tree": False})


def _environment_sampling(s: SceneFacts) -> Requirement:
    if not s.survey.world & Interaction.EMISSION:
        return Requirement(False, "the world gives no light", {}, {})
    if not s.survey.world & Interaction.VARYING_EMISSION:
        return Requirement(False, "the world is equally bright in all directions", {}, {})
    return Requirement(True, "the world is brighter in some directions than in others", {}, {})


def _denoising(s: SceneFacts) -> Requirement:
    off = {"use_denoising": False}
    if not s.has_denoiser:
        reason = "this build of Blender has no OpenImageDenoise: noise may trigger estimates, more samples reduce it"
        return Requirement(False, reason, off, off)
    if s.survey.n_lights == 0:
        return Requirement(False, "the scene has no light, so its pictures have no noise", {}, off)
    return Requirement(True, "OpenImageDenoise removes noise from pictures, but not from light probes", {}, off)


def _fast_gi(s: SceneFacts) -> Requirement:
    asked = "the scene has it switched on, but " if s.scene.cycles.use_fast_gi else ""
    reason = f"{asked}Fast GI only approximates bounced light, and the ground truth must be path-traced in full"
    return Requirement(False, reason, {"use_fast_gi": True}, {"use_fast_gi": False})


RULES: dict[str, Rule] = {
    "diffuse bounces": _diffuse_bounces,
    "glossy bounces": _by_surface("glossy surfaces", Interaction.GLOSSY, glossy_bounces=MAX_BOUNCES),
    "transmission": _by_surface(
        "transmissive surfaces", Interaction.REFRACTION, Interaction.TRANSLUCENT, transmission_bounces=MAX_BOUNCES
    ),
    "transparency": _transparency,
    "volumes": _by_surface("smoke, fog or other volumes", Interaction.VOLUME, volume_bounces=MAX_BOUNCES),
    "reflective caustics": _by_surface(
        "glossy surfaces", Interaction.GLOSSY, onto_matt="reflect light onto matt ones", caustics_reflective=True
    ),
    "refractive caustics": _by_surface(
        "refracting surfaces", Interaction.REFRACTION, onto_matt="bend light onto matt ones", caustics_refractive=True
    ),
    "subsurface": _subsurface,
    "hair": _hair,
    "displacement": _by_surface("displaced surfaces", Interaction.DISPLACEMENT),
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
    "hair": "the objects' particle or hair settings",
    "displacement": "the materials' displacement method",
    "depth of field": "the camera's depth of field",
    "environment sampling": "the sampling in the world's settings",
}
"""What switches those effects that no setting of a scene does."""


def _rendered(kind: str, found: Sequence[str], what_they_do: str = "") -> str:
    return f"{kind} {what_they_do or 'are rendered'}: {_named(found)}" if found else f"no {kind} are rendered"


def _named(found: Sequence[str]) -> str:
    """The first two, and how many more."""
    more = f" and {len(found) - 2} more" if len(found) > 2 else ""
    return ", ".join(found[:2]) + more
