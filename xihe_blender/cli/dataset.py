"""`xihe dataset`: rooms to train estimators on, procedural or of one's own."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import frame_range, names
from xihe_blender.cli.progress import progress_line, when_news
from xihe_blender.jobs import run_blocking


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What can be typed: one of two actions, each with its own options."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    build = actions.add_parser("build", help="make and render procedural rooms; a stopped build is resumed")
    add = build.add_argument
    add("--rooms", type=int, required=True, metavar="N", help="number of rooms in total")
    add("--out", type=Path, required=True, metavar="DIR", help="folder of the rooms, one .npz file each")
    add("--workers", type=int, metavar="K", help="processes on this machine, one thread each; default: one per core")
    add("--seed", type=int, default=0, metavar="N", help="the same seed makes the same rooms")
    add(
        "--walk",
        type=int,
        metavar="F",
        help="render F frames of a walk through each room instead of five separate views",
    )
    add("--split", metavar="NAME", help="make only the train, validation or test rooms; default: all")
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler whose workers make the rooms; default: processes on this machine",
    )
    build.set_defaults(act=_build)
    scene = actions.add_parser("scene", help="store a scene with a camera path as one more room")
    add = scene.add_argument
    add("scene", type=Path, metavar="SCENE.blend", help="scene with an animated camera")
    add("--out", type=Path, required=True, metavar="DIR", help="folder of scenes; a scene of the same name is replaced")
    add("--frames", type=frame_range, metavar="A:B[:S]", help="frames of the path; default: the scene's range and step")
    add("--at", type=names, metavar="A,B", help="objects that mark the positions; default: the virtual objects")
    scene.set_defaults(act=_scene)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    """Do the action that was typed."""
    options.act(options, stdout, stderr)


def _build(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.lab.rooms.build import BuildSettings, build_dataset

    settings = BuildSettings(
        options.rooms, options.seed, options.workers,
        walk=options.walk, split=options.split, scheduler=options.scheduler,
    )  # fmt: skip
    n_made = run_blocking(build_dataset(options.out, settings), when_news(progress_line(stderr)))
    print(f"{len(settings.wanted())} rooms in {options.out}, {n_made} of them made now", file=stdout)


def _scene(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.lab.rooms.render_room import RoomRenderSettings
    from xihe_blender.lab.rooms.scene import add_scene
    from xihe_blender.scene.blend_file import open_blend

    scene = open_blend(options.scene)
    job = add_scene(scene, options.scene.stem, options.out, RoomRenderSettings(), frames=options.frames, at=options.at)
    print(run_blocking(job, progress_line(stderr)), file=stdout)
