"""What do trigger thresholds cost, and what do they save? A table over the captures that previs runs kept.

    python addon_tests/bench/trigger.py out/living_room out/light_temperature ...

For each setting and run: the share of steps that made an estimate, the mean SHC RMSE of the light in force against the
rendered truth, and its RMSE against making an estimate in every frame. Nothing is rendered.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import ControllerSettings, XiheController
from xihenet.metrics import shc_rmse
from xihenet.recording import load_frame
from xihenet.records import RgbdFrame
from xihenet.trigger import TriggerSettings

EVERY_FRAME = TriggerSettings(theta=0.0, coverage_theta=0.0)
CANDIDATES = [
    TriggerSettings(policy="reference"),
    TriggerSettings(),
    *(
        TriggerSettings(theta=theta, ignored_share=ignored)
        for theta in (0.01, 0.02, 0.05)
        for ignored in (0.0, 0.1, 0.25, 0.4)
    ),
]


@dataclass(frozen=True)
class Recorded:
    """A run's captures, its positions and the truth at each, frame by frame."""

    name: str
    frames: list[RgbdFrame]
    positions: dict[str, list[float]]
    truth: list[dict[str, np.ndarray]]
    exposure: float


def read_run(folder: Path) -> Recorded:
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    active = [entry for entry in results["frames"] if entry["active"]]
    return Recorded(
        folder.name,
        [load_frame(folder / "work" / f"capture_{entry['frame']:04d}.npz") for entry in active],
        {probe["name"]: probe["position_m"] for entry in active for probe in entry["probes"]},
        [{probe["name"]: np.array(probe["sh_truth"]) for probe in entry["probes"]} for entry in active],
        results["settings"]["reference_exposure"],
    )


def walk(recorded: Recorded, settings: TriggerSettings) -> tuple[np.ndarray, float, float]:
    """The lights in force, the share of steps that fired, and the mean error against truth."""
    chain = ControllerSettings(settings, reference_exposure=recorded.exposure)
    controller = XiheController(LocalBackend(estimators.load("projection")), chain)
    for name, position in recorded.positions.items():
        controller.add_position(name, position)
    lights, fired, errors = [], [], []
    for frame, truth in zip(recorded.frames, recorded.truth, strict=True):
        for name, step in controller.step(frame).items():
            light = controller.light(name)
            if light is None:
                continue
            lights.append(light.sh_radiance)
            fired.append(step.decision.fire)
            errors.append(shc_rmse(light.sh_radiance, truth[name]))
    return np.array(lights), float(np.mean(fired)), float(np.mean(errors))


def main() -> None:
    runs = [read_run(Path(folder)) for folder in sys.argv[1:]]
    if not runs:
        sys.exit("give the folders of finished previs runs")
    every = {run.name: walk(run, EVERY_FRAME) for run in runs}
    print("share of steps that fire / error against truth / error against estimating in every frame")
    print(f"{'policy':<11}{'theta':>6}{'aside':>7}  " + "".join(f"{run.name:>24}" for run in runs))
    print(f"{'every frame':<24}  " + "".join(f"{f'1.00 / {every[run.name][2]:.3f} / 0.000':>24}" for run in runs))
    for settings in CANDIDATES:
        row = f"{settings.policy:<11}{settings.theta:>6}{settings.ignored_share:>7}  "
        for run in runs:
            lights, fired, error = walk(run, settings)
            drift = shc_rmse(lights, every[run.name][0])
            row += f"{f'{fired:.2f} / {error:.3f} / {drift:.3f}':>24}"
        print(row)


if __name__ == "__main__":
    main()
