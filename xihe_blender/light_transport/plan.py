"""Which effects of light transport does a scene call for? A rule per effect; one plan for all renders of a run.

A rule says on or off, why, and what Cycles is set to. An effect is off only where nothing that light can reach would
show it, so that leaving it out cannot change the picture; "may" counts as on. A user's override wins, and the reason
then says what the scene itself called for. Effects that belong to materials, objects or cameras (no setting of a scene
switches them) are in the plan as well, since a reader wants to know, but cannot be overridden.

What is called for is simulated in full, with the bounces of Blender's preset "Full Global Illumination". Only diffuse
bounces have a number in between, since every matt surface calls for them; see `enclosure`.

Not here: what each effect costs (`costs`), and what the phone and the session add.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import bpy

from xihe_blender.capture.render import RenderSettings, can_denoise, working_scene
from xihe_blender.light_transport.enclosure import MAX_BOUNCES, bounces_needed
from xihe_blender.light_transport.nodes import Ability
from xihe_blender.light_transport.overrides import SWITCHED_ELSEWHERE, checked, overrides_in_force
from xihe_blender.light_transport.reach import Reach, reach_of

State = Literal["on", "off"]
Setting = bool | int
N_NAMED = 2


@dataclass(frozen=True)
class Effect:
    """One effect of light transport.

    Parameters
    ----------
    name : as shown and as overrides name it
    state : "on" or "off"
    reason : why, for a lighting artist
    parameters : what Cycles is set to, by the name of its setting; empty where the scene has no setting for it
    origin : "auto", or "user" for an override
    """

    name: str
    state: State
    reason: str
    parameters: Mapping[str, Setting]
    origin: Literal["auto", "user"] = "auto"


@dataclass(frozen=True)
class EffectPlan:
    """The effects of a run, in the order in which they are shown."""

    effects: tuple[Effect, ...]

    def __getitem__(self, name: str) -> Effect:
        return {effect.name: effect for effect in self.effects}[name]

    @property
    def light_transport(self) -> tuple[tuple[str, Setting], ...]:
        """What to set on a working scene: settings of Cycles by name, each kind of bounce by its own limit alone."""
        settings = {name: value for effect in self.effects for name, value in effect.parameters.items()}
        kinds = ("diffuse_bounces", "glossy_bounces", "transmission_bounces", "volume_bounces")
        return (*settings.items(), ("max_bounces", min(MAX_BOUNCES, sum(int(settings[kind]) for kind in kinds))))

    def as_json(self) -> list[dict[str, Any]]:
        """[{name, state, reason, parameters, origin}], as results.json holds it."""
        return [asdict(effect) | {"parameters": dict(effect.parameters)} for effect in self.effects]

    @classmethod
    def from_json(cls, rows: Sequence[Mapping[str, Any]]) -> EffectPlan:
        """The plan that `as_json` wrote."""
        return cls(tuple(Effect(**row) for row in rows))


@dataclass(frozen=True, eq=False)
class Scenery:
    """What the rules judge by: what light can reach, the scene's own settings, and whether the build can denoise."""

    reach: Reach
    scene: bpy.types.Scene
    has_denoiser: bool


@dataclass(frozen=True)
class Verdict:
    """What a rule says of a scene: on or off, why, and the settings of both states: a user may want the other.

    `spared` are those of an effect that is not called for, where they are not those of `off`, which a user asks for.
    """

    is_on: bool
    reason: str
    on: Mapping[str, Setting]
    off: Mapping[str, Setting]
    spared: Mapping[str, Setting] | None = None


def plan_effects(
    scene: bpy.types.Scene,
    camera: bpy.types.Object | None = None,
    positions: Sequence[Sequence[float]] = (),
    *,
    frames: Sequence[int] | None = None,
    overrides: Mapping[str, str] | None = None,
) -> EffectPlan:
    """The effects that `scene` calls for; the scene stays as it is.

    Parameters
    ----------
    scene : room and virtual objects
    camera : the phone; None takes the scene's camera at each frame
    positions : (K, 3) world, metres: where light probes stand
    frames : frames to judge, each of them evaluated; None takes the scene's range and step
    overrides : effect: "auto", "on" or "off"; wins over what the .blend remembers, which wins over the scene

    Raises
    ------
    UserError for an unknown effect or state, or an effect that no setting of a scene can switch
    """
    wanted = overrides_in_force(scene, overrides or {})
    return planned(judge_effects(scene, camera, positions, frames=frames), wanted)


def judge_effects(
    scene: bpy.types.Scene,
    camera: bpy.types.Object | None = None,
    positions: Sequence[Sequence[float]] = (),
    *,
    frames: Sequence[int] | None = None,
) -> dict[str, Verdict]:
    """What `scene` itself calls for, effect by effect; parameters as of `plan_effects`."""
    chosen = range(scene.frame_start, scene.frame_end + 1, scene.frame_step) if frames is None else frames
    return judge_reach(scene, reach_of(scene, list(chosen), camera, positions))


def judge_reach(scene: bpy.types.Scene, reach: Reach) -> dict[str, Verdict]:
    """`judge_effects` where it is known what light can reach."""
    with working_scene(scene, "Xihe Effects", RenderSettings((4, 4), samples=1)) as working:
        scenery = Scenery(reach, scene, can_denoise(working))
    return {name: rule(scenery) for name, rule in RULES.items()}


def planned(verdicts: Mapping[str, Verdict], wanted: Mapping[str, str]) -> EffectPlan:
    """The plan that follows from `verdicts` and what the user wants; UserError as in `plan_effects`."""
    overrides = checked(wanted)
    return EffectPlan(tuple(_effect(name, verdict, overrides.get(name)) for name, verdict in verdicts.items()))


def everything_on(scene: bpy.types.Scene, verdicts: Mapping[str, Verdict]) -> EffectPlan:
    """The plan to hold others against: every effect that a setting switches is on, with all bounces there are.

    Off stay Fast GI, which replaces bounces, and motion blur where `scene` has it off: a look, not an effect missed.
    """
    left_out = {"Fast GI"} if scene.render.use_motion_blur else {"Fast GI", "motion blur"}
    switched = {name for name, elsewhere in SWITCHED_ELSEWHERE.items() if elsewhere is None}
    plan = planned(verdicts, {name: "off" if name in left_out else "on" for name in switched})
    bounces = replace(plan["diffuse bounces"], parameters={"diffuse_bounces": MAX_BOUNCES})
    return EffectPlan(tuple(bounces if effect.name == bounces.name else effect for effect in plan.effects))


def _effect(name: str, verdict: Verdict, wanted: str | None) -> Effect:
    is_on, reason = verdict.is_on, verdict.reason
    if wanted is not None:
        is_on = wanted == "on"
        called_for = "on" if verdict.is_on else "off"
        reason = f"you turned it {wanted}; by itself it would be {called_for}: {reason}"
    spared = verdict.off if verdict.spared is None or wanted is not None else verdict.spared
    settings = verdict.on if is_on else spared
    return Effect(name, "on" if is_on else "off", reason, dict(settings), "auto" if wanted is None else "user")


# --------------------------------------------------------------------------------------------------------------- rules


def _diffuse_bounces(s: Scenery) -> Verdict:
    worst = max(s.reach.carried, key=bounces_needed)
    needed = bounces_needed(worst)
    kept = worst[1] / worst[0] if worst[0] > 0 else 0.0
    where = "closed and bright" if kept > 0.5 else "partly open or dark" if kept > 0.15 else "open or very dark"
    if not s.reach.which(Ability.DIFFUSE):
        reason = "no surface spreads light in all directions: there is no matt material"
        return Verdict(False, reason, {"diffuse_bounces": needed}, {"diffuse_bounces": 0})
    reason = f"the surroundings are {where}: {kept:.0%} of the light goes on from a surface to the next"
    return Verdict(True, reason, {"diffuse_bounces": needed}, {"diffuse_bounces": 0})


def _glossy_bounces(s: Scenery) -> Verdict:
    on = {"glossy_bounces": MAX_BOUNCES}
    return _by_surface(s, (Ability.GLOSSY,), "glossy", on, {"glossy_bounces": 0})


def _transmission(s: Scenery) -> Verdict:
    on = {"transmission_bounces": MAX_BOUNCES}
    abilities = (Ability.REFRACTION, Ability.TRANSLUCENT)
    return _by_surface(s, abilities, "transmissive", on, {"transmission_bounces": 0})


def _transparency(s: Scenery) -> Verdict:
    on = {"transparent_max_bounces": MAX_BOUNCES}
    # A ray through the bounds of a volume counts as one through a transparent surface.
    abilities = (Ability.TRANSPARENT, Ability.VOLUME)
    verdict = _by_surface(s, abilities, "transparent", on, {"transparent_max_bounces": 0})
    # So does each time that light meets a lamp and goes on behind it, without anything being transparent.
    return replace(verdict, spared=on) if s.reach.has_lamps else verdict


def _volumes(s: Scenery) -> Verdict:
    on = {"volume_bounces": MAX_BOUNCES}
    return _by_surface(s, (Ability.VOLUME,), "smoke, fog or other volume", on, {"volume_bounces": 0}, noun="")


def _reflective_caustics(s: Scenery) -> Verdict:
    return _caustics(s, "caustics_reflective", Ability.GLOSSY, "reflecting light onto matt surfaces", "glossy")


def _refractive_caustics(s: Scenery) -> Verdict:
    return _caustics(s, "caustics_refractive", Ability.REFRACTION, "refracting light onto matt surfaces", "refracting")


def _caustics(s: Scenery, setting: str, caster: Ability, does: str, kind: str) -> Verdict:
    casters, receivers = s.reach.which(caster), s.reach.which(Ability.DIFFUSE)
    if casters and receivers:
        reason = f"{does}: {_named(casters)}"
    elif casters:
        reason = "there is no matt surface for the light to fall on"
    else:
        reason = _none_reached(f"{kind} material")
    return Verdict(bool(casters and receivers), reason, {setting: True}, {setting: False})


def _subsurface(s: Scenery) -> Verdict:
    return _by_surface(s, (Ability.SUBSURFACE,), "subsurface", {}, {})


def _hair(s: Scenery) -> Verdict:
    strands = s.reach.strands + s.reach.which(Ability.HAIR)
    return Verdict(bool(strands), _named(strands) if strands else "no hair or fur is rendered", {}, {})


def _displacement(s: Scenery) -> Verdict:
    return _by_surface(s, (Ability.DISPLACEMENT,), "displacing", {}, {})


def _motion_blur(s: Scenery) -> Verdict:
    on, off = {"use_motion_blur": True}, {"use_motion_blur": False}
    if not s.scene.render.use_motion_blur:
        return Verdict(False, "the scene has it switched off", on, off)
    if not s.reach.is_moving:
        return Verdict(False, "the scene asks for it, but neither the camera nor anything else moves", on, off)
    return Verdict(True, "the scene asks for it, and the camera or something else moves", on, off)


def _depth_of_field(s: Scenery) -> Verdict:
    cameras = s.reach.defocused
    reason = f"camera {_named(cameras)} has it" if cameras else "no camera of the run has it switched on"
    return Verdict(bool(cameras), reason, {}, {})


def _light_tree(s: Scenery) -> Verdict:
    n = s.reach.n_lights
    is_on = n > 1 or bool(s.reach.emitters)
    reason = f"{n} lights to choose among, glowing objects and the world included" if n > 1 else "a single light"
    if n == 1 and s.reach.emitters:
        reason = f"{_named(s.reach.emitters)} glows, which makes each of its faces a light"
    elif n == 0:
        reason = "there is no light"
    return Verdict(is_on, reason, {"use_light_tree": True}, {"use_light_tree": False})


def _environment_sampling(s: Scenery) -> Verdict:
    if not s.reach.world & Ability.EMISSION:
        return Verdict(False, "the world gives no light", {}, {})
    if not s.reach.world & Ability.VARYING_EMISSION:
        return Verdict(False, "the world is equally bright in all directions", {}, {})
    return Verdict(True, "the world is brighter in some directions than in others", {}, {})


def _denoising(s: Scenery) -> Verdict:
    off = {"use_denoising": False}
    if not s.has_denoiser:
        return Verdict(
            False,
            "this build of Blender has no OpenImageDenoise: noise may trigger estimates, more samples help",
            off,
            off,
        )
    if s.reach.n_lights == 0:
        return Verdict(False, "there is no light, so there is no noise", {}, off)
    return Verdict(True, "OpenImageDenoise cleans pictures; light probes are left as they are", {}, off)


def _fast_gi(s: Scenery) -> Verdict:
    asked = "the scene asks for it, but " if s.scene.cycles.use_fast_gi else ""
    reason = f"{asked}it only approximates bounces, and the ground truth must not"
    return Verdict(False, reason, {"use_fast_gi": True}, {"use_fast_gi": False})


RULES: dict[str, Callable[[Scenery], Verdict]] = {
    "diffuse bounces": _diffuse_bounces,
    "glossy bounces": _glossy_bounces,
    "transmission": _transmission,
    "transparency": _transparency,
    "volumes": _volumes,
    "reflective caustics": _reflective_caustics,
    "refractive caustics": _refractive_caustics,
    "subsurface": _subsurface,
    "hair": _hair,
    "displacement": _displacement,
    "motion blur": _motion_blur,
    "depth of field": _depth_of_field,
    "light tree": _light_tree,
    "environment sampling": _environment_sampling,
    "denoising": _denoising,
    "Fast GI": _fast_gi,
}


def _by_surface(
    s: Scenery,
    abilities: tuple[Ability, ...],
    kind: str,
    on: Mapping[str, Setting],
    off: Mapping[str, Setting],
    *,
    noun: str = "material",
) -> Verdict:
    """On where anything that light reaches has one of `abilities`."""
    found = s.reach.which(*abilities)
    reason = f"{kind}: {_named(found)}" if found else _none_reached(f"{kind} {noun}".strip())
    return Verdict(bool(found), reason, on, off)


def _none_reached(what: str) -> str:
    return f"no {what} is visible to the camera, the probes or the virtual objects"


def _named(found: Sequence[str]) -> str:
    """The first few, and how many more."""
    more = f" and {len(found) - N_NAMED} more" if len(found) > N_NAMED else ""
    return ", ".join(found[:N_NAMED]) + more
