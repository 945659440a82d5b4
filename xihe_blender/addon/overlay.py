"""The overlay of the 3D view: where is light estimated, and how much of the surroundings was seen from there?

A disc at each estimation position, coloured by its coverage in the last run, with its name and share. Discs are drawn
in the picture's plane and over everything: a position lies inside its object. Where it was asked where the phone should
look, an arrow says so at the camera path. Rejected: points of the GPU, whose size some of its backends ignore.

Positions are computed when something has changed, not when the view is drawn: handlers only set a flag. The one object
at module level, `_overlay`, holds the handle that has to be given back. In background there is nothing to draw on.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import bpy

from xihe_blender.addon.look_operators import advice_for
from xihe_blender.addon.polls import may_move
from xihe_blender.addon.runs_folder import last_run
from xihe_blender.apply.datablocks import SAME_PLACE_M, moved_positions, still_positions
from xihe_blender.errors import UserError
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import virtual_objects

Colour = tuple[float, float, float, float]
Box = tuple[float, float, float, float]
"""Left, bottom, right, top, in pixels of the region."""

RADIUS_PX = 6.0
N_CORNERS = 20
FONT = 0
FONT_PX = 12.0
LINE, INSET = 1.2, 0.3
"""Height of a line, and what is left free around its words, in sizes of the font."""

RIM: Colour = (0.0, 0.0, 0.0, 0.8)
BEHIND_TEXT: Colour = (0.0, 0.0, 0.0, 0.5)
UNKNOWN: Colour = (0.85, 0.85, 0.85, 1.0)
LITTLE: Colour = (0.95, 0.35, 0.15, 1.0)
MUCH: Colour = (0.20, 0.75, 0.95, 1.0)
"""Orange and blue, which look different to nearly everyone."""

LOOK: Colour = (1.0, 0.55, 0.0, 1.0)
LOOK_M = 0.7
SHAFT_PX = 4.0


class Position(NamedTuple):
    """One estimation position, named as in results.json, in the world: Blender units, as the view has them.

    `may_move` says whether keys, drivers, constraints or physics could move its object.
    """

    name: str
    place: tuple[float, float, float]
    may_move: bool = False


class Overlay:
    """The draw handler, the positions it draws by name of the scene, until something changes, and where its labels are
    by pointer of the region.
    """

    def __init__(self) -> None:
        self.positions: dict[str, list[Position]] = {}
        self.labels: dict[int, list[Box]] = {}
        self._handle = bpy.types.SpaceView3D.draw_handler_add(self.draw, (), "WINDOW", "POST_PIXEL")

    def remove(self) -> None:
        bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")

    def draw(self) -> None:
        """Called by Blender for every 3D view that is drawn."""
        context = bpy.context
        scene, space = context.scene, context.space_data
        taken = self.labels[context.region.as_pointer()] = []
        if not (scene.xihe.show_positions and space.overlay.show_overlays):
            return
        if scene.name not in self.positions:
            self.positions[scene.name] = shown_positions(scene, context.evaluated_depsgraph_get())
        run = last_run(scene.xihe.run_folder)
        shares = shares_seen(scene, self.positions[scene.name], run.last_coverage if run else {})
        for position, x, y in on_screen(context, self.positions[scene.name]):
            seen = shares.get(position.name)
            draw_disc(x, y, colour_of(seen))
            draw_label(x, y, position.name if seen is None else f"{position.name}  {seen:.0%}", taken)
        labelled: set[tuple[float, ...]] = set()
        for look in [json.loads(row.look) for row in advice_for(context) if row.look]:
            start = draw_look(context, look)
            # Objects beside each other ask for a look from the same place.
            if start is not None and (spot := (look["frame"], *look["place_m"])) not in labelled:
                labelled.add(spot)
                draw_label(*start, f"look at frame {look['frame']}", taken)


def shown_positions(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> list[Position]:
    """The estimation positions of all virtual objects as a run would name them, at the frame that is shown.

    An object whose positions a run would refuse has none.
    """
    # NumPy comes with it, which must wait until something is shown.
    from xihe_blender.scene.estimation_positions import all_box_corners_m, named_positions

    metres, objects = metres_per_unit(scene), virtual_objects(scene)
    corners_m = all_box_corners_m(objects, depsgraph)
    found = []
    for item in objects:
        try:
            positions_m = named_positions(item, corners_m=corners_m[item])
        except UserError:
            continue
        for name, position_m in positions_m.items():
            x, y, z = (position_m / metres).tolist()
            found.append(Position(name, (x, y, z), may_move(item)))
    return found


def shares_seen(scene: bpy.types.Scene, positions: Sequence[Position], coverage: dict[str, float]) -> dict[str, float]:
    """Share of the sphere that was seen from each of `positions`, by name; `coverage` has those of the run.

    Without objects that were moved since and are not followed: nothing is known of where they are.
    """
    stood, metres = still_positions(scene), metres_per_unit(scene)
    found = coverage | {name: seen for name, (seen, _) in moved_positions(scene).items()}
    for position in positions:
        is_followed = scene.xihe.follows_objects and not position.may_move
        place_m = [metres * along for along in position.place]
        was_m = stood.get(position.name, place_m)
        if not is_followed and math.dist(place_m, was_m) >= SAME_PLACE_M:
            found.pop(position.name, None)
    return found


def on_screen(context: bpy.types.Context, positions: Sequence[Position]) -> Iterator[tuple[Position, float, float]]:
    """Those of `positions` in front of the view, with their pixel in the region."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d

    for position in positions:
        pixel = location_3d_to_region_2d(context.region, context.region_data, position.place)
        if pixel is not None:
            yield position, pixel.x, pixel.y


def draw_look(context: bpy.types.Context, look: Mapping[str, Any]) -> tuple[float, float] | None:
    """An arrow from where the phone should stand to where it should look; its start on screen, if it is in view."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d

    metres = metres_per_unit(context.scene)
    along = list(zip(look["place_m"], look["direction"], strict=True))
    ends = [tuple((p + far * d) / metres for p, d in along) for far in (0, LOOK_M)]
    start, tip = (location_3d_to_region_2d(context.region, context.region_data, end) for end in ends)
    if start is None or tip is None:
        return None
    draw_triangles(arrow_corners((start.x, start.y), (tip.x, tip.y)), LOOK)
    draw_disc(start.x, start.y, LOOK)
    return start.x, start.y


def arrow_corners(start: tuple[float, float], tip: tuple[float, float]) -> list[tuple[float, float]]:
    """Three triangles, in pixels: two of the shaft and one of the head; none for an arrow without length."""
    scale = bpy.context.preferences.system.ui_scale
    along = tip[0] - start[0], tip[1] - start[1]
    length = math.hypot(*along)
    if length < 1e-3:
        return []
    x, y = along[0] / length, along[1] / length
    half, head = SHAFT_PX * scale / 2, min(length, 4 * SHAFT_PX * scale)
    neck = tip[0] - head * x, tip[1] - head * y

    def beside(place: tuple[float, float], width: float) -> tuple[float, float]:
        return place[0] - width * y, place[1] + width * x

    a, b, c, d = beside(start, half), beside(start, -half), beside(neck, -half), beside(neck, half)
    return [a, b, c, a, c, d, beside(neck, 4 * half), beside(neck, -4 * half), tip]


def draw_triangles(corners: Sequence[tuple[float, float]], colour: Colour) -> None:
    """Filled, each of three corners."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    if corners:
        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        shader.uniform_float("color", colour)
        batch_for_shader(shader, "TRIS", {"pos": corners}).draw(shader)


def colour_of(coverage: float | None) -> Colour:
    """From orange at 0 to blue at 1, by the share of the sphere that was seen; grey where nothing is known."""
    if coverage is None:
        return UNKNOWN
    share = min(1.0, max(0.0, coverage))
    red, green, blue = (low + share * (high - low) for low, high in zip(LITTLE[:3], MUCH[:3], strict=True))
    return red, green, blue, 1.0


def draw_disc(x: float, y: float, colour: Colour) -> None:
    """A filled disc with a dark rim."""
    import gpu

    scale = bpy.context.preferences.system.ui_scale
    turns = [2 * math.pi * k / N_CORNERS for k in range(N_CORNERS)]
    gpu.state.blend_set("ALPHA")
    for radius, paint in (((RADIUS_PX + 1.5) * scale, RIM), (RADIUS_PX * scale, colour)):
        first, *others = [(x + radius * math.cos(turn), y + radius * math.sin(turn)) for turn in turns]
        draw_triangles([corner for pair in pairwise(others) for corner in (first, *pair)], paint)
    gpu.state.blend_set("NONE")


def draw_label(x: float, y: float, text: str, taken: list[Box]) -> None:
    """`text` beside the disc, below the labels of `taken`."""
    scale = bpy.context.preferences.system.ui_scale
    left, bottom = x + (RADIUS_PX + 2) * scale, y - LINE / 2 * FONT_PX * scale
    box = below_others(box_of(left, bottom, text), taken)
    taken.append(box)
    draw_text(box[0], box[1], text)


def box_of(left: float, bottom: float, text: str) -> Box:
    """The dark box on which `draw_text` draws `text` there."""
    return left, bottom, left + text_width(text), bottom + LINE * font_size()


def text_width(text: str) -> float:
    """Of that box, in pixels."""
    import blf

    blf.size(FONT, font_size())
    return float(blf.dimensions(FONT, text)[0]) + 2 * INSET * font_size()


def font_size() -> float:
    return FONT_PX * float(bpy.context.preferences.system.ui_scale)


def draw_text(left: float, bottom: float, text: str) -> None:
    """White on a dark box, to be read before a bright window, whose corner is at these pixels of the region."""
    import blf
    import gpu

    _, _, right, top = box_of(left, bottom, text)
    low_left, low_right, high_right, high_left = (left, bottom), (right, bottom), (right, top), (left, top)
    gpu.state.blend_set("ALPHA")
    draw_triangles([low_left, low_right, high_right, low_left, high_right, high_left], BEHIND_TEXT)
    gpu.state.blend_set("NONE")
    blf.size(FONT, font_size())
    blf.color(FONT, 1.0, 1.0, 1.0, 1.0)
    blf.position(FONT, left + INSET * font_size(), bottom + INSET * font_size(), 0)
    blf.draw(FONT, text)


def below_others(wanted: Box, taken: Sequence[Box]) -> Box:
    """`wanted`, moved down until it overlaps none of `taken`."""
    left, bottom, right, top = wanted
    for other in sorted(taken, key=lambda box: -box[1]):
        if left < other[2] and other[0] < right and bottom < other[3] and other[1] < top:
            bottom, top = other[1] - (top - bottom), other[1]
    return left, bottom, right, top


_overlay: Overlay | None = None


def labels_in(region: bpy.types.Region) -> Sequence[Box]:
    """Of the positions, as they were drawn last."""
    return () if _overlay is None else _overlay.labels.get(region.as_pointer(), ())


@bpy.app.handlers.persistent
def forget_positions(*_: Any) -> None:
    """They are computed anew when a view is drawn next."""
    if _overlay is not None:
        _overlay.positions.clear()


HANDLERS = dict.fromkeys(("depsgraph_update_post", "frame_change_post", "load_post"), forget_positions)


def register() -> None:
    global _overlay
    _overlay = None if bpy.app.background else Overlay()


def unregister() -> None:
    global _overlay
    if _overlay is not None:
        _overlay.remove()
    _overlay = None
