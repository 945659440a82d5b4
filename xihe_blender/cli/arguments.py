"""Options of `xihe`: how they are added to a parser, what typed text means, those that several commands share.

For argparse, whose one line to the user is that of the ArgumentTypeError.
"""

from __future__ import annotations

import argparse
import inspect
import math
import re
from collections.abc import Callable, Iterable
from glob import glob
from pathlib import Path
from typing import Any, TypeVar

from xihe_blender.errors import UserError
from xihe_blender.previs import presets
from xihe_blender.previs.presets import PRESETS
from xihenet import estimators
from xihenet.camera import DEFAULT_SIZE
from xihenet.io.frame_files import BLENDER_FROM_UP
from xihenet.phone import LINKS, profile_names
from xihenet.trigger import NAMED_RULES

MAX_FRAME = 1048574
Position = tuple[float, float, float]
Settings = TypeVar("Settings")


def adder(parser: argparse._ActionsContainer) -> Callable[..., None]:
    """A function that adds arguments to `parser`, as docs/cli.md shows them: `add("--out DIR", "folder", Path)`.

    Without a word for its value an argument is a switch, or has `choices`; what else is given goes to argparse.
    """

    def add(argument: str, words: str, kind: Callable[[str], object] = str, **more: Any) -> None:
        name, _, value = argument.partition(" ")
        if value:
            more |= {"metavar": value, "type": kind}
        parser.add_argument(name, help=words, **more)

    return add


def add_scene(add: Callable[..., None], out: str) -> None:
    """The arguments of all commands that work on one scene; `out` says what --out is the folder of."""
    add("scene SCENE.blend", SCENE, Path)
    add("--out DIR", out, Path, required=True)


def add_capture(add: Callable[..., None], *, has_estimator: bool = True) -> None:
    """The arguments of all commands that capture the camera path of one scene, and estimate light from it or not."""
    add("--frames A:B[:S]", FRAMES, frame_range)
    if has_estimator:
        add("--estimator NAME", f"{ESTIMATORS}; default: {estimators.DEFAULT}", default=estimators.DEFAULT)
    add("--preset NAME", PRESET, default=presets.DEFAULT)
    add("--size WxH", SIZE, picture_size)
    add("--exposure FACTOR", "exposure of the phone, locked; default: metered", float)
    add("--phone NAME|FILE.toml", PHONES, default="perfect")
    add("--seed N", "the same seed gives the same numbers", int, default=0)


def add_recording(add: Callable[..., None]) -> None:
    """The arguments of all commands that read a recording: what it does not say of itself, or says wrongly."""
    add("--up AXIS", UP, choices=tuple(BLENDER_FROM_UP))
    add("--scale FACTOR", "factor on all lengths of the recording; default: 1", float, default=1.0)
    add("--floor HEIGHT", "height of the floor in the scaled recording, in metres, which becomes 0", float, default=0.0)


def settings_from(options: argparse.Namespace, kind: Callable[..., Settings], **others: Any) -> Settings:
    """The settings record `kind` with all options that are named as its fields are, and `others`."""
    fields = inspect.signature(kind).parameters
    return kind(**{name: value for name, value in vars(options).items() if name in fields} | others)


def check_one_kind_of_workers(n_workers: int | None, scheduler: str | None) -> None:
    """UserError where both are given."""
    if n_workers is not None and scheduler is not None:
        raise UserError("--workers are processes on this machine, and --scheduler has workers of its own: give one")


def files(given: Iterable[Path]) -> list[Path]:
    """The files that were given, where a shell of Windows has left a pattern such as *.blend as it is."""
    found = [[path] if path.exists() else sorted(glob(str(path))) or [path] for path in given]  # noqa: PTH207
    return [Path(one) for of_one in found for one in of_one]


def frame_range(text: str) -> tuple[int, ...]:
    """Frames of "A:B" or "A:B:S", both ends included, or of "A" alone."""
    match = re.fullmatch(r"(-?\d+)(?::(-?\d+)(?::(\d+))?)?", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a range of frames: give A:B or A:B:S, such as 1:24:2")
    first, last, step = int(match[1]), int(match[2] or match[1]), int(match[3] or 1)
    if step == 0:
        raise argparse.ArgumentTypeError(f"{text!r} has a step of 0: give 1 or more")
    if max(abs(first), abs(last)) > MAX_FRAME:
        raise argparse.ArgumentTypeError(f"{text!r} goes beyond Blender's last frame, {MAX_FRAME}")
    return tuple(range(first, last + 1, step))


def picture_size(text: str) -> tuple[int, int]:
    """(width, height) of "WxH"."""
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a picture size: give WxH, such as 256x192")
    return int(match[1]), int(match[2])


def position(text: str) -> Position:
    """Three finite numbers of "X,Y,Z"."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a position: give X,Y,Z in metres, such as 0.5,1.2,0.8")
    return x, y, z


def as_given(at: Position) -> str:
    """What `position` reads, with as many digits as say millimetres in the coordinates of a map."""
    return ",".join(f"{coordinate:.10g}" for coordinate in at)


def names(text: str) -> tuple[str, ...]:
    """Those of "A,B"; spaces around them and empty ones do not count.

    In double quotes, each of its own doubled, a name may have commas, and spaces at its ends: see `format_names`.
    """
    found = re.findall(r'\s*(?:"((?:[^"]|"")*)"|([^,]*?))\s*(?:,|\Z)', text)
    return tuple(quoted.replace('""', '"') or plain for quoted, plain in found if quoted or plain)


def whole_numbers(text: str) -> tuple[int, ...]:
    """Those of "N,M"."""
    try:
        return tuple(int(number) for number in names(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: give whole numbers with commas between them") from error


def one_of(names: Iterable[str]) -> str:
    """Names to choose from: "wifi, home or lte"."""
    *most, last = names
    return f"{', '.join(most)} or {last}"


def by_preset(name: str) -> str:
    """A default that each preset has for itself: "4, 16 or 64, by preset"."""
    return f"{one_of(f'{getattr(preset, name):g}' for preset in PRESETS.values())}, by preset"


BACKEND = "estimate by the edge service at this address, such as http://127.0.0.1:8550, instead of here; see xihe serve"
BETWEEN = "light in use until the next estimate: carried, as the light in view changes (default), or kept as estimated"
TRIGGER = "when light is estimated again: " + "; ".join(
    f"{name}, {rule.summary[0].lower()}{rule.summary[1:]}" for name, rule in NAMED_RULES.items()
)
EFFECT = "simulate an effect or leave it out, whatever the scene needs; may be repeated, is not saved"
ESTIMATORS = one_of(estimators.names())
FRAMES = "frames of the path; default: the scene's range and step"
LIGHT = (
    "what objects are lit with: sh, sh+key (the dominant light as a sun with a shadow), or sh+key+reflections (metal "
    "and glass show what the phone saw besides)"
)
OBJECTS = 'virtual objects, with quotes around a name that has a comma: "A, B"; default: all'
NETWORK = f"{one_of(LINKS)}: estimates arrive late; default: at once"
PRESET = f"{one_of(PRESETS)}: how much is rendered"
PHONES = one_of([*profile_names(), "your own file"])
SAMPLES = f"samples of every capture; default: {by_preset('path_samples')}"
SCENE = "scene with an animated camera"
SIZE = "size of captured pictures; default: {0}x{1}, or {1}x{0} if the scene is upright".format(*DEFAULT_SIZE)
UP = "axis of the recording's world that points up; default: the usual one of its format"
TARGET = "light to estimate and to compare with: all of it (hdr, the default) or clipped at white (ldr)"
