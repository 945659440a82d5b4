"""`xihe record`: the camera path of a scene as a phone would have stored it, and the true light beside it."""

from __future__ import annotations

import argparse
from typing import Any

from xihe_blender.cli import arguments
from xihe_blender.cli.progress import progress_line
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihenet.captures.writing import WRITERS

LAYOUT = "our own OpenEXR files (xihe, the default), or as another app or data set stores a recording"
TRUTH = "render the true light as well: coefficients, a panorama and the three spheres, beside the recording"
PLACES = "position of the true light in metres; may be repeated; default: at the virtual objects"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = arguments.adder(parser)
    arguments.add_scene(add, "folder of the recording; a stopped one in it is resumed")
    arguments.add_capture(add, has_estimator=False)
    add("--samples N", arguments.SAMPLES, int)
    add("--metering NAME", "highlights, as phones do, or key; default: the phone's own")
    add("--effect NAME=on|off|auto", arguments.EFFECT, dest="overrides", action="append", default=[])
    add("--as LAYOUT", LAYOUT, choices=("xihe", *WRITERS), default="xihe", dest="layout")
    add("--truth", TRUTH, action="store_true", dest="has_truth")
    add("--at X,Y,Z", PLACES, arguments.position, action="append", dest="at_m", default=[])


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.light_transport.overrides import parsed_overrides
    from xihe_blender.previs.record import RecordWishes, record_session
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.blend_file import open_blend

    if options.at_m and not options.has_truth:
        raise UserError("--at says where the true light is measured: give --truth as well")
    settings = arguments.settings_from(options, PrevisSettings, effect_choices=parsed_overrides(options.overrides))
    scene = open_blend(options.scene)
    wishes = RecordWishes(options.layout, options.has_truth, tuple(options.at_m))
    job = record_session(scene, options.out, settings, wishes, blend_file=options.scene, command=options.command_line)
    for line in run_blocking(job, progress_line(stderr)):
        print(line, file=stdout)
    print(f"{options.out / 'work'} is for resuming and can be deleted", file=stdout)
