"""Load on `xihe serve` in a process of its own: a held rate, then twice what it can bear, and whether it recovers.

    python addon_tests/bench/edge_load.py [--seconds 60] [--clients 8] [--rate 30] [--estimator lattice] [--form clean]

The server has one core to itself, and the clients have the others. Each client has a connection and a session of its
own, in the published or the clean form, and asks at fixed times. Latencies are counted from those times and not from
when a request could be sent, so that a server that stalls is not spared.
"""

import asyncio
import json
import os
import re
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from given import given

from xihenet.codec import encode_cloud
from xihenet.edge.bench import random_cloud
from xihenet.edge.protocol import DEFAULT_METHOD, content_type_of

N_ANCHORS = 1280
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


class Client:
    """One phone: its connection and session, in the published or the clean form."""

    def __init__(self, port, seed, form="published"):
        self.port, self.form, rng = port, form, np.random.default_rng(seed)
        method = DEFAULT_METHOD if form == "clean" else "uint8_float16_stripped"
        self.bodies = [encode_cloud(random_cloud(rng, N_ANCHORS), method) for _ in range(8)]
        self.n_asked = 0

    async def open(self):
        self.reader, self.writer = await asyncio.open_connection("127.0.0.1", self.port)
        if self.form == "clean":
            opened = await self._opened("/api/v3/sessions", {}, b'{"n_anchors": %d}' % N_ANCHORS)
            self.path = f"/api/v3/sessions/{opened['session']}/positions/vase"
            self.headers = {"Xihe-Token": opened["token"], "Xihe-Exposure": "0.5", "Xihe-Position": "1,2,3"}
            self.headers["Content-Type"] = content_type_of(DEFAULT_METHOD)
        else:
            opened = await self._opened("/api/v2/session/", {"Anchor-Size": str(N_ANCHORS)}, b"")
            self.path, self.headers = "/api/v2/lighting-estimation/", {"Session-ID": opened["sid"]}

    async def _opened(self, path, headers, body):
        _, answer = await self._exchange(path, headers, body)
        return json.loads(answer)

    async def ask(self):
        self.n_asked += 1
        status, _ = await self._exchange(self.path, self.headers, self.bodies[self.n_asked % len(self.bodies)])
        return status

    async def _exchange(self, path, headers, body):
        lines = [f"POST {path} HTTP/1.1", "Host: x", f"Content-Length: {len(body)}"]
        lines += [f"{name}: {value}" for name, value in headers.items()]
        self.writer.write("\r\n".join([*lines, "\r\n"]).encode() + body)
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


async def opened(port, n, first_seed=0, form="published"):
    clients = [Client(port, first_seed + number, form) for number in range(n)]
    for client in clients:
        await client.open()
    return clients


async def run(process, port, options):
    form, seconds = options.form, options.seconds
    clients = await opened(port, options.clients, 0, form)
    await hold_rate(clients, options.rate, 2)
    before = rss_mb(process)
    held = f"{options.clients} clients x {options.rate:g}/s for {seconds:g} s"
    print(f"{held}: {await hold_rate(clients, options.rate, seconds)}")
    print(f"memory of the server: {before:.1f} MB before, {rss_mb(process):.1f} MB after")
    more = await opened(port, 24, 100, form)
    spent_s = cpu_s(process.pid)
    capacity = await as_many_as_go(more, seconds / 4)
    n_lights = len(capacity.latencies_s) / capacity.seconds
    per_cpu_s = len(capacity.latencies_s) / (cpu_s(process.pid) - spent_s)
    print(f"as many as go, 24 clients: {capacity}; {per_cpu_s:.0f} lights per second of processor time")
    for client in [*clients, *more]:
        client.close()  # The first have waited longer than the server keeps a silent connection.
    many = await opened(port, MOST_CONNECTIONS, 200, form)
    twice = 2 * n_lights / len(many)
    print(f"twice that, {len(many)} clients: {await hold_rate(many, twice, seconds / 4)}")
    print(f"recovery: {await recovery_s(many[0]):.2f} s; memory {rss_mb(process):.1f} MB")
    for client in many:
        client.close()


def on_a_core_of_their_own():
    """Cores for the server and for the clients, this process; all for both where there is one alone."""
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, cores[1:] or cores)
    return set(cores[:1]), set(cores[1:] or cores)


def main():
    options = given(__doc__, seconds=60.0, clients=8, rate=30.0, estimator="lattice", form="published")
    print(f"load of the machine before: {Path('/proc/loadavg').read_text().split()[0]}")
    of_server, of_clients = on_a_core_of_their_own()
    os.sched_setaffinity(0, of_server)  # The server inherits it.
    command = [sys.executable, "-m", "xihe_blender", "serve", "--port", "0", "--estimator", options.estimator]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    os.sched_setaffinity(0, of_clients)
    try:
        port = int(re.search(r":(\d+),", process.stdout.readline())[1])
        asyncio.run(run(process, port, options))
        assert process.poll() is None, "the server is gone"
    finally:
        process.kill()
        process.wait()


if __name__ == "__main__":
    main()
