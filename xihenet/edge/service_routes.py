"""Routes about the service itself: health, metrics, the description of its routes, and a page that uses it."""

from __future__ import annotations

from importlib import resources

from xihenet import __version__
from xihenet.edge.handler import Handler, log_lost
from xihenet.edge.openapi import openapi_document
from xihenet.edge.protocol import failure
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
            log_lost(error)
            self.headers["Retry-After"] = str(self.service.settings.retry_after_s)
            self.tell(told | failure(str(error)), 503)
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
