"""`xihe export`: the light of a run as an engine takes it, without Blender; or a page that shows the run, with it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, get_args

from xihe_blender.cli.arguments import adder, names, one_of
from xihe_blender.errors import UserError
from xihe_blender.io.run_lights import UNITS, LightsAsked, export_lights
from xihe_blender.io.run_results import read_results
from xihenet.light import LightParts
from xihenet.light.platforms import PLATFORMS

VIEWER = "viewer"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    readings = "; ".join(
        f"{name}: {', '.join(one.readings)}" for name, one in PLATFORMS.items() if len(one.readings) > 1
    )
    add("results RESULTS.json", "of a run that is done, or its folder", Path)
    target = f"engine or file format, {one_of(PLATFORMS)}; or {VIEWER}, a page to send that shows the run"
    add("--to TARGET", target, choices=(*PLATFORMS, VIEWER), required=True)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--frame", metavar="N", type=int, help="light in force at this frame; default: the last one")
    which.add_argument("--all", action="store_true", help="every light of the path, from the frame on where it changes")
    add("--objects A,B", "virtual objects; default: all", names)
    parts = "what is written: spherical harmonics, a main light apart, pictures for reflections; default: as in the run"
    add("--light PARTS", parts, choices=get_args(LightParts))
    add(
        "--reading NAME",
        f"where sources of an engine disagree, which is followed; the first is the default. {readings}",
    )
    add(
        "--units",
        "picture: 1 is white in the phone's picture; scene: radiance in Blender",
        choices=tuple(UNITS),
        default="picture",
    )
    blend = f"for {VIEWER}: the file with the virtual objects; default: the lit one in the run's folder"
    add("--blend FILE.blend", blend, Path)
    out = f"folder for the files; default: exports/TARGET in the run's folder, for {VIEWER} the folder itself"
    add("--out DIR", out, Path)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    folder = options.results.parent if options.results.name == "results.json" else options.results
    results = read_results(folder)
    if options.to == VIEWER:
        if options.frame is not None or options.reading is not None:
            raise UserError(f"{VIEWER} shows the whole run: leave out --frame and --reading")
        from xihe_blender.viewer.save import save_viewer

        print(save_viewer(results, folder, options.objects, blend=options.blend, out=options.out), file=stdout)
        return
    asked = LightsAsked(options.frame, options.all, options.objects, options.light, options.units)
    for path in export_lights(results, folder, options.to, asked, reading=options.reading, out=options.out):
        print(path, file=stdout)
