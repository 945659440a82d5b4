"""A contact sheet: many rooms in one picture, a view of each, and the light at one of its positions below.

`python -m xihe_blender.lab.rooms.contact_sheet DIR PICTURE.png` shows the first 24 rooms of a data set: of each the
view in which most positions are seen, as the phone delivers it, and the panorama at one of them at the same exposure.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xihe_blender.lab.rooms.store import StoredRoom, load_room, room_path, stored_indices
from xihenet.camera import encode_exposed
from xihenet.io.png import write_png
from xihenet.io.whole_files import written_whole
from xihenet.records import ArrayU8

GAP_PX = 4


def contact_sheet(rooms: Sequence[StoredRoom], n_columns: int = 6) -> ArrayU8:
    """(H, W, 3) picture of all rooms in rows of `n_columns`. ValueError without a room."""
    if not rooms:
        raise ValueError("contact_sheet: expected at least one room, got none")
    tiles = [_tile(room) for room in rooms]
    height, width = tiles[0].shape[:2]
    n_rows = -(-len(tiles) // n_columns)
    sheet = np.full((n_rows * (height + GAP_PX), n_columns * (width + GAP_PX), 3), 255, np.uint8)
    for i, tile in enumerate(tiles):
        y, x = i // n_columns * (height + GAP_PX), i % n_columns * (width + GAP_PX)
        sheet[y : y + height, x : x + width] = tile
    return sheet


def _tile(room: StoredRoom) -> ArrayU8:
    """The view that sees most positions, over the panorama of a position that it sees."""
    seen = room.is_in_view & room.is_unhidden
    view = int(seen.sum(axis=1).argmax())
    position = int(seen[view].argmax())
    picture = room.srgb_u8[view]
    panorama = encode_exposed(room.panorama(position, picture.shape[1] // 4), room.exposure)
    factor = picture.shape[1] // panorama.shape[1]
    enlarged = panorama.repeat(factor, axis=0).repeat(factor, axis=1)
    missing = picture.shape[1] - enlarged.shape[1]
    return np.concatenate([picture, np.pad(enlarged, ((0, 0), (0, missing), (0, 0)))])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m xihe_blender.lab.rooms.contact_sheet", description="Show rooms.")
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("picture", type=Path, metavar="PICTURE.png")
    parser.add_argument("--rooms", type=int, default=24, metavar="N", help="how many, from the first; default: 24")
    options = parser.parse_args()
    indices = list(stored_indices(options.folder))[: options.rooms]
    with written_whole(options.picture) as beside:
        write_png(beside, contact_sheet([load_room(room_path(options.folder, i)) for i in indices]))


if __name__ == "__main__":
    main()
