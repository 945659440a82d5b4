"""Hard cases of light in spherical harmonics: turned by hardly anything, by no rotation, and ringing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from addon_tests.hard_case import at_most, case, equal, near, refused, that
from addon_tests.pure.sh_samples import CONSTANT, light, random_directions, random_light, sunny
from xihenet.sh import basis, dering, dering_with_strength, irradiance, project_panorama, rotate

STAGE = "harmonics"
UNIT_NORMALS = random_directions(2000)

# --------------------------------------------------------------------------------------------------------- rotation


def about(axis: int, radians: float) -> np.ndarray:
    first, second = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = np.cos(radians)
    matrix[second, first], matrix[first, second] = np.sin(radians), -np.sin(radians)
    return matrix


def turn_error(given: tuple[np.ndarray, int]) -> float:
    """Largest error of rotated(R d) = original(d) over 2000 directions, relative to the light."""
    rotation, order = given
    sh = random_light(order)
    there, here = basis(UNIT_NORMALS @ rotation.T, order) @ rotate(sh, rotation), basis(UNIT_NORMALS, order) @ sh
    return float(np.abs(there - here).max() / np.abs(here).max())


def turn_error_by_euler(given: tuple[np.ndarray, int]) -> float:
    """Naive: takes the matrix for one turn about Z, by the angle of its first column."""
    rotation, order = given
    yaw = about(2, np.arctan2(rotation[1, 0], rotation[0, 0]))
    sh = random_light(order)
    there, here = basis(UNIT_NORMALS @ rotation.T, order) @ rotate(sh, yaw), basis(UNIT_NORMALS, order) @ sh
    return float(np.abs(there - here).max() / np.abs(here).max())


def tiny_turn(radians: float) -> float:
    """What a turn about Z moves from the coefficient of y into that of x, over the angle: -1."""
    return float(rotate(light(c1=1), about(2, radians))[3, 0] / radians)


def tiny_turn_in_float32(radians: float) -> float:
    """Naive: the angle from an arc cosine of the matrix's trace."""
    angle = np.arccos((np.trace(about(2, radians)) - 1) / 2)
    return float(-angle / radians)


def rotated(matrix: Any) -> np.ndarray:
    return rotate(light(c2=1), matrix)


NO_ROTATION = {
    "scaled by 1.001": (np.eye(3) * 1.001, "expected orthonormal rows"),
    "scaled by 1e200": (np.eye(3) * 1e200, "expected orthonormal rows"),
    "of rank 1": (np.ones((3, 3)), "expected orthonormal rows"),
    "that shears": (np.array([[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]), "expected orthonormal rows"),
    "that is nearly singular": (np.diag([1.0, 1.0, 1e-12]), "expected orthonormal rows"),
    "that mirrors": (np.diag([1.0, 1.0, -1.0]), "got a mirroring"),
    "with NaN": (np.full((3, 3), np.nan), "expected a finite (3, 3) matrix"),
}
TURNS = [
    *(
        case(f"light of order {order} turns with the room", (about(0, 1.1) @ about(2, 0.4), order), turn_error_by_euler)
        for order in (1, 2, 3, 10)
    ),
    case("a turn by 180 degrees about X turns the light over", (about(0, np.pi), 2), turn_error_by_euler),
    case(
        "a pitch of 90 degrees, where Euler angles lock, turns the light",
        (about(1, np.pi / 2) @ about(0, 0.3), 2),
        turn_error_by_euler,
    ),
    case(
        "no turn leaves light of order 10 as it is",
        (np.eye(3), 10),
        lambda given: turn_error_by_euler((about(1, 1e-9), given[1])),
    ),
]


@pytest.mark.parametrize("given, naive", TURNS)
def test_light_turns_with_the_room(given, naive, comes_out):
    assert comes_out(given, turn_error, at_most(1e-12), naive)


def test_a_turn_by_a_billionth_moves_the_light_by_a_billionth(comes_out):
    assert comes_out(1e-9, tiny_turn, near(-1.0, 1e-5), tiny_turn_in_float32)


def test_constant_light_of_order_0_can_be_turned(comes_out):
    assert comes_out(
        np.ones((1, 3)), lambda sh: rotate(sh, about(0, 1.0)), near(np.ones((1, 3)), 1e-14), lambda sh: sh[[1, 2, 3]]
    )


SMALL_TURNS = [
    case(
        "a matrix in float32, as Blender has it, is a rotation",
        about(0, 1.1).astype(np.float32),
        lambda matrix: float(np.abs(rotate(random_light(2), matrix) - rotate(random_light(2), about(0, 1.1))).max()),
        at_most(1e-6),
        lambda matrix: float(np.abs(matrix.astype(np.float16) - about(0, 1.1)).max()),
    )
]


@pytest.mark.parametrize("given, ask, must, naive", SMALL_TURNS)
def test_light_is_turned_exactly(given, ask, must, naive, comes_out):
    assert comes_out(given, ask, must, naive)


NO_ROTATIONS = [
    case(f"a matrix {name} is refused", matrix, refused(words)) for name, (matrix, words) in NO_ROTATION.items()
]


@pytest.mark.parametrize("given, must", NO_ROTATIONS)
def test_a_matrix_that_is_no_rotation_is_refused(given, must, comes_out):
    assert comes_out(given, rotated, must)


# ---------------------------------------------------------------------------------------------- ringing and irradiance


def lowest(sh: np.ndarray) -> float:
    """The lowest irradiance over 2000 normals, relative to the largest."""
    lit = irradiance(sh, UNIT_NORMALS)
    return float(lit.min() / np.abs(lit).max())


def lowest_deringed(sh: np.ndarray) -> float:
    return lowest(dering(sh))


def lanczos(sh: np.ndarray) -> np.ndarray:
    """Naive: one fixed window for all light."""
    bands = np.repeat(np.arange(3), [1, 3, 5])
    return sh * np.sinc(bands / 6)[:, None]


NOT_NEGATIVE = that("not negative, but for 0.1 %", lambda came: came >= -1e-3)
SUN = project_panorama(sunny(2e5, sky=0.0))
SUN_IN_SKY = project_panorama(sunny(2e5))


def window_of(sh: np.ndarray) -> float:
    return dering_with_strength(sh)[1]


def window_too_weak(sh: np.ndarray) -> float:
    """The lowest irradiance under a window 1 % weaker than the one chosen."""
    strength = window_of(sh) * 0.99
    bands = np.repeat(np.arange(3), [1, 3, 5])
    return lowest(sh * ((1 - strength) ** (bands * (bands + 1) / 2))[:, None])


def test_a_sun_in_one_texel_lights_no_surface_negatively(comes_out):
    assert comes_out(SUN, lowest_deringed, NOT_NEGATIVE, lambda sh: lowest(lanczos(sh)))


def test_a_sun_in_a_sky_lights_no_surface_negatively(comes_out):
    assert comes_out(SUN_IN_SKY, lowest_deringed, NOT_NEGATIVE, lowest)


RINGING = [
    case(
        "a window 1 % weaker would ring",
        SUN,
        window_too_weak,
        that("negative", lambda came: came < 0),
        lambda sh: lowest(dering(sh) * np.repeat([1, 0.9, 0.7], [1, 3, 5])[:, None]),
    ),
    case(
        "light of odd bands alone becomes black",
        light(c1=1, c2=-2, c3=0.5),
        lambda sh: float(np.abs(dering(sh)).max()),
        at_most(1e-8),
        lambda sh: float(np.abs(lanczos(sh)).max()),
    ),
    case(
        "constant light of order 10 irradiates pi times itself",
        light(10, c0=CONSTANT),
        lambda sh: irradiance(sh, UNIT_NORMALS),
        near(np.pi, 1e-12),
        lambda sh: basis(UNIT_NORMALS, 10) @ sh,
    ),
    case(
        "light of odd bands above 1 irradiates nothing",
        light(5, c12=1, c30=1),
        lambda sh: float(np.abs(irradiance(sh, UNIT_NORMALS)).max()),
        at_most(1e-14),
        lambda sh: float(np.abs(basis(UNIT_NORMALS, 5) @ sh).max()),
    ),
]


def test_light_that_does_not_ring_is_left_alone(comes_out):
    assert comes_out(light(c0=1, c2=0.2), lambda sh: float(np.abs(dering(sh) - sh).max()), equal(0.0))


def test_no_light_stays_none(comes_out):
    assert comes_out(light(), lambda sh: (float(np.abs(dering(sh)).max()), window_of(sh)), equal((0.0, 0.0)))


def test_a_channel_of_negative_light_is_black_and_the_others_stay(comes_out):
    assert comes_out(light(c0=1) * [1, -1, 1], lambda sh: dering(sh)[0].tolist(), equal([1.0, 0.0, 1.0]))


@pytest.mark.parametrize("given, ask, must, naive", RINGING)
def test_ringing_is_removed_and_nothing_else(given, ask, must, naive, comes_out):
    assert comes_out(given, ask, must, naive)


WINDOWS = [
    case("the window for a sun costs 17 % of the bands of l = 1", SUN, lambda sh: float(1 - np.sinc(1 / 3))),
    *(
        case(
            f"the window of light times {factor:g} is the same",
            SUN * factor,
            lambda sh: float(np.clip(-irradiance(sh, UNIT_NORMALS).min(), 0, 1)),
        )
        for factor in (1e-300, 1e-12, 1e250)
    ),
]


@pytest.mark.parametrize("given, naive", WINDOWS)
def test_the_window_is_no_wider_than_it_must_be(given, naive, comes_out):
    assert comes_out(given, window_of, near(0.1698, 5e-4), naive)


def test_coefficients_with_nan_are_refused_with_their_number(comes_out):
    assert comes_out(light(c3=np.nan), lambda sh: irradiance(sh, UNIT_NORMALS), refused("got 3 NaN or infinite"))


def test_five_coefficients_are_refused(comes_out):
    assert comes_out(np.ones((5, 3)), dering, refused("expected shape ((order + 1)^2, 3), got (5, 3)"))
