"""What a recording says of itself, before its light is asked for: were its conventions read rightly, did it drift?"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from xihenet.captures.capture import Capture
from xihenet.captures.conventions import suspect
from xihenet.captures.drift import Drift, follow_drift
from xihenet.captures.self_fit import MOST_FRAMES
from xihenet.records import ArrayF64, RgbdFrame


def suspicion(capture: Capture) -> str | None:
    """A sentence where another convention fits the recording better by far, from some of its frames; else None.

    Raises as `CapturedFrame.read`.
    """
    n = len(capture.frames)
    chosen = np.unique(np.linspace(0, n - 1, min(n, MOST_FRAMES)).astype(int))
    frames = (capture.frames[k].read() for k in chosen)
    found = suspect(frames, blender_from_file=capture.blender_from_file, is_opencv=capture.is_opencv)
    return None if found is None else found.sentence


def steadied(capture: Capture) -> tuple[Capture, Drift]:
    """The recording with the drift of its exposure and white balance in `RgbdFrame.white_balance`, and that drift.

    Every frame is read once for it. Raises as `CapturedFrame.read`.
    """
    drift = follow_drift(capture)
    frames = [frame.changed(partial(_with, gains)) for frame, gains in zip(capture.frames, drift.gains, strict=True)]
    return replace(capture, frames=frames), drift


def _with(gains: ArrayF64, read: RgbdFrame) -> RgbdFrame:
    return replace(read, white_balance=gains if read.white_balance is None else read.white_balance * gains)
