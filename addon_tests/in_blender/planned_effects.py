"""Plans of light transport that tests hold scenes against: by the rules and choices, and with every effect on."""

from dataclasses import replace

from xihe_blender.light_transport import required_effects
from xihe_blender.light_transport.enclosure import MAX_BOUNCES
from xihe_blender.light_transport.overrides import overrides_in_force
from xihenet.effects import plan_effects


def plan_light_transport(scene, positions=(), *, frames=None, overrides=None):
    """The effects of light transport in a run, by `required_effects` and `overrides_in_force`."""
    choices = overrides_in_force(scene, overrides or {})
    return plan_effects(required_effects(scene, positions, frames=frames), choices)


def everything_on(scene, required):
    """The plan to hold others against: every effect that a setting switches is on, with all bounces there are.

    Off stay Fast GI, which replaces bounces, and motion blur where `scene` has it off: a look, not an effect missed.
    """
    left_out = {"Fast GI"} if scene.render.use_motion_blur else {"Fast GI", "motion blur"}
    effects = plan_effects(required, {name: "off" if name in left_out else "on" for name in required})
    effects["diffuse bounces"] = replace(effects["diffuse bounces"], parameters={"diffuse_bounces": MAX_BOUNCES})
    return effects
