"""Dask workers, to whom work is handed: Dask's own on this machine, or those of a scheduler that is there.

Dask does what a batch needs beyond starting processes: it notices workers that die and hands their work to others, lets
workers come and go, and has a dashboard. A piece of work whose Blender dies is tried twice more, and one that takes
four workers with it is given up; both are named in the end. Rejected: pools of our own, which end at one machine.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from xihe_blender.errors import UserError
from xihe_blender.jobs import Progress
from xihe_blender.lab.workers.one_core import n_cores
from xihenet import __version__
from xihenet.formats import format_count

if TYPE_CHECKING:
    from distributed import Client, Future

POLL_S = 0.25
CONNECT_S = 10.0
ALONE_S = 30.0
N_RETRIES = 2
INSTALL = "pip install 'xihe-blender[evaluate]'"


@dataclass
class DaskWorkers:
    """Work under way; made by `open_dask_workers`.

    Parameters
    ----------
    client : of the scheduler
    is_local : whether its workers are our own; others come and go
    shares : how far each piece of work is, 0 to 1, by name
    failed : why what could not be done, by name
    """

    client: Client
    is_local: bool
    shares: dict[str, float] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def check_workers(self, folder: str, scenes: list[str]) -> None:
        """UserError if no worker is there, or one does not have this project, the folder or a scene.

        The scheduler needs the project too: it reads what it passes on.
        """
        from xihe_blender.lab.workers.dask_worker import describe_worker

        address = self.client.scheduler.address
        try:
            self.client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError as error:
            raise UserError(
                f"the scheduler at {address} has no worker: start some with `dask worker {address} --nthreads 1`"
            ) from error
        try:
            self.client.run_on_scheduler(describe_worker, folder, [])
        except (ImportError, RuntimeError) as error:
            raise UserError(
                f"the scheduler at {address} does not have this project: install xihe-blender there ({error})"
            ) from error
        for worker, told in self.client.run(describe_worker, folder, scenes, on_error="return").items():
            if isinstance(told, BaseException):
                raise UserError(f"worker {worker} does not have this project: install xihe-blender there ({told})")
            if told["xihe"] != __version__:
                raise UserError(f"worker {worker} has xihe {told['xihe']} and this is {__version__}: install the same")
            if told["missing"] or not told["is_writable"]:
                place = (told["missing"] or [folder])[0]
                raise UserError(f"worker {worker} cannot use {place}: all workers need it under the same path")

    def run(self, asked: Sequence[Mapping[str, Any]], noun: str) -> Iterator[Progress]:
        """Have it all done, the first ones first; yields progress. What failed is in `failed` afterwards.

        Parameters
        ----------
        asked : as `dask_worker.run_module` takes it
        noun : what one of them is
        """
        from xihe_blender.lab.workers.dask_worker import TOPIC, run_module

        self.client.subscribe_topic(TOPIC, self._hear)
        futures: dict[str, Future[str | None]] = {}
        for place, one in enumerate(asked):
            futures[one["name"]] = self.client.submit(
                run_module, dict(one), key=f"{one['name']}-{time.time_ns()}", pure=False,
                priority=-place, retries=N_RETRIES,
            )  # fmt: skip
        try:
            yield from self._watched(futures, noun)
        finally:
            self.client.cancel(list(futures.values()))

    def _watched(self, futures: Mapping[str, Future[str | None]], noun: str) -> Iterator[Progress]:
        n_done, alone_since = -1, time.monotonic()
        while n_done < len(futures):
            ended = [name for name, future in futures.items() if future.done()]
            for name in ended:
                self.shares[name] = 1.0
            n_done = len(ended)
            share = sum(self.shares.get(name, 0.0) for name in futures) / len(futures)
            # By the percent, or a batch of thousands would tell of nothing else.
            done = len(futures) * math.floor(100 * share) / 100
            n_workers = len(self.client.ncores())
            workers = format_count(n_workers, "worker")
            yield Progress(done, len(futures), f"{n_done} of {format_count(len(futures), noun)}, {workers}")
            alone_since = time.monotonic() if n_workers else alone_since
            if self.is_local and time.monotonic() - alone_since > ALONE_S:
                raise UserError("no worker is left: run the same command again, it goes on from here")
            if n_done < len(futures):
                time.sleep(POLL_S)
        for name, future in futures.items():
            reason = _why_it_failed(future)
            if reason is not None:
                self.failed[name] = reason

    def _hear(self, event: tuple[Any, Mapping[str, Any]]) -> None:
        _, told = event
        # What is tried again starts over, but what it had rendered is there.
        self.shares[told["name"]] = float(told["share"])


def _why_it_failed(future: Future[str | None]) -> str | None:
    if future.status == "finished":
        reason: str | None = future.result()
        return reason
    if future.status == "error":
        error = future.exception()
        return f"{type(error).__name__}: {' '.join(str(error).split())}"
    return f"was {future.status}"


@contextlib.contextmanager
def open_dask_workers(n_workers: int | None, address: str | None) -> Iterator[DaskWorkers]:
    """A scheduler with workers: the one at `address`, or our own with `n_workers` processes (None: one per core).

    UserError where Dask is missing, or nobody answers at `address`.
    """
    try:
        import distributed
    except ImportError as error:
        raise UserError(f"Dask is not installed: {INSTALL}") from error
    for name in ("distributed", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with contextlib.ExitStack() as stack:
        if address is None:
            cluster = stack.enter_context(_local_cluster(n_workers))
            yield DaskWorkers(stack.enter_context(distributed.Client(cluster)), is_local=True)
        else:
            yield DaskWorkers(stack.enter_context(_client_of(address)), is_local=False)


def dashboard(workers: DaskWorkers) -> str:
    """Where the dashboard is, or how to get one, in a sentence.

    The scheduler is asked: what is installed here says nothing of another machine. Call it after `check_workers`, for
    the scheduler needs the project to answer.
    """
    from xihe_blender.lab.workers.dask_worker import has_dashboard

    if workers.client.run_on_scheduler(has_dashboard):
        return f"dashboard: {workers.client.dashboard_link}"
    return f"no dashboard: it takes {'pip install bokeh' if workers.is_local else 'a scheduler with bokeh installed'}"


@contextlib.contextmanager
def _local_cluster(n_workers: int | None) -> Iterator[Any]:
    import dask
    from distributed import LocalCluster

    # A port that is free, or two batches could not run beside each other. No limit: Dask would count in Blender's
    # memory, and pause workers for it.
    # And no profile of workers that only wait: it grows by the second, for an hour.
    profile = {"distributed.worker.profile.enabled": False}
    with (
        dask.config.set(profile),
        LocalCluster(
            n_workers=n_workers or n_cores(),
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            memory_limit=0,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as cluster,
    ):
        yield cluster


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
    try:
        yield client
    finally:
        client.close()


async def _reach(address: str) -> None:
    """Raises what is wrong with the address, or the way there.

    A client for which that is anything but an OSError is never finished, and Python's end waits 20 s for it.
    """
    from distributed.comm import connect
    from distributed.security import Security

    comm = await connect(address, timeout=CONNECT_S, **Security().get_connection_args("client"))
    comm.abort()
