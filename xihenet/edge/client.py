"""`EdgeBackend`: an `InferenceBackend` whose light comes from an edge service.

It speaks the clean form with the standard library's HTTP client, over one connection that stays open, and further ones
where several positions ask in the same frame. Each request carries the whole cloud of the position and takes the place
of what the server knew of it, so that the light is that of this cloud and of no other, a request can be sent again
without harm, and a server that has forgotten everything needs no more than a new session. Rejected: sending what
changed since the last answer, which saves bytes and loses all three.

What goes wrong is tried again, see `connection`. After the last try the estimate has no answer (`NoAnswer`), which
the chain takes like a light that cannot be known: the light before stays, and the trigger goes on to ask. For a while
after that estimates fail at once, so that a lost server does not hold up every frame.
"""

from __future__ import annotations

import contextlib
import functools
import json
import math
import os
import ssl
import threading
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from xihenet.backend import Answer, NoAnswer, answer_of
from xihenet.codec import EncodingMethod, encode_cloud
from xihenet.edge import protocol
from xihenet.edge.axes import OUR_AXES, sh_from
from xihenet.edge.connection import EdgeRefused, NotTrusted, Patience, PatientConnection, TryAgain
from xihenet.estimators.ambient import Ambient
from xihenet.estimators.base import EstimateContext, NotFinite, Target
from xihenet.records import ArrayF64, UnitSphereCloud

POSITION = "phone"
MOST_KEPT_TIMES = 1000
MOST_TOGETHER = 4
"""Requests under way at once: the server batches those of all clients, and a phone has few positions in view."""

BESIDE_AGAIN_S = 60.0
"""After a server had no room for another session: it refuses one only after several tries, seconds in every frame."""

CONSTANT = 2 * np.sqrt(np.pi)  # The first coefficient of light of 1 from everywhere

BEARER_VARIABLE = "XIHE_EDGE_BEARER"
"""Environment variable with the service's bearer token, of server and client alike."""


class EdgeBackend:
    """The backend at `url`, such as http://127.0.0.1:8550, with a session of its own for clouds of `n_anchors`.

    `bearer` is the service's token, if it has one, and `tls` how its certificate is checked, by default as usual. The
    server is asked for its estimator at once: `NoAnswer` if it cannot be reached, `EdgeRefused` if it refuses, and
    ValueError for a URL that is none.
    """

    def __init__(
        self,
        url: str,
        n_anchors: int = 1280,
        target: Target = "ldr",
        *,
        method: EncodingMethod = protocol.DEFAULT_METHOD,
        patience: Patience | None = None,
        bearer: str = "",
        tls: ssl.SSLContext | None = None,
    ) -> None:
        self.n_anchors, self.target, self.method = n_anchors, target, method
        self.connection = PatientConnection(url, patience or Patience(), bearer, tls)
        self._like_this = functools.partial(
            EdgeBackend, url, n_anchors, target, method=method, patience=patience, bearer=bearer, tls=tls
        )
        self._beside: list[EdgeBackend] = []
        """Others of its kind, for estimates that are asked for at the same time."""
        self._beside_again_s = -math.inf
        """Of the monotonic clock, before which no more of them are opened, since the server would not."""
        self._lock = threading.Lock()
        self._session: dict[str, str] | None = None
        self._sensor = Ambient(n_anchors, target)
        self.n_answered = self.n_opened = 0
        self.times_s: deque[float] = deque(maxlen=MOST_KEPT_TIMES)
        """Of the last answers, from the first try on."""
        self.name, self.farthest_m, self._knows_unseen = "", float("inf"), "never"
        with self._lock:
            self.connection.persist(lambda: dict(self._open()))

    def estimate(self, cloud: UnitSphereCloud, context: EstimateContext | None = None) -> ArrayF64:
        """As `estimate_with_error`, the light alone."""
        return self.estimate_with_error(cloud, context)[0]

    def estimate_with_error(
        self, cloud: UnitSphereCloud, context: EstimateContext | None = None
    ) -> tuple[ArrayF64, float | None]:
        """(9, 3) coefficients that carry the session's exposure, and the SHC RMSE expected of them.

        `NoAnswer` if the server gave none in time, `NotFinite` if the light is not finite, and ValueError for a cloud
        with another number of anchors.
        """
        if len(cloud) != self.n_anchors:
            raise ValueError(f"EdgeBackend: made for {self.n_anchors} anchors, got a cloud of {len(cloud)}")
        context = context or EstimateContext()
        exposure = context.reference_exposure or (context.frame.exposure if context.frame else 1.0)
        headers, payload = self._headers(cloud, context, exposure), encode_cloud(cloud, self.method)
        with self._lock:
            if self.connection.is_resting():
                raise NoAnswer(self.connection.last_failure)
            start = time.perf_counter()
            answer = self.connection.persist(lambda: self._light(payload, headers))
            self.n_answered += 1
            self.times_s.append(time.perf_counter() - start)
            return _light_of(answer)

    def estimate_together(
        self, clouds: Sequence[UnitSphereCloud], contexts: Sequence[EstimateContext]
    ) -> list[Answer | NoAnswer | NotFinite]:
        """Of each cloud what `estimate_with_error` gives, or `NoAnswer` or `NotFinite`: requests are under way at once.

        Each beyond the first goes over a connection, and by a session, of its own, which stay. ValueError as there,
        after all have been answered.
        """
        n_beside = min(len(clouds), MOST_TOGETHER) - 1
        if self.connection.is_resting() or n_beside < 1:
            return [answer_of(self, *one) for one in zip(clouds, contexts, strict=True)]
        missing = n_beside - len(self._beside) if time.monotonic() >= self._beside_again_s else 0
        with ThreadPoolExecutor(n_beside + 1) as pool:
            others = list(pool.map(lambda _: self._another(), range(missing)))
            self._beside += [one for one in others if one is not None]
            if None in others:
                self._beside_again_s = time.monotonic() + BESIDE_AGAIN_S
            lines = [self, *self._beside[:n_beside]]
            each = [lines[number % len(lines)] for number in range(len(clouds))]
            return list(pool.map(answer_of, each, clouds, contexts))

    def _another(self) -> EdgeBackend | None:
        """A backend like this one; None while the server does not answer, or has no room for more sessions."""
        with contextlib.suppress(NoAnswer):
            return self._like_this()
        return None

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        """As the server's estimator says it of a cloud without an anchor, without asking again."""
        has_sensor = context.frame is not None and context.frame.ambient is not None
        knows_unseen = self._knows_unseen == "always" or (self._knows_unseen == "with_ambient" and has_sensor)
        return "" if knows_unseen or cloud.is_set.any() else "nothing_seen"

    def state(self) -> str:
        """How the server is, in words for a panel or a report."""
        link = self.connection
        if link.lost_since is not None:
            lost_s = time.monotonic() - link.lost_since
            return f"no answer from {link.url} for {lost_s:.0f} s ({link.last_failure}); the last light is kept"
        lines = [self, *self._beside]
        times_s = [time_s for line in lines for time_s in line.times_s]
        n_retries, n_failed = (sum(getattr(o.connection, kind) for o in lines) for kind in ("n_retries", "n_failed"))
        n_lost = sum(line.n_opened - 1 for line in lines)
        words = f"{self.name} at {link.url}, {sum(line.n_answered for line in lines)} answers"
        if times_s:
            words += f" in {1e3 * float(np.median(times_s)):.1f} ms each"
        if n_retries:
            words += f", {n_retries} tries repeated"
        if n_lost:
            words += f", {n_lost} sessions lost and opened again"
        return words + (f", {n_failed} estimates without an answer" if n_failed else "")

    def close(self) -> None:
        """Have the server forget the session, if it can be reached, and close the connection."""
        for one in self._beside:
            one.close()
        self._beside = []
        with self._lock:
            if self._session is not None and self.connection.lost_since is None:
                path = f"{protocol.SESSIONS}/{self._session['session']}"
                with contextlib.suppress(TryAgain, EdgeRefused):
                    self.connection.ask("DELETE", path, b"", {protocol.TOKEN_HEADER: self._session["token"]})
            self._session = None
            self.connection.close()

    def __del__(self) -> None:
        """Without `close` the connection is closed all the same, and the session expires on the server."""
        connection = getattr(self, "connection", None)
        if connection is not None:
            connection.close()

    def _headers(self, cloud: UnitSphereCloud, context: EstimateContext, exposure: float) -> dict[str, str]:
        headers = {
            "Content-Type": protocol.content_type_of(self.method),
            protocol.AXES_HEADER: OUR_AXES,
            protocol.EXPOSURE_HEADER: repr(float(exposure)),
        }
        if context.position_m is not None:
            headers[protocol.POSITION_HEADER] = _joined(context.position_m)
        if context.frame is not None:
            # What the estimators lean on here: the sensor or, without one, the mean of the anchors.
            headers[protocol.AMBIENT_HEADER] = _joined(self._sensor.estimate(cloud, context)[0] / CONSTANT)
        return headers

    def _open(self) -> dict[str, str]:
        wanted = json.dumps({"n_anchors": self.n_anchors, "target": self.target, "joinable": False}).encode()
        answer = self.connection.ask("POST", protocol.SESSIONS, wanted, {"Content-Type": "application/json"})
        missing = [name for name in ("estimator", "farthest_m", "session", "token") if name not in answer]
        if missing:
            raise EdgeRefused(f"{self.connection.url} is no edge service: its answer has no {missing[0]}")
        if self.name not in ("", answer["estimator"]):
            raise EdgeRefused(
                f"the server at {self.connection.url} came back with {answer['estimator']} instead of {self.name}"
            )
        self.name = answer["estimator"]
        self.farthest_m = float("inf") if answer["farthest_m"] is None else float(answer["farthest_m"])
        self._knows_unseen = answer.get("knows_unseen", "never")
        self._session = {"session": answer["session"], "token": answer["token"]}
        self.n_opened += 1
        return self._session

    def _light(self, payload: bytes, headers: dict[str, str]) -> dict[str, Any]:
        session = self._session or self._open()
        path = f"{protocol.SESSIONS}/{session['session']}/positions/{POSITION}?replace=yes"
        try:
            return self.connection.ask("POST", path, payload, {**headers, protocol.TOKEN_HEADER: session["token"]})
        except EdgeRefused as refused:
            if refused.status != 404:
                raise
            self._session = None
            raise TryAgain(str(refused)) from None


OF_A_COMMAND = Patience(timeout_s=5.0, n_tries=8)


def backend_at(url: str, estimator: str, n_anchors: int, target: Target) -> EdgeBackend:
    """The backend of a command: patient, with the bearer token of the environment.

    ValueError if it does not answer, or estimates with another estimator than the one that was chosen.
    """
    bearer = os.environ.get(BEARER_VARIABLE, "")
    try:
        backend = EdgeBackend(url, n_anchors, target, patience=OF_A_COMMAND, bearer=bearer)
    except NoAnswer as error:
        is_up = isinstance(error.__cause__, NotTrusted)
        fix = "name a file with it in the variable SSL_CERT_FILE" if is_up else "start xihe serve there"
        raise NoAnswer(f"{error}: {fix}, or leave --backend out") from None
    if backend.name != estimator:
        backend.close()
        raise ValueError(f"the server at {url} estimates with {backend.name}: give --estimator {backend.name}")
    return backend


def _light_of(answer: dict[str, Any]) -> tuple[ArrayF64, float | None]:
    """The light of an answer; NotFinite, with the server's reason, where it could not be known."""
    if not answer["is_valid"]:
        reason = answer["unknown_because"]
        raise NotFinite(f"the server could not know the light: {reason}", reason)
    error = answer["expected_error"]
    return sh_from(answer["coefficients"], OUR_AXES), None if error is None else float(error)


def _joined(numbers: ArrayF64) -> str:
    return ",".join(repr(float(number)) for number in numbers)
