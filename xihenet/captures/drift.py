"""Drift of the phone's exposure and white balance: by how much? What is seen again in another frame tells.

Phones adapt both from frame to frame and seldom say so: a wall becomes darker because a window came into view. Points
of earlier frames are projected into each new one. Where the depth agrees it is the same surface, and the ratio of its
linear colours is the ratio of the two frames' gains. Each pair of frames gives the weighted median of the ratios of
each channel, and `gain_graph` the gains that fit all pairs. Pictures are 8-bit and clipped: pixels with a channel near
black or white know no ratio and are left out, as are edges of depth, where colours are mixed.

Chosen: each frame is held against the one before it and against a few keyframes, some of them the oldest that still
show the same place, so that errors do not add up along a walk. Keyframes are thinned points, some 36 kB each; no
picture is kept. Rejected: ratios of whole pictures' brightness, which follow what is in view; only frames next to each
other, whose errors add up.

A lamp that changes most of what is seen again changes its light as an exposure would: the gains follow it, and no
picture could tell them apart. One that changes less than half leaves the median where it was, and a larger residual.
Gloss and vignetting are taken to be small. An exposure that a file does give (`RgbdFrame.exposure`) is not divided out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from xihenet.camera import pixels_in_view, unproject_frame
from xihenet.captures.capture import Capture
from xihenet.captures.gain_graph import Pair, solve_gains
from xihenet.captures.seen_again import away_from_edges, thinned
from xihenet.colour import LINEAR_OF_CODE, in_any_channel
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt, ArrayU8, RgbdFrame

DARKEST_CODE, BRIGHTEST_CODE = 12, 244  # Of 255. Below, one step is more than 9 % of the light; above, noise clips
MOST_POINTS = 1500  # Of a keyframe
N_PROBES = 64  # Of these, projected into each frame to learn which keyframes it shows
MOST_KEYFRAMES = 300  # 11 MB; of more the one that was out of view for the longest is dropped
SAME_DEPTH = 0.04  # Share by which a point may miss the measured plane depth and still be of that surface
FEWEST_COUNTED, LEAST_WEIGHT = 15, 1e-6  # Points by their weight, as if all had one; so that none is without
FEWEST_SAMPLES = 40  # Points that a pair needs, to tell its ratio to a few per cent
N_NEAREST, N_OLDEST = 3, 2  # Keyframes that a frame is held against: those it shows most of, and those seen first
ENOUGH_SHOWN = 0.5  # A frame that shows less than this share of every keyframe becomes one
SOME_SHOWN = 0.1
SURE_TO = 0.003  # A pair's ratio is not trusted further, however many points it has; natural logarithm
# Sheen and gloss change with the angle from which a surface is seen. Of nine rendered rooms with a locked exposure the
# gains were off by 3.5 % in the mean, 32 % at most, where all angles counted alike; so by 1.9 %, 10 % at most.
SAME_ANGLE_DEG = 20.0
UNSURE_BY_DEG = 0.005  # Natural logarithm, for each degree between the two views of a pair's points
LOG_LINEAR = np.log(np.maximum(LINEAR_OF_CODE, 1e-6))
"""(256,) of the linear light of each code."""


@dataclass(frozen=True, eq=False)
class Drift:
    """Gains of a session of N frames: linear colour in a frame = gain * that under the reference frame's exposure and
    white balance. The reference is the first frame whose colours can be read, and its gain 1; so is that of all
    frames if there is none.

    Parameters
    ----------
    frames : (N,) numbers of the frames
    gains : (N, 3) float64, positive, linear R, G, B; of a frame that is not known that of the known one nearest in time
    is_known : (N,) bool, whether surfaces seen again tie the frame to the reference
    n_samples : (N,) points that the frame shares with those it was held against; 0 for none
    residual : (N,) how far the frame's pairs are from the gains, root mean square of natural logarithms; NaN for none
    """

    frames: ArrayInt
    gains: ArrayF64
    is_known: ArrayBool
    n_samples: ArrayInt
    residual: ArrayF64

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def n_unknown(self) -> int:
        """Frames that nothing ties to the reference."""
        return int(np.count_nonzero(~self.is_known))


@dataclass(eq=False)
class _Seen:
    """Points of a frame whose colours can be read."""

    index: int  # of the frame, in the order of the session
    points_m: ArrayF32 | ArrayF64  # (K, 3) world
    codes: ArrayU8  # (K, 3)
    camera_m: ArrayF64  # (3,) world, from where they were seen
    shown_at: int  # index of the last frame that showed it

    def __post_init__(self) -> None:
        self.probes_m = self.points_m[thinned(np.arange(len(self.points_m)), N_PROBES)]


class DriftFollower:
    """Takes the frames of a session one by one, in order, and says at any time how they drifted so far.

    Keeps at most MOST_KEYFRAMES keyframes, and some 500 bytes for each of the up to 6 pairs of a frame: 10,000 frames
    of 256x192 around one room took 26 MB.
    """

    def __init__(self) -> None:
        self._frames: list[int] = []
        self._times_s: list[float] = []
        self._keyframes: list[_Seen] = []
        self._before: _Seen | None = None
        self._pairs: list[Pair] = []
        self._reference: int | None = None

    def add(self, frame: RgbdFrame) -> None:
        """The next frame, of any size; ValueError for a pose that cannot be inverted."""
        index = len(self._frames)
        self._frames.append(frame.frame)
        self._times_s.append(frame.time_s)
        is_readable = _readable(frame)
        pixels = thinned(np.flatnonzero(is_readable), MOST_POINTS)
        if len(pixels) < FEWEST_SAMPLES:
            return
        if self._reference is None:
            self._reference = index
        points_m = unproject_frame(frame).points_m[pixels]
        seen = _Seen(index, points_m, frame.srgb_u8.reshape(-1, 3)[pixels], frame.world_from_camera[:3, 3], index)
        shown = self._shown(frame, is_readable)
        n_before = len(self._pairs)
        for known in self._to_compare(shown):
            pair = _compared(known, frame, is_readable, index)
            if pair is not None:
                known.shown_at = index
                self._pairs.append(pair)
        is_tied = len(self._pairs) > n_before
        if not is_tied or shown.max(initial=0.0) < ENOUGH_SHOWN:
            self._keep(seen)
        self._before = seen

    def drift(self) -> Drift:
        """Of all frames so far; empty for none."""
        n = len(self._frames)
        logs, is_known, residual = solve_gains(n, self._pairs, self._reference or 0)
        n_samples = np.zeros(n, np.intp)
        for pair in self._pairs:
            n_samples[pair.later] += pair.n_samples
            n_samples[pair.earlier] += pair.n_samples
        known = np.flatnonzero(is_known)
        times_s = np.array(self._times_s)
        for index in np.flatnonzero(~is_known):
            # Frames of files without times all have the same one: then the nearest in order.
            apart = np.abs(times_s[known] - times_s[index])
            logs[index] = logs[known[np.lexsort((np.abs(known - index), apart))[0]]]
        return Drift(np.array(self._frames, np.intp), np.exp(logs), is_known, n_samples, residual)

    def _shown(self, frame: RgbdFrame, is_readable: ArrayBool) -> ArrayF64:
        """(number of keyframes,) the share of each that the frame shows, by a few of its points."""
        if not self._keyframes:
            return np.zeros(0)
        probes = [known.probes_m for known in self._keyframes]
        owner = np.repeat(np.arange(len(probes)), [len(points) for points in probes])
        again, _ = _same_surface(np.concatenate(probes), frame, is_readable)
        return np.bincount(owner[again], minlength=len(probes)) / np.bincount(owner)

    def _to_compare(self, shown: ArrayF64) -> list[_Seen]:
        """The frame before, and a few keyframes; none twice."""
        enough = np.flatnonzero(shown >= SOME_SHOWN)
        nearest = enough[np.argsort(-shown[enough], kind="stable")[:N_NEAREST]]
        asked = {known.index: known for known in (self._keyframes[i] for i in (*nearest, *enough[:N_OLDEST]))}
        if self._before is not None:
            asked[self._before.index] = self._before
        return list(asked.values())

    def _keep(self, seen: _Seen) -> None:
        self._keyframes.append(seen)
        if len(self._keyframes) > MOST_KEYFRAMES:
            # The first of all stays: what is held against it is held against the reference itself.
            del self._keyframes[1 + int(np.argmin([known.shown_at for known in self._keyframes[1:]]))]


def follow_drift(frames: Iterable[RgbdFrame]) -> Drift:
    """Of a whole session, whose frames are asked for one by one and in order."""
    follower = DriftFollower()
    for frame in frames:
        follower.add(frame)
    return follower.drift()


def steadied(capture: Capture) -> tuple[Capture, Drift]:
    """The recording with the drift of its exposure and white balance in `RgbdFrame.white_balance` and taken out of
    `RgbdFrame.ambient`, and that drift.

    Every frame is read for it. Raises as `CapturedFrame.read`.
    """
    drift = follow_drift(capture)
    frames = [frame.changed(partial(_with, gains)) for frame, gains in zip(capture.frames, drift.gains, strict=True)]
    return replace(capture, frames=frames), drift


def _with(gains: ArrayF64, read: RgbdFrame) -> RgbdFrame:
    white_balance = gains if read.white_balance is None else read.white_balance * gains
    # Where a file does not give its exposure, the light sensor's reading is the mean of the picture.
    ambient = None if read.ambient is None else read.ambient / gains
    return replace(read, white_balance=white_balance, ambient=ambient)


def _readable(frame: RgbdFrame) -> ArrayBool:
    """(H, W) where the depth is known and no edge, and no channel is near black or white."""
    is_extreme = (frame.srgb_u8 < DARKEST_CODE) | (frame.srgb_u8 > BRIGHTEST_CODE)
    return away_from_edges(frame.plane_depth_m) & ~in_any_channel(is_extreme)[..., 0]


def _same_surface(points_m: ArrayF32 | ArrayF64, frame: RgbdFrame, is_readable: ArrayBool) -> tuple[ArrayInt, ArrayInt]:
    """Which of points (P, 3) the frame shows where it is readable, and in which pixel each."""
    points, pixels, expected_m = pixels_in_view(points_m, frame.intrinsics, frame.world_from_camera)
    measured_m = frame.plane_depth_m.ravel()[pixels]
    is_same = is_readable.ravel()[pixels]
    is_same[is_same] = np.abs(expected_m - measured_m)[is_same] < SAME_DEPTH * measured_m[is_same]
    return points[is_same], pixels[is_same]


def _compared(known: _Seen, frame: RgbdFrame, is_readable: ArrayBool, index: int) -> Pair | None:
    """The ratio of a frame's colours to those of an earlier one; None where too few surfaces are in both."""
    points, pixels = _same_surface(known.points_m, frame, is_readable)
    n = len(points)
    if n < FEWEST_SAMPLES:
        return None
    before, after = known.codes[points], frame.srgb_u8.reshape(-1, 3)[pixels]
    ratios = LOG_LINEAR[after] - LOG_LINEAR[before]
    # A step of a code is some 2.4 / (code + 14) of the light, by the derivative of the sRGB curve.
    weights = (np.minimum(before, after) + 14.0) ** 2
    apart_deg = _angles_deg(known.points_m[points], known.camera_m, frame.world_from_camera[:3, 3])
    weights *= (np.exp(-((apart_deg / SAME_ANGLE_DEG) ** 2)) + LEAST_WEIGHT)[:, None]
    n_counted = (weights.sum(axis=0) ** 2 / (weights**2).sum(axis=0)).min()
    if n_counted < FEWEST_COUNTED:
        return None
    middle = _weighted_median(ratios, weights)
    spread = 1.4826 * _weighted_median(np.abs(ratios - middle), weights)
    # Of a normal distribution: 1.4826 makes a deviation of a median one, and a median's error is 1.2533 of a mean's.
    unsure_by = UNSURE_BY_DEG * float(np.average(apart_deg, weights=weights[:, 0]))
    sure_to = np.hypot(np.hypot(1.2533 * spread / np.sqrt(n_counted), SURE_TO), unsure_by)
    return Pair(known.index, index, middle, sure_to, n)


def _angles_deg(points_m: ArrayF32 | ArrayF64, first_m: ArrayF64, second_m: ArrayF64) -> ArrayF64:
    """(K,) between the directions from points (K, 3) to two cameras, degrees."""
    towards = [place_m - points_m.astype(np.float64) for place_m in (first_m, second_m)]
    lengths = [np.linalg.norm(one, axis=1).clip(1e-9) for one in towards]
    cosine = np.einsum("kc,kc->k", *towards) / (lengths[0] * lengths[1])
    return np.degrees(np.arccos(cosine.clip(-1, 1)))


def _weighted_median(values: ArrayF64, weights: ArrayF64) -> ArrayF64:
    """(C,) of values (K, C) with weights (K, C), of which none is negative and some are not 0."""
    medians = []
    for of_channel, weight in zip(values.T, weights.T, strict=True):
        order = np.argsort(of_channel)
        summed = np.cumsum(weight[order])
        medians.append(of_channel[order[np.searchsorted(summed, summed[-1] / 2)]])
    return np.array(medians)
