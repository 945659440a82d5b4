"""How long a run will take: measured on a few renders, in proportion to its frames, and said in one sentence."""

import contextlib
import itertools
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from previs_runs import SMALL, counted_renders, walk
from scene_snapshot import nothing_changes

from xihe_blender.capture.all_around import N_VIEWS
from xihe_blender.capture.reference_probe import ProbeSettings
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.error_budget import N_SEEDS
from xihe_blender.previs.run_time import (
    N_SESSIONS,
    RenderTime,
    RunTime,
    format_run_time,
    pictures_needed,
    run_time_job,
)
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.estimators.projection import Projection


@pytest.mark.slow
def test_the_time_of_a_run_grows_with_its_frames_and_leaves_the_scene():
    scene = walk()
    with nothing_changes():
        frames = [tuple(range(1, n + 1)) for n in (2, 5)]
        (few, budget), (many, _) = (run_blocking(run_time_job(scene, replace(SMALL, frames=each))) for each in frames)
    assert all(0 < n < many.renders[kind][0] for kind, (n, _) in few.renders.items()) and len(few.renders) == 3
    assert few.renders["probe"][0] == 2  # Of the two positions in view, each in one frame for both.
    assert few.total_s > 0 and budget.total_s > 0
    # Nothing changes in this room: a look from each object and a ball serve for all frames.
    n_probes, (capture, look) = 3, (budget.renders[kind][1] for kind in ("capture", "look"))
    n_of_each = {"capture": 2, "look": (2 + n_probes) * N_VIEWS, "ball": n_probes}
    n_of_each["chain"] = n_probes * (N_SESSIONS * 2 + 2 * N_VIEWS * 2)
    assert {kind: n for kind, (n, _) in budget.renders.items()} == {k: N_SEEDS * n for k, n in n_of_each.items()}
    # A smaller picture takes less for its rays, and as long to have the scene ready.
    assert look == replace(capture, per_sample_s=capture.per_sample_s * 24 / 32)


@pytest.mark.slow
def test_it_can_be_stopped_after_each_frame_of_the_survey_each_capture_and_each_picture_of_a_light_probe():
    scene = walk()
    with counted_renders() as renders:
        n_done = [Counter(renders) for _ in run_time_job(scene, replace(SMALL, frames=(1, 2, 3)))]
    steps = [after - before for before, after in itertools.pairwise(n_done)]
    captured = [step["Xihe Capture"] for step in steps]
    assert max(captured) == 1 < sum(captured)
    pictures = [step["Xihe Reference Probe"] for step in steps]
    assert max(pictures) == 1 < sum(pictures)
    assert [step["Xihe Effects"] for step in steps][:3] == [1, 1, 1]


@pytest.mark.slow
def test_a_run_of_the_true_light_has_a_time_too():
    time, budget = run_blocking(run_time_job(walk(), replace(SMALL, frames=(1,), estimator="truth")))
    assert time.total_s > 0 and "chain" not in budget.renders


@pytest.mark.slow
def test_the_chain_of_an_error_budget_is_timed_where_something_is_estimated(monkeypatch):
    scene, estimated = walk(), []
    virtual_collection(scene).all_objects[0].location.z = -50
    monkeypatch.setattr(Projection, "_estimate", lambda *_: estimated.append(1) or np.zeros((9, 3)))
    run_blocking(run_time_job(scene, replace(SMALL, frames=(1,), estimator="projection")))
    assert estimated


@pytest.mark.slow
def test_a_run_that_never_sees_its_object_has_a_time_too():
    scene = walk()
    for item in virtual_collection(scene).all_objects:
        item.location.z = -50
    time, _ = run_blocking(run_time_job(scene, replace(SMALL, frames=(1, 2))))
    assert time.renders["probe"][0] == time.renders["comparison"][0] == 0 < time.renders["capture"][0]
    assert time.total_s > 0


def test_an_edge_server_is_not_asked_as_nothing_is_estimated():
    job = run_time_job(walk(), replace(SMALL, frames=(1,), backend="http://127.0.0.1:9"))
    with contextlib.closing(job):
        assert next(job), "at port 9 nobody answers"


def test_a_run_of_more_frames_takes_longer_in_proportion():
    of_each = {"capture": (3, RenderTime(0.1, 0.01, 10)), "comparison": (2, RenderTime(1.0, 0.5, 8))}
    one = RunTime(2.0, of_each)
    assert one.total_s == pytest.approx(2 + 3 * 0.2 + 2 * 5)
    double = replace(one, renders={kind: (2 * n, time) for kind, (n, time) in of_each.items()})
    assert double.total_s - 2 == pytest.approx(2 * (one.total_s - 2))


@pytest.mark.parametrize(
    ("noise", "target", "pictures"),
    [(0.01, 0.02, 6), (0.03, 0.02, 13.5), (0.2, 0.02, 24), (None, 0.02, 24), (0.1, None, 24)],
)
def test_a_light_probe_takes_as_many_pictures_as_its_noise_asks_for(noise, target, pictures):
    assert pictures_needed(6, noise, ProbeSettings(max_samples=24, noise_target=target)) == pytest.approx(pictures)


@pytest.mark.parametrize(("seconds", "words"), [(0.3, "5 s"), (170, "3 min"), (3200, "53 min"), (5000, "1 h 20 min")])
def test_the_time_is_said_in_round_numbers(seconds, words):
    assert format_run_time(seconds) == f"about {words}"
