"""The scenes that ship: small, whole in themselves, with a phone and virtual objects, and built the same every time."""

import math
import re
from importlib import import_module
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from renders import rendered_picture

from xihe_blender.scene.estimation_positions import estimation_positions
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects

FOLDER = Path(__file__).resolve().parents[2] / "blend_scenes"
N_VIRTUAL = {
    "living_room": 2,
    "bedroom_night": 2,
    "cornell_box": 3,
    "light_temperature": 1,
    "light_intensity": 1,
    "walk_around": 2,
    "courtyard": 3,
}
STATIC = {"light_temperature", "light_intensity"}
SCENES = sorted(N_VIRTUAL)
DOWN = (0, 0, -1)
MAX_BYTES = 2_000_000


def opened(name):
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{name}.blend"))
    return bpy.context.scene


@pytest.fixture(params=SCENES)
def scene(request):
    return opened(request.param)


@pytest.fixture
def builders(monkeypatch):
    """The build scripts import each other by plain name, as when they are run."""
    monkeypatch.syspath_prepend(str(FOLDER))


def file_name():
    return Path(bpy.data.filepath).stem


def frames(scene):
    """The numbers of the frames, at each of which the scene stands while it is used."""
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        yield frame


def poses(scene):
    return [scene.camera.matrix_world.copy() for _ in frames(scene)]


def hit_by_a_ray(scene, start, direction):
    """The nearest place on a surface, None where there is none, and the normal there."""
    hit, place, normal, *_ = scene.ray_cast(bpy.context.evaluated_depsgraph_get(), Vector(start), Vector(direction))
    return place if hit else None, normal


def test_every_build_script_has_its_scene_and_its_row_in_the_table(builders):
    scripts = {path.stem.removeprefix("build_") for path in FOLDER.glob("build_*.py")} - {"all"}
    rows = set(re.findall(r"^\| `(\w+)` \|", (FOLDER / "README.md").read_text(encoding="utf-8"), re.MULTILINE))
    files = {path.stem for path in FOLDER.glob("*.blend")}
    assert scripts == files == rows == set(SCENES) == set(import_module("build_all").SCENES)


def test_the_file_is_small_blender_4_3_reads_all_keys_and_nothing_lies_outside_it(scene):
    assert Path(bpy.data.filepath).stat().st_size < MAX_BYTES
    assert bpy.data.actions
    assert all(len(getattr(action, "slots", ["the only one"])) == 1 for action in bpy.data.actions)
    assert len(bpy.data.libraries) == 0
    assert [path for path in bpy.utils.blend_paths(absolute=False, packed=False) if path] == []
    for image in bpy.data.images:
        assert image.source in {"VIEWER", "GENERATED"} or image.packed_file is not None
        assert image.source == "VIEWER" or min(image.size) > 0, f"{image.name} has no pixels"


def test_the_settings_are_those_of_a_capture(scene):
    assert scene.render.engine == "CYCLES"
    assert scene.view_settings.view_transform == "Standard"
    assert (scene.render.resolution_x, scene.render.resolution_y) == (256, 192)
    assert (scene.frame_start, scene.frame_end, scene.frame_step) == (1, 24, 1)
    assert scene.cycles.samples == 16
    assert (scene.cycles.max_bounces, scene.cycles.diffuse_bounces) == (12, 4)
    assert scene.render.fps / scene.render.fps_base == pytest.approx(2.0)


def test_the_phone_is_carried_upright_through_the_room_or_held_still(scene):
    of_phone = poses(scene)
    places = np.array([pose.translation for pose in of_phone])
    assert scene.camera.name == "Phone"
    assert 60 <= math.degrees(scene.camera.data.angle_x) <= 70
    assert ((places[:, 2] > 1.2) & (places[:, 2] < 1.6)).all()
    walked = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert walked.max() < 0.6, "a hand does not jump"
    if file_name() in STATIC:
        assert np.ptp(places, axis=0).max() < 0.03
    else:
        assert walked.sum() > 1.8
    assert walked.min() > 0, "a hand is never quite still"
    rolls = [math.degrees(math.asin((pose.to_3x3() @ Vector((1.0, 0.0, 0.0))).z)) for pose in of_phone]
    assert np.abs(rolls).max() < 8


def test_there_are_as_many_virtual_objects_as_the_table_says_and_in_no_other_collection(scene):
    assert len(virtual_objects(scene)) == N_VIRTUAL[file_name()]
    for thing in virtual_objects(scene):
        assert list(thing.users_collection) == [virtual_collection(scene)]


def test_virtual_objects_are_in_view_most_of_the_time(scene):
    for thing in virtual_objects(scene):
        seen = 0
        for _ in frames(scene):
            (position,) = estimation_positions(thing)
            x, y, distance = world_to_camera_view(scene, scene.camera, Vector(position))
            seen += 0 < x < 1 and 0 < y < 1 and distance > 0
        assert seen >= 16, f"{thing.name} is in view in {seen} of 24 frames"


def test_virtual_objects_stand_on_the_room(scene):
    scene.frame_set(1)
    things = virtual_objects(scene)
    virtual_collection(scene).hide_viewport = True
    for thing in things:
        low = min((thing.matrix_world @ Vector(corner)).z for corner in thing.bound_box)
        place, _ = hit_by_a_ray(scene, (thing.location.x, thing.location.y, low + 0.02), DOWN)
        assert place.z == pytest.approx(low, abs=0.002), f"{thing.name} floats or sinks"


def test_the_phone_never_comes_close_to_anything(scene):
    virtual_collection(scene).hide_viewport = True
    around = [Vector(d) for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]
    for pose in poses(scene):
        for direction in around:
            place, _ = hit_by_a_ray(scene, pose.translation, (direction - Vector((1, 1, 1))).normalized())
            assert place is None or (place - pose.translation).length > 0.15


def test_a_tiny_render_is_neither_black_nor_blank(scene, tmp_path):
    scene.frame_set(18)
    scene.render.resolution_x, scene.render.resolution_y, scene.cycles.samples = 32, 24, 4
    pixels = rendered_picture(scene, tmp_path)[..., :3]
    assert 0.05 < pixels.mean() < 0.8
    assert pixels.std() > 0.03


def test_one_lamp_goes_from_warm_to_cool_and_one_from_dark_to_full_power():
    kelvin, power = lamp_over_time(opened("light_temperature"))
    assert (kelvin[0], kelvin[-1]) == pytest.approx((1500, 6500))
    assert (np.diff(kelvin) > 0).all()
    assert np.ptp(power) == 0
    kelvin, power = lamp_over_time(opened("light_intensity"))
    np.testing.assert_allclose(power / power[-1], np.linspace(0, 1, 24), atol=1e-6)
    assert np.ptp(kelvin) == 0


def lamp_over_time(scene):
    lamp = bpy.data.lights["Desk lamp light"]
    temperature = lamp.node_tree.nodes["Temperature"].inputs[0]
    return np.array([(temperature.default_value, lamp.energy) for _ in frames(scene)]).T


def test_the_cornell_box_is_where_its_docstring_says():
    scene = opened("cornell_box")
    virtual_collection(scene).hide_viewport = True
    middle = Vector((0.0, -0.6, 1.5))
    known = {(0, 1, 0): 1.6, (-1, 0, 0): 1.0, (1, 0, 0): 1.0, (0, 0, 1): 0.5, DOWN: 1.5}
    for direction, distance in known.items():
        place, normal = hit_by_a_ray(scene, middle, direction)
        assert (place - middle).length == pytest.approx(distance, abs=1e-6)
        assert normal.dot(Vector(direction)) == pytest.approx(-1), "faces look into the box"
    for x, y, height in ((0.35, -0.3, 0.6), (-0.35, 0.35, 1.2), (0.0, 0.0, 1.995)):
        place, _ = hit_by_a_ray(scene, (x, y, 3), DOWN)
        place, _ = hit_by_a_ray(scene, place - Vector((0, 0, 1e-3)), DOWN)
        assert place.z == pytest.approx(height, abs=1e-6)


def numbers(scene):
    """All the numbers of a scene: the phone's poses, and each object's place and vertices."""
    found = {"poses": np.array(poses(scene))}
    scene.frame_set(scene.frame_start)
    for thing in scene.objects:
        vertices = [tuple(v.co) for v in thing.data.vertices] if thing.type == "MESH" else []
        found["place of " + thing.name] = np.array(thing.matrix_world)
        found["vertices of " + thing.name] = np.array(vertices)
    return found


def nodes():
    """The node types of each material."""
    return {material.name: [node.bl_idname for node in material.node_tree.nodes] for material in bpy.data.materials}


@pytest.mark.parametrize("name", SCENES)
def test_the_shipped_scene_is_what_its_script_builds(builders, name):
    build = import_module(f"build_{name}").build
    built, built_nodes = numbers(build()), nodes()
    shipped = numbers(opened(name))
    assert set(shipped) == set(built)
    assert nodes() == built_nodes
    for what in built:
        # Blender versions differ in the last digit of a sphere's vertices.
        np.testing.assert_allclose(shipped[what], built[what], atol=1e-5, err_msg=what)
