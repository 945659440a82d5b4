"""A batch from its settings to its tables and its report; see `evaluate_batch`."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

from xihe_blender.io.json_records import as_json
from xihe_blender.jobs import Job, Progress
from xihe_blender.lab.batch.grid import BatchSettings, Unit, check_settings, planned_units
from xihe_blender.lab.batch.report import report_page
from xihe_blender.lab.batch.results import BatchFolder, BatchResults, batch_results, read_frontier
from xihe_blender.lab.workers.dask_workers import Work, dashboard, open_dask_workers
from xihe_blender.report.document import write_document

OF_OTHER_FILES = "files that the scene reads have changed, or are others on the worker: run the same command again"


def evaluate_batch(
    scenes: Sequence[Path],
    folder: Path,
    settings: BatchSettings,
    seeds: Sequence[int],
    *,
    n_workers: int | None,
    scheduler: str | None,
    frontier: Path | None,
) -> Job[tuple[BatchResults, int]]:
    """Evaluate what is not done yet, and write tables and report over all that is: these, and how many are new.

    Parameters
    ----------
    scenes : .blend files; one that is broken does not stop the others
    folder : of the batch; one with the same settings goes on, also with more scenes or seeds
    n_workers : processes on this machine; None takes one per core. Of no meaning with `scheduler`
    scheduler : address of a Dask scheduler whose workers do it
    frontier : a frontier.json, or its folder, for the report; None takes one in `folder`

    UserError for settings that make no sense, a folder with another batch, a scheduler that cannot help.
    """
    check_settings(settings, seeds)
    measured = read_frontier(frontier, folder)
    kept = BatchFolder(folder.resolve())
    manifest = kept.manifest(settings)
    if manifest.is_held:
        raise manifest.under_way()
    kept.forget_what_made_nothing()
    manifest.check()
    units, failed = planned_units(scenes, seeds)
    missing = [unit for unit in units if kept.result(unit) is None]
    n_needed = None if n_workers is None else min(n_workers, len(missing))
    with contextlib.ExitStack() as stack:
        workers = stack.enter_context(open_dask_workers(n_needed, scheduler)) if missing else None
        stack.enter_context(manifest.held())
        if workers is not None:
            workers.check_workers(str(kept.path), sorted({str(unit.scene) for unit in missing}))
            yield Progress(0, len(missing), f"{len(missing)} of {len(units)} units to do; {dashboard(workers)}")
            yield from workers.run(_work(kept, settings, missing), "unit")
            names = {unit.name: f"{unit.scene} (seed {unit.seed})" for unit in units}
            reasons = {unit.name: OF_OTHER_FILES for unit in missing if kept.result(unit) is None} | workers.failed
            failed |= {names[name]: reason for name, reason in reasons.items()}
        results = batch_results(kept, settings, units, failed)
        kept.write_tables(results)
        write_document(kept.path / "report.html", report_page(kept, results, measured))
        return results, sum(kept.result(unit) is not None for unit in missing)


def _work(kept: BatchFolder, settings: BatchSettings, missing: Sequence[Unit]) -> list[Work]:
    """A unit that starts last keeps one worker busy alone: the largest files first, which are often the longest."""
    return [
        Work(
            unit.name,
            "xihe_blender.lab.batch.blender_process",
            (str(unit.scene), str(unit.seed), str(kept.of_unit(unit)), unit.content_sha256),
            told=as_json(settings),
        )
        for unit in sorted(missing, key=lambda unit: -unit.scene.stat().st_size)
    ]
