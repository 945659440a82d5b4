"""A render with Cycles that comes back as arrays, without touching the user's scene.

Chosen: a working scene, a copy that shares the objects and owns its settings, its frame and its view layers. The user's
settings are never changed, so there are none to restore after an error, a cancel or a crash. What rendering writes into
the shared objects, their animated values, `scene.state` puts back. Rejected: changing settings in place.

Pixels come back through a 32-bit EXR file in memory, since Blender cannot hand out a render result in background mode.
The file is saved after the render: a render that writes its own says so on the terminal, every time.
Light transport (bounces, caustics) is what the settings say, or what the user's scene has where they say nothing: the
same in capture, truth and comparison, or the comparison would measure the renderer. Clamps stay as the scene has them.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.capture.cycles_device import CYCLES_IS_OFF, use_chosen_device
from xihe_blender.errors import UserError
from xihe_blender.scene.colour_management import in_rec709
from xihe_blender.scene.state import WORKING, copied_scene, remove_copied_scene, users_name
from xihe_blender.scene.units import metres_per_unit
from xihenet.camera import MISS_PLANE_DEPTH_M, PicturePart
from xihenet.io.exr import read_exr
from xihenet.records import ArrayF32

MEMORY_FOLDER = Path("/dev/shm")
MAX_SEED = 2**31 - 1
"""Of Cycles."""

SWITCHED_OFF = ("film_transparent", "use_border", "use_compositing", "use_freestyle", "use_motion_blur",
                "use_multiview", "use_sequencer", "use_single_layer", "use_stamp")  # fmt: skip
"""Of a scene's render settings."""


@dataclass(frozen=True)
class RenderSettings:
    """What a working scene renders.

    Parameters
    ----------
    size : width and height in pixels
    samples : per pixel, fixed: adaptive sampling is off, so that equal settings give equal noise
    seed : of Cycles, the same in every frame
    denoise : with OpenImageDenoise, where the build has it
    light_transport : (setting, value) as `cycles_settings` gives them; settings that are not named stay the scene's own
    """

    size: tuple[int, int]
    samples: int
    seed: int = 0
    denoise: bool = True
    light_transport: tuple[tuple[str, bool | int], ...] = ()


@dataclass(frozen=True, eq=False)
class Rendered:
    """Channels (H, W) by "<pass>.<channel>" for each view layer, and the seconds Blender's render operator took.

    "Depth.Z" is in metres.
    """

    layers: dict[str, dict[str, ArrayF32]]
    render_s: float

    @property
    def passes(self) -> dict[str, ArrayF32]:
        """Of the first view layer."""
        return next(iter(self.layers.values()))


def stacked_rgb(passes: Mapping[str, ArrayF32], name: str = "Combined") -> ArrayF32:
    """A pass as a picture (H, W, 3)."""
    return np.stack([passes[f"{name}.{c}"] for c in "RGB"], axis=-1)


@contextlib.contextmanager
def working_scene(scene: bpy.types.Scene, name: str, settings: RenderSettings) -> Iterator[bpy.types.Scene]:
    """A copy of `scene` with one view layer, set up to render by `settings`; gone afterwards, whatever happens."""
    copy = copied_scene(scene)
    try:
        copy.name = name
        copy[WORKING] = scene.get(WORKING, scene.name)
        for layer in list(copy.view_layers)[1:]:
            copy.view_layers.remove(layer)
        set_up_cycles(copy, settings)
        yield copy
    finally:
        # Frees what Cycles kept between renders: Blender 5.2 keeps it beyond the scene's end, and crashes on it later.
        copy.render.use_persistent_data = False
        remove_copied_scene(copy)


def set_up_cycles(scene: bpy.types.Scene, settings: RenderSettings) -> None:
    """Make `scene` render plain radiance: no border, compositor, sequencer, line art, film exposure, adaptive sampling.

    Its view layers render, as the viewport shows them, though the user may have left one out of their own renders.

    UserError where the user has turned Cycles off.
    """
    if not hasattr(scene, "cycles"):
        raise UserError(CYCLES_IS_OFF)
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    use_chosen_device(scene)
    render.resolution_x, render.resolution_y = settings.size
    render.resolution_percentage = 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    for switch in SWITCHED_OFF:
        setattr(render, switch, False)
    # 0.4 s -> 0.04 s per small render; new pixels in an existing world image would be missed, so none are ever made.
    render.use_persistent_data = True
    cycles.samples, cycles.use_layer_samples = settings.samples, "USE"
    cycles.seed, cycles.use_animated_seed = settings.seed, False
    cycles.use_adaptive_sampling, cycles.time_limit = False, 0.0
    cycles.film_exposure = 1.0
    cycles.use_fast_gi = False
    # What the phone does not see lights the room all the same, and a light probe is in another place.
    cycles.use_camera_cull = cycles.use_distance_cull = False
    cycles.use_denoising = settings.denoise and can_denoise(scene)
    if cycles.use_denoising:
        # The accurate prefilter runs the denoiser three times over: 0.5 s more per small picture, no visible gain.
        cycles.denoising_prefilter = "FAST"
    for layer in scene.view_layers:
        layer.use, layer.samples = True, 0
        layer.material_override = None
        layer.use_pass_combined = layer.use_pass_z = True
    apply_effects(scene, settings.light_transport)
    # Without compression, the fastest to write, and lossless.
    choose_format(render.image_settings, "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER")
    render.image_settings.color_depth, render.image_settings.exr_codec = "32", "NONE"


def apply_effects(scene: bpy.types.Scene, light_transport: Iterable[tuple[str, bool | int]]) -> None:
    """Set a plan of effects: (name, value) of Cycles' settings; motion blur is the only one of Blender's."""
    for name, value in light_transport:
        setattr(scene.render if name == "use_motion_blur" else scene.cycles, name, value)


def can_denoise(scene: bpy.types.Scene) -> bool:
    """Whether this build of Blender has OpenImageDenoise; chooses it for `scene` if so."""
    try:
        scene.cycles.denoiser = "OPENIMAGEDENOISE"
    except TypeError:
        return False
    return True


def choose_format(image_settings: bpy.types.ImageFormatSettings, media_type: str, file_format: str) -> None:
    """Set the format of output; Blender 5 asks for its kind first."""
    if hasattr(image_settings, "media_type"):
        image_settings.media_type = media_type
    image_settings.file_format = file_format


def render_only_part(scene: bpy.types.Scene, part: PicturePart | None) -> None:
    """Let `scene` render only a part of its picture; all of it with None.

    Pictures are then as large as the part. A pixel has the noise that it has in the whole picture.
    """
    render = scene.render
    render.use_border = render.use_crop_to_border = part is not None
    if part is not None:
        left, top, right, bottom = part
        width, height = render.resolution_x, render.resolution_y
        # Blender rounds down to whole pixels: a quarter of one more is safe from what 32 bits lose.
        render.border_min_x, render.border_max_x = (left + 0.25) / width, (right + 0.25) / width
        render.border_min_y, render.border_max_y = (height - bottom + 0.25) / height, (height - top + 0.25) / height


def in_whole_picture(rendered: Rendered, part: PicturePart, size: tuple[int, int]) -> Rendered:
    """What was rendered of a `part`, in pictures (height, width) of `size`; around it there is nothing at any depth."""
    left, top, right, bottom = part
    layers: dict[str, dict[str, ArrayF32]] = {}
    for layer, passes in rendered.layers.items():
        layers[layer] = {}
        for name, pixels in passes.items():
            around = MISS_PLANE_DEPTH_M if name == "Depth.Z" else 0.0
            layers[layer][name] = whole = np.full((size[1], size[0]), around, np.float32)
            whole[top:bottom, left:right] = pixels
    return Rendered(layers, rendered.render_s)


def render_scene(scene: bpy.types.Scene) -> None:
    """Have Blender render `scene` at its current frame. RuntimeError with Blender's own words.

    Without a window by name, and not as the scene of an overridden context: Blender looks into that while it renders,
    with Python 3.11 and older without Python's lock, and crashes where another thread runs Python meanwhile, of a
    script or an add-on. By name it sets `scene` to the frame of the context's scene, so that one goes to the frame of
    `scene` before, and is evaluated anew afterwards: to be used inside of `scene_kept`. A window would evaluate it
    later, when everything is put back.
    """
    if not bpy.app.background:
        with bpy.context.temp_override(scene=scene):
            bpy.ops.render.render()
        return
    in_context = bpy.context.scene
    before, camera = in_context.frame_current, in_context.camera
    try:
        if before != scene.frame_current:
            in_context.frame_current = scene.frame_current
        bpy.ops.render.render(scene=scene.name)
    finally:
        if before != in_context.frame_current:
            in_context.frame_current = before
            in_context.camera = camera  # Where markers bind cameras, another frame may have brought another one.


def render_passes(scene: bpy.types.Scene) -> Rendered:
    """Render `scene` at its current frame and return its passes.

    UserError if Blender says that it cannot; OSError if the temporary file cannot be written or read.
    """
    memory = MEMORY_FOLDER if os.access(MEMORY_FOLDER, os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="xihe_", dir=memory) as temporary:
        path = Path(temporary) / "passes.exr"
        # Also has Blender look at the scene anew: what is set of Cycles alone, as its seed, it would not notice.
        scene.render.filepath = str(path)
        start = time.perf_counter()
        try:
            render_scene(scene)
        except RuntimeError as error:
            raise UserError(f"Cycles could not render {users_name(scene)!r}: {str(error).strip()}") from error
        _save_render(scene, path)
        render_s = time.perf_counter() - start
        with contextlib.suppress(OSError):
            return Rendered(_whole_picture(scene, path), render_s)
    # In containers the memory folder often has no more than 64 MB.
    with tempfile.TemporaryDirectory(prefix="xihe_") as temporary:
        path = Path(temporary) / "passes.exr"
        _save_render(scene, path)
        return Rendered(_whole_picture(scene, path), render_s)


def _save_render(scene: bpy.types.Scene, path: Path) -> None:
    """Save what was rendered last. What went wrong is said where the file is read."""
    result = next(image for image in bpy.data.images if image.type == "RENDER_RESULT")
    with contextlib.suppress(RuntimeError):
        result.save_render(str(path), scene=scene)


def _whole_picture(scene: bpy.types.Scene, path: Path) -> dict[str, dict[str, ArrayF32]]:
    """The passes of every view layer that renders. OSError if Blender, which does not say so, could not write them."""
    layers: dict[str, dict[str, ArrayF32]] = {}
    # Not there, or cut short where the disk was full.
    with contextlib.suppress(FileNotFoundError, ValueError):
        for name, pixels in read_exr(path).items():
            # The name of a layer may have dots.
            layer, pass_name, channel = name.rsplit(".", 2)
            layers.setdefault(layer, {})[f"{pass_name}.{channel}"] = pixels
    if any("Depth.Z" not in layers.get(layer.name, ()) for layer in scene.view_layers if layer.use):
        raise OSError(f"Blender wrote no whole picture to {path}: free some space in the temporary folder")
    for passes in layers.values():
        for name in [key.removesuffix(".R") for key in passes if key.endswith(".R")]:
            rgb = in_rec709(stacked_rgb(passes, name))
            passes |= {f"{name}.{channel}": rgb[..., index] for index, channel in enumerate("RGB")}
    metres = metres_per_unit(scene)
    for passes in layers.values() if metres != 1 else ():
        plane_depth = passes["Depth.Z"]
        is_hit = plane_depth < MISS_PLANE_DEPTH_M
        passes["Depth.Z"] = np.where(is_hit, plane_depth * np.float32(metres), plane_depth)
    return layers


def exclude_collection(
    layer: bpy.types.LayerCollection, collection: bpy.types.Collection, *, is_excluded: bool = True
) -> None:
    """Leave `collection` out of the view layer that `layer` is the root of, wherever it is linked; or take it in."""
    for child in layer.children:
        if child.collection == collection:
            child.exclude = is_excluded
        else:
            exclude_collection(child, collection, is_excluded=is_excluded)
