"""OpenEXR files in forms that `exr` does not read, through the OpenEXR package: in a process of its own.

In a whole Blender the package must not be imported: its library has the names of the one that Blender brings, and the
two mixed up end the process (seen with OpenEXR 3.5.3 in Blender 4.3.2, on reading and on writing). The Python beside
Blender has no such library. Rejected: loading it with RTLD_DEEPBIND, which ends the process as well.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import tempfile
from collections.abc import Collection
from pathlib import Path

import numpy as np

from xihenet.records import ArrayF32

_IN_THE_PROCESS = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    "from xihenet.io.openexr_package import store_channels; store_channels(*sys.argv[2:])"
)


def is_installed() -> bool:
    """Whether the package is there; it is not imported."""
    return importlib.util.find_spec("OpenEXR") is not None


def read_by_package(path: Path, names: Collection[str] | None = None) -> dict[str, ArrayF32]:
    """The channels of `names`, or all, as (H, W) float32 by their full names, of all parts; row 0 is the top.

    Needs `is_installed`. ValueError if the file cannot be read; a part whose pixels are broken is left out.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "channels.npz"
        command = [sys.executable, "-c", _IN_THE_PROCESS, json.dumps(sys.path), str(path), str(out)]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace")
        if done.returncode != 0:
            said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
            raise ValueError(f"{path}: expected an OpenEXR file, and could not read it ({said[-1]})")
        with np.load(out) as stored:
            known = enumerate(stored["names"].tolist())
            return {name: stored[f"channel_{index}"] for index, name in known if names is None or name in names}


def store_channels(path: str, out: str) -> None:
    """What the process does: write the file's channels as an .npz, and apart their names, which may be any text."""
    import OpenEXR

    channels: dict[str, ArrayF32] = {}
    with OpenEXR.File(path, separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                if name not in channels:  # As in `exr.read_exr` the first part counts.
                    channels[name] = channel.pixels.astype(np.float32, copy=False)
    arrays = {f"channel_{index}": pixels for index, pixels in enumerate(channels.values())}
    np.savez(out, names=np.array(list(channels), dtype=str), **arrays)
