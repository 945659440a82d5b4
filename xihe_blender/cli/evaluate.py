"""The sub-command `xihe evaluate`: what is typed, and what is said in the end."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import frame_range, names, picture_size, whole_numbers
from xihe_blender.cli.progress import EXIT_IN_PART, progress_line, when_news
from xihe_blender.cli.shared_options import ESTIMATORS, NETWORK, SIZE, TARGET, one_of
from xihe_blender.errors import UserError
from xihenet.phone import profile_names


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What can be typed."""
    add = parser.add_argument
    add("scenes", type=Path, nargs="+", metavar="SCENE.blend", help="scenes with animated cameras")
    add("--out", type=Path, required=True, metavar="DIR", help="folder of the batch; a stopped batch in it is resumed")
    add("--estimators", type=names, metavar="A,B", help=f"{ESTIMATORS}; default: lattice,projection,ambient,truth")
    add("--profiles", type=names, metavar="A,B", help="phones: " + one_of([*profile_names(), "FILE.toml"]))
    add(
        "--seeds",
        type=whole_numbers,
        default=(0,),
        metavar="N,M",
        help="the room is rendered once for each seed; default: 0",
    )
    add("--preset", default="draft", metavar="NAME", help="draft (default), balanced or accurate: how much is rendered")
    add(
        "--frames", type=frame_range, metavar="A:B[:S]", help="frames of each path; default: the scene's range and step"
    )
    add("--size", type=picture_size, metavar="WxH", help=SIZE)
    add("--target", choices=("ldr", "hdr"), default="ldr", help=TARGET)
    add(
        "--samples",
        type=int,
        metavar="N",
        help="samples of every capture and light probe; default: as many as the preset's noise target needs",
    )
    add("--network", metavar="NAME", help=NETWORK["help"])
    add("--workers", type=int, metavar="N", help="processes on this machine, one thread each; default: one per core")
    add("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers do the work, such as tcp://host:8786")
    add(
        "--frontier",
        type=Path,
        metavar="DIR",
        help="results of xihe frontier to include in the report; default: those in --out",
    )


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> int:
    """Do it; 1 where something could not be done."""
    from xihe_blender.jobs import run_blocking
    from xihe_blender.lab.batch.batch import evaluate_batch
    from xihe_blender.lab.batch.grid import DEFAULT_ESTIMATORS, BatchSettings

    if options.workers is not None and options.workers < 1:
        raise UserError(f"--workers {options.workers}: give 1 or more")
    settings = BatchSettings(
        estimators=DEFAULT_ESTIMATORS if options.estimators is None else options.estimators,
        phones=tuple(_absolute_profile(name) for name in options.profiles or ("perfect",)),
        preset=options.preset,
        target=options.target,
        size=options.size,
        frames=options.frames,
        samples=options.samples,
        network=options.network,
    )
    job = evaluate_batch(
        options.scenes,
        options.out,
        settings,
        options.seeds,
        n_workers=options.workers,
        scheduler=options.scheduler,
        frontier=options.frontier,
    )
    batch = run_blocking(job, when_news(progress_line(stderr)))
    for what, reason in batch.failed.items():
        print(f"xihe: {what}: {reason}", file=stderr)
    n_trials, n_units = len(batch.results.trials), len(batch.results.units)
    print(f"{n_trials} trials in {n_units} units, {batch.n_done_now} of them done now", file=stdout)
    print(options.out / "report.html", file=stdout)
    return EXIT_IN_PART if batch.failed else 0


def _absolute_profile(phone: str) -> str:
    """A profile as workers in another folder find it too."""
    return phone if phone in profile_names() else str(Path(phone).resolve())
