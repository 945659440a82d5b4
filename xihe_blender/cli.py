"""The `xihe` command: what a user types, turned into calls of the functions that do the work.

Exit codes: 0 the job was done; 1 a part of it could not be, and each is named; 2 the user can mend it, and one line
says how; 130 after Ctrl-C, and the same command goes on from there. What Blender prints is kept away from stdout, at
the level of file descriptors, since Cycles writes there from C++.
"""

from __future__ import annotations

import argparse
import atexit
import contextlib
import errno
import json
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from xihe_blender.arguments import frame_range, names, picture_size
from xihe_blender.errors import UserError
from xihe_blender.evaluation.batch.command import add_evaluate
from xihe_blender.evaluation.frontier.command import add_frontier
from xihenet import __version__, estimators
from xihenet.phone import LINKS, profile_names

if TYPE_CHECKING:
    from xihe_blender.jobs import Progress

EXIT_IN_PART = 1
EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130
OVERRIDE: dict[str, Any] = {
    "dest": "overrides",
    "action": "append",
    "default": [],
    "metavar": "NAME=on|off|auto",
    "help": "an effect, whatever the scene calls for; may be repeated, is not saved",
}
PHONE: dict[str, Any] = {"default": "perfect", "metavar": "NAME|FILE.toml", "help": ", ".join(profile_names())}
NETWORK: dict[str, Any] = {"metavar": "NAME", "help": ", ".join(LINKS) + "; default: estimates arrive at once"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    typed = list(sys.argv[1:] if arguments is None else arguments)
    if typed[:1] == ["train"]:
        return _train(typed[1:])
    try:
        options = _parser().parse_args(with_positions_bound(typed))
        options.command_line = shlex.join(["xihe", *typed])
        with blender_output_aside() as (stdout, stderr):
            code = options.run(options, stdout, stderr)
    except UserError as error:
        return _failed(str(error))
    except OSError as error:
        return _failed(_said_of_the_disk(error))
    except KeyboardInterrupt:
        # On a terminal the line of progress, with "^C" at its end, stands there unfinished.
        start = "\n" if sys.stderr.isatty() else ""
        print(f"{start}xihe: stopped; the same command goes on from here", file=sys.stderr)
        return EXIT_INTERRUPTED
    return code or 0


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the usage that hides it."""

    def error(self, message: str) -> NoReturn:
        raise UserError(f"{message}; see {self.prog} --help")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="xihe", description="AR lighting previsualisation in Blender.")
    parser.add_argument("--version", action="version", version=f"xihe {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    previs = commands.add_parser("previs", help="what a phone on the scene's camera path believes about the light")
    previs.add_argument("scene", type=Path, metavar="SCENE.blend")
    previs.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder of the run; resumed if it exists"
    )
    previs.add_argument("--frames", type=frame_range, metavar="A:B[:S]", help="default: the scene's range and step")
    previs.add_argument("--objects", type=names, metavar="A,B", help="virtual objects; default: all")
    previs.add_argument("--estimator", default=estimators.DEFAULT, metavar="NAME", help=", ".join(estimators.names()))
    previs.add_argument("--preset", default="balanced", metavar="NAME", help="draft, balanced or accurate")
    previs.add_argument("--size", type=picture_size, metavar="WxH", help="default: 256x192, upright for a portrait")
    previs.add_argument(
        "--target", choices=("ldr", "hdr"), default="ldr", help="light that coefficients are held against"
    )
    previs.add_argument("--exposure", type=float, metavar="FACTOR", help="of the phone; default: metered")
    previs.add_argument("--metering", metavar="NAME", help="highlights or key; default: the phone's own")
    previs.add_argument("--phone", **PHONE)
    previs.add_argument("--network", **NETWORK)
    previs.add_argument("--seed", type=int, default=0)
    previs.add_argument("--effect", **OVERRIDE)
    effort = previs.add_mutually_exclusive_group()
    effort.add_argument("--noise-target", type=float, metavar="SHARE", help="of the light; default: the preset's")
    effort.add_argument("--samples", type=int, metavar="N", help="of every capture and probe, whatever the noise")
    previs.set_defaults(run=_previs)
    effects = commands.add_parser("effects", help="which effects of light transport the scene calls for, and why")
    effects.add_argument("scene", type=Path, metavar="SCENE.blend")
    effects.add_argument("--frames", type=frame_range, metavar="A:B[:S]", help="default: the scene's range and step")
    effects.add_argument("--effect", **OVERRIDE)
    effects.add_argument("--phone", **PHONE)
    effects.add_argument("--network", **NETWORK)
    effects.add_argument("--plan-only", action="store_true", help="render nothing: no costs, no changes, no captures")
    effects.add_argument("--json", action="store_true", help="JSON on stdout, and nothing else")
    effects.set_defaults(run=_effects)
    add_frontier(commands)
    _add_estimate(commands)
    scenes = commands.add_parser("scenes", help="the example scenes")
    scenes.add_argument("action", choices=("build",), help="build the .blend files from their scripts")
    scenes.set_defaults(run=_scenes)
    _add_dataset(commands)
    _add_package(commands)
    add_evaluate(commands)
    commands.add_parser("train", help="train estimators and report on them: see xihe train --help")
    return parser


def _add_dataset(commands: Any) -> None:
    dataset = commands.add_parser("dataset", help="rooms to train estimators on")
    actions = dataset.add_subparsers(dest="action", required=True, metavar="ACTION")
    build = actions.add_parser("build", help="make and render procedural rooms; resumes what is there")
    add = build.add_argument
    add("--rooms", type=int, required=True, metavar="N", help="rooms in all")
    add("--out", type=Path, required=True, metavar="DIR", help="one .npz per room")
    add("--workers", type=int, metavar="K", help="processes of one thread; default: one per core")
    add("--seed", type=int, default=0)
    add("--walk", type=int, metavar="F", help="F frames of a walk through each room; default: free views")
    add("--split", metavar="NAME", help="only the rooms of train, validation or test; default: all")
    add("--scheduler", metavar="ADDRESS", help="a Dask scheduler whose workers make them; default: processes here")
    build.set_defaults(run=_dataset_build)
    scene = actions.add_parser("scene", help="a scene with a camera path as one more room")
    add = scene.add_argument
    add("scene", type=Path, metavar="SCENE.blend")
    add("--out", type=Path, required=True, metavar="DIR", help="a folder of scenes; one of the same name is replaced")
    add("--frames", type=frame_range, metavar="A:B[:S]", help="default: the scene's range and step")
    add("--at", type=names, metavar="A,B", help="objects that mark positions; default: the virtual objects")
    scene.set_defaults(run=_dataset_scene)


def _add_estimate(commands: Any) -> None:
    from xihe_blender.estimate_command import position, run_estimate

    estimate = commands.add_parser("estimate", help="the light in one RGB-D frame from anywhere; needs no Blender")
    add = estimate.add_argument
    add("frame", type=Path, metavar="FRAME", help="OpenEXR with colour and Z, or a colour image with --plane-depth")
    add("--camera", type=Path, required=True, metavar="FILE.json", help="intrinsics and pose")
    add("--at", type=position, action="append", required=True, metavar="X,Y,Z", help="metres; may be repeated")
    add("--plane-depth", type=Path, metavar="FILE", help="16-bit image of distances along the optical axis")
    add("--depth-scale", type=float, default=1e-3, metavar="METRES", help="metres per unit of that; default: 0.001")
    add("--exposure", type=float, metavar="FACTOR", help="default: metered for OpenEXR, 1 for images")
    add("--estimator", default=estimators.DEFAULT, metavar="NAME", help=", ".join(estimators.names()))
    add("--target", choices=("ldr", "hdr"), default="ldr", help="light clipped at white, or all of it")
    add("--anchors", type=int, default=1280, metavar="N", help="directions that light is gathered in")
    add("--json", action="store_true", help="JSON on stdout, and nothing else")
    add("--out", type=Path, metavar="DIR", help="folder for estimate.json and a picture of each light")
    estimate.set_defaults(run=run_estimate)


def _add_package(commands: Any) -> None:
    from xihe_blender.package import run_package

    package = commands.add_parser("package", help="the Blender extension as a zip, from a checkout; needs no Blender")
    add = package.add_argument
    add("--out", type=Path, required=True, metavar="DIR", help="folder for xihe-<version>.zip")
    add("--wheels", type=Path, metavar="DIR", help="wheels of others; missing ones are fetched; default: a cache")
    package.set_defaults(run=run_package)


def with_positions_bound(typed: Sequence[str]) -> list[str]:
    """`typed` with "--at", "-1,0,2" as one word: on its own, what begins with a minus looks like an option."""
    bound: list[str] = []
    for word in typed:
        if bound and bound[-1] == "--at" and re.match(r"-[\d.]", word):
            bound[-1] = f"--at={word}"
        else:
            bound.append(word)
    return bound


def _previs(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.blend_file import open_blend
    from xihe_blender.effects.overrides import parsed_overrides
    from xihe_blender.jobs import run_blocking
    from xihe_blender.previs import previs
    from xihe_blender.previs_settings import PrevisSettings

    settings = PrevisSettings(
        estimator=options.estimator,
        preset=options.preset,
        target=options.target,
        size=options.size,
        frames=options.frames,
        objects=options.objects,
        exposure=options.exposure,
        metering=options.metering,
        seed=options.seed,
        phone=options.phone,
        network=options.network,
        effect_choices=parsed_overrides(options.overrides),
        noise_target=options.noise_target,
        samples=options.samples,
    )
    scene = open_blend(options.scene)
    job = previs(scene, options.out, settings, blend_file=options.scene, command=options.command_line)
    results = run_blocking(job, progress_line(stderr))
    print(said_in_one_line(results), file=stdout)
    print(options.out / "report.html", file=stdout)


def said_in_one_line(results: dict[str, Any]) -> str:
    """The result of a previs run for someone who reads only one line."""
    summary, estimator = results["summary"], results["settings"]["estimator"]
    ratio = (summary["rmse_against_ambient"] or {}).get(estimator)
    line = f"{summary['n_active_frames']} of {summary['n_frames']} frames, {summary['n_estimates']} estimates"
    if results["settings"]["network"] is not None:
        line += f", {said_of_the_network(summary)}"
    if summary["n_unknown_lights"]:
        line += f", the light was kept {summary['n_unknown_lights']} times where it could not be known"
    if ratio is None or estimator == "ambient":
        return line
    word = "closer to" if ratio <= 1 else "further from"
    return f"{line}; {estimator} is {abs(1 - ratio):.0%} {word} the ground truth than ambient (RMSE)"


def said_of_the_network(summary: dict[str, Any]) -> str:
    """How long estimates took, and how many never came: "84 ms on their way, none lost"."""
    latency_ms = summary["mean_latency_ms"]
    took = "none arrived" if latency_ms is None else f"{latency_ms:.0f} ms on their way"
    return f"{took}, {summary['n_lost'] or 'none'} lost"


def _effects(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.blend_file import open_blend
    from xihe_blender.effects.command import report_effects, said_as_table
    from xihe_blender.effects.overrides import parsed_overrides
    from xihe_blender.jobs import run_blocking

    overrides = parsed_overrides(options.overrides)
    scene = open_blend(options.scene)
    session = {"phone": options.phone, "network": options.network}
    job = report_effects(scene, options.frames, overrides, **session, is_measured=not options.plan_only)
    report = run_blocking(job, when_news(progress_line(stderr)))
    print(json.dumps(report.as_json(), indent=1) if options.json else said_as_table(report), file=stdout)


def _scenes(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    import runpy

    script = Path(__file__).resolve().parent.parent / "blend_scenes" / "build_all.py"
    if not script.exists():
        raise UserError(f"{script} is not there: build the scenes from a checkout of the project")
    runpy.run_path(str(script), run_name="__main__")


def _dataset_build(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.dataset.build import BuildSettings, build_dataset
    from xihe_blender.jobs import run_blocking

    settings = BuildSettings(
        options.rooms, options.seed, options.workers,
        walk=options.walk, split=options.split, scheduler=options.scheduler,
    )  # fmt: skip
    n_made = run_blocking(build_dataset(options.out, settings), when_news(progress_line(stderr)))
    print(f"{len(settings.wanted())} rooms in {options.out}, {n_made} of them made now", file=stdout)


def _dataset_scene(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.blend_file import open_blend
    from xihe_blender.dataset.render_room import RoomRenderSettings
    from xihe_blender.dataset.scene import add_scene
    from xihe_blender.jobs import run_blocking

    scene = open_blend(options.scene)
    job = add_scene(scene, options.scene.stem, options.out, RoomRenderSettings(), frames=options.frames, at=options.at)
    print(run_blocking(job, progress_line(stderr)), file=stdout)


def _train(arguments: Sequence[str]) -> int:
    """Training has its own command line, which needs torch and no Blender."""
    try:
        from xihenet.training.__main__ import main as train_main
    except ImportError:
        return _failed("train: torch is not installed; pip install 'xihe-blender[train]'")
    return train_main(arguments)


def when_news(show: Callable[[Progress, float], None]) -> Callable[[Progress, float], None]:
    """`show`, called only when more is done than before: for jobs that yield while they wait."""
    last = -1.0

    def show_news(progress: Progress, elapsed_s: float) -> None:
        nonlocal last
        if progress.done > last:
            last = progress.done
            show(progress, elapsed_s)

    return show_news


def progress_line(stream: Any) -> Callable[[Progress, float], None]:
    """Shows progress on `stream`: on one line that is rewritten on a terminal, line by line elsewhere."""

    def show(progress: Progress, elapsed_s: float) -> None:
        left = progress.seconds_left(elapsed_s)
        remaining = "" if left is None or progress.done >= progress.total else f", {left:.0f} s left"
        line = f"{progress.done / progress.total:4.0%}  {progress.doing}{remaining}"
        end = "\n" if not stream.isatty() or progress.done >= progress.total else ""
        print(f"\r\033[K{line}" if stream.isatty() else line, file=stream, end=end, flush=True)

    return show


@contextlib.contextmanager
def blender_output_aside() -> Iterator[tuple[Any, Any]]:
    """Send what is written to file descriptors 1 and 2 nowhere during the block; give the real stdout and stderr.

    With XIHE_VERBOSE set in the environment it goes to stderr instead.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    real = [os.dup(1), os.dup(2)]
    aside = os.dup(2) if os.environ.get("XIHE_VERBOSE") else os.open(os.devnull, os.O_WRONLY)
    os.dup2(aside, 1)
    os.dup2(aside, 2)
    streams = [os.fdopen(descriptor, "w", closefd=False) for descriptor in real]
    try:
        yield streams[0], streams[1]
    finally:
        # Registered after Blender was loaded, it runs before Blender ends, and 4.5 prints a line to stdout as it ends.
        atexit.unregister(close_stdout)
        atexit.register(close_stdout)
        # Blender's operators write what they report through Python's own stream.
        for stream in (*streams, sys.stdout, sys.stderr):
            stream.flush()
        for place, descriptor in enumerate(real, start=1):
            os.dup2(descriptor, place)
            os.close(descriptor)
        os.close(aside)


def close_stdout() -> None:
    """Send what still comes from this process' C++ nowhere."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)


def _failed(message: str) -> int:
    """Say in one line what the user can mend, and return the exit code for it."""
    print(f"xihe: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_USER_ERROR


def _said_of_the_disk(error: OSError) -> str:
    if error.errno is None:
        # Raised by ourselves, with the fix in it.
        return f"{error}; then the same command goes on from here"
    place = "" if error.filename is None else f"{error.filename}: "
    fix = "free some space" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "mend that"
    return f"{place}{error.strerror or error}; {fix}, and the same command goes on from here"
