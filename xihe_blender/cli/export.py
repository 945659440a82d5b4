"""`xihe export`: the light of a run as an engine takes it, without Blender; or a page that shows the run, with it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, get_args

from xihe_blender.cli.arguments import OBJECTS, adder, names, one_of
from xihe_blender.errors import UserError
from xihe_blender.io.run_lights import UNITS, LightsAsked, lights_asked, write_lights
from xihe_blender.io.run_results import read_results
from xihenet.light import LightParts
from xihenet.light.platforms import PLATFORMS

VIEWER = "viewer"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    readings = "; ".join(
        f"{name}: {', '.join(one.readings)}" for name, one in PLATFORMS.items() if len(one.readings) > 1
    )
    parser.add_argument(
        "results", metavar="RESULTS.json", type=Path, nargs="?", help="results of a finished run, or its folder"
    )
    lit = (
        "instead of a run: a .blend whose virtual objects are lit; needs Blender, has no reflections. "
        f"For {VIEWER}, with the run: the file with the objects; default: the lit one in the run's folder"
    )
    add("--from FILE.blend", lit, Path, dest="lit")
    target = f"engine or file format, {one_of(PLATFORMS)}; or {VIEWER}, a page to send that shows the run"
    add("--to TARGET", target, choices=(*PLATFORMS, VIEWER), required=True)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--frame", metavar="N", type=int, help="light in use at this frame; default: the last one")
    which.add_argument("--all", action="store_true", help="every light of the path, from the frame on where it changes")
    add("--objects A,B", OBJECTS, names)
    parts = (
        "what is written: spherical harmonics, the key light apart, pictures for reflections; default: as in the run"
    )
    add("--light PARTS", parts, choices=get_args(LightParts))
    add(
        "--reading NAME",
        f"where sources of an engine disagree, which is followed; the first is the default. {readings}",
    )
    units = "picture: 1 is white in the phone's picture; scene: radiance in Blender"
    add("--units", units, choices=tuple(UNITS), default="picture")
    out = f"folder for the files; default: exports/TARGET in the run's folder, for {VIEWER} the folder itself"
    add("--out DIR", out, Path)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    if options.to == VIEWER:
        written = [_viewer(options)]
    elif (options.results is None) == (options.lit is None):
        raise UserError("give either RESULTS.json or --from FILE.blend")
    elif options.lit is None:
        written = _of_run(options)
    else:
        written = _of_file(options)
    for path in written:
        print(path, file=stdout)


def _folder(options: argparse.Namespace) -> Path:
    """Of the run."""
    given: Path = options.results
    if given.suffix.lower() == ".blend":
        raise UserError(f"{given} is no run: give the run's RESULTS.json, or this file by --from")
    folder = given.parent if given.name == "results.json" else given
    if not folder.is_dir():
        raise UserError(f"{given} is no run: give the run's folder, or the results.json in it")
    return folder


def _asked(options: argparse.Namespace) -> LightsAsked:
    return LightsAsked(options.frame, options.all, options.objects, options.light, options.units)


def _of_run(options: argparse.Namespace) -> list[Path]:
    folder = _folder(options)
    lights = lights_asked(read_results(folder), folder, _asked(options))
    return write_lights(
        lights, options.to, options.out or folder / "exports" / options.to, options.units, options.reading
    )


def _of_file(options: argparse.Namespace) -> list[Path]:
    if options.light is not None:
        raise UserError("--light does not apply to a file: leave it out, or name the run's RESULTS.json")
    from xihe_blender.apply.applied_lights import lights_of_scene
    from xihe_blender.scene.blend_file import open_blend

    lights = lights_of_scene(open_blend(options.lit), _asked(options))
    out = options.out or options.lit.parent / "exports" / options.to
    return write_lights(lights, options.to, out, options.units, options.reading)


def _viewer(options: argparse.Namespace) -> Path:
    given = {name: getattr(options, name) for name in ("frame", "reading", "light")}
    chosen = [name for name, value in given.items() if value is not None] + ["all"] * options.all
    if options.results is None:
        raise UserError(f"{VIEWER} shows a run: give its RESULTS.json")
    if chosen or options.units != "picture":
        raise UserError(f"{VIEWER} shows all of the run: leave out --{(*chosen, 'units')[0]}")
    from xihe_blender.viewer.save import save_viewer

    folder = _folder(options)
    return save_viewer(read_results(folder), folder, options.objects, blend=options.lit, out=options.out)
