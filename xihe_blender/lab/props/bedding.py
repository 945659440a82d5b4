"""What one sleeps on: a bed with pillows and a blanket, and the bench at its foot."""

from __future__ import annotations

from typing import TypeAlias

import bpy
import numpy as np

from xihe_blender.lab.props.furniture import Place, cushion
from xihe_blender.lab.props.shapes import Solid, Vector, add_solid, box, box_between, joined, sheet

Material: TypeAlias = bpy.types.Material
Collection: TypeAlias = bpy.types.Collection
BED_LENGTH_M, MATTRESS_TOP_M = 2.0, 0.52


def add_bed(
    room: Collection, name: str, width: float, frame: Material, linen: Material, blanket: Material, *, place: Place
) -> None:
    """A double bed, its head at +Y: frame, mattress, four pillows, a blanket over the lower two thirds."""
    x, y = width / 2, BED_LENGTH_M / 2
    parts = [box_between((-x - 0.04, y, 0), (x + 0.04, y + 0.05, 1.05)), box((2 * x + 0.06, 2 * y, 0.14), (0, 0, 0.25))]
    parts += [box((0.07, 0.07, 0.2), (s * (x - 0.05), -y + 0.08, 0.1)) for s in (-1, 1)]
    add_solid(room, f"{name} frame", joined(parts), frame, bevel_m=0.012, **place)
    mattress = box_between((-x, -y + 0.01, 0.3), (x, y - 0.01, MATTRESS_TOP_M))
    add_solid(room, f"{name} mattress", mattress, linen, bevel_m=0.05, smooth=True, **place)
    for i, (px, py, tilt) in enumerate(
        ((-0.38, y - 0.16, 48), (0.38, y - 0.16, 48), (-0.4, y - 0.42, 22), (0.39, y - 0.4, 24))
    ):
        pillow = cushion(0.68, 0.44, 0.17).turned(tilt, "X").turned(-4 + 3 * i)
        lying = pillow.moved((px * width / 1.6, py, MATTRESS_TOP_M + (0.2 if i < 2 else 0.12)))
        add_solid(room, f"{name} pillow {i + 1}", lying, linen, subdivisions=2, **place)
    add_solid(room, f"{name} blanket", blanket_solid(width, 1.45), blanket, smooth=True, location=place["location"],
              turn_deg=place["turn_deg"], subdivisions=1)  # fmt: skip


def blanket_solid(width: float, length: float) -> Solid:
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


def add_bench(room: Collection, name: str, size: Vector, cloth: Material, legs: Material, *, place: Place) -> None:
    """An upholstered bench on four legs, of full extents `size`; its seat is flat, so that things stand on it."""
    x, y, z = size
    seat = box_between((-x / 2, -y / 2, z - 0.12), (x / 2, y / 2, z))
    add_solid(room, f"{name} seat", seat, cloth, bevel_m=0.025, smooth=True, **place)
    posts = [
        box((0.045, 0.045, z - 0.12), (a, b, (z - 0.12) / 2))
        for a in (-x / 2 + 0.06, x / 2 - 0.06)
        for b in (-y / 2 + 0.05, y / 2 - 0.05)
    ]
    add_solid(room, f"{name} legs", joined(posts), legs, bevel_m=0.005, **place)
