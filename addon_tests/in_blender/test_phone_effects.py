"""Which effects of a phone a session shows, what they know of the room, and that leaving others out changes nothing."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from phone_runs import IPAD, kept, pane, planned, principled, state
from previs_runs import SMALL
from tiny_scenes import key, room_with_a_virtual_sphere

from xihe_blender.capture.phone_surfaces import load_surfaces
from xihe_blender.light_transport import remember_overrides
from xihe_blender.previs.phone_capture import SURFACE_EFFECTS
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.recording import load_frame


@pytest.fixture(scope="module")
def as_it_is(tmp_path_factory):
    """The phone in the room as it is, the capture of its first frame, and where that is kept."""
    out = tmp_path_factory.mktemp("as_it_is")
    return *planned(room_with_a_virtual_sphere(), out, IPAD), kept(out)


def test_range_is_cut_in_a_large_room_and_not_in_a_small_one(as_it_is, tmp_path):
    assert state(as_it_is[0], "range") == "off"
    scene = room_with_a_virtual_sphere()
    bpy.data.objects["Room"].scale = (4, 4, 2)
    large, captured = planned(scene, tmp_path, IPAD)
    assert state(large, "range") == "on"
    _, n_lost = replace(large, of_camera=frozenset({"range"})).see(captured, kept(tmp_path))
    assert n_lost["range"] == np.count_nonzero(captured.plane_depth_m > 5)


def test_an_effect_that_was_left_out_would_have_changed_nothing(as_it_is, tmp_path):
    by_itself, captured, beside = as_it_is
    choices = {"range": "on", "transparent_holes": "on"}
    forced, again = planned(room_with_a_virtual_sphere(), tmp_path, replace(IPAD, effect_choices=choices))
    assert choices.keys() <= forced.on - by_itself.on
    with_all = forced.see(again, kept(tmp_path))[0]
    assert np.array_equal(by_itself.see(captured, beside)[0].plane_depth_m, with_all.plane_depth_m)


def test_a_still_camera_has_no_rolling_shutter_and_no_drift(as_it_is, tmp_path):
    assert state(as_it_is[0], "rolling_shutter") == state(as_it_is[0], "pose_drift") == "on"
    scene = room_with_a_virtual_sphere(2)
    scene.camera.animation_data_clear()
    still, captured = planned(scene, tmp_path, IPAD)
    assert state(still, "rolling_shutter") == state(still, "pose_drift") == "off"
    assert np.array_equal(still.see(captured, kept(tmp_path))[0].world_from_camera, captured.world_from_camera)
    # A frame that is taken over has what its source has.
    later = load_frame(kept(tmp_path).capture(2))
    assert later.frame == 2 and np.array_equal(captured.srgb_u8, later.srgb_u8)
    seen = [replace(still, of_camera=SURFACE_EFFECTS).see(frame, kept(tmp_path))[0] for frame in (captured, later)]
    assert np.array_equal(seen[0].plane_depth_m, seen[1].plane_depth_m)
    facts = [vars(load_surfaces(kept(tmp_path).surfaces(frame))) for frame in (1, 2)]
    assert all(np.array_equal(facts[0][key], facts[1][key]) for key in facts[0])


def test_a_single_frame_of_a_walk_is_not_taken_for_a_still_camera(tmp_path):
    phone, _ = planned(room_with_a_virtual_sphere(), tmp_path, replace(IPAD, frames=(2,)))
    assert state(phone, "rolling_shutter") == "on"
    assert np.linalg.norm(phone.survey.frames[2].motion.velocity_m_per_s) == pytest.approx(0.3 * 24, rel=0.05)


def _dimmed(scene):
    strength = bpy.data.materials["Light"].node_tree.nodes["Emission"].inputs["Strength"]
    key(strength, "default_value", {1: 6.0, 3: 1.0})


def _driven_lamp(scene):
    lamp = bpy.data.objects.new("Spot", bpy.data.lights.new("Spot", "POINT"))
    scene.collection.objects.link(lamp)
    lamp.data.driver_add("energy").driver.expression = "frame * 10"


def _switched_off(scene):
    key(bpy.data.objects["Lamp"], "hide_render", {1: False, 2: True})


def _carried_away(scene):
    key(bpy.data.objects["Lamp"], "location", {1: (1.9, 1, 1.6), 3: (1.9, 3, 1.6)})


def _sky_changes(scene):
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    key(background.inputs["Color"], "default_value", {1: (0.1, 0.1, 0.1, 1.0), 3: (0.3, 0.3, 0.3, 1.0)})


def _a_virtual_lamp_changes(scene):
    """As an instance of a collection, and by itself; the captures show neither."""
    lamps = bpy.data.collections.new("Lamps")
    lamp = bpy.data.objects.new("Candle", bpy.data.lights.new("Candle", "POINT"))
    lamp.data.driver_add("energy").driver.expression = "frame * 10"
    lamps.objects.link(lamp)
    candles = bpy.data.objects.new("Candles", None)
    candles.instance_type, candles.instance_collection = "COLLECTION", lamps
    virtual_collection(scene).objects.link(candles)
    virtual_collection(scene).objects.link(bpy.data.objects.new("Torch", lamp.data))


@pytest.mark.parametrize("change", [_dimmed, _driven_lamp, _switched_off, _carried_away, _sky_changes])
def test_the_light_sensor_is_simulated_where_a_light_changes(change, tmp_path):
    scene = room_with_a_virtual_sphere()
    change(scene)
    phone, captured = planned(scene, tmp_path, IPAD)
    assert state(phone, "light_sensor") == "on"
    assert not np.allclose(phone.see(captured, kept(tmp_path))[0].ambient, captured.ambient, rtol=1e-3)


def test_the_light_sensor_is_left_out_where_no_light_changes(tmp_path):
    scene = room_with_a_virtual_sphere()
    _a_virtual_lamp_changes(scene)
    key(bpy.data.objects["Table"], "location", {1: (0, 0.1, 0.7), 3: (0, 0.3, 0.7)})
    phone, captured = planned(scene, tmp_path, IPAD)
    assert state(phone, "light_sensor") == "off"
    assert np.array_equal(phone.see(captured, kept(tmp_path))[0].ambient, captured.ambient)


@pytest.mark.parametrize(
    ("effect", "look"),
    [
        ("transparent_holes", {"Transmission_Weight": 1.0, "Roughness": 0.0, "Base_Color": (1, 1, 1, 1)}),
        ("glossy_holes", {"Metallic": 1.0, "Roughness": 0.02}),
        ("dark_holes", {"Base_Color": (0.01, 0.01, 0.01, 1), "Specular_IOR_Level": 0.0}),
    ],
)
def test_a_surface_that_gives_no_answer_makes_a_hole_where_it_is(effect, look, as_it_is, tmp_path):
    assert state(as_it_is[0], effect) == "off"
    scene = room_with_a_virtual_sphere(1)
    pane(scene, principled("Pane", **look))
    phone, captured = planned(scene, tmp_path, IPAD)
    assert state(phone, effect) == "on"
    seen, n_lost = replace(phone, of_camera=frozenset({effect})).see(captured, kept(tmp_path))
    middle = (slice(10, 14), slice(14, 18))
    assert (captured.plane_depth_m[middle] > 0).all() and (seen.plane_depth_m[middle] == 0).all()
    assert 16 <= n_lost[effect] < captured.plane_depth_m.size / 2


def test_a_lacquered_surface_answers_and_a_lamp_is_not_dark(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    pane(scene, principled("Lacquer", Roughness=0.02, Base_Color=(0.6, 0.3, 0.2, 1)))
    phone, captured = planned(scene, tmp_path, replace(IPAD, effect_choices={"glossy_holes": "on"}))
    assert state(phone, "dark_holes") == "off"
    assert phone.see(captured, kept(tmp_path))[1]["glossy_holes"] == 0


def test_a_bright_wall_at_night_is_not_dark_to_a_sensor_with_its_own_light(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    bpy.data.materials["Light"].node_tree.nodes["Emission"].inputs["Strength"].default_value = 1e-3
    phone, captured = planned(scene, tmp_path, IPAD)
    assert captured.srgb_u8.mean() < 15
    assert state(phone, "dark_holes") == "off"


def test_roughness_that_a_texture_drives_is_not_known_and_makes_no_hole(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    look = principled("Brushed", Metallic=1.0)
    noise = look.node_tree.nodes.new("ShaderNodeTexNoise")
    shader = next(node for node in look.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    look.node_tree.links.new(noise.outputs[0], shader.inputs["Roughness"])
    pane(scene, look)
    phone, captured = planned(scene, tmp_path, IPAD)
    assert state(phone, "glossy_holes") == "on"
    assert np.isnan(load_surfaces(kept(tmp_path).surfaces(1)).roughness[12, 16])
    assert phone.see(captured, kept(tmp_path))[1]["glossy_holes"] == 0


def test_materials_of_other_names_do_not_stand_in_for_a_mirror(tmp_path):
    """Names of every length and beyond ASCII: Cryptomatte knows a material by a hash of its name."""
    scene = room_with_a_virtual_sphere(1)
    roughness = {"M": 0.07, "Mi": 0.08, "Mir": 0.09, "Mirr": 0.1, "Spiegel größer": 0.11, "鏡": 0.12}
    for column, (name, value) in enumerate(roughness.items()):
        strip = pane(scene, principled(name, Metallic=1.0, Roughness=value))
        strip.scale.x, strip.delta_location.x = 0.15, 0.09 * column - 0.22
    planned(scene, tmp_path, IPAD)
    seen = load_surfaces(kept(tmp_path).surfaces(1)).roughness
    from_left_to_right = dict.fromkeys(seen[12][seen[12] < 0.5].tolist())
    assert list(from_left_to_right) == np.float32(list(roughness.values())).tolist() and seen[0, 0] == 1


def test_a_path_that_is_coarser_than_the_network_says_so(tmp_path):
    scene, settings = room_with_a_virtual_sphere(2), replace(SMALL, network="lte")
    assert planned(scene, tmp_path, settings)[0].notes() == []
    scene.render.fps = 2
    phone, _ = planned(scene, tmp_path, settings)
    assert len(phone.notes()) == 1 and "500 ms" in phone.notes()[0] and "79 ms" in phone.notes()[0]
    phone, _ = planned(scene, tmp_path, replace(settings, effect_choices={"network": "off"}))
    assert phone.link_in_use is None and phone.effects["network"].origin == "user" and phone.notes() == []


def test_choices_are_remembered_in_the_blend_and_the_runs_own_win(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    remember_overrides(scene, {"noise": "off", "range": "on", "volumes": "on"})
    phone, _ = planned(scene, tmp_path, IPAD)
    assert (state(phone, "noise"), state(phone, "range")) == ("off", "on")
    phone, _ = planned(scene, tmp_path, replace(IPAD, effect_choices={"noise": "auto", "range": "off"}))
    assert (state(phone, "noise"), state(phone, "range")) == ("on", "off")
    perfect, _ = planned(scene, tmp_path, SMALL)
    assert perfect.on == frozenset()
