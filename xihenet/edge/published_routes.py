"""Routes of the published client, exactly as it calls them, with the session's id as the only secret."""

from __future__ import annotations

from xihenet.edge import protocol
from xihenet.edge.axes import PUBLISHED_AXES, checked_axes
from xihenet.edge.handler import Handler, as_sent, begin_of
from xihenet.edge.service import Refused
from xihenet.edge.sessions import new_session


class PublishedSessionRoute(Handler):
    """POST: a session of the published client."""

    def post(self) -> None:
        sizes, headers = self.service.settings.sizes, self.request.headers
        with as_sent():
            n_anchors = protocol.anchors_wanted(headers.get("Anchor-Size"), sizes)
            axes = checked_axes(headers.get(protocol.AXES_HEADER, PUBLISHED_AXES))
        session = self.service.open(new_session(n_anchors, self.service.settings.target, axes))
        self.session_told = begin_of(session.id)
        self.tell({"ok": True, "sid": session.id})


class PublishedEstimationRoute(Handler):
    """POST: the light of a published client's records."""

    async def post(self) -> None:
        headers = self.request.headers
        session_id = headers.get("Session-ID")
        if session_id is None:
            raise Refused(400, "Session-ID: expected the id that opening a session gave, got no such header")
        self.session_told = begin_of(session_id)
        session = self.service.published_session(session_id)
        self.service.check_room()
        with self.service.timed("decode"), as_sent():
            axes = headers.get(protocol.AXES_HEADER, session.axes)
            sent = protocol.read_published(self.request.body, session.n_anchors, axes)
        coefficients = await self.service.estimate_published(session, sent)
        self.set_header("Xihe-Dropped-Records", str(sent.quirks.get("dropped", 0)))
        self.set_header("Xihe-Lost-Records", str(sent.quirks.get("lost", 0)))
        self.tell({"ok": True, "coefficients": coefficients})
