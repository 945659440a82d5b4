"""`xihe placement`: where in the room AR light will be right, and where it will fail."""

from __future__ import annotations

import argparse
from typing import Any

from xihe_blender.cli import arguments
from xihe_blender.cli.progress import progress_line
from xihe_blender.jobs import run_blocking
from xihenet.formats import format_count

SPACING = "distance between places, however many that makes; default: the smallest that --places allows"
CLEARANCE = "height of a place above its surface, without --height; default: 0.1"
PLACES = "largest number of places; default: 1000"
VERIFY = "places whose light probe is rendered, to say how far the map is right; default: 0"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = arguments.adder(parser)
    arguments.add_scene(add, "folder of the map; captures in it are resumed, and used again for other places")
    add("--height METRES", "a grid in free air at this height; default: upward surfaces", float, dest="height_m")
    add("--spacing METRES", SPACING, float, dest="spacing_m")
    add("--clearance METRES", CLEARANCE, float, dest="clearance_m", default=0.1)
    add("--reach METRES", "largest distance of a place from the camera", float, dest="reach_m", default=5.0)
    add("--places N", PLACES, int, dest="most", default=1000)
    add("--verify N", VERIFY, int, dest="n_verified", default=0)
    arguments.add_capture(add)
    add("--target", arguments.TARGET, choices=("ldr", "hdr"), default="hdr")
    add("--samples N", arguments.SAMPLES, int)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.io.placement_results import ENOUGH
    from xihe_blender.previs.placement import PlacementSettings, placement
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.blend_file import open_blend

    settings = arguments.settings_from(options, PrevisSettings)
    wanted = arguments.settings_from(options, PlacementSettings)
    scene = open_blend(options.scene)
    job = placement(scene, options.out, settings, wanted, blend_file=options.scene, command=options.command_line)
    results = run_blocking(job, progress_line(stderr))
    known = results.best_first
    line = f"{format_count(len(results.places), 'place')} {results.spacing_m:.2f} m apart, {results.n_unknown} unknown"
    if known:
        line += f"; expected error {known[0].expected_error:.3f} to {known[-1].expected_error:.3f}"
    print(line, file=stdout)
    if results.verified is not None and results.verified.rank_correlation is not None:
        found = results.verified
        interval = f" ({found.interval[0]:.2f} to {found.interval[1]:.2f})" if found.interval else ""
        print(
            f"rank correlation with the true error at {found.n_places} places: {found.rank_correlation:.2f}{interval}"
            + (", too few to tell much" if found.n_places < ENOUGH else ""),
            file=stdout,
        )
    print(options.out / "report.html", file=stdout)
