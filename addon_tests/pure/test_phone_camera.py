"""The whole phone: the same bytes in any order, nothing when off, and every lost pixel counted."""

from dataclasses import replace

import numpy as np
import pytest

from xihenet.camera import encode_exposed, valid_plane_depth
from xihenet.phone import EFFECTS, CameraMotion, PhoneCamera, PhoneProfile, SurfaceFacts, load_profile, profile_names
from xihenet.phone.camera_chain import DROPOUTS
from xihenet.phone.depth import RangeLimits
from xihenet.phone.depth_dropout import DepthDropout
from xihenet.records import Intrinsics, RgbdFrame

MOTION = CameraMotion(np.array([0.5, 0, 0]), np.array([0, 0, 0.6]))
CAMERA = Intrinsics(64, 48, 50.0, 50.0, 32.0, 24.0)


def frame_of(number, size=(48, 64), ambient=(1.0, 0.9, 0.7)):
    """A wall with a box before it, holes and misses; every frame another picture."""
    rng = np.random.default_rng(100 + number)
    height, width = size
    z = np.full(size, 3.0) + rng.uniform(0, 0.01, size)
    z[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3] = 1.2
    z.reshape(-1)[1 :: max(z.size // 40, 7)] = rng.choice([0, np.nan, np.inf, 1e10])
    z[: height // 6] = 6.0
    colour = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
    intrinsics = CAMERA if size == (48, 64) else Intrinsics(width, height, 50.0, 50.0, width / 2, height / 2)
    return RgbdFrame(colour, z, intrinsics, np.eye(4), 0.5, np.array(ambient), time_s=0.1 * number, frame=number)


def test_every_depth_dropout_has_its_turn():
    assert sorted(DROPOUTS) == sorted(name for name, kind in EFFECTS.items() if issubclass(kind, DepthDropout))


def as_bytes(frame):
    return (
        frame.srgb_u8.tobytes(), frame.plane_depth_m.tobytes(), frame.world_from_camera.tobytes(),
        frame.exposure, frame.ambient.tobytes(), frame.time_s, frame.frame,
    )  # fmt: skip


def followed(camera, n=8):
    frames = [frame_of(i) for i in range(n)]
    metered = 0.5 * 2.0 ** np.linspace(0, 1, n)
    light = np.array([f.ambient for f in frames])
    return camera.follow(range(n), [f.time_s for f in frames], metered=metered, ambient=light, reference=0.5)


@pytest.mark.parametrize("name", profile_names())
def test_a_phone_with_nothing_on_gives_the_very_frame(name):
    frame = frame_of(1)
    assert PhoneCamera(load_profile(name), 3, effects=()).see(frame, motion=MOTION)[0] is frame


@pytest.mark.parametrize("effect", [effect for effect in EFFECTS if effect != "frame_rate"])
def test_every_effect_has_its_turn(effect):
    """All but the frame rate, which decides what frames there are."""
    profile = next(one for one in map(load_profile, profile_names()) if effect in one.effects)
    camera, frame = PhoneCamera(profile, 3, effects={effect}), frame_of(6)
    none, all_of_it = np.zeros((48, 64), np.float32), np.ones((48, 64), np.float32)
    turned_away = np.broadcast_to(np.float32([1, 0, 0]), (48, 64, 3))
    facts = SurfaceFacts(turned_away, roughness=none, transmission=all_of_it, reflectance=none)
    fast = CameraMotion(np.array([2.0, 0, 0]), np.array([0, 0, 6.0]))
    seen, _ = camera.see(frame, facts=facts, motion=fast, track=followed(camera))
    assert as_bytes(seen) != as_bytes(frame)


@pytest.mark.parametrize("name", profile_names())
@pytest.mark.parametrize("size", [(48, 64), (1, 1), (1, 7), (5, 1)])
def test_any_effect_alone_changes_nothing_that_is_not_its_own(name, size):
    profile, frame = load_profile(name), frame_of(2, size)
    before = as_bytes(frame)
    colour = {"rolling_shutter", "auto_exposure"}
    for effect in profile.effects:
        seen = PhoneCamera(profile, 3, effects={effect}).see(frame, motion=MOTION)[0]
        assert seen.frame == frame.frame and seen.time_s == frame.time_s
        if effect not in colour:
            assert seen.srgb_u8.tobytes() == frame.srgb_u8.tobytes()
        if effect != "pose_drift":
            assert seen.world_from_camera.tobytes() == frame.world_from_camera.tobytes()
        if effect != "light_sensor":
            assert seen.ambient.tobytes() == frame.ambient.tobytes()
        if effect in {"light_sensor", "pose_drift", "auto_exposure", "frame_rate"}:
            assert seen.plane_depth_m.tobytes() == frame.plane_depth_m.tobytes()
    assert as_bytes(frame) == before


@pytest.mark.parametrize("name", ["ipad_pro_lidar", "azure_kinect"])
def test_frames_are_the_same_bytes_in_any_order_and_after_a_resume(name):
    profile = load_profile(name)
    first = PhoneCamera(profile, 7)
    track = followed(first)
    forwards = {i: as_bytes(first.see(frame_of(i), motion=MOTION, track=track)[0]) for i in range(8)}
    backwards = {i: as_bytes(first.see(frame_of(i), motion=MOTION, track=track)[0]) for i in reversed(range(8))}
    resumed = PhoneCamera(profile, 7)
    later = {i: as_bytes(resumed.see(frame_of(i), motion=MOTION, track=followed(resumed))[0]) for i in range(4, 8)}
    assert forwards == backwards
    assert later == {i: forwards[i] for i in range(4, 8)}


def test_seeds_and_frames_differ_and_negative_frame_numbers_are_legal():
    profile, frame = load_profile("ipad_pro_lidar"), frame_of(3)
    camera = PhoneCamera(profile, 1, effects={"noise"})
    numbered = {n: replace(frame, frame=n) for n in (-2, -1, 0, 1, 2)}
    pictures = {camera.see(f)[0].plane_depth_m.tobytes() for f in numbered.values()}
    assert len(pictures) == 5
    other = PhoneCamera(profile, 2, effects={"noise"}).see(frame)[0]
    assert other.plane_depth_m.tobytes() != camera.see(frame)[0].plane_depth_m.tobytes()


def test_switching_one_effect_off_leaves_the_luck_of_the_others():
    profile, frame = load_profile("ipad_pro_lidar"), frame_of(3)
    both = PhoneCamera(profile, 1, effects={"noise", "light_sensor"}).see(frame)[0]
    noise = PhoneCamera(profile, 1, effects={"noise"}).see(frame)[0]
    light = PhoneCamera(profile, 1, effects={"light_sensor"}).see(frame)[0]
    assert both.plane_depth_m.tobytes() == noise.plane_depth_m.tobytes()
    assert both.ambient.tobytes() == light.ambient.tobytes()


@pytest.mark.parametrize("name", ["ipad_pro_lidar", "azure_kinect"])
def test_every_pixel_that_is_lost_is_counted_once(name):
    size = (48, 64)
    rng = np.random.default_rng(0)
    facts = SurfaceFacts(
        roughness=rng.random(size).astype(np.float32) * 0.3, transmission=rng.random(size).astype(np.float32)
    )
    frame = frame_of(4)
    seen, n_lost = PhoneCamera(load_profile(name), 1).see(frame, facts=facts)
    n_valid, n_left = (np.count_nonzero(valid_plane_depth(one.plane_depth_m)) for one in (frame, seen))
    assert n_left == n_valid - sum(n_lost.values()) < 48 * 64
    assert n_lost["transparent_dropout"] == pytest.approx(0.5 * 48 * 64, rel=0.1)
    assert n_lost["range"] > 0


def test_nothing_beyond_the_range_arrives():
    seen = PhoneCamera(load_profile("azure_kinect"), 1).see(frame_of(1))[0]
    left = seen.plane_depth_m[valid_plane_depth(seen.plane_depth_m)]
    assert left.size and left.min() >= 0.5 and left.max() <= 3.86 + 0.0005


def test_noise_has_its_sigma_through_the_whole_chain():
    intrinsics = Intrinsics(256, 192, 210, 210, 128, 96)
    wall = RgbdFrame(np.full((192, 256, 3), 128, np.uint8), np.full((192, 256), 2.0), intrinsics, np.eye(4))
    camera = PhoneCamera(load_profile("ipad_pro_lidar"), 1)
    frames = [replace(wall, frame=i) for i in range(12)]
    errors = np.stack([camera.see(f)[0].plane_depth_m - 2 for f in frames])
    assert errors.std() == pytest.approx(0.01, rel=0.05)


def test_the_track_sets_exposure_and_radiance_makes_it_exact():
    camera = PhoneCamera(load_profile("ipad_pro_lidar"), 1, effects={"auto_exposure"})
    track = followed(camera)
    radiance = np.random.default_rng(1).uniform(0, 4, (48, 64, 3)).astype(np.float32)
    seen = camera.see(frame_of(6), radiance=radiance, track=track)[0]
    assert seen.exposure == track.exposure[6] > 0.5
    np.testing.assert_array_equal(seen.srgb_u8, encode_exposed(radiance, seen.exposure))


def test_a_devices_gain_says_nothing_about_its_first_reading():
    profile = load_profile("ipad_pro_lidar")
    first, late = (
        np.array([PhoneCamera(profile, seed, effects={"light_sensor"}).see(frame)[0].ambient[1] for seed in range(300)])
        for frame in (replace(frame_of(1), frame=n) for n in (0, 9))
    )
    # The gain is the same in both, so what is left is the noise of two readings.
    noise = first / late - 1
    assert abs(np.corrcoef(noise, late)[0, 1]) < 0.2
    assert noise.std() == pytest.approx(0.01 * np.sqrt(2), rel=0.2)


@pytest.mark.parametrize("effect", ["auto_exposure", "light_sensor"])
def test_a_track_without_the_frame_is_refused(effect):
    camera = PhoneCamera(load_profile("ipad_pro_lidar"), 1, effects={effect})
    with pytest.raises(ValueError, match="for frame 99; follow the whole session"):
        camera.see(frame_of(99), track=followed(camera))


def test_a_frame_without_an_ambient_sensor_stays_without():
    frame = replace(frame_of(1), ambient=None)
    assert PhoneCamera(load_profile("ipad_pro_lidar"), 1).see(frame)[0].ambient is None


def test_an_effect_that_the_device_does_not_have_is_refused():
    with pytest.raises(ValueError, match="Azure Kinect has no pose_drift"):
        PhoneCamera(load_profile("azure_kinect"), 1, effects={"pose_drift"})
    with pytest.raises(ValueError, match="seed of 0 or more"):
        PhoneCamera(load_profile("azure_kinect"), -1)


def test_a_profile_made_in_python_works_as_one_from_a_file():
    limits = RangeLimits(source="mine", nearest_m=0, farthest_m=2)
    seen = PhoneCamera(PhoneProfile("Mine", "A phone", {"range": limits}), 0).see(frame_of(1))[0]
    assert seen.plane_depth_m[24, 32] == np.float32(1.2)
    assert seen.plane_depth_m[24, 2] == 0
