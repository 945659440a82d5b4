"""The placement map over the 3D view: where will AR light fail? With its legend, and the place under the mouse.

The map is made from the frames of the last run, without a render, as `xihe placement` makes it. Squares, legend and
words are drawn over the view in any shading; the mesh behind them is `apply.placement_map`'s. Where the mouse is a
gizmo finds out that draws nothing: Blender asks each gizmo whether the mouse is over it. Rejected: an operator that
watches the mouse, which keeps Blender from saving its own backups for as long as it runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import Action
from xihe_blender.addon.modal_job import ModalJob
from xihe_blender.addon.overlay import (
    Box,
    Position,
    below_others,
    box_of,
    draw_disc,
    draw_text,
    labels_in,
    on_screen,
    text_width,
)
from xihe_blender.addon.panels import StagePanel, sentence
from xihe_blender.addon.properties import last_run_folder
from xihe_blender.addon.runs_folder import found_folder
from xihe_blender.apply.datablocks import placement_map
from xihe_blender.apply.placement_map import COLOURS, MapOf, remove_placement_map, show_placement_map, shown_place
from xihe_blender.errors import UserError
from xihe_blender.io.placement_results import RAMP
from xihe_blender.jobs import Job
from xihe_blender.scene.units import metres_per_unit

if TYPE_CHECKING:
    from xihenet.records import ArrayF32

OPACITY = 0.75
SECOND_LIFT_M = 0.002
"""Height of the drawn squares above the mesh, whose own faces would otherwise show through them."""

LEGEND_PX, LEGEND_HIGH_PX, MARGIN_PX = 180.0, 12.0, 24.0
MOUSE_OFFSET_PX = 18.0
RING = (1.0, 0.85, 0.2, 1.0)
FLAT = 1e-6
"""A line of sight that falls less than this meets no square."""


def has_map(_context: bpy.types.Context) -> str | None:
    return None if placement_map() else "There is no map yet: press Map Room first"


class XIHE_OT_map_places(polls.Conditional, ModalJob, bpy.types.Operator):
    bl_idname = "xihe.map_places"
    bl_label = "Map Room"
    bl_description = (
        "Estimate the light at every place where an object could stand, from the last run's frames, and show where it "
        "will be right and where it will fail; nothing is rendered"
    )
    bl_options = {"REGISTER", "UNDO"}
    cancelled = "No map was made"
    conditions = (polls.is_idle, polls.is_room, polls.has_cycles, polls.has_last_run)

    def start_job(self, context: bpy.types.Context) -> Job[Any]:
        from xihe_blender.previs.kept_session import open_kept_session
        from xihe_blender.previs.placement import PlacementSettings, map_places

        chosen = context.scene.xihe
        wanted = PlacementSettings(height_m=chosen.map_height_m if chosen.maps_air else None)

        def job() -> Job[Any]:
            session = yield from open_kept_session(last_run_folder(self.scene))
            return wanted, (yield from map_places(session, wanted))

        return job()

    def finish(self, context: bpy.types.Context, result: Any) -> set[str]:
        wanted, mapped = result
        scene = self.scene
        clearance_m = wanted.clearance_m if wanted.height_m is None else 0.0
        show_placement_map(
            scene, mapped.places, spacing_m=mapped.spacing_m, clearance_m=clearance_m, folder=last_run_folder(scene)
        )
        scene.xihe.show_map, scene.xihe.map_place = True, -1
        self.report({"INFO"}, f"{len(mapped.places)} places, {mapped.spacing_m:.2f} m apart")
        return {"FINISHED"}


class XIHE_OT_go_to_place(Action, bpy.types.Operator):
    bl_idname = "xihe.go_to_place"
    bl_label = "Go to Place"
    bl_description = "Put the 3D cursor at this place and mark it. Shift S then moves the selected object there"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_own_scene, has_map)

    index: bpy.props.IntProperty(name="Place", description="Number of the place on the map", min=0)

    def act(self, context: bpy.types.Context) -> str | None:
        item = placement_map()
        if item is None or self.index >= len(item.data.polygons):
            raise UserError(f"the map has no place {self.index}: make the map again")
        place, metres = shown_place(item, self.index), metres_per_unit(context.scene)
        context.scene.cursor.location = [number / metres for number in place.position_m]
        context.scene.xihe.map_place = self.index
        return format_place(item, self.index)


class XIHE_OT_remove_map(Action, bpy.types.Operator):
    bl_idname = "xihe.remove_map"
    bl_label = "Remove Map"
    bl_description = "Delete the placement map from the file"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, has_map)

    def act(self, _context: bpy.types.Context) -> None:
        remove_placement_map()


def format_place(item: bpy.types.Object, index: int) -> str:
    """One line about the place of a face of the map."""
    place = shown_place(item, index)
    if place.expected_error is None or place.irradiance is None:
        return f"coverage {place.coverage:.0%}, light unknown"
    light = " ".join(f"{one:.2g}" if one < 99.5 else f"{one:,.0f}" for one in place.irradiance)
    known = f"expected error {place.expected_error:.3f}, coverage {place.coverage:.0%}"
    return f"{known}, estimated irradiance {light}"


class XIHE_PT_placement(StagePanel, bpy.types.Panel):
    bl_label = "Placement Map"
    bl_parent_id = "XIHE_PT_results"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings, item = self.layout, context.scene.xihe, placement_map()
        row = layout.row(align=True)
        row.prop(settings, "maps_air")
        height = row.row(align=True)
        height.active = settings.maps_air
        height.prop(settings, "map_height_m", text="")
        row = layout.row(align=True)
        row.operator("xihe.map_places", icon="MOD_HUE_SATURATION")
        if item is None:
            return
        row.prop(settings, "show_map", text="", icon="HIDE_OFF")
        row.operator("xihe.remove_map", text="", icon="TRASH")
        shown = MapOf.read(item.data)
        if found_folder(shown.folder) != last_run_folder(context.scene):
            sentence(context, layout, "The map is of an earlier run: map the room again", icon="INFO")
        row = layout.row()
        for heading, indices in (("Best", shown.best), ("Worst", shown.worst)):
            column = row.column(align=True)
            column.label(text=heading)
            for index in indices:
                error = item.data.attributes["expected_error"].data[index].value
                column.operator("xihe.go_to_place", text=f"{error:.3f}").index = index


# -------------------------------------------------------------------------------------------------------- over the view


class Squares:
    """The squares of one map as they are drawn: corners (4 K, 3) in Blender units, colours (4 K, 4) in Rec.709."""

    def __init__(self, item: bpy.types.Object) -> None:
        import numpy as np

        from xihenet.colour import srgb_to_linear

        mesh = item.data
        corners, colours = np.empty(3 * len(mesh.vertices), "f"), np.empty(4 * len(mesh.loops), "f")
        mesh.vertices.foreach_get("co", corners)
        # As light they would be in the file's working space.
        mesh.color_attributes[COLOURS].data.foreach_get("color_srgb", colours)
        self.corners: ArrayF32 = corners.reshape(-1, 3)
        self.corners[:, 2] += SECOND_LIFT_M / metres_per_unit(bpy.context.scene)
        self.colours: ArrayF32 = srgb_to_linear(colours.reshape(-1, 4))
        self.colours[:, 3] = OPACITY
        self.batch: Any = None

    def draw(self) -> None:
        import gpu
        import numpy as np
        from gpu_extras.batch import batch_for_shader

        shader = gpu.shader.from_builtin("SMOOTH_COLOR")
        if self.batch is None:
            first = 4 * np.arange(len(self.corners) // 4)[:, None]
            triangles = np.concatenate([first + (0, 1, 2), first + (0, 2, 3)]).astype("i")
            self.batch = batch_for_shader(
                shader, "TRIS", {"pos": self.corners, "color": self.colours}, indices=triangles
            )
        gpu.state.blend_set("ALPHA")
        gpu.state.depth_test_set("LESS_EQUAL")
        self.batch.draw(shader)
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")

    def hit(self, origin: Any, direction: Any) -> int | None:
        """The first square that the line of sight from `origin` along `direction` meets; squares are level."""
        import numpy as np

        if abs(direction[2]) < FLAT or not len(self.corners):
            return None
        low, high = self.corners[0::4], self.corners[2::4]
        along = (low[:, 2] - origin[2]) / direction[2]
        points = np.array(origin)[:2] + along[:, None] * np.array(direction)[:2]
        inside = ((points >= low[:, :2]) & (points <= high[:, :2])).all(axis=1) & (along > 0)
        return int(np.argmin(np.where(inside, along, np.inf))) if inside.any() else None


class MapView:
    """What is drawn, and where the mouse is, in pixels of the region named by its pointer."""

    def __init__(self) -> None:
        self.squares: Squares | None = None
        self.squares_of = ""
        self.mouse: tuple[int, float, float] | None = None
        space = bpy.types.SpaceView3D
        self.handles = [
            space.draw_handler_add(self.draw_squares, (), "WINDOW", "POST_VIEW"),
            space.draw_handler_add(self.draw_words, (), "WINDOW", "POST_PIXEL"),
        ]

    def remove(self) -> None:
        for handle in self.handles:
            bpy.types.SpaceView3D.draw_handler_remove(handle, "WINDOW")

    def of(self, item: bpy.types.Object) -> Squares:
        """As they were made: the map is not there to be edited."""
        made = f"{item.data.session_uid} {len(item.data.vertices)}"
        if self.squares is None or self.squares_of != made:
            self.squares, self.squares_of = Squares(item), made
        return self.squares

    def draw_squares(self) -> None:
        item = shown_map(bpy.context)
        if item is not None:
            self.of(item).draw()

    def draw_words(self) -> None:
        context = bpy.context
        item = shown_map(context)
        if item is None:
            return
        draw_legend(MapOf.read(item.data).error_range)
        index = self.under_mouse(context, item)
        if index is not None and self.mouse is not None:
            words = format_place(item, index)
            draw_text(*self.box_of_words(context, words)[:2], words)
        draw_ring(context, item)

    def box_of_words(self, context: bpy.types.Context, words: str) -> Box:
        """Beside the mouse, in the region, and over no label of a position."""
        _, x, y = self.mouse or (0, 0.0, 0.0)
        offset = MOUSE_OFFSET_PX * context.preferences.system.ui_scale
        left = max(0.0, min(x + offset, context.region.width - text_width(words) - MARGIN_PX))
        return below_others(box_of(left, y + offset, words), labels_in(context.region))

    def under_mouse(self, context: bpy.types.Context, item: bpy.types.Object) -> int | None:
        """The face of the map under the mouse, as far as it is in this region."""
        from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

        if self.mouse is None or self.mouse[0] != context.region.as_pointer():
            return None
        pixel = self.mouse[1:]
        origin = region_2d_to_origin_3d(context.region, context.region_data, pixel)
        direction = region_2d_to_vector_3d(context.region, context.region_data, pixel)
        return self.of(item).hit(origin, direction)


def shown_map(context: bpy.types.Context) -> bpy.types.Object | None:
    """The map, where this 3D view is to show it."""
    if not (context.scene.xihe.show_map and context.space_data.overlay.show_overlays):
        return None
    item = placement_map()
    return item if item is not None and item.visible_get() else None


def draw_legend(error_range: tuple[float, float]) -> None:
    """At the lower left, right of the toolbar, which lies over the view: what the colours mean."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    scale = bpy.context.preferences.system.ui_scale
    bars = [bar for bar in bpy.context.area.regions if bar.type == "TOOLS" and bar.width > 1]
    bottom = MARGIN_PX * scale
    left = bottom + max([0, *(bar.x + bar.width - bpy.context.region.x for bar in bars)])
    width, high = LEGEND_PX * scale, LEGEND_HIGH_PX * scale
    steps = [left + width * k / (len(RAMP) - 1) for k in range(len(RAMP))]
    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    corners = [(x, y) for x in steps for y in (bottom, bottom + high)]
    linear = [(*((part / 255) ** 2.2 for part in colour), 1.0) for colour in RAMP for _ in range(2)]
    batch_for_shader(shader, "TRI_STRIP", {"pos": corners, "color": linear}).draw(shader)
    low, most = (f"{error:.3f}" for error in error_range)
    draw_text(left, bottom + 1.6 * high, "Expected error of AR light")
    draw_text(left + width + high / 2, bottom, f"{low} to {most} and more; grey: unknown")


def draw_ring(context: bpy.types.Context, item: bpy.types.Object) -> None:
    """Around the place that was chosen from the lists."""
    index = context.scene.xihe.map_place
    if 0 <= index < len(item.data.polygons):
        place = Position("", tuple(item.data.polygons[index].center))
        for _, x, y in on_screen(context, [place]):
            draw_disc(x, y, RING)


_view: MapView | None = None


class XIHE_GT_mouse(bpy.types.Gizmo):
    bl_idname = "XIHE_GT_mouse"

    def draw(self, _context: bpy.types.Context) -> None:
        """Nothing: it only listens."""

    def test_select(self, context: bpy.types.Context, location: Any) -> int:
        if _view is not None:
            _view.mouse = (context.region.as_pointer(), float(location[0]), float(location[1]))
            context.region.tag_redraw()
        return -1


class XIHE_GGT_placement_map(bpy.types.GizmoGroup):
    bl_idname = "XIHE_GGT_placement_map"
    bl_label = "Xihe Placement Map"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"PERSISTENT"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return shown_map(context) is not None

    def setup(self, _context: bpy.types.Context) -> None:
        self.gizmos.new(XIHE_GT_mouse.bl_idname)


_classes = (XIHE_OT_map_places, XIHE_OT_go_to_place, XIHE_OT_remove_map, XIHE_PT_placement)
_gizmos = (XIHE_GT_mouse, XIHE_GGT_placement_map)


def register() -> None:
    global _view
    for one in (*_classes, *(() if bpy.app.background else _gizmos)):
        bpy.utils.register_class(one)
    if not bpy.app.background:
        _view = MapView()


def unregister() -> None:
    global _view
    if _view is not None:
        _view.remove()
        _view = None
    for one in reversed((*_classes, *(() if bpy.app.background else _gizmos))):
        bpy.utils.unregister_class(one)
