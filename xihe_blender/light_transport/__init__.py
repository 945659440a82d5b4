"""Which effects of light transport does a scene call for, and why? Planned, said, and applied to a working scene."""

from xihe_blender.light_transport.overrides import remember_overrides, remembered_overrides
from xihe_blender.light_transport.plan import Effect, EffectPlan, plan_effects

__all__ = ["Effect", "EffectPlan", "plan_effects", "remember_overrides", "remembered_overrides"]
