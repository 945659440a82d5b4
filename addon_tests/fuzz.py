"""Searches for input that breaks a reader or a numerical stage: `python addon_tests/fuzz.py --minutes 60`.

The property tests of any bytes and of any input run in rounds, each with a seed of its own and more examples than in
the tests, until the time is up or a round has found something. A finding is shown with its seed and its example, bytes
that break a reader are kept in `addon_tests/data/corpus`, where the tests read them again, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parents[1]
CORPUS = ROOT / "addon_tests" / "data" / "corpus"
TESTS = [f"addon_tests/pure/test_{name}.py" for name in ("any_bytes", "any_input", "codec")]

settings.register_profile(
    "search", max_examples=200, deadline=None, database=None, suppress_health_check=list(HealthCheck)
)


def some_examples() -> settings:
    """Of a test: those of the search while it runs, else a few, the same in every run."""
    if is_searching():
        return settings()
    return settings(max_examples=30, derandomize=True, suppress_health_check=list(HealthCheck))


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
    end, number, code = time.time() + 60 * options.minutes, options.seed, 0
    while time.time() < end and not code:
        print(f"seed {number}", flush=True)
        chosen = ["--hypothesis-profile=search", f"--hypothesis-seed={number}", f"--until={end}"]
        chosen += ["-m", "hypothesis", "-k", options.only]
        code = subprocess.run([sys.executable, "-m", "pytest", "-q", *chosen, *TESTS], cwd=ROOT, check=False).returncode
        name_findings()
        number += 1
    print(f"seeds {options.seed} to {number - 1}: {'something was found' if code else 'no finding'}")
    return code


if __name__ == "__main__":
    sys.exit(main())
