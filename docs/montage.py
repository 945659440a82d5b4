"""One picture of a finished run, made from its radiance files: the strip in docs/benchmarks.md.

    python docs/montage.py out docs/living_room.png --frames 1,13,24

A row per frame: ground truth, the run's estimator, ambient, truth. No labels: the caption beside the picture has them.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from xihe_blender.io.exr import read_radiance
from xihe_blender.io.outputs import RunOutputs
from xihenet.camera import encode_exposed
from xihenet.io.png import write_png

GAP_PX = 4


def row(outputs: RunOutputs, methods: list[str], frame: int, exposure: float) -> np.ndarray:
    """(H, W, 3) uint8: the pictures of one frame side by side on white."""
    pictures = [encode_exposed(read_radiance(outputs.radiance(method, frame)), exposure) for method in methods]
    gap = np.full((pictures[0].shape[0], GAP_PX, 3), 255, np.uint8)
    return np.concatenate([part for picture in pictures for part in (picture, gap)][:-1], axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="folder of a finished previs run")
    parser.add_argument("picture", type=Path)
    parser.add_argument("--frames", default="1", help="compared frames, separated by commas")
    options = parser.parse_args()
    results = json.loads((options.run / "results.json").read_text(encoding="utf-8"))
    settings = results["settings"]
    outputs = RunOutputs(options.run, Path(results["scene"]["file"]).stem)
    methods = list(dict.fromkeys(["ground_truth", settings["estimator"], "ambient", "truth"]))
    frames = [int(frame) for frame in options.frames.split(",")]
    rows = [row(outputs, methods, frame, settings["reference_exposure"]) for frame in frames]
    gap = np.full((GAP_PX, rows[0].shape[1], 3), 255, np.uint8)
    write_png(options.picture, np.concatenate([part for strip in rows for part in (strip, gap)][:-1]))


if __name__ == "__main__":
    main()
