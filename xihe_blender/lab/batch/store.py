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
from xihe_blender.io.folder_claim import FolderClaim
from xihe_blender.lab.batch.grid import BatchSettings, Unit


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


def claim_of(folder: BatchFolder, settings: BatchSettings) -> FolderClaim:
    """That the folder is for such a batch. Scenes and seeds may be others."""
    return FolderClaim(folder.path, folder.claim, "a batch", settings.made_with, (folder.results,))


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
