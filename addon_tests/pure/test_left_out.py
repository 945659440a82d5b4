"""A light is judged by what it was not given: nothing is wrong where it is right, and nothing is asked in vain."""

import numpy as np
import pytest

from xihenet.colour import linear_to_srgb
from xihenet.left_out import left_out_error, left_out_errors
from xihenet.records import UnitSphereCloud
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

DIRECTIONS = AnchorLattice(1280).directions
LIGHT = np.zeros((9, 3))
LIGHT[0], LIGHT[3] = [1.5, 1.0, 0.7], [0.3, -0.2, 0.1]


def seen(is_set, light=LIGHT):
    srgb = linear_to_srgb(basis(DIRECTIONS, 2) @ light) * is_set[:, None]
    return UnitSphereCloud(srgb.astype(np.float32), 2.0 * is_set, is_set)


def half(axis, sign=1):
    return sign * DIRECTIONS[:, axis] > 0.1


def test_the_true_light_has_no_error_and_another_one_that_of_its_radiance():
    given, left_out = seen(half(0)), seen(half(0, -1))
    assert left_out_error(LIGHT, given, left_out) < 1e-6
    brighter = LIGHT.copy()
    brighter[0] += 0.1 * np.sqrt(4 * np.pi)
    assert left_out_error(brighter, given, left_out) == pytest.approx(0.1, abs=1e-6)


def test_only_what_the_given_frames_do_not_show_is_asked():
    wrong = seen(half(0), np.zeros((9, 3)))
    left_out = seen(half(0, -1))
    both = UnitSphereCloud(wrong.srgb + left_out.srgb, wrong.distance_m + left_out.distance_m, half(0) | half(0, -1))
    assert left_out_error(LIGHT, seen(half(0)), both) < 1e-6
    assert left_out_error(LIGHT, seen(half(0)), seen(half(0))) is None


def test_a_session_is_asked_frame_by_frame_both_ways():
    frames = [seen(half(0)), seen(half(1)), seen(half(0, -1)), UnitSphereCloud.empty(1280)]
    given = []
    errors = list(left_out_errors(frames, lambda cloud: given.append(cloud.is_set.mean()) or LIGHT))
    assert len(errors) == 3 and max(errors) < 1e-6 and max(given) < 0.5
    given.clear()
    errors = list(left_out_errors(frames, lambda cloud: given.append(cloud.is_set.mean()) or LIGHT, is_merged=True))
    # Thirds: the first two frames, the third, and the empty one, which shows nothing that the others do not.
    assert len(errors) == 2 and min(given) > 0.4
    assert list(left_out_errors(frames[:1], lambda cloud: LIGHT)) == []


def test_radiance_beyond_black_and_white_is_cut_as_pictures_are():
    left_out = seen(half(0, -1), np.eye(9)[:, :1] * np.full(3, np.sqrt(4 * np.pi)))
    assert left_out_error(np.eye(9)[:, :1] * np.full(3, 90.0), seen(half(0)), left_out) < 1e-6


def test_clouds_of_different_sizes_and_light_that_is_not_finite_are_refused():
    with pytest.raises(ValueError, match="1 NaN"):
        left_out_error(np.where(np.arange(27).reshape(9, 3) == 4, np.nan, LIGHT), seen(half(0)), seen(~half(0)))
    with pytest.raises(ValueError, match="got 1280 and 512"):
        left_out_error(LIGHT, seen(half(0)), UnitSphereCloud.empty(512))
