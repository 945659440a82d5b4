"""What does each sensor effect of a phone do to the light that is estimated, and what does it cost?

    python addon_tests/bench/phone.py [--profiles ipad_pro_lidar,azure_kinect] [--rooms 16] [--seed 0]

The rooms that come with the tests: each of their views is a frame of a session, five a second after half a minute,
while the camera walks at 0.5 m/s and pans at 60 degrees a second; each room is a session with its own seed.
`projection` (for the light sensor `ambient`) estimates the light at each position from one view and from all views
merged; its SHC RMSE (target ldr) is compared with that of a perfect capture of the same frames. Change: mean and its
standard error, over (view, position) or positions. Stored rooms know neither roughness nor transmission, so glossy and
transparent surfaces make no holes here. Their plane depth is 16-bit (steps of 2 mm at 3 m).
"planned, not all" simulates in each room what it calls for; its change is against all of them, not a perfect capture.
Below: when estimates arrive over each link.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import time
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from xihenet import estimators
from xihenet.buffers import merge_in_sight
from xihenet.camera import sensed_ambient, unproject_frame
from xihenet.colour import srgb_to_linear
from xihenet.io.npz_files import read_npz
from xihenet.metrics import shc_rmse
from xihenet.phone import (
    LINKS,
    CameraMotion,
    PhoneCamera,
    PhoneProfile,
    arrival_frames,
    facts_of_frame,
    facts_of_session,
    load_profile,
)
from xihenet.phone.metering import metered_exposure
from xihenet.records import RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice
from xihenet.training.rooms import frames_of, room_files

ROOMS = Path(__file__).parents[1] / "data" / "test_rooms"
N_ANCHORS, START_S, INTERVAL_S = 1280, 30.0, 0.2
MOTION = CameraMotion(np.array([0.5, 0.0, 0.0]), np.array([0.0, 0.0, np.radians(60.0)]))


class Session(NamedTuple):
    """Frames of a room, its positions, which (view, position) count, and the true light (P, 9, 3)."""

    frames: list[RgbdFrame]
    positions_m: np.ndarray
    counts: np.ndarray
    truth: np.ndarray


class Scores(NamedTuple):
    """SHC RMSE of each (view, position) that counts and of each position; lost share of pixels and ms per frame."""

    one_view: np.ndarray
    merged: np.ndarray
    lost: float
    ms: float


def read_session(path: Path) -> Session:
    room, frames = read_npz(path), []
    for i, frame in enumerate(frames_of(room)):
        ambient = sensed_ambient(frame.srgb_u8, frame.exposure)
        frames.append(replace(frame, ambient=ambient, time_s=START_S + i * INTERVAL_S, frame=i))
    return Session(frames, room["positions_m"], room["is_in_view"], room["sh_ldr"])


def seen_by(camera: PhoneCamera, session: Session) -> tuple[list[RgbdFrame], float, float]:
    """The phone's frames, the share of pixels lost, and milliseconds per frame."""
    frames, reference = session.frames, session.frames[0].exposure
    metered = [metered_exposure([srgb_to_linear(f.srgb_u8 / 255.0).astype(np.float32) / reference]) for f in frames]
    light = np.array([f.ambient for f in frames])
    numbers, times_s = [f.frame for f in frames], [f.time_s for f in frames]
    track = camera.follow(numbers, times_s, metered=metered, ambient=light, reference=reference)
    start = time.perf_counter()
    pairs = [camera.see(f, motion=MOTION, track=track) for f in frames]
    ms = 1e3 * (time.perf_counter() - start) / len(frames)
    shares = [sum(n_lost.values()) / seen.plane_depth_m.size for seen, n_lost in pairs]
    return [f for f, _ in pairs], float(np.mean(shares)), ms


def planned(profile: PhoneProfile, session: Session) -> list[str]:
    """The effects that a session calls for; what stored rooms do not know is none (light, glossy, transparent)."""
    facts = facts_of_session(
        [facts_of_frame(frame, session.positions_m) for frame in session.frames],
        frame_rate_hz=1 / INTERVAL_S, duration_s=START_S,
        fastest_m_per_s=0.5, fastest_turn_deg_per_s=60.0, smoothest_roughness=1.0, highest_transmission=0.0,
        light_changes=False,
    )  # fmt: skip
    return [name for name, one in profile.required_effects(facts).items() if one.is_required]


def score(
    profile: PhoneProfile, seed: int, effects: Collection[str] | None, sessions: list[Session], estimator_name: str,
    *, is_planned: bool = False,
) -> Scores:  # fmt: skip
    """Of a phone with `effects`, or with those that each session calls for."""
    estimator, lattice = estimators.load(estimator_name, N_ANCHORS), AnchorLattice(N_ANCHORS)
    one_view, merged, lost, ms = [], [], [], []
    for number, session in enumerate(sessions):
        camera = PhoneCamera(
            profile, 1000 * seed + number, effects=planned(profile, session) if is_planned else effects
        )
        frames, lost_share, ms_per_frame = seen_by(camera, session)
        lost.append(lost_share)
        ms.append(ms_per_frame)
        reference = session.frames[0].exposure
        points = [unproject_frame(f, reference_exposure=reference) for f in frames]
        for p, position_m in enumerate(session.positions_m):
            cloud = UnitSphereCloud.empty(N_ANCHORS)
            for v in np.flatnonzero(session.counts[:, p]):
                context = estimators.EstimateContext(frame=frames[v], reference_exposure=reference)
                sampled = sample_unit_sphere(points[v], position_m, lattice)
                one_view.append(shc_rmse(estimator.estimate(sampled, context), session.truth[p]))
                cloud = merge_in_sight(cloud, sampled)
            if session.counts[:, p].any():
                merged.append(shc_rmse(estimator.estimate(cloud, context), session.truth[p]))
    return Scores(np.array(one_view), np.array(merged), float(np.mean(lost)), float(np.median(ms)))


def change(scores: np.ndarray, perfect: np.ndarray) -> str:
    difference = scores - perfect
    return f"{difference.mean():+9.5f} +-{difference.std(ddof=1) / np.sqrt(len(difference)):8.5f}"


def row(name: str, scores: Scores, perfect: Scores) -> None:
    print(
        f"{name:<20}{scores.one_view.mean():9.5f}{change(scores.one_view, perfect.one_view):>21}"
        f"{scores.merged.mean():10.5f}{change(scores.merged, perfect.merged):>21}{scores.lost:8.2%}{scores.ms:8.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--profiles", default="ipad_pro_lidar,azure_kinect")
    parser.add_argument("--rooms", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sessions = [read_session(path) for path in room_files(ROOMS)[: options.rooms]]
    for profile in map(load_profile, options.profiles.split(",")):
        print(f"\n{profile.name}, {len(sessions)} rooms, {N_ANCHORS} anchors, seed {options.seed}")
        print(f"{'SHC RMSE':<20}{'one view':>9}{'change':>21}{'merged':>10}{'change':>21}{'lost':>8}{'ms':>8}")
        for estimator in ("projection", "ambient"):
            perfect = score(profile, options.seed, (), sessions, estimator)
            row(f"{estimator}, perfect", perfect, perfect)
            alone = [e for e in profile.sections if (e == "light_sensor") == (estimator == "ambient")]
            for effect in [e for e in alone if e != "frame_rate"]:
                row(effect, score(profile, options.seed, {effect}, sessions, estimator), perfect)
            whole = score(profile, options.seed, None, sessions, estimator)
            row("all of them", whole, perfect)
            if estimator == "projection":
                row("planned, not all", score(profile, options.seed, None, sessions, estimator, is_planned=True), whole)
        on = [len(planned(profile, session)) for session in sessions]
        print(f"planned: {np.mean(on):.1f} of {len(profile.sections)} effects on, mean over rooms")
    print(f"\n{'link, 4,249 bytes':<20}{'median ms':>10}{'95 %':>9}{'99 %':>9}{'late':>8}{'lost':>10}")
    for name, link in LINKS.items():
        waits_s = arrival_frames(np.zeros(100_000), 4249, link, np.random.default_rng(options.seed))
        median, most, nearly_all = 1e3 * np.percentile(waits_s, [50, 95, 99])
        late = np.mean((waits_s > link.resend_s) & np.isfinite(waits_s))
        print(f"{name:<20}{median:10.1f}{most:9.1f}{nearly_all:9.1f}{late:8.2%}{np.mean(np.isinf(waits_s)):10.5%}")


if __name__ == "__main__":
    main()
