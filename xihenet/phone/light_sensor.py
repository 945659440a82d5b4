"""Readings of a phone's ambient light sensor: an intensity and a colour temperature, late and rough.

AR toolkits give one brightness and one colour temperature; the tint (green or magenta) is lost. The sensor collects
light over a while, its gain is off by some percent, which is fixed for each device, and its numbers come in steps.

Chosen: colour temperature by McCamy's cubic, and back along the black-body curve (Kang et al. 2002) relative to that
of 6504 K, so that 6504 K is white, as AR toolkits define it. Rejected: handing the sensor's RGB through, which is what
the `ambient` estimator does when this effect is off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from xihenet.colour import LUMINANCE
from xihenet.phone.settings import Required, Section, SessionFacts, known, number
from xihenet.records import ArrayF64

WHITE_K = 6504.0
LOWEST_K, HIGHEST_K = 1667.0, 25000.0  # where the black-body fit holds
XYZ_FROM_RGB = np.array(
    [[0.4123908, 0.3575843, 0.1804808], [0.2126390, 0.7151687, 0.0721923], [0.0193308, 0.1191948, 0.9505322]]
)
"""Linear Rec.709 with a D65 white, ITU-R BT.709."""
RGB_FROM_XYZ = np.array(
    [[3.2409699, -1.5373832, -0.4986108], [-0.9692436, 1.8759675, 0.0415551], [0.0556301, -0.2039770, 1.0569715]]
)


@dataclass(frozen=True, kw_only=True)
class LightSensor(Section):
    """How late, how rough and in which steps the sensor answers; a step of 0 for none."""

    time_constant_s: float = number("s", 0.0, 60.0)
    gain_error: float = number("of the reading", 0.0, 0.9)  # fixed for a device, uniform, plus or minus
    noise: float = number("of the reading", 0.0, 0.9)  # new in every reading, standard deviation
    intensity_step: float = number("of the reading", 0.0, 0.9)  # relative, since such sensors switch their gain
    temperature_step_k: float = number("K", 0.0, 2000.0)
    lowest_k: float = number("K", LOWEST_K, HIGHEST_K)
    highest_k: float = number("K", LOWEST_K, HIGHEST_K)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lowest_k >= self.highest_k:
            raise ValueError(f"highest_k: expected more than lowest_k ({self.lowest_k:g}), got {self.highest_k:g}")

    def required_by(self, facts: SessionFacts) -> Required:
        changes = known(facts.light_changes, "whether any light changes")
        return changes, "some light changes" if changes else "no light changes"


@dataclass(frozen=True)
class LightReading:
    """`intensity` is a luminance in the scene's own unit, `temperature_k` the correlated colour temperature."""

    intensity: float
    temperature_k: float


def colour_temperature_k(radiance: ArrayLike) -> float:
    """Correlated colour temperature of linear Rec.709 (3,) (McCamy 1992), clipped to its range; white for black."""
    xyz = XYZ_FROM_RGB @ np.asarray(radiance, np.float64)
    total = float(xyz.sum())
    if not (np.isfinite(total) and total > 0):
        return WHITE_K
    x, y = float(xyz[0]) / total, float(xyz[1]) / total
    # Beyond deep blue the cubic turns round; its inverse slope has a pole at y = 0.1858.
    n = (x - 0.3320) / max(y - 0.1858, 1e-3)
    kelvin = -449.0 * n**3 + 3525.0 * n**2 - 6823.3 * n + 5520.33
    return float(np.clip(kelvin, LOWEST_K, HIGHEST_K))


def colour_of_temperature(temperature_k: float) -> ArrayF64:
    """(3,) linear Rec.709 of luminance 1 at a colour temperature; 6504 K is white; held where the fit is valid."""
    white = _black_body(WHITE_K)
    colour: ArrayF64 = np.maximum(_black_body(float(np.clip(temperature_k, LOWEST_K, HIGHEST_K))) / white, 0.0)
    return colour / float(LUMINANCE @ colour)


def read_light(
    ambient: ArrayLike, settings: LightSensor, *, device_rng: np.random.Generator, rng: np.random.Generator
) -> LightReading:
    """One reading of linear scene radiance (3,) >= 0; `device_rng` makes the device's own gain, `rng` this reading."""
    light = np.asarray(ambient, np.float64)
    gain = 1.0 + settings.gain_error * device_rng.uniform(-1.0, 1.0)
    gain *= max(1.0 + settings.noise * float(rng.normal()), 0.0)
    temperature_k = float(np.clip(colour_temperature_k(light), settings.lowest_k, settings.highest_k))
    if settings.temperature_step_k:
        temperature_k = float(np.rint(temperature_k / settings.temperature_step_k)) * settings.temperature_step_k
    return LightReading(_stepped(float(LUMINANCE @ light) * gain, settings.intensity_step), temperature_k)


def ambient_of_reading(reading: LightReading) -> ArrayF64:
    """(3,) the light that an app can rebuild from a reading."""
    return reading.intensity * colour_of_temperature(reading.temperature_k)


def follow_light(times_s: Sequence[float], ambient: ArrayLike, settings: LightSensor) -> ArrayF64:
    """(N, 3) what has been collected at each frame of a session with light `ambient` (N, 3); never looks ahead."""
    light = np.asarray(ambient, np.float64)
    if light.shape != (len(times_s), 3):
        raise ValueError(f"follow_light: expected light of shape ({len(times_s)}, 3), got {light.shape}")
    collected = light.copy()
    for i in range(1, len(light)):
        elapsed_s = times_s[i] - times_s[i - 1]
        if not elapsed_s >= 0:
            raise ValueError(f"follow_light: expected times that never decrease, got {elapsed_s} s between two frames")
        left = np.exp(-elapsed_s / settings.time_constant_s) if settings.time_constant_s else 0.0
        collected[i] = light[i] + (collected[i - 1] - light[i]) * left
    return collected


def _stepped(intensity: float, step: float) -> float:
    """To the nearest of a row of values that grow by `step` each."""
    if step == 0 or intensity <= 0:
        return intensity
    growth = np.log1p(step)
    return float(np.exp(np.rint(np.log(intensity) / growth) * growth))


def _black_body(temperature_k: float) -> ArrayF64:
    """(3,) linear Rec.709 of luminance 1 on the black-body curve; cubic fits in 1000 / T of Kang et al. 2002."""
    t = 1000.0 / temperature_k
    if temperature_k <= 4000:
        x = ((-0.2661239 * t - 0.2343589) * t + 0.8776956) * t + 0.179910
    else:
        x = ((-3.0258469 * t + 2.1070379) * t + 0.2226347) * t + 0.240390
    if temperature_k <= 2222:
        y = ((-1.1063814 * x - 1.34811020) * x + 2.18555832) * x - 0.20219683
    elif temperature_k <= 4000:
        y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867
    else:
        y = ((3.0817580 * x - 5.87338670) * x + 3.75112997) * x - 0.37001483
    return RGB_FROM_XYZ @ np.array([x / y, 1.0, (1 - x - y) / y])
