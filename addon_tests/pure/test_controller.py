"""The chain of a session, driven with frames made of a painted sphere around the phone."""

from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.made import UPRIGHT, about_z, frame_of, pose_of
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.buffers import merge
from xihenet.camera import unproject_frame
from xihenet.codec import encode_cloud
from xihenet.controller import MOVED_M, ControllerSettings, XiheController
from xihenet.io.recording import ReplayScanner
from xihenet.records import Intrinsics
from xihenet.sampling import sample_unit_sphere
from xihenet.trigger import TriggerSettings

N = 320
CAMERA = Intrinsics(48, 36, 30.0, 30.0, 24.0, 18.0)


def looking(yaw, level=0.5, frame=0, exposure=1.0):
    """The phone at the origin, turned by `yaw` about +Z from looking along +Y, sees a wall 3 m away."""
    taken = {"exposure": exposure, "ambient": [level] * 3, "time_s": frame / 30, "frame": frame}
    return frame_of(np.full((36, 48), 3.0), CAMERA, pose_of(about_z(yaw) @ UPRIGHT), round(255 * level), **taken)


def session(estimator="projection", **settings):
    controller = XiheController(LocalBackend(estimators.load(estimator, N)), ControllerSettings(**settings))
    controller.add_position("Vase", (0, 1.5, 0))
    return controller


def test_the_chain_equals_its_stages_called_by_hand():
    controller, frame = session(), looking(0.0)
    report = controller.step(frame)["Vase"]
    cloud = sample_unit_sphere(unproject_frame(frame), (0, 1.5, 0), controller.lattice)
    assert report.decision.reason == "first"
    assert report.payload_bytes == len(encode_cloud(cloud, "uint8_float16_facing_stripped")) > 0
    assert report.coverage == cloud.is_set.mean()
    np.testing.assert_array_equal(report.estimate.sh_radiance, estimators.load("projection", N).estimate(cloud))
    assert list(report.stage_ms) == ["unproject", "sample", "merge", "trigger", "encode", "estimate"]


class NeverFinite:
    name, n_anchors = "never finite", N

    def estimate(self, cloud, context=None):
        return np.full((9, 3), np.nan)


def test_others_say_of_the_same_cloud_what_they_would_alone_and_one_that_does_not_know_is_left_out():
    others = [LocalBackend(estimators.load("lattice", N)), NeverFinite()]
    controller = XiheController(LocalBackend(estimators.load("projection", N)), others=others)
    controller.add_position("Vase", (0, 1.5, 0))
    alone = session("lattice").step(looking(0.0))["Vase"]
    report = controller.step(looking(0.0))["Vase"]
    assert list(report.estimate.others) == ["lattice"] and report.stage_ms.keys() == alone.stage_ms.keys()
    np.testing.assert_array_equal(report.estimate.others["lattice"], alone.estimate.sh_radiance)
    assert alone.estimate.others == {}


def test_an_unchanged_view_costs_no_estimate():
    controller = session()
    first = controller.step(looking(0.0))["Vase"].estimate
    again = controller.step(looking(0.0, frame=1))["Vase"]
    assert not again.decision.fire and again.estimate is None and again.payload_bytes == 0
    assert "estimate" not in again.stage_ms
    assert controller.light("Vase") is first


def test_a_change_of_light_makes_a_new_estimate():
    controller = session(trigger=TriggerSettings(theta=0.05))
    controller.step(looking(0.0, level=0.2))
    report = controller.step(looking(0.0, level=0.9))["Vase"]
    assert report.decision.reason == "colour"
    assert controller.light("Vase").sh_radiance[0].mean() > 5 * 0.2**2.2


def test_an_estimate_is_made_from_everything_seen_so_far():
    controller = session(trigger=TriggerSettings(coverage_theta=0.01))
    frames = [looking(yaw, frame=k) for k, yaw in enumerate((0.0, 0.25, -0.25))]
    clouds = []
    for frame in frames:
        estimate = controller.step(frame)["Vase"].estimate
        clouds.append(sample_unit_sphere(unproject_frame(frame), (0, 1.5, 0), controller.lattice))
        merged = clouds[0]
        for cloud in clouds[1:]:
            merged = merge(merged, cloud)
        np.testing.assert_array_equal(estimate.sh_radiance, estimators.load("projection", N).estimate(merged))
        assert estimate.coverage == merged.is_set.mean()


def test_a_position_out_of_view_costs_nothing_and_keeps_its_light():
    controller = session()
    light = controller.step(looking(0.0))["Vase"].estimate
    assert controller.step(looking(np.pi, frame=1)) == {} == controller.out_of_view_ms
    assert controller.light("Vase") is light


def test_a_position_out_of_view_learns_where_it_is_told_to_and_changes_its_light_once_it_is_seen():
    controller = session(learns_out_of_view=True, trigger=TriggerSettings(coverage_theta=0.01))
    light = controller.step(looking(0.0))["Vase"].estimate
    away = looking(np.pi, level=0.9, frame=1)
    assert controller.step(away) == {} and controller.out_of_view_ms.keys() == {"unproject", "sample", "merge"}
    assert controller.light("Vase") is light and controller.coverage("Vase") > light.coverage
    report = controller.step(looking(0.0, frame=2))["Vase"]
    seen = [sample_unit_sphere(unproject_frame(one), (0, 1.5, 0), controller.lattice) for one in (looking(0.0), away)]
    assert report.decision.reason == "coverage" and report.estimate.coverage == merge(*seen).is_set.mean()
    assert controller.out_of_view_ms == {}
    np.testing.assert_array_equal(
        report.estimate.sh_radiance, estimators.load("projection", N).estimate(merge(merge(*seen), seen[0]))
    )


def test_positions_are_independent():
    alone, together = session(), session()
    together.add_position("Lamp", (0.4, 2.0, 0.2))
    for k, yaw in enumerate((0.0, 0.1, 0.2)):
        one, both = alone.step(looking(yaw, frame=k)), together.step(looking(yaw, frame=k))
        assert list(both) == ["Vase", "Lamp"]
        assert both["Vase"].decision == one["Vase"].decision
        assert "unproject" not in both["Lamp"].stage_ms


def test_a_change_of_the_cameras_exposure_alone_does_not_fire():
    controller = session(trigger=TriggerSettings(theta=0.001))
    controller.step(looking(0.0, level=0.5, exposure=1.0))
    # Half the exposure: the same light gives half the linear value, 0.2140 / 2, which is 0.3613 encoded.
    report = controller.step(looking(0.0, level=0.3613, exposure=0.5))["Vase"]
    assert not report.decision.fire and report.decision.change < 1e-4


def test_estimate_at_any_position_leaves_the_session_alone():
    controller = session()
    with pytest.raises(ValueError, match="no frame yet"):
        controller.estimate_at((0, 1, 0))
    controller.step(looking(0.0))
    there = controller.estimate_at((0.1, 1.2, 0))
    assert there.is_valid and there.estimator == "projection" and there.exposure == 1.0
    assert not controller.step(looking(0.0, frame=1))["Vase"].decision.fire


def test_a_recording_holds_the_frames_between_its_start_and_its_end(tmp_path):
    controller = session()
    controller.start_recording(tmp_path / "walk")
    frames = [looking(0.1 * k, level=0.3 + 0.1 * k, frame=k) for k in range(4)]
    for frame in frames:
        controller.step(frame)
    assert controller.stop_recording() == 4 and controller.stop_recording() == 0
    controller.step(looking(0.0))
    for kept, frame in zip(ReplayScanner(tmp_path / "walk"), frames, strict=True):
        assert kept.frame == frame.frame and np.array_equal(kept.srgb_u8, frame.srgb_u8)


@pytest.mark.parametrize("wrong", [(0, 0), (0, 0, np.nan), "here"])
def test_a_position_that_is_no_point_is_refused(wrong):
    with pytest.raises(ValueError, match=r"^position_m: expected three finite numbers, got "):
        session().add_position("Vase", wrong)


def test_a_position_stays_where_it_is_while_its_callers_array_changes():
    controller, place_m = session(), np.array([0, 1.5, 0])
    controller.move_position("Vase", place_m)
    controller.step(looking(0.0))
    place_m[0] = 0.2
    assert controller.positions["Vase"].tolist() == [0, 1.5, 0]
    with pytest.raises(ValueError, match="read-only"):
        controller.positions["Vase"][0] = 0.2
    controller.move_position("Vase", place_m)
    assert controller.step(looking(0.0, frame=1))["Vase"].decision.reason == "moved"


def test_no_position_means_no_work():
    controller = XiheController(LocalBackend(estimators.load("projection", N)))
    assert controller.step(looking(0.0)) == {}


def test_a_position_that_moves_asks_for_its_light_once_something_is_seen_and_keeps_what_it_knows_of_the_room():
    controller = session()
    first = controller.step(looking(0.0))["Vase"]
    controller.move_position("Vase", (0.015, 1.5, 0))
    assert not controller.step(looking(0.0, frame=1))["Vase"].decision.fire, "nobody sees so small a step"
    controller.move_position("Vase", (0.2, 1.5, 0))
    nothing = replace(looking(0.5, frame=2), plane_depth_m=np.zeros((36, 48), np.float32))
    assert not controller.step(nothing)["Vase"].decision.fire
    moved = controller.step(looking(0.5, frame=3))["Vase"]
    assert moved.decision.fire and moved.coverage > first.coverage
    controller.move_position("Vase", (0.2, 1.4, 0))
    again = controller.step(looking(0.5, frame=4))["Vase"].decision
    assert again.reason == "moved" and again.change == pytest.approx(0.1) and again.threshold == MOVED_M
    assert not controller.step(looking(0.5, frame=5))["Vase"].decision.fire
