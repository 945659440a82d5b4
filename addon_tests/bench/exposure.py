"""Exposure: what does each way of metering clip? A table over scenes.

    python addon_tests/bench/exposure.py blend_scenes/*.blend

For each scene, by `key` and by `highlights`: the exposure; the share of pixels of the phone's pictures that have a
channel at 255, in the first, middle and last frame of the camera path; and of the light around the virtual objects the
share of the sphere that has a channel above white, and the share of the energy that lies above white or comes from
lamps that cameras do not see. Captures are 256x192 with 8 samples, denoised; the light is that of the preset Draft in
the first frame.
"""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from given import given
from reference import positions_of

from xihe_blender.capture.reference_probe import open_reference_probe
from xihe_blender.capture.render import RenderSettings, render_passes
from xihe_blender.capture.scanner import first_layer, meter_exposure, metered_frames, open_scanner, sized_for
from xihe_blender.io.blender_output import only_our_output
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.plan import planned_frames
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.blend_file import open_blend
from xihenet.camera import encode_exposed
from xihenet.metrics import share_above_white
from xihenet.mirror_ball import project_mirror_ball
from xihenet.phone.metering import METERINGS
from xihenet.records import ArrayF32


def clipped_share(radiance: ArrayF32, exposure: float) -> float:
    """Of the pixels of a picture (H, W, 3), those with a channel at white."""
    return float((encode_exposed(radiance, exposure) == 255).any(axis=-1).mean())


def sphere_above_white(ball: ArrayF32) -> float:
    """Of the sphere around a position (N, N, 3), the share that has a channel above white."""
    above = np.repeat((ball >= 1).any(axis=-1)[..., None], 3, axis=-1)
    return float(project_mirror_ball(above)[0, 0] / np.sqrt(4 * np.pi))


def light_above_white(scene: bpy.types.Scene, exposure: float) -> tuple[float, float]:
    """Means over the virtual objects, or empties named `placement*`: shares of sphere and of energy."""
    places, shares = positions_of(scene), []
    with open_reference_probe(scene, places, PrevisSettings(preset="draft").reference) as probe:
        for index in range(len(places)):
            light = probe.light_at(index, scene.frame_start, exposure)
            energy = share_above_white(light.measured.ldr, light.measured.hdr)
            shares.append((sphere_above_white(light.ball * np.float32(exposure)), energy or 0.0))
    sphere, energy = np.mean(shares, axis=0)
    return float(sphere), float(energy)


def row(file: Path) -> str:
    scene = open_blend(file)
    frames = planned_frames(scene, None)
    pictures = []
    with open_scanner(scene, sized_for(scene, RenderSettings((256, 192), 8))) as scanner:
        for frame in metered_frames(frames):
            scanner.move_to(frame)
            pictures.append(first_layer(render_passes(scanner.scene))[0])
    cells = [file.stem]
    for metering in reversed(METERINGS):
        exposure = run_blocking(meter_exposure(scene, frames, metering=metering))
        clipped = " ".join(f"{100 * clipped_share(picture, exposure):.1f}" for picture in pictures)
        sphere, energy = light_above_white(scene, exposure)
        cells += [f"{exposure:.3g}", clipped, f"{100 * sphere:.1f}", f"{100 * energy:.0f}"]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    files = given(__doc__, "files+").files
    ways = [f"{name} | % clipped | % of sphere | % of energy" for name in reversed(METERINGS)]
    print("| scene | " + " | ".join(ways) + " |\n" + "| --- " * 9 + "|")
    for file in files:
        print(row(file), flush=True)


if __name__ == "__main__":
    np.seterr(all="raise", under="ignore")  # What underflows is black in any picture.
    with only_our_output():
        main()
