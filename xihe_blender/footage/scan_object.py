"""The scan of a recording as an object of the file: coloured as it was seen, and a catcher of shadows."""

from __future__ import annotations

import bpy
import numpy as np

from xihe_blender.scene.colour_management import in_working_space
from xihe_blender.scene.mesh_arrays import fill_mesh
from xihe_blender.scene.phone_capture import SCAN
from xihe_blender.scene.shader_nodes import new_material
from xihenet.captures.capture import Capture
from xihenet.captures.scan import ScanMesh

COLOURS = "Seen Colour"
SOLID_COLOUR = (0.8, 0.8, 0.8, 0.2)
"""Of a solid view, with its opacity: the pictures behind the camera show through the scan."""

MOVED_M, TURNED_RAD = 0.08, np.radians(6)
"""Frames that differ from the last one that was taken in by less add nothing to the scan that it does not have."""


def frames_to_scan(capture: Capture) -> set[int]:
    """Places in the recording of the frames that are scanned: those after the camera has moved or turned."""
    chosen: set[int] = set()
    last = None
    for index, frame in enumerate(capture.frames):
        pose = frame.camera.world_from_camera
        if last is not None:
            turned_rad = np.arccos(np.clip((np.trace(last[:3, :3].T @ pose[:3, :3]) - 1) / 2, -1, 1))
            if turned_rad < TURNED_RAD and np.linalg.norm(pose[:3, 3] - last[:3, 3]) < MOVED_M:
                continue
        chosen.add(index)
        last = pose
    return chosen


def add_scan(name: str, scan: ScanMesh, unit_m: float) -> bpy.types.Object:
    """An object, in no collection yet, of `scan`; `unit_m` are metres in a Blender unit."""
    mesh = bpy.data.meshes.new(name)
    fill_mesh(mesh, scan.points_m / np.float32(unit_m), scan.quads.ravel(), 4 * np.arange(len(scan.quads)))
    colours = mesh.color_attributes.new(COLOURS, "BYTE_COLOR", "POINT")
    opaque = np.column_stack([in_working_space(scan.colours.clip(0, 1)), np.ones(len(scan.colours), np.float32)])
    colours.data.foreach_set("color", opaque.astype(np.float32).ravel())  # Linear; Blender encodes it
    mesh.materials.append(_showing_colours(name))
    item = bpy.data.objects.new(name, mesh)
    item[SCAN] = name
    item.is_shadow_catcher = True
    return item


def _showing_colours(name: str) -> bpy.types.Material:
    """A dull material in the colours of the mesh's points, and see-through where a solid view shows no colours."""
    material = new_material(name)
    material.diffuse_color = SOLID_COLOUR
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    colour = tree.nodes.new("ShaderNodeVertexColor")
    colour.layer_name, colour.location = COLOURS, (-250, 250)
    tree.links.new(colour.outputs["Color"], shader.inputs["Base Color"])
    return material
