"""The time from a frame to its light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, measured
from xihe_blender.lab.paper.studies.network_time import cloud_bytes, link_ms
from xihenet.edge.batching import Inference

PAPER_MS = {"wifi": 20.67, "lte": 79.2}
COMPUTING = "Theirs is 20.67 ms less 8.4 ms of WiFi, on a phone's GPU and an RTX 2080Ti; ours is one machine."
WHOLE = (
    "Our measured time on phone and server, plus a simulated link with the paper's times; the paper's figure for LTE "
    "is of an iPhone."
)
LOOPBACK = "Phone and server are one process on one machine, with real HTTP between them."


def measure(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    from xihenet.edge.bench import served, step_times_ms

    n, rng = (60 if options.quick else 600), options.rng
    with served(Inference("lattice")) as (port, server_ms):
        times = step_times_ms(port, server_ms, 1, n)
    computing = times["step"] - times["network"]
    found = measured(computing, rng, statistic=np.median)
    yield Row("on phone and server: median", "ms", *found, "other machine", COMPUTING, 20.67 - 8.4, "frames")
    found = measured(times["step"], rng, statistic=np.median)
    yield Row("whole step over loopback: median", "ms", *found, "other machine", LOOPBACK, None, "frames")
    sizes = np.array(cloud_bytes(sessions))
    for name in ("wifi", "home", "lte"):
        ways = link_ms(name, rng.choice(sizes, n), rng)
        found = measured(computing[: len(ways)] + ways, rng, statistic=np.median)
        yield Row(f"end to end over {name}: median", "ms", *found, "other machine", WHOLE, PAPER_MS.get(name), "frames")


STUDY = Study(
    "end_to_end",
    "End to end",
    10,
    "The paper times an estimate from the frame to its light on three devices: 20.67 ms at best over university WiFi, "
    "under 24.04 ms on all; 79.2 ms over LTE.",
    measure,
)
