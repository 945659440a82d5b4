"""results.json and the tables of a batch: one row per trial, per frame of a trial, and per unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from xihe_blender.io.outputs import write_json
from xihe_blender.lab.batch.grid import BatchSettings, Unit
from xihe_blender.lab.batch.rows import METRICS, write_csv
from xihe_blender.lab.batch.store import BatchFolder
from xihenet import __version__

SCHEMA_VERSION = 1
WHICH = ("scene", "seed", "phone", "estimator")
TRIAL_COLUMNS = (
    *WHICH, "n_frames", "n_active_frames", "n_compared_frames", "n_estimates", "estimates_per_minute", "shc_rmse",
    "coverage", *METRICS, "payload_bytes",
)  # fmt: skip
FRAME_COLUMNS = (*WHICH, "frame", "time_s", "n_fired", "shc_rmse", "coverage", *METRICS)
UNIT_COLUMNS = ("unit", "scene", "seed", "elapsed_s", "processor_s", "render_s", "peak_memory_mb", "written_bytes")


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
        trials += [{**which, "number": place, **trial} for place, trial in enumerate(result["trials"])]
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
