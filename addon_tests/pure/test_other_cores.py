"""Light at many places of a kept path, on all cores: as one place after the other, whatever becomes of the helpers."""

import pickle
import sys
import threading
import time
from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.made import UPRIGHT, about_z, frame_of, pose_of
from xihenet import estimators
from xihenet.camera import unproject_frame
from xihenet.camera_path import other_cores
from xihenet.camera_path.kept_path import KeptPath, SeenFrame
from xihenet.camera_path.other_cores import AT_ONCE, find_light_on_all_cores, helper
from xihenet.controller import ControllerSettings
from xihenet.records import Intrinsics

CAMERA = Intrinsics(48, 36, 30.0, 30.0, 24.0, 18.0)
N_BATCHES = 3


def seen(frame):
    pose, colour = pose_of(about_z(0.7 * frame) @ UPRIGHT), np.full((36, 48, 3), 60 * (frame + 1), np.uint8)
    one = frame_of(np.full((36, 48), 3.0), CAMERA, pose, colour, time_s=frame / 30, frame=frame, ambient=[0.5] * 3)
    return SeenFrame(one, unproject_frame(one, reference_exposure=1.0), (CAMERA, pose))


@pytest.fixture
def path():
    chain = ControllerSettings(reference_exposure=1.0, learns_out_of_view=True, between_estimates="carried")
    return KeptPath(tuple(map(seen, range(3))), chain, estimators.load("lattice", 320))


@pytest.fixture
def places():
    rng = np.random.default_rng(0)
    return {str(k): rng.uniform(-2, 2, 3) for k in range(AT_ONCE * N_BATCHES - 2)}


def finished(steps):
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def assert_same(found, expected):
    """To the last bit, though a helper has one thread and this process several."""
    assert list(found) == list(expected)
    for name, light in found.items():
        alone = expected[name]
        assert (light.coverage, light.was_in_view) == (alone.coverage, alone.was_in_view)
        for frame, sh in light.sh.items():
            np.testing.assert_array_equal(sh, alone.sh[frame])
        errors = [np.array(list(one.expected_error.values()), float) for one in (light, alone)]  # NaN for None
        np.testing.assert_array_equal(*errors)


@pytest.fixture
def one_after_the_other(path, places):
    return finished(path.find_light(places))


def test_a_helper_alone_finds_the_same_light(path, places, one_after_the_other):
    names, found = list(places), {}
    batches = deque(names[start : start + AT_ONCE] for start in range(0, len(names), AT_ONCE))
    with helper(pickle.dumps(path), places, batches, found) as thread:
        thread.join(60)
    assert not thread.is_alive()
    assert_same({name: found[name] for name in names}, one_after_the_other)


@pytest.mark.parametrize("n_helpers", [0, 2])
def test_with_helpers_nothing_changes(path, places, one_after_the_other, n_helpers):
    assert_same(finished(find_light_on_all_cores(path, places, n_helpers)), one_after_the_other)


@pytest.fixture
def helpers_run(monkeypatch, tmp_path):
    """Has helpers run some other lines of Python in place of their module."""

    def replace_by(lines):
        module = tmp_path.joinpath(*other_cores.__name__.split(".")).with_suffix(".py")
        module.parent.mkdir(parents=True)
        for package in (module.parent, module.parent.parent):
            (package / "__init__.py").touch()
        module.write_text(lines)
        monkeypatch.setattr(other_cores, "child_environment", lambda: {"PYTHONPATH": str(tmp_path)})

    return replace_by


@pytest.mark.parametrize("interpreter", ["/nowhere/python", sys.executable])
def test_helpers_that_cannot_work_leave_it_to_this_process(
    path, places, one_after_the_other, interpreter, monkeypatch, helpers_run
):
    monkeypatch.setattr(sys, "executable", interpreter)
    helpers_run("raise ImportError")
    assert_same(finished(find_light_on_all_cores(path, places, 1)), one_after_the_other)


TAKES_ALL = "threading.Thread(target=sys.stdin.buffer.read).start()"
IS_READY = "pickle.dump(True, sys.stdout.buffer); sys.stdout.flush()"


@pytest.mark.parametrize("does", ["pass", f"{TAKES_ALL}; {IS_READY}"])
def test_a_helper_that_never_answers_is_not_waited_for(path, places, one_after_the_other, does, helpers_run, tmp_path):
    begun = tmp_path / "begun"
    begins = f"pathlib.Path({str(begun)!r}).touch()"
    helpers_run(f"import pathlib, pickle, sys, threading, time; {does}; {begins}; time.sleep(600)")
    steps, until = find_light_on_all_cores(path, places, 1), time.monotonic() + 30
    next(steps)
    while not begun.exists():
        assert time.monotonic() < until
        time.sleep(0.01)  # A helper that is ready is given places at once.
    assert_same(finished(steps), one_after_the_other)


def test_an_estimator_that_cannot_be_sent_is_asked_here(path, places, one_after_the_other):
    path.estimator.held = threading.Lock()
    assert_same(finished(find_light_on_all_cores(path, places, 1)), one_after_the_other)


def test_what_is_closed_leaves_no_helper(path, places):
    others = set(threading.enumerate())
    steps = find_light_on_all_cores(path, places, 2)
    next(steps)
    assert set(threading.enumerate()) - others
    steps.close()
    assert not set(threading.enumerate()) - others


def test_few_places_start_no_process_and_none_is_no_light(path, places, monkeypatch):
    monkeypatch.setattr(other_cores, "helper", None)
    few = dict(list(places.items())[:2])
    assert_same(finished(find_light_on_all_cores(path, few)), finished(path.find_light(few)))
    assert finished(find_light_on_all_cores(replace(path, frames=()), {})) == {}
