"""How many frames a second does a replay take, reading included? A session of our own form, one position, no pictures.

    xihe record ROOM.blend --out ROOM --truth
    python addon_tests/bench/replay.py ROOM

The first place whose true light was recorded is asked about, by the shipped network and with its key light, on 100
frames: those of the session one after the other, again from the first after the last. The best and the median of five
turns, how much of a frame's time each stage takes, and in how many frames the camera sees the place.
"""

from __future__ import annotations

import itertools
import json
import statistics
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from xihenet import estimators
from xihenet.captures import open_capture
from xihenet.recording import SessionRecorder
from xihenet.replay import REPLAY_TRIGGER, replay

N_FRAMES, TURNS = 100, 5


def main() -> None:
    folder = Path(sys.argv[1])
    recorded = open_capture(folder)
    place = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["places"][0]
    at_m = {place["name"]: np.array(place["position_m"])}
    network = estimators.load("lattice", target="hdr")
    with tempfile.TemporaryDirectory() as beside:
        recorder = SessionRecorder(Path(beside))
        for number, frame in zip(range(N_FRAMES), itertools.cycle(recorded), strict=False):
            recorder.record(replace(frame, frame=number, time_s=number / 30))
        session, seconds = open_capture(Path(beside)), []
        trigger = recorded.trigger or REPLAY_TRIGGER
        for _ in range(TURNS + 1):  # The first one builds tables, and does not count.
            start = time.perf_counter()
            steps = list(replay(session, at_m, network, trigger=trigger, has_key_light=True))
            seconds.append(time.perf_counter() - start)
    reports = [step.reports[place["name"]] for step in steps if place["name"] in step.reports]
    best, median = (N_FRAMES / pick(seconds[1:]) for pick in (min, statistics.median))
    stages = {name: statistics.mean(one.stage_ms.get(name, 0) for one in reports) for name in reports[0].stage_ms}
    size = "x".join(map(str, reversed(frame.plane_depth_m.shape)))
    print(
        f"{N_FRAMES} frames of {size}: {best:.0f} frames a second, {median:.0f} in the median of {TURNS}; "
        f"{place['name']} in view in {len(reports)}, {sum(one.decision.fire for one in reports)} estimates; "
        + ", ".join(f"{name} {ms:.2f} ms" for name, ms in stages.items())
    )


if __name__ == "__main__":
    main()
