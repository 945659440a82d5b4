"""Steps of the phone: how long does each take?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, measured, measured_ratio
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import ControllerSettings, XiheController
from xihenet.edge.bench import seen_frame
from xihenet.records import ArrayF64
from xihenet.trigger import RULES

PAPER_MS = {"unproject": 0.221, "sample": 0.063, "merge": 0.029 + 0.062, "trigger": 3.040, "encode": 2.832}
WHOLE = "the five steps together"
TIME = "The same steps for 49,152 points and 1280 anchors: theirs on an iPad Pro's GPU, ours in NumPy on one core."
SHARE = (
    "What can be compared is which step takes most of the time. Their trigger and encoding wait for data from the GPU; "
    "NumPy does not wait, but takes longer to assign points to anchors."
)


def stage_times_ms(n_frames: int) -> dict[str, ArrayF64]:
    """(F,) milliseconds of each step and of all, every frame asking for an estimate."""
    eager = ControllerSettings(RULES["every-frame"])
    controller = XiheController(LocalBackend(estimators.load("projection")), eager)
    controller.add_position("place", (0.0, 0.5, -0.5))
    reports = [controller.step(seen_frame(k), active=["place"])["place"] for k in range(n_frames + 1)][1:]
    by_stage = {stage: np.array([one.stage_ms.get(stage, 0.0) for one in reports]) for stage in PAPER_MS}
    return by_stage | {WHOLE: np.sum(list(by_stage.values()), axis=0)}


def measure(_sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    times = stage_times_ms(60 if options.quick else 600)
    paper = PAPER_MS | {WHOLE: sum(PAPER_MS.values())}
    for stage, ms in times.items():
        found = measured(ms, options.rng, statistic=np.median)
        yield Row(f"{stage}: median", "ms", *found, "other machine", TIME, paper[stage], "frames")
    for stage in PAPER_MS:
        found = measured_ratio(times[stage], times[WHOLE], options.rng, average=np.median)
        of_paper = paper[stage] / paper[WHOLE]
        yield Row(f"{stage}: of all five", "of the time", *found, "other machine", SHARE, of_paper, "frames")


STUDY = Study(
    "phone_steps",
    "Steps on the phone",
    20,
    "The paper times each step on three devices with the profiler of Unity, five runs; here its iPad Pro, without "
    "acquiring the scan (1.458 ms).",
    measure,
    needs_rooms=False,
)
