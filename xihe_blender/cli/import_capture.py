"""`xihe import`: a recording of a phone as a new .blend."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any

from xihe_blender.cli import arguments
from xihe_blender.cli.progress import progress_line
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihenet.captures.reading import READERS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = arguments.adder(parser)
    add("recording PATH", f"folder of a recording, or its .r3d file: {arguments.one_of(READERS)}", Path)
    add("--out SCENE.blend", "file to be made; a folder of the pictures is made beside it", Path, required=True)
    arguments.add_recording(add)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    import bpy

    from xihe_blender.footage.import_capture import import_capture, recording_at
    from xihe_blender.scene.colour_management import show_as_it_is
    from xihe_blender.scene.phone_capture import ChosenCapture
    from xihenet.io.whole_files import written_whole

    out: Path = options.out
    if out.suffix.lower() != ".blend":
        raise UserError(f"--out {out}: give the name of a .blend file")
    if out.exists():
        raise UserError(f"{out} is there already: choose another --out, or open it and use File > Import")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    # Cycles alone knows shadow catchers, and pictures are to look as they were taken.
    scene.render.engine = "CYCLES"
    show_as_it_is(scene)
    chosen = ChosenCapture(recording_at(options.recording), options.up, options.scale, options.floor)
    job = import_capture(scene, chosen, blend_folder=out.parent, keeps_frames=True)
    imported = run_blocking(job, progress_line(stderr))
    try:
        with written_whole(out) as beside:
            bpy.ops.wm.save_as_mainfile(filepath=str(beside.resolve()), compress=True)
    except BaseException:
        shutil.rmtree(imported.pictures, ignore_errors=True)
        raise
    print(" ".join(imported.said), file=stdout)
    print(out, file=stdout)
