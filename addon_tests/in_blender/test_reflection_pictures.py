"""A world that gives glossy rays a picture and all others its spherical harmonics."""

from functools import partial

import bpy
import numpy as np
import pytest
from effect_scenes import shader_look
from renders import rendered
from tiny_scenes import empty_scene, material, orthographic, sphere

from addon_tests.pure import runs
from xihe_blender.apply.applied_lights import lights_of_scene
from xihe_blender.apply.datablocks import world_name
from xihe_blender.apply.key_suns import apply_key_to_sun, key_suns, make_key_sun, show_in_reflections
from xihe_blender.apply.keys import f_curves
from xihe_blender.apply.lit_timeline import NOTHING_REFLECTED, Reflected, key_object_light, light_of, reflected_of
from xihe_blender.apply.reflection_pictures import (
    PICTURE,
    forget_reflections,
    has_sun_for_lamp,
    reflect_in_world,
    reflect_on_timeline,
)
from xihe_blender.apply.sh_worlds import apply_sh_to_world, key_light_changes, make_sh_world
from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe
from xihe_blender.io.exr import write_radiance
from xihe_blender.io.run_lights import LightsAsked
from xihe_blender.io.run_results import LightChange, ReflectionsResult
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.light.environments import laid_out
from xihenet.light.reflections import reflection_panorama, without_key_light
from xihenet.mirror_ball import seen_in_ball
from xihenet.panorama import panorama_directions
from xihenet.records import KeyLight, ObjectLight, Reflections
from xihenet.sphere import AnchorLattice

SIDE = 40
FLAT = np.sqrt(4 * np.pi) * 0.2 * np.eye(9)[0][:, None] * np.ones(3)
SIDES = {"+X": (1, 0, 0), "-X": (0, 1, 0), "+Z": (0, 0, 1)}


def white():
    return material("White", (1.0, 1.0, 1.0))


def mirror():
    return metal(0.0)


def clear():
    return shader_look("Clear", "BsdfRefraction", Color=(1, 1, 1, 1), Roughness=0.0, IOR=1.0)


def metal(roughness):
    return shader_look("Metal", "BsdfGlossy", Color=(1, 1, 1, 1), Roughness=roughness)


def coloured_panorama():
    """Red from +X, green from -X, blue from above; 0.1 from elsewhere."""
    directions = panorama_directions(32, 64)
    picture = np.full((32, 64, 3), 0.1)
    for axis, sign, colour in ((0, 1, "+X"), (0, -1, "-X"), (2, 1, "+Z")):
        picture[sign * directions[..., axis] > 0.8] = SIDES[colour]
    return picture


def shown(look, exposure=1.0, samples=64):
    """A sphere seen from -Y; at 45 degrees to a side its normal turns the view there."""
    scene = empty_scene()
    sphere(scene, "Ball", (0, 0, 0), 1.0, look())
    orthographic(scene, 2.0)
    scene.world = make_sh_world("Xihe Ball")
    apply_sh_to_world(scene.world, exposure * FLAT, exposure)
    reflect_in_world(scene.world, exposure * coloured_panorama(), exposure)
    return scene, rendered(scene, (SIDE, SIDE), samples)


def at(picture, x, z):
    """Mean colour around a place on the sphere, -1 to 1."""
    column, row = round((x + 1) / 2 * SIDE), round((1 - z) / 2 * SIDE)
    return picture[row - 1 : row + 2, column - 1 : column + 2].mean(axis=(0, 1))


@pytest.mark.parametrize("exposure", [1.0, 4.0])
def test_a_mirror_shows_the_picture_from_where_it_comes(exposure):
    _, picture = shown(mirror, exposure)
    turned = np.sin(np.pi / 4)
    for place, side in (((turned, 0), "+X"), ((-turned, 0), "-X"), ((0, turned), "+Z")):
        assert at(picture, *place) == pytest.approx(SIDES[side], abs=0.03)


def test_a_matt_sphere_is_lit_by_the_spherical_harmonics_alone():
    _, picture = shown(white, samples=128)
    assert at(picture, 0, 0) == pytest.approx([0.2] * 3, rel=0.02)
    assert at(picture, 0.6, 0.3) == pytest.approx([0.2] * 3, rel=0.02)


@pytest.mark.parametrize(("look", "direction"), [(mirror, (0, -1, 0)), (clear, (0, 1, 0))], ids=["mirror", "glass"])
def test_a_mirror_or_glass_shows_no_sun_beside_a_picture_that_has_its_lamp(look, direction):
    scene, before = shown(look, samples=16)
    sun = make_key_sun("Xihe Key Light Ball")
    scene.collection.objects.link(sun)
    apply_key_to_sun(sun, KeyLight(np.array(direction, float), np.full(3, 5.0), 0.2, True))
    show_in_reflections(sun, False)
    assert rendered(scene, (SIDE, SIDE), 16) == pytest.approx(before, abs=0.02)
    show_in_reflections(sun, True)
    assert rendered(scene, (SIDE, SIDE), 16).max() > 5


@pytest.mark.slow
def test_rough_metal_under_a_sun_and_a_picture_without_its_lamp_is_as_under_all_of_the_picture():
    """By far fewer samples: a lamp in the picture is found by luck."""
    lattice, key = AnchorLattice(8192), KeyLight(np.array([0.6, -0.8, 0]), np.full(3, 2.0), 0.15, True)
    radiance = np.full((len(lattice), 3), 0.1, np.float32)
    is_lamp = lattice.directions @ key.direction > np.cos(key.angular_radius)
    radiance[is_lamp] = 2.0 / (np.pi * np.sin(key.angular_radius) ** 2)
    whole = Reflections(radiance, 1.0)
    scene, _ = shown(partial(metal, 0.33))
    assert has_sun_for_lamp(bpy.data.objects["Ball"])
    reflect_in_world(scene.world, reflection_panorama(whole))
    expected = rendered(scene, (SIDE, SIDE), 2048)[8:-8, 8:-8]
    sun = make_key_sun("Xihe Key Light Ball")
    scene.collection.objects.link(sun)
    apply_key_to_sun(sun, key)
    reflect_in_world(scene.world, reflection_panorama(without_key_light(whole, key)))
    found = rendered(scene, (SIDE, SIDE), 64)[8:-8, 8:-8]
    assert found.mean() == pytest.approx(expected.mean(), rel=0.05)
    assert np.abs(found - expected).mean() < 0.08 * expected.mean()


@pytest.mark.parametrize(("roughness", "has_sun"), [(0.0, False), (0.1, False), (0.2, True), (0.33, True)])
def test_smooth_things_reflect_the_lamp_itself(roughness, has_sun):
    scene = empty_scene()
    assert has_sun_for_lamp(sphere(scene, "Ball", (0, 0, 0), 1.0, metal(roughness))) is has_sun


def test_a_new_picture_takes_the_place_of_the_old_one():
    scene, _ = shown(mirror)
    reflect_in_world(scene.world, np.full((16, 32, 3), 0.7))
    assert at(rendered(scene, (SIDE, SIDE), 16), 0.5, 0.5) == pytest.approx([0.7] * 3, abs=0.02)
    assert [image.name for image in bpy.data.images if image.name.startswith(PICTURE)] == [f"{PICTURE} Xihe Ball"]
    forget_reflections(scene.world)
    assert not [image for image in bpy.data.images if image.name.startswith(PICTURE)]
    assert at(rendered(scene, (SIDE, SIDE), 16), 0.5, 0.5) == pytest.approx([0.2] * 3, abs=0.01)
    assert PICTURE not in scene.world.node_tree.nodes and len(scene.world.node_tree.nodes) == 3


def test_pictures_take_turns_on_the_timeline(tmp_path):
    """The second file comes first; keys are constant, and go with the picture while those of the light stay."""
    files = [tmp_path / f"0_Ball_{number:04d}.exr" for number in (1, 2)]
    for path, side in zip(files, SIDES.values(), strict=False):
        write_radiance(path, laid_out(np.broadcast_to(np.float32(side), (16, 32, 3)), "+X"))
    scene, _ = shown(mirror)
    key_light_changes(scene.world, {1: FLAT, 7: 2 * FLAT}, 1.0)
    reflect_on_timeline(scene.world, {3: files[1], 8: files[0]})
    for frame, side in ((3, SIDES["-X"]), (7, SIDES["-X"]), (8, SIDES["+X"]), (20, SIDES["+X"])):
        scene.frame_set(frame)
        assert at(rendered(scene, (SIDE, SIDE), 16), 0.5, 0.5) == pytest.approx(side, abs=0.02)
    n_curves = len(f_curves(scene.world.node_tree))
    forget_reflections(scene.world)
    assert len(f_curves(scene.world.node_tree)) == n_curves - 1 == 28
    scene.frame_set(3)
    assert at(rendered(scene, (SIDE, SIDE), 16), 0.5, 0.5) == pytest.approx([0.2] * 3, abs=0.01)


def test_the_light_of_an_object_that_reflects_is_read_back_from_its_file(tmp_path):
    """Reflections are keyed in the same nodes, at frames of their own, at which no light is."""
    write_radiance(tmp_path / "0_Ball_0001.exr", np.zeros((16, 32, 3), np.float32))
    scene = empty_scene()
    sphere(scene, "Ball", (0, 0, 0), 1.0, None, virtual_collection(scene, create=True))
    world = make_sh_world(world_name("Ball"))
    key_light_changes(world, {1: FLAT, 7: 3 * FLAT}, 0.5)
    reflect_on_timeline(world, {9: tmp_path / "0_Ball_0001.exr"})
    lights = lights_of_scene(scene, LightsAsked(everything=True))
    assert [light.frame for light in lights] == [1, 7]
    for light, factor in zip(lights, (1, 3), strict=True):
        assert light.light.sh == pytest.approx(factor * FLAT, abs=1e-6)


@pytest.mark.parametrize("has_lamp", [True, False])
def test_a_sun_is_reflected_where_no_picture_of_the_run_has_its_lamp(tmp_path, has_lamp):
    write_radiance(tmp_path / "0_Ball_0001.exr", np.zeros((16, 32, 3), np.float32))
    empty_scene()
    light = ObjectLight(FLAT, KeyLight(np.array([0, 0, 1.0]), np.full(3, 0.1), 0.2, True))
    reflected = Reflected({1: tmp_path / "0_Ball_0001.exr"}, has_lamp)
    key_object_light(make_sh_world(world_name("Ball")), "Ball", {1: light}, 1.0, reflected, has_key_light=True)
    (sun,) = key_suns()
    assert sun.visible_glossy == sun.visible_transmission == (not has_lamp)


def test_where_one_picture_of_a_run_is_lost_nothing_is_reflected(tmp_path):
    names = [f"0_Ball_{number:04d}.exr" for number in (1, 2)]
    pictures = [ReflectionsResult(picture=name, seen_share=0.5) for name in names]
    changes = [LightChange(frame=n, sh=(FLAT.tolist(),), reflections=one) for n, one in enumerate(pictures, 1)]
    (tmp_path / names[0]).touch()
    assert reflected_of(changes[:1], tmp_path) == Reflected({1: tmp_path / names[0]}, True)
    assert reflected_of(changes, tmp_path) == NOTHING_REFLECTED


@pytest.mark.parametrize("second", [0.8, 0.9])
def test_a_world_knows_where_its_light_is_of_and_whether_that_moved(second):
    entries = [runs.frame(1, runs.probe("Ball")), runs.frame(2, runs.probe("Ball", position_m=[0.3, -1.25, second]))]
    of = light_of("Ball", runs.results(entries).frames)
    assert of.places_m == {"Ball": (0.3, -1.25, 0.8)} and of.moves == (second != 0.8)


def test_a_mirror_ball_shows_the_lamps_that_glossy_rays_see_and_the_scene_stays_as_it_was():
    """A bulb above, hidden from cameras as Blender's lamps are, and a second one that glossy rays do not see."""
    scene = empty_scene()
    for name, place, is_glossy in (("Bulb", (0, 0, 2), True), ("Other", (2, 0, 0), False)):
        bulb = bpy.data.objects.new(name, bpy.data.lights.new(name, "POINT"))
        bulb.location, bulb.data.energy, bulb.data.shadow_soft_size = place, 20.0, 0.4
        bulb.visible_camera, bulb.visible_glossy = not is_glossy, is_glossy
        scene.collection.objects.link(bulb)
    with open_reference_probe(scene, [(0, 0, 0)], ProbeSettings(size=64, max_samples=4)) as reference_probe:
        ball, render_s = reference_probe.mirror_ball(0, 1)
    straight_up, to_the_side = ball[30:34, 30:34].mean(), seen_in_ball(ball, np.array([[1.0, 0, 0]])).mean()
    assert render_s > 0 and straight_up > 1 and to_the_side < 0.01
    assert [(bulb.visible_camera, bulb.visible_glossy) for bulb in scene.objects] == [(False, True), (True, False)]
