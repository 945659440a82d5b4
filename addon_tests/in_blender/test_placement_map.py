"""The placement map of a small room: its places have the light that a run finds there, and its captures are kept."""

import csv
import json
import shutil
from dataclasses import replace

import bpy
import numpy as np
import pytest
from previs_runs import CAPTURED, counted_renders, files_below, look_away, run, unfinished_files
from scene_snapshot import nothing_changes
from tiny_scenes import opened

from addon_tests.pure.recordings import SMALL, walk
from xihe_blender.errors import UserError
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.io.placement_results import PlacementResults
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.placement import PlacementSettings, placement
from xihe_blender.previs.room_from_above import RoomFromAbove
from xihe_blender.scene.virtual_objects import virtual_objects

FEW = PlacementSettings(spacing_m=0.5)


def mapped(scene, out, settings=CAPTURED, wanted=FEW):
    return run_blocking(placement(scene, out, settings, wanted, blend_file=out.parent / "room.blend"))


@pytest.fixture(scope="module")
def kept(room_file, tmp_path_factory):
    """The folder of a map of `FEW` places, which nothing may change, and its results."""
    out = tmp_path_factory.mktemp("map") / "out"
    (out.parent / "room.blend").write_bytes(room_file.read_bytes())
    return out, mapped(opened(room_file), out)


@pytest.fixture
def copied(kept, out):
    """A copy of the folder of that map."""
    shutil.copytree(kept[0], out)
    return out


@pytest.mark.parametrize("name", ["projection", "truth"])
def test_an_estimator_that_expects_no_error_is_refused_before_anything_is_rendered(scene, out, name):
    with pytest.raises(UserError, match="does not say what error it expects"):
        mapped(scene, out, replace(CAPTURED, estimator=name))
    assert not out.exists()


def test_a_map_has_places_with_their_light_and_leaves_the_scene_as_it_was(scene, out):
    with nothing_changes():
        results = mapped(scene, out, wanted=replace(FEW, n_verified=4))
        bpy.context.view_layer.update()
    written = json.loads((out / "placement.json").read_text())
    assert as_json(results) == written and from_json(PlacementResults, written) == results
    assert len(results.places) > 3 and results.n_unknown < len(results.places)
    for place in results.places:
        assert 0 <= place.coverage <= 1
        assert (place.expected_error is None) == (place.irradiance is None)
    assert results.verified.n_places == sum(place.true_error is not None for place in results.places) == 4
    errors = [place.expected_error for place in results.best_first]
    assert errors == sorted(errors)
    with (out / "placement.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["coverage"]) for row in rows] == [place.coverage for place in results.places]
    page = (out / "report.html").read_text()
    assert "Where AR light will fail: room.blend" in page and page.count("data:image/png") == 2
    assert unfinished_files(out) == []


@pytest.mark.slow
def test_a_place_has_the_coverage_and_the_light_of_a_run_with_the_object_there(kept, scene, tmp_path):
    place = kept[1].best_first[0]
    (ball,) = virtual_objects(scene)
    ball.location = place.position_m
    there = run(scene, tmp_path / "run", replace(CAPTURED, frames=(1, 2, 3)))
    last = [probe for entry in there["frames"] for probe in entry["probes"]][-1]
    np.testing.assert_allclose(last["position_m"], place.position_m, atol=1e-6)
    assert last["coverage"] == place.coverage
    assert last["expected_error"] == pytest.approx(place.expected_error, abs=1e-6)


def test_other_places_in_the_same_room_cost_no_render(copied, scene):
    before = files_below(copied / "work")
    with counted_renders() as renders:
        in_the_air = mapped(scene, copied, wanted=PlacementSettings(height_m=1.0, spacing_m=0.5))
    assert renders == [] and files_below(copied / "work") == before
    assert {place.position_m[2] for place in in_the_air.places} == {1.0}


def test_a_grid_in_the_air_that_fits_no_memory_is_refused_where_it_was_asked_for_and_else_made_coarser(copied, scene):
    with pytest.raises(UserError, match="1e-06 m apart are too many: give a larger spacing"):
        mapped(scene, copied, wanted=PlacementSettings(height_m=1.0, spacing_m=1e-6))
    assert mapped(scene, copied, wanted=PlacementSettings(height_m=1.0, reach_m=1e9, most=50)).places


@pytest.mark.parametrize("most", [1, 10])
def test_no_more_places_than_wanted(scene, copied, most):
    results = mapped(scene, copied, wanted=PlacementSettings(most=most))
    assert 0 < len(results.places) <= most and results.spacing_m > 0.05


def test_one_frame_is_a_path(scene, out):
    assert mapped(scene, out, replace(CAPTURED, frames=(2,))).frames == (2,)


def test_a_path_that_sees_no_upward_surface_is_told(scene, out):
    for frame in (1, 2, 3):
        look_away(scene.camera, frame)
    scene.camera.data.angle = np.radians(20)
    with pytest.raises(
        UserError, match="there is no place for an object: no frame of the path shows an upward surface"
    ):
        mapped(scene, out)
    assert not (out / "placement.json").exists()


def test_another_scene_in_the_folder_is_refused(copied, scene):
    with pytest.raises(UserError, match=r"holds a placement map with another seed.*choose another folder for --out"):
        mapped(scene, copied, replace(CAPTURED, seed=5))


@pytest.mark.parametrize(
    "senseless",
    [{"spacing_m": 0.0}, {"clearance_m": float("nan")}, {"reach_m": -1.0}, {"height_m": float("inf")}, {"most": 0}],
    ids=str,
)
def test_senseless_places_are_refused(senseless):
    with pytest.raises(UserError):
        PlacementSettings(**senseless)


def test_a_report_of_somebody_else_is_left_alone(scene, out):
    out.mkdir()
    (out / "report.html").write_text("mine")
    with pytest.raises(UserError, match=r"report\.html is there and not from a placement map"):
        mapped(scene, out)
    assert (out / "report.html").read_text() == "mine" and len(list(out.iterdir())) == 1


def test_the_room_from_above_has_a_bar_of_a_metre():
    room = RoomFromAbove(walk(SMALL, 1), np.zeros((1, 3)), 0.9, lambda _, srgb: 0 * srgb)
    room.metre()
    (row,) = {int(y) for y in np.argwhere((room.picture == 255).all(axis=2))[:1, 0]}
    assert (room.picture[row] == 255).all(axis=1).sum() == int(room.pixels_per_m) == round(720 / 1.8)
