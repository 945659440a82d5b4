"""The choices of the panel's lists: what can be chosen, where the science knows it?

Blender keeps an enum as a number. The number of an item is made from its name, so that a saved file keeps its choice
when a list grows. Lists are made once and kept: Blender does not hold on to the texts that a callback hands out.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable
from typing import TypeAlias

import bpy

Item: TypeAlias = tuple[str, str, str, str, int]

DEFAULT_ESTIMATOR = "lattice"
DEFAULT_PHONE = "perfect"
DEFAULT_PRESET = "balanced"
FROM_FILE = "FILE"
NO_NETWORK = "NONE"

TARGETS = (
    (
        "hdr",
        "All Light",
        "Estimate all of the light, also what is brighter than white: objects are as bright as they are",
    ),
    ("ldr", "Clipped Light", "Estimate light clipped at white, as in a phone's picture, and as the paper does"),
)
LIGHT_PARTS = (
    ("auto", "As Objects Need", "A key light with its shadow, and reflections if a virtual object is shiny"),
    ("sh", "Soft Light", "All of it as spherical harmonics: light without a sharp shadow"),
    ("sh+key", "Soft Light and Key Light", "The dominant light as a sun with a shadow, the rest as soft light"),
    (
        "sh+key+reflections",
        "Soft Light, Key Light and Reflections",
        "Metal and glass reflect what the phone has seen besides",
    ),
)
USUAL_TRIGGER = "USUAL"
PHONES_METERING = "PHONE"
METERINGS = (
    (PHONES_METERING, "As the Phone", "Meter as the phone's profile says"),
    ("highlights", "Highlights", "Darken the picture until hardly anything is clipped at white, as phones do"),
    ("key", "Key", "Expose for a middle grey, even if highlights are clipped"),
)
OVERRIDES = (
    ("AUTO", "Auto", "Simulated if the scene needs it"),
    ("ON", "On", "Always simulated, even if the scene does not need it"),
    ("OFF", "Off", "Never simulated, even if the scene needs it"),
)


IN_EARLIER_FILES = {"draft": 0, "balanced": 1, "accurate": 2} | {
    name: place for place, name in enumerate(("split", "light", "reference", "every-frame", USUAL_TRIGGER))
}
"""Numbers of the choices whose lists had places before they had names."""


def number_of(name: str) -> int:
    """The number by which Blender stores the choice `name`."""
    return IN_EARLIER_FILES.get(name, zlib.crc32(name.encode()) & 0x7FFFFFFF)


def _listed(make: Callable[[], list[Item]]) -> Callable[[object, bpy.types.Context | None], list[Item]]:
    """`make` as Blender calls what lists the items of an enum; it is called once."""
    made = functools.cache(make)

    def items(_owner: object, _context: bpy.types.Context | None) -> list[Item]:
        return made()

    return items


@_listed
def estimator_items() -> list[Item]:
    from xihenet.estimators import label, names, summary

    return [_item(name, label(name), summary(name), "LIGHT_SUN") for name in names()]


@_listed
def other_estimator_items() -> list[Item]:
    """Those that can be compared with the chosen one; a bit each, as several may be chosen."""
    from xihenet.estimators import IN_EVERY_RUN

    items = [item for item in estimator_items(None, None) if item[0] not in IN_EVERY_RUN]
    return [(*item[:3], "NONE", 1 << bit) for bit, item in enumerate(items)]


@_listed
def preset_items() -> list[Item]:
    from xihe_blender.previs.presets import PRESETS

    return [_item(name, preset.label, preset.summary, "NONE") for name, preset in PRESETS.items()]


@_listed
def trigger_items() -> list[Item]:
    from xihenet.trigger import NAMED_RULES

    usual = "As It Changes does; on a phone's recording, by the trigger that it was made with"
    rules = [_item(name, rule.label, rule.summary, "NONE") for name, rule in NAMED_RULES.items()]
    return [*rules, _item(USUAL_TRIGGER, "As Usual", usual, "NONE")]


@_listed
def phone_items() -> list[Item]:
    from xihenet.phone import load_profile, profile_names

    profiles = [(name, load_profile(name)) for name in profile_names()]
    items = [_item(name, profile.name, profile.summary, "OUTLINER_DATA_CAMERA") for name, profile in profiles]
    return [*items, _item(FROM_FILE, "From File", "A phone of your own, described in a TOML file", "FILE")]


@_listed
def platform_items() -> list[Item]:
    from xihenet.light.platforms import PLATFORMS

    return [_item(name, one.title, "", "EXPORT") for name, one in PLATFORMS.items()]


@_listed
def network_items() -> list[Item]:
    from xihenet.phone import LINKS

    none = _item(NO_NETWORK, "On the Phone", "Estimates arrive at once, in the frame that they are made from", "BLANK1")
    return [none, *(_item(name, link.label, link.summary, "WORLD") for name, link in LINKS.items())]


def _item(name: str, label: str, description: str, icon: str) -> Item:
    return name, label, description, icon, number_of(name)
