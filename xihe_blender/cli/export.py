"""`xihe export`: the light of a run as an engine takes it, without Blender; or a page that shows the run, with it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, get_args

from xihe_blender.cli.arguments import adder, names, one_of
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_lights import UNITS, LightsAsked, export_lights
from xihe_blender.io.run_results import RunResults, read_results
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
        print(_viewer(results, folder, options), file=stdout)
        return
    asked = LightsAsked(options.frame, options.all, options.objects, options.light, options.units)
    for path in export_lights(results, folder, options.to, asked, reading=options.reading, out=options.out):
        print(path, file=stdout)


def _viewer(results: RunResults, folder: Path, options: argparse.Namespace) -> Path:
    """Write the page; its path."""
    if options.frame is not None or options.reading is not None:
        raise UserError(f"{VIEWER} shows the whole run: leave out --frame and --reading")
    from xihe_blender.report.viewer import viewed_frames, viewer_page, write_viewer
    from xihe_blender.scene.blend_file import open_blend
    from xihe_blender.scene.gltf import viewed_objects

    outputs = RunOutputs(folder, Path(results.scene.file).stem)
    seen = viewed_frames(results, outputs)
    blend = outputs.lit_blend if options.blend is None else options.blend
    if not blend.is_file():
        raise UserError(f"there is no {blend}: name the .blend with the virtual objects by --blend")
    scene = open_blend(blend)
    wanted = list(results.lights) if options.objects is None else list(options.objects)
    there = {item.name: item for item in scene.objects}
    lacking = [name for name in wanted if name not in there]
    if lacking or not wanted:
        named = f"no virtual object {lacking[0]!r}" if lacking else "no virtual objects"
        raise UserError(f"{blend} has {named}: name another .blend by --blend")
    objects = viewed_objects(scene, [there[name] for name in wanted], list(seen))
    path = (folder if options.out is None else options.out) / f"{VIEWER}.html"
    try:
        write_viewer(path, viewer_page(results, outputs, seen, objects))
    except OSError as error:
        raise UserError(f"cannot write {path} ({error.strerror}): choose another folder for --out") from error
    return path
