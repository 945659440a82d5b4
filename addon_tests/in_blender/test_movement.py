"""Virtual objects that move along the path are lit where they are, frame by frame."""

import json

import bpy
import numpy as np
import pytest
from mathutils import Vector
from previs_runs import SMALL
from tiny_scenes import add, box, key, material, room_with_a_virtual_sphere

from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.previs import previs
from xihe_blender.previs.survey import SceneSurvey, survey_path
from xihe_blender.scene.virtual_objects import virtual_collection

FIRST = np.array([0, 0, 0.85])
ELSEWHERE = np.array([-1.0, 0.3, 0.5])


def key_location(item, *places):
    """At frames 1, 2, 3, ..."""
    key(item, "location", dict(enumerate(places, start=1)))


def keyed(scene, ball):
    key_location(ball, FIRST, ELSEWHERE)


def parented(scene, ball):
    ball.parent = add(scene, "Cart")
    key_location(ball.parent, (0, 0, 0), ELSEWHERE - FIRST)


def constrained(scene, ball):
    rail = add(scene, "Rail")
    ball.constraints.new("COPY_LOCATION").target = rail
    key_location(rail, FIRST, ELSEWHERE)


def hidden_in_the_viewport(scene, ball):
    keyed(scene, ball)
    ball.hide_viewport = True


def moved_in_its_shape(scene, ball):
    """As bones and simulations do it: the object itself stays."""
    ball.shape_key_add(name="Here")
    there = ball.shape_key_add(name="There")
    for point in there.data:
        point.co += Vector(ELSEWHERE - FIRST)
    key(there, "value", {1: 0.0, 2: 1.0})


def grown(scene, ball):
    keyed(scene, ball)
    key(ball, "scale", {1: (0, 0, 0), 2: (1, 1, 1)})


def followed(scene):
    plan = plan_previs(scene, SMALL)
    survey = survey_path(scene, plan)
    kept = SceneSurvey.from_json(json.loads(json.dumps(survey.as_json())))
    assert [one.moved for one in kept.frames.values()] == [one.moved for one in survey.frames.values()]
    return survey.followed(plan)


@pytest.mark.parametrize("move", [keyed, parented, constrained, hidden_in_the_viewport, moved_in_its_shape, grown])
def test_a_position_goes_where_its_object_goes(move):
    scene = room_with_a_virtual_sphere(2)
    move(scene, bpy.data.objects["Ball"])
    (probe,) = followed(scene).probes
    np.testing.assert_allclose(probe.at(1), FIRST, atol=1e-5)
    np.testing.assert_allclose(probe.at(2), ELSEWHERE, atol=1e-5)


def test_small_steps_count_once_they_are_far_enough_together():
    scene = room_with_a_virtual_sphere(5)
    key_location(bpy.data.objects["Ball"], *(FIRST + (0.009 * step, 0, 0) for step in range(5)))
    (probe,) = followed(scene).probes
    assert [round(probe.at(frame)[0], 3) for frame in range(1, 6)] == [0, 0, 0, 0.027, 0.027]


def test_what_turns_or_is_nowhere_for_a_while_keeps_its_positions():
    scene = room_with_a_virtual_sphere(3)
    ball = bpy.data.objects["Ball"]
    key(ball, "rotation_euler", {1: (0, 0, 0), 2: (0.5, 0.7, 0), 3: (0, 0, 0)})
    key(ball, "scale", {1: (1, 1, 1), 2: (1, 1, 1), 3: (float("nan"), 1, 1)})
    (probe,) = followed(scene).probes
    assert not probe.moved_m


def test_the_positions_of_a_shelf_turn_with_it():
    scene = room_with_a_virtual_sphere(2)
    shelf = box(scene, "Shelf", (0, 1, 1), (1.8, 0.2, 0.1), material("Oak"), virtual_collection(scene))
    key(shelf, "rotation_euler", {1: (0, 0, 0), 2: (0, 0, np.pi / 2)})
    places = [probe.at(2) for probe in followed(scene).probes_of("Shelf")]
    np.testing.assert_allclose(places, [(0, 0.55, 1), (0, 1.45, 1)], atol=1e-5)


def test_a_light_probe_that_moves_measures_what_one_that_stands_there_does():
    scene = room_with_a_virtual_sphere(1)
    few = ProbeSettings(48, 2, noise_target=None)
    with open_reference_probe(scene, [FIRST], few) as probe:
        probe.light_at(0, 1)
        probe.move(0, ELSEWHERE)
        moved = probe.light_at(0, 1).measured
    with open_reference_probe(scene, [ELSEWHERE], few) as probe:
        there = probe.light_at(0, 1).measured
    np.testing.assert_allclose(moved.hdr, there.hdr, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(moved.ldr, there.ldr, rtol=1e-4, atol=1e-5)


def test_a_ball_that_is_pulled_under_a_table_loses_the_light_of_the_lamp(tmp_path):
    """Estimates, reference, results and keys: all follow it."""
    scene = room_with_a_virtual_sphere(4, is_still=True)
    scene.camera.data.angle = 1.8
    beside, below = (0.9, -0.5, 0.5), (0.2, 0, 0.4)
    key_location(bpy.data.objects["Ball"], beside, beside, below, below)
    box(scene, "Front", (0.59, 0, 0.35), (0.05, 0.8, 0.7), material("Wood 2", (0.35, 0.2, 0.1)))
    results = run_blocking(previs(scene, tmp_path, SMALL))
    probes = [frame["probes"][0] for frame in results["frames"] if frame["active"]]
    assert len(probes) == 4
    np.testing.assert_allclose([probe["position_m"] for probe in probes], [beside, beside, below, below], atol=1e-5)
    truth = [np.array(probe["sh_truth"])[0].mean() for probe in probes]
    assert truth[0] == truth[1] and truth[2] == truth[3] < 0.5 * truth[0]
    assert [probe["fired"] for probe in probes] == [True, False, True, False]
    assert probes[2]["light_frame"] == 3 and probes[2]["sh"] != probes[1]["sh"]
    assert [change["frame"] for change in results["lights"]["Ball"]] == [1, 3]
    rendered = [frame["rendering"]["probes"]["Ball"]["same_as"] for frame in results["frames"]]
    assert rendered == [None, 1, None, 3]
