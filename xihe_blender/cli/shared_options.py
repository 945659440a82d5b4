"""Options that several commands share."""

from __future__ import annotations

from typing import Any

from xihenet.phone import LINKS, profile_names

OVERRIDE: dict[str, Any] = {
    "dest": "overrides",
    "action": "append",
    "default": [],
    "metavar": "NAME=on|off|auto",
    "help": "an effect, whatever the scene calls for; may be repeated, is not saved",
}
PHONE: dict[str, Any] = {"default": "perfect", "metavar": "NAME|FILE.toml", "help": ", ".join(profile_names())}
NETWORK: dict[str, Any] = {"metavar": "NAME", "help": ", ".join(LINKS) + "; default: estimates arrive at once"}
