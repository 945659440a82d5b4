"""Overrides: what the user wants on or off, whatever the scene requires. Kept in the .blend, as a custom property.

A custom property of the scene needs no registered class, survives without the add-on, and travels with append and copy.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import bpy

from xihe_blender.errors import UserError
from xihe_blender.light_transport.rules import RULES, SWITCHED_ELSEWHERE
from xihenet.phone import PHONE_EFFECTS

PROPERTY = "xihe_effects"
STATES = ("auto", "on", "off")


def remember_overrides(scene: bpy.types.Scene, overrides: Mapping[str, str]) -> None:
    """Write `overrides` (effect: "auto", "on" or "off") into `scene`; effects not named keep what they had.

    "auto" forgets an override. UserError for an unknown effect or state, or an effect that no scene setting switches.
    """
    kept = overrides_in_force(scene, overrides)
    if kept:
        scene[PROPERTY] = kept
    elif PROPERTY in scene:
        del scene[PROPERTY]


def remembered_overrides(scene: bpy.types.Scene) -> dict[str, str]:
    """{effect: "on" or "off"} as `scene` has it; empty without any. UserError if the property holds something else."""
    stored = scene.get(PROPERTY)
    if stored is None:
        return {}
    if not hasattr(stored, "to_dict"):
        raise UserError(f"scene property {PROPERTY!r} does not hold effects and their states: delete it")
    found = {str(name): str(state) for name, state in stored.to_dict().items()}
    for name in found:
        if name not in RULES and name not in PHONE_EFFECTS:
            raise UserError(f"scene property {PROPERTY!r} has an effect of an older version, {name!r}: delete it")
    return found


def overrides_in_force(scene: bpy.types.Scene, overrides: Mapping[str, str]) -> dict[str, str]:
    """`checked`: `overrides` win over what `scene` remembers, of which "auto" makes nothing. UserError as of there."""
    return checked({**remembered_overrides(scene), **overrides})


def parsed_overrides(texts: Iterable[str]) -> dict[str, str]:
    """{effect: state} of texts such as "motion blur=off", as typed; UserError for what is no such text or unknown."""
    overrides = {}
    for text in texts:
        name, equals, state = (part.strip() for part in text.partition("="))
        if not (name and equals and state):
            raise UserError(f"{text!r} is no effect and its state: give NAME=on, NAME=off or NAME=auto")
        overrides[name] = state
    checked(overrides)
    return overrides


def checked(overrides: Mapping[str, str]) -> dict[str, str]:
    """`overrides` without those that are "auto". UserError for what is unknown or cannot be switched."""
    for name, state in overrides.items():
        if name not in RULES and name not in PHONE_EFFECTS:
            raise UserError(f"there is no effect {name!r}: choose among {', '.join((*RULES, *PHONE_EFFECTS))}")
        if state not in STATES:
            raise UserError(f"effect {name!r} cannot be {state!r}: choose auto, on or off")
        elsewhere = SWITCHED_ELSEWHERE.get(name)
        if elsewhere is not None and state != "auto":
            raise UserError(f"{name} cannot be switched for a whole scene: leave it on auto, and change {elsewhere}")
    return {name: state for name, state in overrides.items() if state != "auto"}
