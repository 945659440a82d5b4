"""Virtual objects in the panel: the selected ones become virtual, or three spheres at the 3D cursor."""

from __future__ import annotations

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import Action
from xihe_blender.scene.virtual_objects import make_room, make_virtual, with_parts


class XIHE_OT_add_virtual_objects(Action, bpy.types.Operator):
    bl_idname = "xihe.add_virtual_objects"
    bl_label = "Make Virtual"
    bl_description = "Mark the selected objects as virtual: the phone inserts them and estimates the light on them"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_room, polls.is_in_object_mode, polls.has_selected_room_objects)

    def act(self, context: bpy.types.Context) -> str | None:
        made = make_virtual(context.scene, context.selected_objects)
        # Their types are called GPENCIL up to Blender 4.2, and GREASEPENCIL since.
        drawn = any(item.type.endswith("PENCIL") for item in with_parts(context.scene, context.selected_objects))
        left = ". Grease Pencil has no surface to light, and stays in the room" if drawn else ""
        return f"{_format_objects(len(made))} virtual now{left}"


class XIHE_OT_remove_virtual_objects(Action, bpy.types.Operator):
    bl_idname = "xihe.remove_virtual_objects"
    bl_label = "Make Part of Room"
    bl_description = "Make the selected virtual objects part of the room again"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_room, polls.is_in_object_mode, polls.has_selected_virtual_objects)

    def act(self, context: bpy.types.Context) -> str | None:
        made = make_room(context.scene, context.selected_objects)
        return f"{_format_objects(len(made))} part of the room again"


class XIHE_OT_add_sphere_rig(Action, bpy.types.Operator):
    bl_idname = "xihe.add_sphere_rig"
    bl_label = "Add Three Spheres"
    bl_description = "Add a mirror, a matte silver and a grey sphere as virtual objects at the 3D cursor"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_room, polls.is_in_object_mode)

    radius_m: bpy.props.FloatProperty(
        name="Radius",
        description="Radius of each sphere in metres",
        default=0.06,
        min=0.001,
        soft_min=0.01,
        soft_max=1.0,
    )

    def act(self, context: bpy.types.Context) -> None:
        from xihe_blender.scene.sphere_rig import add_three_sphere_rig

        add_three_sphere_rig(context.scene, tuple(context.scene.cursor.location), self.radius_m)


def _format_objects(n_objects: int) -> str:
    return "1 object is" if n_objects == 1 else f"{n_objects} objects are"


register, unregister = bpy.utils.register_classes_factory(
    (XIHE_OT_add_virtual_objects, XIHE_OT_remove_virtual_objects, XIHE_OT_add_sphere_rig)
)
