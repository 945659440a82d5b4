"""The scene `Xihe Lit`: the virtual objects alone under their estimated light, over the frames that the phone captured.

A view layer has one world, so each object has a view layer of its own, in which the others hold out. Its camera is the
phone as it was when it captured what is behind it; rendering puts all layers over those frames. Colours are shown at
the run's exposure and by the view transform Standard, as the pictures of the report are. What stands in front of an
object in the room hides it: copies of the room's objects hold out, and no light meets them.

Not here: shadows on the room fall on catchers that `shadow_catchers` makes.
"""

from __future__ import annotations

import itertools
import math
import shutil
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bmesh
import bpy
from mathutils import Matrix

from xihe_blender.apply.datablocks import (
    KEY_LIGHT,
    LIT_SCENE,
    OF_RUN,
    SHADOW_CATCHER,
    lit_scene,
    remove_lit_collections,
)
from xihe_blender.apply.keyed_camera import key_camera
from xihe_blender.apply.shadow_catchers import remove_shadow_catchers, shadow_catchers
from xihe_blender.io.outputs import link_or_copy
from xihe_blender.scene.blend_file import ROOM, absolute
from xihe_blender.scene.colour_management import show_as_it_is
from xihe_blender.scene.mesh_arrays import array_of
from xihe_blender.scene.phone_capture import CAPTURE, SCAN
from xihe_blender.scene.shader_nodes import Interaction, material_shading
from xihe_blender.scene.state import animated_paths, remove_copied_scene, show_to_camera_alone
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import has_renderable_geometry, is_bare_curve, listed, virtual_collection
from xihenet.io.frame_files import FrameCamera

PHONE = "Xihe Phone"
"""Begins the names of the copied cameras, as we give them."""

IS_PHONE = "xihe_phone"
"""Custom property of the copied cameras, whatever Blender calls them now; a file of an earlier version has none."""

ROOM_COPY = "xihe_room_copy"
"""Custom property of what holds out in front of the objects. A name would not do: a user's object may have it."""

SHOWN = "xihe_shown"
"""Custom property of a collection of the scene: the virtual object that it was made for."""

ADDED = "Xihe Added Lamps"
"""Collection of the lamps and cameras that the user added to `Xihe Lit`, while there is no such scene, and after."""

_OF_LIT = ("LIGHT", "CAMERA")
_SOLID = ("MESH", "CURVE", "SURFACE", "FONT", "CURVES", "POINTCLOUD")
_MARKS = (ROOM_COPY, KEY_LIGHT, SHADOW_CATCHER)
_FROM_EDGES = ("NODES", "SCREW", "SKIN")
"""Modifiers that may make faces of edges that have none."""

_SIMULATIONS = ("CLOTH", "DYNAMIC_PAINT", "FLUID", "SOFT_BODY")
"""Modifiers whose results are in a cache."""


@dataclass(frozen=True)
class CapturedFrames:
    """What is shown behind the objects: a PNG of each captured frame, by its number, at least one.

    Between two of them the earlier one stays, as the last one does to the end of `path`; before the first, that one is
    shown. A picture for each frame is put into `folder`, numbered from 1 on, as Blender reads image sequences.
    `cameras` are the phone at each picture, as long as that is shown; without them the room's camera stands for it.
    """

    pictures: Mapping[int, Path]
    path: range
    folder: Path
    size: tuple[int, int]
    exposure: float
    cameras: Mapping[int, FrameCamera] = field(default_factory=dict)

    @property
    def frames(self) -> range:
        """Those of the path, and what was captured beside it."""
        numbers = (*self.pictures, *self.path)
        return range(min(numbers), max(numbers) + 1)

    def write_sequence(self) -> Path:
        """Put the pictures into the folder, anew; the path of the first.

        Where that cannot be written, as on a share that is only read, into Blender's own for this session.
        """
        try:
            return self._write_into(self.folder)
        except OSError:
            return self._write_into(Path(bpy.app.tempdir) / self.folder.parent.name)

    def _write_into(self, folder: Path) -> Path:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        shown = self.pictures[min(self.pictures)]
        for number, frame in enumerate(self.frames, 1):
            shown = self.pictures.get(frame, shown)
            link_or_copy(shown, folder / f"frame_{number:04d}.png")
        return folder / "frame_0001.png"


def put_over_frames(lit: bpy.types.Scene, frames: CapturedFrames) -> None:
    """Show the captured frames behind the objects: in the camera's view, and in what is rendered.

    The picture keeps the frames' shape, and is as large along its longer side as the scene's own. One that the user
    makes wider shows the middle of the frame. Where the scene has compositor nodes, they stay as they are.
    """
    first = frames.write_sequence()
    image = bpy.data.images.load(str(first))
    if bpy.data.filepath and first.is_relative_to(Path(bpy.data.filepath).parent):
        image.filepath = bpy.path.relpath(str(first))  # The file and its runs may be moved together.
    image.name, image.source = f"{LIT_SCENE} Frames", "SEQUENCE"
    copies: dict[bpy.types.Object, bpy.types.Object] = {}
    for owner in (lit, *lit.timeline_markers):
        if owner.camera is not None:
            if owner.camera not in copies:
                phone = _phone_with(owner.camera, image, frames, metres_per_unit(lit), lit.frame_current)
                copies[owner.camera] = phone
                lit.collection.objects.link(copies[owner.camera])
            owner.camera = copies[owner.camera]
    render, view = lit.render, lit.view_settings
    larger = max(render.resolution_x, render.resolution_y) / max(frames.size)
    render.resolution_x, render.resolution_y = (max(4, round(side * larger)) for side in frames.size)
    if CAPTURE not in lit:  # Renders have square pixels, a phone's need not be.
        render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    for switch in ("use_border", "use_sequencer", "use_single_layer", "use_freestyle"):
        setattr(render, switch, False)
    render.use_compositing = True
    if any(after - frame > 1 for frame, after in itertools.pairwise(frames.cameras)):
        render.use_motion_blur = False  # Of a phone that jumps, it would show two pictures at once.
    show_as_it_is(lit)
    view.gamma, view.use_curve_mapping = 1.0, False
    view.exposure, lit.cycles.film_exposure = math.log2(frames.exposure), 1.0
    if hasattr(view, "use_white_balance"):  # from Blender 4.3 on
        view.use_white_balance = False
    is_composed = lit.compositing_node_group is not None if hasattr(lit, "compositing_node_group") else lit.use_nodes
    if not is_composed:
        _compose(lit, image, frames)


def hide_behind_room(lit: bpy.types.Scene, room: bpy.types.Scene, objects: Sequence[bpy.types.Object]) -> None:
    """Let what stands in front of `objects` in `room` hide them in `lit`: copies that share data and animation.

    Metaballs, volumes, and copies that an object makes of its children, are not among them. Edges without a face are
    left out of a copy of the data. Of what is simulated there are instances: a copy has no cache of its own.
    """
    tidied: dict[bpy.types.ID, bpy.types.ID] = {}
    holder, has_catchers = bpy.data.collections.new(f"{LIT_SCENE} Room"), bool(shadow_catchers(lit))
    holder[ROOM_COPY] = True
    simulated = bpy.data.collections.new(f"{LIT_SCENE} Simulated")
    for item in dict.fromkeys(_seen_in_scene(room)):
        if SCAN in item and has_catchers:  # It is a catcher there, which would catch no shadow behind a copy.
            continue
        if _may_hide(item) and item.visible_camera and not item.is_holdout and item not in objects:
            if _is_simulated(item):
                simulated.objects.link(item)
                continue
            copied = _own_copy(item)
            _hold_out(copied, item.name)
            _draw_no_lines(copied, tidied)
            copied.is_shadow_catcher &= SCAN not in item
            holder.objects.link(copied)
    if simulated.objects:
        instances = bpy.data.objects.new(simulated.name, None)
        instances.instance_type, instances.instance_collection = "COLLECTION", simulated
        instances.empty_display_size = 0.0
        simulated[ROOM_COPY] = True
        _hold_out(instances, "Simulated")
        holder.objects.link(instances)
    else:
        bpy.data.collections.remove(simulated)
    lit.collection.children.link(holder)


def _own_copy(block: bpy.types.ID) -> Any:
    """A copy that keeps what is set of it: one of a library override is made anew when its file is opened."""
    copied = block.copy()
    return copied.make_local() if copied.override_library is not None else copied


def _hold_out(item: bpy.types.Object, name: str) -> None:
    item.name, item.is_holdout = f"{LIT_SCENE} {name}", True
    item[ROOM_COPY] = item.hide_select = True
    show_to_camera_alone(item)


def _is_simulated(item: bpy.types.Object) -> bool:
    """Whether where it is, or its shape, may come from a cache of physics or of geometry nodes."""
    if item.rigid_body is not None or item.particle_systems:
        return True
    return any(one.type in _SIMULATIONS or (one.type == "NODES" and len(one.bakes)) for one in item.modifiers)


def _may_hide(item: bpy.types.Object) -> bool:
    """Whether it may have a surface: a mesh of edges or points alone has none, nor has a path, or one of fog."""
    if is_fog(item) or is_bare_curve(item):
        return False
    if item.type == "MESH":
        return bool(item.data.polygons or item.modifiers)
    return item.type in _SOLID or item.instance_type == "COLLECTION"


def is_fog(item: bpy.types.Object) -> bool:
    """Whether it is a volume without a surface, or an instance of nothing else: Cycles holds out no such."""
    if item.instance_type == "COLLECTION" and item.instance_collection is not None:
        parts = [part for part in item.instance_collection.all_objects if has_renderable_geometry(part)]
        return bool(parts) and all(map(is_fog, parts))
    looks = [material_shading(slot.material).interactions & ~Interaction.DISPLACEMENT for slot in item.material_slots]
    return item.type == "VOLUME" or (bool(looks) and all(look == Interaction.VOLUME for look in looks))


def _draw_no_lines(copied: bpy.types.Object, tidied: dict[bpy.types.ID, bpy.types.ID]) -> None:
    """Keep a copy's wires, name and axes off the captured frames, which are an overlay themselves and cannot hide them.

    Blender draws edges without a face whatever an object's settings are, but for its bounds, which are more lines. No
    render shows them: `tidied` holds the data without them.
    """
    copied.show_wire = copied.show_name = copied.show_axis = copied.show_bounds = copied.show_in_front = False
    copied.display_type, copied.empty_display_size = "TEXTURED", 0.0
    if copied.type == "MESH" and not any(modifier.type in _FROM_EDGES for modifier in copied.modifiers):
        if copied.data not in tidied:
            tidied[copied.data] = _without_loose_edges(copied.data)
        copied.data = tidied[copied.data]


def _without_loose_edges(mesh: bpy.types.Mesh) -> bpy.types.Mesh:
    """A copy without the edges that have no face; `mesh` itself where there are none. The vertices are the same."""
    if not array_of(mesh.edges, "is_loose", bool).any():
        return mesh
    copied = _own_copy(mesh)
    copied.name = f"{LIT_SCENE} {mesh.name}"
    copied[ROOM_COPY] = True
    edited = bmesh.new()
    edited.from_mesh(copied)
    for edge in [edge for edge in edited.edges if edge.is_wire]:
        edited.edges.remove(edge)
    edited.to_mesh(copied)
    edited.free()
    return copied


def _seen_in_scene(scene: bpy.types.Scene | None) -> Iterator[bpy.types.Object]:
    """All that its first view layer renders, and those of the scenes that are set behind it."""
    while scene is not None:
        yield from seen_in(listed(scene.view_layers[0]).layer_collection)
        scene = scene.background_set


def seen_in(layer: bpy.types.LayerCollection) -> Iterator[bpy.types.Object]:
    """All that a view layer renders for its camera, at some frame at least, of a collection and those in it."""
    if layer.exclude or layer.collection.hide_render or layer.holdout or layer.indirect_only:
        return
    for item in layer.collection.objects:
        if not item.hide_render or "hide_render" in animated_paths(item):
            yield item
    for child in layer.children:
        yield from seen_in(child)


def _phone_with(
    camera: bpy.types.Object, image: bpy.types.Image, frames: CapturedFrames, unit_m: float, now: int
) -> bpy.types.Object:
    phone = bpy.data.objects.new(PHONE, camera.data) if frames.cameras else _own_copy(camera)
    phone.data = _own_copy(camera.data)
    phone.name = phone.data.name = PHONE
    phone[IS_PHONE] = True
    if frames.cameras:
        phone.data.animation_data_clear()
        key_camera(phone, frames.cameras, unit_m, is_held=True)
        # Blender may evaluate it before a window shows it, and then keeps where it is to itself.
        reached = max((frame for frame in frames.cameras if frame <= now), default=min(frames.cameras))
        pose = frames.cameras[reached].world_from_camera.copy()
        pose[:3, 3] /= unit_m
        phone.matrix_world = Matrix(pose.tolist())
    phone.data.show_background_images = True
    phone.data.background_images.clear()
    behind = phone.data.background_images.new()
    behind.image, behind.alpha, behind.frame_method = image, 1.0, "CROP"
    _play(behind.image_user, frames)
    return phone


def _play(user: bpy.types.ImageUser | bpy.types.CompositorNodeImage, frames: CapturedFrames) -> None:
    user.frame_start, user.frame_duration, user.frame_offset = frames.frames.start, len(frames.frames), 0
    user.use_auto_refresh = True


def _compose(lit: bpy.types.Scene, image: bpy.types.Image, frames: CapturedFrames) -> None:
    """Compositor nodes: every layer over the frame, whose light is brought to that of the scene."""
    tree = _compositor_tree(lit)
    behind = tree.nodes.new("CompositorNodeImage")
    behind.image = image
    _play(behind, frames)
    scale = tree.nodes.new("CompositorNodeScale")
    if "Type" in scale.inputs:
        scale.inputs["Type"].default_value = "Render Size"
        scale.inputs["Frame Type"].default_value = "Crop"
    else:
        scale.space, scale.frame_method = "RENDER_SIZE", "CROP"
    tree.links.new(behind.outputs["Image"], scale.inputs["Image"])
    exposed = tree.nodes.new("CompositorNodeExposure")
    exposed.inputs["Exposure"].default_value = -math.log2(frames.exposure)
    tree.links.new(_opaque(tree, scale.outputs[0]), exposed.inputs["Image"])
    picture = exposed.outputs[0]
    for index, layer in enumerate(lit.view_layers):
        rendered, over = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeAlphaOver")
        rendered.scene, rendered.layer = lit, layer.name
        rendered.location, over.location = (0, -300 * (index + 1)), (300 + 200 * index, 0)
        below, above = [socket for socket in over.inputs if socket.type == "RGBA"]
        tree.links.new(picture, below)
        tree.links.new(rendered.outputs["Image"], above)
        picture = over.outputs[0]
    end = tree.nodes.new("NodeGroupOutput" if hasattr(lit, "compositing_node_group") else "CompositorNodeComposite")
    end.location = (500 + 200 * len(lit.view_layers), 0)
    tree.links.new(picture, end.inputs[0])


def _opaque(tree: bpy.types.NodeTree, scaled: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """A scaled picture without the rim, a pixel wide, in which its edge was mixed with what is not there."""
    straight, opaque = tree.nodes.new("CompositorNodePremulKey"), tree.nodes.new("CompositorNodeSetAlpha")
    if "Type" in straight.inputs:  # from Blender 5.0 on
        straight.inputs["Type"].default_value, opaque.inputs["Type"].default_value = "To Straight", "Replace Alpha"
    else:
        straight.mapping, opaque.mode = "PREMUL_TO_STRAIGHT", "REPLACE_ALPHA"
    tree.links.new(scaled, straight.inputs["Image"])
    tree.links.new(straight.outputs[0], opaque.inputs["Image"])
    return opaque.outputs[0]


def _compositor_tree(lit: bpy.types.Scene) -> bpy.types.NodeTree:
    """An empty one of its own. From Blender 5.0 on it is a node group, and the switch `use_nodes` does nothing."""
    if not hasattr(lit, "compositing_node_group"):
        before = set(bpy.data.images)
        lit.use_nodes = True
        lit.node_tree.nodes.clear()
        # The viewer among the first nodes of a new tree brings an image.
        bpy.data.batch_remove(set(bpy.data.images) - before)
        return lit.node_tree
    tree = bpy.data.node_groups.new(LIT_SCENE, "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    lit.compositing_node_group = tree
    return tree


def keep_added() -> list[bpy.types.Object]:
    """Make virtual in its room what the user added to the scene `Xihe Lit`, where it would go with that; gives those.

    Duplicates of the objects shown, and whatever else is in no other scene and not ours, but for lamps and cameras.
    None without the scene or its room, or where that room's virtual objects are another file's.
    """
    lit = lit_scene()
    room = None if lit is None else lit.get(ROOM)
    if lit is None or room is None:
        return []
    added = [item for item in _added(lit) if item.type not in _OF_LIT]
    collection = virtual_collection(room, create=bool(added))
    if collection is None or collection.library is not None or collection.override_library is not None:
        return []
    for item in added:
        collection.objects.link(item)
    return added


def _added(lit: bpy.types.Scene) -> list[bpy.types.Object]:
    shown = {collection.get(SHOWN) for collection in lit.collection.children}
    ours = shown | {*_phones(lit)} | {item for item in lit.objects if any(mark in item for mark in _MARKS)}
    return [item for item in lit.objects if item not in ours and set(item.users_scene) == {lit}]


def _phones(lit: bpy.types.Scene) -> list[bpy.types.Object]:
    return [item for item in lit.collection.objects if IS_PHONE in item or item.name.startswith(PHONE)]


def _added_lamps() -> bpy.types.Collection | None:
    return bpy.data.collections.get((ADDED, None))


def bring_lamps(lit: bpy.types.Scene) -> None:
    """Have `lit` show the lamps and cameras that the user had added to the one before it."""
    lamps = _added_lamps()
    if lamps is not None:
        lit.collection.children.link(lamps)


def remove_lit_scene() -> None:
    """Remove the open file's scene `Xihe Lit` and all that only it uses; windows that show it go back to its room.

    What the user added to it stays, as of `keep_added`; lamps and cameras for the next one, in a collection that no
    scene shows.
    """
    lit = lit_scene()
    if lit is None:  # It may have been deleted in Blender's own menu, which leaves what it showed without a user.
        remove_lit_collections()
        left = [item for item in bpy.data.objects if item.library is None and not item.users]
        phones = [item for item in left if IS_PHONE in item]
        bpy.data.batch_remove(_room_copies(left) | _with_parts(phones) | _unused_trees())
        remove_shadow_catchers([item for item in shadow_catchers() if not item.users])
        return
    keep_added()
    if lamps := [item for item in _added(lit) if item.type in _OF_LIT]:
        kept = _added_lamps() or bpy.data.collections.new(ADDED)
        kept.use_fake_user = True
        for item in set(lamps) - set(kept.objects):
            kept.objects.link(item)
    room = lit.get(ROOM)
    for manager in bpy.data.window_managers:
        for window in manager.windows:
            if window.scene == lit and room is not None:
                window.scene = room
    remove_shadow_catchers(shadow_catchers(lit))
    own = _room_copies(lit.objects) | _with_parts(_phones(lit))
    remove_copied_scene(lit)
    remove_lit_collections()
    # At once: with its data an object goes too.
    bpy.data.batch_remove(own | _unused_trees())


def _unused_trees() -> set[bpy.types.ID]:
    """Those made by `_compositor_tree` that no scene has any more."""
    return {tree for tree in bpy.data.node_groups if tree.name.startswith(LIT_SCENE) and not tree.users}


def _with_parts(phones: Iterable[bpy.types.Object]) -> set[bpy.types.ID]:
    """Cameras of ours with their data, the pictures behind them, and their actions."""
    own: set[bpy.types.ID | None] = set()
    for camera in phones:
        own |= {camera, camera.data, *(behind.image for behind in camera.data.background_images)}
        actions = [owner.animation_data.action for owner in (camera, camera.data) if owner.animation_data is not None]
        own |= {action for action in actions if action is not None and action.name.startswith(PHONE)}
    return own - {None}


def _room_copies(objects: Iterable[bpy.types.Object]) -> set[bpy.types.ID]:
    copies = [item for item in objects if ROOM_COPY in item]
    parts = [block for item in copies for block in (item, item.data, item.instance_collection)]
    return {block for block in parts if block is not None and ROOM_COPY in block}


def is_of_run(lit: bpy.types.Scene, room: bpy.types.Scene, run: str, objects: Iterable[bpy.types.Object]) -> bool:
    """Whether `lit` was made of the run called `run`, with the same `objects` of `room`."""
    shown = {collection.get(SHOWN) for collection in lit.collection.children} - {None}
    return lit.get(ROOM) == room and lit.get(OF_RUN) == run and shown == set(objects)


def show_room_anew(lit: bpy.types.Scene, room: bpy.types.Scene, objects: Sequence[bpy.types.Object]) -> None:
    """Have `lit` hidden by the room, and at the frame, as they are now; all else in it stays as the user left it."""
    bpy.data.batch_remove(_room_copies(lit.objects))
    for holder in [child for child in lit.collection.children if ROOM_COPY in child]:
        bpy.data.collections.remove(holder)
    hide_behind_room(lit, room, objects)
    lit.frame_set(room.frame_current)


def has_its_frames(lit: bpy.types.Scene) -> bool:
    """Whether no picture behind its cameras is gone: they may be of another session, or have been moved."""
    behind = [one.image for camera in _phones(lit) for one in camera.data.background_images]
    return all(Path(absolute(image.filepath)).is_file() for image in behind if image is not None)


def is_over_frames(lit: bpy.types.Scene) -> bool:
    """Whether `put_over_frames` was there."""
    return bool(_phones(lit))


def leave_compositor(lit: bpy.types.Scene) -> None:
    """Take away the nodes that `lit` was copied with: they are of another scene's view layers."""
    if hasattr(lit, "compositing_node_group"):
        lit.compositing_node_group = None
    else:
        lit.use_nodes = False


def set_up_lit_scene(
    lit: bpy.types.Scene, objects: Sequence[bpy.types.Object], layers: Mapping[str, tuple[str, bpy.types.World]]
) -> None:
    """Leave only `objects` in `lit`, each in a collection of its own, and give it one view layer per entry of `layers`.

    `layers` maps the layer's name to the object it shows and the world that lights it; the other objects hold out.
    Of them smoke and fog, which Cycles would draw once more under each light, are seen by no camera: they cast shadows.
    Layers that show such are last, since they go over the others: what is before smoke holds it out.
    """
    root = lit.collection
    for child in list(root.children):
        root.children.unlink(child)
    for item in list(root.objects):
        root.objects.unlink(item)
    for item in objects:
        collection = bpy.data.collections.new(f"{LIT_SCENE} {item.name}")
        collection[SHOWN] = item
        collection.objects.link(item)
        root.children.link(collection)
    lit.render.film_transparent, lit.background_set = True, None
    placeholder, fogs = lit.view_layers[0], {item.name for item in objects if is_fog(item)}
    for name, (shown, world) in sorted(layers.items(), key=lambda layer: layer[1][0] in fogs):
        layer = lit.view_layers.new(name)
        layer.use_pass_z = True
        layer.world_override = world
        for item, child in zip(objects, layer.layer_collection.children, strict=True):
            child.indirect_only = item.name != shown and item.name in fogs
            child.holdout = item.name != shown and item.name not in fogs
    lit.view_layers.remove(placeholder)


def show_only_in(lit: bpy.types.Scene, item: bpy.types.Object, layers: Container[str]) -> None:
    """Link `item` to `lit`, in a collection that only the view layers named in `layers` include."""
    collection = bpy.data.collections.new(f"{LIT_SCENE} {item.name}")
    collection.objects.link(item)
    lit.collection.children.link(collection)
    for layer in lit.view_layers:
        layer.layer_collection.children[collection.name].exclude = layer.name not in layers
