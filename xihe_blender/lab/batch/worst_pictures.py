"""Which pictures does a unit keep? Those of each trial's worst compared frame, by names that the report knows too."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

WORST_KINDS = ("ground_truth", "estimate", "error")


def worst_picture(folder: Path, trial: int, kind: str) -> Path:
    """Where the picture of a trial's worst frame is: one of WORST_KINDS; trials go by number."""
    return folder / f"worst_{trial}_{kind}.png"


def worst_frame(metrics: Mapping[int, Mapping[str, float | None]]) -> int | None:
    """The frame with the lowest psnr, which is on the colours that are shown; the earliest of equals, None without."""
    known = {frame: psnr for frame, of_frame in metrics.items() if (psnr := of_frame["psnr"]) is not None}
    return min(sorted(known), key=lambda frame: known[frame], default=None)
