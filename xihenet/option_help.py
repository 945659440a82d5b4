"""The help of a command line: options with their defaults, as docs/cli.md has them."""

from __future__ import annotations

import argparse


def default_of(action: argparse.Action) -> str:
    """What an option is if it is not given, "default: 0"; empty where there is nothing to say, or its help says it."""
    is_said = action.nargs == 0 or action.default in (None, "", [], ()) or "default" in (action.help or "")
    value = f"{action.default:g}" if isinstance(action.default, float) else action.default
    return "" if is_said else f"default: {value}"


class DefaultsHelp(argparse.HelpFormatter):
    """For `formatter_class` of a parser."""

    def _get_help_string(self, action: argparse.Action) -> str:
        return "; ".join(filter(None, (action.help, default_of(action)))).replace("%", "%%")
