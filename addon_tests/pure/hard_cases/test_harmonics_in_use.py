"""Hard cases of light in spherical harmonics: turned by hardly anything, by no rotation, and ringing."""

from typing import Any

import numpy as np

from addon_tests.hard_case import at_most, each, equal, near, refused, row, that
from addon_tests.pure.sh_samples import CONSTANT, light, random_directions, random_light, sunny
from xihenet.sh import basis, dering, dering_with_strength, irradiance, project_panorama, rotate

STAGE = "harmonics"
UNIT_NORMALS = random_directions(2000)


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


def tiny_turn_by_trace(radians: float) -> float:
    """Naive: the angle from an arc cosine of the matrix's trace."""
    angle = np.arccos((np.trace(about(2, radians)) - 1) / 2)
    return float(-angle / radians)


def rotated(matrix: Any) -> np.ndarray:
    return rotate(light(c2=1), matrix)


def lit(sh: np.ndarray) -> np.ndarray:
    return irradiance(sh, UNIT_NORMALS)


def lowest(sh: np.ndarray) -> float:
    """The lowest irradiance over 2000 normals, relative to the largest."""
    return float(lit(sh).min() / np.abs(lit(sh)).max())


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


def window_by_minimum(sh: np.ndarray) -> float:
    return float(np.clip(-lit(sh).min(), 0, 1))


def float32_moves(matrix: np.ndarray) -> float:
    """How far a matrix in float32 turns light from where the turn in float64 brings it."""
    return float(np.abs(rotate(random_light(2), matrix) - rotate(random_light(2), ABOUT_X)).max())


ABOUT_X = about(0, 1.1)
NO_TURN_BUT_ONE = lambda given: turn_error_by_euler((about(1, 1e-9), given[1]))  # noqa: E731
FIVE = "expected shape ((order + 1)^2, 3), got (5, 3)"
ROWS = "expected orthonormal rows"
NO_ROTATION = {
    "scaled by 1.001": (np.eye(3) * 1.001, ROWS),
    "scaled by 1e200": (np.eye(3) * 1e200, ROWS),
    "of rank 1": (np.ones((3, 3)), ROWS),
    "that shears": (np.array([[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]), ROWS),
    "that is nearly singular": (np.diag([1.0, 1.0, 1e-12]), ROWS),
    "that mirrors": (np.diag([1.0, 1.0, -1.0]), "got a mirroring"),
    "with NaN": (np.full((3, 3), np.nan), "expected a finite (3, 3) matrix"),
}
TURNS = {f"light of order {order} turns with the room": (ABOUT_X @ about(2, 0.4), order) for order in (1, 2, 3, 10)} | {
    "a turn by 180 degrees about X turns the light over": (about(0, np.pi), 2),
    "a pitch of 90 degrees, where Euler angles lock, turns the light": (about(1, np.pi / 2) @ about(0, 0.3), 2),
}
WINDOW = near(0.1698, 5e-4)
CASES = [
    *(row(name, given, turn_error, at_most(1e-12), turn_error_by_euler) for name, given in TURNS.items()),
    row("no turn leaves light of order 10 as it is", (np.eye(3), 10), turn_error, at_most(1e-12), NO_TURN_BUT_ONE),
    row("a turn by a billionth moves the light by a billionth", 1e-9, tiny_turn, near(-1.0, 1e-5), tiny_turn_by_trace),
    row(
        "constant light of order 0 can be turned",
        np.ones((1, 3)),
        lambda sh: rotate(sh, about(0, 1.0)),
        near(np.ones((1, 3)), 1e-14),
        lambda sh: sh[[1, 2, 3]],
    ),
    row(
        "a matrix in float32, as Blender has it, is a rotation",
        ABOUT_X.astype(np.float32),
        float32_moves,
        at_most(1e-6),
        lambda matrix: float(np.abs(matrix.astype(np.float16) - ABOUT_X).max()),
    ),
    *(
        row(f"a matrix {name} is refused", matrix, lambda matrix: rotate(light(c2=1), matrix), refused(words))
        for name, (matrix, words) in NO_ROTATION.items()
    ),
    row(
        "a sun in one texel lights no surface negatively",
        SUN,
        lowest_deringed,
        NOT_NEGATIVE,
        lambda sh: lowest(lanczos(sh)),
    ),
    row("a sun in a sky lights no surface negatively", SUN_IN_SKY, lowest_deringed, NOT_NEGATIVE, lowest),
    row("no light stays none", light(), lambda sh: (float(np.abs(dering(sh)).max()), window_of(sh)), equal((0.0, 0.0))),
    row(
        "a channel of negative light is black and the others stay",
        light(c0=1) * [1, -1, 1],
        lambda sh: dering(sh)[0].tolist(),
        equal([1.0, 0.0, 1.0]),
    ),
    row(
        "light of odd bands alone becomes black",
        light(c1=1, c2=-2, c3=0.5),
        lambda sh: float(np.abs(dering(sh)).max()),
        at_most(1e-8),
        lambda sh: float(np.abs(lanczos(sh)).max()),
    ),
    row(
        "constant light of order 10 irradiates pi times itself",
        light(10, c0=CONSTANT),
        lit,
        near(np.pi, 1e-12),
        lambda sh: basis(UNIT_NORMALS, 10) @ sh,
    ),
    row(
        "light of odd bands above 1 irradiates nothing",
        light(5, c12=1, c30=1),
        lambda sh: float(np.abs(lit(sh)).max()),
        at_most(1e-14),
        lambda sh: float(np.abs(basis(UNIT_NORMALS, 5) @ sh).max()),
    ),
    row(
        "the window for a sun costs 17 % of the bands of l = 1",
        SUN,
        window_of,
        WINDOW,
        lambda sh: float(1 - np.sinc(1 / 3)),
    ),
    *(
        row(f"the window of light times {factor:g} is the same", SUN * factor, window_of, WINDOW, window_by_minimum)
        for factor in (1e-300, 1e-12, 1e250)
    ),
    row("coefficients with nan are refused with their number", light(c3=np.nan), lit, refused("got 3 NaN or infinite")),
    row("five coefficients are refused", np.ones((5, 3)), dering, refused(FIVE)),
]

test_hard_case = each(CASES)
