"""Which effects of a phone do `xihe effects` and the panel announce? Those that a run simulates, and no others off."""

import json
from dataclasses import replace

import bpy
import pytest
from previs_runs import SMALL, run
from results_schema import read_strictly
from scene_snapshot import differences, snapshot
from tiny_scenes import empty_scene, room_with_a_virtual_sphere

from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.light_transport import plan_light_transport
from xihe_blender.previs.required_effects import effects_of_run, format_effects, plan_phone_effects, positions_in
from xihenet.effects import effects_as_json
from xihenet.phone import PHONE_EFFECTS

SESSION = replace(SMALL, phone="ipad_pro_lidar", network="lte")


def announced(scene, settings=SESSION, *, is_captured=True):
    positions = positions_in(scene, scene.frame_start)
    return run_blocking(plan_phone_effects(scene, positions, settings, is_captured=is_captured))


def test_what_is_announced_is_what_the_run_simulates(tmp_path):
    scene = room_with_a_virtual_sphere()
    effects = announced(scene)
    run(scene, tmp_path / "out", SESSION)
    rows = {row["name"]: row for row in read_strictly(tmp_path / "out" / "results.json")["effects"]}
    assert list(effects) == list(PHONE_EFFECTS)
    assert {name: effect.state for name, effect in effects.items()} == {name: rows[name]["state"] for name in effects}
    assert {"on", "off"} == {effect.state for effect in effects.values()}


def test_without_captures_nothing_is_left_out_that_captures_would_call_for():
    scene = room_with_a_virtual_sphere()
    seen, unseen = announced(scene), announced(scene, is_captured=False)
    assert all(unseen[name].state == "on" for name, effect in seen.items() if effect.state == "on")
    assert unseen["range"].state == "on" and "not known" in unseen["range"].reason
    assert seen["range"].state == "off" and "within the sensor's" in seen["range"].reason


def test_looking_changes_nothing_in_the_file():
    scene = room_with_a_virtual_sphere()
    scene.frame_set(3)
    before = snapshot()
    run_blocking(effects_of_run(scene, replace(SMALL, phone="ipad_pro_lidar"), is_measured=False))
    assert differences(before, snapshot()) == ({}, [])


def test_the_users_choices_win_and_are_named():
    effects = announced(room_with_a_virtual_sphere(), replace(SESSION, effect_choices={"noise": "off", "range": "on"}))
    assert (effects["noise"].state, effects["noise"].origin) == ("off", "user")
    assert (effects["range"].state, effects["range"].origin) == ("on", "user")
    assert "you turned it on; by itself it would be off" in effects["range"].reason


def test_a_perfect_phone_that_estimates_by_itself_has_no_effects():
    assert announced(room_with_a_virtual_sphere(), SMALL) == {}
    assert set(announced(room_with_a_virtual_sphere(), replace(SMALL, network="lte"))) == set(PHONE_EFFECTS)


def test_a_scene_without_objects_is_judged_without_captures():
    scene = room_with_a_virtual_sphere()
    effects = run_blocking(plan_phone_effects(scene, [], SESSION, is_captured=True))
    assert effects == announced(scene, is_captured=False)


def test_a_phone_without_a_camera_is_refused():
    empty_scene()
    with pytest.raises(UserError, match="has no camera"):
        announced(bpy.context.scene)


def test_light_transport_comes_first_and_the_phone_behind_it():
    scene = room_with_a_virtual_sphere()
    effects = run_blocking(effects_of_run(scene, SESSION, is_measured=False))
    transport = plan_light_transport(scene, None, positions_in(scene, scene.frame_start), frames=SESSION.frames)
    assert effects == transport | announced(scene, is_captured=False)
    rows = json.loads(json.dumps(effects_as_json(effects, with_cost=True), allow_nan=False))
    assert [row["name"] for row in rows] == list(effects) == [*transport, *PHONE_EFFECTS]
    assert set(rows[-1]) == {"name", "state", "reason", "parameters", "origin", "cost"}
    line = next(line for line in format_effects(effects).splitlines() if line.startswith("edge_bleeding"))
    assert " on " in line and "radius_px 2" in line
