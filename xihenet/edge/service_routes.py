"""Routes about the service itself: health, metrics, the description of its routes, and a page that uses it."""

from __future__ import annotations

from importlib import resources

from xihenet import __version__
from xihenet.edge.handler import Handler
from xihenet.edge.openapi import openapi_document
from xihenet.edge.protocol import failure
from xihenet.edge.service import Refused
from xihenet.edge.sessions import StoreLost


class HealthRoute(Handler):
    """GET: that the service is there; 503 while its store does not answer."""

    needs_bearer = False

    def get(self) -> None:
        store, estimator = self.service.store, self.service.inference.name
        told = {"ok": True, "software": f"xihe {__version__}", "estimator": estimator, "store": store.name}
        try:
            store.check()
        except StoreLost as error:
            self.set_header("Retry-After", str(self.service.settings.retry_after_s))
            self.tell(told | failure(str(error)), 503)
        else:
            self.tell(told)


class MetricsRoute(Handler):
    """GET: metrics for Prometheus."""

    def get(self) -> None:
        self.set_header("Content-Type", "text/plain; version=0.0.4; charset=utf-8")
        self.finish(self.service.metrics.text(self.service.gauges() | self.application.settings["gauges"]()))


class OpenApiRoute(Handler):
    """GET: the description of all routes."""

    def get(self) -> None:
        self.tell(openapi_document(self.service.settings.sizes, has_bearer=bool(self.settings_of_server.bearer)))


class PageRoute(Handler):
    """GET: a page that shows the protocol in use."""

    needs_bearer = False

    def get(self) -> None:
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.set_header("Content-Security-Policy", "default-src 'self' 'unsafe-inline'; connect-src *")
        self.finish(resources.files("xihenet.edge").joinpath("client.html").read_bytes())


class UnknownRoute(Handler):
    """Any other route."""

    def prepare(self) -> None:
        super().prepare()
        raise Refused(404, "there is no such route; /openapi.json names those that there are")
