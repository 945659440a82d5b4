"""`xihe effects`, what it measures, and a user's overrides: remembered in the .blend, given on the command line."""

import contextlib
import hashlib
import itertools
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import bpy
import pytest
from effect_scenes import ball, glass, stage
from planned_effects import plan_light_transport
from previs_runs import SMALL, run
from scene_snapshot import nothing_changes
from tiny_scenes import room_with_a_virtual_sphere, saved

from addon_tests.pure.commands import xihe_here
from xihe_blender.capture.reference_probe import ProbeSettings
from xihe_blender.capture.render import can_denoise
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.light_transport import costs, remember_overrides, remembered_overrides
from xihe_blender.light_transport.overrides import PROPERTY, parsed_overrides
from xihe_blender.light_transport.plan import required_effects
from xihe_blender.light_transport.rules import RULES, SWITCHED_ELSEWHERE
from xihe_blender.previs.required_effects import effects_of_run
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.blend_file import open_blend
from xihenet.phone import PHONE_EFFECTS


def test_overrides_are_remembered_in_the_blend_until_they_are_auto(tmp_path):
    scene = stage()
    remember_overrides(scene, {"volumes": "on", "light tree": "on"})
    scene = open_blend(saved(tmp_path / "kept.blend"))
    assert remembered_overrides(scene) == {"volumes": "on", "light tree": "on"}
    assert plan_light_transport(scene)["volumes"].origin == "user"
    remember_overrides(scene, {"volumes": "auto"})
    assert remembered_overrides(scene) == {"light tree": "on"}
    remember_overrides(scene, {"light tree": "auto"})
    assert PROPERTY not in scene


def test_what_is_given_wins_over_what_is_remembered():
    scene = stage()
    remember_overrides(scene, {"volumes": "on"})
    assert plan_light_transport(scene, overrides={"volumes": "off"})["volumes"].state == "off"
    auto = plan_light_transport(scene, overrides={"volumes": "auto"})["volumes"]
    assert (auto.state, auto.origin) == ("off", "auto")
    assert remembered_overrides(scene) == {"volumes": "on"}


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"fog": "on"}, "there is no effect 'fog': choose among diffuse bounces"),
        ({"volumes": "maybe"}, "choose auto, on or off"),
        ({"hair": "on"}, "particle or hair settings"),
        ({"depth of field": "off"}, "the camera's"),
    ],
)
def test_senseless_overrides_are_refused(overrides, words):
    scene = stage()
    with pytest.raises(UserError, match=words):
        plan_light_transport(scene, overrides=overrides)
    with pytest.raises(UserError, match=words):
        remember_overrides(scene, overrides)
    assert PROPERTY not in scene


@pytest.mark.parametrize(
    ("stored", "words"),
    [("volumes", "does not hold effects"), ({"dark_holes": "on"}, "of an older version, 'dark_holes'")],
)
def test_a_property_that_holds_something_else_is_refused(stored, words):
    scene = stage()
    scene[PROPERTY] = stored
    with pytest.raises(UserError, match=f"scene property '{PROPERTY}' .*{words}.*: delete it"):
        plan_light_transport(scene)


def test_typed_overrides_are_read_with_spaces_and_the_last_one_wins():
    typed = ["motion blur=off", " volumes = on ", "motion blur=on"]
    assert parsed_overrides(typed) == {"motion blur": "on", "volumes": "on"}
    assert parsed_overrides([]) == {}
    for text in ("volumes", "=on", "volumes=", "volumes:on", ""):
        with pytest.raises(UserError, match="give NAME=on"):
            parsed_overrides([text])


MEASURED = {"transmission", "diffuse bounces", "volumes", "transparency", "motion blur", "denoising"}
"""Two that the room calls for, two that it does not, and two that are measured in a scene of their own."""

VARIANTS = costs._variants


@contextlib.contextmanager
def few_costs(names, n_seeds):
    """Costs of `names` alone, from `n_seeds` small renders of each side."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(costs, "PICTURE", replace(costs.PICTURE, size=(24, 18)))
        patch.setattr(costs, "ProbeSettings", lambda size, **others: ProbeSettings(size // 3, **others))
        patch.setattr(costs, "N_SEEDS", n_seeds)
        patch.setattr(costs, "APART_SEEDS", n_seeds)
        patch.setattr(costs, "_variants", lambda *of_run: {k: v for k, v in VARIANTS(*of_run).items() if k in names})
        yield


@pytest.fixture(scope="module")
def measured():
    """Effects of the tiny room with a glass ball in it, some with costs; measuring them leaves the file as it is."""
    scene = room_with_a_virtual_sphere(n_frames=1)
    ball(scene, "Vase", (0.5, 0.3, 1.0), glass())
    with few_costs(MEASURED, n_seeds=3), nothing_changes():
        return run_blocking(effects_of_run(scene, PrevisSettings(), budget_s=1e9))


def without_a_denoiser():
    """What a build without it cannot switch on."""
    return set() if can_denoise(bpy.context.scene) else {"denoising"}


def test_every_effect_says_whether_a_scene_can_switch_it_and_is_measured_if_so():
    plan = plan_light_transport(stage())
    assert {name for name, effect in plan.items() if not effect.is_switchable} == set(SWITCHED_ELSEWHERE)
    scene = room_with_a_virtual_sphere(n_frames=1)
    variants = set(VARIANTS(required_effects(scene), {}))
    assert set(RULES) - variants == set(SWITCHED_ELSEWHERE) | without_a_denoiser()


@pytest.mark.slow
def test_measuring_changes_nothing_in_the_file_and_gives_each_its_cost(measured):
    found = {name: effect.cost for name, effect in measured.items() if effect.cost is not None}
    assert set(found) == MEASURED - without_a_denoiser()
    assert all(cost.time_share > -1 and cost.time_standard_error > 0 for cost in found.values())


@pytest.mark.slow
def test_leaving_out_changes_the_picture_where_the_scene_calls_for_it_and_nothing_elsewhere(measured):
    for name in ("transmission", "diffuse bounces"):
        change = measured[name].cost.picture
        assert change.relative < -2 * change.standard_error < 0, name
        assert measured[name].state == "on"
    for name in ("volumes", "transparency"):
        cost = measured[name].cost
        assert measured[name].state == "off"
        for change in (cost.light, cost.picture):
            assert (change.relative, change.standard_error) == (0, 0), name


@pytest.mark.slow
def test_the_plan_is_shown_before_the_costs_and_each_cost_as_it_is_known(blend):
    names = {"diffuse bounces", "volumes"}
    with few_costs(names, n_seeds=2):
        shown = xihe_here("effects", blend, "--budget", "600").stdout
    plan, of_each = shown.split("\n\n")[:2]
    required = plan_light_transport(open_blend(blend))
    for effect in required.values():
        line = next(line for line in plan.splitlines() if line.startswith(effect.name))
        assert effect.state in line and effect.reason[:30] in line
    assert {n for n in required if any(line.startswith(n) and "%" in line for line in of_each.splitlines())} == names
    assert "standard error" in shown


def test_what_the_budget_has_no_time_for_is_named(blend):
    """And not the network or an effect of the phone, which cost no render."""
    shown = xihe_here("effects", blend, "--budget", "1e-9", "--network", "wifi").stdout
    late = re.findall(r"^(.*): not measured within 1e-09 s, give a larger --budget", shown, re.MULTILINE)
    assert "diffuse bounces" in late and not {*late} & {*PHONE_EFFECTS}


def test_what_was_measured_when_the_time_ran_out_is_told_all_the_same(monkeypatch):
    scene, clock = room_with_a_virtual_sphere(n_frames=1), itertools.count()
    monkeypatch.setattr(costs, "time", SimpleNamespace(perf_counter=lambda: float(next(clock))))
    with few_costs({"diffuse bounces"}, n_seeds=2):
        effects = run_blocking(effects_of_run(scene, PrevisSettings(), budget_s=2.0))
    cost = effects["diffuse bounces"].cost
    assert cost is not None and cost.picture is not None and cost.light is None


def test_a_scene_without_a_camera_and_objects_has_a_plan_and_no_costs():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    effects = run_blocking(effects_of_run(bpy.context.scene, PrevisSettings()))
    assert list(effects) == list(RULES) and all(effect.cost is None for effect in effects.values())


@pytest.fixture(scope="module")
def blend(tmp_path_factory):
    """The tiny room as a file that remembers an override."""
    scene = room_with_a_virtual_sphere(n_frames=2)
    remember_overrides(scene, {"light tree": "off"})
    return saved(tmp_path_factory.mktemp("effects") / "room.blend")


def test_the_command_prints_strict_json_and_saves_no_override(blend):
    before = hashlib.sha256(blend.read_bytes()).digest()
    done = xihe_here("effects", blend, "--plan-only", "--json", "--effect", "motion blur=off", "--effect", "volumes=on")
    assert done.returncode == 0, done.stderr
    rows = {row["name"]: row for row in json.loads(done.stdout)}
    assert list(rows) == list(RULES)
    user = {name: row["state"] for name, row in rows.items() if row["origin"] == "user"}
    assert user == {"light tree": "off", "motion blur": "off", "volumes": "on"}
    assert hashlib.sha256(blend.read_bytes()).digest() == before


def test_the_command_prints_a_table_with_a_star_for_the_users(blend):
    done = xihe_here("effects", blend, "--plan-only")
    assert done.returncode == 0, done.stderr
    head, *lines = done.stdout.splitlines()
    assert head.split() == ["effect", "state", "why", "set", "to"]
    assert any(line.startswith("light tree") and " off* " in line for line in lines)


def test_results_name_the_users_overrides_and_the_given_ones_win(blend, tmp_path):
    scene = open_blend(blend)
    chosen = {"volumes": "on", "reflective caustics": "off"}
    settings = replace(SMALL, frames=(1,), effect_choices={**chosen, "transmission": "auto"})
    results = run(scene, tmp_path / "out", settings)
    user = {row["name"]: row["state"] for row in results["effects"] if row.get("origin") == "user"}
    assert user == {"light tree": "off", "volumes": "on", "reflective caustics": "off"}
    assert results["settings"]["effect_choices"] == {"light tree": "off", **chosen}
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "volume_bounces 32" in report and "you turned it on" in report
    with pytest.raises(UserError, match="another choice of effects"):
        run(scene, tmp_path / "out", replace(settings, effect_choices={}))
