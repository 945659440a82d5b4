"""Places where an object could be, in rooms made of planes."""

import numpy as np
import pytest

from addon_tests.pure.made import frame_of, pose_of
from xihe_blender.io.placement_results import Place, PlacementResults, Verified
from xihe_blender.report.placement import write_placement_report
from xihenet.camera_path.placement import FEWEST_PIXELS, air_places, places_among, upward_points
from xihenet.formats import MINUS
from xihenet.io.png import write_png
from xihenet.records import Intrinsics

CAMERA = Intrinsics(64, 48, 50.0, 50.0, 32.0, 24.0)
DOWN = np.eye(3)
"""A camera that looks down -Z."""

AHEAD = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""One that looks along +Y."""


def looking_at(depth_m, rotation=DOWN, place=(0.0, 0.0, 2.0)):
    """A frame in which every pixel has this plane depth, (48, 64) or one number."""
    depth = np.broadcast_to(np.float32(depth_m), (48, 64)).copy()
    return frame_of(depth, CAMERA, pose_of(rotation, place))


def upward_places(frames, spacing_m):
    return places_among(upward_points(frames), spacing_m)


def test_a_floor_has_a_place_in_every_cell_and_none_twice():
    places = upward_places([looking_at(2.0)] * 3, 0.25)
    assert len(places) > 50 and np.abs(places[:, 2]).max() < 1e-5
    cells = np.floor(places[:, :2] / 0.25)
    assert len(np.unique(cells, axis=0)) == len(places)
    # 64 x 48 pixels at 2 m are 2.56 m x 1.92 m, whose rim has no neighbours.
    assert (np.abs(places[:, :2]).max(axis=0) < (1.28, 0.96)).all()


def test_a_table_and_the_floor_beside_it_are_two_heights_and_the_edge_between_is_none():
    depth = np.full((48, 64), 2.0)
    depth[:, :32] = 1.2
    places = upward_places([looking_at(depth)], 0.1)
    heights = places[:, 2]
    assert np.isclose(heights, 0, atol=1e-5).any() and np.isclose(heights, 0.8, atol=1e-5).any()
    assert (np.isclose(heights, 0, atol=1e-5) | np.isclose(heights, 0.8, atol=1e-5)).all()


def test_walls_and_ceilings_are_no_places():
    assert upward_places([looking_at(2.0, AHEAD)], 0.1).shape == (0, 3)
    upside_down = looking_at(2.0, np.diag([1.0, -1.0, -1.0]))
    assert upward_places([upside_down], 0.1).shape == (0, 3)


def test_a_room_that_is_moved_by_whole_cells_has_its_places_moved():
    by = np.array([1.25, -0.75, 0.0])
    here = upward_places([looking_at(2.0)], 0.25)
    there = upward_places([looking_at(2.0, place=np.array([0, 0, 2.0]) + by)], 0.25)
    np.testing.assert_allclose(there, here + by, atol=1e-4)


@pytest.mark.parametrize("depth", [0.0, np.nan, np.inf, 1e10])
def test_what_was_not_seen_is_no_place(depth):
    assert upward_places([looking_at(depth)], 0.1).shape == (0, 3)
    assert air_places([looking_at(depth)], 1.0, 0.1).shape == (0, 3)


def test_a_window_in_a_floor_is_no_place_and_a_few_pixels_make_none():
    depth = np.full((48, 64), 2.0)
    depth[20:30, 20:40] = 0
    floor, holed = (upward_points([looking_at(one)]) for one in (2.0, depth))
    assert len(floor) == 46 * 62 and len(holed) == len(floor) - 10 * 20 - 2 * (10 + 20)
    assert [len(places_among(np.zeros((n, 3)), 1.0)) for n in (FEWEST_PIXELS - 1, FEWEST_PIXELS)] == [0, 1]


def test_what_is_out_of_reach_is_no_place():
    high = [looking_at(6.0, place=(0.0, 0.0, 6.0))]
    assert not len(upward_points(high)) and len(upward_points(high, reach_m=10.0))
    assert not len(air_places(high, 0.5, 0.2)) and len(air_places(high, 0.5, 0.2, reach_m=10.0))


def test_no_frame_has_no_place_and_a_spacing_must_be_positive():
    assert upward_places([], 0.1).shape == air_places([], 1.0, 0.1).shape == (0, 3)
    for spacing in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="positive spacing"):
            upward_places([looking_at(2.0)], spacing)
        with pytest.raises(ValueError, match="positive spacing"):
            air_places([looking_at(2.0)], 1.0, spacing)


def test_places_in_the_air_are_those_that_the_phone_looks_through():
    places = air_places([looking_at(2.0)], 1.0, 0.2)
    # At half the distance the picture is half as wide.
    assert len(places) > 10 and (np.abs(places[:, :2]).max(axis=0) <= (0.64, 0.48)).all()
    assert (places[:, 2] == 1.0).all()
    assert not len(air_places([looking_at(2.0)], -0.5, 0.2)), "below the floor"
    assert not len(air_places([looking_at(2.0)], 2.5, 0.2)), "behind the phone"


def test_places_in_the_air_are_the_same_whether_the_seen_ends_at_the_wall_or_at_a_mountain_far_away():
    frames, wide = (
        [looking_at(2.0), looking_at(2.0, place=(0.6, 0.2, 2.0))],
        np.array([[-1e6, -1e6], [1e6, 1e6]]) - 0.07,
    )
    places = air_places(frames, 1.0, 0.05, extent_m=wide)
    assert len(places) > 300
    # Of the same grid, as wide as they reach.
    low = wide[0] + 0.05 * np.round((np.array([-8.0, -8.0]) - wide[0]) / 0.05)
    np.testing.assert_allclose(air_places(frames, 1.0, 0.05, extent_m=np.array([low, [8, 8]])), places, atol=1e-6)


def test_more_places_in_the_air_than_fit_memory_are_refused():
    with pytest.raises(ValueError, match="places 1e-06 m apart are too many: give a larger spacing"):
        air_places([looking_at(2.0)], 1.0, 1e-6)


def test_the_report_of_a_single_place_counts_it_in_the_singular_and_has_true_minus_signs(tmp_path):
    picture = tmp_path / "above.png"
    write_png(picture, np.zeros((2, 2, 3), np.uint8))
    place = Place(position_m=(-0.5, 1.0, 0.25), coverage=0.5, expected_error=0.1, irradiance=(1.0, -0.001, 0.5))
    verified = Verified(n_places=1, rank_correlation=-0.5, interval=(-0.9, 0.2), mean_error_of_best=None,
                        mean_error_of_worst=None)  # fmt: skip
    results = PlacementResults(
        software={}, machine={}, scene="room.blend", settings={"estimator": "lattice"}, frames=(1,), exposure=1.0,
        spacing_m=0.5, clearance_m=0.1, n_unknown=0, places=(place,), verified=verified,
    )  # fmt: skip
    write_placement_report(tmp_path / "report.html", results, (picture, picture))
    page = (tmp_path / "report.html").read_text()
    assert "1 places" not in page and "at 1 place, chosen" in page
    for number in ("0.50, 1.00, 0.25", "0.00100", "0.50 (", "0.90 to 0.20"):
        assert MINUS + number in page
