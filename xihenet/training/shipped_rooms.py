"""Which rooms come with the project, so that everyone can check its figures without rendering a data set?

    python -m xihenet.training.shipped_rooms ROOMS OUT [--rooms 16]

The first test rooms of the data set, without what only training uses (the linear pictures): everything that a table
needs can still be derived from them. Whole rooms and not sampled clouds, so that any sampling and any number of anchors
can be checked.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from xihenet.formats import format_bytes
from xihenet.npz_files import read_npz
from xihenet.training.rooms import TRAINING_ONLY, room_files, room_seed, split_of


def write_shipped_rooms(data: Path, out: Path, n_rooms: int) -> list[Path]:
    """Copy the first `n_rooms` test rooms of `data`, less what only training uses; the files written.

    ValueError if there are fewer.
    """
    chosen = [path for path in room_files(data) if split_of(room_seed(path)) == "test"][:n_rooms]
    if len(chosen) < n_rooms:
        raise ValueError(f"{data}: expected {n_rooms} test rooms, got {len(chosen)}; build more rooms")
    out.mkdir(parents=True, exist_ok=True)
    for path in chosen:
        content = {name: values for name, values in read_npz(path).items() if name not in TRAINING_ONLY}
        np.savez_compressed(out / path.name, **content)
    return [out / path.name for path in chosen]


def main() -> int:
    """The command line; 2 for a user's mistake."""
    parser = argparse.ArgumentParser(prog="python -m xihenet.training.shipped_rooms", description=__doc__)
    parser.add_argument("rooms", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rooms", dest="n_rooms", type=int, default=16)
    options = parser.parse_args()
    try:
        written = write_shipped_rooms(options.rooms, options.out, options.n_rooms)
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{len(written)} rooms, {format_bytes(sum(path.stat().st_size for path in written))} in {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
