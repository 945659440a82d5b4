"""Shapes: the geometry that scenes are made of.

A few solids as plain vertices and faces, and one function that turns these into a Blender object. Written
without `bpy.ops`, so that a build depends on nothing but its arguments and the same call gives the same mesh. Rounded
edges and cushions are bevel and subdivision modifiers: the file stays small and the shapes stay editable.

Frames: each solid is made around its own origin in metres, +Z up, and placed by its object's location and turn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from xihe_blender.lab.props import Collection, Material, Vector

BOX_FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
SHARP_ANGLE = math.radians(40)


@dataclass(frozen=True, eq=False)
class Solid:
    """Vertices (V, 3) in metres, and faces as vertex indices that turn anticlockwise seen from outside."""

    vertices: NDArray[Any]
    faces: Sequence[Sequence[int]]

    def moved(self, offset: Vector) -> Solid:
        return Solid(self.vertices + np.asarray(offset), self.faces)

    def turned(self, degrees: float, axis: str = "Z") -> Solid:
        """The same solid, turned about an axis through its origin, anticlockwise seen from the axis' tip."""
        i, j = {"X": (1, 2), "Y": (2, 0), "Z": (0, 1)}[axis]
        points = self.vertices.copy()
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        points[:, [i, j]] = points[:, [i, j]] @ np.array([[c, s], [-s, c]])
        return Solid(points, self.faces)


def joined(solids: Sequence[Solid]) -> Solid:
    firsts = accumulate((len(solid.vertices) for solid in solids[:-1]), initial=0)
    faces = [[first + i for i in face] for first, solid in zip(firsts, solids, strict=True) for face in solid.faces]
    return Solid(np.concatenate([solid.vertices for solid in solids]), faces)


def box(size: Vector, centre: Vector = (0.0, 0.0, 0.0)) -> Solid:
    """A box of full extents `size` around `centre`."""
    corners = [(x, y, z) for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]
    return Solid(np.array(corners) * size + centre, BOX_FACES)


def box_between(low: Vector, high: Vector) -> Solid:
    ends = np.array((low, high), float)
    return box((ends[1] - ends[0]).tolist(), (ends.sum(axis=0) / 2).tolist())


def revolved(profile: Sequence[tuple[float, float]], n_segments: int) -> Solid:
    """A solid of revolution about Z from a profile of (radius, height) that runs upwards on the outside.

    A radius of 0 at an end closes it with a fan; otherwise it stays open.
    """
    vertices: list[tuple[float, float, float]] = []
    rings: list[list[int]] = []
    for radius, height in profile:
        n = n_segments if radius > 0 else 1
        rings.append(list(range(len(vertices), len(vertices) + n)))
        angles = 2 * np.pi * np.arange(n) / n
        vertices += [(radius * math.cos(a), radius * math.sin(a), height) for a in angles.tolist()]
    faces = [face for low, high in pairwise(rings) for face in _band(low, high, n_segments)]
    return Solid(np.array(vertices), faces)


def _band(low: list[int], high: list[int], n: int) -> list[tuple[int, ...]]:
    """Faces between two rings, of which either may be a single point."""
    lower, upper = (np.resize(ring, n + 1).tolist() for ring in (low, high))
    return [tuple(dict.fromkeys((lower[i], lower[i + 1], upper[i + 1], upper[i]))) for i in range(n)]


def cylinder(radius: float, height: float, n_segments: int = 24) -> Solid:
    """A closed cylinder that stands on its origin."""
    return revolved([(0, 0), (radius, 0), (radius, height), (0, height)], n_segments)


def ball(radius: float, centre: Vector = (0.0, 0.0, 0.0), n_segments: int = 48) -> Solid:
    angles = np.linspace(-np.pi / 2, np.pi / 2, n_segments // 2 + 1)
    profile = [(radius * math.cos(a), radius * math.sin(a)) for a in angles.tolist()]
    profile[0], profile[-1] = (0.0, -radius), (0.0, radius)
    return revolved(profile, n_segments).moved(centre)


def tube(start: Vector, end: Vector, radius: float, n_segments: int = 12) -> Solid:
    """A closed round bar between two points."""
    a, b = np.array(start, float), np.array(end, float)
    along = (b - a) / np.linalg.norm(b - a)
    side = np.cross(along, (0.0, 0.0, 1.0) if abs(along[2]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(along, side), along])
    upright = cylinder(radius, float(np.linalg.norm(b - a)), n_segments)
    return Solid(upright.vertices @ frame + a, upright.faces)


def sheet(grid: NDArray[Any]) -> Solid:
    """An open surface through a grid of points (rows, columns, 3)."""
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 4)
    return Solid(grid.reshape(-1, 3), quads.tolist())


def add_solid(
    collection: Collection, name: str, solid: Solid, material: Material, *, location: Vector = (0.0, 0.0, 0.0),
    turn_deg: float = 0.0, bevel_m: float = 0.0, subdivisions: int = 0, smooth: bool = False,
) -> bpy.types.Object:  # fmt: skip
    """Make an object of `solid` in `collection`.

    Parameters
    ----------
    location, turn_deg : of the object; the turn is about +Z
    bevel_m : rounds sharp edges with this width; 0 leaves them
    subdivisions : levels of Catmull-Clark smoothing; 0 for none
    smooth : smooth shading, except across edges sharper than 40 degrees
    """
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(solid.vertices.tolist(), [], solid.faces)
    mesh.materials.append(material)
    if smooth or subdivisions:
        mesh.shade_smooth()
        if not subdivisions:
            mesh.set_sharp_from_angle(angle=SHARP_ANGLE)
    thing = bpy.data.objects.new(name, mesh)
    thing.location, thing.rotation_euler = location, (0.0, 0.0, math.radians(turn_deg))
    collection.objects.link(thing)
    if bevel_m:
        bevel = thing.modifiers.new("Rounded edges", "BEVEL")
        bevel.width, bevel.segments, bevel.limit_method = bevel_m, 2, "ANGLE"
    if subdivisions:
        smoothing = thing.modifiers.new("Soft shape", "SUBSURF")
        smoothing.levels = smoothing.render_levels = subdivisions
    return thing


@dataclass(frozen=True)
class Place:
    """A piece of `room`: its name, where it stands, and its turn about +Z, before which its front looks towards -Y."""

    room: Collection
    name: str
    x: float
    y: float
    z: float = 0.0
    turn_deg: float = 0.0

    def add(self, solid: Solid, material: Material, part: str = "", **look: Any) -> bpy.types.Object:
        """Make an object of `solid` there, named after the piece and its `part`; `look` is what `add_solid` takes."""
        name, location = f"{self.name} {part}".rstrip(), (self.x, self.y, self.z)
        return add_solid(self.room, name, solid, material, location=location, turn_deg=self.turn_deg, **look)
