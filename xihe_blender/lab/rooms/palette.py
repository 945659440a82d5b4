"""The palette of rooms: finishes, sampled, weighted towards what homes and offices look like.

Colours are linear Rec.709. Walls are mostly light, since most walls are; some have a strong colour, because coloured
walls are what tints the light. Albedo stays below 0.85.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xihe_blender.lab.rooms.draws import Rng, one_of, span
from xihe_blender.lab.rooms.room_data import Colour, Finish

LIGHT_WALLS: tuple[Colour, ...] = (
    (0.75, 0.73, 0.68), (0.78, 0.77, 0.75), (0.7, 0.66, 0.58), (0.66, 0.68, 0.68), (0.72, 0.65, 0.52),
    (0.58, 0.56, 0.53), (0.62, 0.68, 0.62), (0.68, 0.6, 0.56),
)  # fmt: skip
STRONG_WALLS: tuple[Colour, ...] = (
    (0.1, 0.2, 0.3), (0.3, 0.42, 0.3), (0.45, 0.12, 0.08), (0.55, 0.35, 0.1), (0.12, 0.12, 0.14), (0.28, 0.36, 0.48),
    (0.5, 0.25, 0.28), (0.6, 0.5, 0.2), (0.12, 0.25, 0.2), (0.35, 0.2, 0.3),
)  # fmt: skip
WOODS: tuple[tuple[Colour, Colour], ...] = (
    ((0.26, 0.14, 0.065), (0.4, 0.23, 0.12)), ((0.15, 0.08, 0.045), (0.25, 0.15, 0.085)),
    ((0.45, 0.31, 0.18), (0.6, 0.44, 0.27)), ((0.05, 0.035, 0.03), (0.09, 0.06, 0.05)),
    ((0.55, 0.45, 0.33), (0.68, 0.58, 0.45)), ((0.3, 0.1, 0.05), (0.42, 0.17, 0.08)),
    ((0.32, 0.28, 0.24), (0.42, 0.38, 0.33)),
)  # fmt: skip
CLOTHS: tuple[Colour, ...] = (
    (0.3, 0.28, 0.25), (0.08, 0.12, 0.2), (0.45, 0.4, 0.33), (0.35, 0.1, 0.08), (0.1, 0.18, 0.12), (0.5, 0.33, 0.1),
    (0.05, 0.05, 0.055), (0.68, 0.66, 0.62), (0.2, 0.3, 0.36), (0.4, 0.22, 0.12), (0.55, 0.3, 0.3), (0.3, 0.12, 0.25),
    (0.6, 0.15, 0.05), (0.12, 0.3, 0.3),
)  # fmt: skip
CARPETS: tuple[Colour, ...] = (
    (0.45, 0.42, 0.38), (0.3, 0.29, 0.28), (0.55, 0.5, 0.43), (0.25, 0.3, 0.38), (0.4, 0.3, 0.28), (0.3, 0.36, 0.28),
)  # fmt: skip
METALS: tuple[Colour, ...] = ((0.6, 0.6, 0.6), (0.75, 0.5, 0.2), (0.05, 0.05, 0.05), (0.8, 0.8, 0.8), (0.7, 0.35, 0.2))
TILES: tuple[tuple[Colour, Colour], ...] = (
    ((0.75, 0.75, 0.73), (0.68, 0.69, 0.68)), ((0.45, 0.43, 0.4), (0.38, 0.37, 0.35)),
    ((0.08, 0.08, 0.085), (0.11, 0.11, 0.12)), ((0.5, 0.24, 0.14), (0.42, 0.19, 0.11)),
    ((0.3, 0.42, 0.45), (0.24, 0.36, 0.4)), ((0.66, 0.6, 0.5), (0.6, 0.54, 0.45)),
)  # fmt: skip


def jittered(rng: Rng, colour: Colour, amount: float = 0.12) -> Colour:
    """The colour a little brighter or darker, and a little off in hue."""
    factors = np.exp(rng.normal(0, amount, 1) + rng.normal(0, amount / 3, 3))
    r, g, b = np.clip(np.array(colour) * factors, 0.01, 0.85).tolist()
    return r, g, b


def pick(rng: Rng, colours: Sequence[Colour]) -> Colour:
    """One of the colours, jittered, and faded towards its own grey: most things at home are not as sold."""
    return jittered(rng, faded(one_of(rng, colours), span(rng, 0.3, 0.9)))


def wall_colour(rng: Rng) -> Colour:
    """A light wall. Nearly grey: light that is reflected five times shows a tint five times as strong."""
    return jittered(rng, faded(one_of(rng, LIGHT_WALLS), span(rng, 0.4, 0.95)), 0.08)


def faded(colour: Colour, share: float) -> Colour:
    """The colour mixed with its own grey; the luminance stays."""
    grey = 0.2126 * colour[0] + 0.7152 * colour[1] + 0.0722 * colour[2]
    r, g, b = (c + (grey - c) * share for c in colour)
    return r, g, b


def wood_finish(rng: Rng, roughness: float | None = None) -> Finish:
    dark, light = (faded(tone, 0.62) for tone in one_of(rng, WOODS))
    worn = span(rng, 0.2, 0.6) if roughness is None else roughness
    return Finish("wood", jittered(rng, dark), jittered(rng, light), worn)


def lacquer_finish(rng: Rng) -> Finish:
    colour = (0.74, 0.74, 0.72) if rng.random() < 0.55 else one_of(rng, CLOTHS)
    return Finish("plain", jittered(rng, colour), roughness=span(rng, 0.15, 0.6))


def trim_finish(rng: Rng) -> Finish:
    """Skirting, frames and doors: white, wood, or now and then a colour."""
    draw = rng.random()
    if draw < 0.65:
        return Finish("plain", jittered(rng, (0.74, 0.74, 0.72), 0.06), roughness=span(rng, 0.2, 0.6))
    return wood_finish(rng) if draw < 0.88 else lacquer_finish(rng)


def board_finish(rng: Rng) -> Finish:
    """What cases and table tops are made of."""
    return wood_finish(rng) if rng.random() < 0.6 else lacquer_finish(rng)


def cloth_finish(rng: Rng) -> Finish:
    """Upholstery: woven, or leather one time in five."""
    kind = "leather" if rng.random() < 0.2 else "fabric"
    return Finish(kind, pick(rng, CLOTHS), roughness=span(rng, 0.3, 0.5), scale=span(rng, 80, 220))


def metal_finish(rng: Rng) -> Finish:
    return Finish("metal", pick(rng, METALS), roughness=span(rng, 0.08, 0.5))


def glaze_finish(rng: Rng) -> Finish:
    return Finish("plain", pick(rng, CLOTHS + LIGHT_WALLS[:4]), roughness=span(rng, 0.05, 0.6))


def floor_finish(rng: Rng, kind: str) -> Finish:
    """Planks, tiles, carpet or screed; wet rooms are tiled."""
    draw = float(rng.random()) if kind not in ("bathroom", "kitchen") else 0.55 + 0.2 * float(rng.random())
    gloss = float(rng.choice([0.08, 0.25, 0.45, 0.7]))
    if draw < 0.55:
        dark, light = (faded(tone, 0.7) for tone in one_of(rng, WOODS))
        if rng.random() < 0.5:
            dark, light = np.minimum(0.8, 1.5 * np.array([dark, light]))
        return Finish("planks", jittered(rng, dark), jittered(rng, light), gloss, span(rng, 0.08, 0.22))
    if draw < 0.75:
        first, second = (jittered(rng, tone) for tone in one_of(rng, TILES))
        return Finish("tiles", first, second, gloss, float(rng.choice([0.2, 0.33, 0.6])))
    if draw < 0.92:
        return Finish("fabric", pick(rng, CARPETS), roughness=1.0, scale=200.0)
    return Finish("plain", jittered(rng, (0.4, 0.39, 0.38)), roughness=gloss)


def wall_finishes(rng: Rng, kind: str, n_walls: int) -> tuple[Finish, ...]:
    """One finish for all walls, or an accent wall, or all strong; wet rooms tiled in half of the cases."""
    base = Finish("paint", wall_colour(rng), roughness=span(rng, 0.5, 0.9))
    draw = rng.random()
    if kind in ("bathroom", "kitchen") and draw < 0.5:
        first, second = (jittered(rng, tone) for tone in one_of(rng, TILES))
        base = Finish("wall tiles", first, second, span(rng, 0.1, 0.4), 0.2)
    elif draw < 0.09:
        base = Finish("paint", pick(rng, STRONG_WALLS), roughness=0.7)
    elif draw < 0.13:
        base = Finish("brick", jittered(rng, (0.36, 0.22, 0.17)), jittered(rng, (0.46, 0.3, 0.24)), 0.85)
    elif draw < 0.17:
        base = wood_finish(rng, 0.5)
    walls = [base] * n_walls
    if rng.random() < 0.22:
        walls[int(rng.integers(n_walls))] = Finish("paint", pick(rng, STRONG_WALLS), roughness=0.7)
    return tuple(walls)


def ceiling_finish(rng: Rng) -> Finish:
    if rng.random() < 0.9:
        return Finish("paint", jittered(rng, (0.78, 0.77, 0.75), 0.06), roughness=0.8)
    return wood_finish(rng, 0.6) if rng.random() < 0.5 else Finish("paint", wall_colour(rng), roughness=0.8)
