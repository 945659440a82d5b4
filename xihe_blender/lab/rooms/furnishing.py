"""Furnishing by kind of room: a table of pieces and their chances; a function puts each of them in its place.

Sizes are full extents in metres, width x depth x height, from what shops sell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from xihe_blender.lab.rooms import palette
from xihe_blender.lab.rooms.arrange import TRIES, Floor, local_point
from xihe_blender.lab.rooms.draws import Rng, one_of, piece_seed, span
from xihe_blender.lab.rooms.room_data import Finish, Piece, Size

CHAIR = (0.5, 0.57, 0.9)
SUPPORTS = ("coffee_table", "round_table", "desk", "table", "sideboard", "chest", "counter", "crate", "bench")
WHITE_GLAZE = Finish("plain", (0.8, 0.8, 0.79), roughness=0.08)
MIRROR_GLASS = Finish("metal", (0.85, 0.85, 0.85), roughness=0.02)
Maker = Callable[[Rng, Floor], object]
"""Puts a piece, or several that belong together, on a floor where there is a place for it."""

Extent = float | tuple[float, float]


def furnish(rng: Rng, floor: Floor, kind: str) -> None:
    """Put the furniture of a `kind` of room on `floor`; then what lies on it and hangs on the walls."""
    if rng.random() < 0.97:
        for make, chance in FURNITURE[kind]:
            _make_by_chance(rng, floor, make, chance)
    for _ in range(int(rng.integers(1, 3 + int(floor.outline.area / 5)))):
        _make_by_chance(rng, floor, *one_of(rng, EXTRAS))
    if rng.random() < 0.1:
        add_pillar(rng, floor)
    add_radiators(rng, floor)
    add_things_on_tops(rng, floor)
    add_pictures(rng, floor)


def _make_by_chance(rng: Rng, floor: Floor, make: Maker, chance: float | None) -> None:
    """None is certain, and draws nothing."""
    if chance is None or rng.random() < chance:
        make(rng, floor)


@dataclass(frozen=True)
class AtWall:
    """Puts one piece at a wall."""

    kind: str
    size: tuple[Extent, Extent, Extent]  # extents, each a number or drawn from between two
    finishes: tuple[Finish | Callable[[Rng], Finish], ...]  # each one, or what draws it
    is_size_first: bool = False  # before the finishes; the order of the draws makes the same seed give the same room
    z: float = 0.0
    tries: int = TRIES

    def __call__(self, rng: Rng, floor: Floor) -> Piece | None:
        size = self._draw_size(rng) if self.is_size_first else None
        looks = tuple(finish if isinstance(finish, Finish) else finish(rng) for finish in self.finishes)
        return floor.against_wall(rng, self.kind, size or self._draw_size(rng), looks, z=self.z, tries=self.tries)

    def _draw_size(self, rng: Rng) -> Size:
        w, d, h = (span(rng, *extent) if isinstance(extent, tuple) else extent for extent in self.size)
        return w, d, h


CASE = (palette.board_finish, palette.metal_finish)
UPHOLSTERY = (palette.cloth_finish, palette.wood_finish, palette.cloth_finish)
SIDEBOARD = AtWall("sideboard", ((0.8, 2.0), (0.38, 0.5), (0.5, 1.0)), CASE)
WARDROBE = AtWall("wardrobe", ((0.9, 2.2), (0.55, 0.65), (1.8, 2.2)), CASE)
BOOKCASE = AtWall("bookcase", ((0.6, 1.8), (0.26, 0.38), (1.0, 2.2)), (palette.board_finish,), is_size_first=True)
BENCH = AtWall("bench", ((0.8, 1.4), 0.4, 0.45), (palette.cloth_finish, palette.wood_finish))
FLOOR_LAMP = AtWall("floor_lamp", (0.44, 0.44, (1.4, 1.75)), (palette.metal_finish,), is_size_first=True)
"""Whether it is lit is decided later."""

TUB = AtWall("tub", ((1.4, 1.8), 0.75, 0.58), (WHITE_GLAZE, palette.metal_finish), is_size_first=True, tries=25)
BASIN = AtWall("counter", ((0.6, 1.4), 0.5, 0.85), (palette.board_finish, WHITE_GLAZE, palette.metal_finish), tries=25)
BATHROOM_MIRROR = AtWall("mirror", ((0.5, 1.2), 0.03, (0.6, 0.9)), (MIRROR_GLASS,), z=1.1, tries=25)
HALL_MIRROR = AtWall("mirror", ((0.5, 0.8), 0.03, (0.9, 1.4)), (MIRROR_GLASS,), z=0.7)
WIDE_SOFA, DINING_SOFA, STUDY_SOFA = (
    AtWall("sofa", (width, 0.92, 0.85), UPHOLSTERY, is_size_first=True, tries=25)
    for width in ((1.4, 2.5), (1.4, 1.9), (0.9, 1.7))
)


def add_sitting_corner(rng: Rng, floor: Floor) -> None:
    """A sofa with a low table before it, which is round now and then, and up to two armchairs."""
    sofa = WIDE_SOFA(rng, floor)
    if sofa is not None:
        looks = (palette.board_finish(rng), palette.metal_finish(rng))
        if rng.random() < 0.3:
            r = span(rng, 0.3, 0.5)
            floor.beside(rng, sofa, (0.0, -0.85 - r), "round_table", (2 * r, 2 * r, span(rng, 0.35, 0.5)), looks)
        else:
            size = (span(rng, 0.8, 1.3), span(rng, 0.5, 0.75), span(rng, 0.32, 0.48))
            floor.beside(rng, sofa, (span(rng, -0.2, 0.2), -0.85 - size[1] / 2), "coffee_table", size, looks)
    for _ in range(int(rng.integers(0, 3))):
        add_armchair(rng, floor)


def add_bed(rng: Rng, floor: Floor) -> None:
    """A bed with chests beside it and a bench at its foot."""
    bed_width = span(rng, 0.9, 1.8)
    frame, blanket, cloth = palette.board_finish(rng), palette.cloth_finish(rng), palette.cloth_finish(rng)
    linen = Finish("fabric", palette.pick(rng, palette.LIGHT_WALLS), scale=160.0)
    size = (bed_width + 0.2, 2.16, 1.05)
    bed = floor.against_wall(rng, "bed", size, (frame, linen, blanket), tries=30)
    if bed is None:
        return
    case = palette.board_finish(rng)
    for side in (-1, 1):
        if rng.random() < 0.75:
            offset = (side * (size[0] / 2 + 0.25), 0.85)
            floor.beside(rng, bed, offset, "chest", (0.45, 0.4, 0.52), (case, palette.metal_finish(rng)))
    if rng.random() < 0.3:
        floor.beside(rng, bed, (0.0, -1.38), "bench", (min(1.2, bed_width), 0.4, 0.45), (cloth, case))


def add_kitchen(rng: Rng, floor: Floor) -> None:
    """Counters, wall cupboards, a fridge."""
    fronts, top, knobs = palette.lacquer_finish(rng), _worktop(rng), palette.metal_finish(rng)
    for chance in (1.0, 0.6):
        if rng.random() > chance:
            continue
        counter = floor.against_wall(rng, "counter", (span(rng, 1.2, 3.0), 0.62, 0.9), (fronts, top, knobs), tries=25)
        if counter is not None and rng.random() < 0.6:
            size = (counter.size[0] * 0.8, 0.34, 0.6)
            x, y = local_point(counter, (0.0, (counter.size[1] - size[1]) / 2))
            floor.add(Piece("cupboard", x, y, 1.5, counter.turn_deg, size, (fronts, knobs), piece_seed(rng)))
    if rng.random() < 0.7:
        steel = Finish("metal", (0.6, 0.6, 0.6), roughness=0.35) if rng.random() < 0.5 else fronts
        floor.against_wall(rng, "wardrobe", (0.65, 0.65, span(rng, 1.6, 2.0)), (steel, knobs))


def _worktop(rng: Rng) -> Finish:
    if rng.random() < 0.4:
        return palette.wood_finish(rng)
    stone = one_of(rng, ((0.08, 0.08, 0.085), (0.5, 0.48, 0.45), (0.75, 0.74, 0.72)))
    return Finish("plain", palette.jittered(rng, stone), roughness=span(rng, 0.08, 0.4))


def add_rug(rng: Rng, floor: Floor) -> None:
    look = Finish("carpet", palette.pick(rng, palette.CLOTHS), palette.pick(rng, palette.CLOTHS), 1.0)
    floor.anywhere(rng, "rug", (span(rng, 1.2, 2.8), span(rng, 0.9, 2.0), 0.012), (look,))


def add_round_table(rng: Rng, floor: Floor) -> None:
    r = span(rng, 0.2, 0.4)
    looks = (palette.board_finish(rng), palette.metal_finish(rng))
    floor.anywhere(rng, "round_table", (2 * r, 2 * r, span(rng, 0.45, 0.65)), looks)


def add_desk(rng: Rng, floor: Floor) -> None:
    size = (span(rng, 1.0, 1.8), span(rng, 0.6, 0.8), span(rng, 0.71, 0.76))
    desk = floor.against_wall(rng, "desk", size, (palette.board_finish(rng), palette.metal_finish(rng)), tries=25)
    if desk is None:
        return
    looks = (palette.metal_finish(rng), palette.cloth_finish(rng))
    offset = (span(rng, -0.2, 0.2), -size[1] / 2 - 0.4)
    floor.beside(rng, desk, offset, "chair", CHAIR, looks, turn_deg=180 + span(rng, -20, 20))


def add_dining(rng: Rng, floor: Floor) -> None:
    """A table with chairs on two or four sides."""
    size = (span(rng, 0.8, 2.2), span(rng, 0.75, 1.0), span(rng, 0.72, 0.77))
    legs = palette.wood_finish(rng) if rng.random() < 0.6 else palette.metal_finish(rng)
    table = floor.anywhere(rng, "table", size, (palette.board_finish(rng), legs), margin_m=0.6, gap_m=0.5)
    if table is None:
        return
    looks = (legs, palette.cloth_finish(rng))
    for i in range(n := max(1, int(size[0] / 0.62))):
        for side in (-1, 1):
            if rng.random() < 0.85:
                offset = (size[0] * ((i + 0.5) / n - 0.5), side * (size[1] / 2 + 0.31 + span(rng, 0.03, 0.2)))
                turn = (0 if side > 0 else 180) + span(rng, -8, 8)
                floor.beside(rng, table, offset, "chair", CHAIR, looks, turn_deg=turn)


def add_plant(rng: Rng, floor: Floor) -> None:
    height = span(rng, 0.6, 1.7)
    green = Finish("foliage", palette.jittered(rng, (0.02, 0.07, 0.02)), palette.jittered(rng, (0.08, 0.2, 0.05)))
    looks = (green, palette.glaze_finish(rng))
    width = 0.3 + 0.35 * height
    floor.against_wall(rng, "plant", (width, width, height), looks)


def add_crate(rng: Rng, floor: Floor) -> None:
    look = (palette.board_finish(rng) if rng.random() < 0.5 else Finish("plain", (0.4, 0.27, 0.15), roughness=0.8),)
    size = (span(rng, 0.3, 0.6), span(rng, 0.3, 0.5), span(rng, 0.25, 0.6))
    floor.anywhere(rng, "crate", size, look, free_turn=True)


def add_pouf(rng: Rng, floor: Floor) -> None:
    d = span(rng, 0.4, 0.6)
    floor.anywhere(rng, "pouf", (d, d, span(rng, 0.36, 0.48)), (palette.cloth_finish(rng),))


def add_pillar(rng: Rng, floor: Floor) -> None:
    side = span(rng, 0.25, 0.45)
    look = Finish("paint", palette.wall_colour(rng), roughness=0.8)
    floor.anywhere(rng, "pillar", (side, side, floor.height - 0.05), (look,), gap_m=0.4)


def add_armchair(rng: Rng, floor: Floor) -> None:
    cloth = palette.cloth_finish(rng)
    looks = (cloth, palette.wood_finish(rng), cloth)
    floor.anywhere(rng, "armchair", (0.95, 0.9, 0.85), looks, free_turn=rng.random() < 0.6)


def add_radiators(rng: Rng, floor: Floor) -> None:
    white = (Finish("plain", (0.75, 0.75, 0.73), roughness=0.3),)
    for hole in floor.windows:
        if hole.bottom < 0.7 or rng.random() < 0.4:
            continue
        wall = floor.outline.walls[hole.wall]
        width = min(hole.high - hole.low, 1.4)
        x, y = wall.point((hole.low + hole.high) / 2, 0.08)
        floor.add(Piece("radiator", x, y, 0.0, wall.turn_deg, (width, 0.14, 0.62), white, piece_seed(rng)))


def add_things_on_tops(rng: Rng, floor: Floor) -> None:
    """Lamps, screens, vases, bowls, books, boxes and balls on whatever has a flat top."""
    for support in [p for p in floor.pieces if p.kind in SUPPORTS]:
        if support.kind in ("desk", "sideboard") and rng.random() < 0.6:
            size = (span(rng, 0.5, min(0.95, support.size[0] - 0.1)), 0.2, span(rng, 0.35, 0.55))
            frame = Finish("plain", (0.02, 0.02, 0.022), roughness=0.15)
            floor.on_top(rng, support, "screen", size, (frame,), free_turn=False)
        if rng.random() < 0.45:
            height = span(rng, 0.35, 0.6)
            d = 0.64 * height + 0.02
            floor.on_top(rng, support, "table_lamp", (d, d, height), (palette.glaze_finish(rng),))
        for _ in range(int(rng.integers(0, 4))):
            add_trinket(rng, floor, support)


def add_trinket(rng: Rng, floor: Floor, support: Piece) -> None:
    kind = str(rng.choice(["vase", "bowl", "book_pile", "box", "ball", "mug"]))
    d = span(rng, 0.06, 0.2)
    look = palette.metal_finish(rng) if rng.random() < 0.25 else palette.glaze_finish(rng)
    heights = {"vase": 2.0 * d, "bowl": 0.45 * d, "book_pile": 0.6 * d, "box": 0.7 * d, "ball": d, "mug": 0.1}
    side = 0.09 if kind == "mug" else d
    floor.on_top(rng, support, kind, (side, side, heights[kind]), (look,))


def add_pictures(rng: Rng, floor: Floor) -> None:
    """Pictures on walls, above what stands there."""
    for _ in range(int(rng.integers(0, 5))):
        stops = palette.pick(rng, palette.CLOTHS), palette.pick(rng, palette.STRONG_WALLS)
        looks = (Finish("painting", *stops), palette.board_finish(rng))
        height = span(rng, 0.3, 0.9)
        size = (span(rng, 0.3, 1.1), 0.035, height)
        floor.against_wall(rng, "picture", size, looks, z=span(rng, 1.2, 1.65) - height / 2 + 0.1, tries=5)


def add_desks(rng: Rng, floor: Floor) -> None:
    for _ in range(int(rng.integers(1, 5))):
        add_desk(rng, floor)


FURNITURE: dict[str, tuple[tuple[Maker, float | None], ...]] = {
    "living": (
        (add_rug, 0.6), (add_sitting_corner, None), (SIDEBOARD, 0.75), (BOOKCASE, 0.65), (add_round_table, 0.3),
        (add_dining, 0.25),
    ),
    "bedroom": (
        (add_rug, 0.5), (add_bed, None), (WARDROBE, 0.75), (SIDEBOARD, 0.35), (add_desk, 0.35), (BOOKCASE, 0.25),
    ),
    "dining": ((add_rug, 0.4), (add_dining, None), (SIDEBOARD, 0.8), (BOOKCASE, 0.35), (DINING_SOFA, 0.3)),
    "study": (
        (add_rug, 0.5), (add_desk, None), (BOOKCASE, 0.9), (BOOKCASE, 0.6), (BOOKCASE, 0.3), (STUDY_SOFA, 0.4),
        (SIDEBOARD, 0.4),
    ),
    "kitchen": ((add_kitchen, None), (add_dining, 0.6)),
    "bathroom": ((TUB, 0.7), (BASIN, None), (BATHROOM_MIRROR, None), (WARDROBE, 0.25)),
    "office": ((add_desks, None), (BOOKCASE, 0.7), (BOOKCASE, 0.4), (SIDEBOARD, 0.6), (add_dining, 0.3)),
    "hall": ((add_rug, 0.5), (SIDEBOARD, 0.6), (WARDROBE, 0.5), (BENCH, None), (HALL_MIRROR, 0.5)),
}  # fmt: skip
"""What may stand in a kind of room, in this order, and its chance; None is certain."""

EXTRAS: tuple[tuple[Maker, float | None], ...] = (
    (add_plant, None), (add_plant, None), (add_crate, None), (add_pouf, None), (FLOOR_LAMP, None), (FLOOR_LAMP, None),
    (add_armchair, None), (SIDEBOARD, 1.0), (BOOKCASE, 1.0), (add_round_table, 1.0),
)  # fmt: skip
"""A chance of 1 draws a number, as it always did: the same seed gives the same room."""
