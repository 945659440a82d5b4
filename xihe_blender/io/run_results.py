"""What did a run leave that can be shown without it? The results.json of its folder, read back.

Read once and kept while the file is the same, since a panel asks at every redraw. Nothing here needs NumPy or Blender.
"""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

from xihe_blender.errors import UserError


def read_results(folder: Path) -> dict[str, Any]:
    """The results of the run in `folder`; they are shared, so leave them as they are.

    UserError if there are none, or none that this version wrote.
    """
    file = folder / "results.json"
    try:
        return _read(file, file.stat().st_mtime_ns)
    except OSError as error:
        raise UserError(f"{file} cannot be read ({error.strerror}): run again") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{file} is not from a run of this version: run again") from error


@functools.lru_cache(maxsize=2)
def _read(file: Path, _changed_ns: int) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    if content["schema_version"] != 1 or not content["lights"]:
        raise ValueError("another schema")
    return content


def compared_frames_of(results: dict[str, Any]) -> dict[int, dict[str, str]]:
    """Paths of the pictures, relative to the run's folder, by compared frame and kind."""
    return {entry["frame"]: entry["pictures"] for entry in results["frames"] if "comparison" in entry}


def nearest_compared_frame(results: dict[str, Any], frame: int) -> int | None:
    """The compared frame next to `frame`, the earlier of two equally near; None if none was compared."""
    return min(compared_frames_of(results), key=lambda compared: (abs(compared - frame), compared), default=None)


def trigger_frames(results: dict[str, Any]) -> list[int]:
    """The frames at which any position asked for an estimate, in order."""
    return [entry["frame"] for entry in results["frames"] if any(probe["fired"] for probe in entry["probes"])]
