"""Searches for input that breaks a reader, a numerical stage or the service: `python addon_tests/fuzz.py --minutes 60`.

The property tests of any bytes and of any input run in rounds, each with a seed of its own and more examples than in
the tests, until the time is up or a round has found something. A finding is shown with its seed and its example, bytes
that break a reader are kept in `addon_tests/data/corpus`, where the tests read them again, and the exit status is 1.

One edge service gets the requests of all rounds; that it ends, logs a fault or grows is a finding as well.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parents[1]
CORPUS = ROOT / "addon_tests" / "data" / "corpus"
NAMES = ("any_bytes", "any_input", "codec", "edge_protocol", "edge_any_request")
TESTS = [f"addon_tests/pure/test_{name}.py" for name in NAMES]

FUZZED_SERVICE = "XIHE_FUZZED_SERVICE"
"""Environment variable with the port of the edge service that one search sends all its requests to."""
MOST_GROWTH = 1.5
"""Of the service's memory, from the end of the first round on."""
FAULT = re.compile(r'.*("fault"|Traceback|Uncaught|Warning).*')
"""A line that the service must not log, whatever arrives."""

settings.register_profile(
    "search", max_examples=200, deadline=None, database=None, suppress_health_check=list(HealthCheck)
)


def some_examples(n: int = 30) -> settings:
    """Of a test: those of the search while it runs, else `n`, the same in every run."""
    if is_searching():
        return settings()
    return settings(max_examples=n, derandomize=True, suppress_health_check=list(HealthCheck))


def is_searching() -> bool:
    return settings().max_examples == settings.get_profile("search").max_examples


@contextmanager
def kept_where_it_breaks(name: str, content: bytes) -> Iterator[None]:
    """While searching: bytes that break the block are kept, those that break it last, which are the smallest."""
    try:
        yield
    except Exception:
        if is_searching():
            (CORPUS / f"{name}-found.bin").write_bytes(content)
        raise


def name_findings() -> None:
    """By what is in them, so that the next finding does not take their place."""
    for file in CORPUS.glob("*-found.bin"):
        file.rename(file.with_stem(file.stem.replace("found", hashlib.sha256(file.read_bytes()).hexdigest()[:8])))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60, help="how long to search (default 60)")
    parser.add_argument("--seed", type=int, default=0, help="of the first round; each round takes the next (default 0)")
    parser.add_argument("--only", default="", help="which tests: an expression as of pytest's -k (default all)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, service(Path(folder) / "log") as running:
        code, number = rounds(options, running)
    print(f"seeds {options.seed} to {number - 1}: {'something was found' if code else 'no finding'}")
    return code


def rounds(options: argparse.Namespace, running: Service) -> tuple[int, int]:
    """Until the time is up or something was found: the exit status, and the seed that would be next."""
    end, number, code, first_mb = time.time() + 60 * options.minutes, options.seed, 0, float("inf")
    while time.time() < end and not code:
        print(f"seed {number}", flush=True)
        chosen = ["--hypothesis-profile=search", f"--hypothesis-seed={number}", f"--until={end}"]
        chosen += ["-m", "hypothesis", "-k", options.only]
        # Else what hypothesis thinks of long examples is told in place of what one of them has found.
        chosen += ["-W", "ignore:Generating overly large repr"]
        environment = os.environ | {FUZZED_SERVICE: str(running.port)}
        command = [sys.executable, "-m", "pytest", "-q", *chosen, *TESTS]
        code = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
        name_findings()
        memory_mb, said = running.state()
        first_mb = min(first_mb, memory_mb)
        print(f"the edge service takes {memory_mb:.1f} MB and has logged {said or 'no fault'}", flush=True)
        if said or memory_mb > MOST_GROWTH * first_mb:
            code = 1
        number += 1
    return code, number


class Service(NamedTuple):
    """An edge service, and where it logs."""

    process: subprocess.Popen[str]
    port: int
    log: Path

    def state(self) -> tuple[float, str]:
        """Its memory, MB (NaN where there is no /proc), and the first fault in its log; ValueError if it has ended."""
        if self.process.poll() is not None:
            raise ValueError(f"the edge service has ended: {self.log.read_text()[-2000:]}")
        found, status = FAULT.search(self.log.read_text()), Path(f"/proc/{self.process.pid}/status")
        memory = re.search(r"VmRSS:\s+(\d+) kB", status.read_text()) if status.exists() else None
        return int(memory[1]) / 1024 if memory else float("nan"), found[0] if found else ""


@contextmanager
def service(log: Path) -> Iterator[Service]:
    """One that runs for the length of the block, and soon forgets."""
    command = [sys.executable, "-m", "xihe_blender", "serve", "--port", "0", "--expire", "30"]
    with log.open("w") as stderr:
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=stderr, text=True)
    try:
        assert process.stdout is not None
        port = re.search(r":(\d+),", process.stdout.readline())
        assert port, log.read_text()
        yield Service(process, int(port[1]), log)
    finally:
        process.kill()
        process.communicate()


if __name__ == "__main__":
    sys.exit(main())
