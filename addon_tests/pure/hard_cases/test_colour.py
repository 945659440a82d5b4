"""Hard cases of colour: 8 bits, exposure, and light from 1e-320 to infinity."""

from typing import Any

import numpy as np

from addon_tests.hard_case import Must, at_most, each, equal, near, refused, row, that
from xihenet.camera import encode_exposed, unproject_frame
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.phone.metering import metered_exposure
from xihenet.records import Intrinsics, RgbdFrame

STAGE = "colour"


def encoded(given: tuple[Any, float]) -> list[int]:
    light, exposure = given
    return encode_exposed(np.array(light), exposure).tolist()


def encoded_by_hand(given: tuple[Any, float]) -> list[int]:
    """Naive: the upper piece of the curve everywhere, cut off instead of rounded, wrapped instead of clipped."""
    exposed = np.array(given[0]) * np.float64(given[1])
    curve = np.sign(exposed) * np.abs(exposed) ** (1 / 2.4) * 1.055 - 0.055
    return (curve * 254.9999).astype(np.int64).astype(np.uint8).tolist()


SUN = 2e5
CODES = np.arange(256)
AROUND = np.arange(-50, 51) * 1e-12


def step_with_the_other_threshold(join: float) -> float:
    """Naive: the threshold of decoding used for encoding."""
    light = 0.04045 + AROUND
    return np.abs(np.diff(np.where(light <= 0.04045, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055))).max()


GREY = np.full((6, 8, 3), 0.12)


def with_pixel(value: Any) -> list[np.ndarray]:
    picture = GREY.copy()
    picture[2, 3] = value
    return [picture]


def with_sun() -> np.ndarray:
    """A grey picture of 256 x 192 with the sun in it, as large as it is."""
    picture = np.full((192, 256, 3), 0.12)
    picture[10:12, 20:22] = SUN
    return picture


def part_of_a_room(share: float, value: float) -> np.ndarray:
    """A room of surfaces around 0.12, a `share` of whose pixels are `value`."""
    luminance = 0.12 * np.exp(np.random.default_rng(0).normal(0, 0.7, 4096))
    luminance *= 0.12 / np.median(luminance[round(share * luminance.size) :])
    luminance[: round(share * luminance.size)] = value
    return np.repeat(luminance[:, None], 3, axis=1)


def by_mean(pictures: list[np.ndarray]) -> float:
    """Naive: the mean of all there is."""
    return float(0.12 / np.mean([np.mean(picture) for picture in pictures]))


def by_logarithm(pictures: list[np.ndarray]) -> float:
    """Naive: the geometric mean, black pixels counting as a thousandth of the arithmetic one."""
    keys = [np.exp(np.log(np.maximum(picture, picture.mean() * 1e-3)).mean()) for picture in pictures]
    return float(0.12 / np.mean(keys))


def by_maximum(pictures: list[np.ndarray]) -> float:
    """Naive: nothing may be brighter than white."""
    return float(1.0 / max(np.max(picture) for picture in pictures))


def by_key(name: str, pictures: list[np.ndarray], must: Must, naive: Any) -> Any:
    return row(name, pictures, lambda pictures: metered_exposure(pictures, "key"), must, naive)


def by_highlights(name: str, pictures: list[np.ndarray], must: Must, naive: Any) -> Any:
    return row(name, pictures, lambda pictures: metered_exposure(pictures, "highlights"), must, naive)


def dark_room(share: float) -> Any:
    name = f"darkness that fills {share:.0%} of a room does not blow out the rest"
    must = that("at least 1, and half of the room below white", lambda exposure: 1 <= exposure <= 1 / 0.12 + 1e-9)
    return by_key(name, [part_of_a_room(share, 0.0)], must, by_logarithm)


def sunny_room(share: float, within: float) -> Any:
    name = f"a sun of 2e5 that fills {share:.0%} of a room does not black it out"
    return by_key(name, [part_of_a_room(share, SUN)], near(1.0, within), by_logarithm)


def sunny_room_by_highlights(share: float) -> Any:
    name = f"a sun of 2e5 that fills {share:.0%} of a room darkens it by two stops and no more"
    must = that("two stops below key", lambda exposure: 0.1 < exposure < 0.26)
    return by_highlights(name, [part_of_a_room(share, SUN)], must, by_maximum)


PINHOLE = Intrinsics(4, 1, 4.0, 4.0, 2.0, 0.5)
FOUR_CODES = np.array([0, 1, 128, 255])
QUARTER = [0, 1 / 255 / 4, float(linear_to_srgb(srgb_to_linear(128 / 255) / 4)), float(linear_to_srgb(0.25))]


def re_exposed(given: tuple[float, float]) -> list[float]:
    """The four codes of a frame of one exposure, at another one."""
    exposure, reference = given
    codes = np.repeat(FOUR_CODES[None, :, None], 3, axis=2).astype(np.uint8)
    frame = RgbdFrame(codes, np.ones((1, 4)), PINHOLE, np.eye(4), exposure)
    return unproject_frame(frame, reference_exposure=reference).srgb[:, 0].tolist()


def encoded_scaled(given: tuple[float, float]) -> list[float]:
    """Naive: scales the encoded colour."""
    return (FOUR_CODES / 255 * np.float64(given[1]) / given[0]).tolist()


def upper_piece(given: tuple[float, float]) -> list[float]:
    """Naive: the upper piece of the curve everywhere is negative near black."""
    return (1.055 * (srgb_to_linear(FOUR_CODES / 255) * given[1]) ** (1 / 2.4) - 0.055).tolist()


def re_exposes(name: str, exposure: float, reference: float, must: Must, naive: Any = None) -> Any:
    return row(name, (exposure, reference), re_exposed, must, naive)


def encoded_in_float32(given: tuple[Any, float]) -> list[int]:
    return encoded((np.float32(given[0]), given[1]))


LIGHTS = [
    ("black is 0", [0.0], 1.0, [0]),
    ("white is 255", [1.0], 1.0, [255]),
    ("a saturated red of 1e6 stays red", [1e6, 0.0, 0.0], 1.0, [255, 0, 0]),
    ("a saturated blue of 1e-6 is black and does not wrap", [0.0, 0.0, 1e-6], 1.0, [0, 0, 0]),
    ("light of 1e-6 is seen under an exposure of 1e6", [1e-6], 1e6, [255]),
    ("light of 1e6 is white", [1e6], 1.0, [255]),
    ("a sun of 2e5 is white", [SUN], 1.0, [255]),
    ("a sun of 2e5 is grey under an exposure of 1e-6", [SUN], 1e-6, [124]),
    ("infinite light is white", [np.inf], 1.0, [255]),
    ("infinite light is black under an exposure of 0", [np.inf, 1.0], 0.0, [0, 0]),
    ("a NaN pixel is black", [np.nan, 1.0], 1.0, [0, 255]),
    ("light of minus infinity is black", [-np.inf, -1.0], 1.0, [0, 0]),
    ("denormal light is black", [5e-324, -5e-324], 1.0, [0, 0]),
    ("light of 1e300 is white under an exposure of 1e300", [1e300, 0.0], 1e300, [255, 0]),
    ("light of 1e300 is seen under an exposure of 1e-300", [1e300], 1e-300, [255]),
]
CURVE = [
    row(
        "every 8 bit code comes back after decoding and encoding",
        CODES,
        lambda codes: encode_exposed(srgb_to_linear(codes / 255), 1.0),
        equal(CODES),
    ),
    row(
        "every 8-bit code comes back through float32 as well",
        CODES,
        lambda codes: np.rint(linear_to_srgb(srgb_to_linear(np.float32(codes) / np.float32(255))) * 255),
        equal(CODES.astype(np.float32)),
    ),
    row(
        "the two pieces of the curve meet without a step",
        0.0031308,
        lambda join: np.abs(np.diff(linear_to_srgb(join + AROUND))).max(),
        at_most(1e-7),
        step_with_the_other_threshold,
    ),
    row(
        "codes are rounded at their edges and not cut off",
        srgb_to_linear((CODES[:-1] + 0.501) / 255),
        lambda light: encode_exposed(light, 1.0).tolist(),
        equal((CODES[:-1] + 1).tolist()),
    ),
    row(
        "float32 decodes within 3e-7 of float64",
        np.linspace(0, 1, 10001),
        lambda srgb: np.abs(srgb_to_linear(srgb.astype(np.float32)) - srgb_to_linear(srgb)).max(),
        at_most(3e-7),
        lambda srgb: np.abs(srgb.astype(np.float16).astype(float) ** 2.4 - srgb_to_linear(srgb)).max(),
    ),
    row(
        "encoding the smallest float32 keeps it above 0",
        np.float32(1e-45),
        lambda light: float(linear_to_srgb(light)),
        that("above 0, below 1e-43", lambda came: 0 < came < 1e-43),
        lambda light: float(1.055 * light ** (1 / 2.4) - 0.055),
    ),
]
NEAR_1 = near(1.0, 0.3)
BOTH_INFINITIES = [np.inf, -np.inf, 0]
BY_KEY = [
    by_key("a black frame is metered as 1", [GREY * 0], equal(1.0), by_mean),
    by_key("no frame is metered as 1", [], equal(1.0), by_mean),
    by_key("a frame without pixels is metered as 1", [GREY[:0]], equal(1.0), by_mean),
    by_key("one NaN pixel does not decide the exposure", with_pixel(np.nan), NEAR_1, by_mean),
    by_key("one infinite pixel does not decide the exposure", with_pixel(np.inf), NEAR_1, by_mean),
    by_key("one pixel of both infinities does not decide the exposure", with_pixel(BOTH_INFINITIES), NEAR_1, by_mean),
    by_key("a sun of 2e5 in four pixels does not black out the room", [with_sun()], near(1.0, 0.01), by_mean),
    *(sunny_room(share, within) for share, within in ((0.01, 0.05), (0.05, 0.15), (0.2, 0.5))),
    *map(dark_room, (0.4, 0.7, 0.99)),
    by_key("one negative pixel does not decide the exposure", with_pixel(-10.0), near(1.1, 0.2), by_mean),
    by_key(
        "a frame of the smallest float32 has a finite exposure",
        [np.full((6, 8, 3), 1e-45, np.float32)],
        near(8.56e43, 1e41),
        lambda pictures: float(np.float32(0.12) / np.mean(pictures[0])),
    ),
    by_key("light too dim for any exposure is metered as 1", [np.full((6, 8, 3), 1e-320)], equal(1.0), by_mean),
]
BY_HIGHLIGHTS = [
    by_highlights("a black frame is metered as 1 by highlights", [GREY * 0], equal(1.0), by_maximum),
    by_highlights("no frame is metered as 1 by highlights", [], equal(1.0), by_maximum),
    by_highlights("one NaN pixel does not lower the exposure", with_pixel(np.nan), NEAR_1, by_maximum),
    by_highlights("one infinite pixel does not lower the exposure", with_pixel(np.inf), NEAR_1, by_maximum),
    by_highlights(
        "a lamp of 1 % of the picture may clip",
        [part_of_a_room(0.01, 50.0)],
        that("at most a stop below key", lambda exposure: 0.45 < exposure < 1.05),
        by_maximum,
    ),
    by_highlights(
        "a window of a fifth of the picture that is four times white does not clip",
        [part_of_a_room(0.2, 4.0)],
        near(0.8 / 4.0, 1e-9),
        by_mean,
    ),
    *map(sunny_room_by_highlights, (0.05, 0.2)),
]
WHITE, A_QUARTER = equal([0.0, 1.0, 1.0, 1.0]), near(QUARTER, 1e-6)
EXPOSURES = [
    re_exposes("1e300 times the exposure keeps black and makes all else white", 1e-300, 1.0, WHITE, encoded_scaled),
    re_exposes("a 1e300th of the exposure makes all black", 1.0, 1e-300, near([0.0] * 4, 1e-290), upper_piece),
    re_exposes("a quarter of the exposure is a quarter of the linear light", 1.0, 0.25, A_QUARTER, encoded_scaled),
    re_exposes("a reference exposure of 0 is refused", 1.0, 0.0, refused("expected a positive, finite exposure")),
    re_exposes("a ratio of exposures beyond float64 is refused", 1e-320, 1.0, refused("a ratio of inf")),
]
NO_EXPOSURE = refused("expected a finite exposure")
CASES = [
    *(row(name, (light, exposure), encoded, equal(codes), encoded_by_hand) for name, light, exposure, codes in LIGHTS),
    row("denormal light is seen under a huge exposure", ([1e-310], 1e308), encoded, equal([25]), encoded_in_float32),
    *(row(f"an exposure of {e} is refused", ([0.5], e), encoded, NO_EXPOSURE) for e in (np.nan, np.inf, -1.0)),
    *CURVE,
    *BY_KEY,
    *BY_HIGHLIGHTS,
    *EXPOSURES,
]

test_hard_case = each(CASES)
