"""Hard cases of colour: 8 bits, exposure, and light from 1e-320 to infinity."""

from __future__ import annotations

from typing import Any

import numpy as np

from addon_tests.pure.hard_cases.hard_case import HardCase, at_most, equal, near, refused, that
from xihenet.camera import encode_exposed, metered_exposure, unproject_frame
from xihenet.colour import linear_to_srgb, srgb_to_linear
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
LIGHTS = {
    "black is 0": (([0.0], 1.0), [0]),
    "white is 255": (([1.0], 1.0), [255]),
    "a saturated red of 1e6 stays red": (([1e6, 0.0, 0.0], 1.0), [255, 0, 0]),
    "a saturated blue of 1e-6 is black and does not wrap": (([0.0, 0.0, 1e-6], 1.0), [0, 0, 0]),
    "light of 1e-6 is seen under an exposure of 1e6": (([1e-6], 1e6), [255]),
    "light of 1e6 is white": (([1e6], 1.0), [255]),
    "a sun of 2e5 is white": (([SUN], 1.0), [255]),
    "a sun of 2e5 is grey under an exposure of 1e-6": (([SUN], 1e-6), [124]),
    "infinite light is white": (([np.inf], 1.0), [255]),
    "infinite light is black under an exposure of 0": (([np.inf, 1.0], 0.0), [0, 0]),
    "a NaN pixel is black": (([np.nan, 1.0], 1.0), [0, 255]),
    "light of minus infinity is black": (([-np.inf, -1.0], 1.0), [0, 0]),
    "denormal light is black": (([5e-324, -5e-324], 1.0), [0, 0]),
    "light of 1e300 is white under an exposure of 1e300": (([1e300, 0.0], 1e300), [255, 0]),
    "light of 1e300 is seen under an exposure of 1e-300": (([1e300], 1e-300), [255]),
}
ENCODING = [
    HardCase(
        STAGE,
        "denormal light is seen under a huge exposure",
        ([1e-310], 1e308),
        encoded,
        equal([25]),
        lambda given: encoded((np.float32(given[0]), given[1])),
    ),
    *(HardCase(STAGE, name, given, encoded, equal(codes), encoded_by_hand) for name, (given, codes) in LIGHTS.items()),
    *(
        HardCase(
            STAGE,
            f"an exposure of {exposure} is refused",
            ([0.5], exposure),
            encoded,
            refused("expected a finite exposure"),
            encoded_by_hand,
        )
        for exposure in (np.nan, np.inf, -1.0)
    ),
]

# ------------------------------------------------------------------------------------------------------ the curve

CODES = np.arange(256)


def power_of_2_2(codes: np.ndarray) -> np.ndarray:
    """Naive: decoded as published, encoded by a plain power."""
    return np.rint(srgb_to_linear(codes / 255) ** (1 / 2.2) * 255).astype(int)


def step_at_the_join(join: float) -> float:
    """How much the encoded colour rises over the smallest steps around where the curve's two pieces meet."""
    light = join + np.arange(-50, 51) * 1e-12
    return float(np.abs(np.diff(linear_to_srgb(light))).max())


def step_with_the_other_threshold(join: float) -> float:
    """Naive: the threshold of decoding used for encoding."""
    light = 0.04045 + np.arange(-50, 51) * 1e-12
    return float(np.abs(np.diff(np.where(light <= 0.04045, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055))).max())


def just_above_the_edge(code: np.ndarray) -> list[int]:
    return encode_exposed(srgb_to_linear((code + 0.501) / 255), 1.0).tolist()


CURVE = [
    HardCase(
        STAGE,
        "every 8-bit code comes back after decoding and encoding",
        CODES,
        lambda codes: encode_exposed(srgb_to_linear(codes / 255), 1.0),
        equal(CODES),
        power_of_2_2,
    ),
    HardCase(
        STAGE,
        "every 8-bit code comes back through float32 as well",
        CODES,
        lambda codes: np.rint(linear_to_srgb(srgb_to_linear(np.float32(codes) / np.float32(255))) * 255),
        equal(CODES.astype(np.float32)),
        lambda codes: np.rint((srgb_to_linear(codes / 255).astype(np.float16) ** np.float16(1 / 2.2)) * 255),
    ),
    HardCase(
        STAGE,
        "the two pieces of the curve meet without a step",
        0.0031308,
        step_at_the_join,
        at_most(1e-7),
        step_with_the_other_threshold,
    ),
    HardCase(
        STAGE,
        "codes are rounded at their edges and not cut off",
        CODES[:-1],
        just_above_the_edge,
        equal((CODES[:-1] + 1).tolist()),
        lambda code: np.floor(linear_to_srgb(srgb_to_linear((code + 0.501) / 255)) * 255).tolist(),
    ),
    HardCase(
        STAGE,
        "float32 decodes within 3e-7 of float64",
        np.linspace(0, 1, 10001),
        lambda srgb: float(np.abs(srgb_to_linear(srgb.astype(np.float32)) - srgb_to_linear(srgb)).max()),
        at_most(3e-7),
        lambda srgb: float(np.abs(srgb.astype(np.float16).astype(float) ** 2.4 - srgb_to_linear(srgb)).max()),
    ),
    HardCase(
        STAGE,
        "encoding the smallest float32 keeps it above 0",
        np.float32(1e-45),
        lambda light: float(linear_to_srgb(light)),
        that("above 0, below 1e-43", lambda came: 0 < came < 1e-43),
        lambda light: float(1.055 * light ** (1 / 2.4) - 0.055),
    ),
    HardCase(
        STAGE,
        "NaN stays NaN beside colours that do not",
        np.array([np.nan, -1.0, 2.0]),
        lambda srgb: np.isnan(srgb_to_linear(srgb)).tolist() + srgb_to_linear(srgb)[1:].tolist(),
        equal([True, False, False, 0.0, 1.0]),
        lambda srgb: np.isnan(((srgb + 0.055) / 1.055) ** 2.4).tolist() + [0.0, 1.0],
    ),
]

# ------------------------------------------------------------------------------------------------------- metering

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


def metered_by_hand(pictures: list[np.ndarray]) -> float:
    """Naive: the mean of all there is."""
    return float(0.12 / np.mean([np.mean(picture) for picture in pictures]))


def part_of_a_room(share: float, value: float) -> np.ndarray:
    """A room of surfaces around 0.12, a `share` of whose pixels are `value`."""
    luminance = 0.12 * np.exp(np.random.default_rng(0).normal(0, 0.7, 4096))
    luminance *= 0.12 / np.median(luminance[round(share * luminance.size) :])
    luminance[: round(share * luminance.size)] = value
    return np.repeat(luminance[:, None], 3, axis=1)


def metered_by_logarithm(pictures: list[np.ndarray]) -> float:
    """Naive: the geometric mean, black pixels counting as a thousandth of the arithmetic one."""
    keys = [np.exp(np.log(np.maximum(picture, picture.mean() * 1e-3)).mean()) for picture in pictures]
    return float(0.12 / np.mean(keys))


def by_key(pictures: list[np.ndarray]) -> float:
    return metered_exposure(pictures, "key")


def by_highlights(pictures: list[np.ndarray]) -> float:
    return metered_exposure(pictures, "highlights")


def by_hand_down(pictures: list[np.ndarray]) -> float:
    """Naive: nothing may be brighter than white."""
    return float(1.0 / max(np.max(picture) for picture in pictures))


NEAR_1 = near(1.0, 0.3)
METERING = [
    HardCase(STAGE, "a black frame is metered as 1", [GREY * 0], by_key, equal(1.0), metered_by_hand),
    HardCase(STAGE, "no frame is metered as 1", [], by_key, equal(1.0), metered_by_hand),
    HardCase(STAGE, "a frame without pixels is metered as 1", [GREY[:0]], by_key, equal(1.0), metered_by_hand),
    HardCase(
        STAGE,
        "one NaN pixel does not decide the exposure",
        with_pixel(np.nan),
        by_key,
        NEAR_1,
        metered_by_hand,
    ),
    HardCase(
        STAGE,
        "one infinite pixel does not decide the exposure",
        with_pixel(np.inf),
        by_key,
        NEAR_1,
        metered_by_hand,
    ),
    HardCase(
        STAGE,
        "one pixel of both infinities does not decide the exposure",
        with_pixel([np.inf, -np.inf, 0]),
        by_key,
        NEAR_1,
        metered_by_hand,
    ),
    HardCase(
        STAGE,
        "a sun of 2e5 in four pixels does not black out the room",
        [with_sun()],
        by_key,
        near(1.0, 0.01),
        metered_by_hand,
    ),
    *(
        HardCase(
            STAGE,
            f"a sun of 2e5 that fills {share:.0%} of a room does not black it out",
            [part_of_a_room(share, SUN)],
            by_key,
            near(1.0, within),
            metered_by_logarithm,
        )
        for share, within in ((0.01, 0.05), (0.05, 0.15), (0.2, 0.5))
    ),
    *(
        HardCase(
            STAGE,
            f"darkness that fills {share:.0%} of a room does not blow out the rest",
            [part_of_a_room(share, 0.0)],
            by_key,
            that("at least 1, and half of the room below white", lambda exposure: 1 <= exposure <= 1 / 0.12 + 1e-9),
            metered_by_logarithm,
        )
        for share in (0.4, 0.7, 0.99)
    ),
    HardCase(
        STAGE,
        "one negative pixel does not decide the exposure",
        with_pixel(-10.0),
        by_key,
        near(1.1, 0.2),
        metered_by_hand,
    ),
    HardCase(
        STAGE,
        "a frame of the smallest float32 has a finite exposure",
        [np.full((6, 8, 3), 1e-45, np.float32)],
        by_key,
        near(8.56e43, 1e41),
        lambda pictures: float(np.float32(0.12) / np.mean(pictures[0])),
    ),
    HardCase(
        STAGE,
        "light too dim for any exposure is metered as 1",
        [np.full((6, 8, 3), 1e-320)],
        by_key,
        equal(1.0),
        metered_by_hand,
    ),
]
METERING += [
    HardCase(STAGE, "a black frame is metered as 1 by highlights", [GREY * 0], by_highlights, equal(1.0), by_hand_down),
    HardCase(STAGE, "no frame is metered as 1 by highlights", [], by_highlights, equal(1.0), by_hand_down),
    HardCase(
        STAGE,
        "one NaN pixel does not lower the exposure",
        with_pixel(np.nan),
        by_highlights,
        NEAR_1,
        by_hand_down,
    ),
    HardCase(
        STAGE,
        "one infinite pixel does not lower the exposure",
        with_pixel(np.inf),
        by_highlights,
        NEAR_1,
        by_hand_down,
    ),
    HardCase(
        STAGE,
        "a lamp of 1 % of the picture may clip",
        [part_of_a_room(0.01, 50.0)],
        by_highlights,
        that("at most a stop below key", lambda exposure: 0.45 < exposure < 1.05),
        by_hand_down,
    ),
    HardCase(
        STAGE,
        "a window of a fifth of the picture that is four times white does not clip",
        [part_of_a_room(0.2, 4.0)],
        by_highlights,
        near(0.8 / 4.0, 1e-9),
        metered_by_hand,
    ),
    *(
        HardCase(
            STAGE,
            f"a sun of 2e5 that fills {share:.0%} of a room darkens it by two stops and no more",
            [part_of_a_room(share, SUN)],
            by_highlights,
            that("two stops below key", lambda exposure: 0.1 < exposure < 0.26),
            by_hand_down,
        )
        for share in (0.05, 0.2)
    ),
]

# ----------------------------------------------------------------------------------------- re-exposing a frame

PINHOLE = Intrinsics(4, 1, 4.0, 4.0, 2.0, 0.5)
FOUR_CODES = np.array([[[0] * 3, [1] * 3, [128] * 3, [255] * 3]], np.uint8)


def re_exposed(given: tuple[float, float]) -> list[float]:
    """The four codes 0, 1, 128 and 255 of a frame of one exposure, at another one."""
    exposure, reference = given
    frame = RgbdFrame(FOUR_CODES, np.ones((1, 4)), PINHOLE, np.eye(4), exposure)
    return unproject_frame(frame, reference_exposure=reference).srgb[:, 0].tolist()


def re_exposed_by_hand(given: tuple[float, float]) -> list[float]:
    """Naive: scales the encoded colour."""
    return (np.array([0, 1, 128, 255]) / 255 * np.float64(given[1]) / given[0]).tolist()


EXPOSING = [
    HardCase(
        STAGE,
        "1e300 times the exposure keeps black and makes all else white",
        (1e-300, 1.0),
        re_exposed,
        equal([0.0, 1.0, 1.0, 1.0]),
        re_exposed_by_hand,
    ),
    HardCase(
        STAGE,
        "a 1e300th of the exposure makes all black",
        (1.0, 1e-300),
        re_exposed,
        near([0.0] * 4, 1e-290),
        lambda given: encode_floor(given),
    ),
    HardCase(
        STAGE,
        "a quarter of the exposure is a quarter of the linear light",
        (1.0, 0.25),
        re_exposed,
        near([0, 1 / 255 / 4, float(linear_to_srgb(srgb_to_linear(128 / 255) / 4)), float(linear_to_srgb(0.25))], 1e-6),
        re_exposed_by_hand,
    ),
    HardCase(
        STAGE,
        "a reference exposure of 0 is refused",
        (1.0, 0.0),
        re_exposed,
        refused("expected a positive, finite exposure"),
        re_exposed_by_hand,
    ),
    HardCase(
        STAGE,
        "a ratio of exposures beyond float64 is refused",
        (1e-320, 1.0),
        re_exposed,
        refused("a ratio of inf"),
        re_exposed_by_hand,
    ),
    HardCase(
        STAGE,
        "a frame of exposure 0 is refused",
        (0.0, 1.0),
        re_exposed,
        refused("expected a positive factor"),
        re_exposed_by_hand,
    ),
]


def encode_floor(given: tuple[float, float]) -> list[float]:
    """Naive: the upper piece of the curve everywhere is negative near black."""
    return (1.055 * (srgb_to_linear(np.array([0, 1, 128, 255]) / 255) * given[1]) ** (1 / 2.4) - 0.055).tolist()


CASES = [*ENCODING, *CURVE, *METERING, *EXPOSING]
