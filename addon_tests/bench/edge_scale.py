"""What sharing sessions costs: one server with sessions in memory, one with Redis, and two workers with Redis.

    python addon_tests/bench/edge_scale.py [--seconds 10] [--rounds 3] [--clients 24] [--estimator lattice]

The three take turns, round after round, so that a busy machine is busy for all. Clients of the published protocol ask
as soon as they have their answer, --clients of each worker. What counts is lights per second of processor time, with
and without that of Redis, since clients, servers and Redis share the machine. Needs redis-server on the path.
"""

import asyncio
import re
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import redis
from edge_load import as_many_as_go, cpu_s, opened
from given import given

PHONES, LIGHTS_A_MINUTE = 100_000, 27
"""For `docs/edge.md`: what the walks of `docs/trigger.md` ask for, at two frames a second."""


class Served:
    """A server process with its workers, and the totals of its rounds."""

    def __init__(self, name, options, store=None, n_workers=1):
        command = [sys.executable, "-m", "xihe_blender", "serve", "--port", "0", *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.port = int(re.search(r":(\d+),", self.process.stdout.readline())[1])
        self.name, self.store, self.n_workers, self.rounds = name, store, n_workers, []

    def cpu_s(self):
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        return sum(cpu_s(pid) for pid in [self.process.pid, *children])

    async def measure(self, n_clients, seconds):
        clients = await opened(self.port, n_clients * self.n_workers)
        await as_many_as_go(clients, 1)
        before = self.cpu_s(), self.store.told() if self.store else None
        answers = await as_many_as_go(clients, seconds)
        n, spent_s = len(answers.latencies_s), self.cpu_s() - before[0]
        assert set(answers.statuses) == {200}, answers
        figures = {"lights/s": n / answers.seconds, "lights per CPU s": n / spent_s, "with Redis": n / spent_s}
        if self.store:
            more = {name: value - before[1][name] for name, value in self.store.told().items()}
            figures["with Redis"] = n / (spent_s + more.pop("CPU s"))
            figures |= {f"{name} a light": value / n for name, value in more.items()}
        self.rounds.append(figures)
        for client in clients:
            client.close()

    def median(self):
        return {name: np.median([one[name] for one in self.rounds]) for name in self.rounds[0]}

    def __str__(self):
        return f"{self.name}: " + ", ".join(f"{value:.3g} {name}" for name, value in self.median().items())


class Store:
    """A Redis of its own, its append-only file on."""

    def __init__(self, folder):
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        command = ["redis-server", "--port", str(port), "--dir", folder, "--appendonly", "yes", "--save", ""]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        self.url, self.client = f"redis://127.0.0.1:{port}/0", redis.Redis(port=port)
        while True:
            try:
                self.client.ping()
                break
            except redis.ConnectionError:
                time.sleep(0.05)

    def told(self):
        info, calls = self.client.info(), self.client.info("commandstats")
        return {
            "CPU s": cpu_s(self.process.pid),
            "calls": calls.get("cmdstat_evalsha", {"calls": 0})["calls"],
            "bytes in": info["total_net_input_bytes"],
            "bytes out": info["total_net_output_bytes"],
            "bytes to the file": info["aof_current_size"],
        }

    def bytes_of_a_position(self):
        keys = self.client.keys("xihe:1:session:*")
        return np.mean([self.client.memory_usage(key, samples=0) for key in keys])


def print_on_paper(figures, bytes_of_a_position):
    """What many phones would take, from the figures of the two workers."""
    per_s, own_s = PHONES * LIGHTS_A_MINUTE / 60, 1 / figures["lights per CPU s"]
    redis_s = 1 / figures["with Redis"] - own_s
    print(f"a light: {1e3 * own_s:.2f} ms of a worker, {1e3 * redis_s:.2f} ms of Redis; one Redis {1 / redis_s:.0f}/s")
    print(
        f"{PHONES} phones, {per_s:.0f} lights/s: {per_s * own_s:.0f} cores of workers, {per_s * redis_s:.0f} of Redis, "
        f"{1e-6 * per_s * figures['bytes in a light']:.0f} MB/s to Redis, "
        f"{1e-9 * PHONES * bytes_of_a_position:.1f} GB in it ({bytes_of_a_position:.0f} bytes a phone)"
    )


def main():
    options = given(__doc__, seconds=10.0, rounds=3, clients=24, estimator="lattice")
    print(f"load of the machine before: {Path('/proc/loadavg').read_text().split()[0]}")
    with tempfile.TemporaryDirectory() as folder, ExitStack() as ending:
        store = Store(folder)
        ending.callback(store.process.wait)
        ending.callback(store.process.kill)
        choice = ["--estimator", options.estimator]
        servers = []
        for name, more, n_workers in [
            ("1 worker, in memory", [], 1),
            ("1 worker, Redis", ["--store", store.url], 1),
            ("2 workers, Redis", ["--store", store.url, "--workers", "2"], 2),
        ]:
            servers.append(Served(name, choice + more, store if more else None, n_workers))
            ending.callback(servers[-1].process.wait)
            ending.callback(servers[-1].process.terminate)
        for _ in range(options.rounds):
            for server in servers:
                asyncio.run(server.measure(options.clients, options.seconds))
        print(*servers, sep="\n")
        print_on_paper(servers[2].median(), store.bytes_of_a_position())
        for number, than in ((2, 1), (2, 0), (1, 0)):
            for figure in ("lights per CPU s", "with Redis"):
                ratios = [
                    a[figure] / b[figure] for a, b in zip(servers[number].rounds, servers[than].rounds, strict=True)
                ]
                rounds = ", ".join(f"{ratio:.2f}" for ratio in ratios)
                print(f"{servers[number].name} / {servers[than].name}, {figure}: {np.median(ratios):.2f} ({rounds})")


if __name__ == "__main__":
    main()
