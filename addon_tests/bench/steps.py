"""Steps of the chain: what does one cost, without rendering? A table against the budget.

    python addon_tests/bench/steps.py [--repeats 50]

One synthetic frame of 256x192 points in a furnished box, 1280 anchors. Stages are timed one by one, then whole steps
for one and for four probes, with a key light, and with reflections besides, interleaved, so that the machine's drift
hits all alike; and the search for the surfaces that catch a shadow, once for each object and compared picture. Prints
minimum and median, and what patches cost: unprojecting and sampling with them over the same without, minimum over
minimum of interleaved repetitions. On 2026-11-22, on a busy machine: 1.3 to 1.4 here, and 1.5 to 1.7 in eight views of
two furnished scenes.
"""

from __future__ import annotations

import itertools
import statistics
from dataclasses import replace

import numpy as np
from given import given
from interleaved import interleaved_ms

from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.buffers import PositionBuffers
from xihenet.camera import unproject_frame
from xihenet.camera_path.surfaces import points_within, surfaces_around
from xihenet.codec import encode_cloud
from xihenet.controller import ControllerSettings, XiheController
from xihenet.light_change import LightFollowing, follow_light
from xihenet.records import Intrinsics, RgbdFrame, TriggerDecision
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice
from xihenet.trigger import LastSeen, TriggerSettings, decide_trigger

CAMERA = Intrinsics(256, 192, 200.0, 200.0, 128.0, 96.0)
PROBES = [(0.0, 2.0, 0.0), (0.3, 2.2, 0.1), (-0.3, 1.8, -0.1), (0.2, 2.5, 0.2)]
ABOVE_FLOOR = (0.0, 2.5, -1.4)
BUDGET_MS = {"unproject + sample": 4.0, "merge + trigger + encode": 0.5, "whole step, 1 probe": 6.0}


def frame_of_a_box(seed: int, noise: float = 0.03) -> RgbdFrame:
    """The inside of a 4 x 6 x 3 m box, its walls up to `noise` nearer, seen from the middle of a short side."""
    rng = np.random.default_rng(seed)
    x = (np.arange(256) + 0.5 - CAMERA.cx) / CAMERA.fx
    y = (np.arange(192) + 0.5 - CAMERA.cy)[:, None] / CAMERA.fy
    reach = np.minimum(np.minimum(2.0 / np.abs(x), 1.5 / np.abs(y)), 5.5) * rng.uniform(1 - noise, 1.0, (192, 256))
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    colours = rng.integers(0, 256, (192, 256, 3), dtype=np.uint8)
    return RgbdFrame(colours, reach, CAMERA, pose, ambient=[0.4, 0.4, 0.4])


def cost_of_patches(
    frame: RgbdFrame, position: tuple[float, float, float], lattice: AnchorLattice, repeats: int
) -> float:
    """Time of unprojecting and sampling with patches over that without: minima of interleaved repetitions."""

    def sampled(has_patches: bool) -> object:
        cloud = unproject_frame(frame)
        return sample_unit_sphere(cloud if has_patches else replace(cloud, grid=None), position, lattice)

    ms = interleaved_ms({"with": lambda: sampled(True), "without": lambda: sampled(False)}, repeats)
    return min(ms["with"]) / min(ms["without"])


def main() -> None:
    repeats = given(__doc__, repeats=50).repeats
    lattice, settings = AnchorLattice(1280), TriggerSettings()
    frames = [frame_of_a_box(seed) for seed in range(2)]
    points = unproject_frame(frames[0])
    cloud, other = (sample_unit_sphere(unproject_frame(f), PROBES[0], lattice) for f in frames)
    buffers = PositionBuffers.empty(1280).with_frame(cloud).fired()
    projection = estimators.load("projection")

    def whole(n_probes: int, **parts: bool) -> XiheController:
        # Theta 0: every step fires, so every step pays for all stages.
        controller = XiheController(LocalBackend(projection), ControllerSettings(TriggerSettings(theta=0.0), **parts))
        for k, position in enumerate(PROBES[:n_probes]):
            controller.add_position(f"probe {k}", position)
        return controller

    def trigger() -> TriggerDecision:
        seen = LastSeen(buffers.last_seen(), other)
        return decide_trigger(buffers.persistent, other, lattice, settings, last_seen=seen)

    with_key, with_all = whole(1, has_key_light=True), whole(1, has_key_light=True, has_reflections=True)
    around, twelve = np.array([0.0, 2.0, -1.4]), [frame_of_a_box(seed) for seed in range(12)]
    one, four, following, turn = whole(1), whole(4), LightFollowing(), itertools.count()
    candidates = {
        "unproject": lambda: unproject_frame(frames[0]),
        "sample": lambda: sample_unit_sphere(points, PROBES[0], lattice),
        "unproject + sample": lambda: sample_unit_sphere(unproject_frame(frames[0]), PROBES[0], lattice),
        "merge": lambda: buffers.with_frame(other),
        "trigger": trigger,
        "encode": lambda: encode_cloud(cloud),
        "follow the light, at triggers": lambda: [
            follow_light(kept, other, following) for kept in (buffers.temporary, buffers.persistent)
        ],
        "merge + trigger + encode": lambda: (buffers.with_frame(other), trigger(), encode_cloud(cloud)),
        "estimate, projection": lambda: projection.estimate(cloud),
        "whole step, 1 probe": lambda: one.step(frames[next(turn) % 2]),
        "whole step, 4 probes": lambda: four.step(frames[next(turn) % 2]),
        "whole step, key light": lambda: with_key.step(frames[next(turn) % 2]),
        "whole step, reflections too": lambda: with_all.step(frames[next(turn) % 2]),
        "surfaces for a shadow": lambda: surfaces_around(*points_within(twelve, around, 0.6), around, 0.6),
    }
    print(f"{'256x192 points, 1280 anchors':<28}{'min ms':>9}{'median':>9}{'budget':>9}")
    medians = {}
    for name, ms in interleaved_ms(candidates, repeats).items():
        medians[name] = statistics.median(ms)
        limit = f"{BUDGET_MS[name]:9.1f}" if name in BUDGET_MS else " " * 9
        print(f"{name:<28}{min(ms):9.3f}{medians[name]:9.3f}{limit}")
    on_a_floor = frame_of_a_box(0, noise=0.0)
    for where, frame, at in (("amid noise", frames[0], PROBES[0]), ("above a floor", on_a_floor, ABOVE_FLOOR)):
        ratio = cost_of_patches(frame, at, lattice, 4 * repeats)
        print(f"unproject + sample with patches / without, {where}: {ratio:.2f} (aim 1.25)")
    first = medians["whole step, 1 probe"]
    further = (medians["whole step, 4 probes"] - first) / 3
    print(f"each further probe costs {further:.3f} ms, {further / first:.2f} of the first (budget 0.5)")


if __name__ == "__main__":
    main()
