"""How `xihe frontier` times and judges what it measures: rounds, errors of lights, ways to compute."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xihe_blender.lab.frontier.choices import EXHAUSTIVE, compute_choices
from xihe_blender.lab.frontier.compute import ChoiceBackend, Walk, padded, square_errors, walk_through, with_every_pixel
from xihe_blender.lab.frontier.records import ComputeChoice
from xihe_blender.lab.frontier.timing import interleaved, median_and_spread
from xihenet.camera import unproject_frame
from xihenet.records import Intrinsics, RgbdFrame


def drained(steps):
    """What a generator returns, and what it yielded."""
    yielded = []
    while True:
        try:
            yielded.append(next(steps))
        except StopIteration as finished:
            return finished.value, yielded


@given(st.integers(0, 5), st.integers(0, 4), st.integers(0, 99))
def test_candidates_take_turns_and_the_first_round_does_not_count(n_candidates, n_rounds, seed):
    calls = []

    def candidate(number):
        calls.append(number)
        return 100 * number + calls.count(number)

    candidates = [lambda number=number: candidate(number) for number in range(n_candidates)]
    measured, yielded = drained(interleaved(candidates, n_rounds, np.random.default_rng(seed)))
    assert [progress.done for progress in yielded] == list(range(1, n_rounds + 2))
    for start in range(0, len(calls), max(1, n_candidates)):
        assert sorted(calls[start : start + n_candidates]) == list(range(n_candidates))
    assert measured == [[100 * number + turn for turn in range(2, n_rounds + 2)] for number in range(n_candidates)]


def test_rounds_have_different_orders():
    calls = []
    candidates = [lambda number=number: float(calls.append(number) or 0) for number in range(6)]
    drained(interleaved(candidates, 5, np.random.default_rng(0)))
    assert len({tuple(calls[start : start + 6]) for start in range(0, 36, 6)}) > 3


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=9), st.floats(0, 100))
def test_spread_moves_with_no_shift_and_one_outlier_does_not_rule_the_median(values, shift):
    median, spread = median_and_spread(values)
    shifted, same = median_and_spread([value + shift for value in values])
    assert shifted == pytest.approx(median + shift) and same == pytest.approx(spread, abs=1e-6)
    assert min(values) <= median <= max(values) and spread >= 0
    assert median_and_spread([*values, *values, 1e9])[0] <= max(values)


def test_the_error_of_a_light_is_its_share_of_the_light_and_bands_that_it_lacks_are_none():
    light = np.random.default_rng(6).normal(1, 0.3, (25, 3))
    errors = square_errors([1.1 * light[:9], light[:9]], [light[:9], light[:9]])
    assert np.sqrt([errors["coefficients"], errors["irradiance"]]) == pytest.approx(np.array([[0.1, 0.0]] * 2))
    missing = (light[9:] ** 2).sum() / (light**2).sum()
    assert square_errors([light[:9]], [light])["coefficients"] == pytest.approx([missing])
    assert padded(light[:4])[4:].max() == 0
    # Darkness is a finite reference.
    errors = square_errors([np.full((9, 3), 0.01)], [np.zeros((9, 3))])
    assert all(0 < value < 1 for values in errors.values() for value in values)


def room_frame(width=48, height=36, shift=0.0):
    """Looking along +Y at a wall with coloured stripes, 3 m away."""
    rng = np.random.default_rng(2)
    stripes = rng.integers(20, 255, (1, width, 3), dtype=np.uint8)
    pose = np.array([[1.0, 0, 0, shift], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    seen = Intrinsics(width, height, fx=30.0, fy=30.0, cx=width / 2, cy=height / 2)
    plane_depth_m = np.full((height, width), 3.0, np.float32)
    ambient = np.full(3, 0.4)
    return RgbdFrame(np.tile(stripes, (height, 1, 1)), plane_depth_m, seen, pose, 1.0, ambient, 0.0, 1)


def room_walk(n_frames=3):
    frames = [replace(room_frame(shift=0.2 * k), time_s=k / 10, frame=k + 1) for k in range(n_frames)]
    names = ["a", "b"]
    positions = {"a": np.array([0.0, 2.0, 0.0]), "b": np.array([0.3, 2.4, 0.1])}
    return Walk(frames, [names] * n_frames, positions, [{n: np.ones((25, 3)) for n in names}] * n_frames, 1.0)


def lights_of(choice, walk=None):
    return np.array(walk_through(ChoiceBackend(choice), walk or room_walk()).lights)


@pytest.mark.parametrize("step", [1, 2, 3, 5])
def test_a_frame_of_fewer_pixels_sees_the_same_points(step):
    whole, fewer = room_frame(), with_every_pixel(room_frame(), step)
    points, few = unproject_frame(whole), unproject_frame(fewer)
    grid = points.points_m.reshape(36, 48, 3)[::step, ::step].reshape(-1, 3)
    assert few.points_m == pytest.approx(grid, abs=1e-6)


@pytest.mark.slow
def test_every_way_to_compute_gives_a_finite_light_at_every_place():
    walk = room_walk(2)
    for choice in compute_choices(is_quick=True):
        if choice.estimator in ("xihenet", "pointar"):
            continue
        lights = lights_of(choice, walk)
        assert lights.shape == (walk.n_places, 25, 3) and np.isfinite(lights).all(), choice.label


def test_the_light_of_what_has_moved_is_that_of_its_new_place():
    walk, there = room_walk(), {"a": (0.1, 1.6, 0.2), "b": (0.2, 2.6, 0.0)}
    moved = replace(walk, moved=dict.fromkeys((1, 2, 3), there))
    stands = replace(walk, positions={name: np.array(place) for name, place in there.items()})
    lights = lights_of(ComputeChoice(), moved)
    assert np.array_equal(lights, lights_of(ComputeChoice(), stands))
    assert not np.allclose(lights, lights_of(ComputeChoice(), walk), atol=1e-3)


def test_brute_force_gives_the_light_of_exact_and_a_finer_table_is_nearer_to_it():
    exact = lights_of(ComputeChoice())
    assert lights_of(ComputeChoice(nearest="brute")) == pytest.approx(exact, abs=1e-6)
    coarse, fine = (lights_of(ComputeChoice(nearest="table", table_size=size)) for size in ((32, 16), (4096, 2048)))
    assert np.abs(fine - exact).max() < np.abs(coarse - exact).max()


def test_a_trigger_at_zero_estimates_wherever_something_changes():
    walk = room_walk(4)
    eager, base = (
        walk_through(ChoiceBackend(choice), walk).n_estimates
        for choice in (ComputeChoice(theta=0.0), ComputeChoice(theta=10.0))
    )
    assert eager == walk.n_places > base >= len(walk.positions)
    dimming = replace(walk, frames=[replace(f, srgb_u8=f.srgb_u8 // n) for n, f in enumerate(walk.frames, 1)])
    low, high = (walk_through(ChoiceBackend(ComputeChoice(theta=theta)), dimming) for theta in (0.01, 10.0))
    assert low.n_estimates > high.n_estimates


def test_projection_of_a_higher_order_begins_with_the_same_job_as_the_estimator():
    walk, choice = room_walk(1), ComputeChoice(estimator="projection", order=4)
    assert np.abs(lights_of(choice, walk)[:, 9:]).max() > 0
    assert np.abs(lights_of(replace(choice, order=2), walk)[:, 9:]).max() == 0


def test_only_the_steps_are_timed():
    ticks = iter(range(100))
    walked = walk_through(ChoiceBackend(ComputeChoice()), room_walk(3), clock=lambda: next(ticks))
    assert walked.frame_ms == 1000


def test_choices_are_told_apart_by_their_words():
    for is_quick in (True, False):
        choices = compute_choices(is_quick=is_quick)
        labels = [choice.label for choice in choices]
        assert len(set(labels)) == len(labels) and labels[0] == "base" and choices[-1] == EXHAUSTIVE
