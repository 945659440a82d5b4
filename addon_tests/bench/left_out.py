"""Left-out frames: which estimator is the best where no light probe has been? A table over simulated phones' walks.

    python addon_tests/bench/left_out.py room_a.blend room_b.blend ...

Each scene has a camera path and virtual objects. The sessions are simulated, twelve frames with every phone profile,
and their truth stays hidden: estimates are held against what left-out frames show (`xihenet.left_out`). For each
session the mean error of each estimator from one frame, judged by all others, and from two thirds of the frames, judged
by the others; at the end in how many sessions each is the best.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from given import given

from xihe_blender.io.blender_output import only_our_output
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run, survey_run
from xihe_blender.previs.run_chain import run_chain
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.state import scene_kept
from xihenet import estimators
from xihenet.camera import unproject_frame
from xihenet.estimators import EstimateContext
from xihenet.io.recording import load_frame
from xihenet.left_out import left_out_errors
from xihenet.phone import profile_names
from xihenet.records import RgbdFrame
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

NAMES = ("lattice", "projection", "ambient")
N_FRAMES = 12
LATTICE = AnchorLattice(1280)
Errors = dict[tuple[bool, str], list[float]]


def session(file: Path, phone: str, folder: Path) -> tuple[PreparedRun, list[RgbdFrame]]:
    """The frames that the phone delivers on a walk through a scene."""
    scene = open_blend(file)
    frames = np.linspace(scene.frame_start, scene.frame_end, N_FRAMES).astype(int).tolist()
    settings = PrevisSettings(preset="draft", size=(96, 72), samples=4, frames=tuple(frames), phone=phone)
    plan, outputs = plan_previs(scene, settings), RunOutputs(folder, file.stem)
    with scene_kept():
        survey = run_blocking(survey_run(scene, plan, outputs))
        run = run_blocking(prepare_run(scene, plan, survey, outputs, settings, load_estimators(settings)))
        phone_in_use = run_blocking(run_chain(run)).phone
        captures = [load_frame(outputs.capture(frame)) for frame in sorted(run.needs.captured)]
        return run, [phone_in_use.see(captured, outputs)[0] for captured in captures]


def errors_of(run: PreparedRun, frames: list[RgbdFrame]) -> Errors:
    """Of all positions, by whether frames were merged and by estimator."""
    points = [unproject_frame(frame, reference_exposure=run.exposure) for frame in frames]
    context = EstimateContext(frame=frames[0], reference_exposure=run.exposure)
    found: Errors = {(is_merged, name): [] for is_merged in (False, True) for name in NAMES}
    for probe in run.plan.probes:
        clouds = [sample_unit_sphere(one, probe.position_m, LATTICE) for one in points]
        for (is_merged, name), errors in found.items():
            estimate = partial(estimators.load(name).estimate, context=context)
            errors += left_out_errors(clouds, estimate, is_merged=is_merged)
    return found


def sessions(files: list[Path]) -> Iterator[tuple[str, Errors]]:
    for file in files:
        for phone in profile_names():
            with tempfile.TemporaryDirectory() as folder:
                yield f"{file.stem}, {phone}", errors_of(*session(file, phone, Path(folder)))


def main() -> None:
    files = given(__doc__, "rooms+").rooms
    best: dict[bool, Counter[str]] = {False: Counter(), True: Counter()}
    print("| session | given | asked | " + " | ".join(NAMES) + " |\n| --- | --- | --- |" + " --- |" * len(NAMES))
    for title, errors in sessions(files):
        for is_merged, shown in ((False, "one frame"), (True, "two thirds")):
            means = {name: float(np.mean(errors[is_merged, name] or [np.nan])) for name in NAMES}
            best[is_merged][min(means, key=means.__getitem__)] += 1
            cells = " | ".join(f"{mean:.4f}" for mean in means.values())
            print(f"| {title} | {shown} | {len(errors[is_merged, NAMES[0]])} | {cells} |", flush=True)
    for is_merged, shown in ((False, "one frame"), (True, "two thirds")):
        counts = ", ".join(f"{name} {best[is_merged][name]}" for name in NAMES)
        print(f"best from {shown}: {counts} of {best[is_merged].total()}")


if __name__ == "__main__":
    with only_our_output():
        main()
