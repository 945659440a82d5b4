"""A file that calculates in Rec.2020 or ACEScg is seen, lit and exported in the colours of Rec.709."""

import json
import os
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from effect_scenes import mirror
from renders import captured, rendered
from tiny_scenes import box, empty_scene, material, orthographic, phone, room_with_a_virtual_sphere, set_world, sphere

from addon_tests.pure.made import constant
from xihe_blender.addon.placement_map import Squares
from xihe_blender.apply.applied_lights import lights_of_scene
from xihe_blender.apply.datablocks import world_name
from xihe_blender.apply.key_suns import apply_key_to_sun, make_key_sun, sun_name
from xihe_blender.apply.placement_map import show_placement_map
from xihe_blender.apply.reflection_pictures import reflect_in_world, reflect_on_timeline
from xihe_blender.apply.sh_worlds import key_light_changes, make_sh_world
from xihe_blender.footage.import_capture import add_scan
from xihe_blender.io.exr import write_radiance
from xihe_blender.io.placement_results import Place, error_range
from xihe_blender.io.run_lights import LightsAsked
from xihe_blender.scene.colour_management import in_working_space
from xihe_blender.scene.shader_nodes import new_material
from xihe_blender.viewer.save import viewed_objects
from xihenet.captures.scan import ScanMesh
from xihenet.colour import linear_to_srgb
from xihenet.light.key_light import sh_of_key_light
from xihenet.records import KeyLight

ORANGE = (0.9, 0.3, 0.02)
MIRROR = 0.9
ROOT = Path(__file__).resolve().parents[2]
since_blender_5 = pytest.mark.skipif(bpy.app.version < (5, 0), reason="a file has no working space of its own")


@pytest.fixture(params=["Linear Rec.2020", "ACEScg"])
def change_working_space(request):
    """Changes it as File > Set Blend File's Working Color Space does, which keeps the colours that are seen."""
    yield lambda: bpy.ops.wm.set_working_color_space(working_space=request.param)
    empty_scene()
    assert bpy.data.colorspace.working_space == "Linear Rec.709"


@since_blender_5
def test_a_phone_sees_the_same_colours(change_working_space):
    scene = empty_scene()
    set_world(scene, ORANGE)
    phone(scene, (0, 0, 0), (0, 1, 0))
    before = captured(scene).srgb_u8
    change_working_space()
    np.testing.assert_allclose(captured(scene).srgb_u8.astype(int), before, atol=1)


@since_blender_5
def test_light_that_is_applied_renders_in_its_own_colours(change_working_space):
    scene = empty_scene()
    change_working_space()
    orthographic(scene)
    scene.world = make_sh_world("Xihe Ball")
    key_light_changes(scene.world, {1: constant(ORANGE), 2: constant(ORANGE[::-1])}, 2.0)
    for frame, colour in ((1, ORANGE), (2, ORANGE[::-1])):
        scene.frame_set(frame)
        np.testing.assert_allclose(rendered(scene, (8, 8), 1)[4, 4], np.divide(colour, 2.0), rtol=1e-3)


@since_blender_5
def test_a_key_light_renders_in_its_own_colours(change_working_space):
    scene = empty_scene()
    change_working_space()
    box(scene, "Floor", (0, 0, -0.5), (4, 4, 1), material("White", (1.0, 1.0, 1.0)))
    phone(scene, (0, 0, 3), (0, 0.01, 0))
    sun = make_key_sun("Xihe Key Light Ball")
    scene.collection.objects.link(sun)
    apply_key_to_sun(sun, KeyLight(np.array([0.0, 0.0, 1.0]), np.pi * np.array(ORANGE), 0.01, is_seen=True))
    np.testing.assert_allclose(rendered(scene, (8, 8), 16)[4, 4], ORANGE, rtol=0.02)


@since_blender_5
def test_pictures_that_are_reflected_have_their_own_colours(change_working_space, tmp_path):
    """One that is packed into the file, and one that is a file on the timeline."""
    scene = empty_scene()
    change_working_space()
    sphere(scene, "Ball", (0, 0, 0), 1.0, mirror())
    orthographic(scene, 0.1)
    scene.world = make_sh_world("Xihe Ball")
    picture = np.broadcast_to(np.float32(ORANGE), (16, 32, 3))
    reflect_in_world(scene.world, picture, 1.0)
    np.testing.assert_allclose(rendered(scene, (8, 8), 1)[4, 4], MIRROR * np.array(ORANGE), rtol=1e-3)
    write_radiance(tmp_path / "0_Ball_0001.exr", picture)
    reflect_on_timeline(scene.world, {1: tmp_path / "0_Ball_0001.exr"})
    scene.frame_set(1)
    np.testing.assert_allclose(rendered(scene, (8, 8), 1)[4, 4], MIRROR * np.array(ORANGE), rtol=1e-3)


@since_blender_5
def test_the_scan_of_a_recording_has_its_own_colours(change_working_space):
    scene = empty_scene()
    change_working_space()
    corners = np.float32([(-1, 1, -1), (1, 1, -1), (1, 1, 1), (-1, 1, 1)])
    scan = add_scan("Scan", ScanMesh(corners, np.array([[0, 1, 2, 3]]), np.tile(np.float32(ORANGE), (4, 1))), 1.0)
    scan.is_shadow_catcher = False
    scene.collection.objects.link(scan)
    set_world(scene, (1.0, 1.0, 1.0))
    phone(scene, (0, 0, 0), (0, 1, 0))
    np.testing.assert_allclose(rendered(scene, (8, 8), 16)[4, 4], ORANGE, atol=0.01)


@since_blender_5
def test_light_is_read_back_from_a_file_in_rec709(change_working_space):
    scene = room_with_a_virtual_sphere()
    change_working_space()
    light = constant(ORANGE)
    key_light_changes(make_sh_world(world_name("Ball")), {1: light}, 2.0)
    key = KeyLight(np.array([0.0, 0.0, 1.0]), np.array([2.0, 1.0, 0.1]), 0.01, is_seen=False)
    apply_key_to_sun(make_key_sun(sun_name("Ball")), key, 2.0)
    (found,) = lights_of_scene(scene, LightsAsked())
    np.testing.assert_allclose(found.light.key.irradiance, key.irradiance, rtol=1e-3)
    np.testing.assert_allclose(found.light.sh, light + sh_of_key_light(key), atol=1e-3)


@pytest.fixture
def painted_ball(change_working_space):
    """Its scene, the ball, and the shader of its only material."""
    scene = room_with_a_virtual_sphere()
    change_working_space()
    ball, shown = bpy.data.objects["Ball"], new_material("Painted")
    shown.node_tree.nodes.clear()
    shader, output = (shown.node_tree.nodes.new(f"ShaderNode{kind}") for kind in ("BsdfPrincipled", "OutputMaterial"))
    shown.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    ball.data.materials.clear()
    ball.data.materials.append(shown)
    return scene, ball, shader


@since_blender_5
def test_materials_of_a_viewer_have_their_own_colours(painted_ball):
    scene, ball, shader = painted_ball
    shader.inputs["Emission Strength"].default_value = 0.5
    for name, colour in (("Base Color", ORANGE), ("Emission Color", ORANGE[::-1]), ("Specular Tint", ORANGE)):
        shader.inputs[name].default_value = (*in_working_space(np.array(colour)), 1)
    (material,) = glb_of(scene, ball)[0]["materials"]
    np.testing.assert_allclose(material["pbrMetallicRoughness"]["baseColorFactor"], (*ORANGE, 1), atol=1e-3)
    np.testing.assert_allclose(material["emissiveFactor"], np.array(ORANGE[::-1]) / 2, atol=1e-3)
    tint = material["extensions"]["KHR_materials_specular"]["specularColorFactor"]
    np.testing.assert_allclose(tint, ORANGE, atol=1e-3)


@since_blender_5
@pytest.mark.parametrize("kind", ["BYTE_COLOR", "FLOAT_COLOR"])
def test_vertices_of_a_viewer_have_their_own_colours(painted_ball, kind):
    scene, ball, shader = painted_ball
    painted = ball.data.color_attributes.new("Painted", kind, "POINT")
    is_light = kind == "FLOAT_COLOR"
    stored = in_working_space(np.array(ORANGE)) if is_light else linear_to_srgb(ORANGE)
    painted.data.foreach_set("color" if is_light else "color_srgb", np.tile([*stored, 1], len(painted.data)))
    colour = shader.id_data.nodes.new("ShaderNodeVertexColor")
    colour.layer_name = "Painted"
    shader.id_data.links.new(colour.outputs[0], shader.inputs["Base Color"])
    document, binary = glb_of(scene, ball)
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    number, white = {5121: ("u1", 255), 5123: ("<u2", 65535), 5126: ("<f4", 1)}[accessor["componentType"]]
    np.testing.assert_allclose(np.frombuffer(binary, number, 3, start) / white, ORANGE, atol=0.01)


def glb_of(scene, item):
    """The document and the binary part of an object of the viewer; whole."""
    glb = viewed_objects(scene, [item], [1])[0].glb
    length = int.from_bytes(glb[12:16], "little")
    assert int.from_bytes(glb[8:12], "little") == len(glb) and length % 4 == 0
    assert int.from_bytes(glb[20 + length : 24 + length], "little") == len(glb) - 28 - length
    return json.loads(glb[20 : 20 + length]), glb[28 + length :]


@since_blender_5
def test_squares_of_a_map_have_their_own_colours(change_working_space, tmp_path):
    scene = empty_scene()
    change_working_space()
    places = [
        Place(position_m=(0.0, 0.0, 0.1), coverage=0.9, expected_error=error, irradiance=None) for error in (0.1, 0.5)
    ]
    shown = show_placement_map(scene, places, spacing_m=0.5, clearance_m=0.1, folder=tmp_path)
    wanted = np.array([place.colour(error_range(places)) for place in places]) / 255
    np.testing.assert_allclose(linear_to_srgb(Squares(shown).colours[::4, :3]), wanted, atol=0.01)


@pytest.mark.slow
@pytest.mark.wheel_only("Blender reads its configuration of colours as it starts")
def test_a_configuration_of_aces_has_another_space_and_names_of_its_own_in_every_blender(tmp_path):
    write_radiance(tmp_path / "0_Ball_0001.exr", np.broadcast_to(np.float32(ORANGE), (16, 32, 3)))
    code = f"""
import os, sys
from pathlib import Path
sys.path[:0] = {str(ROOT)!r}, {str(Path(__file__).parent)!r}
from test_colour_management import *
from xihe_blender.scene.colour_management import show_as_it_is
scene = empty_scene()
orthographic(scene, 0.1)
scene.world = make_sh_world("Xihe Ball")
key_light_changes(scene.world, {{1: constant(ORANGE)}}, 1.0)
colours = [*scene.world.node_tree.nodes["Xihe SH Radiance"].inputs[0].default_value, *rendered(scene, (8, 8), 1)[4, 4]]
sphere(scene, "Ball", (0, 0, 0), 1.0, mirror())
reflect_on_timeline(scene.world, {{1: Path({str(tmp_path)!r}, "0_Ball_0001.exr")}})
scene.frame_set(1)
show_as_it_is(scene)
print("here", *colours, *rendered(scene, (8, 8), 1)[4, 4], scene.view_settings.view_transform, flush=True)
os._exit(0)
"""
    environment = {**os.environ, "OCIO": "ocio://cg-config-v2.1.0_aces-v1.3_ocio-v2.3"}
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment, timeout=100)
    *colours, view = done.stdout.split("here")[1].split()
    kept, shown, reflected = np.array(colours, float).reshape(3, 3)
    assert kept[0] / kept[2] < 15 < ORANGE[0] / ORANGE[2]  # The same colour is less far from grey in ACEScg's numbers.
    np.testing.assert_allclose(shown, ORANGE, rtol=1e-3)
    np.testing.assert_allclose(reflected, MIRROR * np.array(ORANGE), rtol=1e-3)
    assert view == "Un-tone-mapped"
