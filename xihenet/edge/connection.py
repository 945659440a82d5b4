"""A patient connection to an edge service: JSON there and back, tried again with growing waits.

With the standard library's HTTP client, over one connection that stays open, and is opened anew after whatever went
wrong. What may pass is tried again: a network that fails, an answer that is cut or none, 429 and 5xx. What will not,
any other 4xx, is an `EdgeRefused` at once. After the last try there is `NoAnswer`, and a rest in which nobody is asked.
"""

from __future__ import annotations

import http.client
import json
import ssl
import time
import urllib.parse
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from xihenet.backend import NoAnswer
from xihenet.broken_pipes import broken_pipes_raise
from xihenet.edge import protocol


@dataclass(frozen=True)
class Patience:
    """How long one estimate may take, and what happens then."""

    timeout_s: float = 2.0  # of each step of a try: connecting, sending, an answer that does not come
    n_tries: int = 5
    first_wait_s: float = 0.05  # before the second try; doubled before each one after it
    longest_wait_s: float = 2.0
    rest_s: float = 1.0  # after a failure, in which estimates fail at once


class EdgeRefused(ValueError):
    """The server answered that it will not, whatever is tried: the message is its own."""

    def __init__(self, message: str, status: int = 0) -> None:
        super().__init__(message)
        self.status = status


class TryAgain(Exception):
    """A try that failed, and how long the server asked to wait."""

    def __init__(self, why: str, wait_s: float = 0.0) -> None:
        super().__init__(why)
        self.wait_s = wait_s


class NotTrusted(TryAgain):
    """The server's certificate is not one that is trusted here. On a network that asks to log in this passes."""


class PatientConnection:
    """To the service at `url`; ValueError for one or for a `bearer` that is none. Not safe between threads."""

    def __init__(self, url: str, patience: Patience, bearer: str = "", tls: ssl.SSLContext | None = None) -> None:
        self.url, self.patience, self._tls = url.rstrip("/"), patience, tls
        self._address = _parsed(url)
        if not bearer.isprintable() or max(bearer, default="") > "\xff":
            raise ValueError(
                "the bearer token has the end of a line or a character that no header can carry: give another"
            )
        self._always = {"Authorization": f"Bearer {bearer}"} if bearer else {}
        self._connection: http.client.HTTPConnection | None = None
        self.lost_since: float | None = None
        """Of the monotonic clock, while the last attempt had no answer."""
        self.last_failure, self._rests_until = "", 0.0
        self.n_retries = self.n_failed = 0

    def is_resting(self) -> bool:
        """Whether an attempt has failed so lately that the next one is not worth its time."""
        return self.lost_since is not None and time.monotonic() < self._rests_until

    def persist(self, attempt: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """What `attempt` gives, tried as often as patience allows; `NoAnswer` after that."""
        wait_s, kind = self.patience.first_wait_s, TryAgain
        for left in reversed(range(self.patience.n_tries)):
            try:
                answer = attempt()
            except TryAgain as again:
                # Not the error itself, whose frames would keep this one and the connection alive.
                self.last_failure, kind = str(again), type(again)
                if left:
                    self.n_retries += 1
                    time.sleep(min(max(wait_s, again.wait_s), self.patience.longest_wait_s))
                    wait_s *= 2
                continue
            self.lost_since = None
            return answer
        self.n_failed += 1
        now = time.monotonic()
        self.lost_since = self.lost_since or now
        self._rests_until = now + self.patience.rest_s
        raise NoAnswer(f"{self.url} does not answer: {self.last_failure}") from kind(self.last_failure)

    def ask(self, method: str, path: str, body: bytes, headers: dict[str, str]) -> dict[str, Any]:
        """The JSON of an answer, tried once; `TryAgain` for what may pass, `EdgeRefused` for what will not."""
        connection = self._connection = self._connection or self._new_connection()
        try:
            with broken_pipes_raise():
                connection.request(method, path, body, {**self._always, **headers})
            response = connection.getresponse()
            status, text = response.status, response.read()
        except (OSError, http.client.HTTPException) as error:
            self.close()
            kind = NotTrusted if isinstance(error, ssl.SSLCertVerificationError) else TryAgain
            raise kind(f"{type(error).__name__}: {error}") from None
        try:
            answer = json.loads(text)
        except ValueError:
            self.close()
            what = f"{response.headers.get_content_type()} and status {status}"
            raise TryAgain(f"something that is no edge service answers there, with {what}") from None
        if status < 300 and isinstance(answer, dict):
            return answer
        said = str(answer.get("error", status)) if isinstance(answer, dict) else str(status)
        if status == 429 or status >= 500:
            raise TryAgain(said, _seconds(response.headers.get("Retry-After")))
        raise EdgeRefused(f"{self.url} refuses ({status}): {said}", status)

    def close(self) -> None:
        """Close it; the next attempt opens it again."""
        if self._connection is not None:
            self._connection.close()
        self._connection = None

    def _new_connection(self) -> http.client.HTTPConnection:
        host, port, is_tls = self._address
        if is_tls:
            return http.client.HTTPSConnection(host, port, timeout=self.patience.timeout_s, context=self._tls)
        return http.client.HTTPConnection(host, port, timeout=self.patience.timeout_s)


def _parsed(url: str) -> tuple[str, int, bool]:
    """Host, port, and whether it is TLS; ValueError for a URL that is none."""
    try:
        parts = urllib.parse.urlsplit(url)
        is_tls, host, port = parts.scheme == "https", parts.hostname or "", parts.port
        host.encode("idna")  # As it is when it is looked up
    except ValueError:  # A port that is no number, half of an IPv6 address, or two dots in a row
        parts, is_tls, host, port = urllib.parse.urlsplit(""), False, "", None
    is_host = bool(host) and " " not in host and port != 0
    if parts.scheme not in ("http", "https") or not is_host or parts.path.strip("/"):
        raise ValueError(f"expected the address of an edge service, such as http://127.0.0.1:8550, got {url!r}")
    return host, port or (443 if is_tls else protocol.PORT), is_tls


def _seconds(text: str | None) -> float:
    """Of a Retry-After header; a date, which our server does not send, counts as none."""
    return float(text) if text is not None and text.isascii() and text.isdigit() else 0.0
