"""Furniture of a room: tables, chairs, sofas, beds, shelves, plants, curtains, pictures, radiators.

Each function puts one piece in its place and takes its materials as arguments, so that a scene chooses its own palette.
Pieces are a few objects of one material each. Randomness (books, leaves) comes from a generator argument.
"""

from __future__ import annotations

from itertools import pairwise

import bpy
import numpy as np
from numpy.typing import NDArray

from xihe_blender.lab.props import Material, Vector
from xihe_blender.lab.props.shapes import Place, Solid, box, box_between, cylinder, joined, revolved, sheet, tube

BED_LENGTH_M, MATTRESS_TOP_M = 2.0, 0.52


def _posts(width: float, height: float, x: float, y: float) -> list[Solid]:
    """Four square legs of a `width` around the points (±x, ±y)."""
    return [box((width, width, height), (a, b, height / 2)) for a in (-x, x) for b in (-y, y)]


def add_table(place: Place, size: Vector, top: Material, legs: Material, *, leg_m: float = 0.06) -> None:
    """A table of full extents `size` with four legs and an apron."""
    x, y, z = size
    place.add(box_between((-x / 2, -y / 2, z - 0.035), (x / 2, y / 2, z)), top, "top", bevel_m=0.008)
    a, b = x / 2 - leg_m, y / 2 - leg_m
    frame = _posts(leg_m, z - 0.035, a, b)
    frame += [box((2 * a, 0.022, 0.08), (0, s * b, z - 0.075)) for s in (-1, 1)]
    frame += [box((0.022, 2 * b, 0.08), (s * a, 0, z - 0.075)) for s in (-1, 1)]
    place.add(joined(frame), legs, "legs", bevel_m=0.006)


def add_round_table(place: Place, radius: float, height: float, top: Material, foot: Material) -> None:
    """A round side table on three slanted legs."""
    r, h = radius, height
    edge = [(0, h - 0.03), (r - 0.01, h - 0.03), (r, h - 0.02), (r, h - 0.005), (r - 0.005, h), (0, h)]
    place.add(revolved(edge, 48), top, "top", smooth=True)
    angles = np.radians([90, 210, 330])
    feet = np.stack([np.cos(angles), np.sin(angles)], -1)
    legs = [tube((0.95 * r * c, 0.95 * r * s, 0), (0.5 * r * c, 0.5 * r * s, h - 0.03), 0.016) for c, s in feet]
    place.add(joined(legs), foot, "legs", smooth=True)


def add_chair(place: Place, frame: Material, seat: Material) -> None:
    """A dining chair that looks towards -Y."""
    legs = [tube((x * 1.12, -0.2, 0), (x, -0.18, 0.43), 0.017) for x in (-0.18, 0.18)]
    legs += [tube((x * 1.12, 0.24, 0), (x, 0.19, 0.44), 0.017) for x in (-0.18, 0.18)]
    legs += [tube((x, 0.19, 0.44), (x * 0.95, 0.26, 0.84), 0.016) for x in (-0.18, 0.18)]
    legs += [tube((-0.175, 0.25, z), (0.175, 0.25, z), 0.011) for z in (0.55, 0.62)]
    place.add(joined(legs), frame, "frame", smooth=True)
    place.add(curved_board(0.4, 0.16, 0.03).moved((0, 0.255, 0.78)), frame, "back", smooth=True)
    place.add(cushion(0.44, 0.43, 0.06).moved((0, 0, 0.455)), seat, "seat", subdivisions=2)


def curved_board(width: float, height: float, bulge: float) -> Solid:
    """A chair's back rest: a board bent backwards in the middle."""
    u = np.linspace(-1, 1, 9)
    front = [(width / 2 * a, bulge * (1 - a * a), s * height / 2) for s in (-1, 1) for a in u.tolist()]
    grid = np.array(front + [(x, y + 0.02, -z) for x, y, z in front] + front[:9]).reshape(5, 9, 3)
    return sheet(grid)


def cushion(width: float, length: float, height: float) -> Solid:
    """A coarse pillow; two levels of subdivision make it soft. The inner loops keep its seams."""
    u = np.array([-0.5, -0.42, 0.0, 0.42, 0.5])
    x, y = np.meshgrid(u, u)
    puff = np.where(np.maximum(abs(x), abs(y)) > 0.45, 0.32, 0.5) + 0.12 * (np.maximum(abs(x), abs(y)) < 0.1)
    faces = [np.stack([x * width, y * length, s * puff * height], -1) for s in (1, -1)]
    top, bottom = sheet(faces[0]), sheet(faces[1][:, ::-1])
    index = np.arange(25).reshape(5, 5)
    upper, lower = _rim(index), _rim(25 + index[:, ::-1])
    sides = [(lower[i - 1], lower[i], upper[i], upper[i - 1]) for i in [*range(1, 16), 0]]
    both = joined([top, bottom])
    return Solid(both.vertices, [*both.faces, *sides])


def _rim(grid: NDArray[np.int_]) -> list[int]:
    """What lies along the edge of a grid, once around."""
    return [int(i) for side in (grid[0, :-1], grid[:-1, -1], grid[-1, :0:-1], grid[:0:-1, 0]) for i in side]


def add_sofa(place: Place, width: float, cloth: Material, feet: Material, throws: list[Material]) -> None:
    """A sofa with arms, one seat and one back cushion per 0.7 m, and throw cushions of the given materials."""
    half = width / 2
    body = [box_between((-half + 0.05, -0.4, 0.12), (half - 0.05, 0.4, 0.3))]
    body += [
        box_between((x, -0.42, 0.12), (end, 0.42, 0.58)) for x, end in ((-half, -half + 0.18), (half - 0.18, half))
    ]
    body.append(box_between((-half + 0.1, 0.26, 0.12), (half - 0.1, 0.44, 0.78)))
    place.add(joined(body), cloth, "body", bevel_m=0.045, smooth=True)
    n = max(1, round((width - 0.36) / 0.7))
    seat = (width - 0.38) / n
    for i in range(n):
        x = -half + 0.19 + seat * (i + 0.5)
        below = cushion(seat, 0.72, 0.19).moved((x, -0.09, 0.39))
        place.add(below, cloth, f"seat {i + 1}", subdivisions=2)
        back = cushion(seat, 0.44, 0.18).turned(78, "X").moved((x, 0.2, 0.66))
        place.add(back, cloth, f"back {i + 1}", subdivisions=2)
    for i, material in enumerate(throws):
        x = (-1) ** i * (half - 0.42 - 0.2 * (i // 2))
        throw = cushion(0.42, 0.42, 0.15).turned(64, "X").turned(-18 * (-1) ** i).moved((x, -0.02, 0.66))
        place.add(throw, material, f"throw cushion {i + 1}", subdivisions=2)
    stubs = [cylinder(0.025, 0.12).moved((x, y, 0)) for x in (-half + 0.1, half - 0.1) for y in (-0.34, 0.36)]
    place.add(joined(stubs), feet, "feet", smooth=True)


def add_bed(place: Place, width: float, frame: Material, linen: Material, blanket: Material) -> None:
    """A double bed, its head at +Y: frame, mattress, four pillows, a blanket over the lower two thirds."""
    x, y = width / 2, BED_LENGTH_M / 2
    parts = [box_between((-x - 0.04, y, 0), (x + 0.04, y + 0.05, 1.05)), box((2 * x + 0.06, 2 * y, 0.14), (0, 0, 0.25))]
    parts += [box((0.07, 0.07, 0.2), (s * (x - 0.05), -y + 0.08, 0.1)) for s in (-1, 1)]
    place.add(joined(parts), frame, "frame", bevel_m=0.012)
    mattress = box_between((-x, -y + 0.01, 0.3), (x, y - 0.01, MATTRESS_TOP_M))
    place.add(mattress, linen, "mattress", bevel_m=0.05, smooth=True)
    pillows = ((-0.38, y - 0.16, 48), (0.38, y - 0.16, 48), (-0.4, y - 0.42, 22), (0.39, y - 0.4, 24))
    for i, (px, py, tilt) in enumerate(pillows):
        pillow = cushion(0.68, 0.44, 0.17).turned(tilt, "X").turned(-4 + 3 * i)
        lying = pillow.moved((px * width / 1.6, py, MATTRESS_TOP_M + (0.2 if i < 2 else 0.12)))
        place.add(lying, linen, f"pillow {i + 1}", subdivisions=2)
    place.add(_blanket(width, 1.45), blanket, "blanket", smooth=True, subdivisions=1)


def _blanket(width: float, length: float) -> Solid:
    """A blanket that lies on the mattress, hangs over both sides and the foot, and creases."""
    u, v = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(0, 1, 31))
    reach, foot = width / 2 + 0.28, length + 0.25
    across, along = u * reach, -BED_LENGTH_M / 2 + length - v * foot
    over_side = np.clip(abs(across) - width / 2 - 0.02, 0, None)
    over_foot = np.clip(-BED_LENGTH_M / 2 - 0.02 - along, 0, None)
    crease = 0.008 * np.sin(9 * across + 4 * along) + 0.007 * np.sin(5 * across - 11 * along + 1.0)
    x = np.sign(across) * np.minimum(abs(across), width / 2 + 0.02 + 0.12 * over_side) + 2 * crease * (over_side > 0)
    y = np.maximum(along, -BED_LENGTH_M / 2 - 0.02 - 0.12 * over_foot) + 2 * crease * (over_foot > 0)
    z = MATTRESS_TOP_M + 0.025 + crease - np.maximum(over_side, over_foot)
    return sheet(np.stack([x, y, z], -1)[::-1])


def add_bench(place: Place, size: Vector, cloth: Material, legs: Material) -> None:
    """An upholstered bench on four legs, of full extents `size`; its seat is flat, so that things stand on it."""
    x, y, z = size
    place.add(box_between((-x / 2, -y / 2, z - 0.12), (x / 2, y / 2, z)), cloth, "seat", bevel_m=0.025, smooth=True)
    place.add(joined(_posts(0.045, z - 0.12, x / 2 - 0.06, y / 2 - 0.05)), legs, "legs", bevel_m=0.005)


def add_bookcase(
    place: Place, size: Vector, body: Material, books: Material, rng: np.random.Generator, *, n_shelves: int = 5
) -> None:
    """An open bookcase, its back at +Y, filled with rows of books that leave gaps. `books` reads a face colour."""
    x, y, z = size
    sides = ((-x / 2, -x / 2 + 0.025), (x / 2 - 0.025, x / 2))
    boards = [box_between((low, -y / 2, 0), (high, y / 2, z)) for low, high in sides]
    boards.append(box_between((-x / 2, y / 2 - 0.012, 0), (x / 2, y / 2, z)))
    levels = np.linspace(0.06, z - 0.025, n_shelves + 1).tolist()
    boards += [box_between((-x / 2 + 0.025, -y / 2, h), (x / 2 - 0.025, y / 2, h + 0.025)) for h in levels]
    place.add(joined(boards), body, "body", bevel_m=0.003)
    spines = []
    for low, high in pairwise(levels):
        spines += book_row(x - 0.08, high - low - 0.03, y, rng, (-x / 2 + 0.04, 0.0, low + 0.026))
    shelf = place.add(joined(spines), books, "books")
    colour_boxes(shelf, rng)


def book_row(width: float, height: float, row_y: float, rng: np.random.Generator, corner: Vector) -> list[Solid]:
    """Upright books from the left up to some 60 to 100 % of the shelf, then one that leans."""
    row, x, end = [], 0.0, width * rng.uniform(0.6, 1.0)
    while x < end - 0.05:
        thick, tall, wide = rng.uniform(0.014, 0.045), height * rng.uniform(0.62, 0.95), row_y * rng.uniform(0.55, 0.8)
        row.append(box((thick - 0.001, wide, tall), (x + thick / 2, 0.02, tall / 2)).moved(corner))
        x += thick
    if width - x > 0.14:
        tall = height * 0.75
        leaning = box((0.03, row_y * 0.65, tall)).turned(-14, "Y")
        row.append(leaning.moved((corner[0] + x + 0.09, 0.02, corner[2] + tall / 2)))
    return row


BOOK_COLOURS = np.array([
    (0.45, 0.06, 0.04), (0.05, 0.12, 0.28), (0.06, 0.2, 0.12), (0.6, 0.5, 0.33), (0.7, 0.66, 0.58), (0.03, 0.03, 0.035),
    (0.5, 0.22, 0.05), (0.22, 0.05, 0.1), (0.1, 0.25, 0.3), (0.62, 0.4, 0.08), (0.3, 0.28, 0.26),
])  # fmt: skip


def colour_boxes(thing: bpy.types.Object, rng: np.random.Generator) -> None:
    """Give each box of a joined mesh one of the book colours, in the face-corner attribute `Colour`."""
    n_boxes = len(thing.data.polygons) // 6
    tones = BOOK_COLOURS[rng.integers(len(BOOK_COLOURS), size=n_boxes)] * rng.uniform(0.7, 1.2, (n_boxes, 1))
    colours = np.concatenate([np.repeat(tones.clip(0, 0.8), 24, axis=0), np.ones((24 * n_boxes, 1))], axis=1)
    layer = thing.data.color_attributes.new("Colour", "FLOAT_COLOR", "CORNER")
    layer.data.foreach_set("color", colours.astype(np.float32).ravel())


def add_cabinet(place: Place, size: Vector, body: Material, knobs: Material, *, doors: int | None = None) -> None:
    """A sideboard, wardrobe or bedside chest: a body on short feet, doors towards -Y (None: by the width), knobs."""
    x, y, z = size
    carcass = [box_between((-x / 2, -y / 2 + 0.02, 0.08), (x / 2, y / 2, z))]
    carcass.append(box_between((-x / 2 + 0.04, -y / 2 + 0.06, 0), (x / 2 - 0.04, y / 2 - 0.04, 0.08)))
    doors = doors or max(1, round(x / 0.55))
    leaf = (x - 0.02) / doors
    for i in range(doors):
        low = -x / 2 + 0.01 + leaf * i
        carcass.append(box_between((low + 0.004, -y / 2, 0.1), (low + leaf - 0.004, -y / 2 + 0.02, z - 0.03)))
    place.add(joined(carcass), body, bevel_m=0.004)
    sides = [-x / 2 + 0.01 + leaf * i + (0.05 if i % 2 else leaf - 0.05) for i in range(doors)]
    grips = [box((0.014, 0.03, 0.12), (side, -y / 2 - 0.015, 0.55 * z)) for side in sides]
    place.add(joined(grips), knobs, "handles", bevel_m=0.004)


def add_picture(place: Place, size: Vector, picture: Material, frame: Material, mount: Material) -> None:
    """A framed picture with a mount; its back is at y = 0, its centre at the place's height."""
    x, z = size
    bars = [box((x + 0.06, 0.03, 0.03), (0, -0.015, s * (z / 2 + 0.015))) for s in (-1, 1)]
    bars += [box((0.03, 0.03, z), (s * (x / 2 + 0.015), -0.015, 0)) for s in (-1, 1)]
    place.add(joined(bars), frame, "frame", bevel_m=0.003)
    place.add(box((x, 0.01, z), (0, -0.006, 0)), mount, "mount")
    place.add(box((x * 0.74, 0.004, z * 0.74), (0, -0.0125, 0)), picture, "picture")


def add_radiator(place: Place, width: float, height: float, enamel: Material) -> None:
    """A ribbed radiator whose back is at y = 0."""
    n = round(width / 0.05)
    ribs = [box((0.034, 0.07, height), (width * ((i + 0.5) / n - 0.5), -0.07, height / 2 + 0.12)) for i in range(n)]
    ribs += [box((width, 0.03, 0.04), (0, -0.07, z)) for z in (0.16, height + 0.08)]
    ribs += [tube((s * width * 0.46, -0.07, 0), (s * width * 0.46, -0.07, 0.16), 0.01) for s in (-1, 1)]
    place.add(joined(ribs), enamel, bevel_m=0.01, smooth=True)


def add_curtain(place: Place, width: float, height: float, cloth: Material, *, seed: int) -> None:
    """A hanging curtain in folds, its top at the place's height."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, 3)
    u, v = np.meshgrid(np.linspace(0, 1, 15 * round(width / 0.11)), np.linspace(0, 1, 7))
    folds = 2 * np.pi * u * round(width / 0.11)
    sway = 0.045 * np.sin(folds + phase[0] + 0.5 * np.sin(2 * v + phase[1])) * (0.75 + 0.35 * v)
    spread = (u - 0.5) * width * (1 + 0.08 * v * v) + 0.012 * np.sin(2 * folds + phase[2])
    place.add(sheet(np.stack([spread, sway, -v * height], -1)), cloth, smooth=True)


def add_curtain_rod(place: Place, width: float, metal: Material) -> None:
    """A rod along X with knobs at its ends."""
    knob = [(0, -0.03), (0.02, -0.018), (0.028, 0), (0.02, 0.018), (0, 0.03)]
    parts = [tube((-width / 2, 0, 0), (width / 2, 0, 0), 0.012)]
    parts += [revolved(knob, 16).moved((s * width / 2, 0, 0)) for s in (-1, 1)]
    place.add(joined(parts), metal, smooth=True)


def add_plant(
    place: Place, leaves: Material, pot: Material, soil: Material, rng: np.random.Generator,
    *, n_leaves: int = 26, height: float = 0.9, spread: float = 0.4, pot_radius: float = 0.17,
) -> None:  # fmt: skip
    """A potted plant: arching leaves that start at the pot."""
    r, h = pot_radius, 1.9 * pot_radius
    vessel = [(0, 0), (0.7 * r, 0), (r, h), (0.9 * r, h), (0.86 * r, h - 0.03)]
    place.add(revolved(vessel, 32), pot, "pot", smooth=True)
    place.add(cylinder(0.87 * r, 0.02).moved((0, 0, h - 0.05)), soil, "soil")
    blades = []
    for i in range(n_leaves):
        reach, rise = spread * rng.uniform(0.4, 1.1), (height - h) * rng.uniform(0.45, 1.0)
        blade = arching_leaf(reach, rise, width=rng.uniform(0.05, 0.09) * height / 0.9)
        blades.append(blade.turned(137.5 * i + rng.uniform(-15, 15)).moved((0, 0, h - 0.04)))
    place.add(joined(blades), leaves, "leaves", smooth=True)


def arching_leaf(reach: float, rise: float, width: float) -> Solid:
    """A leaf that rises from the origin, bends over towards +X and ends in a point."""
    t = np.linspace(0, 1, 8)
    x, z = reach * t**1.4, rise * np.sin(2.1 * t) / np.sin(2.1) * (1.1 - 0.1 * t) * 0.9
    half = width * np.clip(np.sin(np.pi * t**0.8), 0.0, None) ** 0.8 * 0.5 + 0.003
    rows = [np.stack([x, s * half, z + abs(s) * half * 0.35], -1) for s in (-1.0, 0.0, 1.0)]
    return sheet(np.stack(rows))
