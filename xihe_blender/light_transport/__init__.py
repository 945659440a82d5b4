"""Light transport: the effects that a scene requires, and why; planned, measured, and set on a working scene."""

from xihe_blender.light_transport.overrides import remember_overrides, remembered_overrides
from xihe_blender.light_transport.plan import cycles_settings, required_effects

__all__ = ["cycles_settings", "remember_overrides", "remembered_overrides", "required_effects"]
