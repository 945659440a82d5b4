"""Searches for input that breaks a reader or a numerical stage: `python addon_tests/fuzz.py --minutes 60`.

Every target in turn gets a round of examples from a seed of its own; seeds and counts are printed. A finding is printed
with its target and its seed, bytes are kept in `addon_tests/data/corpus`, and the exit status is 1. The tests try each
target shortly, and on every file of the corpus.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from hypothesis import HealthCheck, Phase, given, seed, settings

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from addon_tests.fuzz_readers import readers
from addon_tests.fuzz_stages import STAGES
from addon_tests.pure.hard_cases.random_payloads import taken_for_something_else
from xihenet.codec import METHODS

CORPUS = Path(__file__).with_name("data") / "corpus"
EXAMPLES_PER_ROUND = 200


def targets() -> dict[str, tuple[Any, Callable[[Any], object]]]:
    """Every target by name: its strategy, and the property that must hold."""
    return {**readers(), **STAGES}


def tried(strategy: Any, holds: Callable[[Any], object], number: int, n_examples: int) -> tuple[int, list[Any]]:
    """How many examples were tried from the seed `number`, and the last one; whatever breaks is raised, shrunk."""
    seen: list[Any] = [None]
    count = 0

    @seed(number)
    @settings(
        max_examples=n_examples,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.generate, Phase.shrink),
        print_blob=False,
        report_multiple_bugs=False,
    )
    @given(strategy)
    def search(example: Any) -> None:
        nonlocal count
        count, seen[0] = count + 1, example
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            holds(example)

    try:
        search()
    except BaseException as error:
        error.add_note(f"example: {seen[0]!r:.2000}")
        error.example = seen[0]  # type: ignore[attr-defined]
        raise
    return count, seen


def kept(name: str, content: bytes) -> Path:
    """The file of the corpus that holds this finding from now on."""
    CORPUS.mkdir(parents=True, exist_ok=True)
    path = CORPUS / f"{name}-{hashlib.sha256(content).hexdigest()[:8]}.bin"
    path.write_bytes(content)
    return path


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60, help="how long to search (default 60)")
    parser.add_argument("--seed", type=int, default=0, help="of the first round; each round takes the next (default 0)")
    parser.add_argument("--only", nargs="*", default=[], help="names of targets (default all)")
    parser.add_argument("--payloads", type=int, default=1_000_000, help="random payloads, besides (default 1,000,000)")
    options = parser.parse_args()
    say = partial(print, file=own_output(), flush=True)
    chosen = {name: target for name, target in targets().items() if not options.only or name in options.only}
    findings = wrong_payloads(options.payloads, options.seed, say)
    findings += search_until(time.monotonic() + 60 * options.minutes, chosen, options.seed, say)
    return min(findings, 1)


def own_output() -> TextIO:
    """Standard output for this script alone: OpenEXR prints a line on it for each file that it cannot read."""
    output = os.fdopen(os.dup(1), "w")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    return output


def wrong_payloads(n: int, number: int, say: Callable[..., None]) -> int:
    """Of `n` random payloads over all wire formats, how many are taken for something else; whatever else is raised."""
    wrong = sum(taken_for_something_else((n // len(METHODS), method), number) for method in METHODS)
    say(f"{n:,} random payloads, seed {number}: {wrong} taken for something else")
    return wrong


def search_until(end: float, chosen: dict[str, Any], first_seed: int, say: Callable[..., None]) -> int:
    """Rounds over the chosen targets until the clock says `end`; how many broke. One that broke is left out then."""
    counts, n_targets, number = dict.fromkeys(chosen, 0), len(chosen), first_seed
    while chosen and time.monotonic() < end:
        for name, (strategy, holds) in list(chosen.items()):
            try:
                counts[name] += tried(strategy, holds, number, EXAMPLES_PER_ROUND)[0]
            except Exception as error:  # noqa: BLE001  whatever comes is the finding
                del chosen[name]
                say(f"FINDING in {name}, seed {number}:\n{''.join(traceback.format_exception(error))}")
                if isinstance(example := getattr(error, "example", None), bytes):
                    say(f"kept as {kept(name, example)}")
            if time.monotonic() > end:
                break
        number += 1
    for name, count in counts.items():
        say(f"{name:32} {count:10,} examples")
    findings = n_targets - len(chosen)
    say(f"seeds {first_seed} to {number - 1}, {sum(counts.values()):,} examples, {findings} findings")
    return findings


if __name__ == "__main__":
    sys.exit(main())
