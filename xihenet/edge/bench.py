"""The bench of the service: what an estimate costs on this machine, part by part, as `xihe serve --bench` prints it.

Three tables: clouds per second against batch size, without a network; decode, merge and inference by number of anchors,
beside the paper's; and one whole step over loopback, phone and server in one process, with one, two and four positions.
Times are medians. The phone looks around in a room of plain walls, 256 x 192 points a frame.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from xihenet.buffers import merge
from xihenet.camera import pixel_rays
from xihenet.codec import decode_cloud, encode_cloud
from xihenet.controller import ControllerSettings, XiheController
from xihenet.edge.batching import Inference, Job
from xihenet.edge.client import EdgeBackend
from xihenet.edge.http_settings import ServerSettings
from xihenet.edge.protocol import DEFAULT_METHOD
from xihenet.records import ArrayF64, Intrinsics, RgbdFrame, UnitSphereCloud
from xihenet.trigger import RULES

BATCHES, SIZES, POSITIONS = (1, 2, 4, 8, 16), (512, 1280, 2048), (1, 2, 4)
PAPER_MS = {512: (0.23, 0.01, 3.99), 1280: (0.30, 0.01, 5.91), 2048: (0.32, 0.01, 10.80)}
"""Decode, merge and inference on an RTX 2080Ti; no estimate of it is faster than 250 a second."""

REPEATS, FRAMES = 30, 40

STAGES = ("unproject", "sample", "merge", "trigger", "encode", "estimate")
HALF_ROOM_M, PICTURE = np.array([2.0, 1.5, 1.2]), Intrinsics(256, 192, 150.0, 150.0, 128.0, 96.0)


def bench_lines(inference: Inference) -> Iterator[str]:
    """The tables as Markdown, line by line as they are measured."""
    rng = np.random.default_rng(0)
    yield f"Estimator {inference.name}, LDR; medians of {REPEATS} repeats."
    yield ""
    yield "| clouds in a batch | ms a cloud | clouds/s |"
    yield "| --- | --- | --- |"
    for size in BATCHES:
        jobs = [Job(random_cloud(rng, 1280), "ldr") for _ in range(size)]
        ms = float(np.median(times_ms(partial(inference, jobs), REPEATS))) / size
        yield f"| {size} | {ms:.2f} | {1e3 / ms:.0f} |"
    yield ""
    yield "| anchors | decode, ms | merge, ms | inference, ms | the paper's three, ms |"
    yield "| --- | --- | --- | --- | --- |"
    for n in SIZES:
        yield _by_anchors(inference, rng, n)
    yield ""
    yield f"| positions | {' | '.join(f'{stage}, ms' for stage in STAGES)} | of that network and JSON, ms | step, ms |"
    yield "| --- " * (len(STAGES) + 3) + "|"
    with served(inference) as (port, server_ms):
        for n in POSITIONS:
            yield _step(port, server_ms, n)
    yield ""
    yield "The paper's whole step with one position: 20.67 ms at best, of which 8.4 ms are WiFi. Loopback is no WiFi."


def _by_anchors(inference: Inference, rng: np.random.Generator, n: int) -> str:
    timed = server_times_ms(inference, rng, n, REPEATS).values()
    of_paper = " / ".join(f"{ms:.2f}" for ms in PAPER_MS[n])
    return f"| {n} | {' | '.join(f'{np.median(ms):.2f}' for ms in timed)} | {of_paper} |"


def server_times_ms(inference: Inference, rng: np.random.Generator, n: int, repeats: int) -> dict[str, list[float]]:
    """What decoding, merging and inference of clouds of `n` anchors took, each time that it was done."""
    one, other = random_cloud(rng, n), random_cloud(rng, n)
    payload = encode_cloud(one, DEFAULT_METHOD)
    return {
        "decode": times_ms(lambda: decode_cloud(payload, n, DEFAULT_METHOD), repeats),
        "merge": times_ms(lambda: merge(one, other), repeats),
        "inference": times_ms(lambda: inference([Job(one, "ldr")]), repeats),
    }


def _step(port: int, server_ms: Callable[[], float], n_positions: int) -> str:
    """A row: the stages' medians, of all positions of a frame together."""
    steps = step_times_ms(port, server_ms, n_positions, FRAMES)
    medians = [float(np.median(ms)) for ms in steps.values()]
    return f"| {n_positions} | {' | '.join('-' if np.isnan(ms) else f'{ms:.2f}' for ms in medians)} |"


def step_times_ms(port: int, server_ms: Callable[[], float], n_positions: int, n_frames: int) -> dict[str, ArrayF64]:
    """(F,) each: STAGES, of all positions of a frame together; of the estimate's what is "network"; the whole "step".

    NaN for the network with several positions: their requests are under way together, so times do not
    add up. `port` and `server_ms` are those of `served`. Every frame asks for the light of every position.
    """
    eager = ControllerSettings(RULES["every-frame"], codec=DEFAULT_METHOD)
    rows, network, whole = [], [], []
    with contextlib.closing(EdgeBackend(f"http://127.0.0.1:{port}")) as backend:
        session = XiheController(backend, eager)
        for number in range(n_positions):
            session.add_position(str(number), (0.3 * number, 0.5, -0.5))
        for number in range(n_frames):
            frame, before_ms = seen_frame(number), server_ms()
            start = time.perf_counter()
            reports = session.step(frame, active=list(session.positions)).values()
            whole.append(1e3 * (time.perf_counter() - start))
            rows.append([sum(report.stage_ms.get(stage, 0.0) for report in reports) for stage in STAGES])
            network.append(rows[-1][-1] - (server_ms() - before_ms) if n_positions == 1 else np.nan)
    by_stage = dict(zip(STAGES, np.array(rows).T, strict=True))
    return by_stage | {"network": np.array(network), "step": np.array(whole)}


@contextlib.contextmanager
def served(inference: Inference) -> Iterator[tuple[int, Callable[[], float]]]:
    """The port of a server in a thread, and what says how many milliseconds it has merged, decoded and inferred."""
    from xihenet.edge.server import running

    ready, stopping = threading.Event(), asyncio.Event()
    found: list[tuple[int, Callable[[], float], asyncio.AbstractEventLoop]] = []

    async def run() -> None:
        async with running(inference, ServerSettings(port=0)) as (service, port):

            def spent_ms() -> float:
                stages = ("decode", "merge", "inference")
                return 1e3 * sum(service.metrics.total("xihe_stage_seconds", stage=stage) for stage in stages)

            found.append((port, spent_ms, asyncio.get_running_loop()))
            ready.set()
            await stopping.wait()

    thread = threading.Thread(target=lambda: asyncio.run(run()))
    thread.start()
    ready.wait()
    port, spent_ms, loop = found[0]
    try:
        yield port, spent_ms
    finally:
        loop.call_soon_threadsafe(stopping.set)
        thread.join()


def random_cloud(rng: np.random.Generator, n: int) -> UnitSphereCloud:
    """Half of the anchors, which is what the paper's views show of them."""
    is_set = rng.random(n) < 0.5
    return UnitSphereCloud(rng.random((n, 3)) * is_set[:, None], rng.uniform(0.5, 5, n) * is_set, is_set)


def seen_frame(number: int) -> RgbdFrame:
    """What the phone sees on its way around: walls by their side, dimmed from frame to frame."""
    turn = 2 * np.pi * number / 30
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(ahead, [0, 0, 1.0]), [0, 0, 1.0], -ahead], axis=1)
    rays = pixel_rays(PICTURE) @ pose[:3, :3].T
    with np.errstate(divide="ignore"):  # A ray along a wall never meets it: the infinite reach loses to another wall.
        reach_m = HALF_ROOM_M / np.abs(rays)
    side = reach_m.argmin(axis=-1)
    colours = np.array([[190, 150, 120], [120, 160, 190], [210, 210, 200]]) * (0.8 + 0.2 * np.sin(number))
    return RgbdFrame(colours[side].astype(np.uint8), reach_m.min(axis=-1), PICTURE, pose, frame=number)


def times_ms(call: Callable[[], object], repeats: int) -> list[float]:
    """Milliseconds of each of so many calls, after one that is not counted."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - start))
    return times
