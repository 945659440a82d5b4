"""Methods compared: how close does an estimated light come to the real one, in the picture?

Ground truth is the room and the virtual objects path-traced together. A method's picture is each virtual object under
its own estimated light, over the captured frame: a view layer per method and object with a world override and, where
the run asks for it, a sun as key light; the other objects as holdouts, film transparent. The room is not in that scene
at all, and only the part of the picture with objects is rendered, so these layers cost little. What stands in front of
an object in the room hides it, by the captured plane depth, as an AR toolkit does it.

Both sides share bounces, clamps and denoising, and samples but for `REFLECTION_SAMPLES`. Pictures are linear and carry
the session's exposure; the metrics are weighted by how much of a pixel the objects cover. With a key light the objects
cast their shadow on what the phone has seen of the room around them, see `compare.shadows`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import bpy
import numpy as np

from xihe_blender.apply.datablocks import LIT_SCENE, PREFIX, remove_lit_collections
from xihe_blender.apply.key_suns import apply_key_to_sun, make_key_sun, remove_key_sun, show_in_reflections
from xihe_blender.apply.lit_scene import is_fog, set_up_lit_scene, show_only_in
from xihe_blender.apply.reflection_pictures import forget_reflections, has_sun_for_lamp, reflect_in_world
from xihe_blender.apply.sh_worlds import apply_sh_to_world, make_sh_world, remove_unused_node_group
from xihe_blender.apply.shadow_catchers import (
    CATCHER_INDEX,
    catch_shadows,
    catch_shadows_of,
    catcher_name,
    corners_of,
    make_shadow_catcher,
    remove_shadow_catchers,
)
from xihe_blender.capture.render import (
    Rendered,
    RenderSettings,
    in_whole_picture,
    render_only_part,
    render_passes,
    stacked_rgb,
    working_scene,
)
from xihe_blender.capture.scanner import first_layer, working_room
from xihe_blender.compare.shadows import (
    BRIGHTEST,
    SHADOW_CHANNELS,
    around_object,
    ring_around,
    ring_rmse,
    shadow_of_all,
    surfaces_in_view,
    surfaces_seen,
    surroundings,
    touches_view,
)
from xihe_blender.io.run_results import ERROR_AT_FULL_SCALE, Metrics
from xihe_blender.scene.estimation_positions import box_corners_m
from xihe_blender.scene.units import metres_per_unit
from xihenet.camera import MISS_PLANE_DEPTH_M, PicturePart, part_around, unproject_frame, valid_plane_depth
from xihenet.camera_path.surfaces import Surface
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.io.npz_files import read_npz
from xihenet.io.whole_files import written_whole
from xihenet.light.key_light import rest_of
from xihenet.light.reflections import light_of_rough, reflection_panorama
from xihenet.metrics import angular_error, angular_error_deg, image_rmse, psnr, si_rmse, ssim
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ObjectLight, RgbdFrame

GROUND_TRUTH_SCENE = "Xihe Ground Truth"
OCCLUSION_TOLERANCE = 2e-3
"""An object this much (relative, and in metres) behind the room's surface still counts as in front of it."""

RECORDED_TOLERANCE = 0.01
"""The same behind what a range sensor measured, which is off by a centimetre or two."""

CATCHER_TOLERANCE = 0.05
"""The same of a shadow catcher that is seen through an object."""

OBJECT_INDEX = ("IndexOB", "Object Index")
"""Name of the pass, before Blender 5 and since."""

MARGIN_PX = 8
"""By so much the part of the picture that is rendered is wider than the objects in it, at least."""

DENOISER_PX = 16
"""OpenImageDenoise looks at a picture in blocks of this size: begun elsewhere it would give objects other colours, by
0.3 % of their light in place of 0.1 %."""

NEAREST_M = 0.05
"""From a position: nearer than this its light is not more of the mixture."""

REFLECTION_SAMPLES = 32
"""Of a pixel of an object that reflects a picture, at least: rays meet the lamps in it by luck, and with 8
their noise was up to a third of a metal sphere's error. Objects alone render so fast that 32 hardly take longer."""

_ERROR_STOPS = np.array([[0, 0, 4], [87, 16, 110], [188, 55, 84], [249, 142, 9], [252, 255, 164]]) / 255.0


@dataclass(frozen=True, eq=False)
class Comparison:
    """Pictures of one frame, (H, W, 3) linear at the session's exposure: path-traced, and by method.

    `weights` (H, W) are the share of each pixel that virtual objects cover, 0 to 1, and `ring` (H, W) which pixels are
    around them; Cycles took `render_s` for all. `surfaces` are those that may catch shadows, by object.
    """

    ground_truth: ArrayF64
    methods: Mapping[str, ArrayF64]
    weights: ArrayF64
    ring: ArrayBool
    render_s: float
    surfaces: Mapping[str, Sequence[Surface]]


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """`radiance` (H, W, 3) of the scene, and the seconds that rendering it took."""

    radiance: ArrayF32
    render_s: float


def save_ground_truth(path: Path, truth: GroundTruth) -> None:
    """Write it, whole or not at all."""
    with written_whole(path) as beside, beside.open("wb") as file:
        np.savez(file, radiance=truth.radiance, render_s=truth.render_s)


def load_ground_truth(path: Path) -> GroundTruth:
    """What `save_ground_truth` wrote. FileNotFoundError, or ValueError or KeyError if it is damaged."""
    content = read_npz(path)
    return GroundTruth(content["radiance"], float(content["render_s"]))


@dataclass(frozen=True, eq=False)
class OverRecording:
    """What is different where objects are put over a phone's recording in place of renders.

    `exposure` is that of light, since each frame has its own; shadows fall on `scan`, the corners (N, 3, 3) of its
    faces in Blender units, or on the flat surfaces that frames show where it is None.
    """

    exposure: float
    scan: ArrayF32 | None


@dataclass
class Comparer:
    """Renders comparisons; made by `open_comparer`. Worlds and view layers are found by (method, object)."""

    ground_truth: bpy.types.Scene
    lit: bpy.types.Scene
    worlds: Mapping[tuple[str, str], bpy.types.World]
    layers: Mapping[tuple[str, str], str]
    suns: Mapping[tuple[str, str], bpy.types.Object]
    """Of the key lights; empty where all of a light is spherical harmonics."""
    catchers: Mapping[str, bpy.types.Object]
    """Of the shadows, by object; empty where there are no suns."""
    objects: Mapping[str, bpy.types.Object]
    """That are compared. By its name alone one of a linked library might be another of the file."""
    recording: OverRecording | None = None

    def surfaces_around_objects(self, seen: Sequence[RgbdFrame], frame: int) -> dict[str, list[Surface]]:
        """By object, what captures show of the room around the place where it is at `frame`; none without catchers."""
        self.lit.frame_set(frame)
        depsgraph = self.lit.view_layers[0].depsgraph
        return {name: surfaces_seen(seen, box_corners_m(self.objects[name], depsgraph)) for name in self.catchers}

    def render_comparison(self, captured: RgbdFrame, lights: Mapping[str, Mapping[str, ObjectLight]]) -> Comparison:
        """Ground truth and every method at the frame of `captured`; see `render_methods`."""
        return self.render_methods(captured, lights, self.render_ground_truth(captured.frame))

    def render_ground_truth(self, frame: int) -> GroundTruth:
        """Room and objects, path-traced together."""
        self.ground_truth.frame_set(frame)
        rendered = render_passes(self.ground_truth)
        return GroundTruth(first_layer(rendered)[0], rendered.render_s)

    def render_methods(
        self,
        captured: RgbdFrame,
        lights: Mapping[str, Mapping[str, ObjectLight]],
        truth: GroundTruth,
        surfaces: Mapping[str, Sequence[Surface]] = MappingProxyType({}),
    ) -> Comparison:
        """Every method at the frame of `captured`, beside `truth`, which is of the same frame.

        The plane depth of `captured` hides what lies behind. `lights` carry its exposure, by method and
        virtual object. `surfaces` are those that catch shadows, by object.
        """
        methods, weights, render_s = self.render_over(captured, lights, surfaces)
        exposed = truth.radiance.astype(np.float64) * captured.exposure
        return Comparison(exposed, methods, weights, ring_around(weights), truth.render_s + render_s, surfaces)

    def render_over(
        self,
        captured: RgbdFrame,
        lights: Mapping[str, Mapping[str, ObjectLight]],
        surfaces: Mapping[str, Sequence[Surface]],
    ) -> tuple[dict[str, ArrayF64], ArrayF64, float]:
        """Every method over `captured`, as `render_methods` takes them: pictures (H, W, 3) linear at its exposure, the
        share (H, W) of each pixel that objects cover, and the seconds that Cycles took."""
        in_view = surfaces_in_view(captured, surfaces)
        if self.has_scan:
            in_view = self._catch_on_scan(captured)
        lit = self.render_layers(captured, lights, surfaces)
        background, weights = srgb_to_linear(captured.srgb_u8 / 255.0), np.zeros(captured.plane_depth_m.shape)
        methods, tolerance = {}, OCCLUSION_TOLERANCE if self.recording is None else RECORDED_TOLERANCE
        for method in lights:
            layers = {key[1]: lit.layers[self.layers[key]] for key in self.worlds if key[0] == method}
            shaded = background * shadow_of_all(layers, in_view)
            fogs = [layers.pop(name) for name in list(layers) if is_fog(self.objects[name])]
            picture, weights = composite(shaded, list(layers.values()), captured, tolerance)
            for fog in fogs:  # It does not hold out what is behind it.
                picture, covered = composite(picture, [fog], captured, tolerance)
                weights = covered + (1 - covered) * weights
            methods[method] = picture
        return methods, weights, lit.render_s

    def _catch_on_scan(self, captured: RgbdFrame) -> dict[str, ArrayBool]:
        """Let shadows fall on the scan around each object; by object, which pixels (H, W) show what is around it."""
        assert self.recording is not None and self.recording.scan is not None
        self.lit.frame_set(captured.frame)
        depsgraph, unit_m = self.lit.view_layers[0].depsgraph, metres_per_unit(self.lit)
        in_view = {}
        for name, catcher in self.catchers.items():
            middle_m, reach_m = surroundings(box_corners_m(self.objects[name], depsgraph))
            catch_shadows_of(catcher, self.recording.scan, (middle_m / unit_m, reach_m / unit_m))
            in_view[name] = around_object(captured, middle_m, reach_m)
        return in_view

    def shows_an_object(self, captured: RgbdFrame) -> bool:
        """Whether a frame may show any of the objects, or what is around one."""
        self.lit.frame_set(captured.frame)
        depsgraph = self.lit.view_layers[0].depsgraph
        boxes = [box_corners_m(self.objects[name], depsgraph) for _, name in self.worlds]
        return any(touches_view(*surroundings(box), captured.intrinsics, captured.world_from_camera) for box in boxes)

    @property
    def has_scan(self) -> bool:
        return self.recording is not None and self.recording.scan is not None

    def render_layers(
        self,
        captured: RgbdFrame,
        lights: Mapping[str, Mapping[str, ObjectLight]],
        surfaces: Mapping[str, Sequence[Surface]] = MappingProxyType({}),
    ) -> Rendered:
        """Each object under each method's light, a view layer each (`layers`), at the frame of `captured`.

        An object that has several positions is rendered under the light of each, and every point of it is lit as the
        positions around it are; see `blended`.
        """
        for name, catcher in self.catchers.items() if not self.has_scan else ():
            catch_shadows(catcher, surfaces.get(name, ()), metres_per_unit(self.lit))
        exposure = captured.exposure if self.recording is None else self.recording.exposure
        self.lit.frame_set(captured.frame)
        chosen = {key: lights[key[0]][key[1]] for key in self.worlds}
        turns = max(len(light.at) for light in chosen.values()) or 1
        rendered: list[Rendered] = []
        for turn in range(turns):
            for key, light in chosen.items():
                layer = self.lit.view_layers[self.layers[key]]
                layer.use = turn < max(1, len(light.at))
                if layer.use:
                    self._light(key, light.at[turn][1] if light.at else light, exposure)
            rendered.append(self._render_objects(captured))
        for layer in self.lit.view_layers:
            layer.use = True
        layers = dict(rendered[0].layers)
        for key, light in chosen.items():
            if light.at:
                name = self.layers[key]
                of_each = [one.layers[name] for one in rendered[: len(light.at)]]
                layers[name] = blended(of_each, [place_m for place_m, _ in light.at], captured)
        return Rendered(layers, sum(one.render_s for one in rendered))

    def _render_objects(self, captured: RgbdFrame) -> Rendered:
        """The lit scene where its objects, and what catches their shadows, are in view; around them there is nothing.

        All of it where something reaches beyond that part: hair, or what the camera blurs.
        """
        size = (captured.intrinsics.width, captured.intrinsics.height)
        depsgraph, unit_m = self.lit.view_layers[0].depsgraph, metres_per_unit(self.lit)
        corners_m = [box_corners_m(self.objects[name], depsgraph) for name in {name for _, name in self.worlds}]
        corners_m += [corners_of(catcher) * unit_m for catcher in self.catchers.values()]
        part = part_around(np.concatenate(corners_m), captured.intrinsics, captured.world_from_camera, MARGIN_PX)
        part = PicturePart(0, 0, *size) if part is None else _in_blocks(part, size)
        render_only_part(self.lit, part)
        rendered = in_whole_picture(render_passes(self.lit), part, size)
        if not _reaches_beyond(rendered, part):
            return rendered
        render_only_part(self.lit, None)
        whole = render_passes(self.lit)
        return Rendered(whole.layers, rendered.render_s + whole.render_s)

    def _light(self, key: tuple[str, str], light: ObjectLight, exposure: float) -> None:
        """Set world, sun and samples of a method's object for `light`, which carries `exposure`."""
        world, layer = self.worlds[key], self.lit.view_layers[self.layers[key]]
        layer.samples = 0 if light.reflections is None else max(REFLECTION_SAMPLES, int(self.lit.cycles.samples))
        has_sun = light.reflections is None or (key in self.suns and has_sun_for_lamp(self.objects[key[1]]))
        if light.reflections is None:
            forget_reflections(world)
        else:
            light = light_of_rough(light) if has_sun else light
            assert light.reflections is not None
            reflect_in_world(world, reflection_panorama(light.reflections), exposure)
        if key in self.suns:
            apply_sh_to_world(world, rest_of(light), exposure)
            apply_key_to_sun(self.suns[key], light.key, exposure)
            show_in_reflections(self.suns[key], has_sun)
        else:
            apply_sh_to_world(world, light.sh, exposure)


@contextlib.contextmanager
def open_comparer(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], methods: Sequence[str], settings: RenderSettings,
    *, has_key_light: bool = False, recording: OverRecording | None = None,
) -> Iterator[Comparer]:  # fmt: skip
    """Everything needed to compare `methods` on the virtual `objects` of `scene`; all of it is gone afterwards.

    With `has_key_light` the key light of each light is a sun, else a part of its spherical harmonics. `recording` says
    what is different over one.
    """
    keys = [(method, item.name) for method in methods for item in objects]
    # View layer names are cut at 63 bytes, so objects go by number.
    layers = {key: f"{key[0]} {number}" for number, key in enumerate(keys)}
    worlds: dict[tuple[str, str], bpy.types.World] = {}
    suns: dict[tuple[str, str], bpy.types.Object] = {}
    catchers: dict[str, bpy.types.Object] = {}
    with contextlib.ExitStack() as stack:
        stack.callback(remove_unused_node_group)
        for key, layer in layers.items():
            worlds[key] = make_sh_world(f"{PREFIX}{layer}")
            stack.callback(bpy.data.worlds.remove, worlds[key])
            stack.callback(forget_reflections, worlds[key])
            if has_key_light:
                suns[key] = make_key_sun(f"{PREFIX}{layer} Key Light")
                stack.callback(remove_key_sun, suns[key])
        truth = stack.enter_context(working_room(scene, GROUND_TRUTH_SCENE, settings))
        # The same objects as in the methods' pictures: no others, no lamp beside them, and however their collection is
        # hidden.
        for item in objects:
            truth.collection.objects.link(item)
        stack.callback(remove_lit_collections)
        lit = stack.enter_context(working_scene(scene, LIT_SCENE, settings))
        set_up_lit_scene(lit, objects, {layer: (key[1], worlds[key]) for key, layer in layers.items()})
        for key, sun in suns.items():
            show_only_in(lit, sun, [layers[key]])
        for item in objects if has_key_light else ():
            catchers[item.name] = make_shadow_catcher(catcher_name(item.name))
            stack.callback(remove_shadow_catchers, [catchers[item.name]])
            show_only_in(lit, catchers[item.name], [layers[key] for key in keys if key[1] == item.name])
        for layer in lit.view_layers:
            layer.cycles.use_pass_shadow_catcher = layer.use_pass_object_index = has_key_light
        # Kept between renders, the order of the suns and so their noise would depend on what was rendered before: a run
        # that is resumed would end otherwise than one that was not stopped.
        lit.render.use_persistent_data = not has_key_light
        if recording is not None:  # Pixels of a phone need not be square.
            for name in ("pixel_aspect_x", "pixel_aspect_y"):
                setattr(lit.render, name, getattr(scene.render, name))
        yield Comparer(truth, lit, worlds, layers, suns, catchers, {item.name: item for item in objects}, recording)


def blended(
    layers: Sequence[Mapping[str, ArrayF32]], places_m: Sequence[ArrayF64], captured: RgbdFrame
) -> dict[str, ArrayF32]:
    """One view layer of those of an object under the light of each of its positions, `places_m` (3,) world, metres.

    A point of the object has most of the light of the position that is nearest: weights fall with the fourth power of
    the distance (Shepard, 1968). Where a layer has no plane depth, all have the same weight.
    """
    depth_m = layers[0]["Depth.Z"]
    points_m = unproject_frame(replace(captured, plane_depth_m=depth_m)).points_m.reshape(*depth_m.shape, 3)
    squared = np.stack([((points_m - place_m) ** 2).sum(axis=-1) for place_m in places_m])
    weights = 1.0 / (squared + NEAREST_M**2) ** 2
    is_known = np.isfinite(weights).all(axis=0) & valid_plane_depth(depth_m)
    weights = np.where(is_known, weights, 1.0)
    weights /= weights.sum(axis=0)
    mixed = {name: layers[0][name] for name in layers[0] if name.startswith(("Depth.Z", "Combined.A", *OBJECT_INDEX))}
    for name in layers[0].keys() - mixed.keys():
        each = np.stack([layer[name] for layer in layers])
        if name in SHADOW_CHANNELS:  # A ratio to hardly any light would outweigh all others.
            each = np.clip(np.nan_to_num(each, nan=1.0), 0.0, BRIGHTEST)
        mixed[name] = np.einsum("kij,kij->ij", weights, each).astype(np.float32)
    return mixed


def _in_blocks(part: PicturePart, size: tuple[int, int]) -> PicturePart:
    """`part` of a picture (width, height) of `size`, extended to whole blocks of the denoiser; one if it is empty."""
    (left, top, right, bottom), (width, height) = part, size
    if left == right or top == bottom:
        left, top, right, bottom = 0, height - 1, 1, height
    # Cycles counts rows from below.
    low, high = (height - bottom) // DENOISER_PX, -(-(height - top) // DENOISER_PX)
    left, right = left // DENOISER_PX * DENOISER_PX, min(-(-right // DENOISER_PX) * DENOISER_PX, width)
    return PicturePart(left, max(height - high * DENOISER_PX, 0), right, height - low * DENOISER_PX)


def _reaches_beyond(rendered: Rendered, part: PicturePart) -> bool:
    """Whether something covers an edge of the `part` of the picture that was rendered, and there is more beside it."""
    left, top, right, bottom = part
    for passes in rendered.layers.values():
        alpha = passes["Combined.A"]
        within, (height, width) = alpha[top:bottom, left:right], alpha.shape
        beside = [(left > 0, within[:, :1]), (right < width, within[:, -1:]), (top > 0, within[:1])]
        beside.append((bottom < height, within[-1:]))
        if any(has_more and (edge > 0).any() for has_more, edge in beside):
            return True
    return False


def composite(
    background: ArrayF64, layers: Sequence[Mapping[str, ArrayF32]], captured: RgbdFrame,
    tolerance: float = OCCLUSION_TOLERANCE,
) -> tuple[ArrayF64, ArrayF64]:  # fmt: skip
    """Objects over the captured frame: (H, W, 3) linear, exposed, and (H, W) the share of each pixel that they cover.

    `background` is (H, W, 3) linear, exposed; `layers` are passes of each object's view layer, scene radiance with
    premultiplied alpha; `captured` gives exposure, white balance and plane depth; `tolerance` is that of
    `in_front_of_room`.
    """
    exposed = captured.exposure * (1.0 if captured.white_balance is None else captured.white_balance)
    shown, weights = np.zeros_like(background), np.zeros(background.shape[:2])
    for passes in layers:
        visible = in_front_of_room(_depth_within_room(passes), captured.plane_depth_m, tolerance)
        colour = stacked_rgb(passes).astype(np.float64)
        shown += np.where(visible[..., None], colour * exposed, 0.0)
        weights += np.where(visible, passes["Combined.A"], 0.0)
    # Of see-through objects one before another Cycles counts the holdouts in part: together they cover more than all.
    weights = np.clip(weights, 0.0, 1.0)
    return shown + (1 - weights[..., None]) * background, weights


def _depth_within_room(passes: Mapping[str, ArrayF32]) -> ArrayF32:
    """(H, W) the plane depth of a view layer, that of its shadow catcher brought nearer by CATCHER_TOLERANCE.

    Fog and thin glass have no other depth than what is behind them, and a catcher lies where the room's own surface
    does, but not to the millimetre.
    """
    depth_m = passes["Depth.Z"]
    of_objects = next((pixels for name, pixels in passes.items() if name.startswith(OBJECT_INDEX)), None)
    if of_objects is None:
        return depth_m
    nearer_m = depth_m / (1 + CATCHER_TOLERANCE) - CATCHER_TOLERANCE
    return np.where(of_objects == CATCHER_INDEX, nearer_m, depth_m).astype(np.float32)


def in_front_of_room(object_plane_depth_m: ArrayF32, room_plane_depth_m: ArrayF32, tolerance: float) -> ArrayBool:
    """(H, W): where an object is nearer than the room, or either is unknown (beside no part of it, through a window).

    At a soft edge Cycles gives no plane depth of the object: there it is that of the nearest neighbour.
    """
    around = np.pad(object_plane_depth_m, 1, constant_values=np.inf)
    nearest_m = np.lib.stride_tricks.sliding_window_view(around, (3, 3)).min(axis=(2, 3))
    object_m = np.where(object_plane_depth_m >= MISS_PLANE_DEPTH_M, nearest_m, object_plane_depth_m)
    is_known = valid_plane_depth(room_plane_depth_m)
    reach = np.where(is_known, room_plane_depth_m, 0) * (1 + tolerance) + tolerance
    return ~is_known | (object_m >= MISS_PLANE_DEPTH_M) | (object_m <= reach)


def measure(prediction: ArrayF64, ground_truth: ArrayF64, weights: ArrayF64, ring: ArrayBool) -> Metrics:
    """The metrics of results.json for one picture, inside the objects' alpha, and one in the ring around them.

    None where one is undefined.
    """
    shown, true = display(prediction), display(ground_truth)
    return Metrics(
        psnr=psnr(shown, true, weights),
        ssim=ssim(shown, true, weights),
        rmse=image_rmse(prediction, ground_truth, weights),
        si_rmse=si_rmse(prediction, ground_truth, weights),
        angular_deg=angular_error_deg(prediction, ground_truth, weights),
        ring_rmse=ring_rmse(prediction, ground_truth, ring),
    )


def hueless_pixels(prediction: ArrayF64, ground_truth: ArrayF64, weights: ArrayF64) -> int:
    """Pixels inside the objects that `angular_deg` leaves out: black on either side."""
    angle = angular_error(prediction, ground_truth, weights)
    return angle.n_black_prediction + angle.n_black_truth


def display(picture: ArrayF64) -> ArrayF64:
    """Linear, exposed light as the Standard view transform shows it: clipped to [0, 1] and sRGB-encoded."""
    return linear_to_srgb(np.clip(picture, 0.0, 1.0))


def error_map(prediction: ArrayF64, ground_truth: ArrayF64, weights: ArrayF64) -> ArrayF64:
    """(H, W, 3) in [0, 1]: the mean absolute difference of the displayed colours inside the objects, black outside."""
    difference = np.abs(display(prediction) - display(ground_truth)).mean(axis=-1) * (weights > 0)
    place = np.clip(difference / ERROR_AT_FULL_SCALE, 0.0, 1.0) * (len(_ERROR_STOPS) - 1)
    return np.stack([np.interp(place, range(len(_ERROR_STOPS)), _ERROR_STOPS[:, c]) for c in range(3)], axis=-1)
