"""Samples reach the noise target, no render is made twice, and what is taken over is what would have been rendered."""

import time
from dataclasses import replace

import numpy as np
import pytest
from previs_runs import SMALL, counted_renders, finished_run, look_away, run, run_some_steps
from renders import captured
from results_schema import without_times
from tiny_scenes import key, light_strength, look_at, room_with_a_virtual_sphere

from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import open_scanner
from xihe_blender.errors import UserError
from xihe_blender.io.exr import read_radiance
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import NOISE_MARGIN, above_noise
from xihe_blender.previs.presets import PRESETS
from xihe_blender.previs.sample_count import (
    LARGE_STEP,
    SMALLEST_LIGHT,
    NoiseModel,
    SampleCount,
    fewest_samples,
    fit_noise,
    measure_captures,
    measure_sample_count,
    pilot_samples,
    pilot_views,
)
from xihe_blender.previs.settings import PREVIS_TRIGGER, PrevisSettings
from xihe_blender.previs.survey import survey_path
from xihenet.camera import unproject_frame
from xihenet.io.recording import load_frame
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import project_anchors
from xihenet.sphere import AnchorLattice
from xihenet.trigger import RULES, decide_trigger

N_FRAMES = 5
MOVES = 5
"""The frame of `still_walk` at which the phone moves; before that it holds still."""

TOLERANCE = 2.0
"""Real over expected error, or the other way round: a pilot of three frames sees little of the denoiser's bias."""


def still_walk():
    """A phone that holds its pose but for the last frame."""
    scene = room_with_a_virtual_sphere(N_FRAMES)
    for frame in range(1, N_FRAMES + 1):
        look_at(scene.camera, (-1.2 if frame < MOVES else -0.6, -1.5, 1.5), (0, 0, 0.85), frame)
    return scene


def surveyed(scene, settings):
    plan = plan_previs(scene, settings)
    return plan, run_blocking(survey_path(scene, plan))


def one_thread(scene):
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    return scene


# --------------------------------------------------------------------------------------------------- the noise model


@pytest.mark.parametrize("is_denoised", [False, True])
@pytest.mark.parametrize(("sigma", "bias"), [(0.1, 0.0), (0.1, 0.05), (0.1, 0.1), (0.1, 0.2)])
def test_a_fit_finds_the_noise_and_the_bias_that_renders_have(is_denoised, sigma, bias):
    rng, n_small, rate = np.random.default_rng(3), 2, 0.5 if is_denoised else 1.0
    light = rng.normal(size=(4000, 9, 3))
    light *= 2.0 / np.linalg.norm(light, axis=(1, 2), keepdims=True)

    def render(n):
        noise = rng.normal(size=light.shape) * 2.0 * sigma / np.sqrt(27 * n)
        return light * (1 - bias / n**rate) + noise

    model = fit_noise(render(n_small), render(n_small), render(4 * n_small), n_small, is_denoised=is_denoised)
    for n in (n_small, 8, 50):
        truth = np.sqrt(((render(n) - light) ** 2).sum(axis=(1, 2)).mean()) / 2.0
        # The larger render, which the fit takes the light's norm from, is itself biased and noisy.
        assert model.noise(n) == pytest.approx(truth, rel=0.34 if is_denoised else 0.08)


def test_light_that_nobody_sees_is_held_against_grey_and_no_position_is_refused():
    rng = np.random.default_rng(4)
    dark = rng.normal(size=(500, 9, 3)) * 1e-3
    a, b, c = (dark + 0.01 * rng.normal(size=dark.shape) for _ in range(3))
    assert fit_noise(a, b, c, 1, is_denoised=False).variance == pytest.approx(27 * 1e-4 / SMALLEST_LIGHT**2, rel=0.05)
    with pytest.raises(ValueError, match="one position or more"):
        fit_noise(*np.zeros((3, 0, 9, 3)), 1, is_denoised=True)


def test_a_tighter_target_takes_more_samples_up_to_the_maximum():
    model = NoiseModel(variance=0.04, bias=0.1, bias_rate=0.5)
    samples = [model.samples_for(target, 2, 64) for target in (0.5, 0.1, 0.06, 0.04, 0.02, 0.001)]
    assert samples == sorted(samples) and samples[0] == 2 and samples[-1] == 64 and len(set(samples)) >= 5
    for target, n in zip((0.1, 0.06, 0.04), samples[1:], strict=False):
        assert model.noise(n) <= target < model.noise(n - 1)


# ----------------------------------------------------------------------------------------------------- the noise itself


def lights_in(scene, plan, settings, frame, samples, seeds):
    """Coefficients (S, K, 9, 3) of captures of `frame` with each of `seeds`."""
    lattice, positions = AnchorLattice(1280), [probe.position_m for probe in plan.probes]
    captures = []
    with open_scanner(scene, settings.capture(plan.size, samples)) as scanner:
        scanner.move_to(frame)
        for seed in seeds:
            scanner.scene.cycles.seed = seed
            cloud = unproject_frame(scanner.acquire_environment_scan())
            captures.append([project_anchors(sample_unit_sphere(cloud, p, lattice), lattice) for p in positions])
    return np.array(captures)


@pytest.mark.slow
def test_the_noise_is_what_was_expected_and_within_the_target():
    scene = one_thread(room_with_a_virtual_sphere(24, is_still=True))
    look_at(scene.camera, (-1.2, -1.5, 1.5), (0, 0, 0.85))
    settings = PrevisSettings(preset="draft", size=(32, 24), exposure=1.0, noise_target=0.05)
    plan, survey = surveyed(scene, settings)
    sample_count = run_blocking(measure_sample_count(scene, plan, survey, settings, 1.0))
    lights = lights_in(scene, plan, settings, 8, sample_count.capture_samples, range(100, 106))
    reference = lights_in(scene, plan, settings, 8, 64, range(200, 202)).mean(axis=0)
    assert sample_count.capture_noise <= 0.05
    error = np.sqrt(((lights - reference) ** 2).sum(axis=(-1, -2)).mean() / (reference**2).sum(axis=(-1, -2)).mean())
    assert sample_count.capture_noise / TOLERANCE < error < TOLERANCE * sample_count.capture_noise


def test_a_tighter_target_takes_more_samples_of_a_scene():
    scene = one_thread(room_with_a_virtual_sphere(3))
    settings = PrevisSettings(preset="balanced", size=(32, 24), exposure=1.0)
    plan, survey = surveyed(scene, settings)

    def measured(noise_target):
        return run_blocking(
            measure_sample_count(scene, plan, survey, replace(settings, noise_target=noise_target), 1.0)
        )

    sample_counts = [measured(noise_target) for noise_target in (0.3, 0.08, 0.04, 0.0001)]
    samples = [sample_count.capture_samples for sample_count in sample_counts]
    assert samples == sorted(samples) and len(set(samples)) >= 3
    assert samples[-1] == PRESETS["balanced"].max_samples
    again = measured(0.04)
    assert replace(again, pilot_s=0) == replace(sample_counts[2], pilot_s=0)


def test_the_pilot_takes_the_time_in_which_it_renders_and_not_that_between_its_steps(monkeypatch):
    scene = room_with_a_virtual_sphere(3)
    plan, survey = surveyed(scene, SMALL)
    waited, clock = [0.0], time.perf_counter
    monkeypatch.setattr(time, "perf_counter", lambda: clock() + sum(waited))
    count = run_blocking(measure_sample_count(scene, plan, survey, SMALL, 1.0), lambda *_: waited.append(1e4))
    assert 0 < count.pilot_s < 1e4 < sum(waited)


@pytest.mark.parametrize(
    ("samples", "looks_at_it", "expected"), [(7, True, 7), (None, False, PRESETS[SMALL.preset].max_samples)]
)
def test_a_number_that_is_given_or_a_path_that_sees_no_position_needs_no_pilot(samples, looks_at_it, expected):
    scene, settings = room_with_a_virtual_sphere(2), replace(SMALL, samples=samples, exposure=1.0)
    for frame in () if looks_at_it else (1, 2):
        look_away(scene.camera, frame)
    plan, survey = surveyed(scene, settings)
    with counted_renders() as renders:
        assert run_blocking(measure_sample_count(scene, plan, survey, settings, 1.0)) == SampleCount(expected)
    assert not renders


@pytest.mark.parametrize(
    ("n_frames", "expected"), [(1, [1]), (8, [5]), (9, [3, 7]), (24, [5, 13, 21]), (60, [11, 31, 51])]
)
def test_pilots_are_spread_over_the_frames_that_see_a_position(n_frames, expected):
    scene = room_with_a_virtual_sphere(n_frames, is_still=True)
    assert [frame for frame, _ in pilot_views(*surveyed(scene, SMALL))] == expected


@pytest.mark.parametrize(
    "change", [{"noise_target": 0.0}, {"noise_target": 1.0}, {"noise_target": float("nan")}, {"samples": 0}]
)
def test_a_senseless_noise_target_is_refused(change):
    with pytest.raises(UserError):
        replace(SMALL, **change)


# --------------------------------------------------------------------------------------------------- what is taken over


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    """A run along `still_walk`, with its files and what was rendered."""
    return finished_run(tmp_path_factory.mktemp("still") / "out", replace(SMALL, exposure=1.0), still_walk)


def test_frames_that_show_nothing_new_are_not_rendered(still):
    results, renders = still.results, still.renders
    captures = [entry["rendering"]["capture"] for entry in results["frames"]]
    assert [capture["same_as"] for capture in captures] == [None, 1, 1, 1, None]
    probes = [entry["rendering"]["probes"]["Ball"] for entry in results["frames"]]
    assert [probe["same_as"] for probe in probes] == [None, 1, 1, 1, 1]
    assert [entry.get("comparison_same_as") for entry in results["frames"]] == [None, None, 1, None, None]
    # Three more captures for the pilot; the probe takes its pictures, two of each kind, at one frame alone.
    assert renders.count("Xihe Capture") == 2 + 3
    assert renders.count("Xihe Reference Probe") == 2 + 2
    assert renders.count("Xihe Ground Truth") == 2
    assert (results["summary"]["n_reused_captures"], results["summary"]["n_reused_probes"]) == (3, 4)


def test_results_say_the_samples_and_the_noise(still):
    results = still.results
    samples, noise = results["settings"]["samples"], results["settings"]["noise"]
    assert results["settings"]["trigger"]["theta"] == PREVIS_TRIGGER.theta + NOISE_MARGIN * noise["trigger"]
    capture = results["frames"][0]["rendering"]["capture"]
    assert (capture["samples"], capture["noise"]) == (samples["capture"], noise["capture"])
    told = any("above the target" in note for note in results["notes"])
    assert noise["capture"] <= results["settings"]["noise_target"] or told
    probe = results["frames"][0]["rendering"]["probes"]["Ball"]
    assert probe["noise"] <= noise["truth"] or probe["is_capped"]
    assert still.outputs.sample_count.exists()


def test_what_is_taken_over_is_what_would_have_been_rendered(still, tmp_path):
    outputs, results = still.outputs, still.results
    samples = results["settings"]["samples"]
    settings = replace(SMALL, exposure=1.0)
    # Alone in its run, frame 3 has no earlier frame to take anything from. Its pilot looks at frame 3, so the numbers
    # of samples of the whole walk are put into its folder.
    outputs_alone = RunOutputs(tmp_path / "alone", "untitled")
    outputs_alone.sample_count.parent.mkdir(parents=True)
    outputs_alone.sample_count.write_text(outputs.sample_count.read_text(encoding="utf-8"), encoding="utf-8")
    alone = run(still_walk(), outputs_alone.folder, replace(settings, frames=(3,)))
    assert alone["settings"]["samples"] == samples
    assert alone["frames"][0]["rendering"]["capture"]["rendered"]
    taken, rendered = (load_frame(files.capture(3)) for files in (outputs, outputs_alone))
    np.testing.assert_array_equal(taken.srgb_u8, rendered.srgb_u8)
    np.testing.assert_array_equal(taken.plane_depth_m, rendered.plane_depth_m)
    assert (taken.frame, taken.time_s) == (rendered.frame, rendered.time_s)
    np.testing.assert_array_equal(*(read_radiance(o.probe(0, "Ball", 3)) for o in (outputs, outputs_alone)))
    assert results["frames"][2]["comparison"] == alone["frames"][0]["comparison"]
    for kind in ("ground_truth", "lattice", "ambient", "truth"):
        one, other = (files.picture(kind, 3).read_bytes() for files in (outputs, outputs_alone))
        assert one == other
        np.testing.assert_array_equal(*(read_radiance(o.radiance(kind, 3)) for o in (outputs, outputs_alone)))


def test_a_run_that_was_stopped_takes_over_the_same(still, tmp_path):
    settings = replace(SMALL, exposure=1.0)
    scene = still_walk()
    with counted_renders() as in_parts:
        for n_steps in (3, 5, 8):
            assert not run_some_steps(scene, tmp_path, n_steps, settings)
        again = run(scene, tmp_path, settings)
    assert without_times(again) == without_times(still.results)
    assert sorted(in_parts) == sorted(still.renders)


def test_a_lamp_that_changes_has_every_frame_rendered_anew(tmp_path):
    scene = room_with_a_virtual_sphere(2, is_still=True)
    key(light_strength(), "default_value", {1: 3.0, 2: 6.0})
    results = run(scene, tmp_path, replace(SMALL, exposure=0.1, samples=2))
    assert results["summary"]["n_reused_captures"] == results["summary"]["n_reused_probes"] == 0
    first, second = (entry["probes"][0]["sh_truth"] for entry in results["frames"])
    assert np.subtract(second, first).max() > 0


def test_what_a_preset_takes_at_least_lies_within_what_its_pilot_measures():
    fewest = [fewest_samples(preset) for preset in PRESETS.values()]
    assert fewest == sorted(fewest)
    for preset, samples in zip(PRESETS.values(), fewest, strict=True):
        assert preset.min_samples <= samples <= preset.max_samples
        assert pilot_samples(preset) <= samples <= LARGE_STEP * pilot_samples(preset)


# ------------------------------------------------------------------------------------------------ noise and the trigger


@pytest.mark.parametrize("n_samples", [1, 4])
def test_noise_that_the_pilot_knows_does_not_fire(n_samples):
    scene, position_m, lattice = room_with_a_virtual_sphere(1), np.array([0, 0, 0.85]), AnchorLattice(1280)
    pilot = RenderSettings((48, 36), 1, denoise=False)
    _, change = run_blocking(measure_captures(scene, [(1, [position_m])], pilot, 1.0, 1280, PREVIS_TRIGGER))
    frames = (captured(scene, (48, 36), n_samples, seed) for seed in (900, 901))
    first, second = (sample_unit_sphere(unproject_frame(frame), position_m, lattice) for frame in frames)
    assert decide_trigger(first, second, lattice, PREVIS_TRIGGER).reason == "colour"
    raised = above_noise(PREVIS_TRIGGER, change / n_samples)
    assert decide_trigger(first, second, lattice, raised).reason == "none"
    # Without a pilot theta stays as it is.
    assert above_noise(PREVIS_TRIGGER, None) == PREVIS_TRIGGER
    for rule in ("light", "reference", "every-frame"):
        assert above_noise(RULES[rule], change) == RULES[rule]
