"""`xihe train --report`: which options does a report take, and where does it go?"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from xihenet.training.plots import report_plots
from xihenet.training.report import ReportSettings, make_report
from xihenet.training.report_text import report_markdown


def add_report_options(parser: argparse.ArgumentParser) -> None:
    """Options of the report, and what runs it."""
    add = parser.add_argument
    add("--clouds", nargs="+", action="extend", required=True, type=Path, metavar="DIR",
        help="sampled clouds of the rooms, a folder for each sampling and number of anchors")  # fmt: skip
    add("--network", nargs="+", action="extend", default=[], metavar="[SAMPLING_ANCHORS:]NAME=FILE",
        help="a trained network; several of one name are its seeds")  # fmt: skip
    add("--split", choices=("validation", "test"), default="test")
    add("--target", choices=("ldr", "hdr"), default="ldr")
    add("--walk", nargs="+", action="extend", default=[], type=Path, metavar="DIR", help="sampled clouds of walks")
    add("--whole", nargs="+", action="extend", default=[], type=Path, metavar="DIR",
        help="sampled clouds of which every anchor is set")  # fmt: skip
    add("--scene", nargs="+", action="extend", default=[], metavar="NAME=DIR", help="sampled clouds of another scene")
    add("--group", nargs="+", action="extend", default=[], metavar="NAME=DIR",
        help="clouds sampled otherwise, for the table of disturbances")  # fmt: skip
    add("--learning", nargs="+", action="extend", default=[], metavar="ROOMS=FILE",
        help="a network trained on so many rooms; several of one number are its seeds")  # fmt: skip
    add("--device", default="cpu")
    add("--json", type=Path, metavar="FILE", help="all figures; - writes them, and nothing else, to standard output")
    add("--markdown", type=Path, metavar="FILE", help="the tables, which else go to standard output")
    add("--plots", type=Path, metavar="DIR", help="folder for plots in SVG")
    parser.set_defaults(run=run_report)


def run_report(options: argparse.Namespace) -> None:
    """Make the report and write it where the options say. ValueError for a user's mistake."""
    report = make_report(_settings(options), _say).as_dict()
    figures = json.dumps(report, indent=1, allow_nan=False) + "\n"
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


def _settings(options: argparse.Namespace) -> ReportSettings:
    return ReportSettings(
        options.clouds,
        named_paths(options.network),
        split=options.split,
        target=options.target,
        walks=options.walk,
        whole=options.whole,
        scenes=named_paths(options.scene),
        stress=named_paths(options.group),
        learning=_by_number(named_paths(options.learning)),
        device=options.device,
    )


def named_paths(words: Sequence[str]) -> dict[str, list[Path]]:
    """NAME=PATH by name, in their order; ValueError for other words."""
    paths: dict[str, list[Path]] = {}
    for word in words:
        name, _, value = word.partition("=")
        if not (name and value):
            raise ValueError(f"expected NAME=PATH, got {word!r}")
        paths.setdefault(name, []).append(Path(value))
    return paths


def _by_number(files: Mapping[str, Sequence[Path]]) -> dict[int, Sequence[Path]]:
    for name in files:
        if not (name.isdecimal() and int(name) > 0):
            raise ValueError(f"--learning: expected ROOMS=FILE with a number of rooms, got {name!r}")
    return {int(name): paths for name, paths in files.items()}


def _write(path: Path, text: str) -> None:
    """Whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.part")
    beside.write_text(text, encoding="utf-8")
    beside.replace(path)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
