"""The HTTP server, on Tornado: it listens, and serves until it is told to stop.

Tornado was chosen over asyncio alone for its HTTP parser and TLS, and over the ASGI frameworks since Dask brings it
anyway. `requests` is what it hands over, `routes` who answers, and `handler` what all of them share.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import multiprocessing
import signal
import socket
import ssl
import sys
from collections.abc import AsyncIterator, Callable

from xihenet.edge.batching import Inference
from xihenet.edge.handler import Site, log_event
from xihenet.edge.http_settings import ServerSettings
from xihenet.edge.requests import Server
from xihenet.edge.routes import ROUTES
from xihenet.edge.service import EdgeService
from xihenet.edge.sessions import MemoryStore, SessionStore

EXPIRES_EVERY_S = 5.0

SWITCH_S = 0.0005
"""After so long another thread lets the event loop have the interpreter. Python's 5 ms would pass at each `send`."""


@contextlib.asynccontextmanager
async def running(inference: Inference, settings: ServerSettings) -> AsyncIterator[tuple[EdgeService, int]]:
    """The service, listening, and its port, for the length of the block.

    OSError where the address cannot be had or a certificate cannot be read.
    """
    service = EdgeService(inference, settings.service, _store(settings), settings.worker)
    site = Site(service, settings, ROUTES)
    server = Server.made(settings, site.answer, tls_of(settings))
    site.gauges = lambda: {"xihe_connections": server.n_connections}
    listening = bound(settings)
    listening.listen(128)
    server.add_socket(listening)
    beside = [asyncio.create_task(one) for one in (_expire(service), server.close_late())]
    try:
        yield service, listening.getsockname()[1]
    finally:
        for task in beside:
            task.cancel()
        server.stop()
        await site.stop()
        await service.close()
        await server.close_all_connections()


async def serve(inference: Inference, settings: ServerSettings, when_ready: Callable[[int], None]) -> None:
    """Run until SIGINT or SIGTERM; `when_ready` gets the port. The process is the server's own."""
    sys.setswitchinterval(SWITCH_S)
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError):  # Windows, where Ctrl-C cancels this instead.
            loop.add_signal_handler(number, stop.set)
    starter = multiprocessing.parent_process()
    if settings.worker is not None and starter is not None:
        loop.add_reader(starter.sentinel, stop.set)  # Nobody is left to end it.
    async with running(inference, settings) as (_, port):
        # What there is stays: looking through it for garbage, now and then, holds up all requests for 20 ms.
        gc.collect()
        gc.freeze()
        log_event(
            "started",
            host=settings.host,
            port=port,
            estimator=inference.name,
            tls=settings.certificate is not None,
            worker=settings.worker,
        )
        when_ready(port)
        try:
            await stop.wait()
        finally:
            log_event("stopping")


async def _expire(service: EdgeService) -> None:
    while True:
        await asyncio.sleep(EXPIRES_EVERY_S)
        if isinstance(service.store, MemoryStore):
            service.store.expire()


def _store(settings: ServerSettings) -> SessionStore:
    if not settings.store:
        return MemoryStore(settings.service.limits)
    from xihenet.edge.redis_store import RedisStore

    return RedisStore(settings.store, settings.service.limits)


def bound(settings: ServerSettings) -> socket.socket:
    """A socket that does not listen yet, at the first address that the host's name has; workers share the address."""
    try:
        family, *_, address = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM)[0]
    except UnicodeError as error:  # Of a name with two dots in a row, for instance.
        raise OSError("this is no name of a machine") from error
    at_address = socket.socket(family, socket.SOCK_STREAM)
    try:
        if sys.platform != "win32":  # Where it would let two servers have one address.
            at_address.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if settings.worker is not None:
            at_address.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        if family == socket.AF_INET6:
            at_address.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        at_address.setblocking(False)
        at_address.bind(address[:2])
    except OSError:
        at_address.close()
        raise
    return at_address


def tls_of(settings: ServerSettings) -> ssl.SSLContext | None:
    if settings.certificate is None:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    # Else OpenSSL would ask in the terminal for the key's password, once in each process.
    context.load_cert_chain(settings.certificate, settings.key, password=b"")
    return context
