"""Single renders of small scenes, and pictures read as arrays."""

import bpy
import numpy as np

from xihe_blender.capture.render import RenderSettings, render_passes, working_scene
from xihe_blender.capture.scanner import first_layer, open_scanner


def captured(scene, size=(64, 48), samples=1, seed=0, frame=1):
    """What the phone sees at a frame, at an exposure of 1, not denoised."""
    with open_scanner(scene, RenderSettings(size, samples, seed, denoise=False)) as scanner:
        scanner.move_to(frame)
        return scanner.acquire_environment_scan()


def rendered(scene, size, samples):
    """(H, W, 3) radiance of the whole scene, not denoised."""
    with working_scene(scene, "Test", RenderSettings(size, samples, denoise=False)) as working:
        return first_layer(render_passes(working))[0].astype(np.float64)


def pixels(image):
    """(H, W, channels) of an image of Blender's, row 0 at the top."""
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], -1)[::-1]


def pixels_of_file(path):
    image = bpy.data.images.load(str(path))
    try:
        return pixels(image)
    finally:
        bpy.data.images.remove(image)
