"""Pieces as objects, and finishes as materials: one function per kind, over the project's own furniture and surfaces.

A lamp's body and light are made with the lamps: its piece only keeps the place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from xihe_blender.lab.props import Collection, Material, furniture, surfaces
from xihe_blender.lab.props.shapes import Place, ball, box, box_between, cylinder, joined, revolved
from xihe_blender.lab.rooms.arrange import local_point
from xihe_blender.lab.rooms.draws import span
from xihe_blender.lab.rooms.room_data import LAMP_KINDS, Finish, Piece

Maker: TypeAlias = Callable[[Place, Piece, list[Material]], None]
BOXES = {"cupboard": 0.004, "mirror": 0.0, "rug": 0.0, "crate": 0.008, "pillar": 0.0, "box": 0.003, "partition": 0.0}
"""What is a box, and by how many metres its edges are rounded."""

TURNED = {
    "vase": (0.5, 24, ((0, 0), (0.6, 0), (1, 0.35), (0.85, 0.6), (0.4, 0.85), (0.5, 1))),
    "bowl": (0.5, 32, ((0, 0), (0.5, 0), (0.85, 0.4), (1, 1), (0.92, 1), (0.75, 0.45), (0, 0.2))),
    "mug": (0.42, 24, ((0, 0), (1, 0), (1, 1), (0.9, 1), (0.9, 0.1), (0, 0.1))),
    "pouf": (0.5, 32, ((0, 0), (0.92, 0), (1, 0.15), (1, 0.82), (0.9, 0.97), (0, 1))),
}
"""What is turned: radius as a share of the width, segments, and the profile as shares of radius and height."""


def place_piece(room: Collection, name: str, piece: Piece) -> None:
    """Make the objects of a piece in `room`. KeyError for a kind that nobody makes."""
    if piece.kind in LAMP_KINDS:
        return
    materials = [material_of(f"{name} {i}", finish) for i, finish in enumerate(piece.finishes)]
    MAKERS[piece.kind](Place(room, name, piece.x, piece.y, piece.z, piece.turn_deg), piece, materials)


def _generator(piece: Piece) -> np.random.Generator:
    return np.random.default_rng(piece.seed)


def _table(place: Place, piece: Piece, m: list[Material]) -> None:
    leg_m = float(_generator(piece).uniform(0.035, 0.075))
    furniture.add_table(place, piece.size, m[0], m[1], leg_m=leg_m)


def _sofa(place: Place, piece: Piece, m: list[Material]) -> None:
    n_throws = int(_generator(piece).integers(0, 3)) if piece.size[0] > 1.2 else 0
    furniture.add_sofa(place, piece.size[0], m[0], m[1], [m[2]] * n_throws)


def _bookcase(place: Place, piece: Piece, m: list[Material]) -> None:
    books, rng = surfaces.coloured_by_face(f"{place.name} books"), _generator(piece)
    n_shelves = max(2, round(piece.size[2] / 0.38))
    furniture.add_bookcase(place, piece.size, m[0], books, rng, n_shelves=n_shelves)


def _cabinet(place: Place, piece: Piece, m: list[Material]) -> None:
    w, d, h = piece.size
    # Handles stand out by 3 cm in front: inside the piece's extents.
    furniture.add_cabinet(_shifted(place, piece, 0.015), (w, d - 0.03, h), m[0], m[1])


def _shifted(place: Place, piece: Piece, back_m: float, up_m: float = 0.0) -> Place:
    """The piece's place, moved towards its back and up."""
    x, y = local_point(piece, (0.0, back_m))
    return replace(place, x=x, y=y, z=piece.z + up_m)


def _counter(place: Place, piece: Piece, m: list[Material]) -> None:
    w, d, h = piece.size
    furniture.add_cabinet(_shifted(place, piece, 0.015), (w, d - 0.05, h - 0.04), m[0], m[2])
    place.add(box_between((-w / 2, -d / 2, h - 0.04), (w / 2, d / 2, h)), m[1], "top", bevel_m=0.004)


def _tub(place: Place, piece: Piece, m: list[Material]) -> None:
    w, d, h = piece.size
    walls = [box_between((-w / 2, -d / 2, 0), (w / 2, d / 2, 0.15))]
    walls += [box((w, 0.07, h), (0, s * (d / 2 - 0.035), h / 2)) for s in (-1, 1)]
    walls += [box((0.08, d, h), (s * (w / 2 - 0.04), 0, h / 2)) for s in (-1, 1)]
    place.add(joined(walls), m[0], bevel_m=0.02, smooth=True)
    tap = [cylinder(0.015, 0.12).moved((w / 2 - 0.04, 0, h)), box((0.14, 0.025, 0.025), (w / 2 - 0.1, 0, h + 0.11))]
    place.add(joined(tap), m[1], "tap", smooth=True)


def _plant(place: Place, piece: Piece, m: list[Material]) -> None:
    w, _, h = piece.size
    soil = surfaces.plain(f"{place.name} soil", (0.05, 0.035, 0.025), roughness=1.0)
    shape = {"height": 0.85 * h, "spread": 0.42 * w, "pot_radius": min(0.17, 0.1 + 0.05 * h)}
    furniture.add_plant(place, m[0], m[1], soil, _generator(piece), n_leaves=18, **shape)


def _picture(place: Place, piece: Piece, m: list[Material]) -> None:
    w, d, h = piece.size
    mount = surfaces.plain(f"{place.name} mount", (0.74, 0.73, 0.7), roughness=0.8)
    hung = _shifted(place, piece, d / 2, h / 2)
    furniture.add_picture(hung, (w - 0.06, h - 0.06), m[0], m[1], mount)


def _radiator(place: Place, piece: Piece, m: list[Material]) -> None:
    w, d, h = piece.size
    furniture.add_radiator(_shifted(place, piece, d / 2), w, h - 0.14, m[0])


def _screen(place: Place, piece: Piece, m: list[Material]) -> None:
    w, d, h = piece.size
    middle = 0.06 + (h - 0.06) / 2
    parts = [box((w, 0.03, h - 0.06), (0, 0, middle)), box((0.05, 0.03, 0.08), (0, 0.02, 0.04))]
    parts.append(box((0.3 * w, d, 0.012), (0, 0, 0.006)))
    place.add(joined(parts), m[0], bevel_m=0.004)
    rng = _generator(piece)
    if rng.random() < 0.35:
        glow = surfaces.glowing(f"{place.name} picture", 7000.0, span(rng, 0.3, 1.5))
        place.add(box((w - 0.03, 0.002, h - 0.1), (0, -0.017, middle)), glow, "picture")


def _book_pile(place: Place, piece: Piece, m: list[Material]) -> None:
    w, d, h = piece.size
    n = max(2, round(h / 0.03))
    book = box((0.85 * w, 0.65 * d, 0.95 * h / n))
    books = [book.turned(7 * ((i * 5) % 3 - 1)).moved((0, 0, h * (i + 0.5) / n)) for i in range(n)]
    place.add(joined(books), m[0])


def _box(place: Place, piece: Piece, m: list[Material]) -> None:
    place.add(box(piece.size, (0, 0, piece.size[2] / 2)), m[0], bevel_m=BOXES[piece.kind])


def _stairs(place: Place, piece: Piece, m: list[Material]) -> None:
    """Steps of about 17 cm that rise towards the back."""
    w, d, h = piece.size
    n = max(2, round(h / 0.17))
    steps = [box_between((-w / 2, d * (i / n - 0.5), 0), (w / 2, d / 2, h * (i + 1) / n)) for i in range(n)]
    place.add(joined(steps), m[0])


def _turned(place: Place, piece: Piece, m: list[Material]) -> None:
    w, _, h = piece.size
    share, n_segments, profile = TURNED[piece.kind]
    place.add(revolved([(r * (share * w), z * h) for r, z in profile], n_segments), m[0], smooth=True)


MAKERS: dict[str, Maker] = {
    "table": _table, "desk": _table, "coffee_table": _table, "sofa": _sofa, "armchair": _sofa,
    "bookcase": _bookcase, "sideboard": _cabinet, "wardrobe": _cabinet, "chest": _cabinet, "counter": _counter,
    "tub": _tub, "plant": _plant, "picture": _picture, "radiator": _radiator, "screen": _screen,
    "book_pile": _book_pile, "stairs": _stairs,
    "round_table": lambda place, piece, m: furniture.add_round_table(place, piece.size[0] / 2, piece.size[2], *m),
    "chair": lambda place, piece, m: furniture.add_chair(place, *m),
    "bed": lambda place, piece, m: furniture.add_bed(place, piece.size[0] - 0.2, *m),
    "bench": lambda place, piece, m: furniture.add_bench(place, piece.size, *m),
    "ball": lambda place, piece, m: place.add(ball(d := piece.size[0] / 2, (0, 0, d), 32), m[0], smooth=True),
    "post": lambda place, piece, m: place.add(cylinder(piece.size[0] / 2, piece.size[2]), m[0], smooth=True),
    **dict.fromkeys(BOXES, _box), **dict.fromkeys(TURNED, _turned),
}  # fmt: skip

FINISHES: dict[str, Callable[[str, Finish], Material]] = {
    "plain": lambda name, f: surfaces.plain(name, f.colour, roughness=f.roughness),
    "metal": lambda name, f: surfaces.plain(name, f.colour, roughness=f.roughness, metallic=1.0),
    "leather": lambda name, f: surfaces.plain(name, f.colour, roughness=f.roughness),
    "paint": lambda name, f: surfaces.paint(name, f.colour, roughness=f.roughness),
    "wood": lambda name, f: surfaces.wood(name, f.colour, f.second, roughness=f.roughness),
    "fabric": lambda name, f: surfaces.fabric(name, f.colour, weave_per_m=max(f.scale, 40.0)),
    "carpet": lambda name, f: surfaces.carpet(name, f.colour, f.second, surfaces.shade(f.second, 1.6)),
    "foliage": lambda name, f: surfaces.foliage(name, f.colour, f.second),
    "painting": lambda name, f: surfaces.painting(
        name, [(0.3, f.colour), (0.5, f.second), (0.7, surfaces.shade(f.colour, 1.8))]
    ),
    "patches": lambda name, f: surfaces.patches(name, f.colour, f.second, size_m=f.scale, roughness=f.roughness),
    "glass": lambda name, f: surfaces.plain(name, f.colour, roughness=f.roughness, transmission_weight=1.0),
    "planks": lambda name, f: surfaces.planks(name, f.colour, f.second, width_m=f.scale),
    "tiles": lambda name, f: _tiled(name, f, upright=False),
    "wall tiles": lambda name, f: _tiled(name, f, upright=True),
    "brick": lambda name, f: surfaces.masonry(
        name, (f.colour, f.second, (0.5, 0.48, 0.45)), (0.24, 0.075), upright=True
    ),
}


def material_of(name: str, finish: Finish) -> Material:
    """A new material. KeyError for a kind of finish that nobody makes."""
    return FINISHES[finish.kind](name, finish)


def _tiled(name: str, finish: Finish, *, upright: bool) -> Material:
    tones = (finish.colour, finish.second, surfaces.shade(finish.colour, 0.5))
    side = finish.scale
    return surfaces.masonry(
        name, tones, (side, side), joint_m=0.006, upright=upright, offset=0.0, roughness=finish.roughness
    )
