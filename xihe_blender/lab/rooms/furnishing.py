"""What stands in which kind of room? One function per kind; each calls the pieces that such a room has.

Sizes are full extents in metres, width x depth x height, from what shops sell.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from xihe_blender.lab.rooms import palette
from xihe_blender.lab.rooms.arrange import Floor, Rng
from xihe_blender.lab.rooms.room_data import Finish, Piece

CHAIR = (0.5, 0.57, 0.9)
SUPPORTS = frozenset(
    {"coffee_table", "round_table", "desk", "table", "sideboard", "chest", "counter", "crate", "bench"}
)


def span(rng: Rng, low: float, high: float) -> float:
    """A number between two others."""
    return float(rng.uniform(low, high))


def furnish(rng: Rng, floor: Floor, kind: str) -> None:
    """Put the furniture of a `kind` of room on `floor`; then what lies on it and hangs on the walls."""
    if rng.random() < 0.97:
        FURNISHERS[kind](rng, floor)
    for _ in range(int(rng.integers(1, 3 + int(floor.outline.area / 5)))):
        EXTRAS[int(rng.integers(len(EXTRAS)))](rng, floor)
    if rng.random() < 0.1:
        add_pillar(rng, floor)
    add_radiators(rng, floor)
    add_things_on_tops(rng, floor)
    add_pictures(rng, floor)


def furnish_living(rng: Rng, floor: Floor) -> None:
    """Sofa with its table, armchairs, sideboard, books."""
    add_rug(rng, floor, 0.6)
    sofa = add_sofa(rng, floor, span(rng, 1.4, 2.5))
    if sofa is not None:
        add_coffee_table(rng, floor, sofa)
    for _ in range(int(rng.integers(0, 3))):
        add_armchair(rng, floor)
    add_sideboard(rng, floor, 0.75)
    add_bookcase(rng, floor, 0.65)
    add_round_table(rng, floor, 0.3)
    if rng.random() < 0.25:
        add_dining(rng, floor)


def furnish_bedroom(rng: Rng, floor: Floor) -> None:
    """Bed, chests beside it, wardrobe."""
    add_rug(rng, floor, 0.5)
    bed_width = span(rng, 0.9, 1.8)
    finishes = (palette.board_finish(rng), palette.cloth_finish(rng), palette.cloth_finish(rng))
    linen = Finish("fabric", palette.pick(rng, palette.LIGHT_WALLS), scale=160.0)
    size = (bed_width + 0.2, 2.16, 1.05)
    bed = floor.against_wall(rng, "bed", size, (finishes[0], linen, finishes[1]), tries=30)
    if bed is not None:
        case = palette.board_finish(rng)
        for side in (-1, 1):
            if rng.random() < 0.75:
                offset = (side * (size[0] / 2 + 0.25), 0.85)
                floor.beside(rng, bed, offset, "chest", (0.45, 0.4, 0.52), (case, palette.metal_finish(rng)))
        if rng.random() < 0.3:
            floor.beside(rng, bed, (0.0, -1.38), "bench", (min(1.2, bed_width), 0.4, 0.45), (finishes[2], case))
    add_wardrobe(rng, floor, 0.75)
    add_sideboard(rng, floor, 0.35)
    if rng.random() < 0.35:
        add_desk(rng, floor)
    add_bookcase(rng, floor, 0.25)


def furnish_dining(rng: Rng, floor: Floor) -> None:
    """A table with chairs, a sideboard."""
    add_rug(rng, floor, 0.4)
    add_dining(rng, floor)
    add_sideboard(rng, floor, 0.8)
    add_bookcase(rng, floor, 0.35)
    if rng.random() < 0.3:
        add_sofa(rng, floor, span(rng, 1.4, 1.9))


def furnish_study(rng: Rng, floor: Floor) -> None:
    """A desk among books."""
    add_rug(rng, floor, 0.5)
    add_desk(rng, floor)
    for chance in (0.9, 0.6, 0.3):
        add_bookcase(rng, floor, chance)
    if rng.random() < 0.4:
        add_sofa(rng, floor, span(rng, 0.9, 1.7))
    add_sideboard(rng, floor, 0.4)


def furnish_kitchen(rng: Rng, floor: Floor) -> None:
    """Counters, wall cupboards, a fridge, a table."""
    fronts, top, knobs = palette.lacquer_finish(rng), _worktop(rng), palette.metal_finish(rng)
    for chance in (1.0, 0.6):
        if rng.random() > chance:
            continue
        counter = floor.against_wall(rng, "counter", (span(rng, 1.2, 3.0), 0.62, 0.9), (fronts, top, knobs), tries=25)
        if counter is not None and rng.random() < 0.6:
            size = (counter.size[0] * 0.8, 0.34, 0.6)
            x, y = counter.x, counter.y
            back = (counter.size[1] - size[1]) / 2
            c, s = np.cos(np.radians(counter.turn_deg)), np.sin(np.radians(counter.turn_deg))
            floor.add(Piece("cupboard", float(x - s * back), float(y + c * back), 1.5, counter.turn_deg, size,
                            (fronts, knobs), int(rng.integers(2**31))))  # fmt: skip
    if rng.random() < 0.7:
        steel = Finish("metal", (0.6, 0.6, 0.6), roughness=0.35) if rng.random() < 0.5 else fronts
        floor.against_wall(rng, "wardrobe", (0.65, 0.65, span(rng, 1.6, 2.0)), (steel, knobs))
    if rng.random() < 0.6:
        add_dining(rng, floor)


def furnish_bathroom(rng: Rng, floor: Floor) -> None:
    """A tub, a basin on a cabinet, a mirror."""
    white = Finish("plain", (0.8, 0.8, 0.79), roughness=0.08)
    if rng.random() < 0.7:
        floor.against_wall(rng, "tub", (span(rng, 1.4, 1.8), 0.75, 0.58), (white, palette.metal_finish(rng)), tries=25)
    vanity = (palette.board_finish(rng), white, palette.metal_finish(rng))
    floor.against_wall(rng, "counter", (span(rng, 0.6, 1.4), 0.5, 0.85), vanity, tries=25)
    chrome = Finish("metal", (0.85, 0.85, 0.85), roughness=0.02)
    floor.against_wall(rng, "mirror", (span(rng, 0.5, 1.2), 0.03, span(rng, 0.6, 0.9)), (chrome,), z=1.1, tries=25)
    add_wardrobe(rng, floor, 0.25)


def furnish_office(rng: Rng, floor: Floor) -> None:
    """Several desks, shelves, cabinets."""
    for _ in range(int(rng.integers(1, 5))):
        add_desk(rng, floor)
    for chance in (0.7, 0.4):
        add_bookcase(rng, floor, chance)
    add_sideboard(rng, floor, 0.6)
    if rng.random() < 0.3:
        add_dining(rng, floor)


def furnish_hall(rng: Rng, floor: Floor) -> None:
    """A chest, a bench, a wardrobe, a mirror."""
    add_rug(rng, floor, 0.5)
    add_sideboard(rng, floor, 0.6)
    add_wardrobe(rng, floor, 0.5)
    cloth, case = palette.cloth_finish(rng), palette.wood_finish(rng)
    floor.against_wall(rng, "bench", (span(rng, 0.8, 1.4), 0.4, 0.45), (cloth, case))
    if rng.random() < 0.5:
        chrome = Finish("metal", (0.85, 0.85, 0.85), roughness=0.02)
        floor.against_wall(rng, "mirror", (span(rng, 0.5, 0.8), 0.03, span(rng, 0.9, 1.4)), (chrome,), z=0.7)


FURNISHERS: dict[str, Callable[[Rng, Floor], None]] = {
    "living": furnish_living, "bedroom": furnish_bedroom, "dining": furnish_dining, "study": furnish_study,
    "kitchen": furnish_kitchen, "bathroom": furnish_bathroom, "office": furnish_office, "hall": furnish_hall,
}  # fmt: skip


def _worktop(rng: Rng) -> Finish:
    if rng.random() < 0.4:
        return palette.wood_finish(rng)
    stone = ((0.08, 0.08, 0.085), (0.5, 0.48, 0.45), (0.75, 0.74, 0.72))[int(rng.integers(3))]
    return Finish("plain", palette.jittered(rng, stone), roughness=span(rng, 0.08, 0.4))


def add_rug(rng: Rng, floor: Floor, chance: float) -> None:
    """A rug with a pattern, or a plain one."""
    if rng.random() > chance:
        return
    look = Finish("carpet", palette.pick(rng, palette.CLOTHS), palette.pick(rng, palette.CLOTHS), 1.0)
    floor.anywhere(rng, "rug", (span(rng, 1.2, 2.8), span(rng, 0.9, 2.0), 0.012), (look,))


def add_sofa(rng: Rng, floor: Floor, width: float) -> Piece | None:
    """A sofa at a wall."""
    looks = (palette.cloth_finish(rng), palette.wood_finish(rng), palette.cloth_finish(rng))
    return floor.against_wall(rng, "sofa", (width, 0.92, 0.85), looks, tries=25)


def add_coffee_table(rng: Rng, floor: Floor, sofa: Piece) -> None:
    """A low table before a sofa; round now and then."""
    looks = (palette.board_finish(rng), palette.metal_finish(rng))
    if rng.random() < 0.3:
        r = span(rng, 0.3, 0.5)
        floor.beside(rng, sofa, (0.0, -0.85 - r), "round_table", (2 * r, 2 * r, span(rng, 0.35, 0.5)), looks)
        return
    size = (span(rng, 0.8, 1.3), span(rng, 0.5, 0.75), span(rng, 0.32, 0.48))
    floor.beside(rng, sofa, (span(rng, -0.2, 0.2), -0.85 - size[1] / 2), "coffee_table", size, looks)


def add_round_table(rng: Rng, floor: Floor, chance: float) -> None:
    """A small round table."""
    if rng.random() < chance:
        r = span(rng, 0.2, 0.4)
        looks = (palette.board_finish(rng), palette.metal_finish(rng))
        floor.anywhere(rng, "round_table", (2 * r, 2 * r, span(rng, 0.45, 0.65)), looks)


def add_sideboard(rng: Rng, floor: Floor, chance: float) -> None:
    """A sideboard or chest of drawers at a wall."""
    if rng.random() < chance:
        looks = (palette.board_finish(rng), palette.metal_finish(rng))
        floor.against_wall(rng, "sideboard", (span(rng, 0.8, 2.0), span(rng, 0.38, 0.5), span(rng, 0.5, 1.0)), looks)


def add_wardrobe(rng: Rng, floor: Floor, chance: float) -> None:
    """A wardrobe at a wall."""
    if rng.random() < chance:
        looks = (palette.board_finish(rng), palette.metal_finish(rng))
        floor.against_wall(rng, "wardrobe", (span(rng, 0.9, 2.2), span(rng, 0.55, 0.65), span(rng, 1.8, 2.2)), looks)


def add_bookcase(rng: Rng, floor: Floor, chance: float) -> None:
    """A bookcase at a wall."""
    if rng.random() < chance:
        size = (span(rng, 0.6, 1.8), span(rng, 0.26, 0.38), span(rng, 1.0, 2.2))
        floor.against_wall(rng, "bookcase", size, (palette.board_finish(rng),))


def add_desk(rng: Rng, floor: Floor) -> None:
    """A desk at a wall with its chair."""
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
    """A potted plant in a corner or anywhere."""
    height = span(rng, 0.6, 1.7)
    green = Finish("foliage", palette.jittered(rng, (0.02, 0.07, 0.02)), palette.jittered(rng, (0.08, 0.2, 0.05)))
    looks = (green, palette.glaze_finish(rng))
    floor.against_wall(rng, "plant", (0.3 + 0.35 * height, 0.3 + 0.35 * height, height), looks)


def add_crate(rng: Rng, floor: Floor) -> None:
    """A box on the floor."""
    look = (palette.board_finish(rng) if rng.random() < 0.5 else Finish("plain", (0.4, 0.27, 0.15), roughness=0.8),)
    size = (span(rng, 0.3, 0.6), span(rng, 0.3, 0.5), span(rng, 0.25, 0.6))
    floor.anywhere(rng, "crate", size, look, free_turn=True)


def add_pouf(rng: Rng, floor: Floor) -> None:
    """A round upholstered stool."""
    d = span(rng, 0.4, 0.6)
    floor.anywhere(rng, "pouf", (d, d, span(rng, 0.36, 0.48)), (palette.cloth_finish(rng),))


def add_floor_lamp(rng: Rng, floor: Floor) -> None:
    """A floor lamp at a wall; whether it is lit is decided later."""
    floor.against_wall(rng, "floor_lamp", (0.44, 0.44, span(rng, 1.4, 1.75)), (palette.metal_finish(rng),))


def add_pillar(rng: Rng, floor: Floor) -> None:
    """A column from the floor to the ceiling."""
    side = span(rng, 0.25, 0.45)
    look = Finish("paint", palette.wall_colour(rng), roughness=0.8)
    floor.anywhere(rng, "pillar", (side, side, floor.height - 0.05), (look,), gap_m=0.4)


def add_armchair(rng: Rng, floor: Floor) -> None:
    """An armchair, turned as one likes it."""
    cloth = palette.cloth_finish(rng)
    looks = (cloth, palette.wood_finish(rng), cloth)
    floor.anywhere(rng, "armchair", (0.95, 0.9, 0.85), looks, free_turn=rng.random() < 0.6)


EXTRAS: tuple[Callable[[Rng, Floor], None], ...] = (
    add_plant, add_plant, add_crate, add_pouf, add_floor_lamp, add_floor_lamp, add_armchair,
    lambda rng, floor: add_sideboard(rng, floor, 1.0), lambda rng, floor: add_bookcase(rng, floor, 1.0),
    lambda rng, floor: add_round_table(rng, floor, 1.0),
)  # fmt: skip


def add_radiators(rng: Rng, floor: Floor) -> None:
    """Radiators under windows, where there is room."""
    white = (Finish("plain", (0.75, 0.75, 0.73), roughness=0.3),)
    for hole in floor.holes:
        if hole.is_door or hole.bottom < 0.7 or rng.random() < 0.4:
            continue
        wall = floor.outline.walls[hole.wall]
        width = min(hole.high - hole.low, 1.4)
        x, y = wall.point((hole.low + hole.high) / 2, 0.08)
        floor.add(Piece("radiator", x, y, 0.0, wall.turn_deg, (width, 0.14, 0.62), white, int(rng.integers(2**31))))


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
    """One small thing."""
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
