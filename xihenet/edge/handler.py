"""What all routes of the edge service share: CORS, the bearer token, errors as JSON, metrics and logs.

A handler reads a request, calls the service and writes its answer. What is refused, by the service or since the request
is wrong, is a `Refused` and becomes the status that it says; any other exception is a fault of ours, 500 and logged.
"""

from __future__ import annotations

import json
import logging
import secrets
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any

from tornado import web

from xihenet import __version__
from xihenet.edge import protocol
from xihenet.edge.http_settings import ServerSettings
from xihenet.edge.service import EdgeService, Refused
from xihenet.edge.sessions import StoreLost

logger = logging.getLogger("xihenet.edge")


class Handler(web.RequestHandler):
    """What all routes share: CORS, the bearer token, JSON, metrics and logs."""

    needs_bearer = True

    def initialize(self, service: EdgeService, settings: ServerSettings, route: str) -> None:
        self.service, self.settings_of_server, self.route = service, settings, route
        self.session_told = ""
        self.start = time.perf_counter()

    def set_default_headers(self) -> None:
        self.set_header("Server", f"xihe/{__version__}")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cache-Control", "no-store")

    def prepare(self) -> None:
        self.allow_origin()
        bearer = self.settings_of_server.bearer
        if not bearer or not self.needs_bearer or self.request.method == "OPTIONS":
            return
        sent = self.request.headers.get("Authorization", "")
        if not secrets.compare_digest(sent.encode(), f"Bearer {bearer}".encode()):
            self.set_header("WWW-Authenticate", "Bearer")
            raise Refused(401, "this service needs its bearer token: send it as Authorization: Bearer TOKEN")

    def allow_origin(self) -> None:
        origin, allowed = self.request.headers.get("Origin"), self.settings_of_server.origins
        if origin is None or not allowed:
            return
        self.set_header("Vary", "Origin")
        if "*" in allowed or origin in allowed:
            self.set_header("Access-Control-Allow-Origin", "*" if "*" in allowed else origin)
            names = (*protocol.OUR_HEADERS, "Content-Type", "Authorization", "Anchor-Size", "Session-ID")
            self.set_header("Access-Control-Allow-Headers", ", ".join(names))
            self.set_header("Access-Control-Allow-Methods", "GET, POST, DELETE, OPTIONS")
            self.set_header("Access-Control-Expose-Headers", "Retry-After, Xihe-Dropped-Records, Xihe-Lost-Records")
            self.set_header("Access-Control-Max-Age", "600")

    def options(self, *_: str) -> None:
        self.set_status(204)
        self.finish()

    def tell(self, answer: Mapping[str, Any], status: int = 200) -> None:
        self.set_status(status)
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(answer, allow_nan=False))

    def token(self) -> str:
        return self.request.headers.get(protocol.TOKEN_HEADER, "")

    def log_exception(self, kind: Any, error: Any, trace: Any) -> None:
        if not isinstance(error, (Refused, StoreLost, web.HTTPError)):
            log_event("fault", route=self.route, error=repr(error))
            logger.debug("fault", exc_info=(kind, error, trace))

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """What is refused with its message, anything else without."""
        error = kwargs.get("exc_info", (None, None, None))[1]
        if isinstance(error, StoreLost):
            error = self.service.lost(error)
        if isinstance(error, Refused):
            status_code = error.status
            if error.retry_after_s is not None:
                self.set_header("Retry-After", str(error.retry_after_s))
        elif status_code == 405:
            self.set_header("Allow", ", ".join(self._methods()))
        said = str(error) if isinstance(error, Refused) else HTTPStatus(status_code).phrase
        self.allow_origin()  # An error has cleared the headers.
        self.tell(protocol.failure(said), status_code)

    def _methods(self) -> list[str]:
        """That this route has."""
        has_none = web.RequestHandler._unimplemented_method
        return [name for name in self.SUPPORTED_METHODS if getattr(type(self), name.lower()) is not has_none]

    def on_finish(self) -> None:
        took_s, status = time.perf_counter() - self.start, self.get_status()
        self.service.metrics.count("xihe_requests_total", route=self.route, status=str(status))
        self.service.metrics.measure("xihe_stage_seconds", took_s, stage="request")
        if self.settings_of_server.log == "all" or (status >= 400 and status != 503):
            log_event(
                "request",
                method=self.request.method,
                route=self.route,
                status=status,
                ms=round(1e3 * took_s, 3),
                body_bytes=len(self.request.body),
                session=self.session_told,
            )


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
