"""What is drawn over the 3D view: positions where a run has them, colours of coverage, labels, and an arrow."""

import bpy
import numpy as np
import pytest
from addon_runs import registered_addon
from tiny_scenes import box, room_with_a_virtual_sphere

from xihe_blender.addon import overlay
from xihe_blender.apply.datablocks import LightOf, world_name
from xihe_blender.apply.sh_worlds import make_sh_world
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.virtual_objects import virtual_collection


def shown_positions(scene):
    return overlay.shown_positions(scene, bpy.context.evaluated_depsgraph_get())


def test_positions_that_are_shown_are_those_of_a_run_by_name_and_place():
    scene = room_with_a_virtual_sphere()
    box(scene, "Shelf", (0, 1.5, 1), (2.5, 0.2, 0.2), collection=virtual_collection(scene))
    bpy.context.view_layer.update()
    probes = plan_previs(scene, PrevisSettings()).probes
    shown = shown_positions(scene)
    assert [position.name for position in shown] == [probe.name for probe in probes]
    np.testing.assert_allclose([position.place for position in shown], [p.position_m for p in probes], atol=1e-6)
    assert len(shown) == 4
    # The view has Blender units, whatever they are in metres.
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 0.5
    halved = shown_positions(scene)
    ball = next(position for position in shown if "Shelf" not in position.name)
    np.testing.assert_allclose(next(p.place for p in halved if p.name == ball.name), ball.place, atol=1e-6)


def test_an_object_that_a_run_would_refuse_shows_no_positions_and_the_others_do():
    scene = room_with_a_virtual_sphere()
    for name, scale in (("Planet", 1e4), ("Ghost", float("nan"))):
        box(scene, name, (0, 0, 1), (1, 1, 1), collection=virtual_collection(scene)).scale = (scale,) * 3
    bpy.context.view_layer.update()
    shown = shown_positions(scene)
    assert [position.name for position in shown] == ["Ball"]


def test_a_keyed_object_that_was_moved_since_the_run_has_no_share_of_it():
    scene = room_with_a_virtual_sphere()
    ball = bpy.data.objects["Ball"]
    bpy.context.view_layer.update()
    (there,) = shown_positions(scene)
    with registered_addon():
        LightOf({"Ball": there.place}).write(make_sh_world(world_name("Ball")))
        assert overlay.shares_seen(scene, [there], {"Ball": 0.7}) == {"Ball": 0.7}
        ball.location.x += 0.2
        bpy.context.view_layer.update()
        (followed,) = shown_positions(scene)
        assert overlay.shares_seen(scene, [followed], {"Ball": 0.7}) == {"Ball": 0.7}, "until its light is there"
        ball.keyframe_insert("location", frame=1)
        (keyed,) = shown_positions(scene)
        assert overlay.shares_seen(scene, [keyed], {"Ball": 0.7}) == {}
        scene.xihe.follows_objects = False
        assert overlay.shares_seen(scene, [followed], {"Ball": 0.7}) == {}
        LightOf({"Ball": keyed.place}, live={"Ball": (0.4, None)}).write(bpy.data.worlds[world_name("Ball")])
        assert overlay.shares_seen(scene, [keyed], {"Ball": 0.7}) == {"Ball": 0.4}
        assert overlay.shares_seen(scene, [there], {"Ball": 0.7}) == {}
        LightOf({"Ball": keyed.place}, moves=True).write(bpy.data.worlds[world_name("Ball")])
        assert overlay.shares_seen(scene, [there], {"Ball": 0.7}) == {"Ball": 0.7}, "along the path"


def test_an_overlay_is_never_made_in_background():
    with registered_addon():
        assert overlay._overlay is None
        for name in overlay.HANDLERS:
            assert overlay.forget_positions not in getattr(bpy.app.handlers, name)


def test_coverage_goes_from_one_colour_to_the_other_and_unknown_has_its_own():
    assert overlay.colour_of(0) == overlay.LITTLE
    assert overlay.colour_of(1.0) == pytest.approx(overlay.MUCH)
    assert overlay.colour_of(7) == overlay.colour_of(1)
    assert overlay.colour_of(None) == overlay.UNKNOWN


def test_labels_that_would_overlap_are_moved_down_until_none_does():
    rng = np.random.default_rng(5)
    taken = []
    for x, y in rng.uniform(0, 60, (40, 2)):
        taken.append(overlay.below_others((x, y, x + 50, y + 12), taken))
    for index, (left, bottom, right, top) in enumerate(taken):
        assert top - bottom == pytest.approx(12)
        for other in taken[:index]:
            assert left >= other[2] or other[0] >= right or bottom >= other[3] - 1e-9 or other[1] >= top - 1e-9
    assert overlay.below_others((0, 0, 1, 1), []) == (0, 0, 1, 1)


def test_an_arrow_is_three_triangles_that_end_at_its_tip():
    corners = overlay.arrow_corners((10.0, 10.0), (110.0, 10.0))
    assert len(corners) == 9 and corners[-1] == (110.0, 10.0)
    assert all(10.0 <= x <= 110.0 for x, _ in corners)
    assert overlay.arrow_corners((5.0, 5.0), (5.0, 5.0)) == []
