"""Results of a batch: what it leaves, field by field, and where. A unit that is done is never done again, whoever asks.

batch.json                what every unit was made with (`BatchManifest`)
units/<unit>/result.json  a unit that is done (`UnitResult`); its folder also holds the renders of one that is not, and
                          the pictures of each trial's worst compared frame
results.json              everything that is done, in the order in which it was asked for (`BatchResults`)
trials.csv, frames.csv    a row per trial, and per frame of a trial: the same bytes, whoever computes them
units.csv                 what each unit cost
report.html

Means are over positions and frames, those of image metrics over compared frames; None without any.
docs/batch.schema.json is made from the records (`python -m xihe_blender.lab.batch.results`).
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import FolderManifest
from xihe_blender.io.json_records import Json, as_json, from_json, json_schema
from xihe_blender.io.kept_files import kept_json
from xihe_blender.io.outputs import write_csv, write_json
from xihe_blender.io.run_results import Metrics, Plain
from xihe_blender.lab.batch.grid import FORMAT_VERSION, BatchSettings, Unit
from xihe_blender.lab.frontier.records import Frontier
from xihenet import __version__
from xihenet.json_files import read_json
from xihenet.phone import load_profile

SCHEMA_VERSION: Literal[1] = 1
WORST_KINDS = ("ground_truth", "estimate", "error")
"""Pictures of a trial's worst frame."""


@dataclass(frozen=True, kw_only=True)
class TrialFrame:
    """A captured frame of a trial.

    Parameters
    ----------
    frame, time_s : its number, and when it is
    n_fired : positions at which an estimate was asked for
    shc_rmse, coverage : means over positions
    psnr, ssim, rmse, si_rmse, angular_deg : of its picture against the ground truth, as in a run's results.json
    """

    frame: int
    time_s: float
    n_fired: int
    shc_rmse: float | None
    coverage: float | None
    psnr: float | None
    ssim: float | None
    rmse: float | None
    si_rmse: float | None
    angular_deg: float | None


@dataclass(frozen=True, kw_only=True)
class TriggerFigures:
    """What a more or less eager trigger would have done on the same captures.

    Parameters
    ----------
    factor : of both thresholds
    theta, coverage_theta : which then are these
    per_minute : estimates for a position in view
    shc_rmse : mean error
    """

    factor: float
    theta: float
    coverage_theta: float
    per_minute: float | None
    shc_rmse: float


@dataclass(frozen=True, kw_only=True)
class TrialFigures:
    """What came of one phone and one estimator in a unit.

    Parameters
    ----------
    phone, estimator : names
    n_frames, n_active_frames, n_compared_frames : of the path
    n_estimates, estimates_per_minute : in all, and for a minute in which a position is in view
    shc_rmse, coverage : means
    psnr, ssim, rmse, si_rmse, angular_deg : of pictures against the ground truth, as in a run's results.json
    payload_bytes : sent
    frames, thetas : see there; no thetas for estimators that look at nothing the trigger watches
    """

    phone: str
    estimator: str
    n_frames: int
    n_active_frames: int
    n_compared_frames: int
    n_estimates: int
    estimates_per_minute: float | None
    shc_rmse: float | None
    coverage: float | None
    psnr: float | None
    ssim: float | None
    rmse: float | None
    si_rmse: float | None
    angular_deg: float | None
    payload_bytes: int
    frames: tuple[TrialFrame, ...]
    thetas: tuple[TriggerFigures, ...]


@dataclass(frozen=True, kw_only=True)
class UnitCost:
    """What a unit took.

    Parameters
    ----------
    elapsed_s, processor_s : of its process
    peak_memory_mb : None on Windows
    written_bytes : to storage, most of it removed again
    """

    elapsed_s: float
    processor_s: float
    peak_memory_mb: float | None
    written_bytes: int


@dataclass(frozen=True, kw_only=True)
class UnitDone:
    """What came of a unit.

    Parameters
    ----------
    trials : of all phones and estimators, in the order of the batch
    step_ms : the chain's mean time by trial; None where nothing was in view
    render_s : of everything
    """

    trials: tuple[TrialFigures, ...]
    step_ms: tuple[float | None, ...]
    render_s: float


@dataclass(frozen=True, kw_only=True)
class UnitResult(UnitDone):
    """All of a unit's result.json.

    Parameters
    ----------
    cost : see there
    """

    cost: UnitCost


@dataclass(frozen=True, kw_only=True)
class UnitName:
    """Which unit it is.

    Parameters
    ----------
    unit, scene, seed : its folder, the name of its scene, and its seed
    """

    unit: str
    scene: str
    seed: int


@dataclass(frozen=True, kw_only=True)
class Trial(TrialFigures, UnitName):
    """A trial, with its place in the batch.

    Parameters
    ----------
    number : within the unit, which names its pictures
    """

    number: int


@dataclass(frozen=True, kw_only=True)
class UnitRow(UnitCost, UnitName):
    """A unit that is done.

    Parameters
    ----------
    render_s : of everything
    step_ms : the chain's mean time by trial
    """

    render_s: float
    step_ms: tuple[float | None, ...]


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A scene or unit that could not be done, and why.

    Parameters
    ----------
    what, reason : in words
    """

    what: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class BatchResults:
    """All of a batch's results.json.

    Parameters
    ----------
    schema_version, software : of the file, and of who wrote it
    settings : that all units share
    trials, units, failed : see there
    """

    schema_version: Literal[1] = SCHEMA_VERSION
    software: dict[str, str]
    settings: BatchSettings
    trials: tuple[Trial, ...]
    units: tuple[UnitRow, ...]
    failed: tuple[Failure, ...]


@dataclass(frozen=True, kw_only=True)
class PhoneUsed:
    """A phone's profile as it was.

    Parameters
    ----------
    name, summary, metering : of the profile
    sections : numbers of each effect
    """

    name: str
    summary: str
    sections: dict[str, dict[str, Plain]]
    metering: str


@dataclass(frozen=True, kw_only=True)
class BatchManifest:
    """All of batch.json: what decides the numbers of every unit of a folder, besides its scene and its seed.

    Parameters
    ----------
    format, xihe : versions
    settings, profiles : what all units share, and its phones
    """

    format: int
    xihe: str
    settings: BatchSettings
    profiles: dict[str, PhoneUsed]


WHICH = ("scene", "seed", "phone", "estimator")
TRIAL_COLUMNS = (*WHICH[:2], *(part.name for part in fields(TrialFigures) if part.name not in ("frames", "thetas")))
FRAME_COLUMNS = (*WHICH, *(part.name for part in fields(TrialFrame)))
UNIT_COLUMNS = ("unit", "scene", "seed", "elapsed_s", "processor_s", "render_s", "peak_memory_mb", "written_bytes")


def result_file(unit_folder: Path) -> Path:
    """The result of a unit; that it exists says that the unit is done."""
    return unit_folder / "result.json"


def worst_picture(folder: Path, trial: int, kind: str) -> Path:
    """Where the picture of a trial's worst frame is: one of WORST_KINDS; trials go by number."""
    return folder / f"worst_{trial}_{kind}.png"


def worst_frame(metrics: Mapping[int, Metrics]) -> int | None:
    """The frame with the lowest psnr, which is on the colours that are shown; the earliest of equals, None without."""
    known = {frame: of_frame.psnr for frame, of_frame in metrics.items() if of_frame.psnr is not None}
    return min(sorted(known), key=lambda frame: known[frame], default=None)


@dataclass(frozen=True)
class BatchFolder:
    """The files of one batch below `path`."""

    path: Path

    @property
    def report(self) -> Path:
        return self.path / "report.html"

    def of_unit(self, unit: Unit) -> Path:
        return self.path / "units" / unit.name

    def result(self, unit: Unit) -> UnitResult | None:
        """What the unit came to; None if it is not done, or its file is damaged."""
        return kept_json(result_file(self.of_unit(unit)), lambda content: from_json(UnitResult, content))

    def manifest(self, settings: BatchSettings) -> FolderManifest:
        """That the folder is for such a batch. Scenes and seeds may be others."""
        phones = {name: from_json(PhoneUsed, as_json(load_profile(name))) for name in settings.phones}
        content = BatchManifest(format=FORMAT_VERSION, xihe=__version__, settings=settings, profiles=phones)
        results = (self.path / "results.json",)
        return FolderManifest(self.path, self.path / "batch.json", "a batch", as_json(content), results)

    def write_tables(self, results: BatchResults) -> None:
        """And results.json. trials.csv and frames.csv hold nothing that another run would change."""
        frames = [{**vars(trial), **vars(frame)} for trial in results.trials for frame in trial.frames]
        write_csv(self.path / "trials.csv", [vars(trial) for trial in results.trials], TRIAL_COLUMNS)
        write_csv(self.path / "frames.csv", frames, FRAME_COLUMNS)
        write_csv(self.path / "units.csv", [vars(unit) for unit in results.units], UNIT_COLUMNS)
        write_json(self.path / "results.json", as_json(results))


def batch_results(
    folder: BatchFolder, settings: BatchSettings, units: Sequence[Unit], failed: Mapping[str, str]
) -> BatchResults:
    """Everything that is done, in the order in which it was asked for."""
    trials, rows = list[Trial](), list[UnitRow]()
    for unit, scene in zip(units, _scene_names(units), strict=True):
        result = folder.result(unit)
        if result is not None:
            name = vars(UnitName(unit=unit.name, scene=scene, seed=unit.seed))
            trials += [Trial(number=number, **name, **vars(one)) for number, one in enumerate(result.trials)]
            rows.append(UnitRow(render_s=result.render_s, step_ms=result.step_ms, **name, **vars(result.cost)))
    return BatchResults(
        software={"xihe": __version__},
        settings=settings,
        trials=tuple(trials),
        units=tuple(rows),
        failed=tuple(Failure(what=what, reason=reason) for what, reason in failed.items()),
    )


def _scene_names(units: Sequence[Unit]) -> list[str]:
    """The stem of each unit's .blend, with a piece of its digest where another file has the same."""
    n_of_stem = Counter(stem for stem, _ in {(unit.scene.stem, unit.digest) for unit in units})
    return [
        unit.scene.stem if n_of_stem[unit.scene.stem] == 1 else f"{unit.scene.stem} {unit.digest[:8]}" for unit in units
    ]


def read_frontier(given: Path | None, folder: Path) -> Frontier | None:
    """A frontier.json: the one given, or its folder, or one in the batch's `folder`, if any.

    UserError if the one given cannot be read, or the one in `folder` is there and damaged.
    """
    file = given or folder
    if given is None or given.is_dir():
        file /= "frontier.json"
    try:
        return from_json(Frontier, read_json(file))
    except (OSError, ValueError, TypeError) as error:
        if given is not None:
            raise UserError(
                f"--frontier {given}: no frontier can be read there ({error}): run xihe frontier"
            ) from error
        if isinstance(error, OSError):
            return None
        raise UserError(f"{file} is damaged: run xihe frontier again, or delete it") from error


def batch_schema() -> Json:
    """A JSON schema of results.json; those of a unit's result.json and of batch.json are among its definitions."""
    schema = json_schema(BatchResults)
    for record in (UnitResult, BatchManifest):
        of_file = json_schema(record)
        schema["$defs"] |= {**of_file.pop("$defs"), record.__name__: of_file}
        del of_file["$schema"]
    return schema


if __name__ == "__main__":
    print(json.dumps(batch_schema(), indent=1))
