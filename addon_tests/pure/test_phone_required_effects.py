"""Each effect of the phone with a session that requires it and one that does not."""

import dataclasses

import numpy as np
import pytest

from addon_tests.pure.made import frame_of, pose_of
from xihenet.effects import names_that_are_on, plan_effects
from xihenet.phone import EFFECTS, LINKS, PHONE_EFFECTS, SessionFacts, load_profile, profile_names
from xihenet.phone.motion import motion_between, read_rows
from xihenet.records import Intrinsics

CALM = SessionFacts(
    frame_rate_hz=24, duration_s=10, focal_px=200, nearest_m=1.0, farthest_m=3.0, clearance_m=2.5, fastest_m_per_s=0.0,
    fastest_turn_deg_per_s=0.0, widest_step_m=0.0, darkest_grey=0.3, smoothest_roughness=0.5, highest_transmission=0.0,
    steepest_deg=60, brightness_change_stops=0.0, light_changes=False,
)  # fmt: skip

CALLING = {
    "frame_rate": {"frame_rate_hz": 120},
    "rolling_shutter": {"fastest_turn_deg_per_s": 90},
    "auto_exposure": {"brightness_change_stops": 2.0},
    "edge_bleeding": {"widest_step_m": 0.5},
    "noise": {"clearance_m": 0.05},
    "range": {"farthest_m": 7.0},
    "quantisation": {"clearance_m": 0.01},
    "dark_dropout": {"darkest_grey": 0.02},
    "glossy_dropout": {"smoothest_roughness": 0.0},
    "transparent_dropout": {"highest_transmission": 1.0},
    "grazing_dropout": {"steepest_deg": 88},
    "span_dropout": {"widest_step_m": 1.5},
    "pose_drift": {"fastest_m_per_s": 0.5, "duration_s": 60},
    "light_sensor": {"light_changes": True},
}


def device_with(effect):
    return load_profile("azure_kinect" if effect in {"quantisation", "span_dropout"} else "ipad_pro_lidar")


def required(facts, effect, profile=None):
    return (profile or device_with(effect)).required_effects(facts)[effect]


@pytest.mark.parametrize("effect", EFFECTS)
def test_each_effect_is_required_by_a_session_that_shows_it_and_by_no_other(effect):
    shown = required(dataclasses.replace(CALM, **CALLING[effect]), effect)
    calm = required(CALM, effect)
    assert (shown.is_required, calm.is_required) == (True, False)
    assert shown.reason != calm.reason


@pytest.mark.parametrize("name", profile_names())
def test_a_session_of_which_nothing_is_known_leaves_every_effect_on(name):
    profile = load_profile(name)
    effects = plan_effects(profile.required_effects(SessionFacts()), {})
    assert names_that_are_on(effects) == profile.effects
    assert all("known" in effects[name].reason for name in profile.effects)


@pytest.mark.parametrize("name", profile_names())
def test_the_plan_names_every_effect_once_with_a_reason_in_words(name):
    found = load_profile(name).required_effects(CALM)
    assert list(found) == list(PHONE_EFFECTS)
    assert all(" " in one.reason and "_" not in one.reason for one in found.values())


def test_an_effect_that_the_device_lacks_cannot_be_switched_on():
    found = load_profile("azure_kinect").required_effects(CALM)
    assert found["pose_drift"].reason == "Azure Kinect does not have it"
    effect = plan_effects(found, {"pose_drift": "on"})["pose_drift"]
    assert (effect.state, effect.origin, effect.is_switchable, effect.parameters) == ("off", "auto", False, {})


@pytest.mark.parametrize("speed_m_per_s", [0.0, 0.05, 0.1, 0.5, 2.0])
@pytest.mark.parametrize("turn_deg_per_s", [0.0, 1.0, 5.0, 60.0])
def test_where_rolling_shutter_is_left_out_no_row_shifts_by_a_pixel(speed_m_per_s, turn_deg_per_s):
    facts = dataclasses.replace(CALM, fastest_m_per_s=speed_m_per_s, fastest_turn_deg_per_s=turn_deg_per_s)
    shutter = load_profile("ipad_pro_lidar").sections["rolling_shutter"]
    columns = np.broadcast_to(np.arange(200, dtype=np.uint8)[None, :, None], (40, 200, 3))
    frame = frame_of(np.ones((40, 200)), Intrinsics(200, 40, 200, 200, 100, 20), srgb_u8=columns)
    c, s = np.cos(np.radians(turn_deg_per_s)), np.sin(np.radians(turn_deg_per_s))
    later = pose_of([[c, 0, -s], [0, 1, 0], [s, 0, c]], [speed_m_per_s, 0, 0])
    read, _ = read_rows(frame, motion_between(np.eye(4), later, 1.0), shutter)
    shift = np.abs(read.srgb_u8[:, 60:140, 0].astype(int) - columns[:, 60:140, 0])
    is_on, reason = shutter.required_by(facts)
    assert "pixels" in reason or "does not move" in reason
    assert is_on or shift.max() <= 1


def network(facts, link):
    found = load_profile("ipad_pro_lidar").required_effects(facts, link)["network"]
    return found.is_required, found.reason


def test_the_network_matters_only_while_something_changes():
    assert network(CALM, None) == (False, "the phone estimates by itself")
    assert not network(CALM, LINKS["lte"])[0]
    changing = dataclasses.replace(CALM, light_changes=True)
    assert network(changing, LINKS["lte"]) == (True, "estimates arrive some 79 ms after the frame they are of")
    assert network(SessionFacts(), LINKS["lte"])[0]
