"""Steps of the server: how long do they take, by number of anchors?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, measured, measured_ratio
from xihenet.edge.batching import Inference
from xihenet.edge.bench import PAPER_MS, server_times_ms

STEPS = ("decode", "merge", "inference")
NETWORKS = {"lattice": "our default network", "xihenet": "the paper's network, with weights of ours"}
TIME = "Clouds of which half of the anchors are set: theirs on an RTX 2080Ti, ours in NumPy on one core."
GROWTH = "The growth with the number of anchors can be compared, though small clouds leave most of a GPU idle."


def measure(_sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    repeats, rng = (20 if options.quick else 200), options.rng
    for name, words in NETWORKS.items():
        inference = Inference(name)
        times = {n: server_times_ms(inference, rng, n, repeats) for n in PAPER_MS}
        for n, of_paper in PAPER_MS.items():
            for step, paper in zip(STEPS, of_paper, strict=True):
                if step == "inference" or name == "lattice":
                    of_network = f" of {name} ({words})" if step == "inference" else ""
                    drawn = (f"{step}, {name}", float(n)) if step == "inference" else ("", None)
                    found = measured(times[n][step], rng, statistic=np.median)
                    what = f"{step}{of_network}: {n} anchors, median"
                    yield Row(what, "ms", *found, "other machine", TIME, paper, "calls", *drawn)
        found = measured_ratio(times[2048]["inference"], times[512]["inference"], rng, average=np.median)
        what = f"inference of {name}, 2048 anchors over 512"
        yield Row(what, "times", *found, "other machine", GROWTH, PAPER_MS[2048][2] / PAPER_MS[512][2], "calls")


STUDY = Study(
    "edge_steps",
    "Steps on the server",
    30,
    "The paper times its server with 512, 1280 and 2048 anchors over its test set. What is called merge here, the "
    "paper calls extrapolation.",
    measure,
    "anchors",
    "Inference of one cloud, ms.",
    needs_rooms=False,
)
