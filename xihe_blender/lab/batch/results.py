"""Results of a batch: what it leaves and where. Units that are done are never done again, whoever asks.

batch.json                what every unit was made with
units/<unit>/result.json  a unit that is done; its folder also holds the renders of one that is not, and the pictures of
                          each trial's worst compared frame
results.json              everything that is done, in the order in which it was asked for
trials.csv, frames.csv    a row per trial, and per frame of a trial: the same bytes, whoever computes them
units.csv                 what each unit cost
report.html
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import FolderManifest
from xihe_blender.io.outputs import write_csv, write_json
from xihe_blender.io.run_results import METRICS
from xihe_blender.lab.batch.grid import BatchSettings, Unit
from xihenet import __version__
from xihenet.json_files import read_json

SCHEMA_VERSION = 1
WHICH = ("scene", "seed", "phone", "estimator")
TRIAL_COLUMNS = (
    *WHICH, "n_frames", "n_active_frames", "n_compared_frames", "n_estimates", "estimates_per_minute", "shc_rmse",
    "coverage", *METRICS, "payload_bytes",
)  # fmt: skip
FRAME_COLUMNS = (*WHICH, "frame", "time_s", "n_fired", "shc_rmse", "coverage", *METRICS)
UNIT_COLUMNS = ("unit", "scene", "seed", "elapsed_s", "processor_s", "render_s", "peak_memory_mb", "written_bytes")
WORST_KINDS = ("ground_truth", "estimate", "error")
"""Pictures of a trial's worst frame."""


def result_file(unit_folder: Path) -> Path:
    """The result of a unit; that it exists says that the unit is done."""
    return unit_folder / "result.json"


def worst_picture(folder: Path, trial: int, kind: str) -> Path:
    """Where the picture of a trial's worst frame is: one of WORST_KINDS; trials go by number."""
    return folder / f"worst_{trial}_{kind}.png"


def worst_frame(metrics: Mapping[int, Mapping[str, float | None]]) -> int | None:
    """The frame with the lowest psnr, which is on the colours that are shown; the earliest of equals, None without."""
    known = {frame: psnr for frame, of_frame in metrics.items() if (psnr := of_frame["psnr"]) is not None}
    return min(sorted(known), key=lambda frame: known[frame], default=None)


@dataclass(frozen=True)
class BatchFolder:
    """The files of one batch below `path`."""

    path: Path

    @property
    def manifest(self) -> Path:
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
            content = read_json(result_file(self.of_unit(unit)))
        except (OSError, ValueError):
            return None
        return content if isinstance(content, dict) else None


def manifest_of(folder: BatchFolder, settings: BatchSettings) -> FolderManifest:
    """That the folder is for such a batch. Scenes and seeds may be others."""
    return FolderManifest(folder.path, folder.manifest, "a batch", settings.provenance, (folder.results,))


def batch_results(
    folder: BatchFolder, settings: BatchSettings, units: Sequence[Unit], failed: Mapping[str, str]
) -> dict[str, Any]:
    """The content of results.json: everything that is done, in the order in which it was asked for."""
    trials, costs = [], []
    for unit, scene in zip(units, _scene_names(units), strict=True):
        result = folder.result(unit)
        if result is None:
            continue
        which = {"unit": unit.name, "scene": scene, "seed": unit.seed}
        trials += [{**which, "number": index, **trial} for index, trial in enumerate(result["trials"])]
        costs.append({**which, **result["cost"], "render_s": result["render_s"], "step_ms": result["step_ms"]})
    return {
        "schema_version": SCHEMA_VERSION,
        "software": {"xihe": __version__},
        "settings": settings.as_json(),
        "trials": trials,
        "units": costs,
        "failed": [{"what": what, "reason": reason} for what, reason in failed.items()],
    }


def _scene_names(units: Sequence[Unit]) -> list[str]:
    """The stem of each unit's .blend, with a piece of its digest where another file has the same."""
    digests: dict[str, set[str]] = {}
    for unit in units:
        digests.setdefault(unit.scene.stem, set()).add(unit.digest)
    return [
        unit.scene.stem if len(digests[unit.scene.stem]) == 1 else f"{unit.scene.stem} {unit.digest[:8]}"
        for unit in units
    ]


def write_tables(folder: BatchFolder, results: Mapping[str, Any]) -> None:
    """Write results.json and the tables. trials.csv and frames.csv hold nothing that another run would change."""
    frames = [
        {**{key: trial[key] for key in WHICH}, **frame} for trial in results["trials"] for frame in trial["frames"]
    ]
    write_csv(folder.table("trials"), results["trials"], TRIAL_COLUMNS)
    write_csv(folder.table("frames"), frames, FRAME_COLUMNS)
    write_csv(folder.table("units"), results["units"], UNIT_COLUMNS)
    write_json(folder.results, results)


def read_frontier(given: Path | None, folder: Path) -> dict[str, Any] | None:
    """The content of a frontier.json: the one given, or its folder, or one in the batch's `folder`, if any.

    UserError if the one given cannot be read.
    """
    file = folder if given is None else given
    file = file / "frontier.json" if file.is_dir() or given is None else file
    try:
        content = read_json(file)
    except (OSError, ValueError) as error:
        if given is None:
            return None
        raise UserError(f"--frontier {given}: no frontier can be read there ({error}): run xihe frontier") from error
    return content if isinstance(content, dict) else None
