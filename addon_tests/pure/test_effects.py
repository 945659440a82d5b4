"""The planner of effects: what is required, what the user chose, and the JSON of both."""

import json
from dataclasses import replace

import pytest

from xihenet.effects import (
    Change,
    EffectCost,
    Requirement,
    effects_as_json,
    effects_from_json,
    names_that_are_on,
    plan_effects,
)

REQUIRED = {
    "fog": Requirement(True, "there is fog", {"bounces": 32}, {"bounces": 0}),
    "veil": Requirement(False, "nothing is transparent", {"depth": 8}, {"depth": 0}, left_out={"depth": 4}),
    "hair": Requirement(True, "a cat", {}, {}),
}


def test_without_choices_the_plan_is_what_is_required():
    plan = plan_effects(REQUIRED, {"fog": "auto"})
    assert list(plan) == list(REQUIRED) and names_that_are_on(plan) == {"fog", "hair"}
    assert [dict(plan[name].parameters) for name in plan] == [{"bounces": 32}, {"depth": 4}, {}]
    assert {effect.origin for effect in plan.values()} == {"auto"}


def test_the_users_choice_wins_and_the_reason_says_what_it_replaces():
    plan = plan_effects(REQUIRED, {"fog": "off", "veil": "off"})
    assert (plan["fog"].state, plan["fog"].origin, plan["fog"].parameters) == ("off", "user", {"bounces": 0})
    assert plan["fog"].reason == "you turned it off; by itself it would be on: there is fog"
    assert plan["veil"].parameters == {"depth": 0}
    assert plan_effects(REQUIRED, {"veil": "on"})["veil"].parameters == {"depth": 8}


def test_choices_about_what_cannot_be_switched_or_is_not_there_are_ignored():
    assert plan_effects(REQUIRED, {"hair": "off", "smell": "on"}) == plan_effects(REQUIRED, {})
    assert not plan_effects(REQUIRED, {})["hair"].is_switchable


def test_a_choice_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match="fog: expected auto, on or off"):
        plan_effects(REQUIRED, {"fog": "maybe"})


def test_rows_survive_json_and_have_a_cost_only_if_asked_for():
    plan = plan_effects(REQUIRED, {"fog": "off"})
    rows = json.loads(json.dumps(effects_as_json(plan)))
    assert set(rows[0]) == {"name", "state", "reason", "parameters", "origin"}
    assert names_that_are_on(effects_from_json(rows)) == names_that_are_on(plan)
    plan["fog"] = replace(plan["fog"], cost=EffectCost(0.1, 0.01, Change(-0.2, 0.01), None))
    fog, veil, _ = effects_as_json(plan, with_cost=True)
    assert fog["cost"]["light"] == {"relative": -0.2, "standard_error": 0.01} and veil["cost"] is None
