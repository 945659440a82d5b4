"""Nothing is left out, clamped or unknown without a count and a reason, from the pixel to the light in use."""

import json
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from addon_tests.pure.made import UPRIGHT, about_z, frame_of, pose_of
from xihenet import estimators
from xihenet.backend import LocalBackend, as_inference_backend, estimate_light
from xihenet.camera import invalid_pixels, sound_plane_depth, unproject_frame, valid_plane_depth
from xihenet.codec import METHODS, decode_cloud, encode_cloud, n_clamped_distances
from xihenet.controller import XiheController
from xihenet.estimators import EstimateContext, Estimator
from xihenet.invalid import CLAMPED, LEFT_OUT, UNKNOWN, added, counted, format_reason, left_out
from xihenet.io.exr import exr_attributes, read_exr, write_exr
from xihenet.io.recording import load_frame, save_frame
from xihenet.phone import PhoneCamera, load_profile
from xihenet.records import Intrinsics, LightEstimate, PointCloud, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sampling_reference import sample_unit_sphere_reference
from xihenet.sphere import AnchorLattice

N = 64
WIDTH, HEIGHT = 8, 6
CAMERA = Intrinsics(WIDTH, HEIGHT, 5.0, 5.0, 4.0, 3.0)
LATTICE = AnchorLattice(N)
NASTY = [0.0, -0.0, -1.0, np.nan, np.inf, -np.inf, 1e10, 1e-30, 0.5, 2.0, 3e38]

plane_depths = arrays(np.float32, (HEIGHT, WIDTH), elements=st.sampled_from([np.float32(v) for v in NASTY]))
manifests = st.dictionaries(st.sampled_from([*LEFT_OUT, *CLAMPED, "range"]), st.integers(1, 60))


def frame(plane_depth_m=2.0, invalid=None, **changes):
    """The phone at the origin looking down."""
    plane_depth_m = np.broadcast_to(np.float32(plane_depth_m), (HEIGHT, WIDTH))
    return frame_of(plane_depth_m, CAMERA, invalid=invalid or {}, **changes)


@settings(max_examples=150, deadline=None)
@given(plane_depth_m=plane_depths, taken=manifests)
def test_reasons_add_up_to_the_invalid_pixels_whatever_a_frame_claims(plane_depth_m, taken):
    seen = frame(plane_depth_m, taken)
    n_invalid = np.count_nonzero(~valid_plane_depth(seen.plane_depth_m))
    reasons = invalid_pixels(seen)
    assert sum(reasons.values()) == n_invalid
    assert all(n > 0 for n in reasons.values()) and not CLAMPED.keys() & reasons.keys()
    assert all(n <= taken[r] for r, n in reasons.items() if r in taken and r == "range")
    assert json.loads(json.dumps(reasons, allow_nan=False)) == reasons


@settings(max_examples=60, deadline=None)
@given(plane_depth_m=plane_depths, x=st.sampled_from([0.0, 0.5, 1e39, -3e38]))
def test_every_point_of_a_frame_is_used_or_counted_as_the_plain_loop_counts_it(plane_depth_m, x):
    cloud = unproject_frame(frame(plane_depth_m))
    sampled = sample_unit_sphere(cloud, (x, 0, 0), LATTICE)
    assert sampled.invalid == sample_unit_sphere_reference(cloud, (x, 0, 0), LATTICE).invalid
    assert 0 <= sampled.n_invalid_points <= WIDTH * HEIGHT
    assert sampled.is_set.any() == (sampled.n_invalid_points < WIDTH * HEIGHT)


def test_each_reason_of_a_point_is_told():
    points = [[1, 0, 0], [0, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0], [3e38, 3e38, 0], [0, 1, 0]]
    colours = np.full((6, 3), 0.5)
    colours[5] = np.nan
    sampled = sample_unit_sphere(PointCloud(points, colours), (0, 0, 0), LATTICE)
    assert sampled.invalid == {"at_probe": 1, "colour_not_finite": 1, "too_far": 1, "not_finite": 2}
    assert sampled.n_invalid_points == 5 and sampled.is_set.sum() == 1


def test_what_a_frame_keeps_is_sound_and_what_it_does_not_is_told():
    plane_depth_m = np.float32([[2, 0, np.nan, 1e10, np.inf, -1, 2, 2, 2]])
    radiance = np.full((1, 9, 3), 0.5, np.float32)
    radiance[0, 6, 1], radiance[0, 7, 0], radiance[0, 8, 2], radiance[0, 1] = np.nan, -1, np.inf, np.nan
    kept_m, invalid = sound_plane_depth(plane_depth_m, radiance)
    np.testing.assert_array_equal(kept_m, np.float32([[2, np.nan, np.nan, 0, 0, 0, np.nan, 2, 2]]))
    assert left_out(invalid) == {"not_finite": 1, "no_surface": 2, "no_distance": 2, "colour_not_finite": 1}
    assert {r: n for r, n in invalid.items() if r in CLAMPED} == {"negative_colour": 1, "infinite_colour": 1}


@settings(max_examples=60, deadline=None)
@given(plane_depth_m=plane_depths)
def test_a_frame_that_was_made_sound_tells_the_same_reasons(plane_depth_m):
    kept_m, invalid = sound_plane_depth(plane_depth_m)
    assert invalid_pixels(frame(kept_m, invalid)) == invalid_pixels(frame(plane_depth_m)) == invalid


@pytest.mark.parametrize("name", ["ipad_pro_lidar", "iphone_lidar", "azure_kinect"])
def test_what_the_phone_takes_is_told_by_the_effect_that_took_it(name):
    plane_depth_m = np.full((HEIGHT, WIDTH), 2.0)
    plane_depth_m[0], plane_depth_m[1] = 0.0, 900.0
    phone = PhoneCamera(load_profile(name), 3)
    seen, n_lost = phone.see(frame(plane_depth_m, {"no_surface": WIDTH}, ambient=[1.0] * 3))
    assert sum(n_lost.values()) > 0
    assert invalid_pixels(seen) == counted(**n_lost) | {"no_surface": WIDTH}


@pytest.mark.parametrize("said", ["range 0", "range -1", "range 1.5", "range nan", "range", "3", "range 1, "])
def test_a_recorded_count_that_is_none_is_refused(tmp_path, said):
    path = tmp_path / "frame.exr"
    save_frame(path, frame())
    channels, header = read_exr(path), exr_attributes(path)
    write_exr(path, channels, attributes={**header, "invalid": said})
    if said == "range 1, ":
        assert load_frame(path).invalid == {"range": 1}
    else:
        with pytest.raises(ValueError, match=r"frame\.exr: not a recorded frame"):
            load_frame(path)


@pytest.mark.parametrize("method", METHODS)
def test_a_distance_is_counted_as_clamped_exactly_where_the_wire_changes_its_size(method):
    distance_m = np.float32([1e-30, 2.0**-25, 2.0**-24, 1.0, 65504.0, 7e4, 1e30, 0.0])
    is_set = np.ones(8, bool)
    cloud = UnitSphereCloud(np.full((8, 3), 0.5), distance_m, is_set)
    there = decode_cloud(encode_cloud(cloud, method), 8, method).distance_m
    changed = np.abs(there - distance_m) > 2.0**-11 * np.minimum(there, distance_m)
    assert n_clamped_distances(cloud) == changed.sum() == 5


def test_a_colour_without_a_distance_on_the_wire_is_counted():
    cloud = UnitSphereCloud(np.full((3, 3), 0.5), [1.0, 1.0, 1.0], [True] * 3)
    records = np.frombuffer(encode_cloud(cloud, "float32"), np.float32).reshape(3, 4).copy()
    records[1, 3] = 0
    decoded = decode_cloud(records.tobytes(), 3, "float32")
    assert decoded.invalid == {"colour_without_distance": 1} and decoded.is_set.tolist() == [True, False, True]


class Scripted(Estimator):
    """Gives one answer after the other."""

    name = "scripted"
    farthest_m = 1.5

    def __init__(self, answers):
        super().__init__(N)
        self.answers = iter(answers)

    def _estimate(self, cloud, context):
        return np.full((9, 3), next(self.answers))


def turned(yaw, plane_depth_m=2.0, number=0):
    """The phone looks past a position 1 m ahead, at another part of the wall for each yaw."""
    depths = np.full((HEIGHT, WIDTH), plane_depth_m)
    return frame_of(depths, CAMERA, pose_of(about_z(yaw) @ UPRIGHT), frame=number)


@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf])
def test_a_session_keeps_the_last_light_through_an_estimate_that_is_not_finite_and_says_so(broken):
    controller = XiheController(LocalBackend(Scripted([1.0, broken, 3.0])))
    controller.add_position("Ball", (0, 1, 0))
    reports = [controller.step(turned(yaw, number=i))["Ball"] for i, yaw in enumerate((0.0, 0.4, -0.4))]
    assert [report.decision.fire for report in reports] == [True] * 3
    assert [report.estimate.is_valid for report in reports] == [True, False, True]
    assert [report.unknown_because for report in reports] == ["", "estimate_not_finite", ""]
    assert not reports[1].estimate.sh_radiance.any()
    assert controller.light("Ball") is reports[2].estimate


def test_the_light_stays_that_of_before_while_nothing_is_known():
    controller = XiheController(LocalBackend(Scripted([1.0])))
    controller.add_position("Ball", (0, 1, 0))
    first = controller.step(turned(0.0))["Ball"].estimate
    blind = controller.step(turned(0.0, np.nan))["Ball"]
    assert (blind.unknown_because, blind.estimate, blind.decision.fire) == ("nothing_seen", None, False)
    assert blind.invalid == {"not_finite": WIDTH * HEIGHT}
    assert controller.light("Ball") is first


def test_distances_that_wire_or_network_take_for_others_are_counted_in_the_step():
    controller = XiheController(LocalBackend(Scripted([1.0])))
    controller.add_position("Ball", (0, 1, 0))
    report = controller.step(turned(0.0, 1e5))["Ball"]
    n_set = round(report.coverage * N)
    assert report.invalid == {"distance_on_wire": n_set, "distance_in_network": n_set}
    assert report.n_invalid_points == 0


@pytest.mark.parametrize("name", ["ambient", "projection", "lattice", "truth"])
def test_each_estimator_says_when_the_light_cannot_be_known(name):
    backend = LocalBackend(estimators.load(name, N))
    seen = UnitSphereCloud(np.full((N, 3), 0.5), np.ones(N), np.ones(N, bool))
    truth_sh = np.zeros((9, 3))
    blind, sensing = (EstimateContext(frame(np.nan, ambient=a), truth_sh=truth_sh) for a in (None, [0.2] * 3))
    known = [
        estimate_light(backend, cloud, context, 1.0).is_valid
        for cloud in (seen, UnitSphereCloud.empty(N))
        for context in (sensing, blind)
    ]
    assert known == [True, True, name in ("ambient", "truth"), name == "truth"]


class Answering:
    """A backend with nothing but what it must have."""

    name, n_anchors = "answering", N

    def __init__(self, answer):
        self.answer = answer

    def estimate(self, cloud, context=None):
        return self.answer


@settings(max_examples=60, deadline=None)
@given(
    answer=arrays(np.float64, (9, 3), elements=st.sampled_from([0.0, 1.0, -1e300, np.nan, np.inf])),
    is_seen=st.booleans(),
)
def test_any_answer_of_any_backend_becomes_a_light_that_is_finite_or_not_valid(answer, is_seen):
    cloud = UnitSphereCloud(np.zeros((N, 3)), np.full(N, float(is_seen)), np.full(N, is_seen))
    light = estimate_light(as_inference_backend(Answering(answer)), cloud, EstimateContext(), 1.0)
    assert light.is_valid == (is_seen and bool(np.isfinite(answer).all()))
    assert light.is_valid == (light.unknown_because == "")
    np.testing.assert_array_equal(light.sh_radiance, answer if light.is_valid else 0)


@pytest.mark.parametrize(("is_valid", "reason"), [(True, "nothing_seen"), (False, "no idea")])
def test_an_estimate_with_a_reason_that_does_not_fit_is_refused(is_valid, reason):
    with pytest.raises(ValueError, match=r"LightEstimate\.unknown_because"):
        LightEstimate(np.zeros((9, 3)), 1.0, 0.5, "none", is_valid, None, reason)


@given(st.lists(st.dictionaries(st.sampled_from([*LEFT_OUT, *CLAMPED, *UNKNOWN]), st.integers(1, 10**12))))
def test_counts_add_up_like_those_of_the_standard_library(counts):
    assert added(counts) == sum(map(Counter, counts), Counter())


def test_every_reason_has_words_and_an_effect_of_the_phone_its_name():
    reasons = [*LEFT_OUT, *CLAMPED, *UNKNOWN]
    assert len(set(reasons)) == len(reasons) == len({format_reason(reason) for reason in reasons})
    assert format_reason("dark_dropout") == "the phone's dark dropout"
    assert not set(reasons) & {
        effect for name in ("ipad_pro_lidar", "azure_kinect") for effect in load_profile(name).effects
    }
