"""Build `walk_around`: a phone that circles a lamp on a table, once, in 24 frames.

The paper's third recording: the light stays, the user walks. A full circle shows the estimator every wall; the lamp is
the main light and stands right beside the virtual objects, so that their light changes quickly with position. Dusk
comes in through one window. Virtual: a porcelain jar and a brushed metal ball on the table, on two sides of the lamp.

The room is 4.4 m x 4.4 m x 2.6 m with its middle, the table and the lamp at the origin.
"""

from __future__ import annotations

import bpy
import numpy as np
from staging import add_virtual, arc, main, open_stage, walk_phone

from xihe_blender.lab.props import Collection, furniture, surfaces
from xihe_blender.lab.props.lighting import add_table_lamp, set_sky
from xihe_blender.lab.props.room_shell import Opening, Room, add_shell
from xihe_blender.lab.props.shapes import Place, add_solid, ball, box_between, revolved

WINDOW = Opening("+x", -0.8, 0.8, 0.85, 2.2)
DOOR = Opening("-y", 0.9, 1.75, 0.0, 2.02, is_door=True)
ROOM = Room(4.4, 4.4, 2.6, openings=(WINDOW, DOOR))
TABLE_HEIGHT_M, TABLE_RADIUS_M = 0.74, 0.5
# Radius and height in metres, from the foot over the belly and the lid to the knob.
JAR_PROFILE = [
    (0, 0), (0.06, 0), (0.068, 0.008), (0.082, 0.05), (0.086, 0.1),
    (0.078, 0.145), (0.062, 0.165), (0.07, 0.172), (0.07, 0.18), (0.045, 0.2),
    (0.016, 0.208), (0.012, 0.216), (0.02, 0.228), (0.014, 0.24), (0, 0.243),
]  # fmt: skip


def build() -> bpy.types.Scene:
    """The whole scene in an empty file."""
    scene, room = open_stage("Walk around a lamp")
    rng = np.random.default_rng(360)
    add_walls(room)
    add_furniture(room, rng)
    add_decoration(room, rng)
    add_virtual_pieces(scene)
    glaze = surfaces.plain("Lamp glaze", (0.4, 0.13, 0.07), roughness=0.2)
    place = Place(room, "Lamp", 0.0, 0.0, TABLE_HEIGHT_M)
    add_table_lamp(place, glaze, kelvin=2800, watts=32.0, radiance=1.8, height=0.52)
    ground, dusk = [(0.0, (0.08, 0.08, 0.1)), (0.49, (0.1, 0.1, 0.12))], [(0.51, (1.0, 0.6, 0.4))]
    set_sky(scene, [*ground, *dusk, (0.7, (0.25, 0.4, 0.8)), (1.0, (0.08, 0.17, 0.5))], strength=0.8)
    positions = arc((0.0, 0.0), 1.45, (-90, 270 - 15), (1.42, 1.5))
    walk_phone(scene, positions, np.tile((0.0, 0.0, 0.98), (len(positions), 1)), seed=21)
    return scene


def add_walls(room: Collection) -> None:
    """Shell, window, door and skirting; each wall has its own colour, so that the light has a direction."""
    white = surfaces.plain("White lacquer", (0.75, 0.75, 0.73), roughness=0.35)
    walls = {
        "+x": surfaces.paint("Cream paint", (0.68, 0.63, 0.52)),
        "-x": surfaces.paint("Brick red paint", (0.42, 0.13, 0.08)),
        "+y": surfaces.paint("Sage paint", (0.3, 0.38, 0.28)),
        "-y": surfaces.paint("Chalk paint", (0.65, 0.65, 0.63)),
    }
    floor = surfaces.planks("Pine planks", (0.38, 0.24, 0.12), (0.52, 0.36, 0.2), width_m=0.12)
    ceiling = surfaces.paint("Ceiling paint", (0.74, 0.74, 0.72))
    steel = surfaces.plain("Steel", (0.6, 0.6, 0.6), metallic=1.0, roughness=0.3)
    add_shell(room, ROOM, floor=floor, walls=walls, ceiling=ceiling, trim=white, handle=steel)


def add_furniture(room: Collection, rng: np.random.Generator) -> None:
    """The table in the middle; something to see on every side."""
    oak = surfaces.wood("Oak", (0.3, 0.17, 0.08), (0.44, 0.27, 0.14))
    walnut = surfaces.wood("Walnut", (0.09, 0.045, 0.022), (0.17, 0.09, 0.045), grain="Z")
    brass = surfaces.plain("Brass", (0.75, 0.5, 0.2), metallic=1.0, roughness=0.3)
    furniture.add_round_table(Place(room, "Table", 0.0, 0.0), TABLE_RADIUS_M, TABLE_HEIGHT_M, oak, walnut)
    cloth = surfaces.fabric("Sofa cloth", (0.16, 0.22, 0.3))
    throws = [surfaces.fabric("Rust cloth", (0.5, 0.17, 0.05)), surfaces.fabric("Cream cloth", (0.66, 0.6, 0.5))]
    furniture.add_sofa(Place(room, "Sofa", 0.0, 1.74), 1.9, cloth, walnut, throws)
    books = surfaces.coloured_by_face("Book spines")
    furniture.add_bookcase(Place(room, "Bookcase 1", -2.05, -0.5, turn_deg=90), (0.95, 0.3, 2.0), walnut, books, rng)
    furniture.add_bookcase(Place(room, "Bookcase 2", -2.05, 0.5, turn_deg=90), (0.95, 0.3, 2.0), walnut, books, rng)
    furniture.add_cabinet(Place(room, "Sideboard", -0.35, -2.0, turn_deg=180), (1.5, 0.4, 0.8), oak, brass, doors=3)
    seat = surfaces.fabric("Chair cloth", (0.5, 0.36, 0.12))
    furniture.add_chair(Place(room, "Chair", 1.75, -1.3, turn_deg=-60), walnut, seat)
    rug = surfaces.carpet("Rug", (0.42, 0.35, 0.27), (0.07, 0.12, 0.2), (0.36, 0.09, 0.05))
    disc = revolved([(0, 0), (1.2, 0), (1.2, 0.012), (0, 0.012)], 64)
    add_solid(room, "Rug", disc, rug)


def add_decoration(room: Collection, rng: np.random.Generator) -> None:
    """Curtains, radiator, pictures, plants, the street outside."""
    linen = surfaces.curtain_cloth("Linen", (0.7, 0.6, 0.45))
    steel = surfaces.plain("Rod steel", (0.25, 0.24, 0.23), metallic=1.0, roughness=0.4)
    furniture.add_curtain_rod(Place(room, "Curtain rod", 2.1, 0.0, 2.35, 90), 2.5, steel)
    furniture.add_curtain(Place(room, "Curtain left", 2.1, 0.98, 2.35, 90), 0.5, 2.3, linen, seed=1)
    furniture.add_curtain(Place(room, "Curtain right", 2.1, -0.98, 2.35, 90), 0.5, 2.3, linen, seed=2)
    enamel = surfaces.plain("Radiator enamel", (0.74, 0.74, 0.72), roughness=0.3)
    furniture.add_radiator(Place(room, "Radiator", 2.18, 0.0, turn_deg=-90), 1.3, 0.5, enamel)
    black = surfaces.plain("Picture frame", (0.02, 0.02, 0.02), roughness=0.4)
    mount = surfaces.plain("Mount", (0.78, 0.77, 0.74))
    stops = [(0.3, (0.03, 0.1, 0.18)), (0.47, (0.3, 0.42, 0.4)), (0.53, (0.7, 0.62, 0.45)), (0.7, (0.45, 0.14, 0.06))]
    for i, (x, scale) in enumerate(((-0.55, 1.5), (0.0, 2.2), (0.55, 1.8))):
        art = surfaces.painting(f"Print {i + 1}", stops, scale=scale)
        furniture.add_picture(Place(room, f"Picture {i + 1}", x, 2.2, 1.55), (0.42, 0.54), art, black, mount)
        art = surfaces.painting(f"Study {i + 1}", stops, scale=scale + 1)
        furniture.add_picture(
            Place(room, f"Small picture {i + 1}", x - 0.35, -2.2, 1.5, 180), (0.34, 0.34), art, black, mount
        )
    leaves = surfaces.foliage("Leaves", (0.02, 0.07, 0.015), (0.1, 0.22, 0.05))
    clay = surfaces.plain("Terracotta", (0.4, 0.15, 0.07), roughness=0.8)
    soil = surfaces.plain("Soil", (0.03, 0.02, 0.015), roughness=1.0)
    furniture.add_plant(Place(room, "Plant", 1.75, 1.7), leaves, clay, soil, rng, height=1.4, spread=0.4, n_leaves=32)
    furniture.add_plant(
        Place(room, "Fern", -0.8, -2.0, 0.8), leaves, clay, soil, rng, height=0.45, spread=0.25, pot_radius=0.09
    )
    houses = [
        box_between((12, y, -4), (16, y + w, h))
        for y, w, h in ((-14, 6, 2.2), (-7, 5, 1.4), (-1.5, 6, 2.6), (5, 7, 1.7))
    ]
    for i, house in enumerate(houses):
        facade = surfaces.plain(f"Facade {i + 1}", (0.3, 0.24 - 0.03 * i, 0.2 - 0.03 * i), roughness=0.9)
        add_solid(room, f"House {i + 1}", house, facade)


def add_virtual_pieces(scene: bpy.types.Scene) -> None:
    """A jar on one side of the lamp, a ball on the other."""
    jar = revolved(JAR_PROFILE, 64)
    porcelain = surfaces.plain("Virtual porcelain", (0.7, 0.7, 0.68), roughness=0.4)
    add_virtual(scene, "Jar", jar, porcelain, (-0.27, -0.16, TABLE_HEIGHT_M))
    metal = surfaces.plain("Virtual brushed metal", (0.85, 0.83, 0.8), metallic=1.0, roughness=0.3)
    add_virtual(scene, "Ball", ball(0.095, (0, 0, 0.095), 64), metal, (0.28, 0.14, TABLE_HEIGHT_M))


if __name__ == "__main__":
    main(build, __file__)
