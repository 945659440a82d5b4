"""Facts read from frames of known rooms, and that what they leave out takes no pixel away."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from addon_tests.pure import made
from addon_tests.pure.made import pose_of
from xihenet.phone import PhoneCamera, facts_of_frame, facts_of_session, load_profile
from xihenet.records import Intrinsics

CAMERA = Intrinsics(40, 30, 35.0, 35.0, 20.0, 15.0)
DROPOUTS = {"dark_dropout", "grazing_dropout", "span_dropout", "range", "glossy_dropout", "transparent_dropout"}


def facts_from_frames(frames, positions_m, **known):
    return facts_of_session([facts_of_frame(frame, positions_m) for frame in frames], **known)


def frame_of(plane_depth_m, *, colour=128, time_s=0.0, x=0.0, yaw_deg=0.0, number=0):
    pose = pose_of(Rotation.from_euler("y", yaw_deg, degrees=True).as_matrix(), [x, 0, 0])
    plane_depth_m = np.broadcast_to(plane_depth_m, (30, 40))
    return made.frame_of(plane_depth_m, CAMERA, pose, colour, exposure=0.5, time_s=time_s, frame=number)


def random_session(seed):
    """Walls, slopes, boxes and dark patches at random, seen while walking."""
    rng = np.random.default_rng(seed)
    frames = []
    for i in range(3):
        z = rng.uniform(0.3, 3) + np.linspace(0, rng.choice([0, 2.5]), 30)[:, None] + np.zeros((30, 40))
        if rng.random() < 0.5:
            z[8:18, 10:30] = rng.uniform(0.2, 1)
        frame = frame_of(z, colour=int(rng.integers(5, 200)), time_s=i / 10, x=0.01 * i, number=i)
        frames.append(frame)
    return frames


def test_a_plain_wall_has_the_facts_it_was_made_with():
    frames = [frame_of(2.0, time_s=i / 20, x=0.1 * i, yaw_deg=3 * i) for i in range(4)]
    facts = facts_from_frames(frames, [[0.0, 0, -1.5]], light_changes=False)
    assert (facts.nearest_m, facts.farthest_m, facts.widest_step_m) == (2.0, 2.0, 0.0)
    assert facts.frame_rate_hz == pytest.approx(20) and facts.duration_s == pytest.approx(0.15)
    assert facts.fastest_m_per_s == pytest.approx(2.0) and facts.fastest_turn_deg_per_s == pytest.approx(60)
    assert facts_from_frames(frames[:1], [[0.0, 0, -1.5]]).clearance_m == pytest.approx(0.5, abs=0.02)
    assert facts.darkest_grey == pytest.approx(128 / 255)
    assert facts.brightness_change_stops == 0 and facts.light_changes is False
    corner = np.degrees(np.arctan(np.hypot(19.5, 14.5) / 35))
    assert facts.steepest_deg == pytest.approx(corner, abs=0.1)
    assert facts.smoothest_roughness is None


def test_brightness_changes_are_counted_in_stops_of_light():
    linear_of = {188: 0.503, 137: 0.251}
    frames = [frame_of(2.0, colour=colour, time_s=i) for i, colour in enumerate(linear_of)]
    assert facts_from_frames(frames, []).brightness_change_stops == pytest.approx(1, abs=0.02)


def test_a_cut_by_half_a_turn_is_fast_and_no_error():
    frames = [frame_of(2.0), frame_of(2.0, time_s=0.1, yaw_deg=180)]
    assert facts_from_frames(frames, []).fastest_turn_deg_per_s == pytest.approx(1800)


def test_one_frame_knows_no_motion_and_an_empty_one_no_distance():
    facts = facts_from_frames([frame_of(0.0)], [[0, 0, 0]])
    assert facts.frame_rate_hz is None and facts.fastest_m_per_s is None
    assert facts.nearest_m is None and facts.farthest_m is None and facts.clearance_m is None
    with pytest.raises(ValueError, match="at least one frame"):
        facts_from_frames([], [])


def test_a_camera_beyond_all_numbers_knows_no_clearance_and_one_of_any_exposure_its_brightness():
    dark, bright = (replace(frame_of(2.0), exposure=exposure) for exposure in (1e-50, 1e50))
    assert facts_from_frames([dark, bright], []).brightness_change_stops == pytest.approx(np.log2(1e100))
    assert facts_from_frames([frame_of(2.0, x=1e39)], [[0, 0, 0]]).clearance_m is None


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, 1e10])
def test_invalid_pixels_are_no_surface(value):
    z = np.full((30, 40), 2.0)
    z[::3, ::4] = value
    facts = facts_from_frames([frame_of(z)], [[0, 0, 0]])
    assert (facts.nearest_m, facts.farthest_m, facts.widest_step_m) == (2.0, 2.0, 0.0)


def test_what_the_caller_knows_wins():
    facts = facts_from_frames([frame_of(2.0)], [], farthest_m=30.0, highest_transmission=0.0)
    assert facts.farthest_m == 30.0 and facts.highest_transmission == 0.0


@pytest.mark.parametrize("name", ["ipad_pro_lidar", "azure_kinect"])
@pytest.mark.parametrize("seed", range(12))
def test_an_effect_that_is_left_out_would_have_taken_no_pixel_away(name, seed):
    profile, frames = load_profile(name), random_session(seed)
    required = profile.required_effects(facts_from_frames(frames, [[0, 0, -1]]))
    left_out = {name for name, one in required.items() if not one.is_required} & profile.effects & DROPOUTS
    for effect in left_out:
        camera = PhoneCamera(profile, seed, effects={effect})
        for frame in frames:
            assert camera.see(frame)[0].plane_depth_m.tobytes() == frame.plane_depth_m.tobytes()


def test_the_random_sessions_both_call_for_effects_and_leave_them_out():
    profile = load_profile("azure_kinect")
    plans = [profile.required_effects(facts_from_frames(random_session(s), [[0, 0, -1]])) for s in range(12)]
    for effect in ("range", "span_dropout", "dark_dropout"):
        assert {plan[effect].is_required for plan in plans} == {True, False}
