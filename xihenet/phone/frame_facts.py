"""Facts of a session as its frames show them, before the phone is simulated.

Perfect frames, few and small ones will do, give distances, edges, darkness, angles, motion and brightness. What no
picture shows (roughness, transmission, which lights are animated) the caller adds; what it leaves out stays not known,
and its effects stay on. Chosen: extremes over all pixels, so that a fact errs towards simulating.
A long session need not be held in memory: `facts_of_frame` as each frame comes, `facts_of_session` at the end.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from xihenet.camera import unproject_frame, valid_plane_depth
from xihenet.colour import LINEAR_OF_CODE
from xihenet.phone.depth import window_span_m
from xihenet.phone.depth_dropout import SurfaceFacts, facing_cosines
from xihenet.phone.metering import metered_exposure
from xihenet.phone.motion import turn_between
from xihenet.phone.settings import SessionFacts
from xihenet.records import ArrayF64, RgbdFrame

LEAST = ("nearest_m", "clearance_m", "darkest_grey")
MOST = ("focal_px", "farthest_m", "widest_step_m", "steepest_deg", "highest_transmission")
"""Facts of frames of which the smallest, or the largest, is that of the session."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameFacts(SessionFacts):
    """Those of LEAST and MOST, of one frame; a distance is None without valid plane depth, or without a position."""

    time_s: float
    world_from_camera: ArrayF64
    stops: float  # logarithm to base 2 of the exposure that the frame asks for


def facts_of_session(each: Sequence[FrameFacts], **known: Any) -> SessionFacts:
    """Facts of a session from those of its frames, in the order of their times; ValueError without any.

    Speed is the fastest even motion between two neighbouring frames; with one frame, or where two have the same time,
    frame rate and speed are not known. A distance that no frame has is not known. What is in `known` (further fields of
    SessionFacts) wins.
    """
    if not each:
        raise ValueError("facts_of_session: expected at least one frame, got none")
    stops = [facts.stops for facts in each]
    found: dict[str, Any] = {}
    for extreme, names in ((min, LEAST), (max, MOST)):
        for name in names:
            values = [getattr(facts, name) for facts in each]
            found[name] = extreme((value for value in values if value is not None), default=None)
    found |= {"duration_s": each[-1].time_s - each[0].time_s, "brightness_change_stops": max(stops) - min(stops)}
    return SessionFacts(**(found | _motion_facts(each) | known))


def _motion_facts(each: Sequence[FrameFacts]) -> dict[str, float]:
    steps_s = np.diff([facts.time_s for facts in each])
    if not len(steps_s) or steps_s.min() <= 0:
        return {}
    poses = [facts.world_from_camera for facts in each]
    moves_m = np.linalg.norm(np.diff([pose[:3, 3] for pose in poses], axis=0), axis=1)
    turns = np.degrees([turn_between(before, after)[0] for before, after in itertools.pairwise(poses)])
    return {
        "frame_rate_hz": float(1.0 / steps_s.min()),
        "fastest_m_per_s": float((moves_m / steps_s).max()),
        "fastest_turn_deg_per_s": float((turns / steps_s).max()),
    }


def facts_of_frame(frame: RgbdFrame, positions_m: ArrayLike) -> FrameFacts:
    """What one perfect frame says; `positions_m` (P, 3) are the estimation positions, world; P may be 0."""
    positions = np.asarray(positions_m, np.float64).reshape(-1, 3)
    valid = valid_plane_depth(frame.plane_depth_m)
    seen = frame.plane_depth_m[valid]
    facing = facing_cosines(frame, SurfaceFacts())[valid]
    radiance = (LINEAR_OF_CODE / frame.exposure)[frame.srgb_u8]
    return FrameFacts(
        time_s=frame.time_s,
        focal_px=max(frame.intrinsics.fx, frame.intrinsics.fy),
        world_from_camera=frame.world_from_camera,
        nearest_m=float(seen.min()) if seen.size else None,
        farthest_m=float(seen.max()) if seen.size else None,
        clearance_m=_clearance_m(frame, positions),
        widest_step_m=float(window_span_m(frame.plane_depth_m, 1).max()),
        steepest_deg=float(np.degrees(np.arccos(facing.min()))) if seen.size else 0.0,
        darkest_grey=float(frame.srgb_u8.mean(axis=2)[valid].min()) / 255 if seen.size else 1.0,
        stops=float(np.log2(metered_exposure([radiance], "key"))),
    )


def _clearance_m(frame: RgbdFrame, positions_m: ArrayF64) -> float | None:
    """From any position to the nearest point that the frame saw; None without either."""
    points = unproject_frame(frame).points_m.astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    nearest = (np.linalg.norm(points - position, axis=1).min() for position in positions_m if len(points))
    return min(map(float, nearest), default=None)
