"""An SH world lights a surface as the mathematics says, and plays on the timeline."""

import bpy
import numpy as np
import pytest
from mathutils import Vector
from tiny_scenes import empty_scene, material, set_world, sphere

from xihe_blender.apply.datablocks import NODE_GROUP_NAME, lights_by_sh
from xihe_blender.apply.sh_worlds import (
    COEFFICIENTS,
    GAIN,
    apply_sh_to_world,
    f_curves,
    key_sh_on_world,
    make_sh_world,
    mark_trigger,
    remove_applied_light,
    world_name,
)
from xihe_blender.capture.render import RenderSettings, render_passes, working_scene
from xihe_blender.capture.scanner import first_layer
from xihe_blender.compare.methods import open_comparer
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet import sh

SIDE = 48


def constant(radiance):
    """(9, 3) coefficients of light that is the same from everywhere."""
    coefficients = np.zeros((9, 3))
    coefficients[0] = 2 * np.sqrt(np.pi) * np.asarray(radiance)
    return coefficients


def white_sphere_seen_from(scene, axis):
    """A white Lambert sphere filling an orthographic picture; its normals where it is not at a grazing angle."""
    sphere(scene, "White", (0, 0, 0), 1.0, material("White", (1.0, 1.0, 1.0)))
    data = bpy.data.cameras.new("Camera")
    data.type, data.ortho_scale = "ORTHO", 2.2
    camera = bpy.data.objects.new("Camera", data)
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.location = np.array(axis) * 5.0
    rotation = (-Vector(axis)).to_track_quat("-Z", "Y")
    camera.rotation_euler = rotation.to_euler()
    x = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * 2.2
    right, up = np.meshgrid(x, -x)
    inside = right**2 + up**2 < 0.85
    in_camera = np.stack([right, up, np.sqrt(np.clip(1 - right**2 - up**2, 0, 1))], axis=-1)[inside]
    return in_camera @ np.array(rotation.to_matrix()).T, inside


def rendered_sphere(coefficients, exposure=1.0, axis=(0, -1, 0), samples=128):
    scene = empty_scene()
    normals, inside = white_sphere_seen_from(scene, axis)
    world = make_sh_world("Xihe White")
    apply_sh_to_world(world, coefficients, exposure)
    scene.world = world
    with working_scene(scene, "Test", RenderSettings((SIDE, SIDE), samples, denoise=False)) as working:
        radiance, _ = first_layer(render_passes(working))
    return radiance[inside].astype(np.float64), normals


@pytest.mark.parametrize(("seed", "axis"), [(0, (0, -1, 0)), (1, (1, 0, 0)), (2, (0, 0, 1))])
def test_a_white_sphere_shows_the_analytic_irradiance(seed, axis):
    coefficients = np.random.default_rng(seed).normal(size=(9, 3)) * 0.15
    coefficients[0] += 1.5
    shown, normals = rendered_sphere(coefficients, axis=axis)
    expected = sh.irradiance(coefficients, normals) / np.pi
    assert np.abs(shown.mean(axis=0) / expected.mean(axis=0) - 1).max() < 0.005
    assert np.abs(shown - expected).max() < 0.05 * expected.mean()


def test_radiance_that_is_negative_in_places_is_not_clamped():
    coefficients = np.random.default_rng(0).normal(size=(9, 3)) * 0.3
    coefficients[0] = 1.0
    shown, normals = rendered_sphere(coefficients, samples=512)
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    negative = (sh.basis(directions) @ coefficients < 0).mean()
    assert negative > 0.05
    expected = sh.irradiance(coefficients, normals) / np.pi
    assert np.abs(shown.mean(axis=0) - expected.mean(axis=0)).max() < 0.005 * expected.mean()


def test_constant_light_is_constant_and_the_exposure_it_carries_is_taken_out_once():
    plain, _ = rendered_sphere(constant([0.2, 0.5, 3.0]))
    np.testing.assert_allclose(plain.mean(axis=0), [0.2, 0.5, 3.0], rtol=2e-3)
    exposed, _ = rendered_sphere(5 * constant([0.2, 0.5, 3.0]), exposure=5.0)
    np.testing.assert_allclose(exposed, plain, rtol=1e-4)


def test_keyed_light_plays_back_frame_by_frame_and_does_not_blend():
    scene = empty_scene()
    world = make_sh_world("Xihe Ball")
    light = {frame: np.full((9, 3), float(frame)) for frame in (1, 5, 9)}
    for frame, coefficients in light.items():
        key_sh_on_world(world, frame, coefficients, exposure=2.0)
    scene.world = world
    assert {point.interpolation for curve in f_curves(world.node_tree) for point in curve.keyframe_points} == {
        "CONSTANT"
    }
    inputs = world.node_tree.nodes[NODE_GROUP_NAME].inputs
    for frame, expected in ((1, 1), (4, 1), (5, 5), (8, 5), (9, 9), (20, 9)):
        scene.frame_set(frame)
        assert [tuple(inputs[name].default_value) for name in COEFFICIENTS] == [(expected,) * 3] * 9
        assert inputs[GAIN].default_value == 0.5


def test_a_keyed_world_override_is_evaluated_in_each_frame():
    scene = empty_scene()
    set_world(scene, (1, 0, 0))
    ball = sphere(scene, "Ball", (0, 0, 0), 1.0, material("White", (1, 1, 1)), virtual_collection(scene, create=True))
    white_sphere_seen_from(scene, (0, -1, 0))
    bpy.data.objects.remove(bpy.data.objects["White"])
    world = make_sh_world(world_name("Ball"))
    for frame in (1, 2):
        key_sh_on_world(world, frame, constant(np.eye(3)[frame]))
    with working_scene(scene, "Test", RenderSettings((16, 16), 16, denoise=False)) as working:
        working.view_layers[0].world_override = world
        for frame in (1, 2):
            working.frame_set(frame)
            middle = first_layer(render_passes(working))[0][8, 8]
            assert middle[frame] == pytest.approx(1.0, rel=0.05) and middle[3 - frame] == 0 and middle[0] == 0
    assert ball.name in bpy.data.objects


def test_each_method_lights_each_object_with_its_own_light():
    scene = empty_scene()
    virtual = virtual_collection(scene, create=True)
    objects = [sphere(scene, n, (x, 0, 0), 0.4, material(n, (1, 1, 1)), virtual) for n, x in (("A", -0.5), ("B", 0.5))]
    white_sphere_seen_from(scene, (0, -1, 0))
    bpy.data.objects.remove(bpy.data.objects["White"])

    level = {("one", "A"): 1.0, ("one", "B"): 10.0, ("two", "A"): 2.0, ("two", "B"): 20.0}
    with open_comparer(scene, objects, ["one", "two"], RenderSettings((32, 32), 16, denoise=False)) as comparer:
        for key, world in comparer.worlds.items():
            apply_sh_to_world(world, constant(level[key]))
        layers = render_passes(comparer.lit).layers
    for (method, name), layer in comparer.layers.items():
        column = {"A": 8, "B": 24}[name]
        assert layers[layer]["Combined.G"][16, column] == pytest.approx(level[method, name], rel=0.05)
        assert layers[layer]["Combined.A"][16, 32 - column] == 0.0
    assert not [w for w in bpy.data.worlds if w.name.startswith("Xihe")]
    assert not [c for c in bpy.data.collections if c.name.startswith("Xihe Lit")]


def test_removing_takes_worlds_node_group_and_markers_and_leaves_the_users():
    scene = empty_scene()
    mine = set_world(scene)
    marker = scene.timeline_markers.new("Act two", frame=7)
    make_sh_world("Xihe Ball")
    mark_trigger(scene, 3, ["first", "colour", "first"])
    assert [m.name for m in scene.timeline_markers if m.frame == 3] == ["Xihe trigger (colour, first)"]
    remove_applied_light(scene)
    assert list(bpy.data.worlds) == [mine] and not bpy.data.node_groups
    assert list(scene.timeline_markers) == [marker]


def test_making_a_world_again_starts_it_anew():
    empty_scene()
    key_sh_on_world(make_sh_world("Xihe Ball"), 1, np.ones((9, 3)))
    again = make_sh_world("Xihe Ball")
    assert len([w for w in bpy.data.worlds if w.name.startswith("Xihe Ball")]) == 1
    assert f_curves(again.node_tree) == [] and lights_by_sh(again)
    assert len([g for g in bpy.data.node_groups if g.name.startswith(NODE_GROUP_NAME)]) == 1


@pytest.mark.parametrize(
    ("coefficients", "exposure"),
    [(np.ones((9, 4)), 1.0), (np.full((9, 3), np.nan), 1.0), (np.ones((9, 3)), 0.0), (np.ones((9, 3)), np.inf)],
)
def test_light_that_makes_no_sense_is_refused(coefficients, exposure):
    empty_scene()
    with pytest.raises(ValueError, match="expected"):
        apply_sh_to_world(make_sh_world("Xihe Ball"), coefficients, exposure)


def test_light_is_rid_of_what_is_negative_only_if_asked_for():
    empty_scene()
    world, light = make_sh_world("Xihe Ball"), np.random.default_rng(0).normal(size=(9, 3))
    light[0] = np.abs(light[0])
    shown = sh.dering_for_display(light)
    assert not np.array_equal(shown, light)
    for is_deringed, expected in ((False, light), (True, shown)):
        apply_sh_to_world(world, light, is_deringed=is_deringed)
        inputs = world.node_tree.nodes[NODE_GROUP_NAME].inputs
        np.testing.assert_allclose([inputs[c].default_value[:] for c in COEFFICIENTS], expected, rtol=1e-6, atol=1e-8)


def test_a_world_that_is_not_ours_is_refused():
    with pytest.raises(ValueError, match="make it with make_sh_world"):
        apply_sh_to_world(set_world(empty_scene()), np.ones((9, 3)))
