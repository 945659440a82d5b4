"""`xihe evaluate`: what is typed, and what is said in the end."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.cli import arguments
from xihe_blender.cli.progress import EXIT_IN_PART, progress_line, when_news
from xihe_blender.errors import UserError
from xihe_blender.lab.batch.grid import DEFAULT_ESTIMATORS, BatchSettings
from xihenet.formats import format_count
from xihenet.phone import load_profile, profile_names
from xihenet.trigger import RULES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = arguments.adder(parser)
    estimators = f"{arguments.ESTIMATORS}; default: {','.join(DEFAULT_ESTIMATORS)}"
    samples = "samples of every capture and light probe; default: as many as the preset's noise target needs"
    add("scenes SCENE.blend", "scenes with animated cameras", Path, nargs="+")
    add("--out DIR", "folder of the batch; a stopped batch in it is resumed", Path, required=True)
    add("--estimators A,B", estimators, arguments.names, default=DEFAULT_ESTIMATORS)
    add("--profiles A,B", "phones: " + arguments.one_of([*profile_names(), "FILE.toml"]), arguments.names)
    add("--seeds N,M", "the room is rendered once for each seed; default: 0", arguments.whole_numbers, default=(0,))
    add("--preset NAME", arguments.PRESET, default="draft")
    add("--frames A:B[:S]", "frames of each path; default: the scene's range and step", arguments.frame_range)
    add("--size WxH", arguments.SIZE, arguments.picture_size)
    add("--target", arguments.TARGET, choices=("ldr", "hdr"), default="hdr")
    add("--light PARTS", arguments.LIGHT + "; default: sh", default="sh")
    add("--samples N", samples, int)
    add("--trigger", arguments.TRIGGER + "; default: split", choices=tuple(RULES), default="split")
    add("--network NAME", arguments.NETWORK)
    add("--workers N", "processes on this machine, one thread each; default: one per core", int)
    add("--scheduler ADDRESS", "Dask scheduler whose workers do the work, such as tcp://host:8786")
    add("--frontier DIR", "results of xihe frontier to include in the report; default: a frontier.json in --out", Path)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> int:
    """Do it; 1 where something could not be done."""
    from xihe_blender.jobs import run_blocking
    from xihe_blender.lab.batch.batch import evaluate_batch

    if options.workers is not None and options.workers < 1:
        raise UserError(f"--workers {options.workers}: give 1 or more")
    arguments.check_one_kind_of_workers(options.workers, options.scheduler)
    phones = tuple(_absolute_profile(name) for name in options.profiles or ("perfect",))
    job = evaluate_batch(
        arguments.files(options.scenes),
        options.out,
        arguments.settings_from(options, BatchSettings, phones=phones),
        options.seeds,
        n_workers=options.workers,
        scheduler=options.scheduler,
        frontier=options.frontier,
    )
    results, n_done_now = run_blocking(job, when_news(progress_line(stderr)))
    for one in results.failed:
        print(f"xihe: {one.what}: {one.reason}", file=stderr)
    trials, units = format_count(len(results.trials), "trial"), format_count(len(results.units), "unit")
    print(f"{trials} in {units}, {n_done_now} of them done now", file=stdout)
    print(options.out / "report.html", file=stdout)
    return EXIT_IN_PART if results.failed else 0


def _absolute_profile(phone: str) -> str:
    """A profile as workers in another folder find it too. UserError without one of that name, or for a wrong file."""
    try:
        load_profile(phone)
    except ValueError as error:
        raise UserError(f"--profiles {phone}: {error}") from error
    return phone if phone in profile_names() else str(Path(phone).resolve())
