"""One survey of the path: the scene is stepped through once, and all that needs to know it reads what was noted."""

import contextlib
import json
from collections import Counter
from dataclasses import replace

import bpy
import numpy as np
import pytest
from previs_runs import IPAD, LOOKS_AWAY, SMALL, handler_in, walk
from tiny_scenes import add, add_lamp, key, light_strength, node_of, phone, room_with_a_virtual_sphere

from xihe_blender.apply.keys import f_curves
from xihe_blender.capture.scanner import metered_frames
from xihe_blender.errors import UserError
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.jobs import run_blocking
from xihe_blender.light_transport import required_effects
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.previs import previs
from xihe_blender.previs.sample_count import pilot_views
from xihe_blender.previs.survey import SceneSurvey, may_see_a_position, survey_path
from xihe_blender.scene.virtual_objects import virtual_collection

N_FRAMES = 12


def surveyed(scene, settings=SMALL):
    return run_blocking(survey_path(scene, plan_previs(scene, settings)))


@contextlib.contextmanager
def counted_steps():
    """A counter by frame: how often a scene was set to it, or rendered or looked at there, which sets it as well."""
    steps = Counter()

    def count(scene, depsgraph):
        if depsgraph.mode == "VIEWPORT":
            steps[scene.frame_current] += 1

    with handler_in(bpy.app.handlers.frame_change_post, count):
        yield steps


@pytest.mark.parametrize("settings", [SMALL, replace(IPAD, network="lte")], ids=["perfect", "ipad"])
def test_a_run_steps_through_the_frames_at_most_twice_before_its_first_capture(settings, tmp_path):
    scene = room_with_a_virtual_sphere(N_FRAMES)
    plan = plan_previs(scene, settings)
    rendered = {*metered_frames(plan.frames), *(frame for frame, _ in pilot_views(plan, surveyed(scene)))}
    with counted_steps() as steps, contextlib.closing(previs(scene, tmp_path, settings)) as job:
        next(progress for progress in job if "capturing frame" in progress.doing)
    # As the phone's camera and the checks read a frame, and as Cycles would be given it.
    assert {frame: steps[frame] for frame in plan.frames if frame not in rendered} == dict.fromkeys(
        set(plan.frames) - rendered, 2
    )
    # The others are those that are metered, that light walks alone, and that the pilot renders three times.
    assert sum(steps.values()) - 2 * N_FRAMES <= 1 + 3 * (1 + 2) + 2 * (1 + 3)


def test_the_survey_notes_what_a_look_at_each_frame_gives():
    scene = walk()
    plan = plan_previs(scene, SMALL)
    survey, positions = run_blocking(survey_path(scene, plan)), [probe.position_m.tolist() for probe in plan.probes]
    names = ("Ball", "Board 1", "Board 2")
    assert list(survey.frames) == [1, 2, 3, 4, 5]
    assert survey.frames[LOOKS_AWAY].in_view == () and set(survey.in_view) == {1, 2, 4, 5}
    assert {name for seen in survey.in_view.values() for name in seen} == set(names)
    assert survey.frames[3].time_s == pytest.approx(2 / 24)
    assert survey.light_changes and survey.frames[3].state.room != survey.frames[4].state.room
    assert survey.frames[1].state.room == survey.frames[2].state.room
    assert survey.frames[1].state.camera != survey.frames[2].state.camera
    assert np.linalg.norm(survey.frames[1].motion.velocity_m_per_s) > 0
    assert {"Walls", "Wood", "Light"} <= set(survey.frames[1].roughness)
    assert survey.required == required_effects(scene, positions)
    assert survey.faults == ()


@pytest.mark.parametrize(("comes_into_view_at", "n_looks"), [(1, 0), (5, 5), (None, 5)])
def test_whether_any_position_is_in_view_is_known_from_the_plan_or_the_first_frame_that_sees_one(
    comes_into_view_at, n_looks
):
    scene = room_with_a_virtual_sphere(5, is_still=True)
    rail = add(scene, "Rail", location=(0, -5, 0))
    bpy.data.objects["Ball"].constraints.new("COPY_LOCATION").target = rail
    key(rail, "location", {frame: (0, 0, 0.85) if frame == comes_into_view_at else (0, -5, 0) for frame in range(1, 6)})
    with counted_steps() as steps:
        seen = run_blocking(may_see_a_position(scene, plan_previs(scene, SMALL), within_s=60))
        assert seen is (comes_into_view_at is not None)
    # Once to plan, and twice each: as the camera stands, and as Cycles would be given it.
    assert sum(steps.values()) == 1 + 2 * n_looks
    assert run_blocking(may_see_a_position(scene, plan_previs(scene, SMALL), within_s=0)), "nobody knows yet"


def test_a_survey_comes_back_from_its_file_to_the_last_bit():
    scene = walk()
    bpy.data.objects["Ball"].location = (5e4, 0, 0.85)
    survey = surveyed(scene)
    text = json.dumps(as_json(survey), allow_nan=False)
    read = from_json(SceneSurvey, json.loads(text))
    assert survey.faults and read.faults == survey.faults
    assert json.dumps(as_json(read)) == text
    assert read.frames[1].state == survey.frames[1].state and read.required == survey.required
    np.testing.assert_array_equal(read.frames[1].motion.turn_rad_per_s, survey.frames[1].motion.turn_rad_per_s)


def with_a_film(lamp):
    if lamp.node_tree is None:
        lamp.use_nodes = True
    film = lamp.node_tree.nodes.new("ShaderNodeTexImage")
    film.image = bpy.data.images.new("Television", 4, 4)
    film.image.source = "SEQUENCE"
    lamp.node_tree.links.new(film.outputs["Color"], node_of(lamp, "EMISSION").inputs["Color"])


CHANGING_LAMPS = {
    "power": lambda lamp: key(lamp, "energy", {1: 10.0, 3: 20.0}),
    "spread": lambda lamp: key(lamp, "spread", {1: 1.0, 3: 2.0}),
    "exposure": lambda lamp: key(lamp, "exposure", {1: 0.0, 3: 1.0}),
    "temperature": lambda lamp: key(lamp, "temperature", {1: 3000.0, 3: 6500.0}),
    "film": with_a_film,
}


@pytest.mark.parametrize("changes", CHANGING_LAMPS)
def test_a_lamp_whose_light_changes_is_noticed(changes):
    if changes in ("exposure", "temperature") and bpy.app.version < (4, 5):
        pytest.skip(reason="lamps have neither an exposure nor a temperature")
    scene = room_with_a_virtual_sphere()
    lamp = add_lamp(scene, "AREA", (0, 0, 2.5), "Panel").data
    assert not surveyed(scene).light_changes
    CHANGING_LAMPS[changes](lamp)
    assert surveyed(scene).light_changes


def growing(screen):
    screen.shape_key_add(name="Small")
    large = screen.shape_key_add(name="Large")
    for point in large.data:
        point.co *= 2
    key(large, "value", {1: 0.0, 3: 1.0})


@pytest.mark.parametrize("change", [growing, lambda screen: key(screen, "color", {1: (1, 1, 1, 1), 3: (1, 0, 0, 1)})])
def test_a_glowing_mesh_that_grows_or_has_another_colour_is_light_that_changes(change):
    scene = room_with_a_virtual_sphere()
    assert not surveyed(scene).light_changes
    change(bpy.data.objects["Lamp"])
    assert surveyed(scene).light_changes


def test_what_another_camera_is_beside_the_path_does_not_matter():
    scene = room_with_a_virtual_sphere(3)
    own = scene.camera
    other = phone(scene, (0, -1, 1), (0, 0, 0.85), "Overview")
    other.data.type = "ORTHO"
    for frame, camera in ((1, own), (3, other)):
        scene.timeline_markers.new("switch", frame=frame).camera = camera
    survey = surveyed(scene, replace(SMALL, frames=(1, 2)))
    moves = [np.linalg.norm(survey.frames[frame].motion.velocity_m_per_s) for frame in (1, 2)]
    assert moves[0] == pytest.approx(moves[1]) and moves[0] > 0
    with pytest.raises(UserError, match="'Overview' is ortho"):
        surveyed(scene)


def test_the_survey_leaves_nothing_behind_also_after_an_error():
    scene = room_with_a_virtual_sphere()
    virtual_collection(scene).hide_render = False
    before = {item.name for kind in ("scenes", "cameras", "objects") for item in getattr(bpy.data, kind)}
    surveyed(scene)
    light_strength().default_value = float("nan")
    with pytest.raises(UserError, match="'Light' has nan"):
        surveyed(scene)
    assert {item.name for kind in ("scenes", "cameras", "objects") for item in getattr(bpy.data, kind)} == before


def test_what_is_known_of_materials_is_kept_once_for_frames_in_which_it_is_the_same():
    """Of 3,000 materials it takes 0.4 MB, and a path may have 2,000 frames."""
    scene = room_with_a_virtual_sphere(4)
    tree = scene.objects["Room"].active_material.node_tree
    mirror = tree.nodes.new("ShaderNodeBsdfGlossy")
    tree.links.new(mirror.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    key(mirror.inputs["Roughness"], "default_value", {2: 0.25, 3: 0.75})
    for curve in f_curves(tree):
        for point in curve.keyframe_points:
            point.interpolation = "CONSTANT"
    first, second, third, fourth = (one.roughness for one in surveyed(scene).frames.values())
    assert first is second and third is fourth and second != third
