"""Scenes and installations that are out of the ordinary: each works, or says in one line what to do."""

import shutil
from dataclasses import replace

import bpy
import numpy as np
import pytest
from effect_scenes import nodes_of, shader_node
from previs_runs import DRAFT, SMALL, QuickProbes, run, walk
from results_schema import without_times
from tiny_scenes import (
    add_lamp,
    box,
    empty_scene,
    geometry_nodes,
    linked,
    opened,
    phone,
    room_with_a_virtual_sphere,
    saved,
    set_world,
    sphere,
)
from tiny_scenes import key as keyed

from xihe_blender.apply.datablocks import LIT_SCENE, lights_by_sh, world_name
from xihe_blender.apply.session import XiheController
from xihe_blender.apply.sh_worlds import sh_node_group
from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import open_scanner
from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import matching
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.rooms.scene import add_scene
from xihe_blender.lab.rooms.settings import RoomRenderSettings
from xihe_blender.previs.files_read import files_named, files_read
from xihe_blender.previs.plan import made_of, plan_previs
from xihe_blender.previs.required_effects import effects_of_run
from xihe_blender.previs.scene_faults import blur_faults, faults_at_frame, layer_faults, timing_faults, unseen_faults
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.survey import survey_path
from xihe_blender.scene.blend_file import modifier_input, open_blend, save_copy
from xihe_blender.scene.estimation_positions import estimation_positions
from xihe_blender.scene.phone_capture import CAPTURE
from xihe_blender.scene.sphere_rig import add_three_sphere_rig
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet.controller import ControllerSettings
from xihenet.effects import names_that_are_on
from xihenet.estimators import load

EXACT = QuickProbes(**DRAFT, exposure=0.5, samples=64)


def assert_refused(scene, out, *words, settings=SMALL):
    """One line that holds `words`, and no folder."""
    with pytest.raises(UserError) as refused:
        run(scene, out, settings)
    assert "\n" not in str(refused.value)
    for word in words:
        assert word in str(refused.value)
    assert not out.exists()


# -------------------------------------------------------------------------------------------------------------- scenes


def test_a_scene_without_virtual_objects_or_with_one_that_is_in_the_room_as_well_says_so(tmp_path):
    assert_refused(empty_scene(), tmp_path / "out", "no virtual object", "Xihe Virtual")
    scene = room_with_a_virtual_sphere()
    scene.collection.objects.link(bpy.data.objects["Ball"])
    assert_refused(scene, tmp_path / "out", "'Ball' is also in collection", "unlink")


def test_a_scene_of_another_engine_runs_and_keeps_it(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    scene.render.engine = "BLENDER_WORKBENCH"
    run(scene, tmp_path / "out")
    assert scene.render.engine == "BLENDER_WORKBENCH"
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "untitled_lit.blend"))
    assert bpy.data.scenes[LIT_SCENE].render.engine == "CYCLES"
    assert bpy.data.scenes["Scene"].render.engine == "BLENDER_WORKBENCH"


def test_long_and_strange_names_are_kept_apart(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    scene.name = "Räume/\\ 部屋" * 4
    scene.camera.name = 'Télé/phone:*? <&> "'
    bpy.data.objects["Ball"].name = "球 <b>" * 40
    for x in (-0.3, 0.3):
        sphere(scene, "x" * 300, (x, 0, 0.85), 0.1, None, virtual_collection(scene))
    results = run(scene, tmp_path / "out")
    names = results["scene"]["virtual_objects"]
    assert len(set(names)) == 3
    assert {world.name for world in bpy.data.worlds if lights_by_sh(world)} == {world_name(name) for name in names}
    assert len({world_name(name) for name in names}) == 3
    assert all(len(path.name.encode()) < 255 for path in (tmp_path / "out").rglob("*"))


@pytest.mark.parametrize("name", ["Ball", "x" * 58, "x" * 59, "x" * 300, "球" * 19, "球" * 20, "é" * 200])
def test_the_name_of_a_world_fits_and_tells_its_object(name):
    empty_scene()
    made = bpy.data.worlds.new(world_name(name))
    assert made.name == world_name(name)
    assert made.name.startswith("Xihe " + name[:16])
    assert world_name(name) != world_name(name + "y") != world_name(name + "z")


# ---------------------------------------------------------------------------------------------------------- two scenes


def test_an_accent_may_be_typed_as_one_sign_where_the_name_has_two():
    scene = walk(2)
    scene.objects["Ball"].name = "Cafe\N{COMBINING ACUTE ACCENT}"
    wanted = ("Caf\N{LATIN SMALL LETTER E WITH ACUTE}",)
    assert plan_previs(scene, replace(SMALL, objects=wanted)).objects == (
        scene.objects["Cafe\N{COMBINING ACUTE ACCENT}"],
    )


def test_only_the_scene_that_runs_gets_light_and_markers(tmp_path):
    first = room_with_a_virtual_sphere(2)
    first.name = "First"
    bpy.ops.scene.new(type="FULL_COPY")
    second = bpy.context.scene
    second.name = "Second"
    assert [item.name for item in virtual_objects(second)] == ["Ball.001"]
    results = run(second, tmp_path / "out")
    assert results["scene"]["name"] == "Second" and results["scene"]["virtual_objects"] == ["Ball.001"]
    assert any("2 scenes" in note and "'Second'" in note for note in results["notes"])
    assert [world.name for world in bpy.data.worlds if lights_by_sh(world)] == ["Xihe Ball.001"]
    assert second.timeline_markers and not first.timeline_markers
    assert bpy.context.scene == second


def test_a_file_runs_the_scene_it_was_saved_in(tmp_path):
    room_with_a_virtual_sphere(2).name = "First"
    bpy.ops.scene.new(type="EMPTY")
    bpy.context.scene.name = "Second"
    assert open_blend(saved(tmp_path / "two.blend")).name == "Second"


def test_a_holdout_is_a_fault_of_what_is_rendered_and_none_over_a_recording():
    scene = room_with_a_virtual_sphere(1)
    scene.objects["Table"].is_holdout = scene.objects["Ball"].is_holdout = True
    assert [fault.name for fault in unseen_faults(scene)] == ["Table"]
    not_rendered = bpy.data.collections.new("Not Rendered")
    not_rendered.hide_render = True
    scene.collection.children.link(not_rendered)
    left_out = scene.objects["Table"].copy()
    not_rendered.objects.link(left_out)
    assert [fault.name for fault in unseen_faults(scene)] == ["Table"]
    scene[CAPTURE] = "recording"
    assert not list(unseen_faults(scene))


# ----------------------------------------------------------------------------------------------------------- libraries


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """The walk as a library: (its file, the results of a run in it, and the lit file of that)."""
    folder = tmp_path_factory.mktemp("library")
    scene = walk(2)
    file = saved(folder / "library.blend")
    return file, run(scene, folder / "own"), folder / "own" / "untitled_lit.blend"


def link_all(file, frames=2):
    """A scene that holds nothing of its own: room, phone and virtual objects are linked from `file`."""
    scene = empty_scene()
    scene.frame_end = frames
    virtual = virtual_collection(scene, create=True)
    with bpy.data.libraries.load(str(file), link=True) as (there, wanted):
        wanted.objects, wanted.worlds = list(there.objects), ["Background"]
    scene.world = wanted.worlds[0]
    for item in wanted.objects:
        (virtual if item.name in ("Ball", "Board") else scene.collection).objects.link(item)
        scene.camera = item if item.type == "CAMERA" else scene.camera
    bpy.context.view_layer.update()
    return scene


def test_a_library_or_an_image_that_has_changed_since_makes_another_run(library, tmp_path):
    def made(scene):
        plan = plan_previs(scene, SMALL)
        return made_of("a run", scene, tmp_path / "no.blend", SMALL, plan)["linked_sha256"]

    file, picture = tmp_path / "library.blend", tmp_path / "picture.png"
    file.write_bytes(library[0].read_bytes())
    found = [made(walk(2)), made(link_all(file))]
    with file.open("ab") as changed:
        changed.write(bytes(8))
    scene = link_all(file)
    found.append(made(scene))
    for content in (b"one", b"two"):
        picture.write_bytes(content)
        shown_in_the_sky(bpy.data.images.load(str(picture), check_existing=True))
        found.append(made(scene))
    behind = tmp_path / "behind.png"
    behind.write_bytes(b"three")
    scene.camera.data.background_images.new().image = bpy.data.images.load(str(behind))
    assert made(scene) == found[-1]
    tiles = [tmp_path / f"tile[a].{number}.png" for number in (1001, 1002)]
    for tile in tiles:
        tile.write_bytes(b"four")
    image = bpy.data.images.load(str(tiles[0]))
    image.source, image.filepath = "TILED", str(tmp_path / "tile[a].<UDIM>.png")
    shown_in_the_sky(image)
    found.append(made(scene))
    tiles[1].write_bytes(b"five")
    found.append(made(scene))
    assert found[0] is None and len(set(found)) == len(found)


def test_all_files_that_a_render_reads_are_known_and_no_others(tmp_path):
    walk(2)
    scene = opened(saved(tmp_path / "room.blend"))
    overlay = bpy.data.images.new("overlay", 4, 4)
    overlay.source, overlay.filepath = "FILE", "//overlay.png"
    bpy.data.node_groups.new("Over", "CompositorNodeTree").nodes.new("CompositorNodeImage").image = overlay
    assert files_read() == []

    def here(*names):
        return {str(tmp_path / name) for name in names}

    film = bpy.data.images.new("film", 4, 4)
    film.source, film.filepath = "SEQUENCE", "//film.v2.0010.jp2"
    shown_in_the_sky(film)
    clip = bpy.data.images.new("clip", 4, 4)
    clip.source, clip.filepath = "MOVIE", "//clip[1].mp4"
    shown_in_the_sky(clip)
    for number, (name, is_sequence) in enumerate([("fog.vdb", False), ("smoke_7.vdb", True)]):
        volume = bpy.data.volumes.new(f"Volume {number}")
        volume.filepath, volume.is_sequence = f"//{name}", is_sequence
    named = {"film.v2.[0-9]*.jp2", "clip[[]1].mp4", "fog.vdb", "smoke_[0-9]*.vdb"}
    assert set(files_read()) == here(*named) and set(files_named()) == named

    lamp = bpy.data.lights.new("Lamp", "POINT")
    tree, _ = nodes_of(lamp)
    node = shader_node(tree, "TexIES")
    node.mode, node.filepath = "EXTERNAL", "//lamp.ies"
    table = scene.objects["Table"]
    table.modifiers.new("", "MESH_CACHE").filepath = "//table.mdd"
    table.modifiers.new("", "OCEAN").filepath = "//ocean"
    cloth = table.modifiers.new("", "CLOTH").point_cache
    cloth.use_disk_cache = True
    fluid = table.modifiers.new("", "FLUID")
    fluid.show_viewport = fluid.show_render = False  # Evaluated without a simulation it crashes Blender.
    fluid.fluid_type = "DOMAIN"
    fluid.domain_settings.cache_directory = "//fluid"
    now = here("lamp.ies", "table.mdd")
    assert now < set(files_read()) and not here("ocean/**/*", "fluid/**/*") & set(files_read())
    fluid.domain_settings.cache_type = "ALL"
    cloth.use_external = True
    without_folder = set(files_read())
    cloth.filepath = "//cloth"
    assert here("fluid/**/*", "cloth/*.bphys") < set(files_read()) == without_folder | here("cloth/*.bphys")


def given_to_nodes(item, kind, value):
    """Geometry nodes of `item` that import the STL file of an input of its modifier; the modifier, and the input."""
    tree = bpy.data.node_groups.new("Import", "GeometryNodeTree")
    given = tree.interface.new_socket("File", in_out="INPUT", socket_type="NodeSocketString")
    given.subtype = kind
    node = tree.nodes.new("GeometryNodeImportSTL")
    tree.links.new(tree.nodes.new("NodeGroupInput").outputs[0], node.inputs["Path"])
    modifier = item.modifiers.new("Import", "NODES")
    modifier.node_group = tree
    modifier_input(modifier, given.identifier)[1](value)
    return modifier, given.identifier


def test_what_geometry_nodes_are_given_and_all_kinds_of_baked_physics_are_read(tmp_path):
    walk(2)
    scene = opened(saved(tmp_path / "room.blend"))
    table = scene.objects["Table"]
    given_to_nodes(table, "FILE_PATH", "//models\\vase.stl")  # As a Blender on Windows writes it.
    given_to_nodes(table, "NONE", "//cup_")
    given_to_nodes(table, "NONE", "//cups/")
    given_to_nodes(table, "NONE", "//bowls\\")
    given_to_nodes(table, "NONE", "no path")
    given_to_nodes(table, "NONE", "/")
    bpy.ops.rigidbody.world_add()
    bodies = scene.rigidbody_world.point_cache
    bodies.filepath, bodies.use_external = "//bodies", True
    paint = table.modifiers.new("Paint", "DYNAMIC_PAINT")
    with bpy.context.temp_override(object=table):
        bpy.ops.dpaint.type_toggle(type="CANVAS")
    wet = paint.canvas_settings.canvas_surfaces[0].point_cache
    wet.filepath, wet.use_external = "//wet", True
    bpy.ops.cachefile.open(filepath=str(tmp_path / "walk.abc"))
    bpy.data.cache_files[0].layers.new(filepath="//walk_over.abc")
    names = (
        "models/vase.stl",
        "cup_*",
        "cups/*",
        "bowls/*",
        "bodies/*.bphys",
        "wet/*.bphys",
        "walk.abc",
        "walk_over.abc",
    )
    assert set(files_read()) == {str(tmp_path / name) for name in names}


def test_a_cache_of_a_linked_object_lies_beside_its_library(tmp_path):
    (tmp_path / "shot").mkdir()
    empty_scene()
    shot = saved(tmp_path / "shot" / "walk.blend")
    box(bpy.context.scene, "Flag", (0, 0, 0), (1, 1, 0.1)).modifiers.new("", "CLOTH")
    scene = opened(saved(tmp_path / "library.blend"))
    cache = scene.objects["Flag"].modifiers[0].point_cache
    cache.use_disk_cache, cache.frame_end = True, 2
    with bpy.context.temp_override(point_cache=cache):
        bpy.ops.ptcache.bake(bake=True)
    library = saved(tmp_path / "library.blend")
    kept = set((tmp_path / "blendcache_library").iterdir())
    opened(shot)
    with bpy.data.libraries.load(str(library), link=True, relative=True) as (_, wanted):
        wanted.objects = ["Flag"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    read = {path.resolve() for pattern in files_read() for path in matching(pattern)}
    assert kept and read == {*kept, library}
    assert set(files_named()) == {"../library.blend", "../blendcache_library/*.bphys"}


def test_what_the_first_view_layer_leaves_out_is_named():
    scene = room_with_a_virtual_sphere()
    front = bpy.data.collections.new("Front")
    scene.collection.children.link(front)
    box(scene, "Screen", (0, 0, 1), (1, 1, 0.1), collection=front)
    first, second = scene.view_layers[0], scene.view_layers.new("FG")
    first.layer_collection.children["Front"].exclude = True
    (fault,) = layer_faults(scene)
    assert fault.name == "Screen" and "'FG'" in fault.said
    second.use = False
    assert not list(layer_faults(scene))


@pytest.mark.parametrize(("blur", "n"), [(0.0, 0), (0.1, 1), (0.4, 0), (1.0, 0)])
def test_a_filter_glossy_that_the_reference_light_cannot_follow_is_named(blur, n):
    scene = room_with_a_virtual_sphere()
    scene.cycles.blur_glossy = blur
    assert [fault.said.partition(":")[0] for fault in blur_faults(scene)] == n * ["Filter Glossy is 0.1"]


def test_physics_that_is_not_baked_and_stretched_time_are_named():
    scene = empty_scene()
    assert not list(timing_faults(scene))
    flag = box(scene, "Flag", (0, 0, 0), (1, 1, 0.1))
    cache = flag.modifiers.new("Cloth", "CLOTH").point_cache
    scene.render.frame_map_new = 200
    physics, time = timing_faults(scene)
    assert physics.name == "Flag" and "not baked" in physics.said and "Time Stretching" in time.said
    cache.frame_end = 2
    with bpy.context.temp_override(point_cache=cache):
        bpy.ops.ptcache.bake(bake=True)
    assert list(timing_faults(scene)) == [time]
    painted, furry, dusty = (box(scene, name, (0, 0, 0), (1, 1, 0.1)) for name in ("Painted", "Furry", "Dusty"))
    paint = painted.modifiers.new("Paint", "DYNAMIC_PAINT")
    with bpy.context.temp_override(object=painted):
        bpy.ops.dpaint.type_toggle(type="CANVAS")
    dusty.modifiers.new("Dust", "PARTICLE_SYSTEM")  # Comes out the same whatever frames are left out.
    fur = furry.modifiers.new("Fur", "PARTICLE_SYSTEM").particle_system
    fur.settings.type = "HAIR"
    assert [fault.name for fault in timing_faults(scene)] == ["Painted", scene.name]
    paint.show_render, fur.use_hair_dynamics = False, True
    assert [fault.name for fault in timing_faults(scene)] == ["Furry", scene.name]


def drifting(item):
    """`item` with a simulation zone that moves it by a metre in each frame, in a group within its geometry nodes."""
    (zone, zone_start, zone_end), (outer, start, end) = geometry_nodes(), geometry_nodes()
    first, last = (zone.nodes.new(f"GeometryNodeSimulation{end}") for end in ("Input", "Output"))
    first.pair_with_output(last)
    step = zone.nodes.new("GeometryNodeSetPosition")
    step.inputs["Offset"].default_value = (1, 0, 0)
    zone.links.new(zone_start, first.inputs[0])
    zone.links.new(first.outputs["Geometry"], step.inputs[0])
    zone.links.new(step.outputs[0], last.inputs["Geometry"])
    zone.links.new(last.outputs[0], zone_end)
    group = outer.nodes.new("GeometryNodeGroup")
    group.node_tree = zone
    outer.links.new(start, group.inputs[0])
    outer.links.new(group.outputs[0], end)
    modifier = item.modifiers.new("Drift", "NODES")
    modifier.node_group = outer
    return modifier


def x_at(item, frame):
    bpy.context.scene.frame_set(frame)
    return item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices[0].co.x


def test_a_simulation_zone_is_named_unless_it_is_baked_to_disk_or_into_the_file(tmp_path):
    scene = empty_scene()
    scene.frame_end = 5
    flock = box(scene, "Flock", (0, 0, 0), (1, 1, 1))
    modifier = drifting(flock)
    zone, start = modifier.bakes[0], flock.data.vertices[0].co.x
    as_made = (modifier.bake_directory, zone.directory, zone.use_custom_path)
    (fault,) = timing_faults(scene)
    assert fault.name == "Flock" and "Simulation Nodes > Bake" in fault.said
    assert x_at(flock, 1) - start == 1 and x_at(flock, 5) - start == 2, "frames that are left out are not worked out"
    with bpy.context.temp_override(object=flock, active_object=flock, selected_objects=[flock]):
        bpy.ops.object.simulation_nodes_cache_bake(selected=True)
        if hasattr(zone, "bake_target"):
            assert not list(timing_faults(scene)) and x_at(flock, 5) - start == 5
            assert as_made == (modifier.bake_directory, zone.directory, zone.use_custom_path)
            bpy.ops.object.simulation_nodes_cache_delete(selected=True)
            assert list(timing_faults(scene)) == [fault]
            zone.bake_target = "DISK"
        modifier.bake_directory = str(tmp_path / "flock")
        bpy.ops.object.simulation_nodes_cache_bake(selected=True)
    assert not list(timing_faults(scene))
    shutil.rmtree(tmp_path / "flock")
    assert list(timing_faults(scene)) == [fault]
    modifier.show_render = False
    assert not list(timing_faults(scene))


def test_a_replay_fluid_is_named():
    scene = empty_scene()
    smoke = box(scene, "Smoke", (0, 0, 0), (1, 1, 1)).modifiers.new("", "FLUID")
    smoke.show_viewport = False  # Evaluated without a simulation it crashes Blender.
    smoke.fluid_type = "DOMAIN"
    (fault,) = timing_faults(scene)
    assert fault.name == "Smoke" and "Replay" in fault.said
    smoke.domain_settings.cache_type = "ALL"
    assert not list(timing_faults(scene))


def test_python_that_was_not_run_is_named(tmp_path):
    walk(2)
    bpy.data.objects["Lamp"].driver_add("location", 2).driver.expression = "bpy.data.scenes[0].frame_current"
    (fault,) = timing_faults(open_blend(saved(tmp_path / "walk.blend")))
    assert fault.name == bpy.context.scene.name and "frame_current" in fault.said
    walk(2)
    saved(tmp_path / "plain.blend")
    assert not list(timing_faults(open_blend(tmp_path / "plain.blend")))


def test_an_object_that_follows_a_keyed_property_of_the_scene_is_named():
    scene = empty_scene()
    variable = box(scene, "Lift", (0, 0, 0), (1, 1, 1)).driver_add("location", 2).driver.variables.new()
    variable.targets[0].id_type, variable.targets[0].id, variable.targets[0].data_path = "SCENE", scene, '["height"]'
    scene["height"] = 1.0
    assert not list(timing_faults(scene))
    scene.keyframe_insert('["height"]', frame=1)
    assert [fault.name for fault in timing_faults(scene)] == ["Lift"]


def test_a_copy_in_another_folder_reads_the_same_files(tmp_path):
    flag = box(empty_scene(), "Flag", (0, 0, 0), (1, 1, 0.1))
    flag.modifiers.new("Cloth", "CLOTH")
    hair = flag.modifiers.new("Hair", "PARTICLE_SYSTEM").particle_system.point_cache
    hair.use_external, hair.filepath = True, "//hair"
    tree = bpy.data.node_groups.new("Moves", "GeometryNodeTree")
    tree.nodes.new("GeometryNodeImportSTL").inputs["Path"].default_value = "//models\\flag.stl"
    nodes = flag.modifiers.new("Nodes", "NODES")
    nodes.show_viewport, nodes.node_group, nodes.bake_directory = False, tree, "//moves"
    _, given = given_to_nodes(flag, "FILE_PATH", "//given.stl")
    scene = opened(saved(tmp_path / "shot.blend"))
    cloth = scene.objects["Flag"].modifiers["Cloth"].point_cache
    cloth.use_disk_cache, cloth.frame_end = True, 2
    with bpy.context.temp_override(point_cache=cloth):
        bpy.ops.ptcache.bake(bake=True)
    (tmp_path / "blendcache_shot" / "another.bphys").touch()
    copy = tmp_path / "runs" / "walk.blend"
    save_copy(scene, copy)
    assert scene.objects["Flag"].modifiers["Nodes"].bake_directory == "//moves"
    assert modifier_input(scene.objects["Flag"].modifiers["Import"], given)[0] == "//given.stl"
    opened(copy)
    elsewhere = {str(tmp_path / name) for name in ("hair/*.bphys", "moves/**/*", "models/flag.stl", "given.stl")}
    assert set(files_read()) == {*elsewhere, str(copy.parent / "blendcache_walk" / "*.bphys")}
    assert len(list(copy.parent.glob("blendcache_walk/*.bphys"))) == 2


def test_files_that_are_missing_are_named_where_a_render_would_read_them(tmp_path):
    scene = empty_scene()
    phone(scene, (0, -2, 1), (0, 0, 0))
    images = [bpy.data.images.new(name, 4, 4) for name in ("wall", "sky", "there", "unused", "behind", "packed")]
    for image in images:
        image.source, image.filepath = "FILE", str(tmp_path / f"{image.name}.png")
    (tmp_path / "there.png").write_bytes(b"any")
    images[5].source = "GENERATED"
    images[5].pack()
    look = bpy.data.materials.new("look")
    tree, _ = nodes_of(look)
    for image in (images[0], images[2], images[5]):
        shader_node(tree, "TexImage").image = image
    cube = box(scene, "Box", (0, 0, 0), (1, 1, 1), look)
    shown_in_the_sky(images[1])
    shader_node(nodes_of(bpy.data.materials.new("unused"))[0], "TexImage").image = images[3]
    scene.camera.data.background_images.new().image = images[4]
    smoke = bpy.data.volumes.new("smoke")
    smoke.filepath = str(tmp_path / "smoke.vdb")
    scene.collection.objects.link(bpy.data.objects.new("Smoke", smoke))
    bpy.ops.cachefile.open(filepath=str(tmp_path / "walk.abc"))
    cube.modifiers.new("", "MESH_SEQUENCE_CACHE").cache_file = bpy.data.cache_files["walk.abc"]
    for name, file in (("Spot", "spot.ies"), ("Bulb", "there.png")):
        lamp = bpy.data.lights.new(name, "POINT")
        scene.collection.objects.link(bpy.data.objects.new(name, lamp))
        node = shader_node(nodes_of(lamp)[0], "TexIES")
        node.mode, node.filepath = "EXTERNAL", str(tmp_path / file)
    group = bpy.data.node_groups.new("Beam", "ShaderNodeTree")
    node = shader_node(group, "TexIES")
    node.mode, node.filepath = "EXTERNAL", str(tmp_path / "beam.ies")
    shader_node(lamp.node_tree, "Group").node_tree = group
    given_to_nodes(cube, "FILE_PATH", str(tmp_path / "given.stl"))[0].node_group.nodes.new(
        "GeometryNodeImportOBJ"
    ).inputs["Path"].default_value = str(tmp_path / "vase.obj")
    bpy.context.view_layer.update()
    faults = {fault.name: fault.said for fault in faults_at_frame(bpy.context.evaluated_depsgraph_get(), is_first=True)}
    assert faults.keys() == {"wall", "sky", "smoke", "walk.abc", "Spot", "Beam", "Box", "Import"}
    assert "pink" in faults["sky"]
    assert all("without it" in faults[name] for name in ("smoke", "walk.abc", "Box", "Import"))
    assert "given.stl" in faults["Box"] and "vase.obj" in faults["Import"]
    assert "spot.ies" in faults["Spot"] and "100 times the Strength" in faults["Spot"]


def test_light_in_a_node_group_is_looked_at_as_that_of_the_material_around_it():
    scene, glow = empty_scene(), bpy.data.materials.new("Glow")
    group = bpy.data.node_groups.new("Shine", "ShaderNodeTree")
    strength = shader_node(group, "Emission").inputs["Strength"]
    shader_node(nodes_of(glow)[0], "Group").node_tree = group
    box(scene, "Box", (0, 0, 0), (1, 1, 1), glow)
    strength.default_value = -1.0
    said = [fault.said for fault in faults_at_frame(bpy.context.evaluated_depsgraph_get(), is_first=True)]
    assert len(said) == 1 and said[0].startswith("The light of node group 'Shine' is negative")
    strength.default_value = float("nan")
    with pytest.raises(UserError, match="node group 'Shine' has nan as its strength"):
        faults_at_frame(bpy.context.evaluated_depsgraph_get(), is_first=True)


@pytest.mark.skipif(bpy.app.version < (4, 5), reason="lamps have neither an exposure nor a temperature")
@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"exposure": float("nan")}, "nan as its exposure"),
        ({"energy": 1e25, "exposure": 32.0}, r"4.29497e\+34 as its strength"),
        ({"use_temperature": True, "temperature": float("nan")}, "nan as its temperature"),
    ],
)
def test_the_exposure_and_the_temperature_of_a_lamp_count_for_its_light(values, said):
    scene = empty_scene()
    add_lamp(scene, name="Bulb", **values)
    with pytest.raises(UserError, match=f"lamp 'Bulb' has {said}"):
        faults_at_frame(bpy.context.evaluated_depsgraph_get(), is_first=True)


def shown_in_the_sky(image):
    set_world(bpy.context.scene).node_tree.nodes.new("ShaderNodeTexEnvironment").image = image


def numbers(results):
    frames = without_times(results)["frames"]
    return [[(p["name"], p["position_m"], p["sh"], p["sh_truth"]) for p in frame["probes"]] for frame in frames]


def test_a_scene_that_is_linked_gives_the_numbers_of_the_library(library, tmp_path):
    scene = link_all(library[0])
    assert numbers(run(scene, tmp_path / "out")) == numbers(library[1])
    assert all(world.library is None for world in bpy.data.worlds if lights_by_sh(world))


@pytest.mark.slow
def test_an_overridden_virtual_object_is_estimated_where_it_was_moved_to(library, tmp_path):
    scene = link_all(library[0])
    moved = scene.objects["Ball"].override_create(remap_local_usages=True)
    moved.location.x += 0.25
    bpy.context.view_layer.update()
    place = next(p.position_m for p in plan_previs(scene, SMALL).probes if p.name == "Ball")
    np.testing.assert_allclose(place, (0.25, 0, 0.85), atol=1e-6)
    run(scene, tmp_path / "out", replace(SMALL, frames=(1,)))


def test_a_linked_object_with_the_name_of_another_is_told_apart_by_the_user(library, tmp_path):
    scene = link_all(library[0])
    sphere(scene, "Ball", (0.3, 0, 0.85), 0.1, None, virtual_collection(scene))
    assert_refused(scene, tmp_path / "out", "two virtual objects are named 'Ball'", "library.blend", "rename")


def test_a_linked_virtual_object_is_not_taken_for_one_of_the_room_with_its_name(library, tmp_path):
    def compared(name):
        scene = link_all(library[0])
        sphere(scene, name, (1.8, 1.8, 0.1), 0.05)
        return run(scene, tmp_path / name, replace(SMALL, frames=(1,)))["comparison"]

    assert compared("Ball") == compared("Pebble")
    scene = room_with_a_virtual_sphere(2)
    file, virtual = saved(tmp_path / "ball.blend"), virtual_collection(scene)
    bpy.data.objects.remove(scene.objects["Ball"])
    virtual.objects.link(*linked(file, "objects", "Ball"))
    keyed(add_lamp(scene, name="Ball").data, "energy", {1: 10.0, 2: 20.0})
    assert run_blocking(survey_path(scene, plan_previs(scene, SMALL))).light_changes


def test_an_object_with_the_name_of_a_position_of_another_is_told_apart_by_the_user(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    virtual = virtual_collection(scene)
    box(scene, "Shelf", (0, 1, 1), (3.0, 0.2, 0.2), collection=virtual)
    sphere(scene, "Shelf 1", (1, -1, 1), 0.1, None, virtual)
    assert_refused(scene, tmp_path / "out", "'Shelf' and 'Shelf 1'", "estimation position", "rename")
    bpy.data.objects["Shelf 1"].name = "Vase"
    assert len(plan_previs(scene, SMALL).probes) == 5


def test_light_of_a_library_stays_as_it_is(library, tmp_path):
    scene = room_with_a_virtual_sphere(1)
    (world,) = linked(library[2], "worlds", "Xihe Ball")
    linked(library[2], "node_groups", "Xihe SH Radiance")
    run(scene, tmp_path / "again")
    assert world.library is not None and world.node_tree.animation_data.action.library is not None
    assert [world.library for world in bpy.data.worlds if world.name == "Xihe Ball"].count(None) == 1
    assert sh_node_group().library is None


@pytest.mark.skipif(bpy.app.version < (5, 0), reason="what is linked cannot be packed")
def test_a_library_that_is_packed_is_not_read(tmp_path):
    set_world(empty_scene(), (1.0, 0.5, 0.2))
    path = str(saved(tmp_path / "sky.blend"))
    scene = empty_scene()
    for is_packed in (True, False):
        with bpy.data.libraries.load(path, link=True, pack=is_packed) as (_, wanted):
            wanted.worlds = ["Background"]
        scene.world = wanted.worlds[0]
        assert files_read() == ([] if is_packed else [path])


def test_a_missing_library_is_named(library, tmp_path):
    link_all(shutil.copy(library[0], tmp_path))
    main = saved(tmp_path / "main.blend")
    (tmp_path / "library.blend").unlink()
    assert_refused(open_blend(main), tmp_path / "out", "is missing", "library.blend", "put it back")


# --------------------------------------------------------------------------------------------------------------- units


def scaled_room(scale_length, system="METRIC"):
    """The room of the tests, its lengths in Blender units divided by `scale_length`, which its units give back."""
    scene = room_with_a_virtual_sphere(1)
    scene.unit_settings.system, scene.unit_settings.scale_length = system, scale_length
    for item in scene.objects:
        item.animation_data_clear()
        item.location /= scale_length
        if item.type == "CAMERA":
            item.data.clip_start, item.data.clip_end = 0.1 / scale_length, 1000 / scale_length
        else:
            item.scale /= scale_length
    bpy.context.view_layer.update()
    return scene


@pytest.mark.slow
def test_a_room_in_other_units_is_the_same_room(tmp_path):
    in_metres, results = (
        run(scaled_room(scale), tmp_path / f"{scale}", replace(EXACT, phone="ipad_pro_lidar", target="ldr"))
        for scale in (1.0, 0.01)
    )
    (known,), (frame,) = in_metres["frames"], results["frames"]
    (known_probe,), (probe,) = known["probes"], frame["probes"]
    np.testing.assert_allclose(probe["position_m"], known_probe["position_m"], atol=1e-5)
    assert probe["coverage"] == pytest.approx(known_probe["coverage"], abs=0.01)
    for key in ("sh", "sh_truth"):
        np.testing.assert_allclose(probe[key], known_probe[key], atol=0.02)
    assert frame["n_lost_pixels"].keys() == known["n_lost_pixels"].keys()
    assert frame["n_invalid_pixels"] == pytest.approx(known["n_invalid_pixels"], abs=3)
    for method in ("lattice", "ambient", "truth"):
        mine, known_rmse = (of["comparison"][method]["rmse"] for of in (results, in_metres))
        assert mine == pytest.approx(known_rmse, rel=0.15, abs=0.01)
    assert any("0.01 m" in note for note in results["notes"])
    assert not any("Blender unit" in note for note in in_metres["notes"])


def announced(scene):
    return run_blocking(effects_of_run(scene, PrevisSettings(), is_measured=False))


def test_the_effects_are_planned_by_metres():
    plans = [announced(scaled_room(scale)) for scale in (1.0, 0.01, 1000.0)]
    assert metres_per_unit(bpy.context.scene) == pytest.approx(1000)
    bounces = [plan["diffuse bounces"].parameters["diffuse_bounces"] for plan in plans]
    assert max(bounces) - min(bounces) <= 1
    assert [names_that_are_on(plan) for plan in plans] == [names_that_are_on(plans[0])] * 3
    bpy.context.scene.unit_settings.system = "NONE"
    assert metres_per_unit(bpy.context.scene) == 1


def test_a_board_gets_a_position_for_each_metre_of_it():
    scene = scaled_room(0.01)
    board = bpy.data.objects["Table"]
    assert len(estimation_positions(board)) == 2
    scene.unit_settings.scale_length = 0.1
    assert len(estimation_positions(board)) == 12 * 8


def test_a_rig_is_as_large_as_it_says_and_stands_at_the_cursor():
    scene = scaled_room(0.01)
    mirror, silver, diffuse = add_three_sphere_rig(scene, (10.0, 20.0, 75.0))
    bpy.context.view_layer.update()
    np.testing.assert_allclose(silver.location, (10, 20, 81), atol=1e-4)
    np.testing.assert_allclose(silver.dimensions, (12, 12, 12), rtol=1e-3)
    assert mirror.location.x < silver.location.x < diffuse.location.x


def test_an_object_is_placed_in_metres():
    scene = scaled_room(0.01)
    controller = XiheController(load("ambient"), ControllerSettings())
    with open_scanner(scene, RenderSettings((32, 24), samples=4)) as scanner:
        controller.step(scanner.acquire_environment_scan())
    controller.place_and_estimate_at(bpy.data.objects["Ball"], (0.1, 0.2, 0.85))
    np.testing.assert_allclose(bpy.data.objects["Ball"].location, (10, 20, 85), atol=1e-3)


def test_rooms_to_train_on_are_in_metres(tmp_path):
    job = add_scene(scaled_room(0.01), "room", tmp_path / "rooms", RoomRenderSettings())
    with pytest.raises(UserError, match="set it to 1"):
        run_blocking(job)


# -------------------------------------------------------------------------------------------------------- installations


def test_without_cycles_the_line_names_the_add_on(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    bpy.ops.preferences.addon_disable(module="cycles")
    try:
        assert_refused(scene, tmp_path / "out", "Cycles", "Preferences > Add-ons")
        with pytest.raises(UserError, match="Preferences > Add-ons"):
            announced(scene)
    finally:
        bpy.ops.preferences.addon_enable(module="cycles")


def test_names_in_another_language_change_nothing(library, tmp_path):
    """Where new data-blocks get translated names, nodes and collections are not called what they are in English."""
    scene = walk(2)
    for block in (*bpy.data.materials, *bpy.data.worlds):
        for node in block.node_tree.nodes:
            # The walk's lamp is keyed, by this name.
            node.name = node.name if node.name == "Emission" else f"Knoten {node.name[::-1]}"
    scene.view_layers[0].name = "Ansichtsebene"
    assert numbers(run(scene, tmp_path)) == numbers(library[1])
