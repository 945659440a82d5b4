"""The service without a network: sessions and clouds go in, answers come out as what will be JSON.

`server` turns these into HTTP, and tests can call them without it. Whatever a client can do wrong, and whatever is
full, is a `Refused` with the status that says so. Decoding and merging are done at once in the event loop, some 0.4 ms;
inference waits in the `Batcher`; key light and reflections, which take many times as long, have a thread of their own
and are made only if they are asked for.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn, TypeVar

import numpy as np

from xihenet.buffers import merge
from xihenet.edge.axes import coefficients_in
from xihenet.edge.batching import Answered, Batcher, Inference, Job, QueueFull
from xihenet.edge.extras import Wishes, extras_of, format_extras
from xihenet.edge.metrics import Metrics
from xihenet.edge.protocol import CloudSent
from xihenet.edge.sessions import (
    MemoryStore,
    SeenPosition,
    Session,
    SessionFull,
    SessionGone,
    SessionStore,
    StoreFull,
    StoreLimits,
    StoreLost,
)
from xihenet.edge.sharing import re_exposed, with_others
from xihenet.estimators.base import Target
from xihenet.records import ArrayF64, KeyLight, UnitSphereCloud
from xihenet.sampling import sample_again
from xihenet.sphere import AnchorLattice

PUBLISHED_SIZES = (512, 768, 1024, 1280, 1536, 1792, 2048)
"""Numbers of anchors in the paper."""

DEFAULT_POSITION = "default"
"""Of a published client's session, which has one."""

GONE = "there is no such session, or it has expired: open a new one"

MOST_EXTRAS = 16
"""Key lights and reflections that may wait for their thread."""

Made = TypeVar("Made")


@dataclass(frozen=True)
class ServiceSettings:
    """How the service answers."""

    sizes: tuple[int, ...] = PUBLISHED_SIZES
    target: Target = "ldr"  # of published clients, as the paper trains, and of others that do not say theirs
    max_batch: int = 16
    max_queue: int = 48  # requests that wait for inference; a full queue is some 50 ms of `lattice`
    retry_after_s: int = 1
    limits: StoreLimits = field(default_factory=StoreLimits)


class Refused(Exception):
    """A request that is not answered: an HTTP status, a message, and when to come again if that helps."""

    def __init__(self, status: int, message: str, retry_after_s: int | None = None) -> None:
        super().__init__(message)
        self.status, self.retry_after_s = status, retry_after_s


class EdgeService:
    """One service, in the event loop in which it is made. `close` ends its threads, and closes its store."""

    def __init__(
        self,
        inference: Inference,
        settings: ServiceSettings | None = None,
        store: SessionStore | None = None,
        worker: int | None = None,
    ) -> None:
        self.settings = settings or ServiceSettings()
        self.inference, self.metrics = inference, Metrics(worker)
        self.store: SessionStore = store or MemoryStore(self.settings.limits)
        self.batcher = Batcher(
            inference,
            max_batch=self.settings.max_batch,
            max_queue=self.settings.max_queue,
            in_thread=not inference.is_quick,
        )
        self._extras, self._n_extras = ThreadPoolExecutor(1, "xihe-extras"), 0

    def open(self, session: Session) -> Session:
        """Keep a new session."""
        with self.kept():
            self.store.add(session)
        if not session.is_published:
            # Positions that are moved or shared ask for the nearest anchors. What that takes is made once for a number
            # of anchors, in 0.4 to 1.7 s, and in the event loop would hold up all phones for as long.
            self._extras.submit(AnchorLattice(session.n_anchors).nearest, [(0.0, 0.0, 1.0)])
        self.metrics.count("xihe_sessions_total", happened="opened")
        return session

    def published_session(self, session_id: str) -> Session:
        """The published client's session of that id; one of our own clients cannot be had without its token."""
        session = self.store.session(session_id, is_fresh=False)
        if session is None or not session.is_published:
            raise Refused(404, GONE)
        return session

    def session_for(self, session_id: str, token: str, *, as_owner: bool = False, is_fresh: bool = True) -> Session:
        """The session, if the token's holder may use it or, `as_owner`, delete it; `is_fresh` as of the store."""
        session = self.store.session(session_id, is_fresh=is_fresh)
        if session is not None and not is_fresh and not session.admits(token):
            session = self.store.session(session_id)  # Who joined by another worker is not known here.
        if session is None:
            raise Refused(404, GONE)
        if not token:
            raise Refused(401, "this needs the token that opening or joining the session gave")
        if not (session.is_owned_by(token) if as_owner else session.admits(token)):
            raise Refused(403, "the token is not of this session" + (" or not its owner's" if as_owner else ""))
        return session

    def check_room(self) -> None:
        """Refuse a request whose inference would be refused, before it costs more than its bytes."""
        if len(self.batcher) >= self.batcher.max_queue:
            self._refuse_full("queue", f"{len(self.batcher)} requests wait for inference")

    async def estimate_published(self, session: Session, sent: CloudSent) -> list[float]:
        """27 numbers; of a light that cannot be known those of black, since the published answer has no other word."""
        for quirk, n in sent.quirks.items():
            self.metrics.count("xihe_records_total", n, quirk=quirk)
        seen = self._seen(session, DEFAULT_POSITION, sent, Wishes())
        answered = await self._inferred(Job(seen.cloud, session.target))
        return coefficients_in(answered.light.sh_radiance, sent.axes)

    async def estimate(self, session: Session, name: str, sent: CloudSent, wishes: Wishes) -> dict[str, Any]:
        """The clean form's answer."""
        seen = self._seen(session, name, sent, wishes)
        cloud = seen.cloud
        if wishes.is_shared:
            cloud = self._shared(session, name, seen)
        ambient = None if sent.ambient is None else sent.ambient * (seen.exposure / sent.exposure)
        light = (await self._inferred(Job(cloud, session.target, ambient))).light
        answer: dict[str, Any] = {
            "ok": True,
            "coefficients": coefficients_in(light.sh_radiance, sent.axes),
            "exposure": seen.exposure,
            "expected_error": light.expected_error,
            "coverage": light.coverage,
            "is_valid": light.is_valid,
            "unknown_because": light.unknown_because,
            "estimator": self.inference.name,
            "target": session.target,
            "axes": sent.axes,
            "n_shared_anchors": int(np.count_nonzero(cloud.is_set & ~seen.cloud.is_set)),
        }
        if light.is_valid and (wishes.has_key_light or wishes.has_reflections):
            key, reflections = await self._extra(lambda: extras_of(light, cloud, seen.key, wishes))
            self._remember_key(session, name, key)
            answer |= format_extras(key, reflections, sent.axes, wishes)
        return answer

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Measure the time of the block; not if it raises."""
        start = time.perf_counter()
        yield
        self.metrics.measure("xihe_stage_seconds", time.perf_counter() - start, stage=stage)

    def gauges(self) -> dict[str, float]:
        """What there is now."""
        told = {"xihe_queue": len(self.batcher), "xihe_store_unreadable": self.store.n_unreadable}
        try:
            n_sessions, n_positions = self.store.counts()
        except StoreLost:
            return {**told, "xihe_store_up": 0}
        return {**told, "xihe_store_up": 1, "xihe_sessions": n_sessions, "xihe_positions": n_positions}

    def lost(self, error: StoreLost) -> Refused:
        """What a request is told whose store does not answer."""
        self.metrics.count("xihe_refused_total", what="store_lost")
        return Refused(503, f"{error}: try again later", self.settings.retry_after_s)

    async def close(self) -> None:
        """Answer what waits, and end the threads."""
        await self.batcher.close()
        self._extras.shutdown()
        self.store.close()

    def _seen(self, session: Session, name: str, sent: CloudSent, wishes: Wishes) -> SeenPosition:
        """What is known of a position with this cloud, which is kept; merged again if another worker was faster."""
        with self.timed("merge"):
            while True:
                before = self.store.position(session.id, name)
                # What does not fit its session, which only another hand can have put there, is replaced.
                known = before if before is not None and _fits(before, session) else None
                after = self._merged(known, sent, wishes)
                if wishes.is_shared and after.position_m is None:
                    raise Refused(400, "sharing needs to know where the position is: send its header")
                with self.kept():
                    if self.store.put_position(session.id, name, after, before):
                        return after

    def _merged(self, before: SeenPosition | None, sent: CloudSent, wishes: Wishes) -> SeenPosition:
        if before is None:
            return SeenPosition(sent.cloud, sent.exposure, sent.position_m, n_frames=1)
        key, n_frames = before.key, before.n_frames + 1
        if wishes.replaces:
            return SeenPosition(sent.cloud, sent.exposure, sent.position_m, key, n_frames)
        position_m = before.position_m if sent.position_m is None else sent.position_m
        cloud = merge(_seen_from(before, position_m), re_exposed(sent.cloud, before.exposure / sent.exposure))
        return SeenPosition(cloud, before.exposure, position_m, key, n_frames)

    def _shared(self, session: Session, name: str, seen: SeenPosition) -> UnitSphereCloud:
        known = self.store.positions(session.id)
        others = [other for label, other in known.items() if label != name and _fits(other, session)]
        return with_others(seen, others, AnchorLattice(session.n_anchors))

    async def _inferred(self, job: Job) -> Answered:
        try:
            answered = await self.batcher.estimate(job)
        except QueueFull as full:
            self._refuse_full("queue", str(full))
        self.metrics.measure("xihe_stage_seconds", answered.waited_s, stage="queue")
        self.metrics.measure("xihe_stage_seconds", answered.inference_s, stage="inference")
        self.metrics.measure("xihe_batch_size", answered.batch_size)
        if answered.light.unknown_because:
            self.metrics.count("xihe_unknown_lights_total", reason=answered.light.unknown_because)
        return answered

    async def _extra(self, make: Callable[[], Made]) -> Made:
        if self._n_extras >= MOST_EXTRAS:
            self._refuse_full("extras", f"{self._n_extras} key lights and reflections are being made")
        self._n_extras += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._extras, make)
        finally:
            self._n_extras -= 1

    def _remember_key(self, session: Session, name: str, key: KeyLight | None) -> None:
        # What cannot be kept for the next answer is no reason to refuse this one.
        with suppress(SessionGone, StoreFull, StoreLost):
            seen = self.store.position(session.id, name)
            if seen is not None:
                # Not kept if a frame has come meanwhile: its answer has a key light of its own.
                self.store.put_position(session.id, name, replace(seen, key=key), seen)

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Refuse what the store does not keep in the block."""
        try:
            yield
        except SessionGone:
            raise Refused(404, GONE) from None
        except SessionFull as full:
            raise Refused(409, f"{full}: have it forget one, or open another session") from None
        except StoreFull as full:
            self._refuse_full("store", str(full))

    def _refuse_full(self, what: str, message: str) -> NoReturn:
        self.metrics.count("xihe_refused_total", what=what)
        raise Refused(503, f"{message}: try again later", self.settings.retry_after_s)


def _seen_from(seen: SeenPosition, position_m: ArrayF64 | None) -> UnitSphereCloud:
    """What was seen of a position, as it looks from `position_m`, where the position is now."""
    if position_m is None or seen.position_m is None or (position_m == seen.position_m).all():
        return seen.cloud
    return sample_again(seen.cloud, position_m - seen.position_m, AnchorLattice(len(seen.cloud)))


def _fits(seen: SeenPosition, session: Session) -> bool:
    """Whether a position has the number of anchors of its session; a store outside may hold others."""
    return len(seen.cloud) == session.n_anchors
