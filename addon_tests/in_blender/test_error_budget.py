"""The error budget of small rooms: where one thing alone is wrong it comes first, and what does not apply is zero."""

import contextlib
import json
import shutil
from dataclasses import replace

import bpy
import numpy as np
import pytest
from previs_runs import QuickPrevis, counted_renders, files_below, look_away, run, unfinished_files
from scene_snapshot import nothing_changes
from scipy import stats
from tiny_scenes import (
    add_lamp,
    box,
    empty_scene,
    key,
    light_strength,
    look_at,
    material,
    phone,
    room_with_a_virtual_sphere,
    set_world,
    sphere,
)

from xihe_blender.capture import reference_probe
from xihe_blender.capture.all_around import light_of_views, means_of_anchors, open_all_around, view_rotation
from xihe_blender.capture.reference_probe import CONE, ProbeSettings, open_reference_probe
from xihe_blender.capture.render import MAX_SEED, RenderSettings
from xihe_blender.capture.satin_probe import satin_ball_at
from xihe_blender.errors import UserError
from xihe_blender.io.budget_results import PARTS, BudgetResults
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.error_budget import SeedErrors, error_budget, interval_of_mean, over_seeds
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.satin_ball import HALF_ANGLE, cone_factors, satin_factors
from xihenet.sh_basis import per_coefficient
from xihenet.sphere import AnchorLattice

QUICK = QuickPrevis(size=(32, 24), preset="draft", samples=4, exposure=1.0)
NOISY = replace(QUICK, samples=1)
"""For tests that hold budgets against each other, or against files, and ask for no order of parts."""


def budget(scene, out, settings=QUICK, n_moments=1, n_seeds=1):
    return run_blocking(error_budget(scene, out, settings, n_moments=n_moments, n_seeds=n_seeds))


def gains(results):
    """Of the only object."""
    (item,) = results.objects
    return {part.name: part.gain for part in item.parts}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a budget, which nothing may change, and what it says."""
    scene, out = room_with_a_virtual_sphere(3), tmp_path_factory.mktemp("whole") / "out"
    with nothing_changes():
        results = budget(scene, out, NOISY, n_moments=2)
        bpy.context.view_layer.update()
    return out, results


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The folder of an undisturbed budget of two seeds, and what it says."""
    out = tmp_path_factory.mktemp("both")
    return out, budget(room_with_a_virtual_sphere(2), out, NOISY, n_seeds=2)


def test_a_budget_has_every_part_and_leaves_the_scene_as_it_was(whole):
    out, results = whole
    written = json.loads((out / "budget.json").read_text())
    assert as_json(results) == written and from_json(BudgetResults, written) == results
    (item,) = results.objects
    assert [part.name for part in item.parts] == list(PARTS) and item.moments == (2, 3)
    assert item.error > 0 and item.brightness > 0
    for part in item.parts:
        assert part.gain == pytest.approx(item.error - part.error) and part.error >= 0
    assert {part.name for part in item.parts if part.state == "not simulated"} == {"sensor", "delay"}
    assert gains(results)["sensor"] == gains(results)["delay"] == 0
    page = (out / "report.html").read_text()
    assert item.advice.split(":")[0] in page and page.count("<rect class=") == len(PARTS) - 2
    assert unfinished_files(out) == []


@pytest.mark.slow
def test_the_light_in_use_is_that_of_a_run(whole, tmp_path):
    shutil.copytree(whole[0], tmp_path / "budget")
    scene = room_with_a_virtual_sphere(3)
    (item,) = budget(scene, tmp_path / "budget", NOISY).objects
    there = run(scene, tmp_path / "run", replace(NOISY, frames=(1, 2, 3)))
    last = np.array(there["frames"][-1]["probes"][0]["sh"])
    kept = json.loads((tmp_path / "budget" / "work" / "satin_ball_0_0001.json").read_text())
    picture = np.array(kept["picture"])
    shown = last * per_coefficient(satin_factors(2))[:, None]
    within = np.square(shown - picture[:9]).sum() / (12 * np.pi)
    beyond = max(0.0, np.square(picture[9:]).sum() / (12 * np.pi) - kept["noise_beyond"])
    assert item.error == pytest.approx(np.sqrt(within + beyond))


@pytest.mark.slow
def test_a_budget_that_is_stopped_goes_on_and_a_finished_one_renders_nothing(both, tmp_path):
    scene, out = room_with_a_virtual_sphere(2), tmp_path / "out"
    with contextlib.closing(error_budget(scene, out, NOISY, n_moments=1, n_seeds=2)) as job:
        progress = next(job)
        while progress.done < 0.6 * progress.total:
            progress = next(job)
    assert not (out / "budget.json").exists() and unfinished_files(out) == []
    resumed, kept = budget(scene, out, NOISY, n_seeds=2), files_below(out / "work")
    with counted_renders() as renders:
        assert budget(scene, out, NOISY, n_seeds=2).objects == resumed.objects
    assert renders == [] and files_below(out / "work") == kept
    assert resumed.objects == both[1].objects


@pytest.mark.slow
def test_a_budget_is_the_mean_over_its_seeds_and_says_how_sure_each_part_is(both, tmp_path):
    scene = room_with_a_virtual_sphere(2)
    each = [budget(scene, tmp_path / f"{seed}", replace(NOISY, seed=seed)) for seed in (0, 1)]
    (item,), singles = both[1].objects, [one.objects[0] for one in each]
    assert item.error == pytest.approx(np.mean([one.error for one in singles]))
    for index, part in enumerate(item.parts):
        of_seeds = [one.parts[index].gain for one in singles]
        assert part.gain == pytest.approx(np.mean(of_seeds)) and singles[0].parts[index].interval is None
        if part.state == "measured":
            assert sum(part.interval) / 2 == pytest.approx(part.gain)
            assert part.interval[1] - part.gain == pytest.approx(12.706 * abs(of_seeds[0] - of_seeds[1]) / 2)
    page = (both[0] / "report.html").read_text()
    assert page.count('class="interval"') == len(PARTS) - 2
    assert 'class="interval"' not in (tmp_path / "0" / "report.html").read_text()


def test_seeds_have_the_interval_of_their_mean():
    values = [1.0, 2.0, 4.0, 3.0]
    low, high = interval_of_mean(values)
    expected = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert (low, high) == pytest.approx((expected.low, expected.high), rel=1e-3)
    assert interval_of_mean([1.0]) is None


def room_around_a_ball(*lamps, n_frames=2, walls=0.5):
    """A cube of 4 m in which the phone looks at a ball in its middle; `lamps` are boxes that glow."""
    scene = empty_scene()
    scene.frame_end = n_frames
    set_world(scene)
    box(scene, "Room", (0, 0, 0), (4, 4, 4), material("Walls", (walls,) * 3), inward=True)
    for index, (centre, size, strength) in enumerate(lamps):
        box(scene, f"Lamp {index}", centre, size, material(f"Light {index}", (1, 1, 1), emission=strength))
    sphere(scene, "Ball", (0, 0, 0), 0.1, collection=virtual_collection(scene, create=True))
    phone(scene, (0, -1.9, 0), (0, 0, 0)).data.angle = np.radians(100)
    return scene


def test_a_part_that_some_seeds_do_not_have_gains_nothing_with_those():
    seeds = [SeedErrors(1.0, 0.5, 0.4, {"order_2": 0.4}), SeedErrors(1.0, 0.5, 0.4, {"order_2": 0.4, "sensor": 0.3})]
    for several in (seeds, seeds[::-1]):
        parts = {part.name: part for part in over_seeds("Ball", (1,), several).parts}
        assert parts["sensor"].state == "measured" and parts["sensor"].gain == pytest.approx(0.1)
        assert parts["delay"].state == "not simulated"


def test_a_lamp_far_above_white_in_view_puts_clipping_first(tmp_path):
    scene = room_around_a_ball(((0, 1.97, 0), (3, 0.02, 3), 40.0), walls=0.02)
    # `lattice` guesses how bright the lamp is, and may be right.
    settings = replace(QUICK, exposure=0.2, estimator="projection")
    found = gains(budget(scene, tmp_path, settings))
    assert max(found, key=found.get) == "clipping"


def test_a_lamp_behind_the_phone_is_a_matter_of_where_it_looks(tmp_path):
    scene = room_around_a_ball(((0, -1.97, 0), (3, 0.02, 3), 1.0), walls=0.02)
    found = gains(budget(scene, tmp_path, replace(QUICK, exposure=0.9)))
    assert set(sorted(found, key=found.get)[-2:]) == {"field_of_view", "coverage"}
    assert abs(found["clipping"]) < 0.2 * found["coverage"]


@pytest.mark.slow
def test_a_slow_network_and_a_light_that_changes_put_delay_first(tmp_path):
    scene = room_with_a_virtual_sphere(4, is_still=True)
    look_at(scene.camera, (-1.2, -1.5, 1.5), (0, 0, 0.85))
    scene.camera.data.angle = np.radians(110)
    key(light_strength(), "default_value", {1: 0.5, 2: 0.5, 3: 40.0, 4: 40.0})
    scene.render.fps = 60
    found = gains(budget(scene, tmp_path, replace(QUICK, exposure=0.02, network="lte")))
    assert max(found, key=found.get) == "delay"


def test_a_phone_with_a_range_sensor_has_a_part_for_it(tmp_path):
    results = budget(room_with_a_virtual_sphere(2), tmp_path, replace(NOISY, phone="ipad_pro_lidar"))
    (part,) = (part for part in results.objects[0].parts if part.name == "sensor")
    assert part.state == "measured"


def test_a_lamp_that_no_camera_sees_comes_first_where_it_is_all_the_light(tmp_path):
    scene = room_around_a_ball(walls=0.02)
    lamp = add_lamp(scene, "AREA", (0, 1.9, 0), energy=50.0, size=2.0)
    lamp.rotation_euler, lamp.visible_camera = (-np.pi / 2, 0, 0), False
    found = gains(budget(scene, tmp_path))
    assert max(found, key=found.get) == "hidden_lamps"


@pytest.mark.parametrize(
    ("wrong", "options", "said"),
    [
        ({"estimator": "truth"}, {}, "choose another --estimator"),
        ({}, {"n_moments": 0}, "give --moments 1 or more"),
        ({}, {"n_seeds": 0}, "give --seeds 1 or more"),
        ({"seed": MAX_SEED}, {"n_seeds": 2}, f"give --seed {MAX_SEED - 1} or less"),
    ],
)
def test_what_cannot_be_divided_is_told(tmp_path, wrong, options, said):
    with pytest.raises(UserError, match=said):
        budget(room_with_a_virtual_sphere(1), tmp_path / "out", replace(QUICK, **wrong), **options)
    assert not (tmp_path / "out").exists()


def test_an_object_that_is_never_in_view_is_told(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    look_away(scene.camera, 1)
    with pytest.raises(UserError, match="in view of the camera in any frame"):
        budget(scene, tmp_path / "out")
    assert not (tmp_path / "out").exists()


# -------------------------------------------------------------------------------------------------------------- renders


def test_the_cones_are_those_of_the_reference_probe():
    assert np.radians(90 * CONE) == pytest.approx(HALF_ANGLE)
    opposite = np.repeat([1, -1, 1], [1, 3, 5])
    np.testing.assert_allclose(reference_probe.cone_factors(), opposite * per_coefficient(cone_factors(2)))


@pytest.mark.slow
def test_ball_and_pictures_all_around_show_the_light_of_the_reference_probe():
    scene = room_with_a_virtual_sphere(1)
    place, settings = (0.2, -0.3, 1.4), ProbeSettings(size=48, max_samples=16, noise_target=None)
    with open_reference_probe(scene, [place], settings) as probe:
        light = probe.light_at(0, 1).measured.hdr
        ball = satin_ball_at(probe, 0, 1, exposure=1.0, samples=64)
    np.testing.assert_allclose(ball.light, light, atol=0.06 * light.max())
    with open_all_around(scene, RenderSettings((8, 8), 32), exposure=1.0, with_surfaces=False) as around:
        around.scanner.scene.frame_set(1)
        views = [around.look(view, np.array(place)) for view in range(6)]
    seen = light_of_views(views)
    np.testing.assert_allclose(seen, light, atol=0.06 * light.max())
    np.testing.assert_allclose(means_of_anchors(views, AnchorLattice(1))[0], seen[0] / np.sqrt(4 * np.pi), rtol=1e-6)


@pytest.mark.parametrize("view", range(6))
def test_six_views_look_along_the_axes(view):
    rotation = view_rotation(view)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1)
