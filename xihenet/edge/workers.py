"""Several server processes at one port: the kernel spreads connections over them, and a store outside keeps sessions.

Each worker is a whole server with a socket of its own (`SO_REUSEPORT`), in a new interpreter: forked ones would share
CUDA and threads that do not survive it. One listening socket for all was rejected since Tornado takes all connections
that wait, so that one worker gets most. The process that started them keeps the port and starts anew whichever ends;
they end with it.
"""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

from xihenet.edge.batching import Inference
from xihenet.edge.handler import log_event, logged_to
from xihenet.edge.http_settings import ServerSettings
from xihenet.edge.server import bound, serve, tls_of

RESTART_S = 0.5
"""Before a worker that ended is started anew."""

STOP_S = 10.0
"""For workers to answer what waits, before they are killed."""


class CannotStart(Exception):
    """There can be no workers here; the message says why."""


def serve_by_workers(
    inference: Inference, settings: ServerSettings, n_workers: int, when_ready: Callable[[int], None], *, log_to: int
) -> None:
    """Run until SIGINT or SIGTERM; `when_ready` gets the port once all of them serve. For the main thread.

    Workers log to the file descriptor `log_to`.

    OSError where the address cannot be had or a certificate cannot be read; `CannotStart` where processes cannot share
    a port, and if a worker ends before it serves.
    """
    if not hasattr(socket, "SO_REUSEPORT"):
        raise CannotStart("on this system processes cannot share a port: start one")
    tls_of(settings)
    # Which would share it with others' workers as well: no such server may be there.
    bound(replace(settings, worker=None)).close()
    first = replace(settings, worker=0)
    with contextlib.closing(bound(first)) as keeping_the_port, _ended_by_signals():
        port = keeping_the_port.getsockname()[1]
        workers: list[SpawnProcess] = []
        try:
            pipes = []
            for number in range(n_workers):
                worker, ready = _started(inference, replace(settings, port=port, worker=number), log_to)
                workers.append(worker)
                pipes.append(ready)
            for worker, ready in zip(workers, pipes, strict=True):
                if ready not in wait([ready, worker.sentinel]) or not _is_told(ready):
                    raise CannotStart("a worker ended before it served: its own lines say why")
            when_ready(port)
            _keep_running(inference, replace(settings, port=port), workers, log_to)
        except KeyboardInterrupt:
            log_event("stopping all", workers=len(workers))
        finally:
            for number in (signal.SIGINT, signal.SIGTERM):  # Told once more, it would leave its workers behind.
                signal.signal(number, signal.SIG_IGN)
            _end(workers)


def _started(inference: Inference, settings: ServerSettings, log_to: int) -> tuple[SpawnProcess, Connection[None, Any]]:
    """A worker, and what tells when it serves."""
    from multiprocessing.reduction import DupFd  # Which Windows has not.

    context = multiprocessing.get_context("spawn")
    ready, told = context.Pipe(duplex=False)
    worker = context.Process(target=_work, args=(inference, settings, told, DupFd(log_to)), daemon=True)
    worker.start()
    told.close()  # So that `ready` ends with the worker.
    return worker, ready


def _work(inference: Inference, settings: ServerSettings, told: Connection[Any, None], stderr: Any) -> None:
    os.dup2(stderr.detach(), 2)  # Where it was to go may be for Blender's own lines.
    with logged_to(sys.stderr), contextlib.closing(told):
        asyncio.run(serve(inference, settings, told.send))


def _is_told(ready: Connection[None, Any]) -> bool:
    with contextlib.closing(ready):
        try:
            return bool(ready.recv())
        except EOFError:
            return False


def _keep_running(inference: Inference, settings: ServerSettings, workers: list[SpawnProcess], log_to: int) -> None:
    listeners: dict[int, Connection[None, Any]] = {}  # Kept open, or a worker that was started anew could not tell.
    while True:
        wait([worker.sentinel for worker in workers])
        for number, worker in enumerate(workers):
            if worker.exitcode is not None:
                log_event("worker ended", worker=number, exit=worker.exitcode)
                time.sleep(RESTART_S)
                workers[number], listeners[number] = _started(inference, replace(settings, worker=number), log_to)


def _end(workers: list[SpawnProcess]) -> None:
    for worker in workers:
        worker.terminate()
    until = time.monotonic() + STOP_S
    for worker in workers:
        worker.join(max(0.0, until - time.monotonic()))
        worker.kill()
        worker.join()


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """In the block SIGINT and SIGTERM are a KeyboardInterrupt, in the background too, where shells ignore SIGINT."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
