"""The .blend that a run saves: it opens, and its light is the one in results.json."""

from dataclasses import dataclass, replace

import bpy
import numpy as np
import pytest
from previs_runs import N_FRAMES, SMALL, run, walk
from scene_snapshot import differences, snapshot
from tiny_scenes import sphere

from xihe_blender.apply.datablocks import LIT_SCENE, NODE_GROUP_NAME
from xihe_blender.apply.sh_worlds import COEFFICIENTS, GAIN, f_curves
from xihe_blender.capture.render import render_passes, set_up_memory_exr
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.scene.virtual_objects import virtual_collection

DIMMING = replace(SMALL, estimator="projection")
"""An estimator that follows the lamp of `walk` far enough down for pictures to tell."""


@dataclass
class Saved:
    """A run whose file is open."""

    outputs: RunOutputs
    results: dict
    before: dict


@pytest.fixture(scope="module")
def run_of_walk(tmp_path_factory):
    out = tmp_path_factory.mktemp("lit") / "out"
    scene = walk()
    sphere(scene, "Unseen", (0, -1.9, 2.9), 0.05, None, virtual_collection(scene))
    bpy.context.view_layer.update()
    before = snapshot()
    return Saved(RunOutputs(out, "untitled"), run(scene, out, DIMMING), before)


@pytest.fixture
def saved(run_of_walk):
    bpy.ops.wm.open_mainfile(filepath=str(run_of_walk.outputs.lit_blend), load_ui=False)
    return run_of_walk


def light_by_frame(results, name):
    """The light in force at a single-position object, by active frame in which it is in view."""
    found = [(e["frame"], p) for e in results["frames"] for p in e["probes"] if p["name"] == name]
    return {frame: np.array(probe["sh"]) for frame, probe in found}


def keyed(world):
    """{frame: (9, 3) coefficients} of a world's F-curves, and their interpolations."""
    table, interpolations = {}, set()
    for curve in f_curves(world.node_tree):
        for point in curve.keyframe_points:
            interpolations.add(point.interpolation)
            table.setdefault(round(point.co[0]), {})[curve.data_path, curve.array_index] = point.co[1]
    node = world.node_tree.nodes[NODE_GROUP_NAME]
    paths = [node.inputs[name].path_from_id("default_value") for name in COEFFICIENTS]
    coefficients = {f: np.array([[values[path, c] for c in range(3)] for path in paths]) for f, values in table.items()}
    return coefficients, interpolations


def test_the_users_scene_is_in_it_and_nothing_but_xihes_is_added(saved):
    scene = bpy.context.scene
    assert scene.name == saved.before["context/scene"]
    bpy.context.view_layer.update()
    changed, new = differences(saved.before, snapshot())
    assert new == []
    lost = {path for path, (_, value) in changed.items() if value == "gone" and path.startswith(("objects", "scenes"))}
    assert not lost
    assert scene.render.resolution_x == 64 and scene.cycles.samples == 1


def test_the_lit_scene_has_a_layer_per_object_under_its_own_world(saved):
    lit = bpy.data.scenes[LIT_SCENE]
    names = saved.results["scene"]["virtual_objects"]
    assert names == ["Ball", "Board", "Unseen"]
    assert [layer.world_override.name for layer in lit.view_layers] == [f"Xihe {name}" for name in names]
    assert lit.render.film_transparent
    for layer, name in zip(lit.view_layers, names, strict=True):
        shown = [child for child in layer.layer_collection.children if not child.holdout and not child.exclude]
        assert [item.name for child in shown for item in child.collection.objects] == [name]


def test_the_worlds_are_keyed_with_the_light_of_the_results(saved):
    expected = light_by_frame(saved.results, "Ball")
    coefficients, interpolations = keyed(bpy.data.worlds["Xihe Ball"])
    assert interpolations == {"CONSTANT"}
    fired = [e["frame"] for e in saved.results["frames"] for p in e["probes"] if p["name"] == "Ball" and p["fired"]]
    assert sorted(coefficients) == fired and len(fired) > 1
    for frame in fired:
        np.testing.assert_allclose(coefficients[frame], expected[frame], rtol=1e-6, atol=1e-7)


def test_the_light_between_estimates_is_the_last_one(saved):
    lit = bpy.data.scenes[LIT_SCENE]
    expected = light_by_frame(saved.results, "Ball")
    for frame in range(1, N_FRAMES + 1):
        lit.frame_set(frame)
        layer = lit.view_layers["Xihe Ball"]
        inputs = layer.world_override.evaluated_get(layer.depsgraph).node_tree.nodes[NODE_GROUP_NAME].inputs
        in_force = expected[max(known for known in expected if known <= frame)]
        got = np.array([inputs[name].default_value for name in COEFFICIENTS])
        np.testing.assert_allclose(got, in_force, rtol=1e-6, atol=1e-7)
        assert inputs[GAIN].default_value == pytest.approx(1 / saved.results["settings"]["reference_exposure"])


def test_an_object_of_several_positions_gets_their_mean(saved):
    frame = next(e for e in reversed(saved.results["frames"]) if len(e["probes"]) == 3)
    mean = np.mean([p["sh"] for p in frame["probes"] if p["object"] == "Board"], axis=0)
    coefficients, _ = keyed(bpy.data.worlds["Xihe Board"])
    last = max(known for known in coefficients if known <= frame["frame"])
    np.testing.assert_allclose(coefficients[last], mean, rtol=1e-6, atol=1e-7)


def test_an_object_that_was_never_in_view_has_the_ambient_light(saved):
    coefficients, _ = keyed(bpy.data.worlds["Xihe Unseen"])
    active = [entry for entry in saved.results["frames"] if entry["active"]]
    assert sorted(coefficients) == [entry["frame"] for entry in active]
    exposure = saved.results["settings"]["reference_exposure"]
    for entry in active:
        light = coefficients[entry["frame"]]
        assert np.abs(light[1:]).max() < 1e-6
        expected = np.array(entry["ambient_radiance"]) * exposure * np.sqrt(4 * np.pi)
        np.testing.assert_allclose(light[0], expected, rtol=1e-5)


def test_markers_say_where_the_trigger_fired(saved):
    expected = {}
    for entry in saved.results["frames"]:
        reasons = sorted({probe["reason"] for probe in entry["probes"] if probe["fired"]})
        if reasons:
            expected[entry["frame"]] = f"Xihe trigger ({', '.join(reasons)})"
    markers = bpy.context.scene.timeline_markers
    assert {marker.frame: marker.name for marker in markers} == expected
    assert len(markers) == len(expected)


def picture(lit, frame):
    lit.frame_set(frame)
    passes = render_passes(lit).layers["Xihe Ball"]
    return np.stack([passes[f"Combined.{c}"] for c in "RGBA"], axis=-1)


def test_rendering_it_shows_another_light_after_another_estimate(saved):
    lit = bpy.data.scenes[LIT_SCENE]
    lit.camera.animation_data_clear()
    lit.frame_set(1)
    lit.render.resolution_x, lit.render.resolution_y = SMALL.size
    lit.cycles.samples = 4
    set_up_memory_exr(lit.render.image_settings)
    coefficients, _ = keyed(bpy.data.worlds["Xihe Ball"])
    first, last = min(coefficients), max(coefficients)
    assert last < N_FRAMES
    before, after, still = picture(lit, first), picture(lit, last), picture(lit, N_FRAMES)
    np.testing.assert_array_equal(after, still)
    np.testing.assert_array_equal(before[..., 3], after[..., 3])
    covered = before[..., 3] > 0.5
    assert covered.any() and not covered.all()
    brightness = after[covered][:, :3].mean() / before[covered][:, :3].mean()
    assert brightness == pytest.approx(coefficients[last][0].mean() / coefficients[first][0].mean(), rel=0.3)
    assert brightness < 0.7
