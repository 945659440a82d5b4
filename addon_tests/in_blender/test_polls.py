"""What the panel doubts of a run before it begins; what makes its buttons grey is asked in test_addon_operators."""

import bpy
import pytest
from tiny_scenes import add, box, room_with_a_virtual_sphere

from xihe_blender.addon import polls
from xihe_blender.previs.scene_faults import unseen_faults
from xihe_blender.scene.virtual_objects import make_virtual, virtual_collection, virtual_objects


def first_words(scene):
    return {" ".join(doubt.split()[:2]) for doubt in polls.doubts(scene)} - {"This build"}


def test_a_run_that_would_tell_little_is_doubted_before_it():
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    scene = bpy.context.scene
    scene.camera.animation_data_create()  # With nothing in it.
    assert first_words(scene) == {"The camera"}
    virtual_collection(scene, create=True).objects.link(bpy.data.objects["Cube"])
    scene.collection.children["Collection"].objects.unlink(bpy.data.objects["Cube"])
    assert first_words(scene) == {"The camera", "Only virtual"}
    bpy.ops.mesh.primitive_plane_add()
    assert first_words(scene) == {"The camera"}
    on_rails = bpy.data.objects.new("Rails", None)
    on_rails.keyframe_insert("location", frame=1)
    scene.camera.parent = on_rails
    assert first_words(scene) == set()
    scene.camera.parent = None
    scene.camera.constraints.new("FOLLOW_PATH")
    assert first_words(scene) == set()


def doubts_of_objects(scene):
    bpy.context.view_layer.update()
    named = {item.name.split(".")[0] for item in virtual_objects(scene)}
    return [doubt for doubt in polls.doubts(scene) if doubt.split()[0].strip("'") in named]


def test_virtual_objects_that_no_picture_shows_are_doubted():
    scene = room_with_a_virtual_sphere()
    ball, home = bpy.data.objects["Ball"], virtual_collection(scene)
    assert doubts_of_objects(scene) == []
    disabled = ["'Ball' is disabled in renders: no picture will show it"]
    ball.hide_render = True
    assert doubts_of_objects(scene) == disabled
    ball.keyframe_insert("hide_render", frame=1)
    assert doubts_of_objects(scene) == [], "it may be shown at another frame"
    ball.animation_data_clear()
    ball.hide_render, outer = False, bpy.data.collections.new("Outer")
    scene.collection.children.link(outer)
    outer.children.link(home)
    outer.hide_render = True
    assert doubts_of_objects(scene) == [], "the scene shows the collection by itself as well"
    scene.collection.children.unlink(home)
    assert doubts_of_objects(scene) == disabled
    box(scene, "Vase", (0, 0, 1), (0.1, 0.1, 0.1), collection=home)
    assert doubts_of_objects(scene) == ["'Ball' and 1 more are disabled in renders: no picture will show them"]


def test_a_virtual_curve_without_a_surface_is_doubted():
    scene = room_with_a_virtual_sphere()
    curve = bpy.data.curves.new("Wire", "CURVE")
    curve.splines.new("POLY").points.add(3)
    item = add(scene, "Wire", curve, collection=virtual_collection(scene))
    profile = add(scene, "Profile", bpy.data.curves.new("Profile", "CURVE"))
    bare = ["'Wire' has no surface, only a curve: give it a bevel, an extrusion or a fill"]
    assert doubts_of_objects(scene) == bare
    for name, value, otherwise in (("bevel_depth", 0.1, 0), ("extrude", 0.1, 0), ("bevel_object", profile, None)):
        setattr(curve, name, value)
        assert doubts_of_objects(scene) == [], name
        setattr(curve, name, otherwise)
    curve.splines[0].use_cyclic_u = True
    assert doubts_of_objects(scene) == bare, "what is filled is flat"
    curve.dimensions, curve.fill_mode = "2D", "BOTH"
    assert doubts_of_objects(scene) == []
    curve.fill_mode = "NONE"
    assert doubts_of_objects(scene) == bare
    item.modifiers.new("Thick", "SOLIDIFY")
    assert doubts_of_objects(scene) == []


def test_a_virtual_object_around_the_camera_is_doubted():
    scene = room_with_a_virtual_sphere()
    x, y, z = scene.camera.location
    box(scene, "Mesh_0", (x, y, z), (4, 4, 0.5), collection=virtual_collection(scene))
    said = "'Mesh_0' encloses the camera: is it the room? Only what the phone inserts is to be virtual"
    assert doubts_of_objects(scene) == [said]
    bpy.data.objects["Mesh_0"].location.z += 0.3
    assert doubts_of_objects(scene) == []


def test_what_is_parented_to_a_virtual_object_and_left_in_the_room_is_doubted():
    scene = room_with_a_virtual_sphere()
    hat = box(scene, "Hat", (0, 0, 1), (0.1, 0.1, 0.1))
    hat.parent = add(scene, "Neck", None)
    hat.parent.parent = bpy.data.objects["Ball"]
    add(scene, "Flame", bpy.data.lights.new("Flame", "POINT")).parent = bpy.data.objects["Ball"]
    scene.view_layers[0].update()
    (said,) = (doubt for doubt in polls.doubts(scene) if "parented" in doubt)
    assert said == "'Hat' is parented to a virtual object, but part of the room: add it too"
    hat.hide_render = True
    assert not any("parented" in doubt for doubt in polls.doubts(scene))
    hat.hide_render = False
    cutters = bpy.data.collections.new("Cutters")
    scene.collection.children.link(cutters)
    cutters.objects.link(hat)
    scene.collection.objects.unlink(hat)
    scene.view_layers[0].update()
    assert any("parented" in doubt for doubt in polls.doubts(scene))
    for hiding, name in (
        (cutters, "hide_render"),
        (scene.view_layers[0].layer_collection.children["Cutters"], "exclude"),
    ):
        setattr(hiding, name, True)
        scene.view_layers[0].update()
        assert not any("parented" in doubt for doubt in polls.doubts(scene))
        setattr(hiding, name, False)

    make_virtual(scene, [hat])
    assert not any("parented" in doubt for doubt in polls.doubts(scene))


@pytest.mark.parametrize("has_denoiser", [True, False])
def test_a_build_without_a_denoiser_is_told(monkeypatch, has_denoiser):
    import _cycles

    monkeypatch.setattr(_cycles, "with_openimagedenoise", has_denoiser)
    said = any("no denoiser" in doubt for doubt in polls.doubts(bpy.context.scene))
    assert said is not has_denoiser


def test_a_model_of_many_parts_is_doubted_and_named_by_the_run():
    scene = room_with_a_virtual_sphere()
    root, home = add(scene, "Car", None), virtual_collection(scene)
    inner = add(scene, "Doors", None)
    inner.parent = root
    for k in range(7):
        box(scene, f"Part {k}", (0, 0, 1), (0.1, 0.1, 0.1), collection=home).parent = inner if k % 2 else root
    assert not list(unseen_faults(scene))
    bpy.data.objects["Ball"].parent = inner
    said = "8 virtual objects hang on 'Car', and a run lights and renders them one by one"
    assert any(doubt.startswith(said) for doubt in polls.doubts(scene))
    (fault,) = unseen_faults(scene)
    assert (fault.name, fault.n) == ("Car", 8) and fault.said.startswith(said)
