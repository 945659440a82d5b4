"""Presets: how finely a run renders, by name, and what the panel says of each.

They are points on the front of error against time (`xihe frontier`, docs/frontier.md). Their noise targets are what
`living_room`, the noisiest of the example scenes, has with some 4, 16 and 64 samples per capture at 256x192. The others
would reach them with 1, 2 and 8. In `courtyard`, where the denoiser errs more than the noise, these lie too close
together: so balanced takes 4 samples at least and accurate 24. An estimate is off by some 30 % of the light, to which
noise of 6, 3 and 1.5 % adds, in quadrature, 2 %, 0.5 % and 0.1 % of that.

Nothing here needs NumPy or Blender, since the command line lists presets without either.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Preset:
    """How much rendering effort a run spends.

    Parameters
    ----------
    label : what the panel calls it
    summary : what the panel says of it, without a full stop
    noise_target : relative error of the nine SH coefficients that rendering may cause in captures
    max_samples : Cycles samples per pixel for captures, at most; see `sample_count` for how many are taken
    min_samples : Cycles samples per pixel for captures, at least
    path_samples : Cycles samples per pixel for captures of a path alone, without a position at which a pilot could
        measure the noise, see `kept_session`
    probe_samples : pictures that the reference probe takes, at most; see `reference_probe`
    comparison_samples : Cycles samples per pixel, fixed; 32 at least, since the denoiser takes light of lamps that
        mirrors and shiny things show for noise: with 8 a method's error came out too small, see docs/limits.md
    comparison_step : compare at every n-th frame of the path, and at its last
    """

    label: str
    summary: str
    noise_target: float
    max_samples: int
    min_samples: int = 1
    path_samples: int
    probe_samples: int
    comparison_samples: int
    comparison_step: int = 1

    @property
    def decides(self) -> dict[str, Any]:
        """What decides a run's numbers: not its words, nor `path_samples`, which settings have where they are used."""
        return {name: value for name, value in asdict(self).items() if name not in ("label", "summary", "path_samples")}


DEFAULT = "balanced"
PRESETS = {
    "draft": Preset(
        label="Draft",
        summary="Few samples, every second frame compared: minutes on a laptop",
        noise_target=0.06,
        max_samples=32,
        path_samples=4,
        probe_samples=24,
        comparison_samples=32,
        comparison_step=2,
    ),
    "balanced": Preset(
        label="Balanced",
        summary="Rendering noise stays well below the error of the estimates",
        noise_target=0.03,
        max_samples=64,
        min_samples=4,
        path_samples=16,
        probe_samples=56,
        comparison_samples=32,
    ),
    "accurate": Preset(
        label="Accurate",
        summary="As little noise as ground truth needs; slow",
        noise_target=0.015,
        max_samples=256,
        min_samples=24,
        path_samples=64,
        probe_samples=168,
        comparison_samples=128,
    ),
}
"""By name, from coarse to fine."""
