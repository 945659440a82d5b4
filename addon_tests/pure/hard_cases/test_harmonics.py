"""Hard cases of spherical harmonics: poles, tiny turns, suns that ring, matrices that are no rotation."""

from math import factorial
from typing import Any

import numpy as np

from addon_tests.hard_case import at_most, each, near, refused, row, that
from addon_tests.pure.sh_samples import CONSTANT, light, random_directions, random_light, sunny
from xihenet.panorama import evaluate_panorama, panorama_directions, solid_angles
from xihenet.sh import basis, cosine_lobe, project_panorama

STAGE = "harmonics"
UNIT_NORMALS = random_directions(2000)


def legendre_by_hand(band: int, m: int, z: float) -> float:
    """Naive: the textbook's sum with its factorials, in float64."""
    total = 0.0
    for k in range((band - m) // 2 + 1):
        top = float((-1) ** k) * float(factorial(2 * band - 2 * k))
        bottom = float(2**band) * float(factorial(k)) * float(factorial(band - k)) * float(factorial(band - 2 * k - m))
        total += top / bottom * z ** (band - 2 * k - m)
    return total * (1 - z * z) ** (m / 2)


def power(order: int) -> float:
    """How far the squares of each band are from (2 l + 1) / 4 pi, at the poles and the seam too."""
    directions = np.concatenate([[[0, 0, 1.0], [0, 0, -1.0], [-1, 0.0, 0], [-1, -0.0, 0]], UNIT_NORMALS[:20]])
    squares = basis(directions, order) ** 2
    return max(
        float(np.abs(squares[:, band**2 : (band + 1) ** 2].sum(axis=1) * 4 * np.pi / (2 * band + 1) - 1).max())
        for band in range(order + 1)
    )


def power_by_hand(order: int) -> float:
    """Naive: only the factorials of the formula, with z from float32."""
    z = float(np.float32(0.3))
    bands = np.array([legendre_by_hand(band, 0, z) ** 2 for band in range(order + 1)])
    return float(np.abs(bands - bands[0]).max())


def any_basis(directions: Any) -> int:
    return len(basis(directions))


def panorama_by_samples(radiance: np.ndarray, order: int = 2) -> np.ndarray:
    """Naive: texel centres weighted by their solid angle."""
    height, width, _ = radiance.shape
    weights = (solid_angles(height, width)[..., None] * radiance).reshape(-1, 3)
    return basis(panorama_directions(height, width).reshape(-1, 3), order).T @ weights


def ones(height: int, width: int) -> np.ndarray:
    return np.broadcast_to(np.float32(1), (height, width, 3))


def leak(given: tuple[int, int]) -> float:
    """What constant light of such a panorama has besides its constant coefficient, relative to it."""
    return float(np.abs(project_panorama(ones(*given), 2) / CONSTANT - light(c0=1)).max())


def leak_by_samples(given: tuple[int, int]) -> float:
    return float(np.abs(panorama_by_samples(ones(*given)) / CONSTANT - light(c0=1)).max())


def small_leak(given: tuple[int, int]) -> float:
    """Naive: by rows whose solid angle is the sine times the step, in float32."""
    height, width = given
    sines = np.sin(np.float32(np.pi) * (np.arange(height, dtype=np.float32) + np.float32(0.5)) / np.float32(height))
    areas = sines * np.float32(2 * np.pi**2 / width / height)
    return abs(float(areas.sum(dtype=np.float32) * width) / (4 * np.pi) - 1)


def pole_power(row: int) -> float:
    """Power of one lit texel at a pole of a large panorama, relative to a constant basis over its solid angle."""
    radiance = np.zeros((512, 1024, 3))
    radiance[row, 100] = 1 / solid_angles(512, 1024)[row, 0]
    return float((project_panorama(radiance)[:, 0] ** 2).sum() * 4 * np.pi / 9)


def pole_power_by_hand(row: int) -> float:
    """Naive: the solid angle of the row as a difference of cosines, in float32."""
    edges = np.cos(np.arange(513, dtype=np.float32) * np.float32(np.pi / 512))
    return float(np.abs(edges[row] - edges[row + 1]) * (2 * np.pi / 1024) / solid_angles(512, 1024)[row, 0]) ** 2


def mean_of_bright_and_dim(dim: float) -> float:
    """Twice the mean radiance of a bright half above a dim one, without the bright half's share."""
    radiance = np.concatenate([np.full((4, 16, 3), 1e6), np.full((4, 16, 3), dim)])
    return float(project_panorama(radiance)[0, 0] / CONSTANT - 5e5) * 2


def mean_in_float32(dim: float) -> float:
    return float((np.float32(1e6) + np.float32(dim)) / 2 - 5e5) * 2


def mean_of_texels(sky: np.ndarray, dtype: Any = np.float16) -> float:
    """Naive: in half floats."""
    return float((sky[..., 0].astype(dtype) * solid_angles(64, 128)).sum() / (4 * np.pi))


def last_of_lobe(order: int) -> float:
    return float(abs(cosine_lobe(order)[order]))


def lobe_by_factorials(order: int) -> float:
    return float(factorial(order)) / (2.0**order * float(factorial(order // 2)) ** 2)


FALLS = that("above 0, below 1e-4", lambda came: 0 < came < 1e-4)
NO_DIRECTION = refused("got 1 that are zero, NaN or infinite")
NO_DIRECTIONS = {"of length 0": [0.0, 0, 0], "with NaN": [np.nan, 0, 1], "with infinity": [np.inf, 0, 1]}
EXACT, WHOLE = at_most(1e-12), near(1.0, 1e-4)
SIZES = dict.fromkeys(((1, 1), (1, 2), (2, 1), (3, 5), (8, 16)), leak_by_samples) | {(2048, 4096): small_leak}
BRIGHT_TEXEL = sunny(2e5)
CASES = [
    *(
        row(f"bands to order {n} keep their power at poles and seam", n, power, at_most(1e-11), power_by_hand)
        for n in (1, 2, 5, 10, 100)
    ),
    row("the cosine lobe of order 2000 is finite and falls", 2000, last_of_lobe, FALLS, lobe_by_factorials),
    *(
        row(f"a direction {name} is refused", [[0, 0, 1.0], direction], any_basis, NO_DIRECTION)
        for name, direction in NO_DIRECTIONS.items()
    ),
    row("an order below 0 is refused", -1, lambda order: basis(UNIT_NORMALS, order), refused("at least 0")),
    *(
        row(f"constant light in {width} x {height} texels is constant", (height, width), leak, EXACT, naive)
        for (height, width), naive in SIZES.items()
    ),
    row("a lit texel at the upper pole has its whole power", 0, pole_power, WHOLE, pole_power_by_hand),
    row("a lit texel at the lower pole has its whole power", 511, pole_power, WHOLE, pole_power_by_hand),
    row(
        "a sun of 2e5 in one texel is kept whole",
        BRIGHT_TEXEL,
        lambda sky: float(project_panorama(sky)[0, 0] / CONSTANT),
        near(mean_of_texels(BRIGHT_TEXEL, float), 1e-10),
        mean_of_texels,
    ),
    row(
        "light of 1e6 beside light of 1e-6 does not lose the dim side",
        1e-6,
        mean_of_bright_and_dim,
        near(1e-6, 2e-9),
        mean_in_float32,
    ),
    row(
        "a panorama of coefficients gives them back",
        random_light(2),
        lambda sh: project_panorama(evaluate_panorama(sh, 256, 512)),
        near(random_light(2), 3e-4),
        lambda sh: panorama_by_samples(evaluate_panorama(sh, 4, 8)),
    ),
]

test_hard_case = each(CASES)
