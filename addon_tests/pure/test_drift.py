"""Gains of exposure and white balance: those that were put into walks through a room are found again."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from addon_tests.pure.furnished import as_measured, furniture, seen, walk_poses
from xihenet.camera import sensed_ambient
from xihenet.captures import drift as module
from xihenet.captures.capture import Capture, CapturedFrame
from xihenet.captures.drift import DriftFollower, follow_drift, steadied
from xihenet.captures.gain_graph import Pair, solve_gains
from xihenet.io.frame_files import FrameCamera


def drifting(rng, n, stops=1.5, white=0.25, sign=1):
    """(n, 3) a random walk of the exposure by up to so many stops, and of each channel by up to that share more."""
    exposure = np.cumsum(rng.normal(size=n))
    exposure -= exposure[0]
    exposure *= sign * stops / exposure[np.abs(exposure).argmax()]
    balance = np.cumsum(rng.normal(size=(n, 3)), axis=0)
    balance -= balance[0]
    balance *= np.log(1 + white) / np.abs(balance).max()
    return np.exp(np.log(2) * exposure[:, None] + balance)


def session(seed, gains, poses=None, noise=0.01, lit=None):
    """Frames with these gains (N, 3), of a walk; `lit` by index."""
    rng, boxes = np.random.default_rng(seed), furniture(seed)
    poses = walk_poses(seed, len(gains)) if poses is None else poses
    return [
        seen(pose, boxes, 5 + i, gain=gain, noise=noise, rng=rng, lit=lit and lit(i))
        for i, (pose, gain) in enumerate(zip(poses, gains, strict=True))
    ]


def worst(drift, gains):
    return np.abs(drift.gains / gains - 1).max()


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("seed", range(3))
def test_gains_are_found_again(seed, sign):
    gains = drifting(np.random.default_rng(seed), 30, sign=sign)
    found = follow_drift(session(seed, gains))
    assert found.is_known.all() and len(found) == 30 and found.frames.tolist() == list(range(5, 35))
    assert worst(found, gains) < 0.02
    assert np.median(np.abs(found.gains / gains - 1)) < 0.004 and found.residual.max() < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_gains_are_found_again_with_a_phones_depth_and_poses(seed):
    gains = drifting(np.random.default_rng(seed), 30)
    found = follow_drift(as_measured(session(seed, gains, noise=0.02), seed, 0.5))
    assert found.is_known.all() and worst(found, gains) < 0.04


@pytest.mark.parametrize("seed", range(3))
def test_a_session_that_does_not_drift_has_gains_of_1(seed):
    frames = session(seed, np.ones((20, 3)))
    found = follow_drift(frames)
    assert found.is_known.all() and worst(found, 1.0) < 0.01
    # Poses that are off by half a degree move shaded walls by their shading.
    found = follow_drift(as_measured(frames, seed, 0.5))
    assert found.is_known.all() and worst(found, 1.0) < 0.02


@pytest.mark.slow
def test_errors_do_not_add_up_along_a_long_walk():
    """200 frames, once around and back to the start."""
    gains = drifting(np.random.default_rng(0), 200)
    frames = as_measured(session(0, gains, walk_poses(0, 200, 2 * np.pi, 1.8)), 0, 0.5)
    found = follow_drift(frames)
    off = np.abs(found.gains / gains - 1)
    assert found.is_known.all() and off.max() < 0.03
    assert off[150:].mean() < 2 * off[:50].mean() + 0.005


def test_clipped_frames_are_not_known_and_those_around_them_are():
    gains = np.ones((12, 3))
    gains[4:6] = 40.0  # Nearly all of the room is white.
    gains[8] = 0.01  # And here black.
    found = follow_drift(session(1, gains, walk_poses(1, 12, 0.6, 1.1)))
    assert np.flatnonzero(~found.is_known).tolist() == [4, 5, 8] and found.n_unknown == 3
    assert worst(found, 1.0) < 0.01  # The unknown have the gain of the nearest.
    assert (found.n_samples[[4, 5, 8]] == 0).all() and np.isnan(found.residual[[4, 5, 8]]).all()


def test_a_blank_first_frame_is_no_reference():
    frames = session(1, np.ones((6, 3)))
    frames[0] = replace(frames[0], srgb_u8=np.zeros_like(frames[0].srgb_u8))
    found = follow_drift(frames)
    assert found.is_known.tolist() == [False] + [True] * 5 and worst(found, 1.0) < 0.01


def test_frames_that_share_nothing_keep_the_gain_nearest_in_time():
    gains = drifting(np.random.default_rng(2), 20)
    frames = session(2, gains)
    elsewhere = np.eye(4)
    elsewhere[0, 3] = 50.0
    away = [replace(frame, world_from_camera=elsewhere @ frame.world_from_camera) for frame in frames[12:]]
    found = follow_drift(frames[:12] + away)
    assert found.is_known.tolist() == [True] * 12 + [False] * 8 and found.n_unknown == 8
    assert (found.gains[12:] == found.gains[11]).all()
    assert np.abs(found.gains[:12] / gains[:12] - 1).max() < 0.02


def lamp(radius):
    """Two and a half times the light within a radius of a place at the wall, in metres."""
    at = np.array([1.5, 2.5, 1.2])
    return lambda points: 1 + 1.5 * (np.linalg.norm(points - at, axis=-1) < radius)


def lamp_goes_out(radius):
    poses = walk_poses(0, 24, 2 * np.pi, 1.5)[:12] * 2
    return follow_drift(session(0, np.ones((24, 3)), poses, lit=lambda i: lamp(radius) if i < 12 else None))


def test_a_lamp_that_lights_a_part_of_what_is_seen_is_no_drift():
    assert worst(lamp_goes_out(1.0), 1.0) < 0.01


def test_a_lamp_that_lights_most_of_what_is_seen_passes_for_drift():
    """A limit: the light of all surfaces changes alike, which is what an exposure does. The residual is large where
    another part of the room says otherwise."""
    assert lamp_goes_out(20.0).gains[12:] == pytest.approx(1 / 2.5, abs=0.03)
    found = lamp_goes_out(2.5)
    assert found.gains[12:].min() < 0.5 and found.residual.max() > 0.1


def without_depth(frame, value):
    return replace(frame, plane_depth_m=np.full_like(frame.plane_depth_m, value))


def test_a_steadied_recording_has_the_gains_in_its_white_balance_and_ambient_light_without_them():
    gains, own = drifting(np.random.default_rng(0), 4), np.array([1.0, 2.0, 4.0])
    frames = session(0, gains, walk_poses(0, 30)[:4])
    frames[2] = replace(frames[2], white_balance=own)
    frames = [replace(one, ambient=sensed_ambient(one.srgb_u8, 1.0)) for one in frames]
    moments = [
        CapturedFrame(n, 0.0, FrameCamera(one.intrinsics, one.world_from_camera, np.eye(3)), partial(replace, one))
        for n, one in enumerate(frames)
    ]
    steady, drift = steadied(Capture("", moments, np.eye(3)))
    assert worst(drift, 1.0) > 0.1
    for n, one in enumerate(steady):
        np.testing.assert_array_equal(one.white_balance, drift.gains[n] * (own if n == 2 else 1))
        np.testing.assert_array_equal(one.ambient, frames[n].ambient / drift.gains[n])


def test_no_frame_and_one_frame():
    found = follow_drift([])
    assert len(found) == 0 and found.gains.shape == (0, 3) and found.n_unknown == 0
    found = follow_drift(session(0, np.ones((1, 3))))
    assert found.gains.tolist() == [[1, 1, 1]] and found.is_known.tolist() == [True] and found.n_samples.tolist() == [0]


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -1.0, 1e-42, 1e10])
def test_frames_without_a_depth_are_not_known(value):
    frames = session(0, np.ones((6, 3)), walk_poses(0, 6, 0.5, 1.1))
    found = follow_drift([without_depth(frame, value) if i in (2, 5) else frame for i, frame in enumerate(frames)])
    assert found.is_known.tolist() == [True, True, False, True, True, False] and worst(found, 1.0) < 0.01
    found = follow_drift(without_depth(frame, value) for frame in frames)
    assert found.n_unknown == 5 and (found.gains == 1).all()


def test_the_answer_can_be_asked_for_at_any_time():
    gains = drifting(np.random.default_rng(1), 12)
    follower = DriftFollower()
    for i, frame in enumerate(session(1, gains)):
        follower.add(frame)
        assert worst(follower.drift(), gains[: i + 1]) < 0.02


def test_keyframes_are_few_however_long_the_session(monkeypatch):
    monkeypatch.setattr(module, "MOST_KEYFRAMES", 5)
    gains = drifting(np.random.default_rng(3), 60)
    follower = DriftFollower()
    for frame in session(3, gains, walk_poses(3, 60, 2 * np.pi, 1.8)):
        follower.add(frame)
        assert len(follower._keyframes) <= 5
    assert follower.drift().is_known.all() and worst(follower.drift(), gains) < 0.03


def test_the_gains_of_a_graph_are_those_of_a_dense_solution():
    """And one pair that contradicts all others is weighed down."""
    rng, n = np.random.default_rng(0), 40
    true = rng.normal(size=(n, 3))
    ends = [(i, i + 1) for i in range(n - 1)] + [tuple(sorted(rng.choice(n, 2, replace=False))) for _ in range(60)]
    pairs = [Pair(i, j, true[j] - true[i] + rng.normal(0, 0.004, 3), np.full(3, 0.01), 100) for i, j in ends]
    logs, is_known, _ = solve_gains(n, pairs)
    rows = np.zeros((len(pairs), n))
    rows[np.arange(len(pairs)), [pair.later for pair in pairs]] = 1
    rows[np.arange(len(pairs)), [pair.earlier for pair in pairs]] = -1
    dense = np.linalg.lstsq(rows[:, 1:], np.array([pair.log_ratio for pair in pairs]), rcond=None)[0]
    assert is_known.all() and np.abs(logs[1:] - dense).max() < 1e-4
    wrong = replace(pairs[-1], log_ratio=pairs[-1].log_ratio + 1.0)
    contradicted, _, residual = solve_gains(n, [*pairs[:-1], wrong])
    assert np.abs(contradicted - logs).max() < 0.03 and residual[wrong.later] > 0.1


@pytest.mark.parametrize("jump", [1.5, 3.0])
@pytest.mark.parametrize("seed", range(5))
def test_pairs_that_contradict_the_others_do_not_show_though_the_start_follows_them(seed, jump):
    """A quarter of the pairs between two halves of a session are wrong by the same: a lamp was moved."""
    rng, n = np.random.default_rng(seed), 80
    pairs = [
        Pair(
            i, j, rng.normal(size=3) * 0.01 + (jump if i < 40 <= j and rng.random() < 0.25 else 0), np.full(3, 0.02), 1
        )
        for i in range(n)
        for j in (i + 1, i + 2, i + 3, i + 7)
        if j < n
    ]
    assert np.abs(solve_gains(n, pairs)[0]).max() < 0.1
