"""What does each way of metering clip? A table over scenes.

    python addon_tests/bench/exposure.py blend_scenes/*.blend

For each scene: the exposure by `key` and by `highlights`, and the share of pixels of the phone's pictures that have a
channel at 255, in the first, middle and last frame of the camera path. Captures are 256x192 with 8 samples, denoised.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from xihe_blender.blend_file import open_blend
from xihe_blender.capture import first_layer, meter_exposure, metered_frames, open_scanner, sized_for
from xihe_blender.plan import planned_frames
from xihe_blender.render import RenderSettings, render_passes
from xihenet.camera import encode_exposed
from xihenet.metering import METERINGS
from xihenet.records import ArrayF32


def clipped_share(radiance: ArrayF32, exposure: float) -> float:
    """Of the pixels of a picture (H, W, 3), those with a channel at white."""
    return float((encode_exposed(radiance, exposure) == 255).any(axis=-1).mean())


def row(file: Path) -> str:
    scene = open_blend(file)
    frames = planned_frames(scene, None)
    exposures = {metering: meter_exposure(scene, frames, metering=metering) for metering in METERINGS}
    pictures = []
    with open_scanner(scene, sized_for(scene, RenderSettings((256, 192), 8))) as scanner:
        for frame in metered_frames(frames):
            scanner.move_to(frame)
            pictures.append(first_layer(render_passes(scanner.scene))[0])
    cells = [file.stem]
    for metering in reversed(METERINGS):
        exposure = exposures[metering]
        shares = " ".join(f"{100 * clipped_share(picture, exposure):.1f}" for picture in pictures)
        cells += [f"{exposure:.3g}", shares]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    files = [Path(name) for name in sys.argv[1:]]
    if not files:
        sys.exit("give .blend files")
    print("| scene | key | % clipped | highlights | % clipped |\n| --- | --- | --- | --- | --- |")
    for file in files:
        print(row(file), flush=True)


if __name__ == "__main__":
    np.seterr(all="raise", under="ignore")  # What underflows is black in any picture.
    main()
