"""Does what the plan leaves out change the picture? Renders with the plan beside renders with everything on.

Both sides are rendered with the same 16 seeds, 32x24 pixels, and compared by `addon_tests/agreement.py`. Where the plan
changes nothing that a path could have met, they are the same to the last bit; where it cuts bounces or chooses lights
otherwise, they are not, and the statistic decides. With fixed seeds the outcome is fixed too. That the statistic would
notice is tested as well: the effects that a scene does call for are switched off one by one.
"""

from dataclasses import replace

import numpy as np
import pytest
from effect_scenes import PAIRS, bright_room, open_field
from planned_effects import everything_on, plan_light_transport

from addon_tests.agreement import agreement
from xihe_blender.capture.render import RenderSettings, render_passes, working_scene
from xihe_blender.capture.scanner import first_layer
from xihe_blender.light_transport import cycles_settings, required_effects
from xihenet.effects import plan_effects

N_SEEDS = 16
EVERYTHING_ON = {}
"""Pictures with everything on, by what makes the scene; rendered once."""


def pictures_of(scene, *plans):
    """(16, 24, 32, 3) by plan, over the same seeds, on one thread."""
    settings = RenderSettings((32, 24), 4, denoise=False)
    found = []
    for plan in plans:  # One after the other: whenever Cycles turns to another scene it takes that in anew.
        with working_scene(scene, "Equal", replace(settings, light_transport=cycles_settings(plan))) as working:
            working.render.threads_mode, working.render.threads = "FIXED", 1
            working.frame_set((scene.frame_start + scene.frame_end) // 2)
            found.append([])
            for seed in range(N_SEEDS):
                working.cycles.seed = seed
                found[-1].append(first_layer(render_passes(working))[0])
    return [np.array(pictures) for pictures in found]


def against_everything_on(make_scene, overrides=None):
    scene = make_scene()
    required = required_effects(scene)
    if make_scene not in EVERYTHING_ON:
        [EVERYTHING_ON[make_scene]] = pictures_of(scene, everything_on(scene, required))
    return agreement(EVERYTHING_ON[make_scene], *pictures_of(scene, plan_effects(required, overrides or {})))


@pytest.mark.slow
@pytest.mark.parametrize("make_scene", dict.fromkeys(scene for pair in PAIRS.values() for scene in pair))
def test_a_scene_shows_by_the_plan_all_that_it_calls_for_and_the_same_without_the_rest(make_scene):
    scene = make_scene()
    plan = plan_light_transport(scene)
    assert all(plan[effect].state == "off" for effect, (_, without) in PAIRS.items() if without is make_scene)
    found = against_everything_on(make_scene)
    assert found.holds, found


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect", ["diffuse bounces", "glossy bounces", "transmission", "transparency", "volumes", "motion blur"]
)
def test_an_effect_that_a_scene_calls_for_is_missed_when_it_is_switched_off(effect):
    found = against_everything_on(PAIRS[effect][0], {effect: "off"})
    assert not found.holds, found


@pytest.mark.slow
@pytest.mark.parametrize(("albedo", "missing"), [(0.5, 0.02), (0.8, 0.05)])
def test_in_a_closed_bright_room_the_plan_cuts_no_bounce_that_shows_and_two_are_missed(albedo, missing):
    scene = bright_room(albedo)
    required = required_effects(scene)
    plan = everything_on(scene, required)
    two = plan | {"diffuse bounces": replace(plan["diffuse bounces"], parameters={"diffuse_bounces": 2})}
    full, planned, cut = pictures_of(scene, plan, plan_effects(required, {}), two)
    found = agreement(full, planned)
    assert found.holds and abs(found.relative_difference) < 1e-3, found
    missed = agreement(full, cut)
    assert not missed.holds and missed.relative_difference < -missing, missed


def test_on_open_ground_two_bounces_are_enough():
    scene = open_field()
    assert plan_light_transport(scene)["diffuse bounces"].parameters == {"diffuse_bounces": 2}
    found = against_everything_on(open_field)
    assert found.holds, found
