"""The evaluation's run: it can be stopped, and no study is measured twice.

Rooms are recorded first, into `sessions`; then each study writes results/NAME.json, whole, when its last row is
there. The file says what it was made from: seed, size, the sessions' scenes, weights of networks, and the source of
the study and of `clouds`. A study whose file says the same is not run again. Tables, report and page are made from
those files alone.
"""

from __future__ import annotations

import datetime
import hashlib
import importlib
import inspect
import json
import os
import pkgutil
import platform
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import get_args

import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import FolderManifest
from xihe_blender.io.json_records import Json, as_json
from xihe_blender.io.kept_files import kept_record
from xihe_blender.io.outputs import write_csv, write_json
from xihe_blender.jobs import Job, Progress, part_of
from xihe_blender.lab.paper import clouds, studies
from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, StudyResult
from xihe_blender.lab.paper.report import paper_markdown, report_page
from xihe_blender.lab.paper.sessions import QUICK_WALK, WalkSettings, check_session, recorded_session, scene_files
from xihe_blender.report.document import write_document
from xihenet import __version__, estimators
from xihenet.estimators import Target
from xihenet.estimators.weights_format import weights_sha256

SHARE_OF_RECORDING = 0.4
MAX_SEED = 2**31 - 1
EXTRAS = {"tornado": "edge"}


@dataclass(frozen=True)
class PaperSettings:
    """What is measured.

    Parameters
    ----------
    quick : 20 minutes instead of 8 hours, on two cores
    only : names of studies; empty takes all
    scenes : .blend files of rooms; empty takes the project's own
    seed : of all that is random
    document : page of Markdown that is made as well
    """

    quick: bool = False
    only: tuple[str, ...] = ()
    scenes: tuple[Path, ...] = ()
    seed: int = 0
    document: Path | None = None


def all_studies() -> list[Study]:
    """In the order of the paper."""
    names = [one.name for one in pkgutil.iter_modules(studies.__path__)]
    found: list[Study] = [importlib.import_module(f"{studies.__name__}.{name}").STUDY for name in names]
    return sorted(found, key=lambda study: (study.place, study.name))


def chosen_studies(only: Sequence[str]) -> list[Study]:
    """UserError for a name that is none."""
    found = {study.name: study for study in all_studies()}
    if unknown := [name for name in only if name not in found]:
        raise UserError(f"there is no study {unknown[0]!r}: give --only one of {', '.join(found)}")
    return [study for name, study in found.items() if not only or name in only]


def evaluate_paper(out: Path, settings: PaperSettings, command: str) -> Job[list[StudyResult]]:
    """A job: measure what is not measured yet, and write tables and report; the results of all studies there are.

    UserError, before anything is rendered, for an unknown study, a scene of the user's that cannot be run, a seed
    out of range, or a folder that holds something else. A study that cannot be measured gives its reason as its result.
    """
    chosen = chosen_studies(settings.only)
    if not 0 <= settings.seed <= MAX_SEED:
        raise UserError(f"--seed {settings.seed}: give 0 to {MAX_SEED}")
    files = scene_files(settings.scenes)
    hashes = {file.stem: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    walk = QUICK_WALK if settings.quick else WalkSettings()
    needs_rooms = any(study.needs_rooms for study in chosen)
    for file in files if needs_rooms else ():
        check_session(file, out / "sessions" / file.stem, walk, settings.seed)
    decides = {"xihe": __version__, "scenes": hashes, "settings": {"quick": settings.quick, "seed": settings.seed}}
    report = out / "report.html"
    manifest = FolderManifest(out, out / "settings.json", "an evaluation of the paper", decides, (report,))
    with manifest.held():
        sessions = []
        for number, file in enumerate(files if needs_rooms else ()):
            job = recorded_session(file, out / "sessions" / file.stem, walk, settings.seed)
            share = SHARE_OF_RECORDING / len(files)
            sessions.append((yield from part_of(1, number * share, share, job, file.stem)))
        inputs = study_inputs(decides, walk)
        yield from measure_studies(chosen, sessions, out, settings, inputs)
        kept = [kept_result(out, study, inputs) for study in all_studies()]
        results = [one for one in kept if one is not None]
        write_document(report, report_page(all_studies(), results, out / "pictures", command))
        if settings.document is not None:
            page = paper_markdown(all_studies(), results, command, settings.document.parent)
            write_document(settings.document, page)
    yield Progress(1, 1, "measured and written")
    return results


def study_inputs(decides: Json, walk: WalkSettings) -> str:
    """All that the figures of a study depend on, besides its source: trained networks as well."""
    ours = [name for name in estimators.names() if not estimators.is_outside(name)]
    weights = {target: weights_sha256(ours, target) for target in get_args(Target)}
    return json.dumps([decides, asdict(walk), weights])


def measure_studies(
    chosen: Sequence[Study], sessions: Sequence[Session], out: Path, settings: PaperSettings, inputs: str
) -> Job[None]:
    """A job: each study that has no result of the same `inputs` yet, and its table."""
    share = (1 - SHARE_OF_RECORDING) / max(1, len(chosen))
    for number, study in enumerate(chosen):
        done = SHARE_OF_RECORDING + number * share
        yield Progress(done, 1, study.title)
        result = kept_result(out, study, inputs)
        if result is None or result.failed_because:
            options = StudyOptions(settings.quick, settings.seed, out / "pictures" / study.name)
            rows, failed, start = [], "", time.perf_counter()
            try:
                for row in study.measure(sessions, options):
                    rows.append(row)
                    yield Progress(done, 1, f"{study.title}: {row.what}")
            except (UserError, ImportError) as error:
                failed = _why(error)
            today, elapsed_s = datetime.date.today().isoformat(), time.perf_counter() - start
            result = StudyResult(
                study.name, _made_from(study, inputs), today, elapsed_s, machine_words(), tuple(rows), failed
            )
            write_json(_result_file(out, study), as_json(result))
        if result.rows:
            write_csv(out / f"{study.name}.csv", [asdict(row) for row in result.rows], [f.name for f in fields(Row)])


def _why(error: Exception) -> str:
    extra = EXTRAS.get(getattr(error, "name", None) or "")
    return f"it needs a package: pip install 'xihe-blender[{extra}]'" if extra else " ".join(str(error).split())


def _result_file(out: Path, study: Study) -> Path:
    return out / "results" / f"{study.name}.json"


def kept_result(out: Path, study: Study, inputs: str) -> StudyResult | None:
    """What was measured from the same inputs by the same source."""
    result = kept_record(StudyResult, _result_file(out, study))
    return result if result is not None and result.made_from == _made_from(study, inputs) else None


def _made_from(study: Study, inputs: str) -> str:
    source = inspect.getsource(inspect.getmodule(study.measure) or studies) + inspect.getsource(clouds)
    return hashlib.sha256(f"{study.name}\n{inputs}\n{source}".encode()).hexdigest()


def machine_words() -> str:
    """What it ran on; nothing that names the user."""
    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"NumPy {np.__version__}"
    )
