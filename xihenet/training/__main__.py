"""`xihe train`, also `python -m xihenet.training`: the command line of training, and nothing else.

xihe train --estimator NAME --data DIR --out DIR     train, or go on with a training
xihe train --report ...                              how good the networks are
xihe train cache | report | export ...               the single steps
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn

from xihenet.estimators.calibration import SHARES_ASKED
from xihenet.io.whole_files import written_whole
from xihenet.option_help import DefaultsHelp
from xihenet.training.calibration import calibrate_elsewhere, calibrate_network
from xihenet.training.dataset import CacheSettings, Content, build_cache
from xihenet.training.loop import TrainSettings, check_trainable, train
from xihenet.training.networks import KINDS, export_network
from xihenet.training.plots import report_plots
from xihenet.training.report import ReportSettings, make_report, report_json
from xihenet.training.report_text import report_markdown
from xihenet.training.rooms import SPLITS

TEST_SWITCHES = ("test_only", "all_rooms", "whole_sphere", "upright", "points")
STEPS = ("cache", "train", "report", "export")


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the usage that hides it."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"formatter_class": DefaultsHelp} | options)

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{message}; see {self.prog} --help")


def main(arguments: Sequence[str] | None = None) -> int:
    """0 done, 2 a user's mistake in one line on stderr, 130 interrupted: the same command goes on."""
    try:
        options = training_parser().parse_args(with_step(sys.argv[1:] if arguments is None else arguments))
        options.run(options)
    except (ValueError, OSError, ImportError) as error:
        print(f"xihe train: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; run the same command again to resume from the last complete epoch", file=sys.stderr)
        return 130
    return 0


def with_step(arguments: Sequence[str]) -> list[str]:
    """The arguments with the step in front: what is named first, the report for `--report`, else training."""
    words = list(arguments)
    if "--report" in words:
        return ["report", *(word for word in words if word != "--report")]
    return words if words and words[0] in (*STEPS, "-h", "--help") else ["train", *words]


def training_parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="xihe train", description="Train the estimators' networks.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    cache = commands.add_parser("cache", help="sample the rooms into anchor clouds, once for all trainings")
    _add_cache_options(cache, _run_cache)
    _add_test_options(cache)
    training = commands.add_parser(
        "train", help="train a network or resume a stopped training; the word train may be left out"
    )
    _add_cache_options(training, _run_train)
    _add_train_options(training)
    report = commands.add_parser("report", help="measure networks on the test rooms; also xihe train --report")
    _add_report_options(report)
    _add_export_options(commands.add_parser("export", help="write weights in the form that estimators read"))
    return parser


def _add_cache_options(parser: argparse.ArgumentParser, run: object) -> None:
    add = parser.add_argument
    add("--estimator", choices=tuple(KINDS), default="lattice", help="network")
    add("--data", type=Path, nargs="+", required=True, metavar="DIR", help="folders of the rooms, of different seeds")
    add("--out", type=Path, required=True, metavar="DIR", help="folder of the sampled clouds and networks")
    add("--anchors", type=int, default=1280, metavar="N", help="anchors of a cloud")
    add("--changes", type=int, default=6, metavar="N", help="training clouds of each view and position")
    add("--merged-clouds", type=int, default=8, metavar="N", help="merged training clouds of each position")
    parser.set_defaults(run=run)


def _add_test_options(parser: argparse.ArgumentParser) -> None:
    """For clouds that are only reported on."""
    add = parser.add_argument
    add("--test-only", action="store_true", help="sample the test rooms alone")
    add("--all-rooms", action="store_true",
        help="treat every room as a test room, for walks and scenes outside the data set")  # fmt: skip
    add("--whole-sphere", action="store_true", help="set every anchor, with the colour of the light probe")
    add("--upright", action="store_true", help="see the rooms as a phone turned by 90 degrees does")
    add("--points", action="store_true", help="sample points alone, without patches of surface, for comparison")


def _add_train_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--target", choices=("ldr", "hdr"), default="ldr", help="light to learn: clipped at white, or all of it")
    add("--seed", type=int, default=0, metavar="N",
        help="the same seed trains the same network, to the last bit with one thread (OMP_NUM_THREADS=1)")  # fmt: skip
    add("--epochs", type=int, default=60, metavar="N", help="passes over the training clouds, at most")
    add("--batch-size", type=int, default=64, metavar="N", help="clouds in a batch")
    add("--learning-rate", type=float, default=2e-3, metavar="RATE", help="highest learning rate")
    add("--weight-decay", type=float, default=0.02, metavar="FACTOR", help="weight decay of the optimiser")
    add("--patience", type=int, default=15, metavar="N", help="epochs without improvement after which training ends")
    add(
        "--logarithmic-loss",
        action="store_true",
        dest="is_logarithmic",
        help="use the logarithm of each light's error as the loss",
    )
    add("--huber-delta", type=float, default=1.0, metavar="ERROR",
        help="error of a coefficient from which the loss is linear in it")  # fmt: skip
    add("--start", type=Path, metavar="WEIGHTS", help="weights to begin with, an .npz file; default: random")
    add("--start-share", type=float, default=0.0, metavar="SHARE",
        help="share of the weights of --start in the network that is kept")  # fmt: skip
    add("--device", default="cpu", metavar="NAME", help="device that torch trains on, such as cuda")
    add("--rooms", type=int, metavar="N", help="train on the first N rooms alone, for learning curves")
    add("--keep-unset-at-origin", action="store_true",
        help="leave unset anchors at the origin, as the paper's code does (PointConv)")  # fmt: skip
    add("--bfloat16", action="store_true", help="train in half precision (PointConv)")


def _add_export_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("network", type=Path, help="trained network, a .pt file, or weights of lattice to calibrate again, .npz")
    add("out", type=Path, help="weights to write, an .npz file")
    add("--data", default="", help="description of the training data")
    add("--anchors", type=int, metavar="N", help="points that a PointConv network was trained with")
    add("--clouds", type=Path, metavar="DIR",
        help="sampled validation rooms that calibrate the expected error of lattice")  # fmt: skip
    add(
        "--elsewhere", type=Path, nargs="+", default=(), metavar="DIR",
        help="sampled clouds of rooms of another kind, a folder each, that calibrate it instead of --clouds",
    )  # fmt: skip
    parser.set_defaults(run=_run_export)


def _run_export(options: argparse.Namespace) -> None:
    figures = {}
    if options.elsewhere:
        calibration, kept = calibrate_elsewhere(options.network, options.elsewhere)
        for views, of_views in kept.items():
            promised = zip(SHARES_ASKED, of_views, strict=True)
            said = ", ".join(f"{share:.0%} in {held:.0%}" for share, held in promised)
            _say(f"kept in rooms left out, {views}: {said}")
        figures = calibration.as_figures()
    elif options.clouds is not None:
        figures = calibrate_network(options.network, [options.clouds]).as_figures()
    export_network(options.network, options.out, data=options.data, figures=figures, n_points=options.anchors)


def _run_cache(options: argparse.Namespace, check: Callable[[Path, Content], None] = lambda *_: None) -> Path:
    """The folder of the clouds; options for tests are missing where networks are trained.

    `check` may refuse that folder and what it will be made of before anything is made.
    """
    test_only, all_rooms, whole_sphere, upright, points = (getattr(options, name, False) for name in TEST_SWITCHES)
    is_test = test_only or all_rooms or whole_sphere or upright
    settings = CacheSettings(
        options.anchors, KINDS[options.estimator].sampling, options.changes, options.merged_clouds,
        is_test_only=all_rooms, is_whole_sphere=whole_sphere, is_upright=upright, has_patches=not points,
        only=("test",) if is_test else SPLITS,
    )  # fmt: skip
    kinds = {"test": is_test, "whole": whole_sphere, "upright": upright, "points": points}
    name = [f"clouds_{settings.sampling}_{options.anchors}", *(kind for kind, is_on in kinds.items() if is_on)]
    folder: Path = options.out / "_".join(name)
    folder.parent.mkdir(parents=True, exist_ok=True)
    build_cache(options.data, folder, settings, _say, lambda content: check(folder, content))
    return folder


def _run_train(options: argparse.Namespace) -> None:
    switches = {"keeps_unset_at_origin": options.keep_unset_at_origin, "is_bfloat16_in_training": options.bfloat16}
    architecture = {name: True for name, is_on in switches.items() if is_on}
    if architecture and options.estimator == "lattice":
        raise ValueError("--keep-unset-at-origin and --bfloat16: expected a PointConv network, got lattice")
    name = f"{options.estimator}_{options.target}_{options.seed}"
    out = options.out / (name if options.rooms is None else f"{name}_{options.rooms}rooms")
    same_named = {part.name: getattr(options, part.name) for part in fields(TrainSettings) if part.name in options}

    def settings_on(cache: Path) -> TrainSettings:
        own = {"cache": cache, "out": out, "n_rooms": options.rooms, "options": architecture}
        return TrainSettings(**{**same_named, **own})

    clouds = _run_cache(options, lambda cache, content: check_trainable(settings_on(cache), content))
    print(train(settings_on(clouds), progress=_say))


def _add_report_options(parser: argparse.ArgumentParser) -> None:
    """Options of the report, and what runs it."""
    add = parser.add_argument
    add("--clouds", nargs="+", action="extend", required=True, type=Path, metavar="DIR",
        help="sampled clouds of the rooms, a folder for each sampling and number of anchors")  # fmt: skip
    add("--network", nargs="+", action="extend", default=[], metavar="[SAMPLING_ANCHORS:]NAME=FILE",
        help="a trained network; several of one name are its seeds")  # fmt: skip
    add("--split", choices=("validation", "test"), default="test", help="rooms to measure on")
    add("--target", choices=("ldr", "hdr"), default="ldr", help="light to compare with: clipped at white, or all of it")
    add("--walk", nargs="+", action="extend", default=[], type=Path, metavar="DIR", help="sampled clouds of walks")
    add("--whole", nargs="+", action="extend", default=[], type=Path, metavar="DIR",
        help="sampled clouds with every anchor set")  # fmt: skip
    add("--scene", nargs="+", action="extend", default=[], metavar="NAME=DIR", help="sampled clouds of another scene")
    add("--group", nargs="+", action="extend", default=[], metavar="NAME=DIR",
        help="clouds sampled in another way, for the table of disturbances")  # fmt: skip
    add("--learning", nargs="+", action="extend", default=[], metavar="ROOMS=FILE",
        help="a network trained on that many rooms; several with the same number are its seeds")  # fmt: skip
    add("--device", default="cpu", metavar="NAME", help="device that torch runs on, such as cuda")
    add("--json", type=Path, metavar="FILE", help="file for all figures; - prints them and nothing else on stdout")
    add("--markdown", type=Path, metavar="FILE", help="file for the tables; default: print them")
    add("--plots", type=Path, metavar="DIR", help="folder for plots in SVG")
    parser.set_defaults(run=_run_report)


def _run_report(options: argparse.Namespace) -> None:
    """Make the report and write it where the options say. ValueError for a user's mistake."""
    report = make_report(_report_settings(options), _say)
    figures = report_json(report)
    is_alone = options.json == Path("-")
    if is_alone:
        sys.stdout.write(figures)
    elif options.json is not None:
        _write(options.json, figures)
    if options.markdown is not None:
        _write(options.markdown, report_markdown(report))
    elif not is_alone:
        sys.stdout.write(report_markdown(report))
    if options.plots is not None:
        for name, svg in report_plots(report).items():
            _write(options.plots / f"{name}.svg", svg)


def _report_settings(options: argparse.Namespace) -> ReportSettings:
    learning = _named_paths(options.learning)
    for name in learning:
        if not (name.isdecimal() and int(name) > 0):
            raise ValueError(f"--learning: expected ROOMS=FILE with a number of rooms, got {name!r}")
    return ReportSettings(
        options.clouds, _named_paths(options.network), split=options.split, target=options.target, walks=options.walk,
        whole=options.whole, scenes=_named_paths(options.scene), stress=_named_paths(options.group),
        learning={int(name): files for name, files in learning.items()}, device=options.device,
    )  # fmt: skip


def _named_paths(words: Sequence[str]) -> dict[str, list[Path]]:
    """NAME=PATH by name, in their order; ValueError for other words."""
    paths: dict[str, list[Path]] = {}
    for word in words:
        name, _, value = word.partition("=")
        if not (name and value):
            raise ValueError(f"expected NAME=PATH, got {word!r}")
        paths.setdefault(name, []).append(Path(value))
    return paths


def _write(path: Path, text: str) -> None:
    """Whole or not at all."""
    with written_whole(path) as beside:
        beside.write_text(text, encoding="utf-8")


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
