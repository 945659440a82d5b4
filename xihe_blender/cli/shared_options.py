"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from xihenet import estimators
from xihenet.phone import LINKS, profile_names

SIZE = "size of captured pictures; default: 256x192, or 192x256 if the scene is upright"
TARGET = "light to compare coefficients with: clipped at white (ldr, the default) or all of it (hdr)"


def one_of(names: Iterable[str]) -> str:
    """Names to choose from: "wifi, home or lte"."""
    *most, last = names
    return f"{', '.join(most)} or {last}"


ESTIMATORS = one_of(estimators.names())
ESTIMATOR = f"{ESTIMATORS}; default: {estimators.DEFAULT}"
OVERRIDE: dict[str, Any] = {
    "dest": "overrides",
    "action": "append",
    "default": [],
    "metavar": "NAME=on|off|auto",
    "help": "simulate an effect or leave it out, whatever the scene needs; may be repeated, is not saved",
}
PHONE: dict[str, Any] = {
    "default": "perfect",
    "metavar": "NAME|FILE.toml",
    "help": one_of([*profile_names(), "your own file"]),
}
NETWORK: dict[str, Any] = {"metavar": "NAME", "help": f"{one_of(LINKS)}: estimates arrive late; default: at once"}
