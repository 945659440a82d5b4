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
    parser.add_argument(
        "results", metavar="RESULTS.json", type=Path, nargs="?", help="of a run that is done, or its folder"
    )
    lit = "in place of a run: a .blend whose virtual objects are lit; needs Blender, has no reflections"
    add("--from FILE.blend", lit, Path, dest="lit")
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
    if (options.results is None) == (options.lit is None):
        raise UserError("give either RESULTS.json or --from FILE.blend")
    if options.lit is not None:
        for path in _of_file(options):
            print(path, file=stdout)
        return
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


def _of_file(options: argparse.Namespace) -> list[Path]:
    """The lights of a .blend, written; their paths."""
    if options.to == VIEWER or options.light is not None:
        raise UserError(f"--from has no {VIEWER} and no --light: name the run's RESULTS.json")
    from xihe_blender.apply.applied_lights import applied_light, key_frames
    from xihe_blender.apply.sh_worlds import applied_worlds
    from xihe_blender.io.run_lights import write_lights
    from xihe_blender.scene.blend_file import open_blend
    from xihenet.light.exports import NamedLight, scaled

    scene = open_blend(options.lit)
    lit = list(applied_worlds(scene))
    chosen = lit if options.objects is None else list(options.objects)
    if unknown := [name for name in chosen if name not in lit]:
        raise UserError(f"{options.lit} has no lit virtual object {unknown[0]!r}; it has {', '.join(lit) or 'none'}")
    lights = []
    for name in chosen:
        last = max(key_frames(scene, name), default=scene.frame_current)
        frames = key_frames(scene, name) if options.all else [last if options.frame is None else options.frame]
        for frame in frames:
            found = applied_light(scene, name, frame)
            assert found is not None, "it is one of the lit ones"
            light, exposure = found
            time_s = (frame - scene.frame_start) * scene.render.fps_base / scene.render.fps
            gain = 1.0 if options.units == "picture" else 1.0 / exposure
            lights.append(NamedLight(name, frame, time_s, scaled(light, gain)))
    if not lights:
        raise UserError(
            f"{options.lit} has no lit virtual object: run xihe previs, and name the lit .blend that it leaves"
        )
    out = options.lit.parent / "exports" / options.to if options.out is None else options.out
    return write_lights(lights, options.to, out, options.units, options.reading)
