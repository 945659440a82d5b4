"""What can be chosen in the panel's lists, where the science knows it?

Blender keeps an enum as a number. The number of an item is made from its name, so that a saved file keeps its choice
when a list grows. Lists are made once and kept: Blender does not hold on to the texts that a callback hands out.
"""

from __future__ import annotations

import functools
import zlib
from typing import TypeAlias

import bpy

Item: TypeAlias = tuple[str, str, str, str, int]

DEFAULT_ESTIMATOR = "lattice"
DEFAULT_PHONE = "perfect"
FROM_FILE = "FILE"
NO_NETWORK = "NONE"

PRESETS = (
    ("draft", "Draft", "Few samples, every second frame compared: minutes on a laptop"),
    ("balanced", "Balanced", "Noise that does not show beside the error of an estimate"),
    ("accurate", "Accurate", "As little noise as ground truth should have; takes long"),
)
TARGETS = (
    ("ldr", "Clipped Light", "Coefficients are held against light clipped at white, as a phone's picture has it"),
    ("hdr", "All Light", "Coefficients are held against all of the light"),
)
PHONES_METERING = "PHONE"
METERINGS = (
    (PHONES_METERING, "As the Phone", "As the phone's profile says"),
    ("highlights", "Highlights", "Darker until hardly anything is clipped at white, as phones do"),
    ("key", "Key", "Brings the picture to a middle grey, whatever is lost above white"),
)
OVERRIDES = (
    ("AUTO", "Auto", "On where the scene calls for it"),
    ("ON", "On", "Simulated, whatever the scene calls for"),
    ("OFF", "Off", "Left out, whatever the scene calls for"),
)
_ESTIMATORS = {
    "ambient": (
        "Ambient",
        "Brightness and colour alone, the same from all sides, as phones without estimation have it",
    ),
    "projection": ("Projection", "Least squares on what was seen of the surroundings; nothing learned"),
    "pointar": ("PointAR", "A learned estimate from points chosen at random; needs torch"),
    "xihenet": ("XiheNet", "The paper's learned estimate from the unit sphere; needs torch"),
    "lattice": ("Lattice", "The learned estimate that is shipped: a millisecond, and nothing to install"),
    "truth": ("Ground Truth", "No estimate: the light that is really there, as a bound"),
}
_NETWORKS = {
    "wifi": ("Wi-Fi", "An edge server over a university's Wi-Fi"),
    "home": ("Home Wi-Fi", "An edge server over Wi-Fi at home"),
    "lte": ("LTE", "An edge server over a mobile network"),
}


def number_of(name: str) -> int:
    """The number by which Blender stores the choice `name`."""
    return zlib.crc32(name.encode()) & 0x7FFFFFFF


def estimator_items(_owner: object, _context: bpy.types.Context | None) -> list[Item]:
    return _estimators()


def phone_items(_owner: object, _context: bpy.types.Context | None) -> list[Item]:
    return _phones()


def network_items(_owner: object, _context: bpy.types.Context | None) -> list[Item]:
    return _networks()


@functools.cache
def _estimators() -> list[Item]:
    from xihenet.estimators import names

    return [_item(name, *_ESTIMATORS.get(name, (name, "An estimator")), "LIGHT_SUN") for name in names()]


@functools.cache
def _phones() -> list[Item]:
    from xihenet.phone import load_profile, profile_names

    profiles = [(name, load_profile(name)) for name in profile_names()]
    items = [_item(name, profile.name, profile.summary, "OUTLINER_DATA_CAMERA") for name, profile in profiles]
    return [*items, _item(FROM_FILE, "From File", "A phone of your own, described in a TOML file", "FILE")]


@functools.cache
def _networks() -> list[Item]:
    from xihenet.phone import LINKS

    none = _item(NO_NETWORK, "On the Phone", "Estimates are there at once, in their own frame", "BLANK1")
    return [none, *(_item(name, *_NETWORKS.get(name, (name, "A network")), "WORLD") for name in LINKS)]


def _item(name: str, label: str, description: str, icon: str) -> Item:
    return name, label, description, icon, number_of(name)
