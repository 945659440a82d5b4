"""A run as the panel starts it: in a folder of its own, and shown in the open file at its end.

One job for the panel's two drivers, modal in a window and blocking in background. A run that does not reach its end
leaves no folder.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy

from xihe_blender.addon.results_in_blender import show_results
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import read_results
from xihe_blender.jobs import Job
from xihe_blender.previs.previs import previs
from xihe_blender.previs.settings import PrevisSettings

COMMAND = "Run in Blender's panel"


def run_and_show(scene: bpy.types.Scene, folder: Path, settings: PrevisSettings, *, wipe: float = 0.5) -> Job[None]:
    """`previs` into `folder`, then its results in the open file.

    Parameters
    ----------
    folder : new and empty; removed if the run is stopped or fails
    wipe : of the comparison image, see `wiped`
    """
    try:
        yield from previs(scene, folder, settings, command=COMMAND)
    finally:
        if not RunOutputs(folder, "").results.exists():
            shutil.rmtree(folder, ignore_errors=True)
    results = read_results(folder)
    show_results(scene, results, folder, wipe=wipe)
