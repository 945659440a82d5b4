"""Hard cases of the camera: turned, scaled, sheared, shifted, tiny, huge and far away, and of plane depths."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from addon_tests.hard_case import at_most, each, equal, near, refused, row, that
from addon_tests.pure.made import pose_of
from xihenet.camera import project_points, unproject_frame
from xihenet.records import Intrinsics, RgbdFrame

STAGE = "unproject"
ORDINARY = Intrinsics(8, 6, 7.0, 7.0, 4.0, 3.0)
PLACE_M = np.array([1.0, -2.0, 1.5])


def turned(axis: str, degrees: float) -> np.ndarray:
    """(3, 3) rotation about a world axis."""
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def posed(axes: np.ndarray, place_m: Any = PLACE_M) -> np.ndarray:
    return pose_of(axes, place_m)


def unscaled(axes: np.ndarray) -> np.ndarray:
    """What Cycles makes of a scaled camera."""
    return axes / np.linalg.norm(axes, axis=0)


def shot(pose: np.ndarray, intrinsics: Intrinsics = ORDINARY, plane_depth_m: Any = 2.0) -> RgbdFrame:
    size = intrinsics.height, intrinsics.width
    return RgbdFrame(np.zeros((*size, 3), np.uint8), np.broadcast_to(np.float32(plane_depth_m), size), intrinsics, pose)


def wide(degrees: float) -> Intrinsics:
    """64 x 48 pixels with this horizontal field of view."""
    focal = 32 / np.tan(np.radians(degrees / 2))
    return Intrinsics(64, 48, focal, focal, 32.0, 24.0)


def some_pixels(camera: Intrinsics) -> np.ndarray:
    """Up to 2000 pixels by number, first and last among them."""
    return np.unique(np.linspace(0, camera.width * camera.height - 1, 2000).astype(int))


def centres(camera: Intrinsics, number: np.ndarray) -> np.ndarray:
    return np.stack([number % camera.width, number // camera.width], axis=1) + 0.5


def pixels_off(frame: RgbdFrame) -> float:
    """How far pixels land from where they were, after unprojecting and projecting, in pixels."""
    camera, number = frame.intrinsics, some_pixels(frame.intrinsics)
    there, _ = project_points(unproject_frame(frame).points_m[number], camera, frame.world_from_camera)
    return float(np.abs(there - centres(camera, number)).max())


def upright(frame: RgbdFrame) -> float:
    """Naive: takes the camera for a rotation that has +Z upwards in its picture, built from where it looks."""
    camera, number = frame.intrinsics, some_pixels(frame.intrinsics)
    back = frame.world_from_camera[:3, 2]
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back], axis=1)
    points = unproject_frame(frame).points_m[number]
    seen = (points - frame.world_from_camera[:3, 3]) @ axes
    x = camera.cx + camera.fx * seen[:, 0] / -seen[:, 2]
    y = camera.cy - camera.fy * seen[:, 1] / -seen[:, 2]
    return float(np.abs(np.stack([x, y], axis=1) - centres(camera, number)).max())


def from_corners(frame: RgbdFrame) -> float:
    """Naive: rays through the pixels' corners, one focal length, the principal point in the middle."""
    camera, number = frame.intrinsics, some_pixels(frame.intrinsics)
    corner = centres(camera, number) - 0.5 - np.array([camera.width, camera.height]) / 2
    slopes = np.column_stack([corner[:, 0], -corner[:, 1]]) / camera.fx
    rays = np.column_stack([slopes, -np.ones(len(slopes))]) @ frame.world_from_camera[:3, :3].T
    points = rays * frame.plane_depth_m.ravel()[number, None] + frame.world_from_camera[:3, 3]
    there, _ = project_points(points, camera, frame.world_from_camera)
    return float(np.abs(there - centres(camera, number)).max())


LEVEL = turned("x", 90)
SHEAR, OTHER_SHEAR = np.array([[1, 0.4, 0.1], [0, 1, -0.3], [0, 0, 1]]), np.array([[1, 0, 0], [0.7, 1, 0], [0, 0.2, 1]])
POSES = {
    "a camera upside down": LEVEL @ turned("z", 180),
    "a camera rolled by 37 degrees": LEVEL @ turned("z", 37),
    "a camera that looks straight up, where Euler angles lock": turned("x", 180) @ turned("z", 30),
    "a camera that looks straight down": turned("z", -70),
    "a camera mirrored by one negative scale": LEVEL @ np.diag([-1.0, 1.0, 1.0]),
    "a camera whose scales are all negative": LEVEL @ np.diag([-1.0, -1.0, -1.0]),
    "a sheared camera": unscaled(LEVEL @ SHEAR),
    "a camera that is rolled, sheared and mirrored": unscaled(
        LEVEL @ turned("z", 80) @ np.diag([0.3, -2.0, 1.0]) @ OTHER_SHEAR
    ),
}


def metres_off(frame: RgbdFrame) -> float:
    """The largest distance of a point from where float64 has it."""
    return float(np.linalg.norm(unproject_frame(frame).points_m - in_float64(frame), axis=1).max())


def in_float64(frame: RgbdFrame) -> np.ndarray:
    camera = frame.intrinsics
    row, column = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([(column - camera.cx) / camera.fx, -(row - camera.cy) / camera.fy, -np.ones_like(row)], axis=-1)
    seen = rays * frame.plane_depth_m.astype(float)[..., None]
    return (seen @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3]).reshape(-1, 3)


def in_float32(frame: RgbdFrame) -> float:
    """Naive: the camera's place is rounded, and then the points are."""
    near_origin = in_float64(shot(posed(frame.world_from_camera[:3, :3], 0), frame.intrinsics, frame.plane_depth_m))
    points = near_origin.astype(np.float32) + frame.world_from_camera[:3, 3].astype(np.float32)
    return float(np.linalg.norm(points - in_float64(frame), axis=1).max())


def in_float16(frame: RgbdFrame) -> float:
    return float(np.linalg.norm(in_float64(frame).astype(np.float16) - in_float64(frame), axis=1).max())


def n_finite(frame: RgbdFrame) -> int:
    return int(np.isfinite(unproject_frame(frame).points_m).all(axis=1).sum())


def n_by_hand(frame: RgbdFrame) -> int:
    """Naive: a camera that float32 cannot hold is rounded all the same."""
    pose = frame.world_from_camera.astype(np.float32)
    return len(np.ones((6 * 8, 3), np.float32) @ pose[:3, :3].T + pose[:3, 3])


FINE = Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0)
TURNED = LEVEL @ turned("z", 20)
TEN_KM, ONE_KM = posed(TURNED, np.array([1, -1, 1]) * 10000.00045), posed(LEVEL, np.array([1, -1, 1]) * 1000.00003)
FIRST_RAY = np.array([-3.5 / 7, 2.5 / 7, -1.0])


def first_point(plane_depth_m: float) -> np.ndarray:
    """(3,) the point of the first pixel, of a camera at the origin; its neighbour is 1 m away."""
    depths = np.ones((6, 8), np.float32)
    depths[0, 0] = plane_depth_m
    points = unproject_frame(RgbdFrame(np.zeros((6, 8, 3), np.uint8), depths, ORDINARY, np.eye(4))).points_m
    assert np.isfinite(points[1:]).all(), "one pixel disturbs the others"
    return points[0]


def first_point_by_hand(plane_depth_m: float) -> np.ndarray:
    """Naive: makes numbers of what is none, and multiplies."""
    return FIRST_RAY * float(np.nan_to_num(np.float32(plane_depth_m)))


def relative_in_half(plane_depth_m: float) -> np.ndarray:
    """Naive: plane depths as half floats."""
    return FIRST_RAY * float(np.array(plane_depth_m).astype(np.float16)) / plane_depth_m


def pixel_of(given: tuple[Any, np.ndarray]) -> np.ndarray:
    point, pose = given
    return project_points([point], ORDINARY, pose)[0][0]


def pixel_by_cofactors(given: tuple[Any, np.ndarray]) -> np.ndarray:
    """Naive: the inverse by the textbook's determinant, and the perspective division as it stands."""
    point, pose = given
    x, y, z = pose[:3, :3].T
    determinant = np.float64(np.dot(x, np.cross(y, z)))
    inverse = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)]) / determinant
    seen = inverse @ (np.asarray(point, float) - pose[:3, 3])
    return np.array([4.0, 3.0]) + 7 * seen[:2] * [1, -1] / -seen[2]


def pixel_far(given: tuple[Any, np.ndarray]) -> np.ndarray:
    """Naive: infinity is a large number."""
    return pixel_by_cofactors(([1e308, 0, -1e-5], given[1]))


AHEAD, HERE = [0, 0, -1.0], np.eye(4)
FLAT = np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9]]) * 0.1
LENSES = {
    "a lens shifted far outside the picture": Intrinsics(8, 6, 7.0, 7.0, -50.0, 300.0),
    "pixels twice as high as wide": Intrinsics(8, 6, 14.0, 7.0, 4.0, 3.0),
    "a picture of one pixel": Intrinsics(1, 1, 1.0, 1.0, 0.5, 0.5),
    "a picture of one row": Intrinsics(64, 1, 50.0, 50.0, 32.0, 0.5),
    "a picture in 4K": Intrinsics(3840, 2160, 3000.0, 3000.0, 1920.0, 1080.0),
    "a field of view of 1 degree": wide(1),
    "a field of view of 179 degrees": wide(179),
}
IN_A_ROOM, AWAY = shot(posed(TURNED), FINE, 5.0), shot(posed(LEVEL, [1e39, 0, 0]))
SCALED = {
    scale: ([scale, scale, -2.0 * scale], posed(np.eye(3) * scale, 0)) for scale in (1e-200, 1e-120, 1e120, 1e200)
}
IS_NAN = that("NaN", lambda came: bool(np.isnan(came).all()))
LANDS = pixels_off, at_most(1e-4), upright
RELATIVE = lambda m: first_point(m) / np.float32(m), near([-0.5, 2.5 / 7, -1.0], 1e-6), relative_in_half
BESIDE = near([-0.5, 2.5 / 7, -1.0], 1e-6), first_point_by_hand
AT_0, IN_PLANE = (AHEAD, posed(np.zeros((3, 3)), 0)), (AHEAD, posed(FLAT, 0))
CASES = [
    *(row(f"{name} lands on its own pixels", shot(posed(axes)), *LANDS) for name, axes in POSES.items()),
    *(
        row(f"{name} comes back", shot(posed(LEVEL), lens), pixels_off, at_most(1e-2), from_corners)
        for name, lens in LENSES.items()
    ),
    *(
        row(f"{name}, points are right to {bound}", shot(pose, FINE, 3.3), metres_off, at_most(bound_m), in_float32)
        for name, bound, pose, bound_m in (
            ("10 km along each axis from the origin", "a millimetre", TEN_KM, 1e-3),
            ("1 km away", "0.1 mm", ONE_KM, 5.3e-5),
        )
    ),
    row("in a room points are right to 2 micrometres", IN_A_ROOM, metres_off, at_most(2e-6), in_float16),
    row("a camera 1e39 m away gives points that are not finite and no warning", AWAY, n_finite, equal(0), n_by_hand),
    *(
        row(f"light of a plane depth of {depth_m} comes from beside it", depth_m, first_point, *BESIDE)
        for depth_m in (0.0, -1.0, np.inf, -np.inf, 1e10, 1e9)
    ),
    row("a plane depth of NaN is no point", np.nan, first_point, IS_NAN, first_point_by_hand),
    *(row(f"a plane depth of {m:g} m is a point", m, *RELATIVE) for m in (65535.0, 9e8, 1e-8, 1e-30)),
    *(
        row(
            f"a camera scaled by {scale:g} still projects", given, pixel_of, near([7.5, -0.5], 1e-9), pixel_by_cofactors
        )
        for scale, given in SCALED.items()
    ),
    row("a point at the camera itself has no pixel", ([0, 0, 0.0], HERE), pixel_of, IS_NAN, pixel_by_cofactors),
    row(
        "a point at infinity has no pixel and gives no warning", ([np.inf, 0, -1.0], HERE), pixel_of, IS_NAN, pixel_far
    ),
    row("a camera scaled to 0 is refused", AT_0, pixel_of, refused("is the camera scaled to 0?")),
    row(
        "a camera whose axes lie in one plane but for rounding is refused",
        IN_PLANE,
        pixel_of,
        refused("lie in one plane"),
    ),
]

test_hard_case = each(CASES)
