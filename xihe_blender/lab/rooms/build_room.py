"""How does a room as data become a Blender scene? Shell, openings, furniture, lamps, daylight, in an empty file.

Every build starts from an empty file, so a room never sees what another left, and nothing piles up over a thousand
rooms. Portals stand in the windows: without them nearly all samples of the sky end on the outside of a wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import bpy
from mathutils import Vector as BlenderVector

from xihe_blender.lab.props import furniture, lighting, surfaces
from xihe_blender.lab.props.room_shell import Opening, add_door, add_skirting, add_window, wall_solid
from xihe_blender.lab.props.shapes import Solid, add_solid, ball, box, box_between, cylinder, joined, revolved, tube
from xihe_blender.lab.rooms.materials import material_of
from xihe_blender.lab.rooms.outline import Outline
from xihe_blender.lab.rooms.place_pieces import place_piece
from xihe_blender.lab.rooms.room_data import Hole, Lamp, Room, Slope

Collection: TypeAlias = bpy.types.Collection
Material: TypeAlias = bpy.types.Material
WALL_M, SLAB_M, FACE_GAP_M = 0.25, 0.2, 0.001
CURTAIN_TONES = ((0.7, 0.68, 0.63), (0.45, 0.42, 0.4), (0.3, 0.36, 0.42), (0.6, 0.5, 0.42), (0.42, 0.48, 0.42))
SHADE_PER_WATT = 1 / 14
"""Radiance of a lampshade per watt of its bulb, from the shipped scenes."""


@dataclass(frozen=True)
class PlanWalls:
    """The walls of a plan, named by their numbers, as `room_shell` wants them."""

    outline: Outline
    height: float
    openings: tuple[Opening, ...]
    wall_m: float = WALL_M

    def inner_ends(self, wall: str) -> tuple[float, float]:
        return 0.0, self.outline.walls[int(wall)].length

    def outer_ends(self, wall: str) -> tuple[float, float]:
        edge = self.outline.walls[int(wall)]
        # At a corner that juts into the room each wall ends a little early, or its end would lie in the other's face.
        before = self.wall_m if edge.starts_convex else -FACE_GAP_M
        after = self.wall_m if edge.ends_convex else -FACE_GAP_M
        return -before, edge.length + after

    def wall_box(
        self, wall: str, along: tuple[float, float], out: tuple[float, float], up: tuple[float, float]
    ) -> Solid:
        rect = self.outline.walls[int(wall)].rect(along, (-out[0], -out[1]))
        return box_between((rect.x0, rect.y0, up[0]), (rect.x1, rect.y1, up[1]))


def build_room(room: Room) -> bpy.types.Scene:
    """A new file with the room in its scene, without a camera; whatever was open is gone."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.view_settings.view_transform = "Standard"
    things = bpy.data.collections.new("Room")
    scene.collection.children.link(things)
    add_shell(things, room)
    for i, piece in enumerate(room.pieces):
        place_piece(things, f"{piece.kind} {i}", piece)
    for i, lamp in enumerate(room.lamps):
        add_lamp(things, f"{lamp.kind} lamp {i}", lamp)
    add_daylight(scene, things, room)
    remove_relief()
    return scene


def remove_relief() -> None:
    """Take the bumps off all materials: finer than a pixel here, they cost a tenth of the time and change no light."""
    for material in bpy.data.materials:
        nodes = material.node_tree.nodes
        for bump in [node for node in nodes if node.type == "BUMP"]:
            nodes.remove(bump)


def add_shell(things: Collection, room: Room) -> None:
    """Floor, ceiling with its slopes, walls, skirting, windows, doors."""
    openings = tuple(Opening(str(h.wall), h.low, h.high, h.bottom, h.top, h.is_door) for h in room.holes)
    walls = PlanWalls(room.outline, room.height, openings)
    trim = material_of("Trim", room.trim)
    b = room.outline.bounds.grown(WALL_M)
    ceiling = material_of("Ceiling", room.ceiling)
    add_solid(things, "Floor", box_between((b.x0, b.y0, -SLAB_M), (b.x1, b.y1, 0)), material_of("Floor", room.floor))
    lid = box_between((b.x0, b.y0, room.height), (b.x1, b.y1, room.height + SLAB_M))
    add_solid(things, "Ceiling", lid, ceiling)
    for i, slope in enumerate(room.slopes):
        add_solid(things, f"Slope {i}", slope_solid(room, slope), ceiling)
    paints = {finish: material_of(f"Wall {i}", finish) for i, finish in enumerate(dict.fromkeys(room.walls))}
    for i, finish in enumerate(room.walls):
        add_solid(things, f"Wall {i}", wall_solid(walls, str(i)), paints[finish])
    add_skirting(things, walls, trim, " ".join(str(i) for i in range(len(room.walls))))
    for hole, opening in zip(room.holes, openings, strict=True):
        if hole.is_door:
            add_door(things, walls, opening, trim, trim, surfaces.plain("Handle", (0.6, 0.6, 0.6), metallic=1.0))
        else:
            add_window(things, walls, opening, trim, trim, hole.n_casements)
            add_covering(things, room, hole)


def slope_solid(room: Room, slope: Slope) -> Solid:
    """The wedge between a slanted ceiling and the flat one over it."""
    wall = room.outline.walls[slope.wall]
    section = [(-WALL_M, slope.knee_m - WALL_M * (room.height - slope.knee_m) / slope.reach_m)]
    section += [(slope.reach_m, room.height), (-WALL_M, room.height)]
    ends = [[(*wall.point(along, inwards), up) for inwards, up in section] for along in (-WALL_M, wall.length + WALL_M)]
    first, last = ends
    faces = ((0, 1, 2), (5, 4, 3), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0))
    return Solid(tuple(first + last), faces)


def add_covering(things: Collection, room: Room, hole: Hole) -> None:
    """Curtains at both sides, a sheer over the whole window, or a blind over its upper part."""
    wall = room.outline.walls[hole.wall]
    width, seed = hole.high - hole.low, round(1000 * hole.low) + hole.wall
    name, top = f"Covering {hole.wall} {hole.low:.2f}", min(hole.top + 0.1, room.height - 0.06)
    tone = CURTAIN_TONES[seed % len(CURTAIN_TONES)]
    if hole.covering == "curtains":
        cloth, side = surfaces.curtain_cloth(name, tone), max(0.22, 0.22 * width)
        drop = top - 0.03 if seed % 2 else top - hole.bottom + 0.1
        for i, along in enumerate((hole.low - 0.1 + side / 2, hole.high + 0.1 - side / 2)):
            x, y = wall.point(min(max(along, side / 2 + 0.02), wall.length - side / 2 - 0.02), 0.1)
            place = furniture.at(x, y, top, wall.turn_deg)
            furniture.add_curtain(things, f"{name} {i}", side, drop, cloth, place=place, seed=seed + i)
    elif hole.covering == "sheer":
        x, y = wall.point((hole.low + hole.high) / 2, 0.1)
        place, cloth = furniture.at(x, y, top, wall.turn_deg), surfaces.curtain_cloth(name, (0.8, 0.79, 0.76))
        furniture.add_curtain(things, name, width, top - hole.bottom + 0.05, cloth, place=place, seed=seed)
    elif hole.covering == "blind":
        x, y = wall.point((hole.low + hole.high) / 2, 0.02)
        share = 0.25 + 0.6 * (seed % 97) / 97
        drop = share * (hole.top - hole.bottom)
        cloth = surfaces.curtain_cloth(name, tone)
        panel = box((width + 0.04, 0.008, drop), (0, 0, -drop / 2))
        add_solid(things, name, panel, cloth, **furniture.at(x, y, hole.top + 0.02, wall.turn_deg))


def add_lamp(things: Collection, name: str, lamp: Lamp) -> None:
    """A lamp's body, and its light where it is lit."""
    metal = surfaces.plain(f"{name} metal", (0.3, 0.29, 0.27), metallic=1.0, roughness=0.35)
    LAMP_MAKERS[lamp.kind](things, name, lamp, metal)


def _shade(name: str, lamp: Lamp, per_watt: float = SHADE_PER_WATT) -> Material:
    """A lit shade glows; one that is not is white cloth."""
    if lamp.watts > 0:
        return surfaces.glowing(name, lamp.kelvin, lamp.watts * per_watt)
    return surfaces.plain(name, (0.7, 0.67, 0.6), roughness=0.9)


def _bulb(things: Collection, name: str, lamp: Lamp, height: float, radius: float = 0.06) -> None:
    if lamp.watts > 0:
        place = (lamp.x, lamp.y, height)
        lighting.add_bulb(things, name, place, kelvin=lamp.kelvin, watts=lamp.watts, radius=radius)


def _floor_lamp(things: Collection, name: str, lamp: Lamp, metal: Material) -> None:
    h, place = lamp.size_m, furniture.at(lamp.x, lamp.y, lamp.z)
    pole = [cylinder(0.15, 0.02, 32), tube((0, 0, 0.01), (0, 0, h - 0.1), 0.011)]
    add_solid(things, f"{name} pole", joined(pole), metal, smooth=True, **place)
    lighting.add_shade(things, f"{name} shade", [(0.21, h - 0.3), (0.17, h)], _shade(name, lamp), place=place)
    _bulb(things, f"{name} light", lamp, lamp.z + h - 0.15)


def _table_lamp(things: Collection, name: str, lamp: Lamp, metal: Material) -> None:
    h, place = lamp.size_m, furniture.at(lamp.x, lamp.y, lamp.z)
    foot = [(0, 0), (0.16, 0), (0.16, 0.03), (0.05, 0.07), (0.15, 0.27), (0.12, 0.42), (0.03, 0.54), (0.025, 0.66)]
    add_solid(things, f"{name} foot", revolved([(r * h, z * h) for r, z in foot], 32), metal, smooth=True, **place)
    shade = [(0.32 * h, 0.55 * h), (0.2 * h, h)]
    lighting.add_shade(things, f"{name} shade", shade, _shade(name, lamp), place=place)
    _bulb(things, f"{name} light", lamp, lamp.z + 0.75 * h)


def _pendant(things: Collection, name: str, lamp: Lamp, metal: Material) -> None:
    """An opaque dome that shines down."""
    place = furniture.at(lamp.x, lamp.y, lamp.z)
    lighting.add_pendant(things, name, metal, metal, place=place, drop=lamp.size_m + 0.1)
    _bulb(things, f"{name} light", lamp, lamp.z - lamp.size_m - 0.09, 0.05)


def _globe(things: Collection, name: str, lamp: Lamp, metal: Material) -> None:
    """A glowing ball on a cord, its light spread over the whole of it."""
    radius = 0.14
    middle = lamp.z - lamp.size_m
    globe = add_solid(
        things, f"{name} shade", ball(radius, (0, 0, 0), 32), _shade(name, lamp, 1 / 9), smooth=True,
        location=(lamp.x, lamp.y, middle),
    )  # fmt: skip
    globe.visible_shadow = False
    cord = tube((lamp.x, lamp.y, middle + radius), (lamp.x, lamp.y, lamp.z), 0.006, 8)
    add_solid(things, f"{name} cord", cord, metal)
    _bulb(things, f"{name} light", lamp, middle, 0.12)


def _ceiling_light(things: Collection, name: str, lamp: Lamp, shape: str) -> None:
    """An area light just under the ceiling, facing down."""
    light = bpy.data.lights.new(name, "AREA")
    light.shape, light.size, light.energy = shape, lamp.size_m, lamp.watts
    if light.node_tree is None:  # from 5.0 on a new light may have its nodes, and asking for them warns
        light.use_nodes = True
    tint = light.node_tree.nodes.new("ShaderNodeBlackbody")
    tint.inputs[0].default_value = lamp.kelvin
    emission = next(node for node in light.node_tree.nodes if node.type == "EMISSION")
    light.node_tree.links.new(tint.outputs[0], emission.inputs["Color"])
    thing = bpy.data.objects.new(name, light)
    thing.location = (lamp.x, lamp.y, lamp.z - 0.025)
    things.objects.link(thing)


def _panel(things: Collection, name: str, lamp: Lamp, metal: Material) -> None:
    s = lamp.size_m
    frame = box((s + 0.04, s + 0.04, 0.02), (lamp.x, lamp.y, lamp.z - 0.01))
    add_solid(things, f"{name} frame", frame, surfaces.plain(name, (0.75, 0.75, 0.74)))
    if lamp.watts > 0:
        _ceiling_light(things, name, lamp, "SQUARE")


def _spot(things: Collection, name: str, lamp: Lamp, metal: Material) -> None:
    ring = cylinder(0.6 * lamp.size_m, 0.02).moved((lamp.x, lamp.y, lamp.z - 0.02))
    add_solid(things, f"{name} ring", ring, metal, smooth=True)
    if lamp.watts > 0:
        _ceiling_light(things, name, lamp, "DISK")


LAMP_MAKERS = {
    "floor": _floor_lamp, "table": _table_lamp, "pendant": _pendant, "globe": _globe, "panel": _panel, "spot": _spot,
}  # fmt: skip


def add_daylight(scene: bpy.types.Scene, things: Collection, room: Room) -> None:
    """The panorama as the world, the sun, and a portal in each window."""
    daylight = room.daylight
    lighting.set_panorama(scene, f"{daylight.panorama}.exr", strength=daylight.strength, turn_deg=daylight.turn_deg)
    if daylight.sun is not None:
        sun = daylight.sun
        lighting.add_sun(things, azimuth_deg=sun.azimuth_deg, elevation_deg=sun.elevation_deg,
                         irradiance=sun.irradiance, tint=sun.tint)  # fmt: skip
    for hole in room.holes:
        if not hole.is_door:
            add_portal(things, room, hole)


def add_portal(things: Collection, room: Room, hole: Hole) -> None:
    """A light portal at the outside of a window, facing in."""
    wall = room.outline.walls[hole.wall]
    light = bpy.data.lights.new("Portal", "AREA")
    light.shape, light.size, light.size_y = "RECTANGLE", hole.high - hole.low, hole.top - hole.bottom
    light.cycles.is_portal = True
    portal = bpy.data.objects.new("Portal", light)
    portal.location = (*wall.point((hole.low + hole.high) / 2, -0.2), (hole.bottom + hole.top) / 2)
    inwards = BlenderVector((-wall.outward[0], -wall.outward[1], 0.0))
    portal.rotation_euler = inwards.to_track_quat("-Z", "Y").to_euler()
    things.objects.link(portal)
