"""The small study that `light_temperature` and `light_intensity` share: one lamp on a desk, and what it does over time.

The lamp is the room's only light but for a faint night outside the window, so that whatever changes in the picture is
the lamp. The phone is held still: in the paper's recordings of changing light only the light changes. One frame stands
for half a second.

The room is 3.2 m x 2.8 m x 2.5 m with its middle at the origin; the desk stands at the +y wall, right of the window.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from staging import add_virtual, hold_phone, open_stage

from xihe_blender.lab.props import Collection, furniture, surfaces
from xihe_blender.lab.props.lighting import add_table_lamp, set_sky
from xihe_blender.lab.props.room_shell import Opening, Room, add_shell
from xihe_blender.lab.props.shapes import Place, add_solid, ball, box, box_between, cylinder, joined

WINDOW = Opening("-x", -0.6, 0.5, 0.9, 2.1)
DOOR = Opening("+x", -1.2, -0.4, 0.0, 2.02, is_door=True)
ROOM = Room(3.2, 2.8, 2.5, openings=(WINDOW, DOOR))
DESK_HEIGHT_M = 0.74
LAMP_WATTS, SHADE_RADIANCE = 23.0, 1.8


def build_lamp_room(name: str) -> tuple[bpy.types.Scene, bpy.types.Object]:
    """The furnished room with its virtual sphere and still phone; returns the scene and the lamp's light."""
    scene, room = open_stage(name)
    rng = np.random.default_rng(57)
    _add_walls(room)
    _add_desk(room)
    _add_rest(room, rng)
    set_sky(scene, [(0.0, (0.3, 0.35, 0.5)), (1.0, (0.5, 0.6, 1.0))], strength=0.15)
    foot = surfaces.plain("Lamp glaze", (0.12, 0.28, 0.3), roughness=0.2)
    place = Place(room, "Desk lamp", 0.95, 1.08, DESK_HEIGHT_M)
    lamp = add_table_lamp(place, foot, kelvin=3000, watts=LAMP_WATTS, radiance=SHADE_RADIANCE)
    cream = surfaces.plain("Virtual porcelain", (0.72, 0.7, 0.66), roughness=0.35, coat_weight=0.3, coat_roughness=0.1)
    add_virtual(scene, "Porcelain ball", ball(0.11, (0, 0, 0.11), 64), cream, (0.42, 0.86, DESK_HEIGHT_M))
    hold_phone(scene, (-0.35, -0.75, 1.4), (0.35, 0.95, 0.95), seed=5)
    return scene, lamp


def _add_walls(room: Collection) -> None:
    wall = surfaces.paint("Wall paint", (0.66, 0.64, 0.6))
    accent = surfaces.paint("Accent paint", (0.28, 0.36, 0.42))
    white = surfaces.plain("White lacquer", (0.75, 0.75, 0.73), roughness=0.35)
    floor = surfaces.planks("Ash planks", (0.36, 0.25, 0.15), (0.5, 0.38, 0.25), width_m=0.11)
    steel = surfaces.plain("Steel", (0.6, 0.6, 0.6), metallic=1.0, roughness=0.3)
    walls = {"+x": wall, "-x": wall, "+y": accent, "-y": wall}
    add_shell(room, ROOM, floor=floor, walls=walls, ceiling=wall, trim=white, handle=steel)


def _add_desk(room: Collection) -> None:
    """Desk, chair, and what lies on the desk."""
    oak = surfaces.wood("Oak", (0.3, 0.17, 0.08), (0.44, 0.27, 0.14))
    black = surfaces.plain("Black steel", (0.03, 0.03, 0.03), roughness=0.4)
    furniture.add_table(Place(room, "Desk", 0.5, 1.02), (1.5, 0.7, DESK_HEIGHT_M), oak, black, leg_m=0.045)
    seat = surfaces.fabric("Chair cloth", (0.1, 0.2, 0.25))
    furniture.add_chair(Place(room, "Desk chair", 0.75, 0.3, turn_deg=195), oak, seat)
    paper = surfaces.plain("Paper", (0.76, 0.75, 0.71), roughness=0.9)
    sheets = [box((0.21, 0.297, 0.002), (0, 0, 0.001)), box((0.21, 0.297, 0.002)).turned(17).moved((0.05, 0.02, 0.003))]
    Place(room, "Papers", 0.75, 0.82, DESK_HEIGHT_M, 8).add(joined(sheets), paper)
    cover = surfaces.plain("Book cloth", (0.42, 0.08, 0.06), roughness=0.7)
    pile = [box((0.25, 0.18, 0.03), (0, 0, 0.015)), box((0.22, 0.16, 0.028)).turned(12).moved((0, 0, 0.044))]
    Place(room, "Book pile", 0.02, 1.1, DESK_HEIGHT_M, -12).add(joined(pile), cover, bevel_m=0.003)
    mug = surfaces.plain("Mug glaze", (0.65, 0.45, 0.12), roughness=0.3)
    Place(room, "Pencil mug", 0.62, 1.24, DESK_HEIGHT_M).add(cylinder(0.042, 0.1), mug, smooth=True)


def _add_rest(room: Collection, rng: np.random.Generator) -> None:
    """Shelf, cabinet, pictures, curtain, plant and rug."""
    oak, white = bpy.data.materials["Oak"], bpy.data.materials["White lacquer"]
    black = bpy.data.materials["Black steel"]
    books = surfaces.coloured_by_face("Book spines")
    furniture.add_bookcase(Place(room, "Wall shelf", 0.5, 1.29, 1.45), (1.2, 0.22, 0.7), oak, books, rng, n_shelves=2)
    furniture.add_bookcase(Place(room, "Bookcase", -1.1, 1.25), (0.8, 0.28, 1.9), white, books, rng)
    furniture.add_cabinet(Place(room, "Drawers", 1.37, 0.15, turn_deg=-90), (0.9, 0.42, 0.8), white, black, doors=2)
    stops = [(0.3, (0.05, 0.1, 0.16)), (0.5, (0.6, 0.55, 0.45)), (0.7, (0.5, 0.15, 0.08))]
    furniture.add_picture(
        Place(room, "Picture", 1.6, 0.3, 1.5, -90), (0.5, 0.4), surfaces.painting("Harbour", stops), black, white
    )
    linen = surfaces.curtain_cloth("Linen", (0.6, 0.5, 0.4))
    furniture.add_curtain_rod(Place(room, "Curtain rod", -1.5, -0.05, 2.25, 90), 1.9, black)
    furniture.add_curtain(Place(room, "Curtain left", -1.5, 0.7, 2.25, 90), 0.4, 2.2, linen, seed=1)
    furniture.add_curtain(Place(room, "Curtain right", -1.5, -0.8, 2.25, 90), 0.4, 2.2, linen, seed=2)
    leaves = surfaces.foliage("Leaves", (0.02, 0.07, 0.015), (0.1, 0.22, 0.05))
    clay = surfaces.plain("Terracotta", (0.4, 0.15, 0.07), roughness=0.8)
    soil = surfaces.plain("Soil", (0.03, 0.02, 0.015), roughness=1.0)
    furniture.add_plant(
        Place(room, "Plant", -0.42, 1.15), leaves, clay, soil, rng, height=0.8, spread=0.25, pot_radius=0.12
    )
    rug = surfaces.carpet("Rug", (0.35, 0.33, 0.3), (0.1, 0.14, 0.2), (0.5, 0.47, 0.4))
    add_solid(room, "Rug", box_between((-0.8, -0.6, 0), (0.8, 0.6, 0.01)), rug, location=(0.0, -0.3, 0.0))


def key_lamp(scene: bpy.types.Scene, lamp: bpy.types.Object, kelvin: Sequence[float], level: Sequence[float]) -> None:
    """Key the lamp and its shade at every frame.

    Parameters
    ----------
    kelvin : colour temperature per frame; the black body keeps its luminance, only its colour changes
    level : power per frame as a share of full, 0 to 1; lamp and shade dim together
    """
    shade = bpy.data.materials["Desk lamp shade"].node_tree
    bulb = lamp.data
    # Actions of their own: one that a lamp shares with its node tree has two slots, and Blender 4.3 reads the first.
    for owner, name in ((bulb, bulb.name), (bulb.node_tree, f"{bulb.name} colour")):
        owner.animation_data_create().action = bpy.data.actions.new(name)
    for i, frame in enumerate(range(scene.frame_start, scene.frame_end + 1)):
        for tree in (shade, bulb.node_tree):
            tree.nodes["Temperature"].inputs[0].default_value = kelvin[i]
            tree.nodes["Temperature"].inputs[0].keyframe_insert("default_value", frame=frame)
        glow = next(node for node in shade.nodes if node.type == "BSDF_PRINCIPLED").inputs["Emission Strength"]
        glow.default_value, bulb.energy = SHADE_RADIANCE * level[i], LAMP_WATTS * level[i]
        glow.keyframe_insert("default_value", frame=frame)
        bulb.keyframe_insert("energy", frame=frame)
