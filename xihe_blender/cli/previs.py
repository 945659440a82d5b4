"""`xihe previs`: one run along the camera path of a scene."""

from __future__ import annotations

import argparse
from typing import Any

from xihe_blender.cli import arguments
from xihe_blender.cli.progress import progress_line
from xihe_blender.io.json_records import from_json
from xihe_blender.io.run_results import RunResults
from xihe_blender.jobs import run_blocking
from xihenet.trigger import RULES

CAPTURED = "frames that are rendered: the whole path (default), or only those with a virtual object in view"
NOISE_TARGET = "largest rendering noise, as a share of the light; default: " + arguments.by_preset("noise_target")
AUTO = "; default: auto, sh+key+reflections where a virtual object is shiny, else sh+key"
OTHERS = "other estimators whose light and pictures are compared with it, from the same frames; default: none"
SAMPLES = "samples of every capture, and pictures of every light probe, whatever the noise"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = arguments.adder(parser)
    arguments.add_scene(add, "folder of the run; a stopped run in it is resumed")
    arguments.add_capture(add)
    add("--captured path|in-view", CAPTURED, default="path")
    add("--backend URL", arguments.BACKEND)
    add("--objects A,B", arguments.OBJECTS, arguments.names)
    add("--others A,B", OTHERS, arguments.names, default=())
    add("--target", arguments.TARGET, choices=("ldr", "hdr"), default="hdr")
    add("--light PARTS", arguments.LIGHT + AUTO, default="auto")
    add("--metering NAME", "highlights, as phones do, or key; default: the phone's own")
    add("--between-estimates carried|kept", arguments.BETWEEN, default="carried")
    add("--trigger", arguments.TRIGGER + "; default: split, or the recording's own", choices=tuple(RULES))
    add("--network NAME", arguments.NETWORK)
    add("--effect NAME=on|off|auto", arguments.EFFECT, dest="overrides", action="append", default=[])
    add_one = arguments.adder(parser.add_mutually_exclusive_group())
    add_one("--noise-target SHARE", NOISE_TARGET, float)
    add_one("--samples N", SAMPLES, int)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.light_transport.overrides import parsed_overrides
    from xihe_blender.previs.previs import previs
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.blend_file import open_blend

    choices = {"trigger": RULES.get(options.trigger), "effect_choices": parsed_overrides(options.overrides)}
    settings = arguments.settings_from(options, PrevisSettings, **choices)
    scene = open_blend(options.scene)
    job = previs(scene, options.out, settings, blend_file=options.scene, command=options.command_line)
    results = run_blocking(job, progress_line(stderr))
    for warning in results["warnings"]:
        print(f"xihe: note: {warning}", file=stderr)
    print(format_summary(results), file=stdout)
    print(options.out / "report.html", file=stdout)


def format_summary(results: dict[str, Any]) -> str:
    """The result of a previs run for someone who reads only one line."""
    from xihe_blender.report.values import too_small_to_judge
    from xihenet.formats import format_count
    from xihenet.invalid import format_unanswered

    run = from_json(RunResults, results)
    summary, estimator = run.summary, run.settings.estimator
    ratio = summary.rmse_against_ambient.get(estimator)
    line = f"{summary.n_active_frames} of {summary.n_frames} frames, {format_count(summary.n_estimates, 'estimate')}"
    if summary.n_estimates == 0 and not run.active_frames:
        return f"{line}: no virtual object was in view of the camera"
    line += format_unanswered(summary.invalid.lights)
    if run.network_in_use is not None:
        latency_ms = summary.mean_latency_ms
        took = "none arrived" if latency_ms is None else f"{latency_ms:.0f} ms to arrive"
        line += f", {took}, {summary.n_lost or 'none'} lost"
    if summary.n_unknown_lights:
        line += f", the last light was kept {summary.n_unknown_lights} times because it was unknown"
    if ratio is None or estimator == "ambient":
        return line
    word = "closer to" if ratio <= 1 else "further from"
    small = too_small_to_judge(summary.object_pixels)
    caveat = "" if small is None else f", but {small}"
    return f"{line}; {estimator} is {abs(1 - ratio):.0%} {word} the ground truth than ambient (RMSE){caveat}"
