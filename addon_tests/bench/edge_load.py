"""Load on `xihe serve` in a process of its own: a held rate, then twice what it can bear, and whether it recovers.

    python addon_tests/bench/edge_load.py [--seconds 60] [--clients 8] [--rate 30] [--estimator lattice]

Each client has a connection of its own and asks at fixed times, with the published protocol. Latencies are counted from
those times and not from when a request could be sent, so that a server that stalls is not spared. Clients and server
share the machine: the figures are of both.
"""

import argparse
import asyncio
import os
import re
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from xihenet.codec import encode_cloud
from xihenet.edge.batching import Inference, Job
from xihenet.records import UnitSphereCloud

N_ANCHORS, SEEN_SHARE = 1280, 0.5
MOST_CONNECTIONS = 128


@dataclass
class Answers:
    """Of one phase: latencies in seconds of those that were answered with light, and how many of each status."""

    latencies_s: list[float] = field(default_factory=list)
    statuses: Counter = field(default_factory=Counter)
    seconds: float = 0.0

    def __str__(self) -> str:
        ms = 1e3 * np.array(self.latencies_s or [np.nan])
        p50, p99 = np.percentile(ms, [50, 99])
        statuses = ", ".join(f"{n} x {status}" for status, n in sorted(self.statuses.items(), key=str))
        rate = len(self.latencies_s) / self.seconds
        return f"{statuses}; {rate:.0f} lights/s; p50 {p50:.1f} ms, p99 {p99:.1f} ms, most {ms.max():.1f} ms"


def cloud_of(rng):
    is_set = rng.random(N_ANCHORS) < SEEN_SHARE
    srgb = rng.random((N_ANCHORS, 3)) * is_set[:, None]
    return UnitSphereCloud(srgb, rng.uniform(0.5, 5, N_ANCHORS) * is_set, is_set)


class Client:
    """One phone: its connection and session."""

    def __init__(self, port, seed):
        self.port, rng = port, np.random.default_rng(seed)
        self.bodies = [encode_cloud(cloud_of(rng)) for _ in range(8)]
        self.n_asked = 0

    async def open(self):
        self.reader, self.writer = await asyncio.open_connection("127.0.0.1", self.port)
        head = f"POST /api/v2/session/ HTTP/1.1\r\nHost: x\r\nAnchor-Size: {N_ANCHORS}\r\nContent-Length: 0\r\n\r\n"
        _, body = await self._exchange(head.encode())
        self.session = re.search(rb'"sid": "([^"]+)"', body)[1].decode()

    async def ask(self):
        body = self.bodies[self.n_asked % len(self.bodies)]
        self.n_asked += 1
        head = "POST /api/v2/lighting-estimation/ HTTP/1.1\r\nHost: x\r\n"
        head += f"Session-ID: {self.session}\r\nContent-Length: {len(body)}\r\n\r\n"
        status, _ = await self._exchange(head.encode() + body)
        return status

    async def _exchange(self, sent):
        self.writer.write(sent)
        head = await self.reader.readuntil(b"\r\n\r\n")
        length = int(re.search(rb"Content-Length: (\d+)", head)[1])
        return int(head[9:12]), await self.reader.readexactly(length)

    def close(self):
        self.writer.close()


async def asked_at_a_rate(client, times_s, start, answers):
    for due in times_s:
        await asyncio.sleep(max(0.0, start + due - time.perf_counter()))
        status = await client.ask()
        answers.statuses[status] += 1
        if status == 200:
            answers.latencies_s.append(time.perf_counter() - start - due)


async def hold_rate(clients, rate, seconds):
    """Each client asks `rate` times a second, all of them out of step."""
    answers, start = Answers(), time.perf_counter()
    times = [np.arange(number / len(clients) / rate, seconds, 1 / rate) for number in range(len(clients))]
    await asyncio.gather(*(asked_at_a_rate(c, t, start, answers) for c, t in zip(clients, times, strict=True)))
    answers.seconds = time.perf_counter() - start
    return answers


async def as_many_as_go(clients, seconds):
    """Each client asks as soon as it has its answer."""
    answers, start = Answers(), time.perf_counter()

    async def ask_on(client):
        while time.perf_counter() - start < seconds:
            asked = time.perf_counter()
            status = await client.ask()
            answers.statuses[status] += 1
            if status == 200:
                answers.latencies_s.append(time.perf_counter() - asked)

    await asyncio.gather(*map(ask_on, clients))
    answers.seconds = time.perf_counter() - start
    return answers


async def recovery_s(client):
    """From now until three answers in a row come within 50 ms."""
    start, n_good = time.perf_counter(), 0
    while n_good < 3:
        asked = time.perf_counter()
        n_good = n_good + 1 if await client.ask() == 200 and time.perf_counter() - asked < 0.05 else 0
    return time.perf_counter() - start


def cpu_s(pid):
    """Processor time that the server has taken, of all its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def rss_mb(process):
    text = Path(f"/proc/{process.pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+) kB", text)[1]) / 1024


async def opened(port, n, first_seed=0):
    clients = [Client(port, first_seed + number) for number in range(n)]
    for client in clients:
        await client.open()
    return clients


async def run(process, port, options):
    clients = await opened(port, options.clients)
    await hold_rate(clients, options.rate, 2)
    before = rss_mb(process)
    held = await hold_rate(clients, options.rate, options.seconds)
    print(f"{options.clients} clients x {options.rate}/s for {options.seconds} s: {held}")
    print(f"memory of the server: {before:.1f} MB before, {rss_mb(process):.1f} MB after")
    more = await opened(port, 24, 100)
    spent_s = cpu_s(process.pid)
    capacity = await as_many_as_go(more, options.seconds / 4)
    n_lights = len(capacity.latencies_s) / capacity.seconds
    per_cpu_s = len(capacity.latencies_s) / (cpu_s(process.pid) - spent_s)
    print(f"as many as go, 24 clients: {capacity}; {per_cpu_s:.0f} lights per second of processor time")
    many = [*clients, *more, *await opened(port, MOST_CONNECTIONS - len(clients) - len(more), 200)]
    overload = await hold_rate(many, 2 * n_lights / len(many), options.seconds / 4)
    print(f"twice that, {len(many)} clients: {overload}")
    print(f"recovery: {await recovery_s(clients[0]):.2f} s; memory {rss_mb(process):.1f} MB")
    for client in many:
        client.close()
    return per_cpu_s


def batches_alone(name, seconds=3.0):
    """Lights per second of processor time, of batches of 16 without a network, in this process."""
    inference, rng = Inference(name), np.random.default_rng(0)
    jobs, n = [Job(cloud_of(rng), "ldr") for _ in range(16)], 0
    inference(jobs)
    start = time.process_time()
    while time.process_time() - start < seconds:
        inference(jobs)
        n += len(jobs)
    return n / (time.process_time() - start)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--clients", type=int, default=8)
    parser.add_argument("--rate", type=float, default=30)
    parser.add_argument("--estimator", default="lattice")
    options = parser.parse_args()
    command = [sys.executable, "-m", "xihe_blender", "serve", "--port", "0", "--estimator", options.estimator]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        port = int(re.search(r":(\d+),", process.stdout.readline())[1])
        print(f"load of the machine before: {Path('/proc/loadavg').read_text().split()[0]}")
        through_http = asyncio.run(run(process, port, options))
        assert process.poll() is None, "the server is gone"
    finally:
        process.kill()
        process.wait()
    alone = batches_alone(options.estimator)
    print(
        f"batches of 16 alone: {alone:.0f} lights per second of processor time, through HTTP {through_http / alone:.0%}"
    )


if __name__ == "__main__":
    main()
