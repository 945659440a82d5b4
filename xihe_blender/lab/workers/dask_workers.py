"""Dask workers, to whom work is handed: Dask's own on this machine, or those of a scheduler that is there.

Dask does what a batch needs beyond starting processes: it notices workers that die and hands their work to others, lets
workers come and go, and has a dashboard. A piece of work whose Blender dies is tried twice more, and one that takes
four workers with it is given up; both are named in the end. Rejected: pools of our own, which end at one machine.

A worker never loads Blender, whose module does not load beside the thread that Dask works in: it starts a process that
does, and waits, so its memory stays what it is, and neither of the two can take the other with it. What goes over the
network are names, settings and shares of work.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.metadata
import json
import logging
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xihe_blender.errors import UserError
from xihe_blender.jobs import Progress
from xihe_blender.lab.workers.one_core import last_line, process_on_one_core
from xihenet import __version__
from xihenet.child_processes import n_cores
from xihenet.formats import format_count

if TYPE_CHECKING:
    from distributed import Client, Future

POLL_S = 0.25
CONNECT_S = 10.0
ALONE_S = 30.0
N_RETRIES = 2
EXIT_CANNOT_BE_DONE = 2  # Of a module that has said on stderr what the user can mend
TOPIC = "xihe"  # Of the events that tell how far a piece of work is


@dataclass(frozen=True)
class Work:
    """A piece of work: a module of this project that runs in a process with Blender.

    Where it is told something, it tells its share of the work on stdout, lines that are a number from 0 to 1.
    """

    name: str  # of its own
    module: str  # run with the `arguments`
    arguments: tuple[str, ...] = ()
    told: Any = None  # on stdin, as JSON holds it; None for nothing
    program: tuple[str, ...] = ()  # what starts the module; empty for the worker's own Python


class BlenderDiedError(Exception):
    """The process ended without a word of what the user could mend: it was killed, or Blender crashed."""


@dataclass
class DaskWorkers:
    """Work under way; made by `open_dask_workers`."""

    client: Client  # of the scheduler
    is_local: bool  # whether its workers are our own; others come and go
    shares: dict[str, float] = field(default_factory=dict)  # how far each piece of work is, 0 to 1, by name
    failed: dict[str, str] = field(default_factory=dict)  # why what could not be done, by name

    def check_workers(self, folder: str, scenes: list[str]) -> None:
        """UserError if no worker is there, or one does not have this project, this Blender, the folder or a scene.

        The scheduler needs the project too: it reads what it passes on. Our own workers have what this process has.
        """
        address = self.client.scheduler.address
        try:
            self.client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError as error:
            raise UserError(
                f"the scheduler at {address} has no worker: start some with `dask worker {address} --nthreads 1`"
            ) from error
        if self.is_local:
            return
        try:
            self.client.run_on_scheduler(describe_worker, folder, [])
        except (ImportError, RuntimeError) as error:
            raise UserError(
                f"the scheduler at {address} does not have this project: install xihe-blender there ({error})"
            ) from error
        for worker, told in self.client.run(describe_worker, folder, scenes, on_error="return").items():
            if isinstance(told, BaseException):
                raise UserError(f"worker {worker} does not have this project: install xihe-blender there ({told})")
            version, blender, unusable = told
            if version != __version__:
                raise UserError(f"worker {worker} has xihe {version} and this is {__version__}: install the same")
            if blender != blender_version():
                there, here = map(_format_blender, (blender, blender_version()))
                raise UserError(
                    f"worker {worker} has {there} and this is {here}, which may render differently: install the same"
                )
            if unusable:
                raise UserError(f"worker {worker} cannot use {unusable[0]}: all workers need it under the same path")

    def run(self, work: Sequence[Work], noun: str) -> Iterator[Progress]:
        """Have it all done, the first ones first; yields progress. What failed is in `failed` afterwards.

        `noun` says what one of them is.
        """
        self.client.subscribe_topic(TOPIC, self._hear)
        futures: dict[str, Future[str | None]] = {}
        for index, one in enumerate(work):
            once = {"key": f"{one.name}-{time.time_ns()}", "pure": False}
            if self.is_local:
                one = replace(one, program=own_program(one.module))
            futures[one.name] = self.client.submit(run_module, one, priority=-index, retries=N_RETRIES, **once)
        try:
            yield from self._watched(futures, noun)
        finally:
            with contextlib.suppress(OSError):  # There is nobody to tell.
                self.client.cancel(list(futures.values()))

    def _watched(self, futures: Mapping[str, Future[str | None]], noun: str) -> Iterator[Progress]:
        n_done, alone_since = -1, time.monotonic()
        while n_done < len(futures):
            ended = [name for name, future in futures.items() if future.done()]
            self.shares |= dict.fromkeys(ended, 1.0)
            n_done = len(ended)
            if any(futures[name].cancelled() for name in ended):  # Dask does so to all where the connection is gone.
                raise self._lost()
            share = sum(self.shares.get(name, 0.0) for name in futures) / len(futures)
            # By the percent, or a batch of thousands would tell of nothing else.
            done = len(futures) * math.floor(100 * share) / 100
            try:
                n_workers = len(self.client.ncores())
            except OSError as error:
                raise self._lost() from error
            told = f"{n_done} of {format_count(len(futures), noun)}, {format_count(n_workers, 'worker')}"
            yield Progress(done, len(futures), told)
            alone_since = time.monotonic() if n_workers else alone_since
            if self.is_local and time.monotonic() - alone_since > ALONE_S:
                raise UserError("no worker is left: run the same command again, it goes on from here")
            if n_done < len(futures):
                time.sleep(POLL_S)
        reasons = {name: _why_it_failed(future) for name, future in futures.items()}
        self.failed |= {name: reason for name, reason in reasons.items() if reason is not None}

    def _lost(self) -> UserError:
        address = self.client.scheduler.address
        return UserError(
            f"the scheduler at {address} cannot be reached any more: start it and its workers again where they have "
            "ended, then run the same command again to resume"
        )

    def _hear(self, event: tuple[Any, tuple[str, float]]) -> None:
        # What is tried again starts over, but what it had rendered is there.
        _, (name, share) = event
        self.shares[name] = share


def _format_blender(blender: str | None) -> str:
    return "no Blender as a Python module" if blender is None else f"Blender {blender}"


def _why_it_failed(future: Future[str | None]) -> str | None:
    if future.status == "error":
        error = future.exception()
        return f"{type(error).__name__}: {' '.join(str(error).split())}"
    reason: str | None = future.result() if future.status == "finished" else f"was {future.status}"
    return reason


# --------------------------------------------------------------------------------------- on a worker's machine


def run_module(work: Work) -> str | None:
    """Do `work` in a process with Blender; None, or in one line why it cannot be done.

    BlenderDiedError for what may go better next time.
    """
    command = [*(work.program or (sys.executable, "-m", work.module)), *work.arguments]
    piped = subprocess.PIPE if work.told is not None else subprocess.DEVNULL
    # A whole Blender's own lines may name paths in any encoding.
    words_of = {"encoding": "utf-8", "errors": "replace"}
    with process_on_one_core(command, stdin=piped, stdout=piped, **words_of) as (process, errors):
        if work.told is not None:
            _pass_on(process, work)
        code, words = process.wait(), last_line(errors)
    if code in (0, EXIT_CANNOT_BE_DONE):
        return words if code else None
    raise BlenderDiedError(words if words and code > 0 else f"Blender ended with exit code {code}")


def _pass_on(process: subprocess.Popen[str], work: Work) -> None:
    """Tell the process what to do, and everyone who listens how far it is."""
    from distributed import get_worker

    assert process.stdin is not None and process.stdout is not None
    # One that died at once says why by its exit code.
    with process.stdout as shares, contextlib.suppress(BrokenPipeError):
        with process.stdin as stdin:
            stdin.write(json.dumps(work.told))
        worker = get_worker()
        for line in shares:
            with contextlib.suppress(ValueError):  # A whole Blender's own words.
                worker.log_event(TOPIC, (work.name, float(line)))


def own_program(module: str) -> tuple[str, ...]:
    """What starts `module` on this machine; empty where Blender is not loaded, which a worker must not do for it."""
    if "bpy" not in sys.modules:
        return ()
    from xihe_blender.lab.workers.processes import module_command

    return tuple(module_command(module))


def blender_version() -> str | None:
    """Of the Blender that this runs in, or else of Blender as a Python module, which is not loaded for it.

    None where there is neither. A whole Blender has no package of its own to be asked for.
    """
    running = sys.modules.get("bpy")
    if running is not None:
        return ".".join(map(str, running.app.version))
    try:
        return importlib.metadata.version("bpy")
    except importlib.metadata.PackageNotFoundError:
        return None


def describe_worker(folder: str, scenes: list[str]) -> tuple[str, str | None, list[str]]:
    """What decides whether a worker can help: versions, Blender's too, and which paths it does not see or write to."""
    unseen = [path for path in (folder, *scenes) if not Path(path).exists()]
    return __version__, blender_version(), unseen or ([] if os.access(folder, os.W_OK) else [folder])


def has_dashboard(dask_scheduler: Any) -> bool:
    """Whether a scheduler has one: Bokeh's application among those of its web server.

    Its address is no sign: the web server is there in any case, and without bokeh it says how to get that.
    """
    return any("Bokeh" in type(one).__name__ for one in dask_scheduler.http_application.applications)


# ------------------------------------------------------------------------------------------------ schedulers


@contextlib.contextmanager
def open_dask_workers(n_workers: int | None, address: str | None) -> Iterator[DaskWorkers]:
    """A scheduler with workers: the one at `address`, or our own with `n_workers` processes (None: one per core).

    UserError where Dask is missing, or nobody answers at `address`.
    """
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise UserError("Dask is not installed: pip install 'xihe-blender[evaluate]'") from error
    for name in ("distributed", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with _local_client(n_workers) if address is None else _client_of(address) as client:
        yield DaskWorkers(client, is_local=address is None)


def dashboard(workers: DaskWorkers) -> str:
    """Where the dashboard is, or how to get one, in a sentence.

    The scheduler is asked: what is installed here says nothing of another machine. Call it after `check_workers`, for
    the scheduler needs the project to answer.
    """
    if workers.client.run_on_scheduler(has_dashboard):
        return f"dashboard: {workers.client.dashboard_link}"
    return f"no dashboard: it takes {'pip install bokeh' if workers.is_local else 'a scheduler with bokeh installed'}"


@contextlib.contextmanager
def _local_client(n_workers: int | None) -> Iterator[Client]:
    import dask
    from distributed import Client, LocalCluster

    # A port that is free, or two batches could not run beside each other. No limit: Dask would count in Blender's
    # memory, and pause workers for it.
    settings = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "memory_limit": 0, "processes": True}
    settings |= {"n_workers": n_workers or n_cores(), "threads_per_worker": 1, "silence_logs": logging.CRITICAL}
    # And no profile of workers that only wait: it grows by the second, for an hour.
    without_profile = dask.config.set({"distributed.worker.profile.enabled": False})
    with without_profile, LocalCluster(**settings) as cluster, Client(cluster) as client:
        yield client


@contextlib.contextmanager
def _client_of(address: str) -> Iterator[Client]:
    from distributed import Client

    try:
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, _reach(address)).result()
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError, RuntimeError) as error:
        raise UserError(
            f"no scheduler answers at {address!r}: start one with `dask scheduler` and give its address, "
            "such as tcp://host:8786, or leave --scheduler out"
        ) from error
    with client:
        yield client


async def _reach(address: str) -> None:
    """Raises what is wrong with the address, or the way there.

    A client for which that is anything but an OSError is never finished, and Python's end waits 20 s for it.
    """
    from distributed.comm import connect
    from distributed.security import Security

    comm = await connect(address, timeout=CONNECT_S, **Security().get_connection_args("client"))
    comm.abort()
