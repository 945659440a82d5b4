"""The outputs of a run: which files does it leave, and where? Every name is known before the run starts.

`RunOutputs` names them all; nothing else in the project builds an output path. Files are written beside their place and
renamed, so that a name that exists is a file that is whole.

Nothing here needs NumPy, since the panel looks for these files too; only a picture that is written does.
"""

from __future__ import annotations

import contextlib
import csv
import functools
import json
import math
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xihe_blender.errors import UserError
from xihenet.io.whole_files import written_whole

if TYPE_CHECKING:
    from xihenet.records import ArrayF32, ArrayF64, ArrayU8

MAX_STEM = 40
"""Characters of an object's name in a file name: Blender 5 allows 255 bytes, as much as a whole file name may have."""

MAX_STEM_BYTES = 64
"""Of a scene's file in the names of what is made of it: Windows refuses paths of more than 260 characters, and the
panel's runs have it in the names of their folder and of a file in that."""


def _at(*parts: str) -> functools.cached_property[Path]:
    return functools.cached_property(lambda outputs: outputs.folder.joinpath(*parts))


def _of_frame(kind: str, suffix: str) -> Callable[[RunOutputs, int], Path]:
    """A method that names the file of a frame in the work folder, by its number."""
    return lambda outputs, frame: outputs.folder / "work" / f"{kind}_{frame:04d}.{suffix}"


@dataclass(frozen=True)
class RunOutputs:
    """The files of one run below `folder`. `scene` is the stem of the .blend, by which the lit one is named."""

    folder: Path
    scene: str = ""

    results = _at("results.json")
    report = _at("report.html")
    session = _at("session.json")  # what the phone saw, for `xihe replay`
    side_by_side = _at("side_by_side.mp4")  # on request
    composited = _at("composited.mp4")  # of a recording
    settings = _at("work", "settings.json")  # of the work below: a run resumes only where they are the same
    # What a resumed run takes over: the exposure that was metered, the plan of effects that renders go by, the numbers
    # of samples, and what is known of each frame before any is captured.
    exposure = _at("work", "exposure.json")
    effects = _at("work", "effects.json")
    sample_count = _at("work", "sample_count.json")
    survey = _at("work", "survey.json")
    # Of a run in a Blender of its own: what it is to do, how far it is or why it failed, what is held by the Blender
    # that works on it, and all that this one printed.
    request = _at("work", "request.json")
    progress = _at("work", "progress.json")
    lock = _at("work", "lock")
    console = _at("work", "console.txt")

    # Of one frame each: colour and plane depth as captured, and as a phone with flaws saw them; what a range sensor
    # meets in each pixel, only for phones that ask; the seconds that rendering the capture took; path-traced radiance
    # until it is compared; metrics. Times and metrics are written last, so that their presence says that the capture,
    # or its pictures, are whole.
    capture = _of_frame("capture", "exr")
    seen = _of_frame("seen", "exr")
    surfaces = _of_frame("surfaces", "npz")
    times = _of_frame("times", "json")
    ground_truth = _of_frame("ground_truth", "npz")
    compared = _of_frame("compared", "json")

    @property
    def lit_blend(self) -> Path:
        return self.folder / f"{cut_stem(self.scene)}_lit.blend"

    def probe(self, index: int, name: str, frame: int) -> Path:
        """Radiance panorama of the light probe at one estimation position, the `index`-th of the run."""
        return self.folder / "radiance" / f"probe_{index}_{_file_stem(name)}_{frame:04d}.exr"

    def mirror_ball(self, index: int, name: str, frame: int) -> Path:
        """What glossy rays see at one estimation position, as a mirror ball's picture."""
        return self.folder / "radiance" / f"mirror_{index}_{_file_stem(name)}_{frame:04d}.exr"

    def reflections(self, index: int, name: str, number: int) -> Path:
        """The `number`-th picture that the glossy parts of virtual object `name`, the `index`-th, reflect."""
        return self.folder / "reflections" / f"{index}_{_file_stem(name)}_{number:04d}.exr"

    def reference(self, index: int, name: str, frame: int) -> Path:
        """Coefficients of the reference light at one estimation position, the `index`-th of the run."""
        return self.folder / "work" / f"reference_{index}_{_file_stem(name)}_{frame:04d}.json"

    def radiance(self, method: str, frame: int) -> Path:
        """Linear picture of one method, of "ground_truth", or "captured" for phones that expose by themselves."""
        return self.folder / "radiance" / f"{method}_{frame:04d}.exr"

    def picture(self, kind: str, frame: int) -> Path:
        """sRGB picture: "captured", "ground_truth", a method, or "error_" and a method."""
        return self.folder / "pictures" / f"{kind}_{frame:04d}.png"

    def relative(self, path: Path) -> str:
        """`path` as results.json names it: relative to the run's folder, with forward slashes."""
        return path.relative_to(self.folder).as_posix()


def cut_stem(stem: str) -> str:
    """As much of a file's stem as leaves room for what is added to it: no file name has more than 255 bytes."""
    encoded = os.fsencode(stem)
    return stem if len(encoded) <= MAX_STEM_BYTES else encoded[:MAX_STEM_BYTES].decode(errors="ignore")


def check_names_differ(scenes: Sequence[Path]) -> None:
    """UserError where two of the files have the same stem, in upper or lower case: folders of Windows and macOS do."""
    names = [file.stem for file in scenes]
    alike = [name.casefold() for name in names]
    if twice := [name for name in names if alike.count(name.casefold()) > 1]:
        raise UserError(f"two scenes are named {twice[0]!r}: results go by name, so rename one")


def _file_stem(name: str) -> str:
    """`name` as part of a file name: everything but letters, digits, '-' and '.' replaced, and not too long."""
    return "".join(c if c.isalnum() or c in "-." else "_" for c in name[:MAX_STEM])


def link_or_copy(source: Path, target: Path) -> None:
    try:
        os.link(source.resolve(), target)
    except OSError:  # On another disk, or one without links.
        shutil.copyfile(source, target)


def copy_whole(source: Path, target: Path) -> None:
    """Copy a file whole or not at all."""
    with written_whole(target) as beside:
        shutil.copyfile(source, beside)


def write_picture(path: Path, picture: ArrayF32 | ArrayF64 | ArrayU8) -> None:
    """Write (H, W, 3) uint8, or floats in [0, 1], as sRGB, whole or not at all."""
    from xihenet.io.png import write_png

    pixels = picture if picture.dtype == "uint8" else (picture * 255).round().astype("uint8")
    with written_whole(path) as beside:
        write_png(beside, pixels)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> None:
    """Write a table, whole or not at all; what is None or missing is empty."""
    with written_whole(path) as beside, beside.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, restval="", extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def write_json(path: Path, content: Any) -> None:
    """Write strict JSON (no NaN, no Infinity: those raise ValueError) whole or not at all."""
    with written_whole(path) as beside:
        beside.write_bytes(json_file(content))


def json_file(content: Any) -> bytes:
    """What `write_json` writes."""
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def write_together(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Write all files, by name, or none if one cannot be written; the first gets its name last. Their paths."""
    with contextlib.ExitStack() as stack:
        for name, content in files.items():
            stack.enter_context(written_whole(folder / name)).write_bytes(content)
    return [folder / name for name in files]


def finite_or_none(value: float | None) -> float | None:
    """`value` as JSON can hold it: None for None, NaN and infinity."""
    return None if value is None or not math.isfinite(value) else float(value)
