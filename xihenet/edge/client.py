"""`EdgeBackend`: an `InferenceBackend` whose light comes from an edge service.

It speaks the clean form with the standard library's HTTP client, over one connection that stays open. Each request
carries the whole cloud of the position and takes the place of what the server knew of it, so that the light is that of
this cloud and of no other, a request can be sent again without harm, and a server that has forgotten everything needs
no more than a new session. Rejected: sending what changed since the last answer, which saves bytes and loses all three.

What goes wrong is tried again, with growing waits. After the last try the estimate has no answer (`NoAnswer`), which
the chain takes like a light that cannot be known: the light before stays, and the trigger goes on to ask. For a while
after that estimates fail at once, so that a lost server does not hold up every frame.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import ssl
import threading
import time
import urllib.parse
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from xihenet.backend import NoAnswer
from xihenet.codec import EncodingMethod, encode_cloud
from xihenet.edge import protocol
from xihenet.edge.axes import OUR_AXES, sh_from
from xihenet.estimators.ambient import Ambient
from xihenet.estimators.base import EstimateContext, NotFinite, Target
from xihenet.records import ArrayF64, UnitSphereCloud

POSITION = "phone"
MOST_KEPT_TIMES = 1000
CONSTANT = 2 * np.sqrt(np.pi)  # The first coefficient of light of 1 from everywhere


@dataclass(frozen=True)
class Patience:
    """How long one estimate may take, and what happens then."""

    timeout_s: float = 2.0  # of each step of a try: connecting, sending, an answer that does not come
    n_tries: int = 5
    first_wait_s: float = 0.05  # before the second try; doubled before each one after it
    longest_wait_s: float = 2.0
    rest_s: float = 1.0  # after a failure, in which estimates fail at once


BEARER_VARIABLE = "XIHE_EDGE_BEARER"
"""Environment variable with the service's bearer token, of server and client alike."""


class EdgeRefused(ValueError):
    """The server answered that it will not, whatever is tried: the message is its own."""


class _Again(Exception):
    """A try that failed, and how long the server asked to wait."""

    def __init__(self, why: str, wait_s: float = 0.0) -> None:
        super().__init__(why)
        self.wait_s = wait_s


class EdgeBackend:
    """The backend at `url`, such as http://127.0.0.1:8550, with a session of its own for clouds of `n_anchors`.

    `bearer` is the service's token, if it has one, and `tls` how its certificate is checked, by default as usual. The
    server is asked for its estimator at once: `NoAnswer` if it cannot be reached, `EdgeRefused` if it refuses, and
    ValueError for a URL that is none.
    """

    needs: frozenset[str] = frozenset()

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
        self.url, self.n_anchors, self.target, self.method = url.rstrip("/"), n_anchors, target, method
        self.patience, self._tls = patience or Patience(), tls
        self._address = _parsed(url)
        self._always = {"Authorization": f"Bearer {bearer}"} if bearer else {}
        self._lock = threading.Lock()
        self._connection: http.client.HTTPConnection | None = None
        self._session: dict[str, str] | None = None
        self._sensor = Ambient(n_anchors, target)
        self._lost_since: float | None = None
        self._last_failure, self._rests_until = "", 0.0
        self.n_answered = self.n_retries = self.n_opened = self.n_failed = self.bytes_sent = 0
        self.times_s: deque[float] = deque(maxlen=MOST_KEPT_TIMES)
        """Of the last answers, from the first try on."""
        self.last_light: tuple[ArrayF64, float | None] | None = None
        """The last good one, and the error expected of it."""
        self.name, self.farthest_m = "", float("inf")
        with self._lock:
            self._persist(lambda: dict(self._open()))

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
            if self._is_resting():
                raise NoAnswer(self._last_failure)
            start = time.perf_counter()
            answer = self._persist(lambda: self._light(payload, headers))
            self.n_answered += 1
            self.times_s.append(time.perf_counter() - start)
            light = _light_of(answer)
            self.last_light = light
            return light

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        """As the estimators say it, without asking the server."""
        sensed = context.frame is not None and context.frame.ambient is not None and self.name == "ambient"
        return "" if sensed or cloud.is_set.any() else "nothing_seen"

    def state(self) -> str:
        """How the server is, in words for a panel or a report."""
        if self._lost_since is not None:
            return (
                f"no answer from {self.url} for {time.monotonic() - self._lost_since:.0f} s "
                f"({self._last_failure}); the last light is kept"
            )
        words = f"{self.name} at {self.url}, {self.n_answered} answers"
        if self.times_s:
            words += f" in {1e3 * float(np.median(self.times_s)):.1f} ms each"
        if self.n_retries:
            words += f", {self.n_retries} tries repeated"
        if self.n_opened > 1:
            words += f", {self.n_opened - 1} sessions lost and opened anew"
        return words + (f", {self.n_failed} estimates without an answer" if self.n_failed else "")

    def close(self) -> None:
        """Have the server forget the session, if it can be reached, and close the connection."""
        with self._lock:
            if self._session is not None and self._lost_since is None:
                path = f"{protocol.SESSIONS}/{self._session['session']}"
                with contextlib.suppress(_Again, EdgeRefused):
                    self._ask("DELETE", path, b"", {protocol.TOKEN_HEADER: self._session["token"]})
            self._session = None
            self._drop_connection()

    def __del__(self) -> None:
        """Without `close` the connection is closed all the same, and the session expires on the server."""
        connection = getattr(self, "_connection", None)
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

    def _is_resting(self) -> bool:
        return self._lost_since is not None and time.monotonic() < self._rests_until

    def _persist(self, attempt: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """What `attempt` gives, tried as often as patience allows; `NoAnswer` after that."""
        wait_s = self.patience.first_wait_s
        for left in reversed(range(self.patience.n_tries)):
            try:
                answer = attempt()
            except _Again as again:
                self._last_failure = str(again)
                if left:
                    self.n_retries += 1
                    time.sleep(min(max(wait_s, again.wait_s), self.patience.longest_wait_s))
                    wait_s *= 2
                continue
            self._lost_since = None
            return answer
        self.n_failed += 1
        now = time.monotonic()
        self._lost_since = self._lost_since or now
        self._rests_until = now + self.patience.rest_s
        raise NoAnswer(f"{self.url} does not answer: {self._last_failure}")

    def _open(self) -> dict[str, str]:
        wanted = json.dumps({"n_anchors": self.n_anchors, "target": self.target, "joinable": False}).encode()
        answer = self._ask("POST", protocol.SESSIONS, wanted, {"Content-Type": "application/json"})
        if self.name not in ("", answer["estimator"]):
            raise EdgeRefused(f"the server at {self.url} came back with {answer['estimator']} in place of {self.name}")
        self.name = answer["estimator"]
        self.farthest_m = float("inf") if answer["farthest_m"] is None else float(answer["farthest_m"])
        self._session = {"session": answer["session"], "token": answer["token"]}
        self.n_opened += 1
        return self._session

    def _light(self, payload: bytes, headers: dict[str, str]) -> dict[str, Any]:
        session = self._session or self._open()
        path = f"{protocol.SESSIONS}/{session['session']}/positions/{POSITION}?replace=yes"
        return self._ask("POST", path, payload, {**headers, protocol.TOKEN_HEADER: session["token"]})

    def _ask(self, method: str, path: str, body: bytes, headers: dict[str, str]) -> dict[str, Any]:
        """The JSON of an answer; `_Again` for what may pass, `EdgeRefused` for what will not."""
        connection = self._connection = self._connection or self._new_connection()
        try:
            connection.request(method, path, body, {**self._always, **headers})
            response = connection.getresponse()
            status, text = response.status, response.read()
            self.bytes_sent += len(body)
            answer = json.loads(text)
        except (OSError, http.client.HTTPException, ValueError) as error:
            self._drop_connection()
            raise _Again(f"{type(error).__name__}: {error}") from None
        if status < 300 and isinstance(answer, dict):
            return answer
        said = str(answer.get("error", status)) if isinstance(answer, dict) else str(status)
        if status == 404 and self._session is not None:
            self._session = None
            raise _Again(said)
        if status == 429 or status >= 500:
            raise _Again(said, _seconds(response.headers.get("Retry-After")))
        raise EdgeRefused(f"{self.url} refuses ({status}): {said}")

    def _new_connection(self) -> http.client.HTTPConnection:
        host, port, is_tls = self._address
        if is_tls:
            return http.client.HTTPSConnection(host, port, timeout=self.patience.timeout_s, context=self._tls)
        return http.client.HTTPConnection(host, port, timeout=self.patience.timeout_s)

    def _drop_connection(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection = None


def backend_at(url: str, estimator: str, n_anchors: int, target: Target) -> EdgeBackend:
    """The backend of a command: patient, with the bearer token of the environment.

    ValueError if it does not answer, or estimates with another estimator than the one that was chosen.
    """
    patience = Patience(timeout_s=5.0, n_tries=8)
    backend = EdgeBackend(url, n_anchors, target, patience=patience, bearer=os.environ.get(BEARER_VARIABLE, ""))
    if backend.name != estimator:
        backend.close()
        raise ValueError(f"the server at {url} estimates with {backend.name}: give --estimator {backend.name}")
    return backend


def _light_of(answer: dict[str, Any]) -> tuple[ArrayF64, float | None]:
    """The light of an answer; NotFinite where it could not be known."""
    if not answer["is_valid"]:
        raise NotFinite(f"the server could not know the light: {answer['unknown_because']}")
    error = answer["expected_error"]
    return sh_from(answer["coefficients"], OUR_AXES), None if error is None else float(error)


def _parsed(url: str) -> tuple[str, int, bool]:
    """Host, port, and whether it is TLS; ValueError for a URL that is none."""
    parts = urllib.parse.urlsplit(url)
    is_tls = parts.scheme == "https"
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.path.strip("/"):
        raise ValueError(f"expected the address of an edge service, such as http://127.0.0.1:8550, got {url!r}")
    return parts.hostname, parts.port or (443 if is_tls else protocol.PORT), is_tls


def _joined(numbers: ArrayF64) -> str:
    return ",".join(repr(float(number)) for number in numbers)


def _seconds(text: str | None) -> float:
    """Of a Retry-After header; a date, which our server does not send, counts as none."""
    return float(text) if text is not None and text.isascii() and text.isdigit() else 0.0
