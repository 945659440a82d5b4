"""Routes: which paths there are, and what answers each.

Those of sessions are the published client's, exactly as it calls them, with the session's id as the only secret, and
those of our own clients, with tokens, several clients and positions, and clouds in the clean form. The others are about
the service itself.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from importlib import resources
from typing import Any

from xihenet import __version__
from xihenet.completeness import coverage
from xihenet.edge import protocol
from xihenet.edge.axes import OUR_AXES, PUBLISHED_AXES, checked_axes
from xihenet.edge.extras import Wishes
from xihenet.edge.handler import Handler, as_sent, begin_of, log_lost
from xihenet.edge.openapi import openapi_document
from xihenet.edge.service import EdgeService, Refused
from xihenet.edge.sessions import Session, SessionFull, StoreLost, joined, new_session, new_token

SWITCHES = {"no": False, "yes": True}


class PublishedSessionRoute(Handler):
    """POST: a session of the published client."""

    def post(self) -> None:
        sizes, headers = self.service.settings.sizes, self.request.headers
        with as_sent():
            n_anchors = protocol.anchors_wanted(headers.get("Anchor-Size"), sizes)
            axes = checked_axes(headers.get(protocol.AXES_HEADER, PUBLISHED_AXES))
        session = self.service.open(new_session(n_anchors, self.service.settings.target, axes))
        self.session_begin = begin_of(session.id)
        self.tell({"ok": True, "sid": session.id})


class PublishedEstimationRoute(Handler):
    """POST: the light of a published client's records."""

    async def post(self) -> None:
        headers = self.request.headers
        session_id = headers.get("Session-ID")
        if session_id is None:
            raise Refused(400, "Session-ID: expected the id that opening a session gave, got no such header")
        self.session_begin = begin_of(session_id)
        session = self.service.published_session(session_id)
        self.service.check_room()
        with self.service.timed("decode"), as_sent():
            axes = headers.get(protocol.AXES_HEADER, session.axes)
            sent = protocol.read_published(self.request.body, session.n_anchors, axes)
        coefficients = await self.service.estimate_published(session, sent)
        self.headers["Xihe-Dropped-Records"] = str(sent.quirks.get("dropped", 0))
        self.headers["Xihe-Lost-Records"] = str(sent.quirks.get("lost", 0))
        self.tell({"ok": True, "coefficients": coefficients})


class SessionsRoute(Handler):
    """POST: a session of our own client. GET: those of the token's holder."""

    queries = ()

    def post(self) -> None:
        with as_sent():
            session, token = self._wanted_session()
        self.service.open(session)
        self.session_begin = begin_of(session.id)
        inference = self.service.inference
        self.tell(
            {
                "ok": True,
                "session": session.id,
                "token": token,
                "n_anchors": session.n_anchors,
                "target": session.target,
                "estimator": inference.name,
                "farthest_m": inference.farthest_m if math.isfinite(inference.farthest_m) else None,
                "knows_unseen": inference.knows_unseen,
            },
            201,
        )

    def _wanted_session(self) -> tuple[Session, str]:
        wanted, settings = self._wanted(), self.service.settings
        n_anchors = protocol.anchors_wanted(str(wanted.get("n_anchors", 1280)), settings.sizes, "n_anchors")
        target, joinable = wanted.get("target", settings.target), wanted.get("joinable", True)
        if target not in ("ldr", "hdr"):
            raise ValueError(f"target: expected ldr or hdr, got {str(target)[:80]!r}")
        if not isinstance(joinable, bool):
            raise ValueError(f"joinable: expected true or false, got {str(joinable)[:80]!r}")
        token = self.request.headers.get(protocol.TOKEN_HEADER)
        token = new_token() if token is None else token
        if not 16 <= len(token) <= 128:
            raise ValueError(f"{protocol.TOKEN_HEADER}: expected 16 to 128 characters, got {len(token)}")
        axes = checked_axes(self.request.headers.get(protocol.AXES_HEADER, OUR_AXES))
        return new_session(n_anchors, target, axes, token, joinable=joinable), token

    def _wanted(self) -> dict[str, Any]:
        try:
            wanted = json.loads(self.request.body or b"{}")
        except (ValueError, RecursionError) as error:
            raise ValueError(f"expected a JSON object as body ({type(error).__name__})") from None
        if not isinstance(wanted, dict):
            raise ValueError("expected a JSON object as body")
        for name in wanted.keys() - set(protocol.SESSION_FIELDS):
            raise ValueError(f"{name[:80]!r}: there is no such field; there are {', '.join(protocol.SESSION_FIELDS)}")
        return wanted

    def get(self) -> None:
        if not self.token():
            raise Refused(401, f"this needs the owner's token: send it as {protocol.TOKEN_HEADER}")
        owned = self.service.store.owned_by(self.token())
        self.tell({"ok": True, "sessions": [_described(self.service, session) for session in owned]})


class SessionRoute(Handler):
    """GET: what a session knows. DELETE: forget it."""

    queries = ()

    def get(self, session_id: str) -> None:
        self.session_begin = begin_of(session_id)
        session = self.service.session_for(session_id, self.token())
        self.tell({"ok": True, **_described(self.service, session)})

    def delete(self, session_id: str) -> None:
        self.session_begin = begin_of(session_id)
        session = self.service.session_for(session_id, self.token(), as_owner=True)
        self.service.store.delete(session.id)
        self.service.metrics.count("xihe_sessions_total", happened="deleted")
        self.tell({"ok": True})


class ClientsRoute(Handler):
    """POST: join a session; who knows its id may, unless its owner forbids it."""

    queries = ()

    def post(self, session_id: str) -> None:
        self.session_begin = begin_of(session_id)
        token = new_token()
        while not self._joined(session_id, token):
            pass  # Another client joined by another worker at that very moment.

    def _joined(self, session_id: str, token: str) -> bool:
        session = self.service.store.session(session_id)
        if session is None:
            raise Refused(404, "there is no such session, or it has expired")
        if not session.is_joinable:
            raise Refused(403, "the owner of this session lets nobody join")
        try:
            with_client = joined(session, token, self.service.settings.limits)
        except SessionFull as full:
            raise Refused(409, str(full)) from None
        with self.service.kept():
            if not self.service.store.replace(with_client, session):
                return False
        self.tell({"ok": True, "token": token, "n_anchors": session.n_anchors, "target": session.target}, 201)
        return True


class PositionRoute(Handler):
    """POST: the light at a position, of a cloud in the clean form. DELETE: forget the position."""

    queries = ("replace", "share", "key_light", "reflections")

    async def post(self, session_id: str, name: str) -> None:
        self.session_begin = begin_of(session_id)
        session = self.service.session_for(session_id, self.token(), is_fresh=False)
        content_type = self.request.headers.get("Content-Type", "")
        if not protocol.is_clean(content_type):
            raise Refused(415, f"expected the content type {protocol.CLOUD_TYPE}, got {content_type[:80]!r}")
        self.service.check_room()
        with self.service.timed("decode"), as_sent():
            wishes = Wishes(*map(self._switch, self.queries))
            name = protocol.checked_name(name)
            sent = protocol.read_clean(self.request.body, session.n_anchors, content_type, self.request.headers)
        self.tell(await self.service.estimate(session, name, sent, wishes))

    def delete(self, session_id: str, name: str) -> None:
        self.session_begin = begin_of(session_id)
        session = self.service.session_for(session_id, self.token())
        if not self.service.store.delete_position(session.id, name):
            raise Refused(404, "the session has no such position")
        self.tell({"ok": True})

    def _switch(self, name: str) -> bool:
        said = self.query(name, "no")
        if said not in SWITCHES:
            raise ValueError(f"{name}: expected yes or no, got {said[:80]!r}")
        return SWITCHES[said]


def _described(service: EdgeService, session: Session) -> dict[str, Any]:
    positions = service.store.positions(session.id)
    return {
        "session": session.id,
        "n_anchors": session.n_anchors,
        "target": session.target,
        "joinable": session.is_joinable,
        "n_clients": len(session.clients),
        "created_s": session.created_s,
        "positions": {
            name: {
                "n_frames": seen.n_frames,
                "coverage": coverage(seen.cloud),
                "exposure": seen.exposure,
            }
            for name, seen in positions.items()
        },
    }


class HealthRoute(Handler):
    """GET: that the service is there; 503 while its store does not answer."""

    needs_bearer = False

    def get(self) -> None:
        store, estimator = self.service.store, self.service.inference.name
        told = {"ok": True, "software": f"xihe {__version__}", "estimator": estimator, "store": store.name}
        try:
            store.check()
        except StoreLost as error:
            log_lost(error)
            self.headers["Retry-After"] = str(self.service.settings.retry_after_s)
            self.tell(told | protocol.failure(str(error)), 503)
        else:
            self.tell(told)


class MetricsRoute(Handler):
    """GET: metrics for Prometheus."""

    def get(self) -> None:
        text = self.service.metrics.text(self.service.gauges() | self.site.gauges())
        self.finish(200, text.encode(), "text/plain; version=0.0.4; charset=utf-8")


class OpenApiRoute(Handler):
    """GET: the description of all routes."""

    def get(self) -> None:
        self.tell(openapi_document(self.service.settings.sizes, has_bearer=bool(self.site.settings.bearer)))


class PageRoute(Handler):
    """GET: a page that shows the protocol in use."""

    needs_bearer = False

    def get(self) -> None:
        self.headers["Content-Security-Policy"] = "default-src 'self' 'unsafe-inline'; connect-src *"
        page = resources.files("xihenet.edge").joinpath("client.html").read_bytes()
        self.finish(200, page, "text/html; charset=utf-8")


ROUTES: Mapping[str, type[Handler]] = {
    protocol.PUBLISHED_SESSION: PublishedSessionRoute,
    protocol.PUBLISHED_ESTIMATION: PublishedEstimationRoute,
    protocol.SESSIONS: SessionsRoute,
    protocol.SESSIONS + "/([^/]+)": SessionRoute,
    protocol.SESSIONS + "/([^/]+)/clients": ClientsRoute,
    protocol.SESSIONS + "/([^/]+)/positions/([^/]+)": PositionRoute,
    "/health": HealthRoute,
    "/metrics": MetricsRoute,
    "/openapi.json": OpenApiRoute,
    "/": PageRoute,
}
