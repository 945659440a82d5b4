"""What something hides from the position does not replace it, whatever frame sees it; what is gone hides nothing.

The room is cast ray by ray here: what a position sees of it is known without the chain.
"""

from functools import reduce

import numpy as np
import pytest

from addon_tests.pure.made import UPRIGHT, about_z, frame_of, pose_of, random_cloud
from xihenet.buffers import BEHIND_FROM, FrameAtPosition, PositionBuffers, in_sight, merge, merge_in_sight
from xihenet.camera import pixel_rays, project_points, sees_through, unproject_frame
from xihenet.records import FAR_FROM_M, Intrinsics, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

LATTICE = AnchorLattice(1280)
CAMERA = Intrinsics(160, 120, 120.0, 120.0, 80.0, 60.0)
ROOM = np.array([[-3.0, -3, -1], [3, 3, 2]])
PILLAR = np.array([[0.6, -0.3, -1], [1.0, 0.3, 1]])
HERE = np.zeros(3)


def cast(start_m, rays, *, with_pillar=True):
    """Distances along `rays` (P, 3), in their lengths, and whether the pillar is hit: slabs, inside and outside."""
    with np.errstate(divide="ignore"):  # A ray along a wall never meets it.
        leaving = ((np.where(rays > 0, ROOM[1], ROOM[0]) - start_m) / rays).min(axis=-1)
        near = ((np.where(rays > 0, PILLAR[0], PILLAR[1]) - start_m) / rays).max(axis=-1)
        far = ((np.where(rays > 0, PILLAR[1], PILLAR[0]) - start_m) / rays).min(axis=-1)
    hits = (near < far) & (near > 0) & with_pillar
    return np.where(hits, near, leaving), hits


def seen_from(place_m, yaw, *, with_pillar=True):
    """A frame: the pillar black, walls white."""
    axes = about_z(yaw) @ UPRIGHT
    rays = pixel_rays(CAMERA)
    plane_depth_m, is_pillar = cast(np.asarray(place_m), rays @ axes.T, with_pillar=with_pillar)
    return frame_of(plane_depth_m, CAMERA, pose_of(axes, place_m), np.where(is_pillar, 0, 255)[..., None])


def sight_of(frame):
    return FrameAtPosition(frame, HERE, LATTICE)


def sampled(frame):
    return sample_unit_sphere(unproject_frame(frame), HERE, LATTICE)


FACING_PILLAR = seen_from((-1, 0, 0), -np.pi / 2)
PAST_PILLAR = [seen_from((1.5, side, 0), -np.pi / 2) for side in (-1.5, 1.5)]
"""From beside the pillar, on the wall behind it."""


@pytest.mark.parametrize("order", [1, -1])
def test_the_wall_behind_a_pillar_does_not_replace_it_in_any_order(order):
    frames = [FACING_PILLAR, *PAST_PILLAR][::order]
    clouds = [sampled(frame) for frame in frames]
    _, is_pillar = cast(HERE, LATTICE.directions)

    def share_of_wall(cloud):
        """Of the anchors well inside the pillar's outline."""
        inside = is_pillar & is_pillar[LATTICE.neighbours(6)].all(axis=1)
        return (cloud.srgb[inside & cloud.is_set] > 0.5).any(axis=1).mean()

    buffers = PositionBuffers.empty(LATTICE.n)
    for cloud, frame in zip(clouds, frames, strict=True):
        buffers = buffers.with_frame(buffers.in_sight(cloud, sight_of(frame))).fired()
    assert share_of_wall(buffers.persistent) == share_of_wall(reduce(merge_in_sight, clouds)) == 0
    # As in the paper, where whatever is newer wins.
    assert (share_of_wall(reduce(merge, clouds)) > 0.2) == (order == 1)
    # And what nothing hides is all there.
    wall = cast(HERE, LATTICE.directions)[0] > 2
    assert (buffers.persistent.is_set & wall).sum() >= 0.98 * (reduce(merge, clouds).is_set & wall).sum()


def test_a_pillar_that_is_gone_is_replaced_once_a_frame_sees_through_its_place():
    buffers = PositionBuffers.empty(LATTICE.n).with_frame(sampled(FACING_PILLAR)).fired()
    black = buffers.persistent.is_set & (buffers.persistent.srgb < 0.5).all(axis=1)
    assert black.sum() > 20
    # One that does not look there cannot know.
    aside = seen_from((1.5, -1.5, 0), -np.pi / 2, with_pillar=False)
    kept = buffers.with_frame(buffers.in_sight(sampled(aside), sight_of(aside))).fired()
    assert (kept.persistent.srgb[black] < 0.5).all(axis=1).mean() > 0.9
    through = seen_from((-2, 0, 0), -np.pi / 2, with_pillar=False)
    free = kept.with_frame(kept.in_sight(sampled(through), sight_of(through)))
    # Also in the next frame, which does not look there again.
    free = free.with_frame(free.in_sight(sampled(aside), sight_of(aside))).fired()
    assert (free.persistent.srgb[black] > 0.5).all(axis=1).mean() > 0.9


def test_what_stays_is_what_is_not_behind_anchor_by_anchor():
    rng = np.random.default_rng(4)
    nasty = np.float32([0, 1e-45, 1e-3, 0.1, 1, 1.3, 64, 3e38, 3.4e38])
    old, new = random_cloud(rng, 64, 0.95), random_cloud(rng, 64)
    old = UnitSphereCloud(old.srgb, old.distance_m * 0.3, old.is_set)
    pairs = np.array([(a, b) for a in nasty for b in nasty]).T
    known = np.ones(pairs.shape[1], bool)
    for one, other in ((old, new), [UnitSphereCloud(np.full((len(known), 3), 0.5), m, known) for m in pairs]):
        left, beside = in_sight(one, other), AnchorLattice(len(one)).neighbours(6)
        n_hidden = 0
        for k in range(len(one)):
            shown_m = float(other.distance_m[k])
            nearer = [one.is_set[i] and float(one.distance_m[i]) * BEHIND_FROM < shown_m for i in beside[k]]
            is_hidden = other.is_set[k] and nearer[0] and (sum(nearer) >= 5 or shown_m >= FAR_FROM_M)
            assert left.is_set[k] == (other.is_set[k] and not is_hidden)
            n_hidden += is_hidden
            if left.is_set[k]:
                assert left.distance_m[k] == other.distance_m[k] and (left.srgb[k] == other.srgb[k]).all()
        assert n_hidden and not left.srgb[~left.is_set].any() and not left.distance_m[~left.is_set].any()
    assert in_sight(UnitSphereCloud.empty(64), new) is new
    with pytest.raises(ValueError, match="anchors"):
        in_sight(old, UnitSphereCloud.empty(65))


def test_a_frame_sees_through_a_point_only_if_all_about_it_lies_behind():
    rng = np.random.default_rng(2)
    depth_m = rng.choice(
        np.float32([0.5, 2, 3, np.nan, 0, np.inf, 1e10]), (12, 16), p=[0.05, 0.4, 0.4, 0.05, 0.05, 0.02, 0.03]
    )
    frame = frame_of(depth_m, Intrinsics(16, 12, 9.0, 9.0, 8.0, 6.0), pose_of(about_z(0.3), (0.1, 0.2, 0.3)))
    points_m = np.concatenate(
        [rng.normal(size=(4000, 3)) * 1.5, np.full((1, 3), np.nan), frame.world_from_camera[None, :3, 3]]
    )
    found = sees_through(points_m, frame)
    pixels, plane_depth_m = project_points(points_m, frame.intrinsics, frame.world_from_camera)
    for one, pixel, point_m in zip(found, pixels, plane_depth_m, strict=True):
        expected = False
        if point_m > 0 and 1 <= pixel[0] < 15 and 1 <= pixel[1] < 11:
            column, row = int(pixel[0]), int(pixel[1])
            around = depth_m[row - 1 : row + 2, column - 1 : column + 2]
            expected = all(1.1 * point_m < one_m < 1e9 for one_m in around.ravel().tolist())
        assert one == expected
    assert 20 < found.sum() < len(found) / 2
    assert (
        not sees_through(points_m, frame_of(np.full((2, 2), 9.0))).any() and len(sees_through(points_m[:0], frame)) == 0
    )
