"""What stands outside a house: benches, planters with shrubs, low walls with coping."""

from __future__ import annotations

import numpy as np

from xihe_blender.lab.props import Material, Vector
from xihe_blender.lab.props.shapes import Place, Solid, box, box_between, joined


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
    *, shrub_m: float = 0.4,
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
