"""Scenes small enough for a test: a closed box room, a phone, a virtual sphere. Built anew for every test."""

import functools
import math

import bpy
import numpy as np
from mathutils import Vector

from xihe_blender.scene.virtual_objects import virtual_collection


@functools.cache
def _take_factory_preferences():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def empty_scene():
    """A scene with nothing in it, set to render small and fast on one sample."""
    _take_factory_preferences()
    # Without the preferences it takes a fifth of the time.
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    scene.frame_start, scene.frame_end = 1, 3
    return scene


def nodes_of(block):
    """The node tree of a new material or world, emptied but for an output node, which is given too."""
    if block.node_tree is None:
        block.use_nodes = True
    tree = block.node_tree
    tree.nodes.clear()
    kind = "ShaderNodeOutputWorld" if isinstance(block, bpy.types.World) else "ShaderNodeOutputMaterial"
    return tree, tree.nodes.new(kind)


def material(name, colour=(0.7, 0.7, 0.7), emission=0.0):
    """A diffuse or an emissive material."""
    made = bpy.data.materials.new(name)
    tree, output = nodes_of(made)
    shader = tree.nodes.new("ShaderNodeEmission" if emission else "ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (*colour, 1.0)
    if emission:
        shader.inputs["Strength"].default_value = emission
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return made


def black_smoke(density):
    """A material that dims what is behind it, and has no surface."""
    made = bpy.data.materials.new("Smoke")
    tree, output = nodes_of(made)
    absorbing = tree.nodes.new("ShaderNodeVolumeAbsorption")
    absorbing.inputs["Color"].default_value, absorbing.inputs["Density"].default_value = (0, 0, 0, 1), density
    tree.links.new(absorbing.outputs[0], output.inputs["Volume"])
    return made


def box(scene, name, centre, size, look=None, collection=None, inward=False):
    """An axis-aligned box; `inward` turns its faces around, which makes it a room."""
    x, y, z = (np.array([-0.5, 0.5]) * side for side in size)
    corners = [(a, b, c) for a in x for b in y for c in z]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], [face[::-1] for face in faces] if inward else faces)
    mesh.materials.append(look or material(name))
    return add(scene, name, mesh, centre, collection)


def sphere(scene, name, centre, radius, look=None, collection=None):
    """A smooth UV sphere."""
    points, faces = _unit_sphere()
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata((points * radius).tolist(), [], faces)
    mesh.shade_smooth()
    mesh.materials.append(look or material(name))
    return add(scene, name, mesh, centre, collection)


@functools.cache
def _unit_sphere():
    """Points (P, 3) and faces."""
    rows, columns = 24, 48
    polar = np.linspace(0, np.pi, rows + 1)[1:-1]
    azimuth = np.arange(columns) * 2 * np.pi / columns
    ring = [(math.sin(p) * math.cos(a), math.sin(p) * math.sin(a), math.cos(p)) for p in polar for a in azimuth]
    points = np.array([(0, 0, 1), *ring, (0, 0, -1)])
    top = [(0, 1 + a, 1 + (a + 1) % columns) for a in range(columns)]
    last, start = len(points) - 1, 1 + (rows - 2) * columns
    bottom = [(last, start + (a + 1) % columns, start + a) for a in range(columns)]
    middle = [
        (1 + r * columns + a, 1 + (r + 1) * columns + a, 1 + (r + 1) * columns + b, 1 + r * columns + b)
        for r in range(rows - 2)
        for a in range(columns)
        for b in [(a + 1) % columns]
    ]
    return points, top + middle + bottom


def add(scene, name, data=None, location=(0, 0, 0), collection=None):
    """A new object of these data, an empty without, in the scene's own collection or another."""
    item = bpy.data.objects.new(name, data)
    item.location = location
    (collection or scene.collection).objects.link(item)
    return item


def add_instance(scene, instanced, collection=None):
    """An empty that shows what is in the collection `instanced`."""
    item = add(scene, "Instance", None, collection=collection)
    item.instance_type, item.instance_collection = "COLLECTION", instanced
    return item


def add_lamp(scene, kind="POINT", location=(0, 0, 0), name="Lamp", collection=None, **values):
    """`values` are of its data."""
    data = bpy.data.lights.new(name, kind)
    for attribute, value in values.items():
        setattr(data, attribute, value)
    return add(scene, name, data, location, collection)


def phone(scene, location, towards, name="Phone"):
    """A camera at `location` that looks at `towards`, and the scene's camera from then on."""
    camera = add(scene, name, bpy.data.cameras.new(name))
    look_at(camera, location, towards)
    scene.camera = camera
    return camera


def orthographic(scene, scale=2.0):
    """(3, 3) world_from_camera of the scene's camera from then on, which looks along +Y at the origin."""
    camera = phone(scene, (0.0, -5.0, 0.0), (0, 0, 0))
    camera.data.type, camera.data.ortho_scale = "ORTHO", scale
    return np.array(camera.rotation_euler.to_matrix())


def look_at(camera, location, towards, frame=None):
    """Put the camera there; with `frame`, keyed."""
    camera.location = location
    camera.rotation_euler = (Vector(towards) - Vector(location)).to_track_quat("-Z", "Y").to_euler()
    for name in () if frame is None else ("location", "rotation_euler"):
        camera.keyframe_insert(name, frame=frame)


def node_of(block, kind):
    """The first node of a type, such as "BSDF_DIFFUSE", in the tree of a material or a world."""
    return next(node for node in block.node_tree.nodes if node.type == kind)


def geometry_nodes():
    """A new tree for a geometry nodes modifier, the socket of the geometry that it is given, and of what it gives."""
    tree = bpy.data.node_groups.new("Geometry", "GeometryNodeTree")
    for name, direction in (("Given", "INPUT"), ("Geometry", "OUTPUT")):
        tree.interface.new_socket(name, in_out=direction, socket_type="NodeSocketGeometry")
    return tree, tree.nodes.new("NodeGroupInput").outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0]


def light_strength():
    """How strongly the lamp of `room_with_a_virtual_sphere` shines, as a socket."""
    return bpy.data.materials["Light"].node_tree.nodes["Emission"].inputs["Strength"]


def key(owner, name, value_by_frame):
    """Set and key a property at each of these frames; `value_by_frame` is {frame: value}."""
    for frame, value in value_by_frame.items():
        setattr(owner, name, value)
        owner.keyframe_insert(name, frame=frame)


def set_world(scene, colour=(0.0, 0.0, 0.0)):
    """A background of constant radiance."""
    world = bpy.data.worlds.new("Background")
    if world.node_tree is None:
        world.use_nodes = True
    node_of(world, "BACKGROUND").inputs["Color"].default_value = (*colour, 1.0)
    scene.world = world
    return world


def room_with_a_virtual_sphere(n_frames=3, *, is_still=False):
    """A 4 x 4 x 3 m room with a lamp on the +X side, a table, a grey virtual sphere on it, and a phone that moves."""
    scene = empty_scene()
    scene.frame_end = n_frames
    set_world(scene)
    box(scene, "Room", (0, 0, 1.5), (4, 4, 3), material("Walls", (0.6, 0.55, 0.5)), inward=True)
    box(scene, "Table", (0, 0, 0.7), (1.2, 0.8, 0.05), material("Wood", (0.35, 0.2, 0.1)))
    box(scene, "Lamp", (1.9, 0, 1.6), (0.05, 1.0, 1.0), material("Light", (1.0, 0.9, 0.7), emission=6.0))
    virtual = virtual_collection(scene, create=True)
    sphere(scene, "Ball", (0, 0, 0.85), 0.12, material("Grey", (0.5, 0.5, 0.5)), virtual)
    camera = phone(scene, (-1.2, -1.5, 1.5), (0, 0, 0.85))
    for frame in range(1, 1 if is_still else n_frames + 1):
        look_at(camera, (-1.2 + 0.3 * (frame - 1), -1.5, 1.5), (0, 0, 0.85), frame)
    return scene


def saved(path):
    """`path`, to which the open file was saved as a copy."""
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    return path


def opened(path):
    """The scene of the file at `path`, which is opened."""
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    return bpy.context.scene


def linked(library, kind, *names):
    """The data-blocks of these names, linked from the file `library`; `kind` is as of bpy.data, such as "worlds"."""
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        setattr(wanted, kind, list(names))
    return getattr(wanted, kind)


def memberships():
    """The names of each object's collections."""
    return {item.name: sorted(home.name for home in item.users_collection) for item in bpy.data.objects}
