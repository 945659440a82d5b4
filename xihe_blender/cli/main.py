"""The `xihe` command: what a user types, turned into calls of the functions that do the work.

Each sub-command is a file of this folder, found by its name and imported when it is typed: `add_arguments` says what it
takes, `run` does it. Exit codes: 0 the job was done; 1 a part of it could not be, and each is named; 2 the user can
mend it, and one line says how; 130 after Ctrl-C, and the same command resumes, but for `serve`: 0.
"""

from __future__ import annotations

import argparse
import importlib
import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from xihe_blender.cli.progress import EXIT_INTERRUPTED, EXIT_USER_ERROR, notes_on
from xihe_blender.errors import UserError, format_disk_error
from xihe_blender.io.blender_output import blender_output_aside, exit_code_of, leave_blender, open_closed_streams
from xihenet import __version__
from xihenet.option_help import DefaultsHelp

COMMANDS = {
    "previs": "preview a phone's estimated lighting beside path-traced ground truth",
    "placement": "map where in a room AR light will be right, and where it will fail",
    "budget": "divide an object's error among the parts of the chain, and say what would help most",
    "look": "say where the phone should look for a second to know the light better",
    "video": "save a video of a run: captured pictures, ground truth and estimate side by side",
    "effects": "list the lighting and phone effects that a scene needs, and why",
    "frontier": "measure what accuracy costs in time, setting by setting",
    "paper": "repeat the paper's evaluation, each figure beside the paper's",
    "estimate": "estimate the light in one RGB-D frame; needs no Blender",
    "record": "record the camera path of a scene as a phone would store it, and the true light beside it",
    "replay": "follow the light at places in a recording of a phone or depth camera; needs no Blender",
    "import": "make a .blend of a recording of a phone: its camera, its pictures and a scan of what they show",
    "export": "write the light of a run for an engine, such as three.js, Unity or USD; needs no Blender",
    "serve": "answer phones with the light of what they have seen, over HTTP; needs no Blender",
    "scenes": "build the example scenes",
    "dataset": "make rooms to train estimators on",
    "package": "build the Blender extension as a zip from a checkout; needs no Blender",
    "evaluate": "compare estimators and phones over many scenes and seeds",
    "train": "train the estimators' networks and measure them; needs torch",
}

MODULES = {"import": "import_capture"}
"""Files whose commands are words of Python."""

RENDER = ("previs", "placement", "budget", "look", "effects", "frontier", "paper", "record", "evaluate")
"""Commands that render a user's scenes with Cycles."""

CYCLES_DEVICE = (
    "kind of device that Cycles renders on: CPU, or OPTIX, CUDA, HIP, ONEAPI or METAL for a graphics card; default: "
    "XIHE_CYCLES_DEVICE in the environment, or else Blender's preferences"
)
KERNELS = "Cycles renders on {cards}; the first render on a card can take minutes longer, until its kernels are built"

NEEDS_BLENDER = (
    "this command needs Blender: with Python 3.11 or 3.13 pip install 'xihe-blender[blender]', or install the "
    "extension and type blender --command xihe instead of xihe"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    typed = list(sys.argv[1:] if arguments is None else arguments)
    open_closed_streams()
    try:
        if typed[:1] == ["train"]:
            return _train(typed[1:])
        options = command_parser(typed[0] if typed else "").parse_args(with_positions_bound(typed))
        options.command_line = shlex.join(["xihe", *typed])
        with blender_output_aside() as (stdout, stderr), notes_on(stderr):
            if getattr(options, "cycles_device", None):
                from xihe_blender.capture.cycles_device import choose_device

                if cards := choose_device(options.cycles_device):
                    print(KERNELS.format(cards=", ".join(cards)), file=stderr, flush=True)
            code = options.run(options, stdout, stderr)
    except UserError as error:
        return _failed(str(error))
    except ModuleNotFoundError as error:
        if error.name not in ("bpy", "mathutils", "bmesh"):
            raise
        return _failed(NEEDS_BLENDER)
    except OSError as error:
        after = ";" if error.errno is None else ","
        return _failed(f"{format_disk_error(error)}{after} then run the same command again to resume")
    except KeyboardInterrupt:
        # On a terminal the line of progress, with "^C" at its end, stands there unfinished.
        start = "\n" if sys.stderr.isatty() else ""
        print(f"{start}xihe: stopped; run the same command again to resume", file=sys.stderr)
        return EXIT_INTERRUPTED
    return code or 0


def command(arguments: Sequence[str] | None = None) -> NoReturn:
    """`main` as a program, which ends with its exit code, after an error of ours as well."""
    code = exit_code_of(lambda: main(arguments))
    if "bpy" in sys.modules:
        leave_blender(code)
    sys.exit(code)


def _train(typed: Sequence[str]) -> int:
    """`xihe train` has its own command line, which needs torch and no Blender; UserError without torch."""
    try:
        from xihenet.training.__main__ import main as train
    except ImportError as error:
        raise UserError("train: torch is not installed: pip install 'xihe-blender[train]'") from error
    return train(typed)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the usage that hides it."""

    command = ""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"formatter_class": DefaultsHelp} | options)
        for kind, read in ((Path, _path), (float, _number), (int, _whole_number)):
            self.register("type", kind, read)

    def error(self, message: str) -> NoReturn:
        raise UserError(f"{message}; see {self.prog} {self.command}".rstrip() + " --help")


def command_parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser of `xihe`, with the options of one sub-command or, without its name, of all."""
    parser = _Parser(prog="xihe", description="AR lighting previsualisation in Blender.")
    parser.add_argument("--version", action="version", version=f"xihe {__version__}")
    summaries = COMMANDS
    if command in COMMANDS:  # What a command does not know is refused here, not by its own parser.
        parser.command = command
        summaries = {command: COMMANDS[command]}  # All of them take 10 ms.
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, summary in summaries.items():
        of_command = commands.add_parser(name, help=summary)
        if name != "train" and command in (None, name):
            module = importlib.import_module(f"{__package__}.{MODULES.get(name, name)}")
            module.add_arguments(of_command)
            of_command.set_defaults(run=module.run)
            if name in RENDER:
                of_command.add_argument("--cycles-device", metavar="KIND", help=CYCLES_DEVICE)
    return parser


def with_positions_bound(typed: Sequence[str]) -> list[str]:
    """`typed` with "--at", "-1,0,2" as one word, and frames as well: what begins with a minus looks like an option."""
    bound: list[str] = []
    for word in typed:
        if bound and bound[-1] in ("--at", "--frames") and re.match(r"-[\d.]", word):
            bound[-1] += f"={word}"
        else:
            bound.append(word)
    return bound


def _path(text: str) -> Path:
    """The file or folder `text`; "~" is the home folder in "--out=~/runs" too, where no shell puts it in.

    Nothing is refused: it would be the folder that the command is typed in.
    """
    if not text:
        raise argparse.ArgumentTypeError("'' is no path: give a file or folder, or . for the folder that you are in")
    try:
        return Path(text).expanduser()
    except RuntimeError:  # Of nobody's home, such as that of "~x".
        return Path(text)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number: give one such as 0.5, with a point") from error


def _whole_number(text: str) -> int:
    try:
        return int(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number: give one such as 8") from error


def _failed(message: str) -> int:
    print(f"xihe: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_USER_ERROR
