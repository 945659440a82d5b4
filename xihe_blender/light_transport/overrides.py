"""What does the user want on or off, whatever the scene calls for? Kept in the .blend, as a custom property.

A custom property of the scene needs no registered class, survives without the add-on, and travels with append and copy.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import bpy

from xihe_blender.errors import UserError
from xihenet.phone import EFFECTS

PROPERTY = "xihe_effects"
STATES = ("auto", "on", "off")
NETWORK = "network"
PHONE_EFFECTS = (*EFFECTS, NETWORK)
"""Of the phone and the session; planned elsewhere, chosen and remembered with the rest."""

SWITCHED_ELSEWHERE: dict[str, str | None] = {
    "diffuse bounces": None,
    "glossy bounces": None,
    "transmission": None,
    "transparency": None,
    "volumes": None,
    "reflective caustics": None,
    "refractive caustics": None,
    "subsurface": "the materials' subsurface weight",
    "hair": "what the objects' particle or hair settings render",
    "displacement": "the materials' displacement method",
    "motion blur": None,
    "depth of field": "the camera's depth of field",
    "light tree": None,
    "environment sampling": "the sampling in the world's settings",
    "denoising": None,
    "Fast GI": None,
}
"""All effects of light transport; for those that no setting of a scene switches, what does."""


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
    return {str(name): str(state) for name, state in stored.to_dict().items()}


def overrides_in_force(scene: bpy.types.Scene, overrides: Mapping[str, str]) -> dict[str, str]:
    """{effect: "on" or "off"}: `overrides` win over what `scene` remembers, of which "auto" makes nothing.

    UserError as of `checked`.
    """
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
        if name not in (*SWITCHED_ELSEWHERE, *PHONE_EFFECTS):
            raise UserError(
                f"there is no effect {name!r}: choose among {', '.join((*SWITCHED_ELSEWHERE, *PHONE_EFFECTS))}"
            )
        if state not in STATES:
            raise UserError(f"effect {name!r} cannot be {state!r}: choose auto, on or off")
        elsewhere = SWITCHED_ELSEWHERE.get(name)
        if elsewhere is not None and state != "auto":
            raise UserError(f"{name} cannot be switched for a whole scene: leave it on auto, and change {elsewhere}")
    return {name: state for name, state in overrides.items() if state != "auto"}
