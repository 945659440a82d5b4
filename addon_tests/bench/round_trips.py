"""Round trips: what does another layout cost the light of a recording? Each is written, read again and replayed.

    xihe record ROOM.blend --out ROOM --truth
    python addon_tests/bench/round_trips.py ROOM

For each layout the largest error of depth, in how many of the session's steps its trigger decides as for the session
itself, and how far the light in use is from that of the session, as a share of it: mean and median over frames and
places. Then the same against the session whose depth alone was rounded as the layout rounds it: what writing and
reading lose beside that. The first row is the session with depth a ten-thousandth longer, which no sensor could tell.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from given import given

from xihenet import estimators
from xihenet.captures import open_capture
from xihenet.captures.capture import Capture
from xihenet.captures.replay import REPLAY_TRIGGER, ReplayedStep, never_in_view, replay
from xihenet.captures.writing import WRITERS
from xihenet.records import ArrayF64, RgbdFrame

STEPS_A_METRE = {"nerfstudio": 1000, "stray": 1000, "tum": 5000}
"""Of the layouts whose depth is whole numbers of 16 bits."""


def steps(
    frames: Iterable[RgbdFrame], capture: Capture, at_m: dict[str, ArrayF64], exposure: float | None
) -> list[ReplayedStep]:
    network = estimators.load("lattice", target="hdr")
    unseen = never_in_view(capture, at_m)
    return list(
        replay(frames, at_m, network, trigger=REPLAY_TRIGGER, reference_exposure=exposure, never_in_view=unseen)
    )


def steps_alike(first: list[ReplayedStep], second: list[ReplayedStep]) -> str:
    """The share in which the same positions trigger."""
    fired = [[{name for name, r in one.reports.items() if r.decision.fire} for one in some] for some in (first, second)]
    return f"{np.mean([one == other for one, other in zip(*fired, strict=True)]):.1%}"


def difference(first: list[ReplayedStep], second: list[ReplayedStep], gain: float = 1.0) -> str:
    """Of the light, mean and median, as two cells."""
    shares = []
    for one, other in zip(first, second, strict=True):
        for name in one.lights.keys() & other.lights.keys():
            sh = one.lights[name].sh
            shares.append(np.linalg.norm(other.lights[name].sh * gain - sh) / np.linalg.norm(sh))
    return f"{np.mean(shares):.2%} | {np.median(shares):.2%}"


def rounded(frames: list[RgbdFrame], layout: str) -> list[RgbdFrame]:
    """The same frames with depth as the layout can say it: rounded, and none beyond its last number."""
    a_metre = STEPS_A_METRE.get(layout)
    if a_metre is None:
        return frames
    whole = [np.rint(frame.plane_depth_m.astype(np.float64) * a_metre) for frame in frames]
    depths = [np.where(steps < 2**16, steps / a_metre, 0).astype(np.float32) for steps in whole]
    return [replace(frame, plane_depth_m=depth) for frame, depth in zip(frames, depths, strict=True)]


def main() -> None:
    folder = given(__doc__, "room").room
    content = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    at_m = {one["name"]: np.array(one["position_m"]) for one in content["places"]}
    ours = open_capture(folder)
    frames = list(ours)
    first = steps(frames, ours, at_m, ours.reference_exposure)
    print(
        "| layout | pixels without depth | depth off by, mm | steps that trigger alike | light off by, mean | median "
        "| off from rounded depth, mean | median |\n|" + " --- |" * 8
    )
    longer = [replace(frame, plane_depth_m=frame.plane_depth_m * np.float32(1.0001)) for frame in frames]
    again = steps(longer, ours, at_m, ours.reference_exposure)
    print(f"| depth 0.01 % longer | 0 | | {steps_alike(first, again)} | {difference(first, again)} | | |", flush=True)
    for layout, write in WRITERS.items():
        with tempfile.TemporaryDirectory() as beside:
            path = Path(beside) / ("recording.r3d" if layout == "record3d" else "recording")
            n_unheld = write(path, frames).n_unheld
            theirs = open_capture(path)
            read = list(theirs)
        off_mm = 1e3 * max(
            float(np.abs(np.where(b.plane_depth_m > 0, b.plane_depth_m - a.plane_depth_m, 0)).max())
            for a, b in zip(frames, read, strict=True)
        )
        # Their frames say no exposure: 1 stands for that of the session.
        again = steps(read, theirs, at_m, 1.0)
        gain = (ours.reference_exposure or 1.0) / frames[0].exposure
        of_rounded = steps(rounded(frames, layout), ours, at_m, ours.reference_exposure)
        print(
            f"| {layout} | {n_unheld} | {off_mm:.2f} | {steps_alike(first, again)} | {difference(first, again, gain)} "
            f"| {difference(of_rounded, again, gain)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
