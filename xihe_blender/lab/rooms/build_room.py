"""A Blender scene of a room that is data: shell, openings, furniture, lamps, daylight, in an empty file.

Every build starts from an empty file, so a room never sees what another left, and nothing piles up over a thousand
rooms. Portals stand in the windows: without them nearly all samples of the sky end on the outside of a wall.
"""

from __future__ import annotations

import functools
import math
from dataclasses import asdict, dataclass, replace

import bpy
import numpy as np
from mathutils import Vector as BlenderVector

from xihe_blender.lab.props import Collection, Material, furniture, lighting, surfaces
from xihe_blender.lab.props.room_shell import Opening, Span, Walls, add_door, add_skirting, add_window, wall_solid
from xihe_blender.lab.props.shapes import Place, Solid, add_solid, ball, box, box_between, cylinder, joined, tube
from xihe_blender.lab.rooms.outline import Outline
from xihe_blender.lab.rooms.place_pieces import material_of, place_piece
from xihe_blender.lab.rooms.room_data import Hole, Lamp, Room, Slope
from xihe_blender.scene.colour_management import show_as_it_is

WALL_M, SLAB_M, FACE_GAP_M = 0.25, 0.2, 0.001
CURTAIN_TONES = ((0.7, 0.68, 0.63), (0.45, 0.42, 0.4), (0.3, 0.36, 0.42), (0.6, 0.5, 0.42), (0.42, 0.48, 0.42))
SHADE_PER_WATT = 1 / 14  # Radiance of a lampshade per watt of its bulb, from the shipped scenes
JUG: lighting.Profile = (
    (0, 0), (0.16, 0), (0.16, 0.03), (0.05, 0.07), (0.15, 0.27), (0.12, 0.42), (0.03, 0.54), (0.025, 0.66),
)  # fmt: skip
"""The foot of a table lamp, as shares of its height."""


@dataclass(frozen=True)
class PlanWalls(Walls):
    """The walls of a plan, named by their numbers."""

    outline: Outline
    height: float
    openings: tuple[Opening, ...]
    wall_m: float = WALL_M

    def inner_ends(self, wall: str) -> Span:
        return 0.0, self.outline.walls[int(wall)].length

    def outer_ends(self, wall: str) -> Span:
        edge = self.outline.walls[int(wall)]
        # At a corner that juts into the room each wall ends a little early, or its end would lie in the other's face.
        before = self.wall_m if edge.starts_convex else -FACE_GAP_M
        after = self.wall_m if edge.ends_convex else -FACE_GAP_M
        return -before, edge.length + after

    def wall_box(self, wall: str, along: Span, out: Span, up: Span) -> Solid:
        rect = self.outline.walls[int(wall)].rect(along, (-out[0], -out[1]))
        return box_between((rect.x0, rect.y0, up[0]), (rect.x1, rect.y1, up[1]))


@functools.cache
def _take_factory_preferences() -> None:
    """Once in a process: with them a new file takes six times as long, since every add-on is registered anew."""
    bpy.ops.wm.read_factory_settings(use_empty=True)


def build_room(room: Room) -> bpy.types.Scene:
    """A new file with the room in its scene, without a camera; whatever was open is gone."""
    _take_factory_preferences()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    show_as_it_is(scene)
    things = bpy.data.collections.new("Room")
    scene.collection.children.link(things)
    add_shell(things, room)
    for i, piece in enumerate(room.pieces):
        place_piece(things, f"{piece.kind} {i}", piece)
    for i, lamp in enumerate(room.lamps):
        name = f"{lamp.kind} lamp {i}"
        metal = surfaces.plain(f"{name} metal", (0.3, 0.29, 0.27), metallic=1.0, roughness=0.35)
        before = set(things.objects)
        LAMP_MAKERS[lamp.kind](Place(things, name, lamp.x, lamp.y, lamp.z), lamp, metal)
        for light in set(things.objects) - before if lamp.is_visible else ():
            light.visible_camera = True
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
    trim, ceiling = material_of("Trim", room.trim), material_of("Ceiling", room.ceiling)
    b = room.outline.bounds.grown(WALL_M)
    add_solid(things, "Floor", box_between((b.x0, b.y0, -SLAB_M), (b.x1, b.y1, 0)), material_of("Floor", room.floor))
    lid = box_between((b.x0, b.y0, room.height), (b.x1, b.y1, room.height + SLAB_M))
    add_solid(things, "Ceiling", lid, ceiling)
    for i, slope in enumerate(room.slopes):
        add_solid(things, f"Slope {i}", slope_solid(room, slope), ceiling)
    paints = {finish: material_of(f"Wall {i}", finish) for i, finish in enumerate(dict.fromkeys(room.walls))}
    for i, finish in enumerate(room.walls):
        add_solid(things, f"Wall {i}", wall_solid(walls, str(i)), paints[finish])
    add_skirting(things, walls, trim, map(str, range(len(room.walls))))
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
    ends = (-WALL_M, wall.length + WALL_M)
    corners = [(*wall.point(along, inwards), up) for along in ends for inwards, up in section]
    return Solid(np.array(corners), ((0, 1, 2), (5, 4, 3), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)))


def add_covering(things: Collection, room: Room, hole: Hole) -> None:
    """Curtains at both sides, a sheer over the whole window, slats, or a blind over its upper part."""
    if hole.covering == "none":
        return
    wall = room.outline.walls[hole.wall]
    width, middle, seed = hole.high - hole.low, (hole.low + hole.high) / 2, round(1000 * hole.low) + hole.wall
    name, top = f"Covering {hole.wall} {hole.low:.2f}", min(hole.top + 0.1, room.height - 0.06)
    is_sheer = hole.covering == "sheer"
    tone = (0.8, 0.79, 0.76) if is_sheer else CURTAIN_TONES[seed % len(CURTAIN_TONES)]
    cloth = surfaces.curtain_cloth(name, tone)
    if hole.covering == "curtains":
        side = max(0.22, 0.22 * width)
        drop = top - 0.03 if seed % 2 else top - hole.bottom + 0.1
        for i, along in enumerate((hole.low - 0.1 + side / 2, hole.high + 0.1 - side / 2)):
            within = min(max(along, side / 2 + 0.02), wall.length - side / 2 - 0.02)
            place = Place(things, f"{name} {i}", *wall.point(within, 0.1), top, wall.turn_deg)
            furniture.add_curtain(place, side, drop, cloth, seed=seed + i)
    elif is_sheer:
        place = Place(things, name, *wall.point(middle, 0.1), top, wall.turn_deg)
        furniture.add_curtain(place, width, top - hole.bottom + 0.05, cloth, seed=seed)
    elif hole.covering == "slats":
        place = Place(things, name, *wall.point(middle, 0.04), hole.bottom, wall.turn_deg)
        slat = box((width, 0.035, 0.002)).turned(seed % 120 - 60, "X")
        heights = np.arange(0.02, hole.top - hole.bottom, 0.045)
        place.add(joined([slat.moved((0, 0, height)) for height in heights]), cloth)
    else:
        drop = (0.25 + 0.6 * (seed % 97) / 97) * (hole.top - hole.bottom)
        place = Place(things, name, *wall.point(middle, 0.02), hole.top + 0.02, wall.turn_deg)
        place.add(box((width + 0.04, 0.008, drop), (0, 0, -drop / 2)), cloth)


def _shaded(lamp: Lamp) -> dict[str, float]:
    """What a lamp with a shade shines with."""
    return {"kelvin": lamp.kelvin, "watts": lamp.watts, "radiance": lamp.watts * SHADE_PER_WATT}


def _bulb(place: Place, lamp: Lamp, height: float, radius: float) -> None:
    if lamp.watts > 0:
        lighting.add_bulb(replace(place, z=height), kelvin=lamp.kelvin, watts=lamp.watts, radius=radius)


def _pendant(place: Place, lamp: Lamp, metal: Material) -> None:
    """An opaque dome that shines down."""
    lighting.add_pendant(place, metal, metal, drop=lamp.size_m + 0.1)
    _bulb(place, lamp, lamp.z - lamp.size_m - 0.09, 0.05)


def _globe(place: Place, lamp: Lamp, metal: Material) -> None:
    """A glowing ball on a cord, its light spread over the whole of it."""
    radius, middle = 0.14, lamp.z - lamp.size_m
    cloth = lighting.shade_cloth(f"{place.name} shade", lamp.kelvin, lamp.watts / 9)
    globe = replace(place, z=middle).add(ball(radius, n_segments=32), cloth, "shade", smooth=True)
    globe.visible_shadow = False
    cord = tube((lamp.x, lamp.y, middle + radius), (lamp.x, lamp.y, lamp.z), 0.006, 8)
    add_solid(place.room, f"{place.name} cord", cord, metal)
    _bulb(place, lamp, middle, 0.12)


def _ceiling_light(place: Place, lamp: Lamp, shape: str, **sizes: float) -> bpy.types.Object | None:
    """An area light just under the ceiling, facing down, where the lamp is lit; else None."""
    if lamp.watts <= 0:
        return None
    where = (lamp.x, lamp.y, lamp.z - 0.025)
    look = {"shape": shape, "size": lamp.size_m, "energy": lamp.watts, **sizes}
    light = lighting.add_light(place.room, place.name, "AREA", where, **look)
    lighting.tint_light(light.data, lamp.kelvin)
    return light


def _uplight(place: Place, lamp: Lamp, metal: Material) -> None:
    """A bowl that hides the disk in it from below, so that the ceiling over it gives the light."""
    light = _spot(place, lamp, metal, "bowl", 0.05)
    if light is not None:
        light.rotation_euler.x = math.pi


def _panel(place: Place, lamp: Lamp, metal: Material) -> None:
    s = lamp.size_m
    frame = box((s + 0.04, s + 0.04, 0.02), (lamp.x, lamp.y, lamp.z - 0.01))
    add_solid(place.room, f"{place.name} frame", frame, surfaces.plain(place.name, (0.75, 0.75, 0.74)))
    _ceiling_light(place, lamp, "SQUARE")


def _spot(
    place: Place, lamp: Lamp, metal: Material, part: str = "ring", below_m: float = 0.02
) -> bpy.types.Object | None:
    ring = cylinder(0.6 * lamp.size_m, 0.02).moved((lamp.x, lamp.y, lamp.z - below_m))
    add_solid(place.room, f"{place.name} {part}", ring, metal, smooth=True)
    return _ceiling_light(place, lamp, "DISK")


def _bare_bulb(place: Place, lamp: Lamp, metal: Material) -> None:
    """A bulb or a flame with nothing around it; its size is its radius."""
    _bulb(place, lamp, lamp.z - 1.1 * lamp.size_m, lamp.size_m)


LAMP_MAKERS = {
    "floor": lambda place, lamp, metal: lighting.add_floor_lamp(place, metal, height=lamp.size_m, **_shaded(lamp)),
    "table": lambda place, lamp, metal: lighting.add_table_lamp(
        place, metal, height=lamp.size_m, foot=JUG, **_shaded(lamp)
    ),
    # A tube of 4 cm along X under the ceiling, three times as long as its size.
    "strip": lambda place, lamp, _: _ceiling_light(place, lamp, "RECTANGLE", size=3 * lamp.size_m, size_y=0.04),
    "pendant": _pendant, "globe": _globe, "panel": _panel, "spot": _spot, "uplight": _uplight,
    "bulb": _bare_bulb, "candle": _bare_bulb,
}  # fmt: skip


def add_daylight(scene: bpy.types.Scene, things: Collection, room: Room) -> None:
    """The panorama as the world, the sun, and a portal in each window."""
    daylight = room.daylight
    lighting.set_panorama(scene, f"{daylight.panorama}.exr", strength=daylight.strength, turn_deg=daylight.turn_deg)
    if daylight.sun is not None:
        lighting.add_sun(things, **asdict(daylight.sun))
    for window in room.windows:
        add_portal(things, room, window)


def add_portal(things: Collection, room: Room, hole: Hole) -> None:
    """A light portal at the outside of a window, facing in."""
    wall = room.outline.walls[hole.wall]
    place = (*wall.point((hole.low + hole.high) / 2, -0.2), (hole.bottom + hole.top) / 2)
    size = {"shape": "RECTANGLE", "size": hole.high - hole.low, "size_y": hole.top - hole.bottom}
    portal = lighting.add_light(things, "Portal", "AREA", place, **size)
    portal.data.cycles.is_portal = True
    inwards = BlenderVector((-wall.outward[0], -wall.outward[1], 0.0))
    portal.rotation_euler = inwards.to_track_quat("-Z", "Y").to_euler()
