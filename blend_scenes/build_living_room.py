"""Build `living_room`: a living room by day, walked around its table.

Daylight and a patch of sun come through one wide window in the +y wall, a floor lamp of 2700 K burns in the corner by
the sofa. Two virtual objects: a glazed vase on the table and a brushed metal sphere on the stool behind it, both out of
the sun. The phone goes round the table from the sofa's side past the sideboard to the television.

The room is 5.4 m x 4.6 m x 2.6 m, its middle at the origin.
"""

from __future__ import annotations

import bpy
import numpy as np
from staging import add_virtual, arc, main, open_stage, walk_phone

from xihe_blender.lab.props import Collection, furniture, surfaces
from xihe_blender.lab.props.lighting import add_floor_lamp, add_pendant, add_sun, set_sky
from xihe_blender.lab.props.room_shell import Opening, Room, add_shell
from xihe_blender.lab.props.shapes import Place, add_solid, ball, box, box_between, joined, revolved

WINDOW = Opening("+y", -0.2, 2.2, 0.8, 2.25)
DOOR = Opening("-y", -2.35, -1.5, 0.0, 2.02, is_door=True)
ROOM = Room(5.4, 4.6, 2.6, openings=(WINDOW, DOOR))
TABLE = (0.25, 0.0, 0.74)
VASE_PLACE = (0.0, 0.05, 0.74)
SPHERE_PLACE, SPHERE_RADIUS_M = (-0.4, 1.2, 0.5), 0.13


def build() -> bpy.types.Scene:
    """The whole scene in an empty file."""
    scene, room = open_stage("Living room")
    rng = np.random.default_rng(20210624)
    add_walls(room)
    add_seating(room)
    add_storage(room, rng)
    add_decoration(room, rng)
    add_garden(room)
    add_light(scene, room)
    add_virtual_pieces(scene)
    add_walk(scene)
    return scene


def add_walls(room: Collection) -> None:
    """Shell, window, door and skirting."""
    wall = surfaces.paint("Wall paint", (0.68, 0.65, 0.58))
    accent = surfaces.paint("Accent paint", (0.2, 0.31, 0.3))
    white = surfaces.plain("White lacquer", (0.75, 0.75, 0.73), roughness=0.35)
    floor = surfaces.planks("Oak planks", (0.27, 0.15, 0.075), (0.42, 0.26, 0.14))
    walls = {"+x": wall, "-x": accent, "+y": wall, "-y": wall}
    ceiling = surfaces.paint("Ceiling paint", (0.78, 0.78, 0.76))
    steel = surfaces.plain("Steel", (0.6, 0.6, 0.6), metallic=1.0, roughness=0.3)
    add_shell(room, ROOM, floor=floor, walls=walls, ceiling=ceiling, trim=white, handle=steel, n_casements=3)


def add_seating(room: Collection) -> None:
    """Sofa, table with chairs, the stool that carries the sphere, the rug."""
    oak = surfaces.wood("Oak", (0.3, 0.17, 0.08), (0.44, 0.27, 0.14))
    walnut = surfaces.wood("Walnut", (0.09, 0.045, 0.022), (0.17, 0.09, 0.045), grain="Z")
    sofa_cloth = surfaces.fabric("Sofa cloth", (0.23, 0.25, 0.28))
    throws = [surfaces.fabric("Mustard cloth", (0.6, 0.33, 0.05)), surfaces.fabric("Cream cloth", (0.68, 0.62, 0.52))]
    furniture.add_sofa(Place(room, "Sofa", -2.24, 0.1, turn_deg=90), 2.1, sofa_cloth, walnut, throws)
    furniture.add_table(Place(room, "Table", TABLE[0], TABLE[1]), (1.5, 0.85, TABLE[2]), oak, oak)
    seat = surfaces.fabric("Chair cloth", (0.42, 0.16, 0.09))
    furniture.add_chair(Place(room, "Chair 1", 0.72, 0.62, turn_deg=4), walnut, seat)
    furniture.add_chair(Place(room, "Chair 2", 1.12, -0.08, turn_deg=-96), walnut, seat)
    furniture.add_chair(Place(room, "Chair 3", -0.68, -0.1, turn_deg=84), walnut, seat)
    furniture.add_round_table(Place(room, "Stool", *SPHERE_PLACE[:2], turn_deg=20), 0.24, SPHERE_PLACE[2], oak, walnut)
    rug = surfaces.carpet("Rug", (0.45, 0.38, 0.29), (0.3, 0.06, 0.04), (0.06, 0.08, 0.14))
    add_solid(room, "Rug", box_between((-1.25, -0.95, 0.0), (1.25, 0.95, 0.012)), rug, location=(0.2, 0.05, 0.0))


def add_storage(room: Collection, rng: np.random.Generator) -> None:
    """Bookcase and sideboard by the door wall, television on its bench opposite the sofa."""
    white = surfaces.plain("Shelf lacquer", (0.7, 0.69, 0.66), roughness=0.4)
    teak = surfaces.wood("Teak", (0.2, 0.09, 0.04), (0.33, 0.17, 0.08))
    brass = surfaces.plain("Brass", (0.75, 0.5, 0.2), metallic=1.0, roughness=0.3)
    black = surfaces.plain("Black glass", (0.015, 0.015, 0.018), roughness=0.15)
    books = surfaces.coloured_by_face("Book spines")
    furniture.add_bookcase(Place(room, "Bookcase", 1.95, -2.15, turn_deg=180), (1.1, 0.3, 1.95), white, books, rng)
    furniture.add_cabinet(Place(room, "Sideboard", 0.2, -2.09, turn_deg=180), (1.6, 0.42, 0.78), teak, brass, doors=4)
    furniture.add_cabinet(
        Place(room, "Television bench", 2.5, 0.1, turn_deg=-90), (1.5, 0.4, 0.45), teak, brass, doors=3
    )
    screen = [
        box((1.15, 0.035, 0.66), (0, 0, 0.4)),
        box((0.4, 0.2, 0.02), (0, 0, 0.01)),
        box((0.06, 0.04, 0.1), (0, 0, 0.05)),
    ]
    Place(room, "Television", 2.52, 0.1, 0.45, -90).add(joined(screen), black, bevel_m=0.006)


def add_decoration(room: Collection, rng: np.random.Generator) -> None:
    """Curtains, radiator, pictures, plants, and what lies about."""
    linen = surfaces.curtain_cloth("Linen", (0.72, 0.66, 0.56))
    steel = surfaces.plain("Rod steel", (0.25, 0.24, 0.23), metallic=1.0, roughness=0.4)
    furniture.add_curtain_rod(Place(room, "Curtain rod", 1.0, 2.2, 2.4), 3.3, steel)
    furniture.add_curtain(Place(room, "Curtain left", -0.42, 2.2, 2.4), 0.55, 2.36, linen, seed=1)
    furniture.add_curtain(Place(room, "Curtain right", 2.4, 2.2, 2.4), 0.5, 2.36, linen, seed=2)
    enamel = surfaces.plain("Radiator enamel", (0.74, 0.74, 0.72), roughness=0.3)
    furniture.add_radiator(Place(room, "Radiator", 1.0, 2.28), 1.5, 0.5, enamel)
    leaves = surfaces.foliage("Leaves", (0.02, 0.07, 0.015), (0.1, 0.22, 0.05))
    clay = surfaces.plain("Terracotta", (0.4, 0.15, 0.07), roughness=0.8)
    soil = surfaces.plain("Soil", (0.03, 0.02, 0.015), roughness=1.0)
    furniture.add_plant(Place(room, "Plant", 2.2, 1.65), leaves, clay, soil, rng, height=1.35, spread=0.5, n_leaves=34)
    glaze = surfaces.plain("White glaze", (0.7, 0.7, 0.68), roughness=0.2)
    furniture.add_plant(
        Place(room, "Fern", 0.8, -2.08, 0.78), leaves, glaze, soil, rng, height=0.42, spread=0.26, pot_radius=0.09
    )
    add_pictures(room)
    pile = [box((0.26, 0.19, 0.03), (0, 0, 0.015)), box((0.23, 0.17, 0.025), (0.01, 0.005, 0.0425))]
    cloth = surfaces.plain("Book cloth", (0.07, 0.16, 0.25), roughness=0.7)
    Place(room, "Books on the table", 0.62, -0.14, TABLE[2], 24).add(joined(pile), cloth, bevel_m=0.003)
    bowl = [(0, 0.005), (0.06, 0.0), (0.14, 0.06), (0.15, 0.075), (0.138, 0.07), (0.06, 0.015), (0, 0.014)]
    Place(room, "Bowl", -0.1, -2.05, 0.78).add(
        revolved(bowl, 40), surfaces.plain("Blue glaze", (0.05, 0.13, 0.3), roughness=0.15), smooth=True
    )


def add_pictures(room: Collection) -> None:
    """Three pictures: over the sofa, over the sideboard and beside the television."""
    black = surfaces.plain("Picture frame", (0.02, 0.02, 0.02), roughness=0.4)
    mount = surfaces.plain("Mount", (0.78, 0.77, 0.74), roughness=0.9)
    warm = surfaces.painting(
        "Dunes",
        [(0.3, (0.5, 0.2, 0.07)), (0.45, (0.72, 0.5, 0.25)), (0.55, (0.2, 0.28, 0.33)), (0.7, (0.65, 0.62, 0.55))],
    )
    cool = surfaces.painting(
        "Coast",
        [(0.3, (0.02, 0.06, 0.14)), (0.47, (0.12, 0.3, 0.4)), (0.53, (0.7, 0.68, 0.6)), (0.7, (0.3, 0.12, 0.08))],
        scale=2.3,
    )
    furniture.add_picture(Place(room, "Picture 1", -2.7, 0.1, 1.55, 90), (0.95, 0.65), warm, black, mount)
    furniture.add_picture(Place(room, "Picture 2", 0.45, -2.3, 1.6, 180), (0.5, 0.65), cool, black, mount)
    furniture.add_picture(Place(room, "Picture 3", -0.2, -2.3, 1.6, 180), (0.5, 0.65), warm, black, mount)
    furniture.add_picture(Place(room, "Picture 4", 2.7, -1.25, 1.6, -90), (0.42, 0.55), cool, black, mount)


def add_garden(room: Collection) -> None:
    """What the window shows: a lawn, a hedge and two trees."""
    lawn = surfaces.foliage("Lawn", (0.05, 0.1, 0.02), (0.13, 0.2, 0.05))
    add_solid(room, "Lawn", box_between((-14, 2.7, -0.45), (14, 22, -0.4)), lawn)
    hedge = surfaces.foliage("Hedge", (0.02, 0.05, 0.01), (0.07, 0.13, 0.03))
    crowns = [
        box_between((-14, 9, -0.4), (14, 10, 1.3)),
        ball(1.7, (-2.5, 12.5, 2.6), 20),
        ball(2.1, (5.0, 13.5, 3.0), 20),
        ball(1.4, (1.0, 16.0, 2.2), 20),
    ]
    add_solid(room, "Hedge and trees", joined(crowns), hedge, bevel_m=0.15, smooth=True)


def add_light(scene: bpy.types.Scene, room: Collection) -> None:
    """Sun, sky, the floor lamp by the sofa; the pendant over the table is off."""
    lawn, haze, blue = (0.1, 0.11, 0.06), (0.9, 0.95, 1.0), (0.2, 0.38, 0.75)
    set_sky(scene, [(0.0, lawn), (0.49, lawn), (0.51, haze), (1.0, blue)], strength=16.0, bright_azimuth_deg=90)
    add_sun(room, azimuth_deg=120, elevation_deg=45, irradiance=20.0)
    iron = surfaces.plain("Lamp iron", (0.05, 0.05, 0.05), metallic=1.0, roughness=0.4)
    add_floor_lamp(Place(room, "Floor lamp", -2.3, 1.6), iron, kelvin=2700, watts=36, radiance=2.2)
    shell = surfaces.plain("Pendant shell", (0.55, 0.52, 0.46), roughness=0.5)
    add_pendant(Place(room, "Pendant", 0.25, 0.0, 2.6), shell, iron, drop=0.75)


def add_virtual_pieces(scene: bpy.types.Scene) -> None:
    """The vase on the table, the sphere on the stool."""
    belly = [
        (0, 0), (0.055, 0), (0.062, 0.008), (0.098, 0.07), (0.108, 0.115), (0.096, 0.165), (0.055, 0.215),
        (0.036, 0.245), (0.036, 0.265), (0.05, 0.285), (0.044, 0.287), (0.028, 0.262), (0.028, 0.24), (0, 0.235),
    ]  # fmt: skip
    glaze = surfaces.plain("Virtual glaze", (0.62, 0.58, 0.5), roughness=0.38, coat_weight=0.25, coat_roughness=0.12)
    vase = add_virtual(scene, "Vase", revolved(belly, 64), glaze, VASE_PLACE)
    vase.modifiers.new("Soft shape", "SUBSURF").render_levels = 1
    metal = surfaces.plain("Virtual brushed metal", (0.85, 0.83, 0.8), metallic=1.0, roughness=0.3)
    x, y, z = SPHERE_PLACE
    add_virtual(scene, "Sphere", ball(SPHERE_RADIUS_M, n_segments=64), metal, (x, y, z + SPHERE_RADIUS_M))


def add_walk(scene: bpy.types.Scene) -> None:
    """Round the table, the gaze resting between the two objects and rising a little half-way."""
    positions = arc(TABLE[:2], 1.72, (-165, 38), (1.55, 1.4))
    between = np.array([-0.15, 0.5, 0.86])
    sway = np.sin(np.linspace(0, 2 * np.pi, len(positions)))
    targets = between + np.stack([0.1 * sway, 0 * sway, 0.16 * np.abs(sway)], axis=-1)
    walk_phone(scene, positions, targets, seed=11)


if __name__ == "__main__":
    main(build, __file__)
