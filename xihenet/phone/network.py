"""The network between a phone and the edge server: when estimates arrive, and which light the app has until then.

Simulated time between trigger and arrival over a link to an edge server: work on the device and the server, the time
the bytes take, and a network delay that is log-normal (never below its floor, with a tail). A request that is lost is
sent again after a time-out, and given up after a few: it is then late, or never comes.

Chosen: three presets fitted to the paper's figures. Its medians already hold the bytes of one cloud (4,249 in the
paper's encoding), so only bytes beyond those cost more. Rejected: a queue per packet, which the figures cannot fix.

The delay is in this one place, after the chain. Rejected: a backend that waits, since the chain would then have to know
the time. What a request suffers comes from (seed, frame, position) alone, so a run that is resumed meets the same.
"""

from __future__ import annotations

import bisect
import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from xihenet.phone.settings import Required, Section, SessionFacts, known, number, text
from xihenet.records import ArrayF64, LightEstimate

REFERENCE_PAYLOAD_BYTES = 4249
"""One cloud of 1280 anchors, uint8 and float16, stripped: the paper's average, of which its network times are."""


@dataclass(frozen=True, kw_only=True)
class Link(Section):
    """A way to the edge server."""

    label: str = text()  # what the panel calls it
    summary: str = text()  # what it is, for the panel, without a full stop
    processing_s: float = number("s", 0.0, 60.0)  # on the device and the server together
    median_s: float = number("s", 0.0, 60.0)  # of the network time of one cloud, there and back
    floor_s: float = number("s", 0.0, 60.0)  # which is never below this
    spread: float = number("", 0.0, 5.0)  # standard deviation of the logarithm of what lies above the floor
    uplink_bit_per_s: float = number("bit/s", 1.0, 1e12)  # for bytes beyond one cloud
    loss: float = number("of the requests", 0.0, 1.0)  # share of the requests that are lost, each time they are sent
    resend_s: float = number("s", 0.0, 60.0)  # after this a lost request is sent again
    n_sends: int = number("", 1, 100, kind=int)  # after so many it is given up

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.floor_s > self.median_s:
            raise ValueError(f"floor_s: expected at most median_s ({self.median_s:g}), got {self.floor_s:g}")

    def required_by(self, facts: SessionFacts) -> Required:
        if facts.is_still and facts.light_changes is False:
            return False, "neither the camera nor the light changes while an estimate is under way"
        for fact in (facts.is_still, facts.light_changes):
            known(fact, "whether anything changes while an estimate is under way")
        usual_ms = 1e3 * (self.processing_s + self.median_s)
        return True, f"estimates arrive some {usual_ms:.0f} ms after the frame they are of"


_preset = functools.partial(Link, processing_s=0.01227, resend_s=0.2, n_sends=3)
"""Processing: 20.67 ms end to end, the paper's best on university WiFi, less its 8.4 ms of network time."""

LINKS: Mapping[str, Link] = {
    "wifi": _preset(
        label="Wi-Fi",
        summary="An edge server over a university's Wi-Fi",
        source="the paper: 8.4 ms network time on university WiFi; four positions cost 1.28 x one, hence the "
        "uplink (0.28 x 8.4 ms for 3 x 4,249 bytes); end to end 20.67 ms at best, under 24.04 ms on every device, "
        "hence floor and spread. Loss 0.1 %: the best WiFi in Codavel's table of real-world links. Time-out: "
        "the lower limit of TCP on Linux",
        median_s=0.0084,
        floor_s=0.006,
        spread=0.3,
        uplink_bit_per_s=43e6,
        loss=0.001,
    ),
    "home": _preset(
        label="Home Wi-Fi",
        summary="An edge server over Wi-Fi at home",
        source="25 ms and 0.2 % loss: WiFi in the USA in Codavel's table of real-world links; the paper says that "
        "residential WiFi took several times as long as the university's. Chosen: floor at half the median, "
        "spread 0.5, 10 Mbit/s uplink",
        median_s=0.025,
        floor_s=0.0125,
        spread=0.5,
        uplink_bit_per_s=10e6,
        loss=0.002,
    ),
    "lte": _preset(
        label="LTE",
        summary="An edge server over a mobile network",
        source="the paper: 79.2 ms end to end on LTE, less the processing. Loss 0.5 %: 4G in the USA in Codavel's "
        "table of real-world links. Chosen: floor at half the median, spread 0.6, 8 Mbit/s uplink",
        median_s=0.0669,
        floor_s=0.03345,
        spread=0.6,
        uplink_bit_per_s=8e6,
        loss=0.005,
    ),
}


def arrival_frames(
    trigger_times_s: Sequence[float], payload_bytes: ArrayLike, link: Link | None, rng: np.random.Generator
) -> ArrayF64:
    """(N,) when the estimate of each triggered frame arrives, seconds; infinite if it was lost for good.

    `trigger_times_s` (N,) are in any order; N may be 0. `payload_bytes`, (N,) or one number >= 0, are sent up. Without
    a link everything arrives at once. Each request draws the same from `rng`, so its luck is not that of the link.
    """
    asked_s = np.asarray(trigger_times_s, np.float64)
    if link is None:
        return asked_s
    sizes = np.broadcast_to(np.asarray(payload_bytes, np.float64), asked_s.shape)
    if not (np.isfinite(sizes) & (sizes >= 0)).all():
        raise ValueError("arrival_frames: expected payloads of 0 or more bytes, got a negative one or one not finite")
    normal = rng.normal(size=asked_s.shape)
    luck = rng.random(size=(*asked_s.shape, link.n_sends))
    network_s = link.floor_s + (link.median_s - link.floor_s) * np.exp(link.spread * normal)
    extra_s = np.maximum(sizes - REFERENCE_PAYLOAD_BYTES, 0) * 8 / link.uplink_bit_per_s
    gets_through = luck >= link.loss
    n_resent = np.where(gets_through.any(axis=-1), gets_through.argmax(axis=-1), np.inf)
    waited_s = np.multiply(n_resent, link.resend_s, out=np.full(asked_s.shape, np.inf), where=np.isfinite(n_resent))
    return asked_s + link.processing_s + network_s + extra_s + waited_s


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
    """The estimates of one session, each kept with the time of its arrival; the light is the youngest of those there.

    An answer that is overtaken by a later one is of no use any more; one that was lost never arrives. Without a `link`
    everything arrives at once. `seed`, a whole number >= 0, is that of the session.
    """

    def __init__(self, link: Link | None, seed: int) -> None:
        self.link, self.seed = link, seed
        self._requests: dict[str, list[Request]] = {}
        """By position, in the order in which they were asked for."""

    def ask(self, name: str, estimate: LightEstimate, *, frame: int, asked_s: float, payload_bytes: int) -> Request:
        """Send for `estimate` of position `name`, made from the frame of number `frame` at `asked_s`."""
        arrival_s = float(arrival_frames([asked_s], payload_bytes, self.link, self._rng(name, frame))[0])
        request = Request(estimate, frame, asked_s, arrival_s)
        bisect.insort(self._requests.setdefault(name, []), request, key=lambda one: one.asked_s)
        return request

    def in_use(self, name: str, time_s: float) -> Request | None:
        """What lights a position at `time_s`: the valid estimate that was asked for last, of those there, or None."""
        return next(self._there(name, time_s), None)

    def shares(self, name: str, time_s: float, blend_s: float) -> list[tuple[float, Request]]:
        """What lights a position at `time_s` where late estimates take `blend_s` to replace those before: with shares.

        The youngest comes first, and all shares add up to 1; none before there is a valid estimate. An estimate that
        arrives in its own frame, and the first one, has all of it at once; after `blend_s` every one has.
        """
        left, found = 1.0, []
        for request in self._there(name, time_s):
            is_there = request.arrival_s <= request.asked_s or blend_s == 0
            share = left if is_there else left * min(1.0, (time_s - request.arrival_s) / blend_s)
            found.append((share, request))
            left -= share
            if left <= 0:
                return found
        if found:  # Before the first one there was none to blend with.
            share, first = found.pop()
            found.append((share + left, first))
        return [(share, request) for share, request in found if share > 0]

    def _there(self, name: str, time_s: float) -> Iterator[Request]:
        """The valid estimates that have been in use up to `time_s`, the last one first."""
        earliest_s = math.inf
        for request in reversed(self._requests.get(name, ())):
            is_there = request.estimate.is_valid and request.arrival_s <= time_s
            if is_there and request.arrival_s < earliest_s:  # Else a younger one was there before it.
                earliest_s = request.arrival_s
                yield request

    def _rng(self, name: str, frame: int) -> np.random.Generator:
        """By the position's name, so that one position more leaves the others' luck alone."""
        number = 2 * frame if frame >= 0 else -2 * frame - 1
        return np.random.default_rng([self.seed, number, len(name.encode()), *name.encode()])
