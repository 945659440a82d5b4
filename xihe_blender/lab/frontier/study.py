"""`xihe frontier`: every scene measured, its fronts found, and all of it written down.

A scene that is done is kept whole in the folder, so that a run that was stopped goes on with the next one. The folder
belongs to one set of scenes and one seed; another is refused, as for `xihe previs`.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.capture.render import MAX_SEED
from xihe_blender.errors import UserError
from xihe_blender.io.folder_claim import FolderClaim
from xihe_blender.io.outputs import as_json, write_json, written_whole
from xihe_blender.io.provenance import machine, software
from xihe_blender.jobs import Job, Progress
from xihe_blender.lab.frontier.answers import answers
from xihe_blender.lab.frontier.choices import FULL, QUICK, Effort
from xihe_blender.lab.frontier.measured import Measured
from xihe_blender.lab.frontier.points import points_of
from xihe_blender.lab.frontier.report import report_page
from xihe_blender.lab.frontier.scene import SceneStudy, measure_scene, survey_scene
from xihe_blender.report.document import write_document
from xihe_blender.scene.blend_file import open_blend
from xihenet import __version__

SCHEMA_VERSION = 1
COLUMNS = ("scene", "front", "error_kind", "label", "preset", "error", "error_spread", "time_ms", "spread_ms")
MORE_COLUMNS = ("on_front", "front_share", "instead")


@dataclass(frozen=True)
class FrontierSettings:
    """What is measured.

    Parameters
    ----------
    is_quick : fewer choices
    seed : of everything that is random
    size : of the largest frame; None takes that of a run
    effort : None takes QUICK or FULL
    """

    is_quick: bool = False
    seed: int = 0
    size: tuple[int, int] | None = None
    effort: Effort | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.seed <= MAX_SEED:
            raise UserError(f"a seed of {self.seed} is out of Cycles' range: give 0 to {MAX_SEED}")


def frontier(files: Sequence[Path], out: Path, settings: FrontierSettings, command: str = "") -> Job[dict[str, Any]]:
    """Measure the .blend `files` one after the other and leave frontier.json, frontier.csv and report.html in `out`.

    Returns the content of frontier.json. UserError, before anything is measured, for a file that is none or a scene
    that cannot be run, for two files of one name, and for a folder that holds something else.
    """
    names = [file.stem for file in files]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UserError(f"two scenes are named {twice[0]!r}: results go by name, so rename one")
    for file in files:
        survey_scene(open_blend(file), settings.size)
    _claim(out, files, settings).take()
    kept = []
    for number, file in enumerate(files):
        path = out / "work" / file.stem / "measured.json"
        if not path.exists():
            scene = open_blend(file)
            effort = settings.effort or (QUICK if settings.is_quick else FULL)
            surveyed = survey_scene(scene, settings.size)
            study = SceneStudy(scene, file.stem, *surveyed, path.parent, settings.is_quick, settings.seed, effort)
            write_json(path, (yield from measure_scene(study, float(number), float(len(files)))))
        kept.append(json.loads(path.read_text(encoding="utf-8")))
    content = assembled(names, kept, settings, command)
    _write(out, content)
    yield Progress(1, 1, "measured and written")
    return content


def assembled(
    names: Sequence[str], kept: Sequence[dict[str, Any]], settings: FrontierSettings, command: str
) -> dict[str, Any]:
    """The content of frontier.json."""
    points = []
    for name, one in zip(names, kept, strict=True):
        fronts = {front: [Measured(**choice) for choice in choices] for front, choices in one["fronts"].items()}
        points += points_of(name, fronts, settings.seed)
    return {
        "schema_version": SCHEMA_VERSION,
        "software": software(command),
        "machine": machine(),
        "settings": as_json(settings),
        "scenes": [
            {"name": name, **{key: value for key, value in one.items() if key != "fronts"}}
            for name, one in zip(names, kept, strict=True)
        ],
        "answers": answers(names, points),
        "points": points,
    }


def _claim(out: Path, files: Sequence[Path], settings: FrontierSettings) -> FolderClaim:
    made_with = {
        "xihe": __version__,
        "blender": bpy.app.version_string,
        "scenes": {file.stem: hashlib.sha256(file.read_bytes()).hexdigest() for file in files},
        "settings": asdict(settings),
    }
    return FolderClaim(out, out / "work" / "settings.json", "a frontier", made_with, (out / "frontier.json",))


def _write(out: Path, content: dict[str, Any]) -> None:
    """The report and the table first: frontier.json says that all is there."""
    write_document(out / "report.html", report_page(content))
    with written_whole(out / "frontier.csv") as beside:
        beside.write_text(table(content["points"]), encoding="utf-8")
    write_json(out / "frontier.json", content)


def table(points: Sequence[dict[str, Any]]) -> str:
    """The points as CSV, a line each; settings other than the kind of error as JSON in the last column."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*COLUMNS, *MORE_COLUMNS, "settings"])
    for point in points:
        settings = dict(point["settings"])
        row = {**point, "error_kind": settings.pop("error_kind")}
        writer.writerow([*(row[name] for name in (*COLUMNS, *MORE_COLUMNS)), json.dumps(settings)])
    return text.getvalue()
