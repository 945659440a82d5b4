"""The viewer of a run, written: its virtual objects as glTF, by Blender's own exporter, and how they move."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import RunResults
from xihe_blender.report.document import write_document
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.colour_management import in_rec709, is_rec709
from xihe_blender.scene.estimation_positions import all_box_corners_m
from xihe_blender.scene.shader_nodes import new_material
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import virtual_objects
from xihe_blender.viewer.page import TURNED, ViewedObject, viewed_frames, viewer_page
from xihenet.formats import as_spelled, format_names
from xihenet.light.platforms import Y_UP
from xihenet.records import ArrayF64

EXPORTER = "io_scene_gltf2"
MOST_TRIANGLES = 200_000
"""Of all objects: some 10 MB in a page."""


def save_viewer(
    results: RunResults, folder: Path, objects: Sequence[str] | None = None, *, blend: Path | None = None,
    out: Path | None = None,
) -> Path:  # fmt: skip
    """Write viewer.html of the run in `folder`, whole or not at all; its path.

    Opens `blend`, by default the lit file of the run, in place of what is open. `objects` None shows all that have a
    light. UserError, naming the fix, for what the run or the file does not have, and where nothing can be written.
    """
    outputs = RunOutputs(folder, Path(results.scene.file).stem)
    seen = viewed_frames(results, outputs)
    blend = outputs.lit_blend if blend is None else blend
    if not blend.is_file():
        raise UserError(f"there is no {blend}: name the .blend with the virtual objects by --from")
    scene = open_blend(blend)
    # One that is linked may have the name of one in the file: the light is that of the virtual one.
    there = {item.name: item for item in (*scene.objects, *virtual_objects(scene))}
    wanted = list(results.lights) if objects is None else as_spelled(objects, there)
    lacking = [name for name in wanted if name not in there]
    if unlit := [name for name in wanted if name in there and name not in results.lights]:
        raise UserError(f"the run has no virtual object {unlit[0]!r}; it has {format_names(results.lights)}")
    if lacking or not wanted:
        named = f"no virtual object {lacking[0]!r}" if lacking else "no virtual objects"
        raise UserError(f"{blend} has {named}: name another .blend by --from")
    viewed = viewed_objects(scene, [there[name] for name in wanted], list(seen))
    path = (folder if out is None else out) / "viewer.html"
    try:
        write_document(path, viewer_page(results, outputs, seen, viewed))
    except OSError as error:
        raise UserError(f"cannot write {path} ({error.strerror}): choose another folder for --out") from error
    return path


def viewed_objects(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], frames: Sequence[int]
) -> list[ViewedObject]:
    """The `objects` of `scene`, shaped as they are at the first of `frames`, and where they are at each of them.

    Changes the frame, the selection and what is hidden, for Blender's exporter: for a file that is not saved
    afterwards. (In a copy of the scene, which would leave them alone, the exporter crashes Blender 4.5.) UserError for
    shapes with too many triangles, and where Blender has no exporter of glTF.
    """
    import addon_utils  # Beside bpy, once that is there.

    if addon_utils.enable(EXPORTER) is None:
        raise UserError("this Blender has no exporter of glTF: use one that has the add-on io_scene_gltf2")
    scene.frame_set(frames[0])
    for item in objects:
        _unhide(scene, item)
    depsgraph, metres = scene.view_layers[0].depsgraph, metres_per_unit(scene)
    y_up = np.diag([metres, metres, metres, 1.0]) @ TURNED  # From Blender's axes and units, to metres.
    counts = {item.name: _n_triangles(item, depsgraph) for item in objects}
    if sum(counts.values()) > MOST_TRIANGLES:
        largest = max(counts, key=lambda name: counts[name])
        raise UserError(
            f"the virtual objects have {sum(counts.values())} triangles, {largest!r} the most, and the viewer takes "
            f"{MOST_TRIANGLES}: add a Decimate modifier to it, and name the file by --from"
        )
    shapes = {item.name: _exported(scene, item) for item in objects}
    boxes_m = {item.name: box for item, box in all_box_corners_m(objects, depsgraph).items()}
    from_start = {item.name: _inverse(_place(item, scene)) for item in objects}
    moves: dict[str, list[ArrayF64]] = {item.name: [] for item in objects}
    for frame in frames:
        scene.frame_set(frame)
        for item in objects:
            moves[item.name].append(y_up @ _place(item, scene) @ from_start[item.name] @ TURNED.T)
    viewed = []
    for name, corners_m in boxes_m.items():
        middle_m = (corners_m.min(axis=0) + corners_m.max(axis=0)) / 2
        radius = float(np.linalg.norm(corners_m.max(axis=0) - middle_m))
        viewed.append(ViewedObject(name, shapes[name], moves[name], Y_UP @ middle_m / metres, radius))
    return viewed


def _unhide(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Let the viewport show `item`, whatever hides it: a run lights it all the same."""
    layer = scene.view_layers[0]
    item.hide_viewport = False
    if scene.collection not in item.users_collection:  # Its collections may be hidden, or left out of the view layer.
        scene.collection.objects.link(item)
    layer.update()
    item.hide_set(False, view_layer=layer)
    layer.update()


def _place(item: bpy.types.Object, scene: bpy.types.Scene) -> ArrayF64:
    return np.array(item.evaluated_get(scene.view_layers[0].depsgraph).matrix_world, np.float64)


def _inverse(place: ArrayF64) -> ArrayF64:
    """Of a (4, 4) whose axes may have length 0. All of it at once would lose what is small far from the origin."""
    inverse = np.eye(4)
    inverse[:3, :3] = np.linalg.pinv(place[:3, :3])
    inverse[:3, 3] = -inverse[:3, :3] @ place[:3, 3]
    return inverse


def _n_triangles(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> int:
    evaluated = item.evaluated_get(depsgraph)
    has_faces = evaluated.type in ("MESH", "CURVE", "SURFACE", "META", "FONT")
    mesh = evaluated.to_mesh() if has_faces else None
    if mesh is None:  # As of a curve without a spline.
        return 0
    mesh.calc_loop_triangles()
    n = len(mesh.loop_triangles)
    evaluated.to_mesh_clear()
    return n


def _as_cycles_shows_it(item: bpy.types.Object) -> None:
    """Give an object without a material the matt grey that Cycles has for it: in glTF it would be a metal."""
    if not hasattr(item.data, "materials") or any(slot.material is not None for slot in item.material_slots):
        return
    grey = new_material("Grey")
    tree = grey.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
    shader.inputs["Base Color"].default_value = (0.8, 0.8, 0.8, 1)
    shader.inputs["Roughness"].default_value, shader.inputs["Specular IOR Level"].default_value = 1.0, 0.0
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    if item.material_slots:
        item.material_slots[0].material = grey
    else:
        item.data.materials.append(grey)


def _exported(scene: bpy.types.Scene, item: bpy.types.Object) -> bytes:
    _as_cycles_shows_it(item)
    for other in scene.view_layers[0].objects:
        other.select_set(other == item)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "object.glb"
        bpy.ops.export_scene.gltf(
            filepath=str(path), export_format="GLB", use_selection=True, export_yup=True, export_apply=True,
            export_animations=False, export_cameras=False, export_lights=False,
        )  # fmt: skip
        glb = path.read_bytes()
    return _as_three_takes_it(glb)


SHARES = ("metallicFactor", "roughnessFactor", "transmissionFactor", "specularFactor", "clearcoatFactor")
COLOUR_FACTORS = ("baseColorFactor", "emissiveFactor", "specularColorFactor", "sheenColorFactor", "attenuationColor")
COMPONENTS: dict[int, Any] = {5121: np.uint8, 5123: np.uint16, 5126: np.float32}


def _as_three_takes_it(glb: bytes) -> bytes:
    """A GLB of Blender's exporter with shares from 0 to 1, which Cycles keeps within too, and colours in Rec.709."""
    length = int.from_bytes(glb[12:16], "little")
    document, binary = json.loads(glb[20 : 20 + length]), bytearray(glb[28 + length :])
    for material in document.get("materials", ()):
        for part in _parts(material):
            part |= {name: min(max(part[name], 0), 1) for name in SHARES if name in part}
            if "baseColorFactor" in part:
                alpha = part["baseColorFactor"][3]
                part["baseColorFactor"][3] = min(max(alpha, 0), 1)
                if alpha > 1 and "baseColorTexture" not in part:
                    material.pop("alphaMode", None)  # three.js writes no depth for what is not opaque.
    if not is_rec709():
        _to_rec709(document, binary)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = glb[20 + length : 28 + length] + binary  # Nothing, of an object without a face.
    size, text_size = (number.to_bytes(4, "little") for number in (20 + len(text) + len(rest), len(text)))
    return glb[:8] + size + text_size + glb[16:20] + text + rest


def _parts(material: dict[str, Any]) -> list[dict[str, Any]]:
    return [material, material.get("pbrMetallicRoughness", {}), *material.get("extensions", {}).values()]


def _to_rec709(document: dict[str, Any], binary: bytearray) -> None:
    """Colours of materials and vertices, which are in the file's working space."""
    for material in document.get("materials", ()):
        for part in _parts(material):
            for factor in COLOUR_FACTORS:
                if factor in part:
                    part[factor][:3] = _clipped(np.array(part[factor][:3])).tolist()
    attributes = [part["attributes"] for mesh in document.get("meshes", ()) for part in mesh["primitives"]]
    for index in {index for one in attributes for name, index in one.items() if name.startswith("COLOR_")}:
        accessor = document["accessors"][index]
        start = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0) + accessor.get("byteOffset", 0)
        kind, width = COMPONENTS[accessor["componentType"]], int(accessor["type"][-1])
        stored = np.frombuffer(binary, kind, accessor["count"] * width, start).reshape(-1, width)
        most = 1.0 if kind is np.float32 else float(np.iinfo(kind).max)
        colours = _clipped(stored[:, :3] / np.float64(most)) * most
        stored[:, :3] = colours if kind is np.float32 else np.rint(colours)


def _clipped(rgb: ArrayF64) -> ArrayF64:
    """Colours (..., 3) of the working space, in Rec.709 as far as that holds them."""
    clipped: ArrayF64 = np.clip(in_rec709(rgb), 0, 1)
    return clipped
