"""What must hold at every numerical stage for any input that a record can hold; `make fuzz` tries more of it."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps

from addon_tests.fuzz import some_examples
from addon_tests.pure.hard_cases.hard_clouds import estimator
from addon_tests.pure.made import looked_at, pose_of
from xihenet.buffers import merge
from xihenet.camera import encode_exposed, project_points, unproject_frame
from xihenet.metrics import angular_error_deg, image_rmse, psnr, shc_rmse, si_rmse, ssim
from xihenet.phone.metering import metered_exposure
from xihenet.records import Intrinsics, PointCloud, RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sampling_reference import sample_unit_sphere_reference
from xihenet.sh import dering, irradiance, project_anchors, rotate
from xihenet.sphere import AnchorLattice
from xihenet.trigger import TriggerSettings, decide_trigger

N = 24
LATTICE = AnchorLattice(N)
WHITE = float(np.sqrt(4 * np.pi))
ANY32 = st.floats(width=32)
UNIT32 = st.floats(0, 1, width=32)
METRES32 = st.floats(0, 2.0**127, width=32)
LIGHT = nps.arrays(np.float64, (9, 3), elements=st.floats(-1e9, 1e9))


@st.composite
def clouds(draw: st.DrawFn) -> UnitSphereCloud:
    known = draw(nps.arrays(bool, N))
    srgb = draw(nps.arrays(np.float32, (N, 3), elements=UNIT32)) * known[:, None]
    return UnitSphereCloud(srgb, draw(nps.arrays(np.float32, N, elements=METRES32)) * known, known)


@st.composite
def point_clouds(draw: st.DrawFn) -> tuple[PointCloud, np.ndarray]:
    n = draw(st.integers(0, 30))
    points = draw(nps.arrays(np.float32, (n, 3), elements=ANY32))
    colours = draw(nps.arrays(np.float32, (n, 3), elements=ANY32))
    return PointCloud(points, colours), draw(nps.arrays(np.float64, 3, elements=st.floats(-1e6, 1e6)))


@st.composite
def frames(draw: st.DrawFn) -> RgbdFrame:
    colours = draw(nps.arrays(np.uint8, (2, 3, 3)))
    depths = draw(nps.arrays(np.float32, (2, 3), elements=ANY32))
    turn, _ = np.linalg.qr(draw(nps.arrays(np.float64, (3, 3), elements=st.floats(-1, 1))) + 3 * np.eye(3))
    pose = pose_of(turn, draw(nps.arrays(np.float64, 3, elements=st.floats(-1e4, 1e4))))
    focal = draw(st.floats(0.01, 1e4))
    camera = Intrinsics(3, 2, focal, focal, draw(st.floats(-10, 10)), draw(st.floats(-10, 10)))
    return RgbdFrame(colours, depths, camera, pose, draw(st.floats(1e-6, 1e6)))


@st.composite
def pictures(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    height, width = draw(st.integers(0, 5)), draw(st.integers(0, 5))
    size = (height, width, 3)
    elements = st.floats(0, 1) | st.sampled_from([0.0, 1.0, 5e-324, 1e-200, 0.5])
    first, second = (draw(nps.arrays(np.float64, size, elements=elements)) for _ in range(2))
    return (
        first,
        first.copy() if draw(st.booleans()) else second,
        draw(nps.arrays(np.float64, size[:2], elements=elements)),
    )


@some_examples()
@given(points=point_clouds())
def test_sampling_agrees_with_the_reference(points):
    """Within what sampling promises for distances; a point nearer than that may be taken for one at the position."""
    cloud, position = points
    fast, slow = sample_unit_sphere(cloud, position, LATTICE), sample_unit_sphere_reference(cloud, position, LATTICE)
    error_m = 2.0**-48 * np.linalg.norm(position) + 3e-45
    distance_m = np.linalg.norm(cloud.points_m.astype(float) - position, axis=1)
    n_too_near = int((distance_m <= 2 * error_m).sum())
    assert abs(fast.n_invalid_points - slow.n_invalid_points) <= n_too_near
    if n_too_near == 0 and fast.is_set.any():
        nearest_m = fast.distance_m[fast.is_set].min(), slow.distance_m[slow.is_set].min()
        assert np.isclose(*nearest_m, rtol=5e-7, atol=error_m)
    assert n_too_near or fast.is_set.any() == slow.is_set.any()


@some_examples()
@given(old=clouds(), new=clouds())
def test_merging_does_not_drift(old, new):
    once = looked_at(merge(old, new))
    again = merge(merge(new, once), once)
    assert np.array_equal(once.srgb, again.srgb) and np.array_equal(once.distance_m, again.distance_m)


@some_examples()
@given(previous=clouds(), current=clouds(), thetas=st.tuples(st.floats(0, 2), st.floats(0, 2)))
def test_a_higher_theta_fires_no_sooner(previous, current, thetas):
    for policy in ("split", "reference"):
        asked = (TriggerSettings(theta, policy=policy) for theta in sorted(thetas))
        low, high = (decide_trigger(previous, current, LATTICE, settings) for settings in asked)
        assert not (high.reason == "colour" and low.reason != "colour"), policy
    assert decide_trigger(previous, previous, LATTICE, TriggerSettings(0.0)).reason != "colour"


@some_examples()
@given(cloud=clouds())
def test_a_fit_is_bounded(cloud):
    assert np.abs(project_anchors(cloud, LATTICE)).max() <= 2 * WHITE


@some_examples()
@given(cloud=clouds())
def test_an_estimate_is_bounded(cloud):
    for target in ("ldr", "hdr"):
        light, error = estimator("lattice", N, target).estimate_with_error(cloud)
        assert np.abs(light).max() <= 8 * WHITE and error is not None and np.isfinite(error), target


@some_examples()
@given(light=LIGHT)
def test_deringed_light_lights_no_surface_negatively(light):
    lit = irradiance(dering(light), LATTICE.directions)
    assert lit.min() >= -2e-3 * max(np.abs(irradiance(light * (light[0] >= 0), LATTICE.directions)).max(), 1e-300)


@some_examples()
@given(light=LIGHT, matrix=nps.arrays(np.float64, (3, 3), elements=st.floats(-1, 1)))
def test_light_turns_there_and_back(light, matrix):
    turn, _ = np.linalg.qr(matrix + 3 * np.eye(3))
    turn *= np.sign(np.linalg.det(turn))
    back = rotate(rotate(light, turn), turn.T)
    assert np.abs(back - light).max() <= 1e-12 * max(np.abs(light).max(), 1e-300)


@some_examples()
@given(frame=frames())
def test_points_come_back_to_their_plane_depths(frame):
    cloud = unproject_frame(frame, reference_exposure=1.0)
    assert cloud.srgb.min() >= 0 and cloud.srgb.max() <= 1
    _, depth_m = project_points(cloud.points_m, frame.intrinsics, frame.world_from_camera)
    depths = frame.plane_depth_m.ravel()
    far = np.linalg.norm(frame.world_from_camera[:3, 3]) + 1
    is_plain = np.isfinite(depths) & (depths > 1e-3 * far) & (depths < 1e6)
    error_m = 1e-6 * (far + np.abs(cloud.points_m[is_plain]).max(axis=1, initial=0))
    assert (np.abs(depth_m[is_plain] - depths[is_plain]) <= error_m * 3).all()


@some_examples()
@given(light=nps.arrays(np.float64, 5), exposure=st.floats(0, 1e308))
def test_any_light_is_encoded(light, exposure):
    codes = encode_exposed(light, exposure)
    assert (codes[light <= 0] == 0).all() and (
        codes[np.isposinf(light)] == (255 if exposure > 1e-29 else codes[np.isposinf(light)])
    ).all()


@some_examples()
@given(light=nps.arrays(np.float32, (2, 2, 3), elements=ANY32))
def test_any_light_is_metered(light):
    exposure = metered_exposure([light])
    assert np.isfinite(exposure) and exposure > 0


@some_examples()
@given(scored=pictures())
def test_scores_are_finite_or_undefined(scored):
    metrics = (image_rmse, si_rmse, angular_error_deg, psnr, ssim)
    scores = {metric: metric(*scored) for metric in metrics}
    assert all(score is None or np.isfinite(score) for score in scores.values())
    assert scores[ssim] is None or -1 - 1e-9 <= scores[ssim] <= 1 + 1e-12
    assert (scores[image_rmse] or 0.0) + 1e-12 >= (scores[si_rmse] or 0.0)


@some_examples()
@given(first=LIGHT, second=LIGHT)
def test_an_error_of_coefficients_is_between_its_bounds(first, second):
    difference = np.abs(first - second).max()
    assert difference / 6 <= shc_rmse(first, second) * (1 + 1e-12) <= difference * (1 + 1e-9) + 1e-300
