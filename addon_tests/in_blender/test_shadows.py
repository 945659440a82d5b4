"""Shadows on what the phone has seen of the room, beside the same scene path-traced with its real floor."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Vector
from tiny_scenes import add_lamp, box, empty_scene, material, phone, set_world, sphere

from xihe_blender.apply.datablocks import has_anything
from xihe_blender.apply.shadow_catchers import make_shadow_catcher, remove_shadow_catchers, shadow_catchers
from xihe_blender.capture.render import RenderSettings, render_only_part, render_passes
from xihe_blender.capture.scanner import open_scanner
from xihe_blender.compare.methods import open_comparer
from xihe_blender.compare.shadows import ring_around, ring_rmse
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.camera import valid_plane_depth
from xihenet.light.key_light import sh_of_key_light
from xihenet.records import KeyLight, ObjectLight

SETTINGS = RenderSettings((64, 48), 32)
TOWARDS_SUN = np.array([0.6, -0.2, 0.75]) / np.linalg.norm([0.6, -0.2, 0.75])
SKY, SUN = 0.2, 2.0
FLAT = np.sqrt(4 * np.pi) * SKY * np.eye(9)[0][:, None] * np.ones(3)


def sunlit(height_m=0.2, wall=False):
    """A grey floor under sun and sky, and a white ball of 0.2 m, its middle `height_m` above it; the phone from -Y."""
    scene = empty_scene()
    set_world(scene, (SKY,) * 3)
    sun = add_lamp(scene, "SUN", energy=SUN, angle=0.1)
    sun.rotation_mode, sun.rotation_quaternion = "QUATERNION", Vector(TOWARDS_SUN).to_track_quat("Z", "Y")
    box(scene, "Floor", (0, 0, -0.05), (8, 8, 0.1), material("Grey", (0.3, 0.3, 0.3)))
    if wall:
        box(scene, "Wall", (-0.35, 0, 0.5), (0.1, 4, 1.0), material("Wall", (0.3, 0.3, 0.3)))
    virtual = virtual_collection(scene, create=True)
    ball = sphere(scene, "Ball", (0, 0, height_m), 0.2, material("White", (0.5, 0.5, 0.5)), virtual)
    phone(scene, (0, -1.8, 1.1), (0, 0, 0.15))
    return scene, ball


def light(exposure):
    key = KeyLight(TOWARDS_SUN, np.full(3, SUN * exposure), 0.05, True)
    return ObjectLight(FLAT * exposure + sh_of_key_light(key), key)


def compared(scene, balls, *, has_surfaces=True, blurred=0.0, settings=SETTINGS):
    with open_scanner(scene, settings) as scanner:
        scanner.move_to(1)
        captured = scanner.acquire_environment_scan()
    noise = np.random.default_rng(0).normal(size=captured.plane_depth_m.shape) * blurred
    captured = replace(captured, plane_depth_m=(captured.plane_depth_m * (1 + noise)).astype(np.float32))
    with open_comparer(scene, balls, ["one"], settings, has_key_light=True) as comparer:
        found = comparer.surfaces_around_objects([captured], 1) if has_surfaces else {}
        truth = comparer.render_ground_truth(1)
        result = comparer.render_methods(
            captured, {"one": {item.name: light(captured.exposure) for item in balls}}, truth, found
        )
    return result, found.get("Ball", [])


@pytest.mark.parametrize(("wall", "blurred"), [(False, 0.0), (True, 0.0), (False, 0.004)])
def test_shadow_is_that_of_the_real_floor(wall, blurred):
    scene, ball = sunlit(wall=wall)
    with_shadow, surfaces = compared(scene, [ball], blurred=blurred)
    without, _ = compared(scene, [ball], has_surfaces=False)
    assert len(surfaces) == 1 + wall and surfaces[0].normal[2] == pytest.approx(1.0, abs=0.01)
    left = ring_rmse(with_shadow.methods["one"], with_shadow.ground_truth, with_shadow.ring)
    all_of_it = ring_rmse(without.methods["one"], without.ground_truth, without.ring)
    assert all_of_it > 0.03 and left < 0.3 * all_of_it
    # Away from the sun, which is on the right.
    darker = (without.methods["one"] - with_shadow.methods["one"]).mean(axis=-1) * with_shadow.ring
    columns = darker.clip(0).sum(axis=0)
    assert columns[:32].sum() > 3 * columns[32:].sum()


@pytest.mark.slow
def test_two_balls_beside_each_other_cast_no_shadow_twice():
    scene, ball = sunlit()
    virtual = virtual_collection(scene)
    other = sphere(scene, "Other", (-0.45, 0.1, 0.2), 0.2, material("White", (0.5, 0.5, 0.5)), virtual)
    bpy.context.view_layer.update()
    with_shadow, _ = compared(scene, [ball, other])
    without, _ = compared(scene, [ball, other], has_surfaces=False)
    left = ring_rmse(with_shadow.methods["one"], with_shadow.ground_truth, with_shadow.ring)
    all_of_it = ring_rmse(without.methods["one"], without.ground_truth, without.ring)
    assert all_of_it > 0.03 and left < 0.2 * all_of_it


@pytest.mark.slow
def test_ball_is_lit_as_without_a_catcher():
    scene, ball = sunlit()
    settings = replace(SETTINGS, samples=64)
    with_shadow, _ = compared(scene, [ball], settings=settings)
    without, _ = compared(scene, [ball], has_surfaces=False, settings=settings)
    inside = with_shadow.weights > 0.99
    assert inside.sum() > 60
    difference = (with_shadow.methods["one"] - without.methods["one"])[inside]
    assert np.abs(difference).mean() < 0.01 * without.methods["one"][inside].mean()


def test_fog_has_no_holes_where_the_floor_is_seen_through_it():
    scene, ball = sunlit()
    tree = ball.data.materials[0].node_tree
    tree.nodes.clear()
    fog, output = tree.nodes.new("ShaderNodeVolumeScatter"), tree.nodes.new("ShaderNodeOutputMaterial")
    fog.inputs["Density"].default_value = 9
    tree.links.new(fog.outputs[0], output.inputs["Volume"])
    over_a_catcher, surfaces = compared(scene, [ball], blurred=0.01)
    alone, _ = compared(scene, [ball], has_surfaces=False)
    # Where it is thinner, none of a pixel's few rays may meet it.
    is_fog = alone.weights > 0.2
    assert surfaces and is_fog.sum() > 200
    assert (over_a_catcher.weights[is_fog] > 0).all()
    np.testing.assert_allclose(over_a_catcher.weights.sum(), alone.weights.sum(), rtol=0.02)


def test_nothing_is_around_a_ball_high_in_the_air_and_nothing_is_left_in_the_file():
    scene, ball = sunlit(height_m=2.5)
    phone(scene, (0, -1.8, 2.2), (0, 0, 2.5))
    result, surfaces = compared(scene, [ball])
    assert surfaces == [] and result.ring.any()
    assert not shadow_catchers() and not has_anything(scene)
    assert not [mesh for mesh in bpy.data.meshes if mesh.name.startswith("Xihe")]


@pytest.mark.parametrize(
    ("looks_at", "f_stop", "has_surfaces"),
    [
        ((0, 0, 0.15), None, True),
        ((0, 0, 0.15), None, False),
        ((0, 0, 0.15), 0.1, False),
        ((-2.5, 0, 0.15), None, False),
    ],
)
def test_a_part_of_the_picture_is_rendered_and_is_as_in_the_whole_one(looks_at, f_stop, has_surfaces):
    scene, ball = sunlit()
    phone(scene, (0, -1.8, 1.1), looks_at)
    depth_of_field = scene.camera.data.dof
    depth_of_field.use_dof, depth_of_field.focus_distance = f_stop is not None, 0.3
    depth_of_field.aperture_fstop = f_stop or 1.0
    settings = replace(SETTINGS, size=(150, 110), samples=4, denoise=False)
    with open_scanner(scene, settings) as scanner:
        scanner.move_to(1)
        captured = scanner.acquire_environment_scan()
    with open_comparer(scene, [ball], ["one"], settings, has_key_light=True) as comparer:
        found = comparer.surfaces_around_objects([captured], 1) if has_surfaces else {}
        part = comparer.render_layers(captured, {"one": {"Ball": light(captured.exposure)}}, found).passes
        # A ball that is blurred beyond the part is rendered as a whole.
        render = comparer.lit.render
        assert render.use_border == (f_stop is None)
        assert not render.use_border or render.border_max_y - render.border_min_y < 0.9
        render.use_persistent_data = False
        render_only_part(comparer.lit, None)
        whole = render_passes(comparer.lit).passes
    np.testing.assert_array_equal(part["Combined.A"], whole["Combined.A"])
    is_near = valid_plane_depth(whole["Depth.Z"])
    np.testing.assert_array_equal(valid_plane_depth(part["Depth.Z"]), is_near)
    is_hit = is_near | (whole["Combined.A"] > 0)
    assert is_hit.any() == (looks_at[0] == 0)
    for name, pixels in whole.items():
        np.testing.assert_array_equal(part[name][is_hit], pixels[is_hit], err_msg=name)


def test_a_catcher_of_ours_is_found_and_removed():
    empty_scene()
    catcher = make_shadow_catcher("Xihe Shadow Ball")
    assert shadow_catchers() == [catcher]
    remove_shadow_catchers([catcher])
    assert not shadow_catchers() and not bpy.data.meshes and not bpy.data.materials


def test_ring_is_near_the_objects_and_none_of_them():
    weights = np.zeros((40, 60))
    weights[10:20, 20:30] = 1.0
    weights[10, 20] = 0.01
    ring = ring_around(weights)
    assert not ring[weights > 0].any()
    rows, columns = np.nonzero(ring)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (5, 24, 15, 34)
    assert ring.sum() == 20 * 20 - 100
    assert not ring_around(np.zeros((4, 4))).any()
    assert ring_rmse(np.ones((4, 4, 3)), np.zeros((4, 4, 3)), np.zeros((4, 4), bool)) is None


def test_ring_error_is_that_of_what_a_display_shows():
    ring = np.ones((2, 2), bool)
    assert ring_rmse(np.full((2, 2, 3), 5.0), np.full((2, 2, 3), 3.0), ring) == 0.0
    assert ring_rmse(np.full((2, 2, 3), 0.5), np.full((2, 2, 3), 0.3), ring) == pytest.approx(0.2)
