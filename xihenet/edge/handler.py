"""The handler that all routes of the edge service share: CORS, the bearer token, errors as JSON, metrics and logs.

A handler reads a request, calls the service and writes its answer. What is refused, by the service or since the request
is wrong, is a `Refused` and becomes the status that it says; any other exception is a fault of ours, 500 and logged.
"""

from __future__ import annotations

import asyncio
import functools
import json
import logging
import re
import secrets
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from email.utils import formatdate
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, unquote_to_bytes

from xihenet import __version__
from xihenet.edge import protocol
from xihenet.edge.http_settings import MAX_BODY_BYTES, ServerSettings
from xihenet.edge.requests import Request, headers_text
from xihenet.edge.service import EdgeService, Refused
from xihenet.edge.sessions import StoreLost

logger = logging.getLogger("xihenet.edge")

OF_ALL_ANSWERS = {
    "Server": f"xihe/{__version__}",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}

METHODS = {"GET": "get", "HEAD": "get", "POST": "post", "DELETE": "delete", "OPTIONS": "options"}
"""HTTP's, and a handler's own that answers it. An answer to HEAD is sent without its body, see `Request.send`."""

OF_ALLOWED_ORIGINS = {
    "Vary": "Origin",
    "Access-Control-Allow-Headers": ", ".join(
        (*protocol.OUR_HEADERS, "Content-Type", "Authorization", "Anchor-Size", "Session-ID")
    ),
    "Access-Control-Allow-Methods": ", ".join(METHODS),
    "Access-Control-Expose-Headers": "Retry-After, Xihe-Dropped-Records, Xihe-Lost-Records",
    "Access-Control-Max-Age": "600",
}

_as_json = json.JSONEncoder(allow_nan=False).encode


class Site:
    """Which handler answers which path, and what all of them share; `gauges` are those of the server."""

    def __init__(self, service: EdgeService, settings: ServerSettings, routes: Mapping[str, type[Handler]]) -> None:
        self.service, self.settings = service, settings
        self.gauges: Callable[[], dict[str, float]] = dict
        self._exact = {path: handler for path, handler in routes.items() if "(" not in path}
        self._patterns = [
            (re.compile(pattern), handler, pattern.replace("([^/]+)", "*"))
            for pattern, handler in routes.items()
            if "(" in pattern
        ]
        self._waiting: set[asyncio.Future[None]] = set()
        self.is_stopping = False

    def answer(self, request: Request) -> None:
        """Have it answered, at once or later."""
        exact = self._exact.get(request.path)
        if exact is not None:
            exact(request, self, request.path).run(())
            return
        for pattern, handler, route in self._patterns:
            found = pattern.fullmatch(request.path)
            if found:
                handler(request, self, route).run(found.groups())
                return
        UnknownRoute(request, self, "other").run(())

    def keep(self, task: asyncio.Future[None]) -> None:
        """Until it is done: the event loop alone does not."""
        self._waiting.add(task)
        task.add_done_callback(self._waiting.discard)

    async def stop(self) -> None:
        """Until what waits is answered; what arrives meanwhile is refused."""
        self.is_stopping = True
        while self._waiting:
            await asyncio.wait(self._waiting)


class Handler:
    """One request and its answer. A route has a method for each of HTTP's that it knows, a coroutine where it waits."""

    needs_bearer = True
    queries: Sequence[str] | None = None
    """Names that the query may have; None for any, which monitors add, and which is not read."""

    def __init__(self, request: Request, site: Site, route: str) -> None:
        self.request, self.site, self.service, self.route = request, site, site.service, route
        self.headers: dict[str, str] = {}
        self.session_begin = ""
        self._start = time.perf_counter()

    def run(self, sent: Sequence[str]) -> None:
        """Answer, at once or when the method is done; `sent` are the parts of the path that the route leaves open."""
        try:
            self.prepare()
            going = self._method()(*(_unquoted(part) for part in sent))
            if going is not None:
                self.site.keep(asyncio.create_task(self._waited_for(going)))
        except Exception as error:  # noqa: BLE001  whatever it is, it is answered, and logged if it is a fault of ours
            self.refuse(error)

    async def _waited_for(self, going: Awaitable[None]) -> None:
        try:
            await going
        except Exception as error:  # noqa: BLE001  as in `run`
            self.refuse(error)

    def prepare(self) -> None:
        """Refuse what no route answers."""
        if self.site.is_stopping:
            raise Refused(503, "the server is stopping: try again later", self.service.settings.retry_after_s)
        bearer, request = self.site.settings.bearer, self.request
        if bearer and self.needs_bearer and request.method != "OPTIONS":
            sent = request.headers.get("Authorization", "")
            if not secrets.compare_digest(sent.encode(), f"Bearer {bearer}".encode()):
                self.headers["WWW-Authenticate"] = "Bearer"
                raise Refused(401, "this service needs its bearer token: send it as Authorization: Bearer TOKEN")
        self._check_names()
        if request.is_too_long:
            raise Refused(413, f"expected a body of at most {MAX_BODY_BYTES} bytes, got {request.n_bytes}")
        encoding = request.headers.get("Content-Encoding", "")
        if encoding and encoding.lower() != "identity":
            raise Refused(415, f"bodies are read as they come: leave out Content-Encoding, got {encoding[:80]!r}")

    def _check_names(self) -> None:
        """Refuse what nothing would read, which would be a misspelt name that counts for nothing."""
        for name in self.request.headers:
            if name.startswith("Xihe-") and name not in protocol.OUR_HEADERS:
                raise Refused(400, f"{name[:80]}: there is no such header; there are {', '.join(protocol.OUR_HEADERS)}")
        if self.queries is not None:
            for name in self._query.keys() - set(self.queries):
                there_are = ", ".join(self.queries) or "none here"
                raise Refused(400, f"{name[:80]!r}: the query has no such name; there are {there_are}")

    def _method(self) -> Callable[..., Awaitable[None] | None]:
        name = METHODS.get(self.request.method, "")
        if not hasattr(self, name):
            self.headers["Allow"] = self._allowed()
            raise Refused(405, HTTPStatus(405).phrase)
        return getattr(self, name)

    def _allowed(self) -> str:
        return ", ".join(method for method, name in METHODS.items() if hasattr(self, name))

    def options(self, *_: str) -> None:
        self.headers["Allow"] = self._allowed()
        self.finish(204)

    def tell(self, answer: Mapping[str, Any], status: int = 200) -> None:
        self.finish(status, _as_json(answer).encode(), "application/json")

    def refuse(self, error: Exception) -> None:
        """Tell what is refused with its message, and a fault of ours without."""
        if isinstance(error, StoreLost):
            log_lost(error)
            error = self.service.lost(error)
        refused = error if isinstance(error, Refused) else Refused(500, HTTPStatus(500).phrase)
        if refused is not error:
            log_event("fault", route=self.route, error=repr(error))
            logger.debug("fault", exc_info=error)
        if refused.retry_after_s is not None:
            self.headers["Retry-After"] = str(refused.retry_after_s)
        self.tell(protocol.failure(str(refused)), refused.status)

    def finish(self, status: int, body: bytes = b"", content_type: str = "") -> None:
        """Send the answer, count it and log it."""
        headers = {**self._for_origin(), **self.headers}
        if status != 204:
            headers |= {"Content-Type": content_type, "Content-Length": str(len(body))}
        self.request.send(HTTPStatus(status), _head_of_all(int(time.time())) + headers_text(headers), body)
        self._count(status)

    def _for_origin(self) -> Mapping[str, str]:
        """What a browser needs to be told before it lets a page have the answer."""
        allowed = self.site.settings.origins
        origin = self.request.headers.get("Origin") if allowed else None
        if origin is None:
            return {}
        if "*" not in allowed and origin not in allowed:
            return {"Vary": "Origin"}
        return {**OF_ALLOWED_ORIGINS, "Access-Control-Allow-Origin": "*" if "*" in allowed else origin}

    def _count(self, status: int) -> None:
        took_s = time.perf_counter() - self._start
        self.service.metrics.count("xihe_requests_total", route=self.route, status=str(status))
        self.service.metrics.measure("xihe_stage_seconds", took_s, stage="request")
        if self.site.settings.log == "all" or (status >= 400 and status != 503):
            log_event(
                "request",
                method=self.request.method,
                route=self.route,
                status=status,
                ms=round(1e3 * took_s, 3),
                body_bytes=self.request.n_bytes,
                session=self.session_begin,
            )

    def token(self) -> str:
        return str(self.request.headers.get(protocol.TOKEN_HEADER, ""))

    def query(self, name: str, default: str) -> str:
        """What the query says of `name`."""
        return self._query.get(name, [default])[-1]

    @functools.cached_property
    def _query(self) -> Mapping[str, Sequence[str]]:
        return parse_qs(self.request.query, keep_blank_values=True) if self.request.query else {}


class UnknownRoute(Handler):
    """Any other route."""

    def prepare(self) -> None:
        super().prepare()
        raise Refused(404, "there is no such route; /openapi.json names those that there are")


@contextmanager
def as_sent() -> Iterator[None]:
    """What is read in the block comes from a client, so a ValueError is its mistake: 400, with the message."""
    try:
        yield
    except ValueError as error:
        raise Refused(400, str(error)) from None


def begin_of(session_id: str) -> str:
    """What logs say of a session: enough to tell sessions apart, too little to use one."""
    return session_id[:8] if len(session_id) == 36 else "malformed"


def log_event(event: str, **fields: Any) -> None:
    """One line of JSON."""
    logger.info(json.dumps({"time": round(time.time(), 3), "event": event, **fields}))


def log_lost(error: StoreLost) -> None:
    """Why the store does not work; nothing while it is left alone."""
    if error.__cause__ is not None:
        log_event("store lost", error=str(error.__cause__))


@contextmanager
def logged_to(stream: Any) -> Iterator[None]:
    """In the block the service's lines of JSON go there as they are."""
    handler = logging.StreamHandler(stream)
    handler.setFormatter(logging.Formatter("%(message)s"))
    level, propagates = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = propagates


@functools.lru_cache(maxsize=1)
def _head_of_all(second: int) -> str:
    return headers_text({**OF_ALL_ANSWERS, "Date": formatdate(second, usegmt=True)})


def _unquoted(part: str) -> str:
    """Of a path; 400 unless it is UTF-8."""
    try:
        return unquote_to_bytes(part.encode("latin1")).decode()
    except ValueError:
        raise Refused(400, "expected a path in UTF-8") from None
