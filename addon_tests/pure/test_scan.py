"""The mesh of a recording's surfaces: where it lies, where it ends, and what is left out of it."""

from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.recordings import HALF, looking, seen, walk
from xihenet.captures import scan as scans
from xihenet.captures.scan import Scan
from xihenet.records import Intrinsics, RgbdFrame

K = Intrinsics(128, 96, 100.0, 100.0, 64.0, 48.0)


def mesh_of(frames, **options):
    scan = Scan(**options)
    for frame in frames:
        scan.add(frame)
    return scan.mesh()


def normals_of(mesh):
    """(M, 3) of faces, twice their area long."""
    corners = mesh.points_m[mesh.quads].astype(np.float64)
    return np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])


def ball(k, pose, centre_m, radius_m, far_m=3.0):
    """A ball before a wall that the camera faces, ray-cast."""
    x, y = np.meshgrid((np.arange(k.width) + 0.5 - k.cx) / k.fx, (np.arange(k.height) + 0.5 - k.cy) / k.fy)
    rays = np.stack([x, -y, -np.ones_like(x)], axis=-1)
    middle = pose[:3, :3].T @ (centre_m - pose[:3, 3])
    a, b, c = (rays**2).sum(-1), rays @ middle, middle @ middle - radius_m**2
    inside = b**2 - a * c
    depth_m = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / a, far_m).astype(np.float32)
    return RgbdFrame(np.full((k.height, k.width, 3), 128, np.uint8), depth_m, k, pose)


def test_a_wall_is_flat_whole_and_faces_the_camera():
    mesh = mesh_of([seen(K, looking(0, 0, (0.3, 0, 0)))])
    wall = np.abs(mesh.points_m[:, 0] - HALF[0]) < 0.01
    np.testing.assert_allclose(mesh.points_m[wall, 0], HALF[0], atol=2e-4)
    faces = wall[mesh.quads].all(axis=1)
    normals = normals_of(mesh)[faces]
    assert (normals[:, 0] < 0).all()
    # As large as what is in view of it, without the rim.
    width, height = (1.7 * side / 100 for side in (128, 96))
    assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(width * height, rel=0.06)
    edges = np.sort(np.stack([mesh.quads, np.roll(mesh.quads, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, n_faces = np.unique(edges, axis=0, return_counts=True)
    assert n_faces.max() == 2
    assert (n_faces == 2).mean() > 0.95


def test_frames_together_show_the_whole_room():
    mesh = mesh_of(walk(K, 14))
    off_m = np.abs(HALF - np.abs(mesh.points_m)).min(axis=1)
    assert np.quantile(off_m, 0.99) < 0.01 and off_m.max() < 0.02
    assert (np.einsum("ij,ij->i", normals_of(mesh), mesh.points_m[mesh.quads[:, 0]].astype(float)) < 0).mean() > 0.999


def test_noise_is_averaged():
    rng, frames = np.random.default_rng(0), []
    for i in range(20):
        frame = seen(K, looking(0.02 * i, 0, (0.2, 0.01 * i, 0)))
        noise = rng.normal(0, 0.01, frame.plane_depth_m.shape)
        frames.append(replace(frame, plane_depth_m=(frame.plane_depth_m + noise).astype(np.float32)))

    def off_m(mesh):
        wall = np.abs(mesh.points_m - [HALF[0], 0, 0]) < [0.06, 0.4, 0.4]
        return float(np.sqrt(np.mean((mesh.points_m[wall.all(axis=1), 0] - HALF[0]) ** 2)))

    assert off_m(mesh_of(frames)) < 0.5 * off_m(mesh_of(frames[:1]))
    assert off_m(mesh_of(frames)) < 0.004


@pytest.mark.slow
def test_a_ball_has_no_skirt_to_the_wall_behind_it():
    centre_m, poses = np.array([0.0, 0, 0]), []
    for azimuth in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        poses.append(looking(azimuth + np.pi, 0, (1.5 * np.cos(azimuth), 1.5 * np.sin(azimuth), 0)))
    mesh = mesh_of([ball(K, pose, centre_m, 0.4) for pose in poses])
    away_m = np.linalg.norm(mesh.points_m, axis=1)
    near = away_m[away_m < 1.0]
    assert len(near) > 3000
    assert np.abs(near - 0.4).max() < 0.02
    assert np.sqrt(np.mean((near - 0.4) ** 2)) < 0.004


def test_what_is_not_to_be_trusted_is_left_out():
    frame = seen(K, looking(0, 0, (0.3, 0, 0)))
    confidence = np.full(frame.plane_depth_m.shape, 2, np.uint8)
    confidence[:, :64] = 0
    left = mesh_of([replace(frame, confidence=confidence)])
    assert left.points_m[:, 1].max() < 0.05  # +Y is on the left
    holes = frame.plane_depth_m.copy()
    holes[:, :64] = [[0, np.nan, np.inf, 1e10] * 16]
    assert mesh_of([replace(frame, plane_depth_m=holes)]).points_m[:, 1].max() < 0.05
    far = mesh_of([replace(frame, plane_depth_m=frame.plane_depth_m * 4)])
    assert not len(far.quads) and not len(far.points_m)


def test_no_frame_and_no_depth_make_an_empty_mesh():
    frame = seen(K, looking(0, 0, (0, 0, 0)))
    for frames in ([], [replace(frame, plane_depth_m=np.zeros_like(frame.plane_depth_m))]):
        mesh = mesh_of(frames)
        assert mesh.points_m.shape == (0, 3) and mesh.quads.shape == (0, 4) and mesh.colours.shape == (0, 3)


def test_colours_carry_the_scans_exposure():
    frame = seen(K, looking(0, 0, (0.3, 0, 0)))
    plain = mesh_of([replace(frame, exposure=2.0)], exposure=2.0)
    brighter = mesh_of([replace(frame, exposure=2.0)], exposure=3.0)
    balanced = mesh_of([replace(frame, white_balance=np.array([2.0, 1.0, 1.0]))])
    np.testing.assert_allclose(brighter.colours, plain.colours * 1.5, rtol=1e-5)
    np.testing.assert_allclose(balanced.colours, plain.colours * [0.5, 1, 1], rtol=1e-5)


def test_a_scan_that_grows_too_large_is_cut_and_says_so(monkeypatch):
    monkeypatch.setattr(scans, "MOST_BLOCKS", 100)
    mesh = mesh_of(walk(K, 4))
    assert mesh.is_cut and len(mesh.quads)
    assert not mesh_of(walk(K, 1), voxel_m=0.1).is_cut


def test_large_frames_are_thinned_to_the_same_surfaces():
    large = Intrinsics(1280, 960, 1000.0, 1000.0, 640.0, 480.0)
    mesh = mesh_of([seen(large, looking(0, 0, (0.3, 0, 0)))])
    wall = np.abs(mesh.points_m[:, 0] - HALF[0]) < 0.01
    np.testing.assert_allclose(mesh.points_m[wall, 0], HALF[0], atol=2e-4)
    assert wall.sum() > 2000


def test_a_recording_far_from_its_origin_has_the_same_surfaces():
    frame = seen(K, looking(0, 0, (0.3, 0, 0)))
    lost = frame.world_from_camera.copy()
    lost[:3, 3] = 1e20
    assert not len(mesh_of([replace(frame, world_from_camera=lost)]).points_m), "as of tracking that was lost"
    away_m, there = np.array([30_000, -40_000, 80]), frame.world_from_camera.copy()  # Whole blocks
    there[:3, 3] += away_m
    near, far = mesh_of([frame]), mesh_of([replace(frame, world_from_camera=there)], origin_m=away_m)
    assert len(near.quads) and (near.quads == far.quads).all()
    np.testing.assert_allclose(
        far.points_m - near.points_m, np.broadcast_to((30_000, -40_000, 80), far.points_m.shape), atol=3e-3
    )


@pytest.mark.parametrize("seed", range(6))
def test_what_is_not_looked_at_any_further_would_not_count(seed):
    generator = np.random.default_rng(seed)
    # Smooth depth and noise, with holes and jumps, and points all around it, behind the camera too.
    depth_m = 2 + generator.normal(0, 0.003, (96, 128)) + np.linspace(0, generator.uniform(0, 2), 128)
    depth_m[generator.random(depth_m.shape) < 0.1] = generator.choice([0, np.nan, np.inf, 0.5, 4.9])
    frame = RgbdFrame(np.full((96, 128, 3), 128, np.uint8), depth_m.astype(np.float32), K, np.eye(4))
    points = generator.uniform([[-2], [-2], [-5]], [[2], [2], [0.5]], (3, 100_000)).astype(np.float32)
    frames_view, reach_m = scans._Seen.of(frame, 1.0), 0.06
    fast = frames_view.distances(points, reach_m, frames_view.ends_m(reach_m))
    plain = frames_view.distances(points, reach_m, np.full((96, 128), np.inf, np.float32))
    assert len(plain[0]) > 1000
    for one, other in zip(fast, plain, strict=True):
        np.testing.assert_array_equal(one, other)


def test_batches_of_blocks_change_nothing(monkeypatch):
    frames = walk(K, 3)
    one = mesh_of(frames)
    monkeypatch.setattr(scans, "BLOCKS_AT_ONCE", 7)
    other = mesh_of(frames)
    assert one.points_m.tobytes() == other.points_m.tobytes() and one.colours.tobytes() == other.colours.tobytes()
