"""Batching: requests of all clients wait in one queue, and as many of them at a time as there are get one inference.

While an inference runs, what arrives is the next batch; nobody waits for a batch to fill. The queue is bounded: a
request that finds it full is refused at once, so that the ones in it are still answered in time.

What estimates in a few milliseconds does so in the event loop itself. A thread beside it took a tenth more processor
time on one core, where the two hand the interpreter to and fro at every product, half as much again on two, and gave
no more lights a second. What takes longer, or runs on a GPU, has a thread of its own, one, since it fills a core.

Clouds of one size with and without known facing go into different calls of `estimate_batch_with_error`, since unknown
facing is not a facing of 0. An estimator without that method, or with a light sensor to lean on, is asked one by one.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from xihenet import estimators
from xihenet.backend import Answer, LocalBackend, NoAnswer, answer_of, estimate_lights
from xihenet.estimators.base import EstimateContext, Estimator, NotFinite, Target
from xihenet.estimators.lattice import Lattice, lean_on_sensor
from xihenet.records import ArrayF64, Intrinsics, LightEstimate, RgbdFrame, UnitSphereCloud

SENT = frozenset({"frame"})
"""Fields of `EstimateContext` that a request tells: of a frame the light sensor, all that estimators ask of it."""

NOT_SENT = {
    "truth_sh": "is a light probe rendered in Blender, which no client sends",
    "points": "draws from raw points, which clouds of anchors no longer hold",
}
"""Of others, what is said of an estimator that needs them."""

STEPS_TO_QUEUE = 3
"""Of the event loop, from bytes that have arrived to a request that waits."""


@dataclass(frozen=True, eq=False)
class Job:
    """One cloud that wants its light; `ambient` (3,) is the phone's light sensor, carrying the cloud's exposure."""

    cloud: UnitSphereCloud
    target: Target
    ambient: ArrayF64 | None = None


class QueueFull(Exception):
    """More requests wait than can be answered in time."""


def unserved_because(name: str) -> str:
    """Why the estimator `name` cannot answer clouds; empty where it can. ValueError for an unknown name."""
    try:
        missing = sorted(estimators.kind(name).needs - SENT)
    except ImportError as error:
        return str(error)
    return f"{name} {NOT_SENT.get(missing[0], f'needs {missing[0]}, which no client sends')}" if missing else ""


class Inference:
    """The networks, loaded when a size and target are first asked for; called by one thread.

    On a `device` other than "cpu" they run in torch, see `torch_networks`. ValueError for an unknown estimator, for one
    that cannot answer clouds, and for a device that it cannot run on; ImportError without torch.
    """

    def __init__(self, name: str = estimators.DEFAULT, device: str = "cpu") -> None:
        if reason := unserved_because(name):
            raise ValueError(f"{reason}: choose another estimator")
        self.name, self.device = name, device
        # What cannot be loaded is found out at the start.
        estimator = self.estimator(1280, "ldr")
        self.farthest_m, self.is_quick = estimator.farthest_m, device == "cpu" and estimator.is_quick
        nothing = UnitSphereCloud.empty(1280)
        jobs = {"always": Job(nothing, "ldr"), "with_ambient": Job(nothing, "ldr", np.ones(3))}
        known = [when for when, job in jobs.items() if not estimator.unknown_because(nothing, _context_of(job))]
        self.knows_unseen = known[0] if known else "never"
        """When it knows the light of a cloud without an anchor."""

    @functools.lru_cache(maxsize=32)  # noqa: B019  as many as there are sizes and targets, for as long as the process
    def estimator(self, n_anchors: int, target: Target) -> Estimator:
        estimator = estimators.load(self.name, n_anchors, target)
        if self.device != "cpu":
            from xihenet.edge.torch_networks import put_on

            put_on(estimator, self.device)
        return estimator

    def __call__(self, jobs: Sequence[Job]) -> list[LightEstimate]:
        """The light of each, in order; none keeps another from being answered."""
        groups: dict[tuple[int, Target, bool], list[int]] = {}
        for number, job in enumerate(jobs):
            key = len(job.cloud), job.target, job.cloud.surfaces is not None
            groups.setdefault(key, []).append(number)
        lights: dict[int, LightEstimate] = {}
        for (n_anchors, target, _), numbers in groups.items():
            estimator = self.estimator(n_anchors, target)
            answers = estimate_together(estimator, [jobs[number] for number in numbers])
            lights |= dict(zip(numbers, answers, strict=True))
        return [lights[number] for number in range(len(jobs))]


def estimate_together(estimator: Estimator, jobs: Sequence[Job]) -> list[LightEstimate]:
    """The lights of jobs whose clouds all have surfaces or all have none, equal to those that each has alone."""
    contexts = [_context_of(job) for job in jobs]
    return estimate_lights(_InOneBatch(estimator), [job.cloud for job in jobs], contexts, 1.0)


class _InOneBatch(LocalBackend):
    def estimate_together(
        self, clouds: Sequence[UnitSphereCloud], contexts: Sequence[EstimateContext]
    ) -> list[Answer | NoAnswer | NotFinite]:
        if isinstance(self.estimator, Lattice):
            with contextlib.suppress(NotFinite):  # One of them spoils the batch, and nobody knows which.
                return _of_lattice(self.estimator, clouds, contexts)
        return [answer_of(self, *one) for one in zip(clouds, contexts, strict=True)]


def _of_lattice(
    estimator: Lattice, clouds: Sequence[UnitSphereCloud], contexts: Sequence[EstimateContext]
) -> list[Answer | NoAnswer | NotFinite]:
    facing = None if clouds[0].surfaces is None else np.stack([c.surfaces.facing for c in clouds if c.surfaces])
    srgb, distance_m = np.stack([c.srgb for c in clouds]), np.stack([c.distance_m for c in clouds])
    is_set = np.stack([c.is_set for c in clouds])
    sh_radiance, errors = estimator.estimate_batch_with_error(srgb, distance_m, is_set, facing=facing)
    for number, (cloud, context) in enumerate(zip(clouds, contexts, strict=True)):
        if context.frame is not None:
            sensed, coverage = estimator.sensed(cloud, context), is_set[number].mean(keepdims=True)
            sh_radiance[number] = lean_on_sensor(sh_radiance[number][None], coverage, sensed[None])[0]
    return list(zip(sh_radiance, errors.tolist(), strict=True))


def _context_of(job: Job) -> EstimateContext:
    """A frame of one pixel that carries the light sensor, which is all that an estimator asks of a frame here."""
    if job.ambient is None:
        return EstimateContext()
    pixel = np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.float32), Intrinsics(1, 1, 1.0, 1.0, 0.5, 0.5)
    return EstimateContext(RgbdFrame(*pixel, np.eye(4), ambient=job.ambient), reference_exposure=1.0)


@dataclass(frozen=True, eq=False)
class Answered:
    """A light, how long its request waited, how long the inference of its batch took, and how many were in it."""

    light: LightEstimate
    waited_s: float
    inference_s: float
    batch_size: int


class Batcher:
    """The queue and who answers it, in the event loop in which it is made: a thread, or the loop. `close` ends it."""

    def __init__(
        self, inference: Inference, *, max_batch: int = 16, max_queue: int = 48, in_thread: bool = True
    ) -> None:
        self._inference, self.max_batch, self.max_queue = inference, max_batch, max_queue
        self._waiting: deque[tuple[Job, asyncio.Future[Answered], float]] = deque()
        self._thread = ThreadPoolExecutor(1, "xihe-inference") if in_thread else None
        self._running: asyncio.Task[None] | None = None

    def __len__(self) -> int:
        return len(self._waiting)

    async def estimate(self, job: Job) -> Answered:
        """The light of a cloud; `QueueFull` at once if too many wait."""
        if len(self._waiting) >= self.max_queue:
            raise QueueFull(f"{len(self._waiting)} requests wait for inference")
        answer: asyncio.Future[Answered] = asyncio.get_running_loop().create_future()
        self._waiting.append((job, answer, time.perf_counter()))
        if self._running is None or self._running.done():
            self._running = asyncio.create_task(self._run())
        return await answer

    async def _run(self) -> None:
        """Answer batches until nobody waits."""
        while self._waiting:
            if self._thread is None:
                await self._arrived()
            taken = [self._waiting.popleft() for _ in range(min(self.max_batch, len(self._waiting)))]
            batch = [one for one in taken if not one[1].done()]  # Some have gone away meanwhile.
            if batch:
                await self._answer(batch)

    async def _arrived(self) -> None:
        """Until all that has arrived waits here: it would have to wait for the batch, and may as well be in it."""
        n_before = -1
        while n_before < len(self._waiting) < self.max_batch:
            n_before = len(self._waiting)
            for _ in range(STEPS_TO_QUEUE):
                await asyncio.sleep(0)

    async def _answer(self, batch: list[tuple[Job, asyncio.Future[Answered], float]]) -> None:
        start = time.perf_counter()
        try:
            lights = await self._lights([job for job, _, _ in batch])
        except Exception as error:  # noqa: BLE001  whatever it is, it belongs to those who wait, and the queue goes on
            for _, answer, _ in batch:
                if not answer.done():
                    answer.set_exception(error)
            return
        took_s = time.perf_counter() - start
        for (_, answer, asked_s), light in zip(batch, lights, strict=True):
            if not answer.done():
                answer.set_result(Answered(light, start - asked_s, took_s, len(batch)))

    async def _lights(self, jobs: list[Job]) -> list[LightEstimate]:
        if self._thread is None:
            return self._inference(jobs)
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._inference, jobs)

    async def close(self) -> None:
        """Answer what waits, and end the thread."""
        if self._running is not None:
            await self._running
        if self._thread is not None:
            self._thread.shutdown()
