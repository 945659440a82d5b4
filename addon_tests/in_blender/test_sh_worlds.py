"""An SH world lights surfaces as the mathematics says, on the timeline as well, and what a live session places."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from effect_scenes import shader_look
from renders import captured, rendered, rendered_sphere
from shown_lights import keyed, shown_light
from tiny_scenes import (
    add_lamp,
    box,
    empty_scene,
    material,
    node_of,
    orthographic,
    room_with_a_virtual_sphere,
    set_world,
    sphere,
)

from addon_tests.pure.made import constant
from xihe_blender.apply.datablocks import NODE_GROUP_NAME, lights_by_sh, world_name
from xihe_blender.apply.session import XiheController
from xihe_blender.apply.sh_worlds import (
    apply_sh_to_world,
    f_curves,
    key_light_changes,
    make_sh_world,
    mark_trigger,
    remove_applied_light,
    remove_trigger_markers,
)
from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe
from xihe_blender.capture.render import RenderSettings, exclude_collection, render_passes, working_scene
from xihe_blender.capture.scanner import first_layer
from xihe_blender.compare.methods import composite, open_comparer
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet import estimators, sh
from xihenet.backend import LocalBackend
from xihenet.light.light_picture import SILVER_ROUGHNESS, sphere_mask, three_spheres
from xihenet.mirror_ball import ball_directions
from xihenet.records import Intrinsics, RgbdFrame

SIDE = 48


def white():
    return material("White", (1.0, 1.0, 1.0))


def sphere_under(coefficients, exposure=1.0, look=white):
    """The scene of a sphere of radius 1 under this light."""
    scene = empty_scene()
    sphere(scene, "Ball", (0, 0, 0), 1.0, look())
    scene.world = make_sh_world("Xihe Ball")
    apply_sh_to_world(scene.world, coefficients, exposure)
    return scene


def test_radiance_that_is_negative_in_places_is_not_clamped():
    coefficients = np.random.default_rng(0).normal(size=(9, 3)) * 0.3
    coefficients[0] = 1.0
    shown, normals = rendered_sphere(sphere_under(coefficients), 128)
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    negative = (sh.basis(directions) @ coefficients < 0).mean()
    assert negative > 0.05
    expected = sh.irradiance(coefficients, normals) / np.pi
    assert np.abs(shown.mean(axis=0) - expected.mean(axis=0)).max() < 0.005 * expected.mean()


def test_what_a_mirror_shows_of_a_world_has_its_coefficients_and_is_negative_where_they_are():
    scene, coefficients = empty_scene(), np.random.default_rng(0).normal(size=(9, 3))
    coefficients[6] = 3.0
    scene.world = make_sh_world("Xihe Ball")
    apply_sh_to_world(scene.world, 2 * coefficients, exposure=2.0)
    with open_reference_probe(scene, [(0, 0, 0)], ProbeSettings(48, 8, denoise=False)) as probe:
        ball, _ = probe.mirror_ball(0, 1)
    directions, on_ball = ball_directions(48)
    inner = on_ball & (directions[..., 2] > -0.8)
    found, *_ = np.linalg.lstsq(sh.basis(directions[inner]), ball[inner], rcond=None)
    np.testing.assert_allclose(found, coefficients, atol=0.015)
    assert ball[inner].min() < -0.5


def test_constant_light_is_constant_and_the_exposure_it_carries_is_taken_out_once():
    plain, _ = rendered_sphere(sphere_under(constant([0.2, 0.5, 3.0])), 128)
    np.testing.assert_allclose(plain.mean(axis=0), [0.2, 0.5, 3.0], rtol=2e-3)
    exposed, _ = rendered_sphere(sphere_under(5 * constant([0.2, 0.5, 3.0]), exposure=5.0), 128)
    np.testing.assert_allclose(exposed, plain, rtol=1e-4)


def test_keyed_light_plays_back_frame_by_frame_and_does_not_blend():
    scene = empty_scene()
    world = make_sh_world("Xihe Ball")
    light = {frame: np.full((9, 3), float(frame)) for frame in (1, 5, 9)}
    key_light_changes(world, light, exposure=2.0)
    scene.world = world
    assert keyed(world)[1] == {"CONSTANT"}
    for frame, expected in ((1, 1), (4, 1), (5, 5), (8, 5), (9, 9), (20, 9)):
        scene.frame_set(frame)
        coefficients, gain = shown_light(world)
        assert (coefficients == expected).all() and gain == 0.5


def test_a_keyed_world_override_is_evaluated_in_each_frame():
    scene = empty_scene()
    set_world(scene, (1, 0, 0))
    sphere(scene, "Ball", (0, 0, 0), 1.0, material("White", (1, 1, 1)), virtual_collection(scene, create=True))
    orthographic(scene)
    world = make_sh_world(world_name("Ball"))
    key_light_changes(world, {frame: constant(np.eye(3)[frame]) for frame in (1, 2)})
    with working_scene(scene, "Test", RenderSettings((16, 16), 16, denoise=False)) as working:
        working.view_layers[0].world_override = world
        for frame in (1, 2):
            working.frame_set(frame)
            middle = first_layer(render_passes(working))[0][8, 8]
            assert middle[frame] == pytest.approx(1.0, rel=0.05) and middle[3 - frame] == 0 and middle[0] == 0


def test_each_method_lights_each_object_with_its_own_light():
    scene = empty_scene()
    virtual = virtual_collection(scene, create=True)
    objects = [sphere(scene, n, (x, 0, 0), 0.4, material(n, (1, 1, 1)), virtual) for n, x in (("A", -0.5), ("B", 0.5))]
    orthographic(scene)
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


def add_what_the_run_is_not_of(scene, collection):
    add_lamp(scene, location=(0, 0, 1), energy=1000.0, collection=collection)
    sphere(scene, "In front", (0, 0, 1), 0.4, material("Glow", emission=5.0), collection)


CHANGES = {
    "hidden in renders": lambda _, virtual: setattr(virtual, "hide_render", True),
    "left out of the layer": lambda scene, virtual: exclude_collection(scene.view_layers[0].layer_collection, virtual),
    "held out": lambda scene, _: setattr(scene.view_layers[0].layer_collection.children[0], "holdout", True),
    "more than the run is of": add_what_the_run_is_not_of,
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_the_ground_truth_shows_the_objects_of_the_run_and_no_others(change):
    pictures = []
    for has_changed in (False, True):
        scene = empty_scene()
        set_world(scene, (1.0, 1.0, 1.0))
        virtual = virtual_collection(scene, create=True)
        ball = sphere(scene, "Ball", (0, 0, 0), 0.4, material("Ball", (0.2, 0.2, 0.2)), virtual)
        orthographic(scene)
        if has_changed:
            change(scene, virtual)
        with open_comparer(scene, [ball], ["one"], RenderSettings((32, 32), 16, denoise=False)) as comparer:
            pictures.append(comparer.render_ground_truth(1).radiance)
    np.testing.assert_array_equal(*pictures)
    assert pictures[0].min() < 0.3 < 0.9 < pictures[0].max()


def test_a_comparison_takes_all_that_it_made_with_it():
    scene = empty_scene()
    ball = sphere(scene, "Ball", (0, 0, 0), 0.4, None, virtual_collection(scene, create=True))
    orthographic(scene)
    before = set(bpy.data.user_map())
    with open_comparer(scene, [ball], ["one"], RenderSettings((8, 8), 1, denoise=False), has_key_light=True):
        pass
    assert set(bpy.data.user_map()) == before


@pytest.mark.parametrize("wall_m", [1.5, 10.0])
def test_an_object_behind_a_wall_leaves_no_rim_and_one_before_it_keeps_its_own(wall_m):
    scene = empty_scene()
    virtual = virtual_collection(scene, create=True)
    ball = sphere(scene, "Ball", (0, 0, 0), 0.4, material("Ball", (1, 1, 1)), virtual)
    orthographic(scene)
    with open_comparer(scene, [ball], ["one"], RenderSettings((32, 32), 16, denoise=False)) as comparer:
        apply_sh_to_world(comparer.worlds["one", "Ball"], constant(5.0))
        passes = render_passes(comparer.lit).layers[comparer.layers["one", "Ball"]]
    alpha = passes["Combined.A"]
    is_rim = (alpha > 0) & (passes["Depth.Z"] >= 1e9)
    assert is_rim.sum() > 4
    grey, camera = np.zeros((32, 32, 3), np.uint8), Intrinsics(32, 32, 32.0, 32.0, 16.0, 16.0)
    room = RgbdFrame(grey, np.full((32, 32), wall_m), camera, np.eye(4))
    picture, weights = composite(np.full((32, 32, 3), 0.1), [passes], room)
    if passes["Depth.Z"].min() > wall_m:
        assert (picture == 0.1).all() and not weights.any()
    else:
        np.testing.assert_array_equal(weights, alpha)


def test_see_through_objects_before_each_other_do_not_take_more_than_all_of_the_background():
    scene = empty_scene()
    virtual = virtual_collection(scene, create=True)
    see_through = shader_look("See-through", "BsdfPrincipled", Alpha=0.4)
    balls = [sphere(scene, f"Ball {y}", (0, y, 0), 0.4, see_through, virtual) for y in range(4)]
    orthographic(scene)
    with open_comparer(scene, balls, ["one"], RenderSettings((8, 8), 16, denoise=False)) as comparer:
        rendered = render_passes(comparer.lit).layers
        layers = [rendered[comparer.layers["one", ball.name]] for ball in balls]
    camera = Intrinsics(8, 8, 8.0, 8.0, 4.0, 4.0)
    room = RgbdFrame(np.zeros((8, 8, 3), np.uint8), np.full((8, 8), 100.0), camera, np.eye(4))
    picture, weights = composite(np.full((8, 8, 3), 5.0), layers, room)
    assert picture.min() >= 0 and weights[4, 4] > 0.9
    missed = replace(room, plane_depth_m=np.full((8, 8), np.finfo(np.float32).max))
    np.testing.assert_array_equal(composite(np.zeros((8, 8, 3)), layers, missed)[1], weights)


def test_removing_takes_worlds_node_group_and_markers_and_leaves_the_users():
    scene = empty_scene()
    mine = set_world(scene)
    marker = scene.timeline_markers.new("Act two", frame=7)
    make_sh_world("Xihe Ball")
    for frame in (5, 3, 3):
        mark_trigger(scene, frame, ["first", "colour", "first"])
    ours = sorted((m.frame, m.name) for m in scene.timeline_markers if m != marker)
    assert ours == [(frame, "Xihe trigger (colour, first)") for frame in (3, 5)]
    assert [m for m in scene.timeline_markers if m.select] == [marker], "what is moved with the user's own is not ours"
    remove_applied_light()
    remove_trigger_markers(scene)
    assert list(bpy.data.worlds) == [mine] and not bpy.data.node_groups
    assert list(scene.timeline_markers) == [marker]


def test_making_a_world_again_starts_it_anew():
    empty_scene()
    key_light_changes(make_sh_world("Xihe Ball"), {1: np.ones((9, 3))})
    again = make_sh_world("Xihe Ball")
    assert len([w for w in bpy.data.worlds if w.name.startswith("Xihe Ball")]) == 1
    assert f_curves(again.node_tree) == [] and lights_by_sh(again)
    assert len([g for g in bpy.data.node_groups if g.name.startswith(NODE_GROUP_NAME)]) == 1


@pytest.mark.parametrize(
    ("coefficients", "exposure"),
    [(np.ones((9, 4)), 1.0), (np.full((9, 3), np.nan), 1.0), (np.ones((9, 3)), 0.0), (np.ones((9, 3)), np.inf)],
)
def test_light_that_makes_no_sense_and_a_world_that_is_not_ours_are_refused(coefficients, exposure):
    empty_scene()
    with pytest.raises(ValueError, match="expected"):
        apply_sh_to_world(make_sh_world("Xihe Ball"), coefficients, exposure)
    with pytest.raises(ValueError, match="make it with make_sh_world"):
        apply_sh_to_world(set_world(bpy.context.scene), np.ones((9, 3)))
    with pytest.raises(ValueError, match="make it with make_sh_world"):
        apply_sh_to_world(bpy.data.worlds.new("Without nodes"), np.ones((9, 3)))


def test_light_is_rid_of_what_is_negative_only_if_asked_for():
    empty_scene()
    world, light = make_sh_world("Xihe Ball"), np.random.default_rng(0).normal(size=(9, 3))
    light[0] = np.abs(light[0])
    shown = sh.dering_for_display(light)
    assert not np.array_equal(shown, light)
    for is_deringed, expected in ((False, light), (True, shown)):
        apply_sh_to_world(world, light, is_deringed=is_deringed)
        np.testing.assert_allclose(shown_light(world)[0], expected, rtol=1e-6, atol=1e-8)


def metal(roughness):
    """Reflects all light, without a tint."""
    made = shader_look("Metal", "BsdfAnisotropic", Color=(1, 1, 1, 1), Roughness=roughness)
    node_of(made, "BSDF_GLOSSY").distribution = "MULTI_GGX"
    return made


@pytest.mark.parametrize(
    ("index", "look", "tolerance"),
    [
        (0, lambda: metal(0.0), 0.006),
        (1, lambda: metal(SILVER_ROUGHNESS), 0.015),
        (2, white, 0.01),
    ],
    ids=["mirror", "matte silver", "grey diffuse"],
)
def test_the_pictured_sphere_is_the_one_that_cycles_renders(index, look, tolerance):
    coefficients = np.random.default_rng(0).normal(size=(9, 3)) * 0.3
    coefficients[0] += 3
    expected = three_spheres(coefficients, SIDE)[index]
    # The rim, where a pixel mixes sphere and background and the lobe of a rough metal stretches, is left out.
    x = (2 * np.arange(SIDE) + 1) / SIDE - 1
    inner = sphere_mask(SIDE) & (x[None] ** 2 + x[:, None] ** 2 < 0.8)
    scene = sphere_under(coefficients, look=look)
    orthographic(scene)
    shown = rendered(scene, (SIDE, SIDE), 128)
    error = np.sqrt(np.mean((shown - expected)[inner] ** 2)) / expected[inner].mean()
    assert error < tolerance


def session():
    return XiheController(LocalBackend(estimators.load("projection", 320)))


def test_a_placed_object_is_lit_by_the_estimate_at_its_position():
    scene = room_with_a_virtual_sphere()
    controller, frame, ball = session(), captured(scene, samples=4), bpy.data.objects["Ball"]
    controller.step(frame)
    estimate = controller.place_and_estimate_at(ball, (0.3, 0.1, 0.9))
    np.testing.assert_allclose(ball.matrix_world.translation, (0.3, 0.1, 0.9), atol=1e-6)
    np.testing.assert_allclose(estimate.sh_radiance, controller.estimate_at((0.3, 0.1, 0.9)).sh_radiance, atol=1e-6)
    coefficients, gain = shown_light(bpy.data.worlds["Xihe Ball"])
    np.testing.assert_allclose(coefficients, estimate.sh_radiance, rtol=1e-5)
    assert gain == pytest.approx(1 / estimate.exposure)
    assert "Ball" in controller.step(frame)


def test_a_world_to_be_looked_at_leaves_the_estimate_as_it_is(monkeypatch):
    scene = room_with_a_virtual_sphere()
    controller = session()
    controller.step(captured(scene, samples=4))
    light = np.vstack([np.ones((1, 3)), np.full((8, 3), 0.9)])
    monkeypatch.setattr(controller.backend.estimator, "estimate", lambda *_: light)
    estimate = controller.place_and_estimate_at(bpy.data.objects["Ball"], (0.3, 0.1, 0.9), is_deringed=True)
    np.testing.assert_array_equal(estimate.sh_radiance, light)
    np.testing.assert_allclose(shown_light(bpy.data.worlds["Xihe Ball"])[0], sh.dering_for_display(light), rtol=1e-6)


def test_an_object_of_the_users_becomes_a_virtual_one_and_a_big_one_gets_several_positions():
    scene = room_with_a_virtual_sphere()
    controller = session()
    controller.step(captured(scene, samples=4))
    shelf = box(scene, "Shelf", (0, 0, 0), (2.5, 0.2, 0.2))
    estimate = controller.place_and_estimate_at(shelf, (0, 0.2, 1.0))
    assert shelf in virtual_objects(scene) and estimate.is_valid
    assert {name for name in controller.positions if name.startswith("Shelf")} == {"Shelf 1", "Shelf 2", "Shelf 3"}


@pytest.mark.parametrize(
    ("place", "words"),
    [((0, 0, 1), "no frame yet"), ((0, 0), "three finite numbers"), ((0, 0, np.inf), "three finite numbers")],
)
def test_placing_before_the_first_frame_or_at_no_point_is_refused(place, words):
    room_with_a_virtual_sphere()
    with pytest.raises(ValueError, match=words):
        session().place_and_estimate_at(bpy.data.objects["Ball"], place)
