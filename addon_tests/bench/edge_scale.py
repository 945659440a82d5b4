"""The scale of the edge service: what would 100,000 phones take? From two workers with one Redis, measured.

    python addon_tests/bench/edge_scale.py [--seconds 10] [--rounds 3] [--clients 24] [--estimator lattice]

Clients of the published protocol, --clients of each worker, ask as soon as they have their answer. What counts is
processor time, with and without that of Redis, since clients, servers and Redis share the machine. Needs redis-server
on the path.
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

N_WORKERS = 2
PHONES, LIGHTS_A_MINUTE = 100_000, 27
"""For `docs/edge.md`: what the walks of `docs/trigger.md` ask for, at two frames a second."""


class Served:
    """A server process with its workers, and the figures of its rounds."""

    def __init__(self, options, store):
        command = [sys.executable, "-m", "xihe_blender", "serve", "--port", "0", *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.port = int(re.search(r":(\d+),", self.process.stdout.readline())[1])
        self.store, self.rounds = store, []

    def cpu_s(self):
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        return sum(cpu_s(pid) for pid in [self.process.pid, *children])

    async def measure(self, n_clients, seconds):
        clients = await opened(self.port, n_clients)
        await as_many_as_go(clients, 1)
        before_s, before = self.cpu_s(), self.store.statistics()
        answers = await as_many_as_go(clients, seconds)
        n, spent_s = len(answers.latencies_s), self.cpu_s() - before_s
        assert set(answers.statuses) == {200}, answers
        more = {name: value - before[name] for name, value in self.store.statistics().items()}
        figures = {"lights/s": n / answers.seconds, "lights per CPU s": n / spent_s}
        figures["with Redis"] = n / (spent_s + more.pop("CPU s"))
        self.rounds.append(figures | {f"{name} a light": value / n for name, value in more.items()})
        for client in clients:
            client.close()

    def median(self):
        return {name: np.median([one[name] for one in self.rounds]) for name in self.rounds[0]}


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
    """What many phones would take."""
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
        choices = ["--estimator", options.estimator, "--store", store.url, "--workers", str(N_WORKERS)]
        served = Served(choices, store)
        ending.callback(served.process.wait)
        ending.callback(served.process.terminate)
        for _ in range(options.rounds):
            asyncio.run(served.measure(options.clients * N_WORKERS, options.seconds))
        figures = served.median()
        print(", ".join(f"{value:.3g} {name}" for name, value in figures.items()))
        print_on_paper(figures, store.bytes_of_a_position())


if __name__ == "__main__":
    main()
