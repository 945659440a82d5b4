"""Make `test_rooms`, by which everyone can check the project's figures without rendering a data set:

    python addon_tests/data/make_test_rooms.py ROOMS OUT [--rooms 16]

The first test rooms of the data set, without what only training uses (the linear pictures): everything that a table
needs can still be derived from them. Whole rooms and not sampled clouds, so that any sampling and any number of anchors
can be checked.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from xihenet.io.npz_files import read_npz
from xihenet.training.rooms import TRAINING_ONLY, room_files, room_seed, split_of


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rooms", dest="n_rooms", type=int, default=16)
    options = parser.parse_args()
    chosen = [path for path in room_files(options.rooms) if split_of(room_seed(path)) == "test"][: options.n_rooms]
    if len(chosen) < options.n_rooms:
        sys.exit(f"{options.rooms}: expected {options.n_rooms} test rooms, got {len(chosen)}; build more rooms")
    options.out.mkdir(parents=True, exist_ok=True)
    for path in chosen:
        content = {name: values for name, values in read_npz(path).items() if name not in TRAINING_ONLY}
        np.savez_compressed(options.out / path.name, **content)


if __name__ == "__main__":
    main()
