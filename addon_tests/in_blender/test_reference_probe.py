"""The reference probe holds all the light: lamps that cameras cannot see, from anywhere, linked or not, of any size."""

import math
from dataclasses import replace

import bpy
import numpy as np
import pytest
import tiny_scenes
from effect_scenes import fog, shader_look, shader_node
from mathutils import Vector
from previs_runs import counted_renders, handler_in
from scene_snapshot import snapshot
from tiny_scenes import add, box, empty_scene, material, room_with_a_virtual_sphere, set_world, sphere

from xihe_blender.capture.reference_probe import (
    MORE_BLUR,
    MeasuredLight,
    ProbeSettings,
    cone_factors,
    lights_of_cones,
    open_reference_probe,
)
from xihe_blender.capture.render import stacked_rgb
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.mirror_ball import ball_directions, project_mirror_ball
from xihenet.sh import basis, irradiance

POSITION = np.array([0.3, -0.2, 1.0])
FEW = ProbeSettings(80, 4, noise_target=None)
DISTANCE_M = 2.0
GLOW = 50.0
UP, DOWN, *ASKEW = (np.array(d) / np.linalg.norm(d) for d in [(0, 0, 1), (0, 0, -1), (1, 0, 1), (-1, 1, 0), (1, -1, 1)])
"""Straight down is the rim of the picture."""


def add_lamp(scene, kind, direction, distance_m=DISTANCE_M, **values):
    """A lamp as Blender makes it, hidden from camera rays, at POSITION + direction, shining back."""
    lamp = tiny_scenes.add_lamp(scene, kind, POSITION + distance_m * direction, **values)
    lamp.rotation_euler = Vector(-direction).to_track_quat("-Z", "Y").to_euler()
    return lamp


def dark_scene():
    scene = empty_scene()
    set_world(scene)
    return scene


def measured(scene, settings=FEW, objects=None, position_m=POSITION):
    with open_reference_probe(scene, [position_m], settings, objects) as probe:
        return probe.light_at(0, 1).measured


def of_a_disc(irradiance_of_it, direction, half_angle):
    """(9, 3) coefficients of a disc of even radiance, by its irradiance on a surface that faces it, if it is small."""
    c = math.cos(half_angle)
    bands = np.repeat([1.0, (1 + c) / 2, c * (1 + c) / 2], [1, 3, 5])
    return np.repeat((irradiance_of_it * bands * basis(direction[None])[0])[:, None], 3, axis=1)


POINT = 100 / (4 * math.pi * DISTANCE_M**2)
LAMPS = {
    "sun": ({"kind": "SUN", "energy": 3.0, "angle": 0.0}, 3.0, 0.0),
    "wide sun": ({"kind": "SUN", "energy": 3.0, "angle": math.radians(10)}, 3.0, math.radians(5)),
    "point of a millimetre": ({"kind": "POINT", "energy": 100.0, "shadow_soft_size": 0.001}, POINT, 0.0),
    "spot": ({"kind": "SPOT", "energy": 100.0, "shadow_soft_size": 0.01, "spot_size": 1.0}, POINT, 0.0),
    "small disc": ({"kind": "AREA", "energy": 100.0, "shape": "DISK", "size": 0.02}, 4 * POINT, 0.0),
}


@pytest.mark.parametrize(
    ("name", "direction"),
    [*((name, DOWN) for name in LAMPS), *zip(LAMPS, [*ASKEW, UP, ASKEW[0]], strict=True)],
    ids=str,
)
def test_a_lamp_that_cameras_cannot_see_is_held_whole(name, direction):
    values, at_position, half_angle = LAMPS[name]
    scene = dark_scene()
    add_lamp(scene, values["kind"], direction, **{k: v for k, v in values.items() if k != "kind"})
    light, expected = measured(scene), of_a_disc(at_position, direction, half_angle)
    assert np.linalg.norm(light.hdr - expected) < 0.02 * np.linalg.norm(expected)
    assert np.abs(light.ldr).max() < 1e-3, "camera rays do not see it"


def test_a_lamp_of_ten_metres_fills_half_of_the_sphere():
    scene = dark_scene()
    add_lamp(scene, "AREA", UP, 0.05, energy=1000.0, size=10.0)
    level = 1000 / 100 / math.pi
    light = measured(scene).hdr
    assert light[0, 0] == pytest.approx(level * 2 * np.pi / np.sqrt(4 * np.pi), rel=0.02)
    facing = irradiance(light, np.array([[0.0, 0.0, 1.0]]))[0, 0]
    assert facing == pytest.approx(level * np.pi, rel=0.03)


def test_a_glowing_floor_below_fills_half_of_the_sphere_100_km_from_the_origin_too():
    scene, position_m = dark_scene(), POSITION + (1e5, 0, 0)
    box(scene, "Floor", position_m - (0, 0, 1.05), (20, 20, 2), material("Glow", (1, 1, 1), emission=0.5))
    light = measured(scene, position_m=position_m)
    for found in (light.hdr, light.ldr):
        assert found[0, 0] * np.sqrt(4 * np.pi) == pytest.approx(0.5 * 2 * np.pi, rel=0.02)


def test_light_from_everywhere_is_whole_100_km_from_the_origin_too():
    scene = dark_scene()
    set_world(scene, (0.5, 0.5, 0.5))
    found = measured(scene, position_m=np.full(3, 1e5)).hdr
    np.testing.assert_allclose(found, 0.5 * np.sqrt(4 * np.pi) * np.eye(9, 1) * np.ones(3), atol=2e-3)


def scene_with_a_glowing_disc(radius_m):
    """A disc of radiance GLOW straight above the position, in the dark."""
    scene = dark_scene()
    turns = 2 * math.pi * np.arange(64) / 64
    mesh = bpy.data.meshes.new("Disc")
    mesh.from_pydata([(radius_m * math.cos(a), radius_m * math.sin(a), 0) for a in turns], [], [tuple(range(64))])
    mesh.materials.append(material("Glow", (1, 1, 1), emission=GLOW))
    add(scene, "Disc", mesh, POSITION + (0, 0, DISTANCE_M))
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("radius_m", [0.1, 0.6])
def test_a_glowing_disc_above_counts_once(radius_m):
    solid_angle = 2 * math.pi * (1 - math.cos(math.atan(radius_m / DISTANCE_M)))
    n_pictures = 16 if radius_m < 0.2 else 4
    light = measured(scene_with_a_glowing_disc(radius_m), ProbeSettings(max_samples=n_pictures, noise_target=None))
    assert light.hdr[0, 0] * np.sqrt(4 * np.pi) == pytest.approx(GLOW * solid_angle, rel=0.03)
    # Some 130 rays of 16 pictures meet the small disc.
    assert light.ldr[0, 0] * np.sqrt(4 * np.pi) == pytest.approx(solid_angle, rel=0.2 if radius_m < 0.2 else 0.03)


def test_a_lamp_is_as_white_through_fog_as_many_rays_show_it():
    scene = scene_with_a_glowing_disc(3.0)
    bpy.data.materials["Glow"].node_tree.nodes["Emission"].inputs["Strength"].default_value = 2.5
    air = fog("Air")
    air.node_tree.nodes["Volume Scatter"].inputs["Density"].default_value = 0.4
    box(scene, "Air", POSITION, (8, 8, 8), air)
    settings = replace(FEW, size=48, max_samples=8, light_transport=(("volume_bounces", 1),))
    with open_reference_probe(scene, [POSITION], settings) as probe:
        many = stacked_rgb(probe.view(0, 9, samples=64).passes, "Combined")
        clipped = project_mirror_ball(np.minimum(many, 1))
        assert probe.light_at(0, 1).measured.ldr[0, 0] == pytest.approx(clipped[0, 0], rel=0.05)


def with_a_linked_lamp(state):
    """A lamp above whose receivers are the virtual ball, alone ("INCLUDE") or not at all ("EXCLUDE")."""
    scene = dark_scene()
    ball = sphere(scene, "Ball", POSITION, 0.1, None, virtual_collection(scene, create=True))
    lamp = add_lamp(scene, "POINT", UP, energy=100.0)
    receivers = bpy.data.collections.new("Receivers")
    receivers.objects.link(ball)
    receivers.collection_objects[0].light_linking.link_state = state
    lamp.light_linking.receiver_collection = receivers
    return scene, ball, receivers


@pytest.mark.parametrize(("state", "is_lit"), [("INCLUDE", True), ("EXCLUDE", False)])
def test_the_probe_joins_the_light_links_of_the_virtual_object(state, is_lit):
    scene, ball, receivers = with_a_linked_lamp(state)
    light = measured(scene, objects=[ball]).hdr[0, 0]
    other = measured(scene, objects=[None]).hdr[0, 0]
    expected = POINT / np.sqrt(4 * np.pi)
    assert light == pytest.approx(expected if is_lit else 0.0, rel=0.02, abs=1e-6)
    assert other == pytest.approx(0.0 if is_lit else expected, rel=0.02, abs=1e-6)
    assert list(receivers.objects) == [ball]


def test_a_probe_neither_shades_nor_lights_the_room_and_leaves_nothing():
    scene = room_with_a_virtual_sphere()
    scene.frame_set(1)
    before = snapshot()
    with open_reference_probe(scene, [(0, 0, 0.85), (0.3, 0, 0.85)], FEW) as probe:
        together = probe.light_at(0, 1).measured
    with open_reference_probe(scene, [(0, 0, 0.85)], FEW) as probe:
        alone = probe.light_at(0, 1).measured
    np.testing.assert_allclose(together.ldr, alone.ldr, atol=2e-3)
    np.testing.assert_allclose(together.hdr, alone.hdr, atol=2e-2)
    after = {name: value for name, value in snapshot().items() if "Render Result" not in name}
    assert after == before


@pytest.mark.slow
def test_irradiance_is_that_of_a_white_patch():
    """Against another renderer's path: a small white square, baked, which knows nothing of cones."""
    scene = room_with_a_virtual_sphere()
    bpy.data.objects.remove(bpy.data.objects["Ball"])
    add_lamp(scene, "AREA", np.array([0.0, 0.6, 0.8]), 1.0, energy=10.0, size=0.3)
    place = (0.1, -0.1, 1.2)
    light = measured(scene, ProbeSettings(96, 8, noise_target=None), position_m=place).hdr
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    patched = np.array([_baked(scene, place, normal) for normal in normals])
    found = irradiance(light, normals)
    assert np.abs(found - patched).max() < 0.1 * patched.max()
    assert np.abs(found.mean(axis=0) / patched.mean(axis=0) - 1).max() < 0.02


def test_a_light_can_be_left_before_each_of_its_pictures():
    with open_reference_probe(dark_scene(), [POSITION], ProbeSettings(16, 2)) as probe, counted_renders() as renders:
        n_done = [len(renders) for _ in probe.light_by_steps(0, 1)]
    assert n_done == list(range(len(renders))) and len(renders) >= 4


def test_filter_glossy_blurs_what_the_probe_meets_as_for_a_matte_surface():
    """A rough metal is darker than a polished one: in a white world the blur is seen by that."""
    scene = dark_scene()
    set_world(scene, (1.0, 1.0, 1.0))
    metal = shader_look("Metal", "BsdfAnisotropic", Roughness=0.0, Color=(1.0, 1.0, 1.0, 1.0))
    box(scene, "Mirror", POSITION - (0, 0, 0.2), (50, 50, 0.1), metal)
    scene.cycles.blur_glossy = 1.0
    mean = measured(scene).hdr[0, 0] / np.sqrt(4 * np.pi)
    up, down, beside = (_baked(scene, POSITION, normal)[0] / np.pi for normal in (UP, DOWN, np.array([1.0, 0, 0])))
    assert down < 0.98 and mean == pytest.approx((up + down + 4 * beside) / 6, abs=0.015)


def test_what_camera_rays_see_has_the_scenes_own_filter_glossy():
    scene, blurs = dark_scene(), []
    scene.cycles.blur_glossy = 0.5
    with (
        handler_in(bpy.app.handlers.render_init, lambda working, *_: blurs.append(working.cycles.blur_glossy)),
        open_reference_probe(scene, [POSITION], ProbeSettings(16, 2, denoise=False)) as probe,
    ):
        for _ in range(2):
            probe.light_at(0, 1)
    assert blurs == pytest.approx(2 * [0.5, 0.5, MORE_BLUR / 2, MORE_BLUR / 2]) and scene.cycles.blur_glossy == 0.5


def _baked(scene, place, normal):
    """(3,) irradiance that Blender bakes onto a square of a millimetre."""
    square = box(scene, "Patch", place, (1e-3, 1e-3, 1e-6), material("White", (1.0, 1.0, 1.0)))
    square.rotation_euler = Vector(normal).to_track_quat("Z", "Y").to_euler()
    for ray in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(square, f"visible_{ray}", False)
    attribute = square.data.color_attributes.new("Bake", "FLOAT_COLOR", "CORNER")
    square.data.color_attributes.active_color = attribute
    scene.cycles.samples = 200
    bpy.context.view_layer.update()
    for item in bpy.context.view_layer.objects:
        item.select_set(item == square)
    bpy.context.view_layer.objects.active = square
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, target="VERTEX_COLORS")
    top = max(square.data.polygons, key=lambda face: face.normal.z)
    colours = [square.data.attributes["Bake"].data[i].color[:3] for i in top.loop_indices]
    bpy.data.objects.remove(square)
    return np.mean(colours, axis=0) * np.pi


def test_constant_cones_are_constant_light():
    _, on_ball = ball_directions(32 * 8)
    share = on_ball.reshape(32, 8, 32, 8).mean(axis=(1, 3))
    [light] = lights_of_cones([np.repeat(share[..., None], 3, axis=-1).astype(np.float32)])
    np.testing.assert_allclose(light[0], np.sqrt(4 * np.pi), rtol=5e-3)
    assert (np.sign(cone_factors()) == [1, -1, -1, -1, 1, 1, 1, 1, 1]).all() and abs(cone_factors()).min() > 0.5


def test_means_of_cones_that_are_known_are_those_of_all_pictures_anew():
    pictures, known = list(np.random.default_rng(0).random((5, 16, 16, 3), np.float32)), {}
    for n in range(1, 6):
        again = lights_of_cones(pictures[:n], known)
        assert again.tobytes() == lights_of_cones(pictures[:n]).tobytes()


def test_what_was_measured_comes_back_from_json():
    rng = np.random.default_rng(0)
    light = MeasuredLight(rng.normal(size=(9, 3)), rng.normal(size=(9, 3)), 0.1, None, 4, 16)
    again = from_json(MeasuredLight, as_json(light))
    assert again.ldr.tobytes() == light.ldr.tobytes() and again.hdr.tobytes() == light.hdr.tobytes()
    assert (again.ldr_noise, again.hdr_noise, again.ldr_samples, again.hdr_samples) == (0.1, None, 4, 16)


@pytest.mark.slow
def test_a_tighter_target_takes_more_pictures_and_ends_at_the_most():
    scene = room_with_a_virtual_sphere()
    samples = []
    for target in (0.5, 0.031, 1e-6):
        with open_reference_probe(scene, [(0, 0, 0.85)], ProbeSettings(48, 12, target)) as probe:
            light = probe.light_at(0, 1).measured
        samples.append(light.ldr_samples)
        # What is white is judged anew in the end, which changes the noise a little.
        assert light.ldr_noise <= 1.2 * target or light.ldr_samples == 12
    assert samples[0] == 6 < samples[1] < samples[2] == 12


def test_a_run_whose_target_is_all_of_the_light_takes_the_fewest_pictures_of_clipped_light():
    scene, lights = room_with_a_virtual_sphere(), {}
    for target in ("hdr", "ldr"):
        settings = replace(PrevisSettings(target=target).reference, size=24, max_samples=7, noise_target=None)
        with open_reference_probe(scene, [(0, 0, 0.85)], settings) as probe:
            lights[target] = probe.light_at(0, 1).measured
    assert [light.ldr_samples for light in lights.values()] == [6, 7]
    assert lights["hdr"].hdr_samples == 7 and np.array_equal(lights["hdr"].hdr, lights["ldr"].hdr)


@pytest.mark.parametrize(("target", "side"), [("ldr", -1), ("hdr", 1)], ids=["clipped, below", "whole, above"])
def test_a_bumpy_surface_beyond_the_rim_is_not_black(target, side):
    """Cycles shades bumps by the rays of neighbouring pixels, and on the rim of a mirror ball there are none."""
    scene = dark_scene()
    add_lamp(scene, "SUN", np.array([0.0, 0.6, -0.8 * side]), energy=1.0)
    settings = ProbeSettings(64, 6, noise_target=None)
    sun = measured(scene, settings).of(target)
    surface = shader_look("Surface", "BsdfPrincipled")
    bpy.ops.mesh.primitive_plane_add(size=4.0, location=POSITION + (0, 0, 0.1 * side))
    bpy.context.object.data.materials.append(surface)
    smooth = measured(scene, settings).of(target)
    tree = surface.node_tree
    bump = shader_node(tree, "Bump", Strength=0.1)
    tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[0], bump.inputs["Height"])
    tree.links.new(bump.outputs[0], tree.nodes["Principled BSDF"].inputs["Normal"])
    bumpy = measured(scene, settings).of(target)
    assert 0 < np.linalg.norm(bumpy - smooth) < 0.03 * np.linalg.norm(smooth - sun)
