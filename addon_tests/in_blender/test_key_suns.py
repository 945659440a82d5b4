"""The key light in Blender: a sun beside the world, nothing lit twice, nothing of it left in the file."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from addon_runs import lit_walk, registered_addon
from effect_scenes import shader_look
from previs_runs import DRAFT, PlainPrevis
from renders import pixels_of_file, rendered_picture, rendered_sphere
from shown_lights import keyed
from tiny_scenes import add_instance, black_smoke, box, empty_scene, material, opened, orthographic, phone, sphere

from xihe_blender.apply.datablocks import KEY_LIGHT, SHADOW_CATCHER, applied_worlds
from xihe_blender.apply.key_suns import (
    applied_suns,
    apply_key_to_sun,
    key_sun_changes,
    key_suns,
    make_key_sun,
    remove_key_sun,
    sun_name,
)
from xihe_blender.apply.keys import f_curves
from xihe_blender.apply.lit_timeline import key_object_light
from xihe_blender.apply.reflection_pictures import PICTURE, is_shiny, required_light
from xihe_blender.apply.sh_worlds import apply_sh_to_world, make_sh_world
from xihe_blender.apply.shadow_catchers import catcher_name, shadow_catchers
from xihe_blender.capture.render import RenderSettings, render_passes
from xihe_blender.compare.methods import REFLECTION_SAMPLES, open_comparer
from xihe_blender.io.exr import read_radiance
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_lights import last_surfaces, light_of_change
from xihe_blender.io.run_results import read_results
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.kept_session import open_kept_session
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import prepare_run, survey_run
from xihe_blender.previs.results_notes import light_notes
from xihe_blender.previs.run_chain import run_chain
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.scene.sphere_rig import add_three_sphere_rig
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet import sh
from xihenet.camera import Intrinsics
from xihenet.light.key_light import rest_of, sh_of_key_light, sure_part
from xihenet.light.reflections import N_DIRECTIONS
from xihenet.panorama import solid_angles
from xihenet.phone import session
from xihenet.records import KeyLight, ObjectLight, Reflections, RgbdFrame
from xihenet.sphere import AnchorLattice

SIDE = 48
FLAT = np.sqrt(4 * np.pi) * 0.1 * np.eye(9)[0][:, None] * np.ones(3)


def key_light(direction, irradiance=(3.0, 2.0, 1.0), radius=0.1):
    direction = np.asarray(direction, float)
    return KeyLight(direction / np.linalg.norm(direction), np.array(irradiance), radius, True)


@pytest.mark.parametrize("radius", [0.005, 0.2, 0.6])
@pytest.mark.parametrize("direction", [(0.3, -0.8, 0.6), (0, 0, 1), (0, -1, 0)])
def test_a_white_sphere_is_as_bright_as_key_light_and_rest_make_it(direction, radius):
    """Seen from -Y. Where the whole disc is above the horizon, its irradiance is that of a point in its middle."""
    key, exposure = key_light(direction, radius=radius), 4.0
    light = ObjectLight(FLAT + sh_of_key_light(key), key)
    scene = empty_scene()
    sphere(scene, "White", (0, 0, 0), 1.0, material("White", (1.0, 1.0, 1.0)))
    scene.world = make_sh_world("Xihe White")
    apply_sh_to_world(scene.world, rest_of(light), exposure)
    sun = make_key_sun("Xihe Key Light White")
    scene.collection.objects.link(sun)
    apply_key_to_sun(sun, key, exposure)
    shown, normals = rendered_sphere(scene, 64)
    cosine = normals @ key.direction
    is_whole = cosine > np.sin(radius) + 0.05
    expected = (sh.irradiance(rest_of(light), normals) + np.clip(cosine, 0, 1)[:, None] * key.irradiance) / np.pi
    assert shown[is_whole].mean(axis=0) == pytest.approx(expected[is_whole].mean(axis=0) / exposure, rel=0.03)
    is_below = cosine < -np.sin(radius) - 0.05
    if is_below.any():
        below = expected[is_below].mean(axis=0) / exposure
        assert shown[is_below].mean(axis=0) == pytest.approx(below, rel=0.03, abs=0.002)


def test_a_sun_is_keyed_and_shines_only_where_there_is_a_key_light():
    scene, key = empty_scene(), key_light((1, 0, 0))
    sun = make_key_sun("Xihe Key Light A")
    scene.collection.objects.link(sun)
    key_sun_changes(sun, {1: None, 5: key, 9: None, 11: key, 14: key_light((0, 0, 1))}, 2.0)
    energies = []
    for frame in (1, 4, 5, 8, 9):
        scene.frame_set(frame)
        energies.append(sun.data.energy)
    assert energies == pytest.approx([0, 0, 1.5, 1.5, 0])
    for frame, direction in ((14, (0, 0, 1)), (13, key.direction), (6, key.direction)):
        scene.frame_set(frame)
        assert np.array(sun.matrix_world.col[2][:3]) == pytest.approx(direction, abs=1e-6)
    assert tuple(sun.data.color) == pytest.approx((1, 2 / 3, 1 / 3)) and sun.data.angle == pytest.approx(0.2)
    before = [a.name for a in bpy.data.actions]
    assert before and make_key_sun("Xihe Key Light A").data.energy == 0 and len(key_suns()) == 1
    remove_key_sun(key_suns()[0])
    assert not key_suns() and not bpy.data.actions and not bpy.data.lights


def test_a_sun_shines_on_its_own_object_alone_and_is_gone_after_the_comparison():
    scene = empty_scene()
    virtual = virtual_collection(scene, create=True)
    objects = [sphere(scene, n, (x, 0, 0), 0.4, material(n, (1, 1, 1)), virtual) for n, x in (("A", -0.5), ("B", 0.5))]
    orthographic(scene)
    settings = RenderSettings((32, 32), 16, denoise=False)
    with open_comparer(scene, objects, ["one", "two"], settings, has_key_light=True) as comparer:
        for key, world in comparer.worlds.items():
            apply_sh_to_world(world, FLAT)
            apply_key_to_sun(comparer.suns[key], key_light((0, -1, 0)) if key == ("one", "A") else None)
        layers = render_passes(comparer.lit).layers
    shown = {key: layers[layer]["Combined.R"].max() for key, layer in comparer.layers.items()}
    assert shown.pop(("one", "A")) > 0.8
    assert max(shown.values()) == pytest.approx(0.1, rel=0.1)
    assert not key_suns() and not bpy.data.lights
    assert not [c for c in bpy.data.collections if c.name.startswith("Xihe Lit")]


@pytest.mark.parametrize("is_instance", [False, True])
def test_smoke_beside_other_objects_covers_what_its_density_says(is_instance):
    scene = empty_scene()
    virtual = virtual_collection(scene, create=True)
    asset = bpy.data.collections.new("Asset")
    box(scene, "Smoke", (0, 0, 0), (0.5, 0.5, 0.5), black_smoke(2.0), asset if is_instance else virtual)
    if is_instance:
        add_instance(scene, asset, virtual)
    for name, x in (("A", -0.7), ("Z", 0.7)):
        sphere(scene, name, (x, 0, 0), 0.2, material(name), virtual)
    orthographic(scene)
    with open_comparer(scene, virtual_objects(scene), ["one"], RenderSettings((9, 9), 64, denoise=False)) as comparer:
        layers = render_passes(comparer.lit).layers
        over_all_others = comparer.lit.view_layers[-1].name
    assert over_all_others == comparer.layers["one", "Instance" if is_instance else "Smoke"]
    covered = sum(layers[layer]["Combined.A"][4, 4] for layer in comparer.layers.values())
    assert covered == pytest.approx(1 - np.exp(-2.0 * 0.5), abs=0.01)


def test_what_reflects_a_picture_takes_its_samples_and_all_else_those_of_the_preset():
    """So a preset with fewer gives metal the same picture to the last bit, and a soft light another one; also in a
    scene whose view layers must not choose their samples."""
    scene = empty_scene()
    scene.cycles.use_layer_samples = "IGNORE"
    virtual = virtual_collection(scene, create=True)
    silver = shader_look("Silver", "BsdfPrincipled", Metallic=1.0, Roughness=0.35)
    ball = sphere(scene, "Ball", (0, 0, 0), 0.8, silver, virtual)
    orthographic(scene)
    towards = AnchorLattice(N_DIRECTIONS).directions @ [0.0, -0.6, 0.8]
    picture = Reflections(np.where(towards > np.cos(0.1), 30.0, 0.1)[:, None].astype(np.float32).repeat(3, 1), 1.0)
    lights = {"picture": {"Ball": ObjectLight(FLAT, reflections=picture)}, "soft": {"Ball": ObjectLight(FLAT)}}
    grey, camera = np.zeros((SIDE, SIDE, 3), np.uint8), Intrinsics(SIDE, SIDE, 32.0, 32.0, SIDE / 2, SIDE / 2)
    captured = RgbdFrame(grey, np.full((SIDE, SIDE), 10.0, np.float32), camera, np.eye(4), frame=1)
    pictures = []
    for samples in (2, REFLECTION_SAMPLES):
        with open_comparer(
            scene, [ball], list(lights), RenderSettings((SIDE, SIDE), samples, denoise=False)
        ) as comparer:
            layers = comparer.render_layers(captured, lights).layers
            pictures.append({method: layers[comparer.layers[method, "Ball"]]["Combined.R"] for method in lights})
    few, many = pictures
    assert many["picture"].max() > 0.5 and (few["picture"] == many["picture"]).all()
    assert (few["soft"] != many["soft"]).any()


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    with registered_addon():
        settings = PlainPrevis(**DRAFT, light="sh+key+reflections")
        yield lit_walk(tmp_path_factory.mktemp("key") / "out", settings)


def test_a_run_says_its_key_lights_and_the_file_has_them(ran):
    """The ball is rough: what its sun has is the sure part."""
    opened(ran / "after.blend")
    results = read_results(ran)
    assert results.settings.light == "sh+key+reflections"
    keys = {name: [change.key for change in changes] for name, changes in results.lights.items()}
    assert any(key is not None for of_one in keys.values() for key in of_one)
    worlds, suns = applied_worlds(bpy.context.scene), applied_suns(bpy.context.scene)
    for name, changes in results.lights.items():
        for change in changes:
            light = light_of_change(change)
            if change.reflections is not None:
                light = replace(light, key=light.key and sure_part(light.key))
            assert keyed(worlds[name])[0][change.frame] == pytest.approx(rest_of(light), abs=1e-5)
            energy = 0 if light.key is None else light.key.irradiance.max() / results.settings.reference_exposure
            # No scene holds the suns yet that could play their keys.
            strength = next(curve for curve in f_curves(suns[name].data) if curve.data_path == "energy")
            assert strength.evaluate(change.frame) == pytest.approx(energy, rel=1e-5)


class SmallProbes(PrevisSettings):
    """Light probes of a quarter of the pixels, in which a lamp still is where it is."""

    @property
    def reference(self):
        return replace(super().reference, size=96)


@pytest.mark.slow
@pytest.mark.parametrize("light", ["sh+key", "sh+key+reflections"])
def test_key_light_of_truth_points_at_the_lamp_that_nobody_looked_at(tmp_path, light):
    scene, at = empty_scene(), np.array([0.8, 0.5, 2.3])
    box(scene, "Room", (0, 0, 1.25), (4, 4, 2.5), material("Walls", (0.6, 0.5, 0.4)), inward=True)
    box(scene, "Lamp", at, (0.2, 0.2, 0.05), material("Lamp", (1, 1, 1), 60.0))
    box(scene, "Dim", (-1.5, -1.5, 1.0), (0.6, 0.6, 0.6), material("Dim", (1, 1, 1), 2.0))
    ball = sphere(scene, "Ball", (0, 0, 1), 0.1, material("Ball", (1, 1, 1)), virtual_collection(scene, create=True))
    phone(scene, (-0.5, -1.5, 1.2), (0, 0, 1.0))
    settings = SmallProbes(frames=(1,), size=(32, 24), samples=4, preset="draft", light=light)
    outputs, plan = RunOutputs(tmp_path, "room"), plan_previs(scene, settings)
    survey = run_blocking(survey_run(scene, plan, outputs))
    run = run_blocking(prepare_run(scene, plan, survey, outputs, settings, load_estimators(settings)))
    key = run_blocking(run_chain(run)).lights[1]["truth"]["Ball"].key
    towards = (at - np.array(ball.location)) / np.linalg.norm(at - np.array(ball.location))
    assert key.is_seen and key.direction @ towards > np.cos(np.radians(4))


def test_a_run_keeps_what_is_reflected_and_the_file_shows_it_from_frame_to_frame(ran):
    """The picture's light is about the estimate's; the ball is rough, so it reflects the sun and not its lamp."""
    scene, results = opened(ran / "after.blend"), read_results(ran)
    for name, changes in results.lights.items():
        files = [ran / change.reflections.picture for change in changes]
        assert len(set(files)) > 1 and any(change.reflections.seen_share > 0.1 for change in changes)
        picture = read_radiance(files[-1])
        assert picture.shape == (128, 256, 3) and np.isfinite(picture).all() and picture.min() >= 0
        mean = (picture * solid_angles(128, 256)[..., None]).sum(axis=(0, 1)) / (4 * np.pi)
        of_light = np.array(changes[-1].sh[0]) / np.sqrt(4 * np.pi) / results.settings.reference_exposure
        assert 0.3 < mean.sum() / of_light.sum() < 3
        world, sun = applied_worlds(scene)[name], applied_suns(scene)[name]
        assert PICTURE in world.node_tree.nodes and sun.visible_glossy and sun.visible_transmission
        assert not any(change.reflections.has_lamp for change in changes)
        curve = next(curve for curve in f_curves(world.node_tree) if curve.data_path.endswith("frame_offset"))
        shown = [int(path.stem[-4:]) - 1 for path in files]
        assert [curve.evaluate(change.frame) for change in changes] == shown


def test_a_run_says_what_its_objects_call_for(ran):
    """The ball of the walk is matt; of the three spheres two are shiny."""
    said = " ".join(read_results(ran).notes)
    assert "Glossy parts reflect" in said and "No virtual object is shiny" in said
    rig = add_three_sphere_rig(empty_scene(), (0, 0, 0))
    assert [is_shiny(item) for item in rig] == [True, True, False]
    assert (required_light(rig), required_light(rig[2:])) == ("sh+key+reflections", "sh+key")
    said = " ".join(light_notes(PrevisSettings(light="sh"), rig))
    assert "Mirror Sphere, Xihe Matte Silver Sphere. With reflections (--light sh+key+reflections, or " in said
    assert "In a ground truth of 32 samples, lamps that shiny objects mirror are noise" in said
    for settings, objects in (
        (PrevisSettings(light="sh"), rig[2:]),
        (PrevisSettings(light="sh", preset="accurate"), rig),
    ):
        assert "are noise" not in " ".join(light_notes(settings, objects))


def test_the_kept_session_finds_the_same_key_lights(ran):
    session = run_blocking(open_kept_session(ran))
    results = read_results(ran)
    places = {p.name: np.array(p.position_m) for entry in results.frames for p in entry.probes if p.object == "Ball"}
    found = run_blocking(session.find_light(places))["Ball"].lights
    for change in results.lights["Ball"]:
        light, key = light_of_change(change), found[change.frame].key
        assert (key is None) == (light.key is None)
        if key is not None:
            assert key.direction == pytest.approx(light.key.direction) and key.irradiance == pytest.approx(
                light.key.irradiance
            )


def test_show_lit_has_the_suns_and_remove_light_takes_them_away(ran):
    scene = opened(ran / "after.blend")
    suns = applied_suns(scene)
    assert suns and bpy.ops.xihe.show_lit() == {"FINISHED"}
    lit = bpy.data.scenes["Xihe Lit"]
    for name, sun in suns.items():
        layers = [layer.name for layer in lit.view_layers if sun.name in layer.objects]
        assert layers == [applied_worlds(scene)[name].name]
    caught = {name for name, found in last_surfaces(read_results(ran).frames).items() if found}
    assert caught
    for name in caught:
        (catcher,) = [item for item in shadow_catchers(lit) if item.name == catcher_name(name)]
        layers = [layer.name for layer in lit.view_layers if catcher.name in layer.objects]
        assert catcher.is_shadow_catcher and layers == [applied_worlds(scene)[name].name]
    assert bpy.ops.xihe.remove_light() == {"FINISHED"}
    assert not [item for item in bpy.data.objects if KEY_LIGHT in item or SHADOW_CATCHER in item]
    kinds = "objects", "meshes", "materials", "lights", "worlds", "collections", "actions", "images"
    left = [block.name for kind in kinds for block in getattr(bpy.data, kind) if block.name.startswith("Xihe")]
    assert left == ["Xihe Virtual"]


def test_the_lit_scene_shows_the_shadows_of_the_comparison(ran, tmp_path):
    results = read_results(ran)
    frame, compared = max(results.compared_frames.items())
    pictures = (ran / compared.pictures[kind] for kind in (results.settings.estimator, "captured"))
    estimate, captured = (pixels_of_file(picture)[..., :3] for picture in pictures)
    opened(ran / "after.blend")
    assert bpy.ops.xihe.show_lit() == {"FINISHED"}
    lit = bpy.data.scenes["Xihe Lit"]
    lit.render.resolution_x, lit.render.resolution_y = results.settings.size
    lit.cycles.samples = 64
    lit.frame_set(frame)
    shown = rendered_picture(lit, tmp_path)[..., :3]
    change = (estimate - captured).mean(axis=-1)
    is_shadow = (change < -0.02) & (change > -0.3)
    assert is_shadow.sum() > 5
    of_lit = (shown - captured).mean(axis=-1)[is_shadow].mean()
    assert of_lit == pytest.approx(change[is_shadow].mean(), rel=0.3)


def test_the_sun_of_an_object_that_is_moved_stays_in_the_lit_scene_and_follows(ran):
    scene = opened(ran / "after.blend")
    sun = applied_suns(scene)["Ball"]
    assert bpy.ops.xihe.show_lit() == {"FINISHED"}
    before = [point.co[1] for curve in f_curves(sun.data) for point in curve.keyframe_points]
    bpy.data.objects["Ball"].location = (0.7, -0.5, 0.6)
    bpy.context.view_layer.update()
    assert bpy.ops.xihe.update_light() == {"FINISHED"}
    assert applied_suns(scene)["Ball"] == sun
    assert [layer.name for layer in bpy.data.scenes["Xihe Lit"].view_layers if sun.name in layer.objects]
    assert [point.co[1] for curve in f_curves(sun.data) for point in curve.keyframe_points] != before


def test_another_run_without_key_lights_takes_them_away(ran):
    scene = opened(ran / "after.blend")
    assert sun_name("Ball") in [sun[KEY_LIGHT] for sun in key_suns()]
    key_object_light(applied_worlds(scene)["Ball"], "Ball", {1: ObjectLight(FLAT)}, 1.0, has_key_light=False)
    assert sun_name("Ball") not in [sun[KEY_LIGHT] for sun in key_suns()]


@pytest.mark.slow
def test_reflections_of_an_object_with_several_positions_are_filled_once_for_each_estimate(tmp_path, monkeypatch):
    """For each of 60 positions, and for the object anew in each frame, they took 0.25 s and 100 kB a frame."""
    scene = empty_scene()
    box(scene, "Room", (0, 0, 1.25), (6, 4, 2.5), material("Walls", (0.6, 0.5, 0.4)), inward=True)
    box(scene, "Lamp", (0.8, 0.5, 2.3), (0.2, 0.2, 0.05), material("Lamp", (1, 1, 1), 60.0))
    shelf = box(scene, "Shelf", (0, 1, 1), (2.5, 0.2, 0.2), collection=virtual_collection(scene, create=True))
    phone(scene, (-0.5, -1.5, 1.2), (0, 1, 1.0))
    scene.frame_end = 3
    settings = SmallProbes(size=(32, 24), samples=2, exposure=1.0, preset="draft", light="sh+key+reflections")
    outputs, plan = RunOutputs(tmp_path, "room"), plan_previs(scene, settings)
    assert len(plan.probes_of(shelf.name)) == 3
    survey = run_blocking(survey_run(scene, plan, outputs))
    run = run_blocking(prepare_run(scene, plan, survey, outputs, settings, load_estimators(settings)))
    filled, fill = [], session.fill_reflections
    monkeypatch.setattr(session, "fill_reflections", lambda *given: filled.append(1) or fill(*given))
    chain = run_blocking(run_chain(run))
    assert [sum(probe.fired for probe in entry.probes) for entry in chain.frames] == [3, 0, 0]
    assert len(filled) == 1
    lights = [chain.lights[frame][settings.estimator][shelf.name] for frame in plan.frames]
    assert len({id(light.reflections.radiance) for light in lights}) == 1
    assert all(at.reflections is light.reflections for light in lights for _, at in light.at)
