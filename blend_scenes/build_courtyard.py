"""Build `courtyard`: a paved court before a house, under the open evening sky.

The light is a CC0 panorama that Blender ships (`sunset.exr`), packed: a wide bright sky, and a sun a few degrees above
the horizon that reaches over the low walls. `courtyard.exr` of the same set was rejected: it was taken under a roof.
Virtual: the three-sphere rig, radius 0.09, on the table. The phone walks round the table, the house in view half of the
way and the open side with the low sun the other half.

The court is 7 m x 6 m, its middle at the origin; the house stands at y = 3, the low walls on the other three sides.
"""

from __future__ import annotations

import bpy
import numpy as np
from staging import arc, main, open_stage, walk_phone

from xihe_blender.lab.props import Collection, Material, Vector
from xihe_blender.lab.props.furniture import add_chair, add_plant, add_round_table
from xihe_blender.lab.props.lighting import set_panorama
from xihe_blender.lab.props.room_shell import Opening, Room, add_door, add_window, wall_solid
from xihe_blender.lab.props.shapes import Place, Solid, add_solid, box, box_between, joined, tube
from xihe_blender.lab.props.surfaces import fabric, foliage, masonry, paint, plain, wood
from xihe_blender.scene.sphere_rig import add_three_sphere_rig

DOOR = Opening("+y", -0.55, 0.55, 0.0, 2.25, is_door=True)
WINDOWS = (
    Opening("+y", -2.9, -1.5, 0.9, 2.25),
    Opening("+y", 1.5, 2.9, 0.9, 2.25),
)
HOUSE = Room(8.4, 6.0, 4.2, wall_m=0.35, openings=(DOOR, *WINDOWS))
TABLE_HEIGHT_M = 0.74
PANORAMA_TURN_DEG = 100.0


def build() -> bpy.types.Scene:
    """The whole scene in an empty file."""
    scene, room = open_stage("Courtyard")
    rng = np.random.default_rng(9)
    add_house(room)
    add_court(room)
    add_pieces(room, rng)
    set_panorama(scene, "sunset.exr", strength=1.2, turn_deg=PANORAMA_TURN_DEG)
    add_three_sphere_rig(scene, (0.05, 0.0, TABLE_HEIGHT_M), 0.09)
    positions = arc((0.0, 0.0), 1.75, (-170, 30), (1.5, 1.42))
    targets = np.tile((0.05, 0.05, 0.92), (len(positions), 1))
    walk_phone(scene, positions, targets, seed=17)
    return scene


def add_house(room: Collection) -> None:
    """The facade with a door, two windows with shutters and dark panes, and the eaves."""
    plaster = paint("Ochre plaster", (0.55, 0.36, 0.19), mottling=0.14, roughness=0.9)
    trim = plain("Trim", (0.68, 0.66, 0.6), roughness=0.6)
    green = plain("Green lacquer", (0.05, 0.14, 0.11), roughness=0.4)
    stone = plain("Sill stone", (0.5, 0.48, 0.44), roughness=0.8)
    pane = plain("Panes", (0.02, 0.025, 0.03), roughness=0.03)
    add_solid(room, "Facade", wall_solid(HOUSE, "+y"), plaster)
    add_door(room, HOUSE, DOOR, green, trim, plain("Brass", (0.75, 0.5, 0.2), metallic=1.0, roughness=0.3))
    for side, window in zip(("left", "right"), WINDOWS, strict=True):
        add_window(room, HOUSE, window, trim, stone)
        glass = HOUSE.wall_box("+y", (window.low, window.high), (0.125, 0.135), (window.bottom, window.top))
        add_solid(room, f"Panes {side}", glass, pane)
        leaves = []
        for low in (window.low - 0.66, window.high + 0.02):
            leaves.append(HOUSE.wall_box("+y", (low, low + 0.64), (-0.035, 0.0), (window.bottom, window.top)))
            heights = np.arange(window.bottom + 0.08, window.top - 0.06, 0.07).tolist()
            leaves += [HOUSE.wall_box("+y", (low + 0.06, low + 0.58), (-0.05, -0.03), (z, z + 0.045)) for z in heights]
        add_solid(room, f"Shutters {side}", joined(leaves), green, bevel_m=0.004)
    eaves = [
        HOUSE.wall_box("+y", (-4.6, 4.6), (-0.5, 0.6), (4.2, 4.32)),
        HOUSE.wall_box("+y", (-4.6, 4.6), (-0.6, -0.5), (4.16, 4.3)),
    ]
    add_solid(room, "Eaves", joined(eaves), wood("Eaves wood", (0.12, 0.07, 0.04), (0.2, 0.12, 0.07)))
    plinth = [HOUSE.wall_box("+y", ends, (-0.03, 0.0), (0.0, 0.35)) for ends in ((-4.2, -0.64), (0.64, 4.2))]
    add_solid(room, "Plinth", joined(plinth), stone, bevel_m=0.005)


def add_court(room: Collection) -> None:
    """Paving and the low walls, with a gap for the gate."""
    slabs = ((0.4, 0.36, 0.31), (0.29, 0.27, 0.25), (0.12, 0.115, 0.1))
    paving = masonry("Paving", slabs, (0.62, 0.42), joint_m=0.012)
    add_solid(room, "Paving", box_between((-3.9, -3.4, -0.1), (3.9, 3.0, 0.0)), paving)
    bricks = ((0.36, 0.15, 0.09), (0.25, 0.1, 0.065), (0.4, 0.37, 0.32))
    brick = masonry("Bricks", bricks, (0.25, 0.075), joint_m=0.012, upright=True)
    runs = [
        ((-3.6, -3.0), (-3.6, 2.85)),
        ((3.6, -3.0), (3.6, 2.85)),
        ((-3.4, -3.1), (-0.7, -3.1)),
        ((0.7, -3.1), (3.4, -3.1)),
    ]
    walls, copings = zip(*(low_wall(start, end, 0.85, 0.24) for start, end in runs), strict=True)
    add_solid(room, "Low walls", joined(walls), brick)
    add_solid(room, "Coping", joined(copings), plain("Coping stone", (0.45, 0.43, 0.39), roughness=0.85), bevel_m=0.01)
    bars = [tube((x, -3.1, 0.08), (x, -3.1, 0.95), 0.01, 8) for x in np.linspace(-0.55, 0.55, 11).tolist()]
    bars += [tube((-0.57, -3.1, z), (0.57, -3.1, z), 0.014, 8) for z in (0.15, 0.85)]
    add_solid(room, "Gate", joined(bars), plain("Wrought iron", (0.03, 0.03, 0.03), roughness=0.5), smooth=True)


def add_pieces(room: Collection, rng: np.random.Generator) -> None:
    """Table, chairs, bench, planters and pots."""
    teak = wood("Teak", (0.22, 0.12, 0.06), (0.36, 0.21, 0.11), roughness=0.65)
    iron = bpy.data.materials["Wrought iron"]
    stone = plain("Trough stone", (0.36, 0.34, 0.31), roughness=0.9)
    soil = plain("Soil", (0.03, 0.02, 0.015), roughness=1.0)
    clay = plain("Terracotta", (0.42, 0.16, 0.08), roughness=0.85)
    box_leaves = foliage("Box leaves", (0.015, 0.05, 0.01), (0.07, 0.15, 0.03))
    grey_leaves = foliage("Olive leaves", (0.06, 0.09, 0.05), (0.17, 0.22, 0.13))
    add_round_table(Place(room, "Table", 0.0, 0.0), 0.48, TABLE_HEIGHT_M, teak, iron)
    seat = fabric("Seat cloth", (0.5, 0.44, 0.33))
    add_chair(Place(room, "Chair 1", -0.15, 0.78, turn_deg=8), iron, seat)
    add_chair(Place(room, "Chair 2", 0.75, -0.1, turn_deg=-96), iron, seat)
    add_bench(Place(room, "Bench", -3.1, 0.2, turn_deg=90), 1.7, teak, iron)
    add_planter(Place(room, "Planter 1", 2.1, -2.6), (1.9, 0.5, 0.45), stone, soil, box_leaves, rng, shrub_m=0.34)
    add_planter(Place(room, "Planter 2", -2.1, -2.6), (1.9, 0.5, 0.45), stone, soil, grey_leaves, rng, shrub_m=0.34)
    add_planter(
        Place(room, "Planter 3", 3.1, 0.3, turn_deg=90), (1.8, 0.5, 0.45), stone, soil, box_leaves, rng, shrub_m=0.4
    )
    for i, x in enumerate((-0.95, 0.95)):
        add_plant(
            Place(room, f"Pot {i + 1}", x, 2.65), grey_leaves, clay, soil, rng, height=1.2, spread=0.4, n_leaves=40
        )


def add_bench(place: Place, width: float, slats: Material, iron: Material) -> None:
    """A garden bench with slats, its back at +Y."""
    boards = [box((width, 0.085, 0.03), (0, -0.22 + 0.1 * i, 0.44)) for i in range(5)]
    back = box((width, 0.03, 0.09)).turned(-12, "X")
    boards += [back.moved((0, 0.25 + 0.024 * i, 0.56 + 0.12 * i)) for i in range(3)]
    place.add(joined(boards), slats, "slats", bevel_m=0.006)
    sides = []
    for x in (-width / 2 + 0.15, width / 2 - 0.15):
        sides += [box((0.04, 0.04, 0.43), (x, y, 0.215)) for y in (-0.22, 0.2)]
        sides += [box((0.04, 0.5, 0.03), (x, 0, 0.415)), box((0.03, 0.03, 0.5)).turned(-12, "X").moved((x, 0.25, 0.63))]
    place.add(joined(sides), iron, "frame", bevel_m=0.004)


def add_planter(
    place: Place, size: Vector, stone: Material, soil: Material, leaves: Material, rng: np.random.Generator,
    *, shrub_m: float,
) -> None:  # fmt: skip
    """A trough of full extents `size` with a row of round shrubs of radius `shrub_m`."""
    x, y, z = size
    rims = [box((x, 0.05, z), (0, s * (y / 2 - 0.025), z / 2)) for s in (-1, 1)]
    rims += [box((0.05, y - 0.1, z), (s * (x / 2 - 0.025), 0, z / 2)) for s in (-1, 1)]
    place.add(joined(rims), stone, "trough", bevel_m=0.008)
    place.add(box((x - 0.1, y - 0.1, z - 0.06), (0, 0, (z - 0.06) / 2)), soil, "soil")
    n = max(1, round(x / (1.6 * shrub_m)))
    middles = [(x - 0.2) * ((i + 0.5) / n - 0.5) for i in range(n)]
    bushes = [shrub(shrub_m * rng.uniform(0.85, 1.1), rng).moved((c, 0, z + 0.6 * shrub_m)) for c in middles]
    place.add(joined(bushes), leaves, "shrubs")


def shrub(radius: float, rng: np.random.Generator) -> Solid:
    """Small leaves scattered near the surface of an uneven ball, facing roughly outwards."""
    n_leaves, leaf_m = 420, 0.09
    out = rng.normal(size=(n_leaves, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    uneven = 1 + 0.12 * np.sin(5 * out[:, :1] + 2) + 0.12 * np.sin(6 * out[:, 1:2]) + 0.1 * np.sin(7 * out[:, 2:])
    middles = out * radius * uneven * rng.uniform(0.65, 1.0, (n_leaves, 1)) * (1.0, 1.0, 0.9)
    along = np.cross(out + rng.normal(scale=0.5, size=out.shape), rng.normal(size=out.shape))
    along *= leaf_m / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(out, along) * 0.5
    corners = np.stack([middles - along, middles + across, middles + along, middles - across], axis=1)
    return Solid(corners.reshape(-1, 3), np.arange(4 * n_leaves).reshape(-1, 4).tolist())


def low_wall(start: Vector, end: Vector, height: float, thickness: float) -> tuple[Solid, Solid]:
    """A wall along X or Y between two points, and its coping."""
    low = (min(start[0], end[0]) - thickness / 2, min(start[1], end[1]) - thickness / 2)
    high = (max(start[0], end[0]) + thickness / 2, max(start[1], end[1]) + thickness / 2)
    cap = 0.03
    coping = box_between((low[0] - cap, low[1] - cap, height), (high[0] + cap, high[1] + cap, height + 0.06))
    return box_between((*low, 0.0), (*high, height)), coping


if __name__ == "__main__":
    main(build, __file__)
