"""`xihe dataset`: rooms to train estimators on, procedural or of one's own."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import (
    FRAMES,
    add_scene,
    adder,
    check_one_kind_of_workers,
    frame_range,
    names,
    settings_from,
)
from xihe_blender.cli.progress import progress_line, when_news
from xihe_blender.jobs import run_blocking
from xihenet.formats import format_count


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What can be typed: one of two actions, each with its own options."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    build = actions.add_parser("build", help="make and render procedural rooms; a stopped build is resumed")
    build.set_defaults(act=_build)
    add = adder(build)
    workers = "processes on this machine, one thread each; default: one per core"
    scheduler = "Dask scheduler whose workers make the rooms; default: processes on this machine"
    add("--rooms N", "number of rooms in total", int, required=True, dest="n_rooms")
    add("--out DIR", "folder of the rooms, one .npz file each", Path, required=True)
    add("--workers K", workers, int, dest="n_workers")
    add("--seed N", "the same seed makes the same rooms", int, default=0)
    add("--walk F", "render F frames of a walk through each room instead of five separate views", int)
    add("--views N", "render N separate views of each room instead of five: more of it is seen", int)
    varied = "share of the training rooms that are far more varied than homes and offices"
    add("--varied SHARE", varied, float, default=0.0)
    by_day = "share of the training rooms whose lamps are off, by day, where they have windows"
    add("--by-day SHARE", by_day, float, default=0.0)
    add("--split NAME", "make only the train, validation or test rooms; default: all")
    add("--scheduler ADDRESS", scheduler)
    scene = actions.add_parser("scene", help="store a scene with a camera path as one more room")
    scene.set_defaults(act=_scene)
    add = adder(scene)
    add_scene(add, "folder of scenes; a scene of the same name is replaced")
    add("--frames A:B[:S]", FRAMES, frame_range)
    add("--at A,B", "objects that mark the positions; default: the virtual objects", names)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    options.act(options, stdout, stderr)


def _build(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.lab.rooms.build import build_dataset
    from xihe_blender.lab.rooms.settings import BuildSettings

    check_one_kind_of_workers(options.n_workers, options.scheduler)
    settings = settings_from(options, BuildSettings)
    n_made = run_blocking(build_dataset(options.out, settings), when_news(progress_line(stderr)))
    n_rooms = format_count(len(settings.wanted()), "room")
    print(f"{n_rooms} in {options.out}, {n_made} made now", file=stdout)


def _scene(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.lab.rooms.scene import SCENE_SETTINGS, add_scene
    from xihe_blender.lab.rooms.store import load_room
    from xihe_blender.scene.blend_file import open_blend

    scene = open_blend(options.scene)
    job = add_scene(scene, options.scene.stem, options.out, SCENE_SETTINGS, frames=options.frames, at=options.at)
    path = run_blocking(job, progress_line(stderr))
    ldr, hdr = load_room(path).sh_noise.max(axis=0)
    print(f"The reference light has a noise of at most {ldr:.1%} in ldr and {hdr:.1%} in hdr.", file=stderr)
    print(path, file=stdout)
