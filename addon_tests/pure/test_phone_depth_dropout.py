"""Where the range sensor gives no answer, and where it must give one."""

import numpy as np
import pytest

from addon_tests.pure.made import frame_of, pose_of, random_rotation
from xihenet.camera import pixel_rays
from xihenet.phone.depth_dropout import (
    DarkDropout,
    GlossyDropout,
    GrazingDropout,
    SeenSurfaces,
    SpanDropout,
    SurfaceFacts,
    TransparentDropout,
    facing_cosines,
)
from xihenet.records import Intrinsics

DARK = DarkDropout(source="test", below_grey=15 / 255)
GLOSSY = GlossyDropout(source="test", below_roughness=0.1, beyond_deg=15)
CLEAR = TransparentDropout(source="test", above_transmission=0.5)
GRAZING = GrazingDropout(source="test", beyond_deg=80)
CAMERA = Intrinsics(40, 30, 35.0, 35.0, 20.0, 15.0)
RAYS = pixel_rays(CAMERA)


def seen_surfaces(plane_depth_m, facts=None, colour=0):
    """A frame of any size as the sensor sees it, all of it along the camera's axis."""
    z = np.asarray(plane_depth_m, np.float32)
    height, width = z.shape
    intrinsics = Intrinsics(width, height, 1e6, 1e6, width / 2, height / 2)
    return SeenSurfaces(frame_of(z, intrinsics, srgb_u8=colour), facts or SurfaceFacts(), z)


def dropout_of(settings, frame, facts=None):
    return settings.mask(SeenSurfaces(frame, facts or SurfaceFacts(), frame.plane_depth_m))


def plane_seen(normal, through):
    """Plane depth of a plane in camera axes, and the true cosine in each pixel."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    z = (normal @ through) / (RAYS @ normal)
    return z, np.abs(RAYS @ normal) / np.linalg.norm(RAYS, axis=2)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.3, -0.2, 1), (1, 0.5, 1), (0.9, 0, 0.35)])
def test_cosines_from_plane_depth_are_those_of_the_plane(normal):
    z, expected = plane_seen(normal, np.array([0, 0, -3.0]))
    # Where the plane leaves the view through its own horizon there is nothing to compare.
    seen = (z > 0) & (z < 50)
    got = facing_cosines(frame_of(np.where(seen, z, 0), CAMERA), SurfaceFacts())
    inner = seen & np.roll(seen, 1, 0) & np.roll(seen, -1, 0) & np.roll(seen, 1, 1) & np.roll(seen, -1, 1)
    assert inner.mean() > 0.4
    np.testing.assert_allclose(got[inner], expected[inner], atol=2e-3)


@pytest.mark.parametrize("seed", range(5))
def test_given_normals_are_in_the_world_and_need_no_unit_length(seed):
    rng = np.random.default_rng(seed)
    pose = pose_of(random_rotation(rng), rng.normal(size=3))
    normals = rng.normal(size=(30, 40, 3))
    rays_in_world = RAYS @ pose[:3, :3].T
    expected = (
        np.abs(np.sum(normals * rays_in_world, 2)) / np.linalg.norm(normals, axis=2) / np.linalg.norm(RAYS, axis=2)
    )
    got = facing_cosines(frame_of(np.ones((30, 40)), CAMERA, pose), SurfaceFacts(normals=normals))
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_surfaces_that_face_the_camera_have_a_cosine_of_1_at_most():
    facts = SurfaceFacts(normals=RAYS)
    assert facing_cosines(frame_of(np.ones((30, 40)), CAMERA), facts).max() == 1


def test_normals_that_are_no_direction_count_as_facing():
    normals = np.zeros((30, 40, 3))
    normals[0, :4, 1] = [np.nan, np.inf, -np.inf, 0]
    assert (facing_cosines(frame_of(np.ones((30, 40)), CAMERA), SurfaceFacts(normals=normals)) == 1).all()


def test_a_depth_edge_is_not_taken_for_a_grazing_surface():
    z = np.full((30, 40), 1.0)
    z[:, 20:] = 4.0
    z[15:] = 2.0
    assert not dropout_of(GRAZING, frame_of(z, CAMERA)).any()


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, 2.0])
def test_one_pixel_faces_the_camera(value):
    assert facing_cosines(frame_of(np.full((1, 1), value)), SurfaceFacts())[0, 0] == 1


def test_the_share_of_grazing_dropout_on_a_floor_is_the_one_of_geometry():
    z, cosine = plane_seen((0, 1, 0), np.array([0, -0.15, 0.0]))
    seen = (z > 0) & (z < 1.5)
    dropped = dropout_of(GRAZING, frame_of(np.where(seen, z, 0), CAMERA))
    expected = cosine < np.cos(np.radians(80))
    inner = seen & np.roll(seen, 1, 0)
    assert expected[inner].any() and not expected[inner].all()
    assert np.mean(dropped[inner] == expected[inner]) > 0.99


def test_darkness_is_judged_by_reflectance_where_it_is_known():
    colour = np.zeros((1, 4, 3), np.uint8)
    colour[0, :, :] = np.array([0, 14, 15, 200])[:, None]
    z = np.ones((1, 4))
    assert DARK.mask(seen_surfaces(z, colour=colour)).tolist() == [[True, True, False, False]]
    bright = SurfaceFacts(reflectance=np.array([[0.5, 0.5, 0.5, 0.01]], np.float32))
    assert DARK.mask(seen_surfaces(z, bright, colour)).tolist() == [[False, False, False, True]]


def test_a_glossy_surface_answers_only_where_it_faces_the_phone():
    away = np.radians([[0.0, 14.0, 16.0, 60.0]])
    normals = np.stack([np.sin(away), np.zeros((1, 4)), np.cos(away)], axis=-1).astype(np.float32)
    smooth = SurfaceFacts(normals=normals, roughness=np.full((1, 4), 0.05, np.float32))
    rough = SurfaceFacts(normals=normals, roughness=np.full((1, 4), 0.5, np.float32))
    z = np.ones((1, 4))
    assert GLOSSY.mask(seen_surfaces(z, smooth)).tolist() == [[False, False, True, True]]
    assert not GLOSSY.mask(seen_surfaces(z, rough)).any()
    assert not GLOSSY.mask(seen_surfaces(z, SurfaceFacts(normals=normals))).any()


def test_only_what_lets_light_through_is_a_transparent_dropout():
    facts = SurfaceFacts(transmission=np.array([[0.0, 0.5, 0.9]], np.float32))
    assert CLEAR.mask(seen_surfaces(np.ones((1, 3)), facts)).tolist() == [[False, False, True]]
    assert not CLEAR.mask(seen_surfaces(np.ones((1, 3)))).any()


def test_span_dropout_lies_on_both_sides_of_a_wide_edge_only():
    z = np.full((5, 9), 1.0, np.float32)
    z[:, 3:] = 1.7
    z[:, 6:] = 2.6
    columns = np.flatnonzero(SpanDropout(source="test", span_m=0.8).mask(seen_surfaces(z)).all(axis=0))
    assert columns.tolist() == [5, 6]


def test_facts_of_another_size_are_refused():
    with pytest.raises(ValueError, match=r"SurfaceFacts.normals: expected shape \(30, 40, 3\), got \(30, 40\)"):
        SurfaceFacts(normals=np.zeros((30, 40))).checked_for(CAMERA)


def test_facts_follow_the_pixels_that_they_are_of():
    roughness = np.arange(6, dtype=np.float32).reshape(2, 3)
    normals = np.arange(18, dtype=np.float32).reshape(2, 3, 3)
    source = np.array([[5, 4, 3], [2, 1, 0]])
    moved = SurfaceFacts(normals=normals, roughness=roughness).taken_from(source)
    assert moved.roughness.tolist() == [[5, 4, 3], [2, 1, 0]]
    np.testing.assert_array_equal(moved.normals[0, 0], normals[1, 2])
    assert moved.transmission is None
