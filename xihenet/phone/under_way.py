"""Estimates that are under way, and the light that the app has until they are there.

Every estimate that was asked for is kept with the time of its arrival; the light at a moment is the youngest of those
that have arrived. An answer that is overtaken by a later one is of no use any more, and one that was lost never
arrives: the light before stays.

Chosen: delay in this one place, after the chain, which stays as it is. Rejected: a backend that waits, since the chain
would then have to know the time. What a request suffers comes from (seed, frame, position) alone, so a run that is
resumed meets the same network.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from xihenet.phone.network import Link, arrival_frames
from xihenet.records import LightEstimate


@dataclass(frozen=True, eq=False)
class Request:
    """An estimate asked for in `frame` at `asked_s`, there at `arrival_s` (infinite if it was lost), of the session."""

    estimate: LightEstimate
    frame: int
    asked_s: float
    arrival_s: float

    @property
    def latency_s(self) -> float | None:
        """None if it was lost."""
        return None if math.isinf(self.arrival_s) else self.arrival_s - self.asked_s


class EstimatesUnderWay:
    """The estimates of one session and when they arrive.

    Parameters
    ----------
    link : to the edge server; None for a phone that estimates by itself: everything arrives at once
    seed : of the session, a whole number >= 0
    """

    def __init__(self, link: Link | None, seed: int) -> None:
        self.link, self.seed = link, seed
        self._requests: dict[str, list[Request]] = {}

    def ask(self, name: str, estimate: LightEstimate, *, frame: int, asked_s: float, payload_bytes: int) -> Request:
        """Send for `estimate` of position `name`, made from the frame of number `frame` at `asked_s`."""
        arrival_s = float(arrival_frames([asked_s], payload_bytes, self.link, self._rng(name, frame))[0])
        request = Request(estimate, frame, asked_s, arrival_s)
        self._requests.setdefault(name, []).append(request)
        return request

    def in_force(self, name: str, time_s: float) -> Request | None:
        """What lights a position at `time_s`: the valid estimate that was asked for last, of those there."""
        there = [r for r in self._requests.get(name, ()) if r.estimate.is_valid and r.arrival_s <= time_s]
        return max(there, key=lambda request: request.asked_s) if there else None

    def light(self, name: str, time_s: float) -> LightEstimate | None:
        """The light in force at a position at `time_s`; None before the first valid estimate is there."""
        request = self.in_force(name, time_s)
        return None if request is None else request.estimate

    def _rng(self, name: str, frame: int) -> np.random.Generator:
        """By the position's name, so that one position more leaves the others' luck alone."""
        number = 2 * frame if frame >= 0 else -2 * frame - 1
        return np.random.default_rng([self.seed, number, len(name.encode()), *name.encode()])
