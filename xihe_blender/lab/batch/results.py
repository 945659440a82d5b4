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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import FolderManifest, absolute_pattern, contents_sha256
from xihe_blender.io.json_records import Json, Plain, as_json, from_json, json_schema
from xihe_blender.io.kept_files import kept_record
from xihe_blender.io.outputs import write_csv, write_json
from xihe_blender.io.run_results import Metrics
from xihe_blender.lab.batch.grid import FORMAT_VERSION, BatchSettings, Unit, short_names
from xihe_blender.lab.frontier.records import Frontier
from xihe_blender.lab.workers.dask_workers import blender_version
from xihenet import __version__
from xihenet.estimators.weights_format import weights_sha256
from xihenet.io.json_files import read_json
from xihenet.phone import load_profile

SCHEMA_VERSION: Literal[1] = 1
WORST_KINDS = ("ground_truth", "estimate", "error")
"""Pictures of a trial's worst frame."""


@dataclass(frozen=True, kw_only=True)
class ChainFrame:
    """What the chain made of a captured frame."""

    frame: Annotated[int, "its number"]
    time_s: Annotated[float, "when it is"]
    n_fired: Annotated[int, "positions at which an estimate was asked for"]
    shc_rmse: Annotated[float | None, "mean over positions"]
    coverage: Annotated[float | None, "mean over positions"]


@dataclass(frozen=True, kw_only=True)
class TrialFrame(Metrics, ChainFrame):
    """A captured frame of a trial, and how its pictures compare with the ground truth."""


@dataclass(frozen=True, kw_only=True)
class TriggerFigures:
    """What a more or less eager trigger would have done on the same captures."""

    factor: Annotated[float, "of all thresholds"]
    theta: Annotated[float, "the threshold for colour or, of the rule `light`, for the light, then"]
    coverage_theta: Annotated[float, "the threshold for coverage, then"]
    per_minute: Annotated[float | None, "estimates for a position in view"]
    shc_rmse: Annotated[float, "mean error"]


@dataclass(frozen=True, kw_only=True)
class ChainFigures:
    """What the chain made of one phone and one estimator in a unit."""

    phone: Annotated[str, "its name, in a unit's result that of its file where it has one"]
    estimator: Annotated[str, "its name"]
    n_frames: Annotated[int, "of the path"]
    n_active_frames: Annotated[int, "of the path"]
    n_compared_frames: Annotated[int, "of the path"]
    n_estimates: Annotated[int, "in all"]
    estimates_per_minute: Annotated[float | None, "for a minute in which a position is in view"]
    shc_rmse: Annotated[float | None, "mean"]
    coverage: Annotated[float | None, "mean"]


@dataclass(frozen=True, kw_only=True)
class TrialFigures(Metrics, ChainFigures):
    """What came of one phone and one estimator in a unit; metrics are means over frames."""

    object_pixels: Annotated[float | None, "of a compared picture that virtual objects cover, mean"] = None
    payload_bytes: Annotated[int, "sent"]
    frames: Annotated[tuple[TrialFrame, ...], "see there"]
    trigger_sweep: Annotated[
        tuple[TriggerFigures, ...], "see there; none for estimators that the trigger does not matter to"
    ]


@dataclass(frozen=True, kw_only=True)
class UnitCost:
    """What a unit took."""

    elapsed_s: Annotated[float, "of its last process"]
    processor_s: Annotated[float, "of its last process"]
    peak_memory_mb: Annotated[float | None, "None on Windows"]
    written_bytes: Annotated[int, "to storage, most of it removed again"]


@dataclass(frozen=True, kw_only=True)
class FilesRead:
    """What a scene reads besides its .blend: libraries, images, volumes, caches."""

    patterns: Annotated[
        tuple[str, ...], "of their paths, as Python's glob reads them; relative where the .blend names them so"
    ] = ()
    sha256: Annotated[str | None, "of their names and contents; None where there is none"] = None


@dataclass(frozen=True, kw_only=True)
class UnitResult:
    """All of a unit's result.json."""

    trials: Annotated[tuple[TrialFigures, ...], "of all phones and estimators, in the order of the batch"]
    step_ms: Annotated[
        tuple[float | None, ...], "median time of the chain for a position in a frame, by trial, or None"
    ]
    render_s: Annotated[float, "of everything, before a stop as well"]
    cost: Annotated[UnitCost, "see there"]
    read: Annotated[FilesRead, "see there"] = FilesRead()


@dataclass(frozen=True, kw_only=True)
class UnitName:
    """Which unit it is."""

    unit: Annotated[str, "its folder"]
    scene: Annotated[str, "the name of its file, with folders where others have that name"]
    seed: Annotated[int, "its seed"]


@dataclass(frozen=True, kw_only=True)
class Trial(TrialFigures, UnitName):
    """A trial, with its place in the batch."""

    number: Annotated[int, "within the unit, which names its pictures"]


@dataclass(frozen=True, kw_only=True)
class UnitRow(UnitCost, UnitName):
    """A unit that is done."""

    render_s: Annotated[float, "of everything, before a stop as well"]
    step_ms: Annotated[
        tuple[float | None, ...], "median time of the chain for a position in a frame, by trial, or None"
    ]


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A scene or unit that could not be done, and why."""

    what: Annotated[str, "in words"]
    reason: Annotated[str, "in words"]


@dataclass(frozen=True, kw_only=True)
class BatchResults:
    """All of a batch's results.json."""

    schema_version: Annotated[Literal[1], "of the file"] = SCHEMA_VERSION
    software: Annotated[dict[str, str], "versions of who wrote it"]
    settings: Annotated[BatchSettings, "that all units share"]
    trials: Annotated[tuple[Trial, ...], "see there"]
    units: Annotated[tuple[UnitRow, ...], "see there"]
    failed: Annotated[tuple[Failure, ...], "see there"]


@dataclass(frozen=True, kw_only=True)
class PhoneUsed:
    """A phone's profile as it was."""

    name: Annotated[str, "of the profile"]
    summary: Annotated[str, "of the profile"]
    sections: Annotated[dict[str, dict[str, Plain]], "numbers of each effect"]
    metering: Annotated[str, "of the profile"]


@dataclass(frozen=True, kw_only=True)
class BatchManifest:
    """All of batch.json: what decides the numbers of every unit of a folder, besides its scene and its seed."""

    format: Annotated[int, "version of the folder's files"]
    xihe: Annotated[str, "version of xihe"]
    blender: Annotated[str | None, "version of Blender; None where there is none"] = None
    settings: Annotated[BatchSettings, "what all units share"]
    profiles: Annotated[dict[str, PhoneUsed], "its phones"]
    weights: Annotated[dict[str, str], "SHA-256 of each network's weights file, by estimator"]


WHICH = ("scene", "seed", "phone", "estimator")
TRIAL_COLUMNS = (
    *WHICH[:2],
    *(part.name for part in fields(TrialFigures) if part.name not in ("frames", "trigger_sweep")),
)
FRAME_COLUMNS = (*WHICH, *(part.name for part in fields(TrialFrame)))
UNIT_COLUMNS = ("unit", "scene", "seed", "elapsed_s", "processor_s", "render_s", "peak_memory_mb", "written_bytes")


def result_file(unit_folder: Path) -> Path:
    """The result of a unit; that it exists says that the unit is done."""
    return unit_folder / "result.json"


def read_result(unit_folder: Path, scene: Path) -> UnitResult | None:
    """What a unit of `scene` came to; None if it is not done or damaged, or if what that reads is not what it was."""
    found = kept_record(UnitResult, result_file(unit_folder))
    patterns = [] if found is None else [absolute_pattern(one, scene.parent) for one in found.read.patterns]
    is_current = found is not None and contents_sha256(patterns) == found.read.sha256
    return found if is_current else None


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

    def of_unit(self, unit: Unit) -> Path:
        return self.path / "units" / unit.name

    def result(self, unit: Unit) -> UnitResult | None:
        """As `read_result`."""
        return read_result(self.of_unit(unit), unit.scene)

    def manifest(self, settings: BatchSettings) -> FolderManifest:
        """That the folder is for such a batch. Scenes and seeds may be others."""
        weights = weights_sha256(settings.estimators, settings.target)
        content = BatchManifest(
            format=FORMAT_VERSION,
            xihe=__version__,
            blender=blender_version(),
            settings=settings.named(),
            profiles=_phones_used(settings),
            weights=weights,
        )
        results = (self.path / "results.json", self.path / "report.html")
        return FolderManifest(self.path, self.path / "batch.json", "a batch", as_json(content), results)

    def check_phones(self, settings: BatchSettings) -> None:
        """UserError where the file of a phone is another than when the batch began."""
        manifest = self.path / "batch.json"
        if not manifest.exists():
            return
        try:
            is_same = _phones_used(settings) == from_json(BatchManifest, read_json(manifest)).profiles
        except ValueError:
            is_same = False
        if not is_same:
            raise UserError(
                "the file of a phone has changed since the batch began: put it back as it was and run the same command "
                "again, or choose another folder for --out"
            )

    def forget_what_made_nothing(self) -> None:
        """Free the folder for any batch if the last one has ended in it without making anything: all was refused."""
        manifest, results = self.path / "batch.json", self.path / "results.json"
        try:
            is_empty = manifest.exists() and read_json(results)["units"] == []
        except (OSError, TypeError, KeyError, ValueError):
            return
        if is_empty and not any(path.is_file() for path in (self.path / "units").rglob("*")):
            (self.path / "report.html").unlink(missing_ok=True)
            results.unlink()
            manifest.unlink()

    def write_tables(self, results: BatchResults) -> None:
        """And results.json. trials.csv and frames.csv hold nothing that another run would change."""
        frames = [{**vars(trial), **vars(frame)} for trial in results.trials for frame in trial.frames]
        write_csv(self.path / "trials.csv", [vars(trial) for trial in results.trials], TRIAL_COLUMNS)
        write_csv(self.path / "frames.csv", frames, FRAME_COLUMNS)
        write_csv(self.path / "units.csv", [vars(unit) for unit in results.units], UNIT_COLUMNS)
        write_json(self.path / "results.json", as_json(results))


def _phones_used(settings: BatchSettings) -> dict[str, PhoneUsed]:
    profiles = [from_json(PhoneUsed, as_json(load_profile(phone))) for phone in settings.phones]
    return dict(zip(settings.named().phones, profiles, strict=True))


def batch_results(
    folder: BatchFolder, settings: BatchSettings, units: Sequence[Unit], failed: Mapping[str, str]
) -> BatchResults:
    """Everything that is done, in the order in which it was asked for."""
    trials, rows = list[Trial](), list[UnitRow]()
    names, settings = short_names({unit.scene for unit in units}), settings.named()
    for unit in units:
        result = folder.result(unit)
        if result is not None:
            name = vars(UnitName(unit=unit.name, scene=names[unit.scene], seed=unit.seed))
            phones = dict(zip(dict.fromkeys(one.phone for one in result.trials), settings.phones, strict=False))
            for number, one in enumerate(result.trials):
                trials.append(Trial(number=number, **name, **(vars(one) | {"phone": phones[one.phone]})))
            rows.append(UnitRow(render_s=result.render_s, step_ms=result.step_ms, **name, **vars(result.cost)))
    return BatchResults(
        software={"xihe": __version__} | ({} if (blender := blender_version()) is None else {"blender": blender}),
        settings=settings,
        trials=tuple(trials),
        units=tuple(rows),
        failed=tuple(Failure(what=what, reason=reason) for what, reason in failed.items()),
    )


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
