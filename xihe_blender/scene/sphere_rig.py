"""The three spheres of the field's comparisons, as virtual objects."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from xihe_blender.scene.mesh_arrays import fill_mesh
from xihe_blender.scene.shader_nodes import new_material
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.records import ArrayInt

MIRROR = "Xihe Mirror Sphere"
RIG_LOOKS: dict[str, dict[str, Any]] = {
    MIRROR: {"Base Color": (1.0, 1.0, 1.0, 1.0), "Metallic": 1.0, "Roughness": 0.0},
    "Xihe Matte Silver Sphere": {"Base Color": (0.9, 0.9, 0.9, 1.0), "Metallic": 1.0, "Roughness": 0.3271},
    "Xihe Diffuse Sphere": {"Base Color": (0.5, 0.5, 0.5, 1.0), "Roughness": 1.0, "Specular IOR Level": 0.0},
}


def add_three_sphere_rig(
    scene: bpy.types.Scene, location: tuple[float, float, float], radius_m: float = 0.06
) -> list[bpy.types.Object]:
    """Put mirror, matte silver and diffuse sphere side by side along X, each a virtual object of its own.

    They are what the field's comparisons render: together they show sharp reflections, the main light's direction and
    the irradiance.

    Parameters
    ----------
    scene : gets the virtual collection if it has none
    location : world point under the middle sphere, Blender units, as the 3D cursor has it
    radius_m : of each sphere; ValueError if it is not positive and finite
    """
    if not (np.isfinite(radius_m) and radius_m > 0):
        raise ValueError(f"add_three_sphere_rig: radius_m must be positive and finite, got {radius_m}")
    collection = virtual_collection(scene, create=True)
    assert collection is not None
    x, y, z = location
    radius = radius_m / metres_per_unit(scene)
    spheres = []
    for step, (name, look) in zip((-1, 0, 1), RIG_LOOKS.items(), strict=True):
        sphere = bpy.data.objects.new(name, sphere_mesh(name, radius))
        sphere.data.materials.append(rig_material(name, look))
        sphere.location = (x + 2.3 * radius * step, y, z + radius)
        collection.objects.link(sphere)
        spheres.append(sphere)
    return spheres


def sphere_mesh(name: str, radius: float, n_around: int = 64, n_up: int = 32) -> bpy.types.Mesh:
    """A smooth UV sphere around the origin; bmesh's own orders its vertices differently from version to version."""
    polar = np.pi * np.arange(1, n_up) / n_up
    azimuth = 2 * np.pi * np.arange(n_around) / n_around
    across, along = np.sin(polar)[:, None], np.cos(polar)[:, None] * np.ones(n_around)
    rings = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), along], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([rings, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]) * radius
    mesh = bpy.data.meshes.new(name)
    fill_mesh(mesh, vertices, *_sphere_faces(n_around, n_up - 1))
    return mesh


def _sphere_faces(n_around: int, n_rings: int) -> tuple[ArrayInt, ArrayInt]:
    """The corners of all faces, and where each begins: triangles at the poles, four corners between them.

    Vertices are rings from the top down, followed by the top and the bottom pole; faces turn outwards.
    """
    ring = np.arange(n_around)
    after = np.roll(ring, -1)
    top, last = n_rings * n_around, (n_rings - 1) * n_around
    upper = n_around * np.arange(n_rings - 1)[:, None]
    lower = upper + n_around
    above = np.stack([np.full(n_around, top), ring, after], axis=-1)
    below = np.stack([np.full(n_around, top + 1), last + after, last + ring], axis=-1)
    between = np.stack([upper + ring, lower + ring, lower + after, upper + after], axis=-1).reshape(-1, 4)
    n_corners = np.repeat([3, 4], [len(above) + len(below), len(between)])
    corners = np.concatenate([faces.ravel() for faces in (above, below, between)])
    return corners, np.cumsum(n_corners) - n_corners


def rig_material(name: str, look: dict[str, Any]) -> bpy.types.Material:
    """The rig's material `name`, the existing one if a rig was added before."""
    known = bpy.data.materials.get(name)
    if known is not None:
        return known
    material = new_material(name)
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for socket, value in look.items():
        shader.inputs[socket].default_value = value
    return material
