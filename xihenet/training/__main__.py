"""`python -m xihenet.training cache | train | report | export`: the command line of training, and nothing else."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from xihenet.training.dataset import CacheSettings, build_cache
from xihenet.training.export import export_lattice
from xihenet.training.loop import TrainSettings, train
from xihenet.training.networks import SAMPLING_OF
from xihenet.training.report import make_report


def main(arguments: Sequence[str] | None = None) -> int:
    """0 done, 2 a user's mistake in one line on stderr, 130 interrupted: the same command goes on."""
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except (ValueError, OSError, ImportError) as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; the same command goes on from the last whole epoch", file=sys.stderr)
        return 130
    return 0


def cache_folder(out: Path, sampling: str, n_anchors: int) -> Path:
    """Where the clouds of one sampling lie."""
    return out / f"clouds_{sampling}_{n_anchors}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m xihenet.training", description="Train the estimators' networks.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_cache_options(commands.add_parser("cache", help="sample the rooms once"), _run_cache)
    training = commands.add_parser("train", help="train a network, or go on with it")
    _add_cache_options(training, _run_train)
    _add_train_options(training)
    report = commands.add_parser("report", help="the table of errors on the test rooms")
    report.add_argument("--clouds", nargs="+", required=True, metavar="SAMPLING=DIR", help="sphere=DIR and others")
    report.add_argument("--network", nargs="*", default=[], metavar="[SAMPLING:]NAME=FILE.pt")
    report.add_argument("--split", choices=("validation", "test"), default="test")
    report.add_argument("--target", choices=("ldr", "hdr"), default="ldr")
    report.add_argument("--merged", action="store_true", help="clouds of all views of a room instead of one")
    report.add_argument("--json", action="store_true")
    report.set_defaults(run=_run_report)
    export = commands.add_parser("export", help="lattice weights for use without torch")
    export.add_argument("network", type=Path)
    export.add_argument("out", type=Path)
    export.add_argument("--data", default="", help="what it was trained on, in words")
    export.set_defaults(run=lambda o: export_lattice(o.network, o.out, data=o.data))
    return parser


def _add_cache_options(parser: argparse.ArgumentParser, run: object) -> None:
    parser.add_argument("--estimator", choices=tuple(SAMPLING_OF), default="lattice")
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="the rooms")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--anchors", type=int, default=1280)
    parser.add_argument("--turns", type=int, default=4, help="training clouds of each pair")
    parser.add_argument("--merged-clouds", type=int, default=4, help="merged training clouds of each position")
    parser.set_defaults(run=run)


def _add_train_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--target", choices=("ldr", "hdr"), default="ldr")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--epochs", type=int, default=60)
    parser.add_argument("--batch-size", type=int, default=64)
    parser.add_argument("--learning-rate", type=float, default=2e-3)
    parser.add_argument("--weight-decay", type=float, default=0.02)
    parser.add_argument("--patience", type=int, default=15)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--keep-unset-at-origin", action="store_true", help="as the reference does (PointConv)")


def _run_cache(options: argparse.Namespace) -> Path:
    sampling = SAMPLING_OF[options.estimator]
    settings = CacheSettings(options.anchors, sampling, options.turns, options.merged_clouds)
    folder = cache_folder(options.out, sampling, options.anchors)
    folder.parent.mkdir(parents=True, exist_ok=True)
    build_cache(options.data, folder, settings, _say)
    return folder


def _run_train(options: argparse.Namespace) -> None:
    if options.keep_unset_at_origin and options.estimator == "lattice":
        raise ValueError("--keep-unset-at-origin: expected a PointConv network, got lattice")
    cache = _run_cache(options)
    settings = TrainSettings(
        cache,
        options.out / f"{options.estimator}_{options.target}_{options.seed}",
        estimator=options.estimator,
        target=options.target,
        seed=options.seed,
        epochs=options.epochs,
        batch_size=options.batch_size,
        learning_rate=options.learning_rate,
        weight_decay=options.weight_decay,
        patience=options.patience,
        device=options.device,
        options={"keeps_unset_at_origin": True} if options.keep_unset_at_origin else {},
    )
    print(train(settings, progress=_say))


def _run_report(options: argparse.Namespace) -> None:
    caches = {name: Path(folder) for name, folder in map(_named, options.clouds)}
    networks = {name: Path(file) for name, file in map(_named, options.network)}
    if "sphere" not in caches:
        raise ValueError("--clouds: expected at least sphere=DIR")
    report = make_report(caches, networks, split=options.split, target=options.target, is_merged=options.merged)
    print(json.dumps(report.as_dict(), indent=1, allow_nan=False) if options.json else report.as_markdown())


def _named(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise ValueError(f"expected NAME=PATH, got {text!r}")
    return name, value


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
