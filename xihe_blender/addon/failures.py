"""Failures of operators: said in one line, and kept as the last error of the panel."""

from __future__ import annotations

import re
from collections.abc import Callable

import bpy

from xihe_blender.addon.polls import Conditional
from xihe_blender.errors import UserError

FAILURES = (UserError, OSError, ReferenceError)
"""What a user can mend; anything else is a mistake of ours, and its traceback should be seen."""

IN_THE_PANEL = {
    "--estimator": "Estimator",
    "--exposure": "Own Exposure",
    "--backend": "Edge Server",
    "--light": "Light",
    "--others": "Compare With",
    "--frames": "Own Frames",
    "--size": "Own Size",
    "--height": "Height",
    "--network": "Network",
    "choose another folder for --out": "run again, with a Runs Folder that can be written to",
    "--phone": "Phone",
    "run xihe previs": "run",
    ", or give a larger --reach": "",
}
"""What the panel calls a command or an option of the command line, in whose words the work speaks. What it does not
have is left out."""


def format_error(error: BaseException) -> str:
    """`error` in one line."""
    if isinstance(error, ReferenceError):
        return "The scene or one of its objects was deleted meanwhile: try again"
    if isinstance(error, OSError) and error.strerror:
        place = "" if error.filename is None else f"{error.filename}: "
        return f"{place}{error.strerror}"
    return in_the_panels_words(" ".join(str(error).split()))


def in_the_panels_words(line: str) -> str:
    """`line` with what the panel calls the command line's commands and options."""
    words = "|".join(map(re.escape, IN_THE_PANEL))
    return re.sub(rf"({words})(?![a-z])", lambda found: IN_THE_PANEL[found[0]], line)


def failed(operator: bpy.types.Operator, context: bpy.types.Context, error: BaseException) -> set[str]:
    """Report `error` and give what the operator returns."""
    line = format_error(error)
    context.window_manager.xihe.error = line
    operator.report({"ERROR"}, line[:1].upper() + line[1:])
    return {"CANCELLED"}


class Action(Conditional):
    """Base of operators that are done at once."""

    report: Callable[[set[str], str], None]
    """Of bpy.types.Operator."""

    def act(self, context: bpy.types.Context) -> str | None:
        """Do it; what is to be said of it, if anything. One of FAILURES for what cannot be done."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            said = self.act(context)
        except FAILURES as error:
            return failed(self, context, error)
        # What went wrong before is mended, or of no interest any more.
        context.window_manager.xihe.error = ""
        if said:
            self.report({"INFO"}, said)
        return {"FINISHED"}
