"""The placement map in the open file: made from the last run's frames, removed with its light, never in a render."""

import json
from dataclasses import replace
from functools import partial

import bpy
import numpy as np
import pytest
from previs_runs import CAPTURED, counted_renders, run, walk
from scene_snapshot import nothing_changes
from tiny_scenes import opened, saved

from xihe_blender.addon.placement_map import Squares, format_place
from xihe_blender.apply.datablocks import placement_map
from xihe_blender.apply.placement_map import MapOf, remove_placement_map, show_placement_map, shown_place
from xihe_blender.io.placement_results import Place, error_range
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.placement import PlacementSettings, placement

pytestmark = pytest.mark.usefixtures("addon")
FEW = PlacementSettings(most=20)
"""Places: what is asked here is not how fine a map is."""


@pytest.fixture(scope="module", autouse=True)
def few_places():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("xihe_blender.previs.placement.PlacementSettings", partial(PlacementSettings, most=FEW.most))
        yield


@pytest.fixture(scope="module")
def ran(addon, tmp_path_factory):
    """The folder of a run, and beside it the file as it was then."""
    out = tmp_path_factory.mktemp("map") / "out"
    scene = walk()
    scene.xihe.run_folder = str(out)
    saved(out.parent / "room.blend")
    run(scene, out, CAPTURED)
    return out


@pytest.fixture
def scene(ran):
    return opened(ran.parent / "room.blend")


def values(name):
    item = placement_map()
    found = np.empty(len(item.data.polygons), "f")
    item.data.attributes[name].data.foreach_get("value", found)
    return found


@pytest.mark.slow
def test_the_map_of_a_run_is_that_of_the_command_line_and_costs_no_render(scene, ran, tmp_path):
    with counted_renders() as renders:
        assert bpy.ops.xihe.map_places() == {"FINISHED"}
    assert renders == []
    errors, coverage = values("expected_error"), values("coverage")
    results = run_blocking(placement(scene, tmp_path, CAPTURED, FEW, blend_file=ran.parent / "room.blend"))
    expected = [-1 if place.expected_error is None else place.expected_error for place in results.places]
    np.testing.assert_allclose(errors, expected, atol=1e-6)
    np.testing.assert_allclose(coverage, [place.coverage for place in results.places], atol=1e-6)
    for index, place in enumerate(results.places):
        np.testing.assert_allclose(shown_place(placement_map(), index).position_m, place.position_m, atol=1e-5)
    best = MapOf.read(placement_map().data).best
    assert [results.places[index] for index in best] == results.best_first[:10]


def test_removing_the_light_removes_the_map(scene):
    with nothing_changes():
        assert bpy.ops.xihe.map_places() == {"FINISHED"} and placement_map() is not None
        for is_shown in (False, True):
            scene.xihe.show_map = is_shown
            assert placement_map().hide_viewport is not is_shown, "Blender draws the edges of its mesh"
        assert bpy.ops.xihe.remove_light() == {"FINISHED"}
        scene.xihe.property_unset("show_map")
        scene.xihe.property_unset("map_place")


def test_a_new_map_takes_the_place_of_the_old_one_and_a_saved_one_is_found_again(scene, tmp_path):
    bpy.ops.xihe.map_places()
    scene.xihe.maps_air, scene.xihe.map_height_m = True, 1.2
    bpy.ops.xihe.map_places()
    saved(tmp_path / "mapped.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "mapped.blend"), load_ui=False)
    assert [item.name for item in bpy.data.objects if item.name.startswith("Xihe Placement")] == ["Xihe Placement Map"]
    assert shown_place(placement_map(), 0).position_m[2] == pytest.approx(1.2, abs=1e-5)


@pytest.mark.slow
def test_a_run_does_not_see_the_map(scene, tmp_path):
    one_frame = replace(CAPTURED, frames=(1,))
    without = run(scene, tmp_path / "without", one_frame)
    bpy.ops.xihe.map_places()
    with_map = run(scene, tmp_path / "with", one_frame)
    assert with_map["frames"][0]["probes"][0]["sh"] == without["frames"][0]["probes"][0]["sh"]


def test_a_place_from_the_lists_gets_the_cursor(scene):
    bpy.ops.xihe.map_places()
    index = MapOf.read(placement_map().data).worst[0]
    assert bpy.ops.xihe.go_to_place(index=index) == {"FINISHED"}
    np.testing.assert_allclose(scene.cursor.location, shown_place(placement_map(), index).position_m, atol=1e-5)
    assert scene.xihe.map_place == index
    with pytest.raises(RuntimeError, match="make the map again"):
        bpy.ops.xihe.go_to_place(index=10**6)


# ------------------------------------------------------------------------------------------------------- places by hand

PLACES = [
    Place(position_m=(0.0, 0.0, 0.1), coverage=0.9, expected_error=0.1, irradiance=(1.0, 2.0, 3.0)),
    Place(position_m=(1.0, 0.0, 0.1), coverage=0.4, expected_error=0.5, irradiance=(0.1, 99.6, 1234.0)),
    Place(position_m=(1.0, 0.0, 0.9), coverage=0.0, expected_error=None, irradiance=None),
]


@pytest.fixture
def by_hand(tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.unit_settings.scale_length = 0.5
    yield show_placement_map(scene, PLACES, spacing_m=0.5, clearance_m=0.1, folder=tmp_path)
    remove_placement_map()


def test_what_is_known_of_a_place_is_read_off_the_mesh(by_hand):
    for index, place in enumerate(PLACES):
        shown = shown_place(by_hand, index)
        np.testing.assert_allclose(shown.position_m, place.position_m, atol=1e-5)
        assert shown.expected_error == pytest.approx(place.expected_error) and shown.coverage == pytest.approx(
            place.coverage
        )
    assert format_place(by_hand, 0) == "expected error 0.100, coverage 90%, estimated irradiance 1 2 3"
    assert format_place(by_hand, 1) == "expected error 0.500, coverage 40%, estimated irradiance 0.1 100 1,234"
    assert format_place(by_hand, 2) == "coverage 0%, light unknown"


def test_colours_go_from_blue_over_the_errors_to_red_and_unknown_is_grey(by_hand):
    colours = np.empty(4 * 4 * len(PLACES), "f")
    by_hand.data.color_attributes["Expected Error"].data.foreach_get("color_srgb", colours)
    of_places = 255 * colours.reshape(len(PLACES), 4, 4)[:, 0, :3]
    wanted = [place.colour(error_range(PLACES)) for place in PLACES]
    np.testing.assert_allclose(of_places, wanted, atol=1)
    assert wanted[0][2] > wanted[0][0] and wanted[2] == (128, 128, 128)


def test_the_place_under_a_line_of_sight_is_the_nearest_that_it_meets(by_hand):
    squares, down = Squares(by_hand), (0.0, 0.0, -1.0)
    # Blender units: half a metre each.
    assert squares.hit((0.0, 0.0, 5.0), down) == 0
    assert squares.hit((2.0, 0.1, 5.0), down) == 2, "the upper one hides the lower one"
    assert squares.hit((2.0, 0.1, 1.0), down) == 1
    assert squares.hit((1.0, 0.0, 5.0), down) is None, "between two places"
    assert squares.hit((0.0, 0.0, -5.0), down) is None, "behind"
    assert squares.hit((0.0, 0.0, 0.01), (1.0, 0.0, 0.0)) is None, "level"


def test_squares_are_drawn_two_millimetres_above_the_mesh_in_a_scene_of_any_scale(by_hand):
    mesh_z = [vertex.co.z for vertex in by_hand.data.vertices]
    np.testing.assert_allclose(Squares(by_hand).corners[:, 2] - mesh_z, 0.002 / 0.5, atol=1e-6)


def test_an_object_of_the_users_with_our_name_is_left_alone(by_hand, tmp_path):
    remove_placement_map()
    own = bpy.data.objects.new("Xihe Placement Map", bpy.data.meshes.new("own"))
    bpy.context.scene.collection.objects.link(own)
    made = show_placement_map(bpy.context.scene, PLACES, spacing_m=0.5, clearance_m=0.1, folder=tmp_path)
    assert placement_map() == made != own and json.loads(made.data["xihe_placement_map"])["spacing_m"] == 0.5
    made.name = "Where it is dark"
    assert placement_map() == made, "whatever it is called"
    remove_placement_map()
    assert own.name in bpy.data.objects and "Where it is dark" not in bpy.data.objects


def test_a_height_without_a_place_is_told_in_the_panels_words(scene):
    scene.xihe.maps_air, scene.xihe.map_height_m = True, 50.0
    with pytest.raises(RuntimeError, match=r"give another Height, bring the camera nearer to it$"):
        bpy.ops.xihe.map_places()
