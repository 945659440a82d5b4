"""Shadow catchers: an object's shadow falls on the room, where the room is only a picture.

A catcher is a mesh of the flat surfaces that the phone has seen around a virtual object, in the view layer of that
object alone. Cycles shades it with and without the object and gives the ratio, by which the picture is multiplied. It
is seen by the camera and by nothing else: the light that comes from the table is in the object's estimate already.
EEVEE knows no shadow catchers; there a catcher is not seen.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import bpy
import numpy as np

from xihe_blender.apply.datablocks import PREFIX, SHADOW_CATCHER, shortened
from xihe_blender.scene.mesh_arrays import array_of, fill_mesh
from xihe_blender.scene.shader_nodes import new_material
from xihe_blender.scene.state import show_to_camera_alone
from xihenet.camera_path.surfaces import Surface
from xihenet.records import ArrayF32, ArrayF64

CATCHER_INDEX = 32767
"""Pass index of a catcher, by which pixels that show one are told from others: the largest that there is."""


def make_shadow_catcher(name: str) -> bpy.types.Object:
    """A catcher named `name` without any surface yet."""
    mesh = bpy.data.meshes.new(name)
    mesh.materials.append(_unseen_in_eevee(name))
    catcher = bpy.data.objects.new(name, mesh)
    catcher[SHADOW_CATCHER] = name
    catcher.hide_select = True
    catcher.is_shadow_catcher, catcher.pass_index = True, CATCHER_INDEX
    show_to_camera_alone(catcher)
    return catcher


def catcher_name(virtual_object: str) -> str:
    """Name of the catcher of a virtual object, in the 63 bytes that every Blender keeps of one."""
    return shortened(f"{PREFIX}Shadow {virtual_object}")


def catch_shadows(catcher: bpy.types.Object, surfaces: Sequence[Surface], unit_m: float, lifted_m: float = 0.0) -> None:
    """Let `catcher`, made by `make_shadow_catcher`, stand for `surfaces`, in place of others.

    `unit_m` are metres in a Blender unit; by `lifted_m` they are moved along their normals.
    """
    corners: list[tuple[float, ...]] = []
    faces = []
    for surface in surfaces:
        outline = (surface.outline_m + lifted_m * surface.normal) / unit_m
        faces.append(list(range(len(corners), len(corners) + len(outline))))
        corners += map(tuple, outline.tolist())
    mesh = catcher.data
    mesh.clear_geometry()
    mesh.from_pydata(corners, [], faces)
    mesh.update()


def catch_shadows_of(
    catcher: bpy.types.Object, triangles: ArrayF32, around: tuple[ArrayF64, float] | None = None
) -> None:
    """Let `catcher`, made by `make_shadow_catcher`, stand for a scan, as `triangles_of` has it.

    With `around`, a middle (3,) and a distance in Blender units, for what is no farther from there: a ray that meets a
    catcher costs several times one that meets nothing.
    """
    if around is not None:
        middle, reach = around
        away = np.linalg.norm(triangles - middle, axis=-1)
        triangles = triangles[(away <= reach).all(axis=1)]
    mesh = catcher.data
    mesh.clear_geometry()
    points, corners = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    fill_mesh(mesh, points, corners.ravel(), 3 * np.arange(len(triangles)))


def corners_of(item: bpy.types.Object) -> ArrayF64:
    """(N, 3) the corners of a mesh without modifiers, in its own axes: of a catcher those of the world."""
    return array_of(item.data.vertices, "co", np.float32, 3).astype(np.float64)


def triangles_of(scan: bpy.types.Object) -> ArrayF32:
    """(N, 3, 3) corners of the faces of a mesh, world, Blender units; of what its modifiers make nothing is known."""
    mesh = scan.data
    mesh.calc_loop_triangles()
    corners = array_of(mesh.loop_triangles, "vertices", np.int32, 3)
    world_from_scan = np.array(scan.matrix_world, np.float64)
    placed = corners_of(scan) @ world_from_scan[:3, :3].T + world_from_scan[:3, 3]
    triangles: ArrayF32 = placed.astype(np.float32)[corners]
    return triangles


def _unseen_in_eevee(name: str) -> bpy.types.Material:
    """White for Cycles, whatever the surface is: the ratio does not depend on it. Nothing at all for EEVEE."""
    material = new_material(name)
    tree = material.node_tree
    tree.nodes.clear()
    for target, shader in (("CYCLES", "ShaderNodeBsdfDiffuse"), ("EEVEE", "ShaderNodeBsdfTransparent")):
        output = tree.nodes.new("ShaderNodeOutputMaterial")
        output.target = target
        tree.links.new(tree.nodes.new(shader).outputs[0], output.inputs["Surface"])
    return material


def shadow_catchers(scene: bpy.types.Scene | None = None) -> list[bpy.types.Object]:
    """All catchers of ours in `scene`; None for those in the file itself."""
    among = bpy.data.objects if scene is None else scene.objects
    return [item for item in among if SHADOW_CATCHER in item and item.library is None]


def remove_shadow_catchers(catchers: Iterable[bpy.types.Object]) -> None:
    """Take them away, with their meshes and materials."""
    own: set[bpy.types.ID | None] = set()
    for catcher in catchers:
        mesh = catcher.data
        own |= {catcher, mesh, *mesh.materials}
    bpy.data.batch_remove(own - {None})  # The user may have deleted a material.
