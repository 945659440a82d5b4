"""Virtual objects that move along the path are lit where they are, frame by frame."""

import json

import bpy
import numpy as np
import pytest
from mathutils import Vector
from previs_runs import SMALL
from tiny_scenes import add, box, key, room_with_a_virtual_sphere

from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.previs import previs
from xihe_blender.previs.survey import SceneSurvey, survey_path
from xihe_blender.scene.virtual_objects import virtual_collection

FIRST, ELSEWHERE = np.array([0, 0, 0.85]), np.array([-1.0, 0.3, 0.5])


def followed(scene):
    plan = plan_previs(scene, SMALL)
    survey = run_blocking(survey_path(scene, plan))
    kept = from_json(SceneSurvey, json.loads(json.dumps(as_json(survey))))
    assert [one.moved for one in kept.frames.values()] == [one.moved for one in survey.frames.values()]
    return survey.followed(plan)


def parented(ball):
    ball.parent = add(bpy.context.scene, "Cart")
    key(ball.parent, "location", {1: (0, 0, 0), 2: ELSEWHERE - FIRST})


def constrained_and_hidden_in_the_viewport(ball):
    ball.constraints.new("COPY_LOCATION").target = rail = add(bpy.context.scene, "Rail")
    key(rail, "location", {1: FIRST, 2: ELSEWHERE})
    ball.hide_viewport = True


def moved_in_its_shape(ball):
    """As bones and simulations do it: the object itself stays."""
    ball.shape_key_add(name="Here")
    there = ball.shape_key_add(name="There")
    for point in there.data:
        point.co += Vector(ELSEWHERE - FIRST)
    key(there, "value", {1: 0.0, 2: 1.0})


def keyed_and_grown(ball):
    key(ball, "location", {1: FIRST, 2: ELSEWHERE})
    key(ball, "scale", {1: (0, 0, 0), 2: (1, 1, 1)})


@pytest.mark.parametrize(
    "move", [parented, constrained_and_hidden_in_the_viewport, moved_in_its_shape, keyed_and_grown]
)
def test_a_position_goes_where_its_object_goes(move):
    scene = room_with_a_virtual_sphere(2)
    move(bpy.data.objects["Ball"])
    (probe,) = followed(scene).probes
    np.testing.assert_allclose([probe.at(1), probe.at(2)], [FIRST, ELSEWHERE], atol=1e-5)


def test_small_steps_count_once_they_are_far_enough_together():
    scene = room_with_a_virtual_sphere(5)
    key(bpy.data.objects["Ball"], "location", {frame: (0.009 * (frame - 1), 0, 0.85) for frame in range(1, 6)})
    (probe,) = followed(scene).probes
    assert [round(probe.at(frame)[0], 3) for frame in range(1, 6)] == [0, 0, 0, 0.027, 0.027]


def test_a_shelf_that_turns_takes_its_positions_with_it_and_what_is_nowhere_keeps_its_own():
    scene = room_with_a_virtual_sphere(2)
    shelf = box(scene, "Shelf", (0, 1, 1), (1.8, 0.2, 0.1), collection=virtual_collection(scene))
    key(shelf, "rotation_euler", {1: (0, 0, 0), 2: (0, 0, np.pi / 2)})
    key(bpy.data.objects["Ball"], "scale", {1: (1, 1, 1), 2: (float("nan"), 1, 1)})
    plan = followed(scene)
    np.testing.assert_allclose([one.at(2) for one in plan.probes_of("Shelf")], [(0, 0.55, 1), (0, 1.45, 1)], atol=1e-5)
    assert not plan.probes_of("Ball")[0].moved_m


def test_a_light_probe_that_moves_measures_what_one_that_stands_there_does():
    scene, lights = room_with_a_virtual_sphere(1), []
    for place in (FIRST, ELSEWHERE):
        with open_reference_probe(scene, [place], ProbeSettings(48, 2, noise_target=None)) as probe:
            probe.light_at(0, 1)
            probe.move(0, ELSEWHERE)
            lights.append(probe.light_at(0, 1).measured)
    np.testing.assert_allclose(lights[0].hdr, lights[1].hdr, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(lights[0].ldr, lights[1].ldr, rtol=1e-4, atol=1e-5)


def test_a_ball_that_is_pulled_under_a_table_loses_the_light_of_the_lamp(tmp_path):
    """Estimates, reference, results and keys: all follow it."""
    scene = room_with_a_virtual_sphere(4, is_still=True)
    scene.camera.data.angle = 1.8
    places = dict(enumerate([(0.9, -0.5, 0.5)] * 2 + [(0.2, 0, 0.4)] * 2, start=1))
    key(bpy.data.objects["Ball"], "location", places)
    box(scene, "Front", (0.59, 0, 0.35), (0.05, 0.8, 0.7))
    results = run_blocking(previs(scene, tmp_path, SMALL))
    probes = [frame["probes"][0] for frame in results["frames"]]
    np.testing.assert_allclose([probe["position_m"] for probe in probes], list(places.values()), atol=1e-5)
    truth = [probe["sh_truth"][0][0] for probe in probes]
    assert truth[0] == truth[1] and truth[2] == truth[3] < 0.5 * truth[0]
    assert [probe["light_frame"] for probe in probes] == [1, 1, 3, 3]
    assert [change["frame"] for change in results["lights"]["Ball"]] == [1, 3]
    rendered = [frame["rendering"]["probes"]["Ball"]["same_as"] for frame in results["frames"]]
    assert rendered == [None, 1, None, 3]
