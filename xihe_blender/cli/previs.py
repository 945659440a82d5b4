"""`xihe previs`: one run along the camera path of a scene."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import frame_range, names, picture_size
from xihe_blender.cli.progress import progress_line
from xihe_blender.cli.shared_options import ESTIMATOR, NETWORK, OVERRIDE, PHONE, SIZE, TARGET
from xihe_blender.jobs import run_blocking
from xihenet import estimators

NOISE_TARGET = "largest rendering noise, as a share of the light; default: 0.06, 0.03 or 0.015, by preset"
SAMPLES = "samples of every capture, and pictures of every light probe, whatever the noise"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What can be typed."""
    parser.add_argument("scene", type=Path, metavar="SCENE.blend", help="scene with an animated camera")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder of the run; a stopped run in it is resumed"
    )
    parser.add_argument(
        "--frames", type=frame_range, metavar="A:B[:S]", help="frames of the path; default: the scene's range and step"
    )
    parser.add_argument("--objects", type=names, metavar="A,B", help="virtual objects; default: all")
    parser.add_argument("--estimator", default=estimators.DEFAULT, metavar="NAME", help=ESTIMATOR)
    parser.add_argument(
        "--preset", default="balanced", metavar="NAME", help="draft, balanced or accurate: how much is rendered"
    )
    parser.add_argument("--size", type=picture_size, metavar="WxH", help=SIZE)
    parser.add_argument("--target", choices=("ldr", "hdr"), default="ldr", help=TARGET)
    parser.add_argument(
        "--exposure", type=float, metavar="FACTOR", help="exposure of the phone, locked; default: metered"
    )
    parser.add_argument("--metering", metavar="NAME", help="highlights, as phones do, or key; default: the phone's own")
    parser.add_argument("--phone", **PHONE)
    parser.add_argument("--network", **NETWORK)
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="the same seed gives the same numbers")
    parser.add_argument("--effect", **OVERRIDE)
    budget = parser.add_mutually_exclusive_group()
    budget.add_argument("--noise-target", type=float, metavar="SHARE", help=NOISE_TARGET)
    budget.add_argument("--samples", type=int, metavar="N", help=SAMPLES)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    """Do it, and say what came of it in one line."""
    from xihe_blender.light_transport.overrides import parsed_overrides
    from xihe_blender.previs.previs import previs
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.blend_file import open_blend

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
    print(format_summary(results), file=stdout)
    print(options.out / "report.html", file=stdout)


def format_summary(results: dict[str, Any]) -> str:
    """The result of a previs run for someone who reads only one line."""
    summary, estimator = results["summary"], results["settings"]["estimator"]
    ratio = (summary["rmse_against_ambient"] or {}).get(estimator)
    line = f"{summary['n_active_frames']} of {summary['n_frames']} frames, {summary['n_estimates']} estimates"
    if results["settings"]["network"] is not None:
        line += f", {format_network(summary)}"
    if summary["n_unknown_lights"]:
        line += f", the last light was kept {summary['n_unknown_lights']} times because it was unknown"
    if ratio is None or estimator == "ambient":
        return line
    word = "closer to" if ratio <= 1 else "further from"
    return f"{line}; {estimator} is {abs(1 - ratio):.0%} {word} the ground truth than ambient (RMSE)"


def format_network(summary: dict[str, Any]) -> str:
    """How long estimates took, and how many never came: "84 ms to arrive, none lost"."""
    latency_ms = summary["mean_latency_ms"]
    took = "none arrived" if latency_ms is None else f"{latency_ms:.0f} ms to arrive"
    return f"{took}, {summary['n_lost'] or 'none'} lost"
