"""Build `bedroom_night`: a bedroom lit by two bedside lamps of 2400 K and 2900 K, the rest in the dark.

Two small warm lights on either side of the virtual objects, and a window that shows the night: the case in which an
estimate from a few bright anchors is hardest. Virtual: a vase and a brushed gold ball on
the bench at the foot of the bed. The phone walks along the foot of the bed, from the window to the wardrobe.

The room is 4.2 m x 3.8 m x 2.5 m with its middle at the origin; the bed's head is at the +y wall.
"""

from __future__ import annotations

import bpy
import numpy as np
from staging import N_FRAMES, add_virtual, main, open_stage, walk_phone

from xihe_blender.lab.props import Collection, furniture
from xihe_blender.lab.props.lighting import add_table_lamp, set_sky
from xihe_blender.lab.props.room_shell import Opening, Room, add_shell
from xihe_blender.lab.props.shapes import Place, add_solid, ball, box, box_between, joined, revolved
from xihe_blender.lab.props.surfaces import carpet, curtain_cloth, fabric, foliage, paint, painting, plain, planks, wood

WINDOW = Opening("+x", -0.9, 0.5, 0.85, 2.15)
DOOR = Opening("-y", 0.9, 1.75, 0.0, 2.02, is_door=True)
ROOM = Room(4.2, 3.8, 2.5, openings=(WINDOW, DOOR))
CHEST_HEIGHT_M, BENCH_HEIGHT_M = 0.52, 0.45
LEFT_CHEST, RIGHT_CHEST = (-1.2, 1.62), (1.2, 1.62)


def build() -> bpy.types.Scene:
    """The whole scene in an empty file."""
    scene, room = open_stage("Bedroom at night")
    rng = np.random.default_rng(2400)
    add_walls(room)
    add_sleeping_place(room)
    add_rest(room, rng)
    add_lamps(scene, room)
    add_virtual_pieces(scene)
    add_walk(scene)
    return scene


def add_walls(room: Collection) -> None:
    """Shell, window, door and skirting."""
    wall, deep = paint("Wall paint", (0.6, 0.57, 0.52)), paint("Deep paint", (0.13, 0.2, 0.27))
    white = plain("White lacquer", (0.72, 0.72, 0.7), roughness=0.4)
    floor = planks("Walnut planks", (0.15, 0.08, 0.045), (0.25, 0.15, 0.085))
    steel = plain("Steel", (0.6, 0.6, 0.6), metallic=1.0, roughness=0.3)
    walls = {"+x": wall, "-x": wall, "+y": deep, "-y": wall}
    add_shell(room, ROOM, floor=floor, walls=walls, ceiling=wall, trim=white, handle=steel)


def add_sleeping_place(room: Collection) -> None:
    """Bed, bedside chests, the bench at its foot, a rug."""
    oak = wood("Oak", (0.26, 0.14, 0.065), (0.4, 0.23, 0.12))
    brass = plain("Brass", (0.75, 0.5, 0.2), metallic=1.0, roughness=0.3)
    linen, blanket = fabric("White linen", (0.7, 0.69, 0.66), contrast=0.05), fabric("Blanket", (0.35, 0.1, 0.08))
    furniture.add_bed(Place(room, "Bed", 0.0, 0.88), 1.6, oak, linen, blanket)
    for name, (x, y) in (("Left chest", LEFT_CHEST), ("Right chest", RIGHT_CHEST)):
        furniture.add_cabinet(Place(room, name, x, y), (0.48, 0.42, CHEST_HEIGHT_M), oak, brass, doors=1)
    furniture.add_bench(
        Place(room, "Bench", 0, -0.5), (1.2, 0.42, BENCH_HEIGHT_M), fabric("Bench cloth", (0.12, 0.22, 0.2)), oak
    )
    rug = carpet("Rug", (0.4, 0.36, 0.3), (0.12, 0.15, 0.2), (0.5, 0.42, 0.3))
    add_solid(room, "Rug", box_between((-1.4, -0.9, 0), (1.4, 0.9, 0.012)), rug, location=(0.0, -0.5, 0.0))


def add_rest(room: Collection, rng: np.random.Generator) -> None:
    """Wardrobe, pictures, curtains, plant, chair."""
    oak, brass = bpy.data.materials["Oak"], bpy.data.materials["Brass"]
    black, white = plain("Picture frame", (0.02, 0.02, 0.02), roughness=0.4), bpy.data.materials["White lacquer"]
    lacquer = plain("Wardrobe lacquer", (0.5, 0.5, 0.47), roughness=0.35)
    furniture.add_cabinet(Place(room, "Wardrobe", -1.81, -0.3, turn_deg=90), (1.7, 0.58, 2.15), lacquer, brass, doors=3)
    stops = [(0.3, (0.6, 0.5, 0.35)), (0.45, (0.3, 0.12, 0.06)), (0.55, (0.1, 0.16, 0.2)), (0.7, (0.6, 0.56, 0.5))]
    for i, x in enumerate((-0.45, 0.45)):
        art = painting(f"Print {i + 1}", stops[i:] + stops[:i] if i == 0 else stops, scale=1.4 + i)
        furniture.add_picture(Place(room, f"Picture {i + 1}", x, 1.9, 1.65), (0.5, 0.6), art, black, white)
    velvet = curtain_cloth("Velvet", (0.16, 0.2, 0.3))
    furniture.add_curtain_rod(Place(room, "Curtain rod", 2.0, -0.2, 2.28, 90), 2.3, black)
    furniture.add_curtain(Place(room, "Curtain left", 2.0, 0.65, 2.28, 90), 0.5, 2.23, velvet, seed=1)
    furniture.add_curtain(Place(room, "Curtain right", 2.0, -1.08, 2.28, 90), 0.5, 2.23, velvet, seed=2)
    furniture.add_chair(Place(room, "Chair", 1.6, -1.4, turn_deg=-60), oak, fabric("Chair cloth", (0.4, 0.3, 0.18)))
    leaves = foliage("Leaves", (0.02, 0.07, 0.015), (0.1, 0.22, 0.05))
    clay, soil = plain("Grey pot", (0.3, 0.3, 0.29), roughness=0.7), plain("Soil", (0.03, 0.02, 0.015), roughness=1.0)
    furniture.add_plant(Place(room, "Plant", -1.75, 1.5), leaves, clay, soil, rng, height=1.1, spread=0.35)
    books = [box((0.2, 0.14, 0.03), (0, 0, 0.015)), box((0.19, 0.13, 0.025)).turned(15).moved((0, 0, 0.043))]
    cover = plain("Book cloth", (0.07, 0.16, 0.25), roughness=0.7)
    Place(room, "Books", -1.3, 1.47, CHEST_HEIGHT_M, 70).add(joined(books), cover, bevel_m=0.003)


def add_lamps(scene: bpy.types.Scene, room: Collection) -> None:
    """The two bedside lamps and the night."""
    glaze = plain("Lamp glaze", (0.55, 0.5, 0.42), roughness=0.25)
    for name, (x, y), kelvin, watts in (("Left lamp", LEFT_CHEST, 2400, 10.0), ("Right lamp", RIGHT_CHEST, 2900, 15.0)):
        place = Place(room, name, x, y + 0.06, CHEST_HEIGHT_M)
        add_table_lamp(place, glaze, kelvin=kelvin, watts=watts, radiance=watts / 8, height=0.46)
    set_sky(scene, [(0.0, (0.1, 0.1, 0.12)), (0.5, (0.5, 0.45, 0.4)), (1.0, (0.1, 0.16, 0.4))], strength=0.015)


def add_virtual_pieces(scene: bpy.types.Scene) -> None:
    """A vase and a ball side by side on the bench."""
    side = [(0, 0), (0.06, 0), (0.066, 0.01), (0.085, 0.07), (0.09, 0.13), (0.078, 0.19), (0.05, 0.235), (0.045, 0.26),
            (0.062, 0.285), (0.056, 0.287), (0.038, 0.26), (0, 0.25)]  # fmt: skip
    glaze = plain("Virtual glaze", (0.45, 0.55, 0.56), roughness=0.4)
    add_virtual(scene, "Vase", revolved(side, 64), glaze, (-0.18, -0.5, BENCH_HEIGHT_M))
    gold = plain("Virtual gold", (0.85, 0.6, 0.3), metallic=1.0, roughness=0.3)
    add_virtual(scene, "Gold ball", ball(0.1, (0, 0, 0.1), 64), gold, (0.24, -0.46, BENCH_HEIGHT_M))


def add_walk(scene: bpy.types.Scene) -> None:
    """Along the foot of the bed in a shallow bow, looking at the bench and up the bed."""
    t = np.linspace(0, 1, N_FRAMES)
    positions = np.stack(
        [1.45 - 2.55 * t, -0.75 - 0.95 * np.sin(np.pi * t) ** 0.7, 1.45 + 0.08 * np.sin(2 * np.pi * t)], axis=-1
    )
    targets = np.stack([0.25 - 0.3 * t, 0 * t - 0.1, 0.72 + 0.1 * np.sin(np.pi * t)], axis=-1)
    walk_phone(scene, positions, targets, seed=8)


if __name__ == "__main__":
    main(build, __file__)
