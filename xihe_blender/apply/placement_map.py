"""The placement map in the open file: a mesh `Xihe Placement Map`, a square at each place in the colour of its error.

Its faces carry what is known of the places as attributes, for geometry nodes and scripts, and the colours as a colour
attribute, which its material shows. It is never rendered and casts no light, so runs do not see it. What else belongs
to the map is a custom property of the mesh, so that Undo and saving keep both together.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import bpy

from xihe_blender.apply.datablocks import MAP, placement_map
from xihe_blender.io.placement_results import N_EXTREMES, Place, best_first, error_range
from xihe_blender.scene.shader_nodes import new_material
from xihe_blender.scene.state import show_to_camera_alone
from xihe_blender.scene.units import metres_per_unit

NAME = "Xihe Placement Map"
COLOURS = "Expected Error"
"""The colour attribute; the expected error itself is `expected_error`."""

UNKNOWN_ERROR = -1.0
"""In the attribute `expected_error` of places of which nothing is known."""

SIDE = 0.92
"""Of a square, as a share of the spacing: the gaps show how fine the map is."""

LIFT_M = 0.004
"""Above the surface: less would flicker in the view."""


@dataclass(frozen=True)
class MapOf:
    """What the map is of; as text it is the custom property MAP of its mesh.

    Parameters
    ----------
    folder : of the run whose frames it is made from
    spacing_m : between places
    clearance_m : of the places above the squares; 0 in free air
    error_range : expected errors at both ends of the colours
    best, worst : faces, at most ten of each, the most extreme first
    """

    folder: str
    spacing_m: float
    clearance_m: float
    error_range: tuple[float, float]
    best: tuple[int, ...]
    worst: tuple[int, ...]

    @classmethod
    def read(cls, mesh: bpy.types.Mesh) -> MapOf:
        return cls(**json.loads(mesh[MAP]))


def show_placement_map(
    scene: bpy.types.Scene, places: Sequence[Place], *, spacing_m: float, clearance_m: float, folder: Path
) -> bpy.types.Object:
    """Make the map of `places`, in the collection of `scene` itself; an earlier one goes."""
    remove_placement_map()
    metres, half = metres_per_unit(scene), SIDE * spacing_m / 2
    corners: list[tuple[float, float, float]] = []
    faces = []
    for x, y, z in (place.position_m for place in places):
        bottom = z - clearance_m + LIFT_M
        around = ((-half, -half), (half, -half), (half, half), (-half, half))
        faces.append(tuple(range(len(corners), len(corners) + 4)))
        corners += [((x + dx) / metres, (y + dy) / metres, bottom / metres) for dx, dy in around]
    mesh = bpy.data.meshes.new(NAME)
    mesh.from_pydata(corners, [], faces)
    _add_attributes(mesh, places)
    mesh.materials.append(_material())
    order = best_first(places)
    best, worst = tuple(order[:N_EXTREMES]), tuple(order[::-1][:N_EXTREMES])
    mesh[MAP] = json.dumps(asdict(MapOf(str(folder), spacing_m, clearance_m, error_range(places), best, worst)))
    item = bpy.data.objects.new(NAME, mesh)
    item.hide_render = True
    show_to_camera_alone(item)  # A rendered view shows what is not hidden in the view, and would be lit by it.
    scene.collection.objects.link(item)
    return item


def _add_attributes(mesh: bpy.types.Mesh, places: Sequence[Place]) -> None:
    errors = [UNKNOWN_ERROR if place.expected_error is None else place.expected_error for place in places]
    for name, values in (("expected_error", errors), ("coverage", [place.coverage for place in places])):
        mesh.attributes.new(name, "FLOAT", "FACE").data.foreach_set("value", values)
    light = [channel for place in places for channel in place.irradiance or (0.0, 0.0, 0.0)]
    mesh.attributes.new("irradiance", "FLOAT_VECTOR", "FACE").data.foreach_set("vector", light)
    colours, shown = mesh.color_attributes.new(COLOURS, "BYTE_COLOR", "CORNER"), error_range(places)
    of_corners = [4 * (*(part / 255 for part in place.colour(shown)), 1.0) for place in places]
    colours.data.foreach_set("color_srgb", [number for corner in of_corners for number in corner])
    mesh.color_attributes.active_color = colours


def _material() -> bpy.types.Material:
    """Shines in the colours of the attribute, whatever light there is."""
    material = new_material(NAME)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    attribute, emission, output = (
        nodes.new(f"ShaderNode{kind}") for kind in ("VertexColor", "Emission", "OutputMaterial")
    )
    attribute.layer_name = COLOURS
    links.new(attribute.outputs["Color"], emission.inputs["Color"])
    links.new(emission.outputs["Emission"], output.inputs["Surface"])
    return material


def remove_placement_map() -> None:
    """The map, its mesh and its material; nothing where there is none."""
    item = placement_map()
    while item is not None:
        mesh, materials = item.data, list(item.data.materials)
        bpy.data.objects.remove(item)
        bpy.data.meshes.remove(mesh)
        for material in materials:
            if material is not None and material.name.startswith(NAME) and not material.users:
                bpy.data.materials.remove(material)
        item = placement_map()


def shown_place(item: bpy.types.Object, index: int) -> Place:
    """The place of face `index` of the map, as far as the map says it."""
    mesh, attributes = item.data, item.data.attributes
    x, y, z = (number * metres_per_unit(bpy.context.scene) for number in mesh.polygons[index].center)
    error = attributes["expected_error"].data[index].value
    is_known = error != UNKNOWN_ERROR
    red, green, blue = attributes["irradiance"].data[index].vector
    return Place(
        position_m=(x, y, z - LIFT_M + MapOf.read(mesh).clearance_m),
        coverage=attributes["coverage"].data[index].value,
        expected_error=error if is_known else None,
        irradiance=(red, green, blue) if is_known else None,
    )
