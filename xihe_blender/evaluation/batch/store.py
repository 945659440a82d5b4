"""What does a batch leave, and where? Units that are done are never done again, whoever asks.

batch.json                what every unit was made with
units/<unit>/result.json  a unit that is done; its folder also holds the renders of one that is not
results.json, trials.csv, frames.csv, units.csv, report.html
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xihe_blender.errors import UserError
from xihe_blender.evaluation.batch.grid import BatchSettings, Unit
from xihe_blender.outputs import write_json


def result_file(unit_folder: Path) -> Path:
    """The result of a unit; that it exists says that the unit is done."""
    return unit_folder / "result.json"


@dataclass(frozen=True)
class BatchFolder:
    """The files of one batch below `path`."""

    path: Path

    @property
    def claim(self) -> Path:
        return self.path / "batch.json"

    @property
    def results(self) -> Path:
        return self.path / "results.json"

    @property
    def report(self) -> Path:
        return self.path / "report.html"

    def table(self, name: str) -> Path:
        return self.path / f"{name}.csv"

    def of_unit(self, unit: Unit) -> Path:
        return self.path / "units" / unit.name

    def result(self, unit: Unit) -> dict[str, Any] | None:
        """What the unit came to; None if it is not done, or its file is damaged."""
        try:
            content = json.loads(result_file(self.of_unit(unit)).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return content if isinstance(content, dict) else None


def check_folder(folder: BatchFolder, settings: BatchSettings) -> None:
    """UserError if the folder holds anything but such a batch. Scenes and seeds may be others."""
    if folder.path.exists() and not folder.path.is_dir():
        raise UserError(f"{folder.path} is a file: give --out a folder")
    if folder.claim.exists():
        different = _differences(folder.claim, settings.made_with)
        if different:
            raise UserError(
                f"{folder.path} holds a batch with another {', '.join(different)}: choose another folder for --out, "
                "or delete that one"
            )
    elif folder.results.exists():
        raise UserError(f"{folder.results} is there and not from a batch: choose another folder for --out")


def claim_folder(folder: BatchFolder, settings: BatchSettings) -> None:
    """Check the folder, and write what the batch is made with. UserError also if it cannot be written."""
    check_folder(folder, settings)
    if folder.claim.exists():
        return
    try:
        write_json(folder.claim, settings.made_with)
    except OSError as error:
        raise UserError(f"cannot write to {folder.path} ({error.strerror}): choose another folder for --out") from error


def _differences(claim: Path, made_with: dict[str, Any]) -> list[str]:
    """In words: "version of xihe", or the settings that differ."""
    try:
        kept = json.loads(claim.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        kept = {}
    kept = kept if isinstance(kept, dict) else {}
    if any(kept.get(key) != made_with[key] for key in ("format", "xihe")):
        return ["version of xihe"]
    settings, of_kept = made_with["settings"], kept.get("settings") or {}
    different = [name.replace("_", " ") for name in settings if of_kept.get(name) != settings[name]]
    return different or (["phone profile"] if kept.get("profiles") != made_with["profiles"] else [])


def read_frontier(given: Path | None, folder: Path) -> dict[str, Any] | None:
    """The content of a frontier.json: the one given, or its folder, or one in the batch's `folder`, if any.

    UserError if the one given cannot be read.
    """
    file = folder if given is None else given
    file = file / "frontier.json" if file.is_dir() or given is None else file
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        if given is None:
            return None
        raise UserError(f"--frontier {given}: no frontier can be read there ({error}): run xihe frontier") from error
    return content if isinstance(content, dict) else None
