"""Which objects are virtual, and where their light is estimated."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest

from xihe_blender.errors import UserError
from xihe_blender.scene.estimation_positions import MAX_POSITIONS, box_cell_centres, estimation_positions
from xihe_blender.scene.sphere_rig import add_three_sphere_rig
from xihe_blender.scene.virtual_objects import COLLECTION_NAME, virtual_collection, virtual_objects

CUBE_CORNERS = [(x, y, z) for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]
CUBE_FACES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


@pytest.fixture
def scene() -> bpy.types.Scene:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def add_object(name: str, data: object, collection: bpy.types.Collection) -> bpy.types.Object:
    added = bpy.data.objects.new(name, data)
    collection.objects.link(added)
    return added


def add_box(name: str, collection: bpy.types.Collection, size: tuple[float, float, float]) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([[c * s for c, s in zip(corner, size, strict=True)] for corner in CUBE_CORNERS], [], CUBE_FACES)
    return add_object(name, mesh, collection)


def positions_of(thing: bpy.types.Object) -> np.ndarray:
    bpy.context.view_layer.update()
    return estimation_positions(thing, bpy.context.evaluated_depsgraph_get())


def test_the_collection_is_made_once_and_only_on_request(scene):
    assert virtual_collection(scene) is None
    made = virtual_collection(scene, create=True)
    assert made.name == COLLECTION_NAME
    assert virtual_collection(scene) == made
    assert virtual_collection(scene, create=True) == made


def test_a_scene_does_not_find_the_collection_of_another_scene(scene):
    virtual_collection(scene, create=True)
    assert virtual_collection(bpy.data.scenes.new("Other")) is None


def test_a_collection_that_no_scene_shows_is_linked_instead_of_doubled(scene):
    stray = bpy.data.collections.new(COLLECTION_NAME)
    assert virtual_collection(scene) is None
    assert virtual_collection(scene, create=True) == stray


def test_a_nested_collection_is_found(scene):
    outer = bpy.data.collections.new("Set dressing")
    scene.collection.children.link(outer)
    inner = bpy.data.collections.new(COLLECTION_NAME)
    outer.children.link(inner)
    assert virtual_collection(scene) == inner


def test_virtual_objects_are_the_geometry_inside_sorted_by_name(scene):
    virtual = virtual_collection(scene, create=True)
    child = bpy.data.collections.new("Child")
    virtual.children.link(child)
    add_box("Room box", scene.collection, (1, 1, 1))
    add_box("b", child, (1, 1, 1))
    add_object("a", bpy.data.curves.new("a", "FONT"), virtual)
    add_object("lamp", bpy.data.lights.new("lamp", "POINT"), virtual)
    add_object("eye", bpy.data.cameras.new("eye"), virtual)
    add_object("handle", None, virtual)
    assert [thing.name for thing in virtual_objects(scene)] == ["a", "b"]


def test_a_scene_without_the_collection_has_no_virtual_object(scene):
    add_box("Room box", scene.collection, (1, 1, 1))
    assert virtual_objects(scene) == []


def test_a_hidden_object_stays_virtual(scene):
    thing = add_box("Box", virtual_collection(scene, create=True), (1, 1, 1))
    thing.hide_render = thing.hide_viewport = True
    assert virtual_objects(scene) == [thing]


def test_a_small_object_has_the_centre_of_its_box(scene):
    thing = add_box("Box", scene.collection, (0.4, 0.2, 0.6))
    thing.location, thing.rotation_euler = (1.0, -2.0, 0.5), (0.3, 0.2, 0.1)
    np.testing.assert_allclose(positions_of(thing), [[1.0, -2.0, 0.5]], atol=1e-6)


def test_modifiers_move_the_centre(scene):
    thing = add_box("Box", scene.collection, (0.2, 0.2, 0.2))
    row = thing.modifiers.new("Row", "ARRAY")
    row.count, row.relative_offset_displace = 3, (1.0, 0.0, 0.0)
    np.testing.assert_allclose(positions_of(thing), [[0.2, 0.0, 0.0]], atol=1e-6)


def test_a_long_object_is_split_evenly_along_its_world_axis(scene):
    thing = add_box("Shelf", scene.collection, (2.5, 0.3, 0.3))
    thing.rotation_euler = (0.0, 0.0, math.radians(90))
    expected = [[0.0, y, 0.0] for y in (-2.5 / 3, 0.0, 2.5 / 3)]
    np.testing.assert_allclose(positions_of(thing), expected, atol=1e-6)


def test_a_box_of_exactly_one_spacing_is_one_cell(scene):
    thing = add_box("Box", scene.collection, (1.0, 1.0, 1.0))
    thing.location = (0.1, 0.7, 123.3)
    assert positions_of(thing).shape == (1, 3)


def test_cells_cover_the_box_and_are_no_longer_than_the_spacing():
    rng = np.random.default_rng(4)
    for _ in range(200):
        low = rng.uniform(-5, 5, 3)
        size, spacing = rng.uniform(0, 4, 3), rng.uniform(0.3, 2)
        centres = box_cell_centres(low, low + size, spacing)
        axes = [np.unique(centres[:, i].round(9)) for i in range(3)]
        counts = np.array([len(axis) for axis in axes])
        assert len(centres) == counts.prod()
        assert (size / counts <= spacing * 1.0001).all()
        np.testing.assert_allclose(centres.mean(axis=0), low + size / 2, atol=1e-9)
        np.testing.assert_allclose([axis[0] for axis in axes], low + size / counts / 2, atol=1e-8)


def test_an_instancing_empty_has_the_box_of_what_it_shows(scene):
    prototype = bpy.data.collections.new("Prototype")
    add_box("Part", prototype, (0.2, 0.2, 0.2)).location = (1.0, 0.0, 0.0)
    add_box("Other part", prototype, (0.2, 0.2, 0.2)).location = (1.4, 0.0, 0.0)
    empty = add_object("Stamp", None, virtual_collection(scene, create=True))
    empty.instance_type, empty.instance_collection = "COLLECTION", prototype
    empty.location = (0.0, 0.0, 3.0)
    assert virtual_objects(scene) == [empty]
    np.testing.assert_allclose(positions_of(empty), [[1.2, 0.0, 3.0]], atol=1e-6)


def test_an_object_without_geometry_has_its_origin(scene):
    thing = add_object("Nothing", bpy.data.meshes.new("Nothing"), scene.collection)
    thing.location = (1.0, 2.0, 3.0)
    np.testing.assert_allclose(positions_of(thing), [[1.0, 2.0, 3.0]])


def test_an_object_of_an_excluded_collection_keeps_its_place(scene):
    virtual = virtual_collection(scene, create=True)
    thing = add_box("Box", virtual, (0.2, 0.2, 0.2))
    thing.location = (1.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    bpy.context.view_layer.layer_collection.children[COLLECTION_NAME].exclude = True
    np.testing.assert_allclose(positions_of(thing), [[1.0, 2.0, 3.0]], atol=1e-6)


def test_an_object_of_as_many_positions_as_there_may_be_is_the_last_that_is_not_refused(scene):
    largest = add_box("Hall", scene.collection, (MAX_POSITIONS / 2, 2.0, 0.5))
    assert len(positions_of(largest)) == MAX_POSITIONS
    largest.location = (1e4, 0.0, 0.0)
    assert len(positions_of(largest)) == MAX_POSITIONS
    larger = add_box("Street", scene.collection, (MAX_POSITIONS / 2 + 1, 2.0, 0.5))
    with pytest.raises(UserError, match=r"'Street' is 501 x 2 x 0.5 m .* 1002 positions: .* unit scale"):
        positions_of(larger)


def test_an_object_without_a_finite_place_is_refused(scene):
    thing = add_box("Box", scene.collection, (1, 1, 1))
    # Blender makes the largest float of an infinite one.
    thing.location = (0.0, math.nan, 0.0)
    with pytest.raises(UserError, match="'Box' has no finite position"):
        positions_of(thing)


def test_the_rig_is_three_spheres_that_rest_on_the_place(scene):
    rig = add_three_sphere_rig(scene, (1.0, 2.0, 0.7), 0.1)
    assert virtual_objects(scene) == sorted(rig, key=lambda sphere: sphere.name)
    centres = np.concatenate([positions_of(sphere) for sphere in rig])
    np.testing.assert_allclose(centres.mean(axis=0), [1.0, 2.0, 0.8], atol=1e-6)
    assert (np.diff(centres[:, 0]) > 0.2).all(), "the spheres must not touch"
    for sphere, centre in zip(rig, centres, strict=True):
        corners = np.array([sphere.matrix_world @ v.co for v in sphere.data.vertices])
        np.testing.assert_allclose(np.linalg.norm(corners - centre, axis=1), 0.1, atol=1e-6)
        assert corners[:, 2].min() == pytest.approx(0.7, abs=1e-6)
        assert all(face.normal.dot(face.center) > 0 for face in sphere.data.polygons), "faces look outwards"
        assert len(sphere.data.edges) - len(sphere.data.polygons) == len(sphere.data.vertices) - 2, "closed"
        assert sphere.data.materials[0].name == sphere.name


def test_the_rig_has_the_three_usual_surfaces(scene):
    mirror, silver, grey = (
        sphere.data.materials[0].node_tree.nodes["Principled BSDF"].inputs
        for sphere in add_three_sphere_rig(scene, (0, 0, 0))
    )
    assert (mirror["Metallic"].default_value, mirror["Roughness"].default_value) == (1.0, 0.0)
    assert silver["Metallic"].default_value == 1.0
    assert silver["Roughness"].default_value == pytest.approx(0.3271)
    assert (grey["Metallic"].default_value, grey["Specular IOR Level"].default_value) == (0.0, 0.0)
    assert tuple(grey["Base Color"].default_value)[:3] == (0.5, 0.5, 0.5)


def test_a_second_rig_shares_the_materials(scene):
    add_three_sphere_rig(scene, (0, 0, 0))
    add_three_sphere_rig(scene, (1, 0, 0))
    assert len(virtual_objects(scene)) == 6
    assert len(bpy.data.materials) == 3


@pytest.mark.parametrize("radius_m", [0.0, -0.1, math.nan])
def test_a_useless_radius_is_refused(scene, radius_m):
    with pytest.raises(ValueError, match="radius_m must be positive"):
        add_three_sphere_rig(scene, (0, 0, 0), radius_m)
