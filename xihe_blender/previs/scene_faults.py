"""Faults of a scene: what of it cannot be lit or believed as it stands, and what does a run say of it?

Cycles drops a sample that is not finite without a word: a lamp of NaN watts gives a black room, and so does an emission
whose light overflows single precision. Chosen: such numbers are refused by name before anything is rendered; what is
legal, but no phone could see or no float could hold, is a fault that results and report name. Rejected: looking for
black in the pictures, where a dropped sample is like any other darkness.

Values are read where they are constants. What textures or arithmetic make of them only Cycles knows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.apply.datablocks import PREFIX
from xihe_blender.apply.lit_scene import seen_in
from xihe_blender.capture.reference_probe import LEAST_BLUR
from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import absolute_pattern, matching
from xihe_blender.io.run_results import Fault
from xihe_blender.light_transport.animation import is_animated, is_film
from xihe_blender.previs.files_read import blend_folder, file_of, pattern_of
from xihe_blender.scene.blend_file import paths_of_modifiers, paths_of_nodes
from xihe_blender.scene.mesh_arrays import array_of
from xihe_blender.scene.phone_capture import remembered_capture
from xihe_blender.scene.shader_nodes import constant, has_nodes
from xihe_blender.scene.state import animated_paths
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import (
    GEOMETRY_TYPES,
    in_virtual_collection,
    models_of_many_parts,
    rendered_collections,
    virtual_objects,
)
from xihenet.records import ArrayF32, ArrayF64

BRIGHTEST = 1e30
"""Watts or strength from which Cycles' single precision overflows within a few bounces (measured: from 1e37 on)."""

COARSEST_M = 1e-3
"""Coordinates that are rounded to more than this put surfaces beside each other where they should touch."""

NEAREST_M, FARTHEST_M = 0.02, 100.0
"""Of a phone from a virtual object. Beyond it estimators know no rooms, and the unit scale is mostly wrong."""

COUNTED_AT_ONCE = 2**20
"""Pixels: an HDRI may have a hundred million."""

READ_FROM_FILES = (bpy.types.Image, bpy.types.Volume, bpy.types.CacheFile)
HAS_SHADER = (bpy.types.Light, bpy.types.Material, bpy.types.World)

NEGLIGIBLE_SHARE = 1e-4
"""Of an image's light: what colours outside Rec.709 take away as negative numbers, in HDRIs from real places."""

EMISSION_INPUTS = {
    "EMISSION": ("Color", "Strength"),
    "BACKGROUND": ("Color", "Strength"),
    "BSDF_PRINCIPLED": ("Emission Color", "Emission Strength"),
}
"""By type of node: the inputs that say how brightly it shines. Negative ones take light away."""


def faults_at_frame(depsgraph: bpy.types.Depsgraph, *, is_first: bool) -> list[Fault]:
    """Light that is negative, objects and vertices that are nowhere, at the frame of `depsgraph`.

    Data-blocks without animation are looked at only where `is_first`. UserError for the first lamp or shader with
    a number that is NaN or infinite, or that shines with BRIGHTEST.
    """
    seen = [block for block in depsgraph.ids if is_first or is_animated(block.original)]
    faults = []
    for where, name, value, shines in _constants(seen):
        if not abs(value) < (BRIGHTEST if shines else math.inf):
            raise UserError(
                f"{where} has {value:g} as its {name.lower()} at frame {depsgraph.scene.frame_current}, which Cycles "
                f"leaves out: give it a number{f' below {BRIGHTEST:g}' if shines else ''}"
            )
        if shines and value < 0:
            said = f"The light of {where} is negative: it darkens what Cycles renders, and no phone sees it."
            faults.append(Fault(name=where, n=1, said=said))
    for item in depsgraph.objects:
        if not np.isfinite(item.matrix_world).all():
            said = f"Object {item.name!r} has no finite location: Cycles leaves it out. "
            faults.append(Fault(name=item.name, n=1, said=said + "Check its scale and its constraints."))
    faults += _missing_files(seen)
    return faults + [fault for block in seen if isinstance(block, bpy.types.Mesh) for fault in _mesh_faults(block)]


NO_IES = "makes the light equally strong in all directions, at 100 times the Strength of its IES Texture"
FIND_IT = "Put the file back, or choose File > External Data > Find Missing Files."


def _missing_files(blocks: Iterable[bpy.types.ID]) -> Iterator[Fault]:
    """Files of `blocks` that are not there; Blender says so only on its console, or on the node.

    Of images, volumes, caches, lamps (IES), and what geometry nodes import.
    """
    for block in blocks:
        original, files = block.original, []
        if isinstance(block, READ_FROM_FILES) and not original.name.startswith(PREFIX):
            drawn = "renders pink in its place" if isinstance(block, bpy.types.Image) else "renders without it"
            files = [(file_of(original), original.filepath, drawn)]
        elif isinstance(block, bpy.types.Object | bpy.types.GeometryNodeTree):
            found = paths_of_modifiers(original) if isinstance(block, bpy.types.Object) else paths_of_nodes(original)
            paths = [one.path for one in found if one.is_whole]
            files = [(pattern_of(path, original.library), path, "renders without it") for path in paths]
        else:
            nodes = [node for node in _shader_nodes(original) if node.type == "TEX_IES" and node.mode == "EXTERNAL"]
            paths = [node.filepath for node in nodes if node.filepath]
            files = [(pattern_of(path, original.library), path, NO_IES) for path in paths]
        for pattern, path, does in files:
            if pattern is not None and not any(matching(absolute_pattern(pattern, blend_folder()))):
                said = f"The file of {block.name!r}, {path}, is not there: Cycles {does}. "
                yield Fault(name=block.name, n=1, said=said + FIND_IT)


def _shader_nodes(block: bpy.types.ID) -> Iterable[bpy.types.Node]:
    """Those of a lamp, material or world that uses nodes, or of a group of shader nodes; none of what has no shader.

    `depsgraph.ids` gives groups as blocks of their own, and an owner's tree beside it.
    """
    if isinstance(block, bpy.types.ShaderNodeTree):
        return () if block.is_embedded_data else block.nodes
    return block.node_tree.nodes if isinstance(block, HAS_SHADER) and has_nodes(block) else ()


def _constants(blocks: Iterable[bpy.types.ID]) -> Iterator[tuple[str, str, float, bool]]:
    """The constants of all lamps, and of all shaders of materials, worlds and node groups, among `blocks`.

    Of each: what it belongs to, its name, its value, and whether it says how brightly something shines.
    """
    for block in blocks:
        if isinstance(block, bpy.types.Light):
            where = f"lamp {block.name!r}"
            yield from ((where, name, value, shines) for name, value, shines in _lamp_constants(block))
        elif isinstance(block, bpy.types.ShaderNodeTree):
            where = f"node group {block.name!r}"
        else:
            where = f"{block.bl_rna.name.lower()} {block.name!r}"
        for socket in (socket for node in _shader_nodes(block) for socket in node.inputs):
            shines = socket.name in EMISSION_INPUTS.get(socket.node.type, ())
            yield from ((where, socket.name, number, shines) for number in _numbers(socket))


def _lamp_constants(lamp: bpy.types.Light) -> Iterator[tuple[str, float, bool]]:
    """As `_constants`, of the lamp itself. Only from Blender 4.5 on it has an exposure and a temperature."""
    exposure = getattr(lamp, "exposure", 0.0)
    yield "Exposure", exposure, False
    if getattr(lamp, "use_temperature", False):
        yield "Temperature", lamp.temperature, False
    yield from (("Strength", value, True) for value in (lamp.energy * 2.0**exposure, *lamp.color))


def _numbers(socket: bpy.types.NodeSocket) -> list[float]:
    """What a socket is set to; nothing where it is no constant."""
    value = constant(socket, ()) if socket.type in ("VALUE", "RGBA", "VECTOR") else None
    return [] if value is None else [float(number) for number in np.ravel(value)]


def _mesh_faults(mesh: bpy.types.Mesh) -> Iterator[Fault]:
    places = array_of(mesh.vertices, "co", np.float32, 3)
    n_broken = int(np.count_nonzero(~np.isfinite(places).all(axis=1)))
    if n_broken:
        said = f"{n_broken} vertices of mesh {mesh.name!r} are NaN or infinite: Cycles leaves their faces out."
        yield Fault(name=mesh.name, n=n_broken, said=said)


def unseen_faults(scene: bpy.types.Scene) -> Iterator[Fault]:
    """What lights its surroundings while the phone sees a hole in its place; lamps and many parts of a model among the
    virtual objects.

    Over a phone's recording holes are made by intention.
    """
    virtual = set(in_virtual_collection(scene))
    for model, n_parts, said in models_of_many_parts(virtual_objects(scene)):
        yield Fault(name=model, n=n_parts, said=f"{said}.")
    for lamp in sorted(item.name for item in virtual if item.type == "LIGHT"):
        said = f"Lamp {lamp!r} is among the virtual objects and shines on nothing: move it out of their collection."
        yield Fault(name=lamp, n=1, said=said)
    if remembered_capture(scene) is not None:
        return
    layer = scene.view_layers[0]
    layer.update()  # Blender 5.2 lists no objects before.
    rendered = {item for home in rendered_collections(scene) for item in home.objects if not item.hide_render}
    unseen = [
        item.name
        for item in layer.objects
        if item.type in GEOMETRY_TYPES and item not in virtual and item in rendered
        if item.is_holdout or item.is_shadow_catcher
        or item.holdout_get(view_layer=layer) or item.indirect_only_get(view_layer=layer)
    ]  # fmt: skip
    if unseen:
        said = (
            f"{_named(unseen)}: the phone does not see what is a holdout, a shadow catcher or indirect only, "
            "but light comes from there. Switch that off in Object Properties > Visibility, or in the outliner."
        )
        yield Fault(name=unseen[0], n=len(unseen), said=said)


def _named(names: list[str]) -> str:
    """ "'Vase' and 2 more"."""
    return repr(names[0]) + (f" and {len(names) - 1} more" if len(names) > 1 else "")


def layer_faults(scene: bpy.types.Scene) -> Iterator[Fault]:
    """What the user renders in other view layers alone: captures and ground truth are of the first one."""
    first, *others = scene.view_layers
    first.update()
    known = {*first.objects, *in_virtual_collection(scene)}
    for layer in [layer for layer in others if layer.use]:
        alone = [item.name for item in dict.fromkeys(seen_in(layer.layer_collection)) if item not in known]
        if alone:
            they_are = f"{_named(alone)} {'is' if len(alone) == 1 else 'are'}"
            said = (
                f"{they_are} in view layer {layer.name!r}, but a run renders the first one alone, "
                f"{first.name!r}. Tick the collection there in the Outliner."
            )
            yield Fault(name=alone[0], n=len(alone), said=said)


def blur_faults(scene: bpy.types.Scene) -> Iterator[Fault]:
    """A Filter Glossy that the reference light cannot follow (docs/reference_light.md#limits)."""
    blur = scene.cycles.blur_glossy
    if 0 < blur < LEAST_BLUR:
        said = (
            f"Filter Glossy is {blur:.2g}: beside mirrors and glass the reference light for all of the light (hdr) can "
            f"be wrong by a fifth or more. Set it to 0, or to {LEAST_BLUR} or more (Render > Light Paths > Caustics)."
        )
        yield Fault(name=scene.name, n=1, said=said)


def timing_faults(scene: bpy.types.Scene) -> Iterator[Fault]:
    """What may be elsewhere, or play at another frame, than in the user's own renders."""
    loose = [item.name for item in scene.objects if any(map(_is_worked_out, item.modifiers))]
    world = scene.rigidbody_world
    if world is not None and world.enabled and world.collection is not None and not world.point_cache.is_baked:
        bodies = [item for item in world.collection.objects if item.rigid_body is not None]
        loose += [item.name for item in bodies if item.rigid_body.type == "ACTIVE" and not item.rigid_body.kinematic]
    if loose:
        said = (
            f"The physics of {_named(loose)} is not baked: Blender works out each frame from the one before, and a "
            "run leaves frames out, so that it may be elsewhere than in your own renders. Bake it (Cache > Bake, or "
            "Simulation Nodes > Bake; a fluid first needs another Type than Replay)."
        )
        yield Fault(name=loose[0], n=len(loose), said=said)
    keyed = animated_paths(scene)
    for item in scene.objects if keyed else ():
        drivers = item.animation_data.drivers if item.animation_data is not None else ()
        targets = [target for curve in drivers for variable in curve.driver.variables for target in variable.targets]
        read = [target.data_path for target in targets if target.id == scene and target.data_path in keyed]
        if read:
            said = (
                f"Drivers of {item.name!r} read {read[0]}, which is keyed on the scene: it may be elsewhere than in "
                "your own renders, and stands still in Xihe Lit. Key that on an object, such as an empty."
            )
            yield Fault(name=item.name, n=1, said=said)
    if bpy.app.autoexec_fail:
        said = (
            f"Python in the file was not run ({bpy.app.autoexec_fail_message}), since nobody said that it is trusted: "
            "what it moves or lights stays as it was saved. Bake it to keys, or trust the file in Blender and use Run."
        )
        yield Fault(name=scene.name, n=1, said=said)
    if scene.render.frame_map_old != scene.render.frame_map_new:
        said = (
            "The scene stretches time: pictures and numbers are right, but Blender plays the keys of the estimated "
            "light, and of the phone in Xihe Lit, at other frames. Set Old and New to the same number in Output > "
            "Frame Range > Time Stretching."
        )
        yield Fault(name=scene.name, n=1, said=said)


def _is_worked_out(modifier: bpy.types.Modifier) -> bool:
    """Whether it is cloth, a soft body, hair that moves, dynamic paint or a simulation zone, and is not baked.

    A fluid of type Replay counts as not baked: Blender keeps only what was played of it.
    """
    caches: list[Any] = []
    if not modifier.show_render:
        return False
    if modifier.type == "NODES":
        # Of a library that is missing there is no node.
        zones = [bake for bake in modifier.bakes if bake.node and bake.node.type == "SIMULATION_OUTPUT"]
        return not all(_is_zone_baked(modifier, zone) for zone in zones)
    if modifier.type == "FLUID":
        return bool(modifier.fluid_type == "DOMAIN" and modifier.domain_settings.cache_type == "REPLAY")
    if modifier.type in ("CLOTH", "SOFT_BODY"):
        caches = [modifier.point_cache]
    elif modifier.type == "PARTICLE_SYSTEM" and modifier.particle_system.use_hair_dynamics:
        caches = [modifier.particle_system.point_cache]
    elif modifier.type == "DYNAMIC_PAINT" and modifier.canvas_settings is not None:
        surfaces = modifier.canvas_settings.canvas_surfaces
        caches = [surface.point_cache for surface in surfaces if surface.is_active and surface.is_cache_user]
    return not all(cache.is_baked for cache in caches)


def _is_zone_baked(modifier: bpy.types.NodesModifier, zone: bpy.types.NodesModifierBake) -> bool:
    """Whether the simulation zone has a bake, on disk or in the .blend.

    Python cannot ask for the latter, but packing from an empty folder succeeds only where a bake is packed already.
    """
    folder, own = (zone.directory, "") if zone.use_custom_path else (modifier.bake_directory, str(zone.bake_id))
    baked = Path(pattern_of(folder, modifier.id_data.library), own, "meta", "*")
    if folder and matching(absolute_pattern(str(baked), blend_folder())):
        return True
    if not hasattr(zone, "bake_target"):  # Blender 4.2 packs none.
        return False
    place = zone.use_custom_path, zone.directory
    zone.use_custom_path, zone.directory = True, f"{bpy.app.tempdir}nothing"
    which = {"session_uid": modifier.id_data.session_uid, "modifier_name": modifier.name, "bake_id": zone.bake_id}
    try:
        return bool(bpy.ops.object.geometry_node_bake_pack_single(**which) == {"FINISHED"})
    except RuntimeError:
        return False
    finally:
        zone.use_custom_path, zone.directory = place


def image_faults(world: bpy.types.World | None) -> Iterator[Fault]:
    """Environment textures of `world` with negative pixels, or ones that are NaN or infinite, black to Cycles."""
    nodes = world.node_tree.nodes if world is not None and has_nodes(world) else ()
    images = dict.fromkeys(node.image for node in nodes if node.type == "TEX_ENVIRONMENT")
    for image in images:
        if image is None or is_film(image):
            continue
        n_broken, n_negative = _broken_and_negative(image)
        for n, what in (
            (n_broken, "are NaN or infinite: Cycles takes them for black."),
            (n_negative, "are negative: they darken what Cycles renders."),
        ):
            if n:
                yield Fault(name=image.name, n=n, said=f"{n} pixels of image {image.name!r} {what}")


def _broken_and_negative(image: bpy.types.Image) -> tuple[int, int]:
    """How many pixels of an image have a channel that is not finite, and how many others one that takes light away."""
    if not (image.is_float and image.channels and len(image.pixels)):
        return 0, 0
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    # NaN passes through a minimum: one look tells whether there is anything to count.
    if values.min() >= 0 and values.max() < np.inf:
        return 0, 0
    pixels = values.reshape(-1, image.channels)[:, :3]
    parts = [_counted(pixels[start : start + COUNTED_AT_ONCE]) for start in range(0, len(pixels), COUNTED_AT_ONCE)]
    n_broken, n_negative, taken, given = (sum(of_each) for of_each in zip(*parts, strict=True))
    return int(n_broken), int(n_negative) if taken > NEGLIGIBLE_SHARE * given else 0


def _counted(pixels: ArrayF32) -> tuple[int, int, float, float]:
    """Of (P, 3): pixels that are not finite, others that are negative, the light these take away, all light given."""
    is_finite = np.isfinite(pixels).all(axis=1)
    known = pixels[is_finite].astype(np.float64)
    n_broken, n_negative = np.count_nonzero(~is_finite), np.count_nonzero((known < 0).any(axis=1))
    return int(n_broken), int(n_negative), float(-known.clip(max=0).sum()), float(known.clip(min=0).sum())


def place_faults(scene: bpy.types.Scene, positions_m: dict[str, ArrayF64], cameras_m: ArrayF64) -> Iterator[Fault]:
    """Estimation positions so far from the world's origin that float32 rounds them, or from every camera.

    Both are (F, 3), of each frame.
    """
    metres = metres_per_unit(scene)
    for name, position_m in positions_m.items():
        step_m = float(np.spacing(np.float32(np.abs(position_m / metres).max()))) * metres
        if step_m > COARSEST_M:
            said = f"{name!r} lies so far from the world's origin that Blender's coordinates have steps of "
            yield Fault(name=name, n=1, said=f"{said}{step_m:.2g} m.")
    if not positions_m:
        return
    offsets = cameras_m - np.stack(list(positions_m.values()))
    nearest_m = float(np.linalg.norm(offsets, axis=-1).min())
    if not NEAREST_M <= nearest_m <= FARTHEST_M:
        through = "does its path lead through the object, or " if nearest_m < NEAREST_M else ""
        said = (
            f"The phone's smallest distance from a virtual object is {nearest_m:.3g} m: "
            f"{through}is the unit scale (Scene > Units) right? One Blender unit is {metres:g} m."
        )
        yield Fault(name=scene.name, n=1, said=said)
