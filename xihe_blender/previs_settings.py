"""What can a user choose for a previs run, and what do the presets choose for them?

Presets are provisional: they are round numbers until the frontier of error against time picks better ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from xihe_blender.errors import UserError
from xihe_blender.render import RenderSettings
from xihenet import estimators
from xihenet.estimators import Estimator, Target
from xihenet.trigger import TriggerSettings


@dataclass(frozen=True)
class Preset:
    """How much rendering effort a run spends.

    Parameters
    ----------
    capture_samples, truth_samples, comparison_samples : Cycles samples per pixel
    truth_width : width of the light probe's panorama in pixels; twice its height
    comparison_step : compare at every n-th frame of the path, and at its last
    """

    capture_samples: int
    truth_width: int
    truth_samples: int
    comparison_samples: int
    comparison_step: int = 1


PRESETS = {
    "draft": Preset(4, 32, 16, 8, comparison_step=2),
    "balanced": Preset(16, 64, 32, 32),
    "accurate": Preset(64, 128, 64, 128),
}

MAX_SEED = 2**31 - 1

PREVIS_TRIGGER = TriggerSettings(theta=0.02, ignored_share=0.25, coverage_theta=0.05)
"""The paper's theta of 0.6 sleeps through a lamp that changes; see docs/trigger.md for how these were chosen."""


@dataclass(frozen=True)
class PrevisSettings:
    """One previs run.

    Parameters
    ----------
    estimator : its registered name
    preset : name of one of PRESETS
    target : "ldr" compares coefficients with light clipped at 1, as the paper does, "hdr" with all of it
    size : of captures and comparisons; None takes 256x192, upright where the scene's picture is
    frames : frame numbers along the path; None takes the scene's range and step
    objects : names of virtual objects to estimate for; None takes all
    exposure : of the phone, locked for the session; None meters it
    seed : of everything that is random
    n_anchors : of the unit sphere
    """

    estimator: str = estimators.DEFAULT
    preset: str = "balanced"
    target: Target = "ldr"
    size: tuple[int, int] | None = None
    frames: tuple[int, ...] | None = None
    objects: tuple[str, ...] | None = None
    exposure: float | None = None
    seed: int = 0
    n_anchors: int = 1280
    trigger: TriggerSettings = field(default_factory=lambda: PREVIS_TRIGGER)

    def __post_init__(self) -> None:
        if self.estimator not in estimators.names():
            known = ", ".join(estimators.names())
            raise UserError(f"there is no estimator {self.estimator!r}: choose one of {known}")
        if self.preset not in PRESETS:
            raise UserError(f"there is no preset {self.preset!r}: choose one of {', '.join(PRESETS)}")
        if self.size is not None and not all(4 <= side <= 8192 for side in self.size):
            raise UserError(
                f"a picture of {self.size[0]}x{self.size[1]} pixels cannot be captured: use 4 to 8192 a side"
            )
        if self.exposure is not None and not (math.isfinite(self.exposure) and self.exposure > 0):
            raise UserError(f"an exposure of {self.exposure:g} makes no picture: give a positive factor, or none")
        if not 0 <= self.seed <= MAX_SEED:
            raise UserError(f"a seed of {self.seed} is out of Cycles' range: give 0 to {MAX_SEED}")

    @property
    def effort(self) -> Preset:
        return PRESETS[self.preset]

    def capture(self, size: tuple[int, int]) -> RenderSettings:
        return RenderSettings(size, self.effort.capture_samples, self.seed)

    def truth(self) -> RenderSettings:
        width = self.effort.truth_width
        # A denoiser would smear the few texels of a probe, and their noise averages out in nine coefficients.
        return RenderSettings((width, width // 2), self.effort.truth_samples, self.seed, denoise=False)

    def comparison(self, size: tuple[int, int]) -> RenderSettings:
        return RenderSettings(size, self.effort.comparison_samples, self.seed)


def load_estimator(settings: PrevisSettings) -> Estimator:
    """The estimator of a run; UserError if a package or a file of weights is missing."""
    try:
        return estimators.load(settings.estimator, settings.n_anchors, settings.target)
    except (ImportError, ValueError) as error:
        raise UserError(f"--estimator {settings.estimator}: {error}") from error
