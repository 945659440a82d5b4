"""Single renders of small scenes, and pictures read as arrays."""

import bpy
import numpy as np
from tiny_scenes import orthographic

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


def rendered_sphere(scene, samples, side=48):
    """(P, 3) radiance, and normals, of a sphere of radius 1 at the origin, seen from -Y but for its grazing rim."""
    world_from_camera = orthographic(scene, 2.2)
    x = ((np.arange(side) + 0.5) / side - 0.5) * 2.2
    right, up = np.meshgrid(x, -x)
    inside = right**2 + up**2 < 0.85
    in_camera = np.stack([right, up, np.sqrt(np.clip(1 - right**2 - up**2, 0, 1))], axis=-1)[inside]
    return rendered(scene, (side, side), samples)[inside], in_camera @ world_from_camera.T


def rendered_picture(scene, folder, colour_mode="RGB"):
    """(H, W, channels) of the PNG that Blender renders of the current frame, by the scene's own settings."""
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", colour_mode
    scene.render.filepath = str(folder / "rendered.png")
    bpy.ops.render.render(write_still=True, scene=scene.name)
    return pixels_of_file(folder / "rendered.png")


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
