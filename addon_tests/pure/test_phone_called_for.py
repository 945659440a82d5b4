"""Each effect with a session that calls for it and one that does not."""

import dataclasses

import numpy as np
import pytest

from xihenet.phone import EFFECTS, LINKS, PhoneCamera, SessionFacts, load_profile, plan_phone, profile_names
from xihenet.phone.called_for import calls_for_network, calls_for_rolling_shutter
from xihenet.phone.motion import motion_between, read_rows
from xihenet.records import Intrinsics, RgbdFrame

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
    "dark_holes": {"darkest_grey": 0.02},
    "glossy_holes": {"smoothest_roughness": 0.0},
    "transparent_holes": {"highest_transmission": 1.0},
    "grazing_holes": {"steepest_deg": 88},
    "span_holes": {"widest_step_m": 1.5},
    "pose_drift": {"fastest_m_per_s": 0.5, "duration_s": 60},
    "light_sensor": {"light_changes": True},
}


def device_with(effect):
    return load_profile("azure_kinect" if effect in {"quantisation", "span_holes"} else "ipad_pro_lidar")


def planned(facts, effect, profile=None):
    return {state.name: state for state in plan_phone(facts, profile or device_with(effect))}[effect]


@pytest.mark.parametrize("effect", EFFECTS)
def test_each_effect_is_on_where_it_is_called_for_and_off_where_not(effect):
    called = planned(dataclasses.replace(CALM, **CALLING[effect]), effect)
    calm = planned(CALM, effect)
    assert (called.state, calm.state) == ("on", "off")
    assert called.reason != calm.reason


@pytest.mark.parametrize("name", ["ipad_pro_lidar", "azure_kinect"])
def test_a_calm_session_calls_for_nothing(name):
    assert {state.state for state in plan_phone(CALM, load_profile(name))} == {"off"}


@pytest.mark.parametrize("name", profile_names())
def test_a_session_of_which_nothing_is_known_leaves_every_effect_on(name):
    profile = load_profile(name)
    states = plan_phone(SessionFacts(), profile)
    assert {state.name for state in states if state.state == "on"} == profile.effects
    assert all("known" in state.reason for state in states if state.state == "on")


@pytest.mark.parametrize("name", profile_names())
def test_the_plan_names_every_effect_once_with_a_reason_in_words(name):
    states = plan_phone(CALM, load_profile(name))
    assert [state.name for state in states] == list(EFFECTS)
    assert all(" " in state.reason and "_" not in state.reason for state in states)


def test_the_users_choice_wins_and_is_named():
    states = {s.name: s for s in plan_phone(CALM, load_profile("ipad_pro_lidar"), {"noise": "on", "range": "auto"})}
    assert (states["noise"].state, states["noise"].reason) == ("on", "set by the user")
    assert states["range"].state == "off" and states["range"].reason != "set by the user"
    loud = dataclasses.replace(CALM, farthest_m=9)
    assert {s.name: s.state for s in plan_phone(loud, load_profile("ipad_pro_lidar"), {"range": "off"})}[
        "range"
    ] == "off"


@pytest.mark.parametrize(
    ("choices", "says"),
    [
        ({"smell": "on"}, "no effect smell"),
        ({"noise": "maybe"}, "noise: expected auto, on or off"),
        ({"pose_drift": "on"}, "Azure Kinect does not have it"),
    ],
)
def test_a_choice_that_cannot_be_is_refused(choices, says):
    with pytest.raises(ValueError, match=says):
        plan_phone(CALM, load_profile("azure_kinect"), choices)


def test_a_room_of_three_metres_needs_no_range_cut_and_the_cut_would_change_nothing():
    profile = load_profile("ipad_pro_lidar")
    assert planned(CALM, "range").state == "off"
    z = np.random.default_rng(0).uniform(1, 3, (20, 20))
    frame = RgbdFrame(np.zeros((20, 20, 3), np.uint8), z, Intrinsics(20, 20, 20, 20, 10, 10), np.eye(4))
    seen = PhoneCamera(profile, 0, effects={"range"}).see(frame)
    assert seen.plane_depth_m.tobytes() == frame.plane_depth_m.tobytes()


@pytest.mark.parametrize("speed_m_per_s", [0.0, 0.05, 0.1, 0.5, 2.0])
@pytest.mark.parametrize("turn_deg_per_s", [0.0, 1.0, 5.0, 60.0])
def test_where_rolling_shutter_is_left_out_no_row_shifts_by_a_pixel(speed_m_per_s, turn_deg_per_s):
    facts = dataclasses.replace(CALM, fastest_m_per_s=speed_m_per_s, fastest_turn_deg_per_s=turn_deg_per_s)
    shutter = load_profile("ipad_pro_lidar").sections["rolling_shutter"]
    columns = np.broadcast_to(np.arange(200, dtype=np.uint8)[None, :, None], (40, 200, 3))
    frame = RgbdFrame(columns.copy(), np.full((40, 200), 1.0), Intrinsics(200, 40, 200, 200, 100, 20), np.eye(4))
    later = np.eye(4)
    angle = np.radians(turn_deg_per_s)
    later[:3, :3] = [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    later[0, 3] = speed_m_per_s
    read, _ = read_rows(frame, motion_between(np.eye(4), later, 1.0), shutter)
    shift = np.abs(read.srgb_u8[:, 60:140, 0].astype(int) - columns[:, 60:140, 0])
    is_on, reason = calls_for_rolling_shutter(facts, shutter)
    assert "pixels" in reason or "does not move" in reason
    assert is_on or shift.max() <= 1


def test_the_network_matters_only_while_something_changes():
    assert calls_for_network(CALM, None) == (False, "the phone estimates by itself")
    assert not calls_for_network(CALM, LINKS["lte"])[0]
    changing = dataclasses.replace(CALM, light_changes=True)
    assert calls_for_network(changing, LINKS["lte"]) == (
        True,
        "estimates arrive some 79 ms after the frame they are of",
    )
    assert calls_for_network(SessionFacts(), LINKS["lte"])[0]
