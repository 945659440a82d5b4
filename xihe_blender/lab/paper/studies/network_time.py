"""Network time: how long are bytes under way, and what do further positions cost?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.lab.paper.clouds import views
from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, measured, measured_ratio
from xihenet.codec import encode_cloud
from xihenet.edge.batching import Inference
from xihenet.phone import LINKS
from xihenet.phone.network import arrival_frames
from xihenet.records import ArrayF64, ArrayInt
from xihenet.sphere import AnchorLattice

POSITIONS = (1, 2, 4)
PAPER_MS = {("wifi", 1): 8.4, ("wifi", 4): 1.28 * 8.4}
LINK = (
    "A simulated link that carries our clouds. Its median with one position, and the cost of four, were set to the "
    "paper's figures, so their agreement is no result; home WiFi and LTE are from other sources."
)
LOOPBACK = (
    "From the request to the last light, the server's work included, in one process on one machine: positions ask "
    "together but share its cores, and there is no network delay."
)
RATIO = "The paper's figure is of university WiFi."


def cloud_bytes(sessions: Sequence[Session]) -> list[int]:
    """Of clouds of one view each, at most 40 of a room. UserError where no place is in view."""
    lattice = AnchorLattice(1280)
    clouds = [view.cloud(lattice) for view in views(sessions, 40)]
    if not clouds:
        raise UserError("no frame of the rooms has a place in view: give more --scenes")
    return [len(encode_cloud(cloud)) for cloud in clouds]


def link_ms(name: str, sizes: ArrayInt, rng: np.random.Generator) -> ArrayF64:
    """(N,) network time of requests of (N,) bytes, milliseconds; those that are lost for good are left out."""
    link = LINKS[name]
    ms = 1e3 * (arrival_frames([0.0] * len(sizes), sizes, link, rng) - link.processing_s)
    return np.asarray(ms[np.isfinite(ms)])


def measure(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    sizes, rng = np.array(cloud_bytes(sessions)), options.rng
    n = 1000 if options.quick else 10_000
    for name in LINKS:
        times = {k: link_ms(name, rng.choice(sizes, (n, k)).sum(axis=1), rng) for k in POSITIONS}
        for k, ms in times.items():
            what = f"{name}: {k} position{'s' * (k > 1)}, median"
            found = measured(ms, rng, statistic=np.median)
            paper = PAPER_MS.get((name, k))
            yield Row(what, "ms", *found, "cannot be compared", LINK, paper, "requests", name, k)
        yield _ratio(name, times[4], times[1], rng, "requests", 1.28 if name == "wifi" else None)
    yield from _over_loopback(options)


def _over_loopback(options: StudyOptions) -> Iterator[Row]:
    from xihenet.edge.bench import served, step_times_ms

    times, rng = {}, options.rng
    with served(Inference("lattice")) as (port, server_ms):
        for k in POSITIONS:
            times[k] = step_times_ms(port, server_ms, k, 40 if options.quick else 400)["estimate"]
    for k, ms in times.items():
        what = f"loopback and server: {k} position{'s' * (k > 1)}, median"
        found = measured(ms, rng, statistic=np.median)
        yield Row(what, "ms", *found, "other machine", LOOPBACK, None, "frames", "loopback and server", k)
    yield _ratio("loopback and server", times[4], times[1], rng, "frames", 1.28)


def _ratio(name: str, four: ArrayF64, one: ArrayF64, rng: np.random.Generator, cases: str, paper: float | None) -> Row:
    n = min(len(four), len(one))
    found = measured_ratio(four[:n], one[:n], rng, average=np.median)
    sentence = LINK if cases == "requests" else f"{LOOPBACK} {RATIO}"
    return Row(f"{name}: four positions over one", "times", *found, "cannot be compared", sentence, paper, cases)


STUDY = Study(
    "network_time",
    "Network",
    40,
    "The paper times the transfer of one encoded cloud to the server and of the light back, over university WiFi, home "
    "WiFi and LTE, with one, two and four positions.",
    measure,
    "positions",
    "Network time, over loopback with the server's work, ms.",
)
