"""Trigger thresholds: what do they cost, and what do they save? A table over the captures that previs runs kept.

    python addon_tests/bench/trigger.py out/living_room out/light_temperature ...

For each setting and run: the share of steps that made an estimate, for which reasons, and the mean SHC RMSE of the
light in use against the rendered truth. Theta lies above the noise of the captures, as in the run itself. With a
view angle of 180 degrees the trigger asks a surface whatever the angle it is seen from. Nothing is rendered.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from given import given

from xihe_blender.previs.prepare import above_noise
from xihe_blender.previs.settings import PREVIS_TRIGGER
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import ControllerSettings, XiheController
from xihenet.io.recording import load_frame
from xihenet.metrics import shc_rmse
from xihenet.records import RgbdFrame, StepReport
from xihenet.trigger import RULES, TriggerSettings

FIRED = ("first", "colour", "coverage")
EVERY_FRAME = RULES["every-frame"]
CANDIDATES = [
    replace(PREVIS_TRIGGER, view_angle_deg=180.0), replace(PREVIS_TRIGGER, theta=0.005), PREVIS_TRIGGER,
]  # fmt: skip


@dataclass(frozen=True)
class Recorded:
    """A run's captures, its positions and the truth at each, frame by frame."""

    name: str
    frames: list[RgbdFrame]
    positions: dict[str, list[float]]
    truth: list[dict[str, np.ndarray]]
    exposure: float
    capture_change: float | None


def read_run(folder: Path) -> Recorded:
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    active = [entry for entry in results["frames"] if entry["active"]]
    return Recorded(
        folder.name,
        [load_frame(folder / "work" / f"capture_{entry['frame']:04d}.exr") for entry in active],
        {probe["name"]: probe["position_m"] for entry in active for probe in entry["probes"]},
        [{probe["name"]: np.array(probe["sh_truth"]) for probe in entry["probes"]} for entry in active],
        results["settings"]["reference_exposure"],
        results["settings"]["noise"]["trigger"],
    )


def walk(recorded: Recorded, settings: TriggerSettings) -> tuple[Counter[str], int, float]:
    """How many steps fired, by reason, of how many, and the mean error against truth of the light in use."""
    chain = ControllerSettings(settings, reference_exposure=recorded.exposure)
    known = [(step, error) for _, step, error in steps_of(recorded, "projection", chain) if error is not None]
    reasons = Counter(step.decision.reason for step, _ in known)
    return reasons, len(known), float(np.mean([error for _, error in known]))


def steps_of(
    recorded: Recorded, estimator: str, chain: ControllerSettings
) -> Iterator[tuple[RgbdFrame, StepReport, float | None]]:
    """Each step of a session, and the SHC RMSE of the light that is then in use; None where there is none yet."""
    controller = XiheController(LocalBackend(estimators.load(estimator)), chain)
    for name, position in recorded.positions.items():
        controller.add_position(name, position)
    for frame, truth in zip(recorded.frames, recorded.truth, strict=True):
        for name, step in controller.step(frame, active=list(truth)).items():
            light = controller.light(name)
            yield frame, step, None if light is None else shc_rmse(light.sh_radiance, truth[name])


def cell(recorded: Recorded, settings: TriggerSettings) -> str:
    """A walk as the table tells it."""
    reasons, n_steps, error = walk(recorded, above_noise(settings, recorded.capture_change))
    counts = [reasons[reason] for reason in FIRED]
    return f"{sum(counts) / n_steps:.2f} ({'+'.join(map(str, counts))} of {n_steps}) / {error:.3f}"


def main() -> None:
    runs = [read_run(folder) for folder in given(__doc__, "runs+").runs]
    headings = [f"theta {one.theta}, {one.view_angle_deg:g} degrees" for one in CANDIDATES]
    print("share of steps that fire (first+colour+coverage of all) / error against truth")
    print("| scene | every frame | " + " | ".join(headings) + " |\n| --- |" + " --- |" * (1 + len(CANDIDATES)))
    for run in runs:
        cells = [f"{walk(run, EVERY_FRAME)[2]:.3f}", *(cell(run, settings) for settings in CANDIDATES)]
        print(f"| `{run.name}` | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
