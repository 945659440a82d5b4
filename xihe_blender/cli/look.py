"""`xihe look`: where the phone should look for a second, so that the light at an object is known better."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.cli import arguments
from xihe_blender.cli.progress import progress_line
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihenet.formats import format_percent

VERIFY = "render the advised look, random ones and a light probe at each object, and say the true errors"
MAP = "one look for all places where an object could stand; needs no virtual object"
CAMERA = "save a copy of the scene whose camera does the look advised for the first object"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = arguments.adder(parser)
    arguments.add_scene(add, "folder of the advice; captures in it are resumed, and used again for other objects")
    add("--objects A,B", arguments.OBJECTS, arguments.names)
    add("--map", MAP, action="store_true", dest="is_for_map")
    add("--verify", VERIFY, action="store_true", dest="is_verified")
    add("--random N", "random looks for each object to compare with, with --verify", int, dest="n_random", default=1)
    add("--hold SECONDS", "how long the phone looks there; default: 1", float, dest="hold_s", default=1.0)
    add("--turn DEGREES", "largest turn away from the path; default: 90", float, dest="largest_turn_deg", default=90.0)
    add("--camera FILE.blend", CAMERA, Path)
    arguments.add_capture(add)
    add("--target", arguments.TARGET, choices=("ldr", "hdr"), default="hdr")
    add("--samples N", arguments.SAMPLES, int)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.previs.better_camera import check_camera_file, save_better_path
    from xihe_blender.previs.better_path import LookWishes, better_path
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.blend_file import open_blend
    from xihenet.camera_path.looks import LookSettings

    if options.is_for_map and options.objects:
        raise UserError("give either --objects, or --map for all places where an object could stand")
    settings = arguments.settings_from(options, PrevisSettings, objects=None)
    try:
        looks = arguments.settings_from(options, LookSettings)
    except ValueError as error:
        raise UserError("give --hold a positive number of seconds, and --turn up to 180 degrees") from error
    wishes = arguments.settings_from(options, LookWishes, looks=looks)
    if options.camera is not None:
        check_camera_file(options.camera, options.scene)
    scene = open_blend(options.scene)
    job = better_path(scene, options.out, settings, wishes, blend_file=options.scene, command=options.command_line)
    results = run_blocking(job, progress_line(stderr))
    for one in results.objects:
        print(f"{one.name}: {one.sentence}", file=stdout)
        true = one.true_errors
        if true is not None:
            line = f"  true error {true.before:.3f}, with the look {true.after:.3f} ({_change(true.lowered)})"
            if true.lowered_by_random is not None:
                line += f"; a random look: {_change(true.lowered_by_random)}"
            print(line, file=stdout)
    look = next((one.look for one in results.objects if one.look is not None), None)
    if options.camera is not None:
        if look is None:
            print(f"no camera in {options.camera}: there is no look that it could do", file=stdout)
        else:
            save_better_path(scene, look, options.camera)
            print(options.camera, file=stdout)
    print(options.out / "report.html", file=stdout)


def _change(lowered: float) -> str:
    """Such as "12 % lower", of the share that was taken off an error."""
    return f"{format_percent(abs(lowered))} {'lower' if lowered >= 0 else 'higher'}"
