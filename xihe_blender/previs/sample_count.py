"""The sample count: how many must Cycles take so that its noise does not matter for the light that is estimated?

The quantity that matters is the light at the estimation positions as nine SH coefficients. Before the walk a pilot
renders a few frames of it at two small numbers of samples with seeds of their own, fits how the error of these
coefficients falls, and takes the smallest number that reaches the target, up to a maximum. The error of a capture is
that of `projection` on the points sampled from it: linear, cheap, and as exposed to the renderer's noise as any
estimator. The reference probe tells its own noise, position by position; see `reference_probe`.

The error has two parts, and both are in the target. Noise, whose square falls as 1/samples, is how far two renders
with different seeds lie apart. Bias is how far renders with few samples lie off those with more: light that is clipped
at white pixel by pixel before the noise is averaged out loses energy (falls as 1/samples; without a denoiser it is all
there is), and the denoiser smears what it takes for noise (falls about as its root). In `bedroom_night` the denoiser's
bias is 2.7 % at 4 samples, where noise is 1.1 %.

Rejected: rendering each frame in batches until their spread is small enough. Denoised one by one, batches keep the bias
of the few samples each has, and their spread does not show it: in `bedroom_night` four batches of 4 are off by 2.8 %,
their spread says 0.7 %, and 8 samples denoised as one are off by 2.1 %. Batches without denoiser need four times the
samples. A pilot leaves one render per frame with one seed, so that a frame in which nothing changed needs none. It
costs 36 samples in balanced, for a walk of 24 frames.

Expected over real error of captures at 4 samples (128x96, two views, 8 seeds against 192 samples): `cornell_box` 1.2
to 1.4, `bedroom_night` 0.7 to 0.9, `living_room` 1.0 to 1.1, by the pilot's seed.

Not here: noise that a phone's sensor adds, and the pictures of the comparison, whose samples are fixed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.capture.render import MAX_SEED, RenderSettings
from xihe_blender.capture.scanner import open_scanner
from xihe_blender.jobs import Job, Progress, timed
from xihe_blender.previs.plan import PrevisPlan
from xihe_blender.previs.presets import Preset
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.survey import SceneSurvey
from xihenet.camera import unproject_frame
from xihenet.camera_path.placement import evenly_chosen
from xihenet.phone.metering import KEY_LUMINANCE, MOST_STOPS
from xihenet.records import ArrayF64
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import project_anchors
from xihenet.sphere import AnchorLattice
from xihenet.trigger import TriggerSettings, colour_change

LARGE_STEP = 4
"""The pilot's larger number of samples over its smaller one."""

SMALLEST_SHARE = 32
"""The pilot's smaller number of samples is the preset's most over this, and no fewer are ever taken."""

N_PILOT_FRAMES, FRAMES_PER_PILOT = 3, 8
DENOISED_BIAS_RATE, CLIPPED_BIAS_RATE = 0.5, 1.0

SMALLEST_LIGHT = KEY_LUMINANCE / 2**MOST_STOPS * math.sqrt(4 * math.pi * 3)
"""Norm of the coefficients of grey light at the darkest key that metering chooses. Darker light is held against this:
nobody sees its noise."""


@dataclass(frozen=True)
class NoiseModel:
    """How the relative error of nine SH coefficients falls with the number of samples n: see `noise`.

    Parameters
    ----------
    variance : of the noise at one sample, relative to the light's squared norm
    bias : at one sample, relative to the light's norm
    bias_rate : the power of n with which the bias falls
    """

    variance: float
    bias: float
    bias_rate: float

    def noise(self, n_samples: int) -> float:
        """Expected root mean square error at `n_samples`, relative to the light."""
        return math.sqrt(self.variance / n_samples + (self.bias / n_samples**self.bias_rate) ** 2)

    def samples_for(self, target: float, minimum: int, maximum: int) -> int:
        """The smallest number of samples from `minimum` on with at most `target`; `maximum` if it takes more."""
        enough = (n for n in range(minimum, maximum) if self.noise(n) <= target)
        return next(enough, maximum)


def fit_noise(
    small: ArrayLike, other_small: ArrayLike, large: ArrayLike, n_small: int, *, is_denoised: bool
) -> NoiseModel:
    """The noise model of a pilot.

    Parameters
    ----------
    small, other_small, large : (K, 9, 3) coefficients at K positions; the first two with `n_small` samples, the third
        with LARGE_STEP times as many, each with its own seed. ValueError for K = 0
    is_denoised : whether a denoiser or clipping alone makes the bias

    Notes
    -----
    E|a - b|^2 = 2 v for two renders of noise v. The mean of both lies off the larger render by d^2, the square of the
    difference of their biases plus noise of v / 2 + v / LARGE_STEP. Without a denoiser bias stands out from noise, and
    the noise in d^2 is taken off. With one, bias is 0.5 to 2 times the noise (three scenes, 4 samples), and what is
    left of d^2 after that scatters by a factor of 2 with three pilots: so bias^2 = d^2 at `n_small` samples, which is
    right on average where bias equals noise, 32 % too large an error for no bias and 26 % too small for twice the
    noise. Squares are averaged over positions before any root.
    """
    a, b, c = (np.asarray(x, np.float64) for x in (small, other_small, large))
    if not len(c):
        raise ValueError("fit_noise: expected coefficients at one position or more, got none")
    norm2 = np.maximum((c**2).sum(axis=(1, 2)), SMALLEST_LIGHT**2)
    variance = float(np.mean(((a - b) ** 2).sum(axis=(1, 2)) / norm2) / 2)
    apart = float(np.mean((((a + b) / 2 - c) ** 2).sum(axis=(1, 2)) / norm2))
    if is_denoised:
        return NoiseModel(variance * n_small, math.sqrt(apart * n_small), DENOISED_BIAS_RATE)
    bias_difference = math.sqrt(max(0.0, apart - variance * (1 / 2 + 1 / LARGE_STEP)))
    fallen = (n_small**-CLIPPED_BIAS_RATE) * (1 - LARGE_STEP**-CLIPPED_BIAS_RATE)
    return NoiseModel(variance * n_small, bias_difference / fallen, CLIPPED_BIAS_RATE)


@dataclass(frozen=True)
class SampleCount:
    """Samples of captures, per pixel, and what noise does at them; None where that was not measured.

    `capture_noise` is the relative error of the light that is expected, `capture_change` what the trigger would take
    for a change of colour between two captures that differ in noise alone. Measuring took `pilot_s`.
    """

    capture_samples: int
    capture_noise: float | None = None
    pilot_s: float = 0.0
    capture_change: float | None = None


def measure_sample_count(
    scene: bpy.types.Scene,
    plan: PrevisPlan,
    survey: SceneSurvey,
    settings: PrevisSettings,
    exposure: float,
    light_transport: tuple[tuple[str, bool | int], ...] = (),
) -> Job[SampleCount]:
    """A job: the samples that reach `settings.noise_target` in captures of a run on `scene`.

    With `settings.samples` these, and nothing is rendered. The same goes for a path that never sees a position: it
    gets the maximum. The same seed gives the same numbers.
    """
    preset = settings.preset_values
    if settings.samples is not None:
        return SampleCount(settings.samples)
    views = pilot_views(plan, survey)
    if not views:
        return SampleCount(preset.max_samples)
    n_small = pilot_samples(preset)
    capture = replace(settings.capture(plan.size, n_small), light_transport=light_transport)
    measuring = measure_captures(scene, views, capture, exposure, settings.n_anchors, settings.trigger_in_use)
    (noise, change), pilot_s = yield from timed(measuring)
    n_samples = samples_taken(preset, noise, settings.noise_aim)
    return SampleCount(n_samples, noise.noise(n_samples), pilot_s, change * min(1.0, n_small / n_samples))


def pilot_samples(preset: Preset) -> int:
    return max(1, preset.max_samples // SMALLEST_SHARE)


def fewest_samples(preset: Preset) -> int:
    """What a capture takes at least. Not below what was measured: with fewer, the denoiser's bias is another."""
    return max(preset.min_samples, pilot_samples(preset))


def samples_taken(preset: Preset, model: NoiseModel, target: float | None = None) -> int:
    """What `preset` takes where noise falls as `model` says, for its own target or another."""
    wanted = preset.noise_target if target is None else target
    return model.samples_for(wanted, fewest_samples(preset), preset.max_samples)


def pilot_views(plan: PrevisPlan, survey: SceneSurvey) -> list[tuple[int, list[ArrayF64]]]:
    """A few frames, spread over those in which an estimation position is in view, with the positions (3,) in view."""
    probes = {probe.name: probe for probe in plan.probes}
    views = [(frame, [probes[name].at(frame) for name in names]) for frame, names in survey.in_view.items()]
    return evenly_chosen(views, min(N_PILOT_FRAMES, math.ceil(len(views) / FRAMES_PER_PILOT)))


def measure_captures(
    scene: bpy.types.Scene,
    views: Sequence[tuple[int, list[ArrayF64]]],
    settings: RenderSettings,
    exposure: float,
    n_anchors: int,
    trigger: TriggerSettings,
) -> Job[tuple[NoiseModel, float]]:
    """A job: the noise model of captures, and what change of colour `trigger` sees in noise with `settings.samples`.

    That change is the largest, over views and positions, of what two renders of one view with different seeds have. It
    is a square of differences, so it falls as the variance does, as 1/samples.
    """
    lattice, changes = AnchorLattice(n_anchors), []
    steps = (settings.samples, settings.samples, LARGE_STEP * settings.samples)
    lights: tuple[list[ArrayF64], ...] = ([], [], [])
    with open_scanner(scene, settings) as scanner:
        scanner.exposure = exposure
        for number, (frame, positions) in enumerate(views):
            scanner.move_to(frame)
            seen = []
            for index, n_samples in enumerate(steps):
                done = len(steps) * number + index
                yield Progress(done, len(steps) * len(views), "measuring the noise of a few samples")
                # By seeds that neither the walk nor another pilot uses.
                seed = (settings.seed + 1 + done) % MAX_SEED
                scanner.scene.cycles.samples, scanner.scene.cycles.seed = n_samples, seed
                cloud = unproject_frame(scanner.acquire_environment_scan())
                seen.append([sample_unit_sphere(cloud, position_m, lattice) for position_m in positions])
                lights[index].extend(project_anchors(sphere, lattice) for sphere in seen[-1])
            changes += [colour_change(a, b, lattice, trigger) for a, b in zip(seen[0], seen[1], strict=True)]
        is_denoised = scanner.scene.cycles.use_denoising
    small, other_small, large = map(np.stack, lights)
    return fit_noise(small, other_small, large, settings.samples, is_denoised=is_denoised), max(changes)
