"""A run from the panel: the numbers of the command line, its results in the open file, and gone again."""

import contextlib
import shutil
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from addon_runs import enable_preferences, poll_message, registered_addon, small_panel_runs, walk_for_the_panel
from previs_runs import SMALL, handler_in, look_away, run
from renders import pixels, pixels_of_file, rendered
from results_schema import read_strictly, without_times
from scene_snapshot import data_blocks, differences, nothing_changes, snapshot
from shown_lights import keyed
from tiny_scenes import empty_scene, node_of, phone, set_world

from addon_tests.pure import runs
from xihe_blender.addon import results_in_blender
from xihe_blender.addon.background_run import newest_run, saved_for_run
from xihe_blender.addon.comparison_view import follow_playhead
from xihe_blender.addon.properties import last_run_folder
from xihe_blender.addon.results_in_blender import (
    COVERAGE_CURVE,
    ERROR_CURVE,
    apply_results,
    go_to_trigger,
    left_out,
    light_in_use,
    remove_everything,
    show_comparison,
    show_light,
    show_lit,
)
from xihe_blender.addon.run_operators import XIHE_OT_run
from xihe_blender.addon.run_settings import run_and_show
from xihe_blender.addon.runs_folder import found_folder, last_run, shown_runs
from xihe_blender.apply.datablocks import COMPARISON_NAME, image_named
from xihe_blender.apply.keys import f_curves
from xihe_blender.io.json_records import as_json
from xihe_blender.io.outputs import write_json
from xihe_blender.io.run_lights import light_of_change
from xihe_blender.io.run_results import read_results
from xihe_blender.jobs import run_blocking
from xihenet.light.key_light import rest_of
from xihenet.panorama import evaluate_panorama


@pytest.fixture(autouse=True, scope="module")
def addon():
    with registered_addon(), small_panel_runs():
        yield


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A run from the panel, its file saved at its end: the folder of both, and the scene before and after."""
    folder = tmp_path_factory.mktemp("panel")
    scene = walk_for_the_panel(folder / "runs")
    bpy.context.view_layer.update()
    before = snapshot()
    bpy.context.window_manager.xihe.newest_run = str(folder / "earlier")
    assert bpy.ops.xihe.run() == {"FINISHED"}
    assert bpy.context.window_manager.xihe.unshown_run == "", "the run of this process is newer"
    after = snapshot()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shown.blend"))
    return folder, Path(scene.xihe.run_folder), before, after


@pytest.fixture
def shown(done):
    """The folder of the run, whose saved file is open."""
    bpy.ops.wm.open_mainfile(filepath=str(done[0] / "shown.blend"), load_ui=False)
    enable_preferences().cache_folder = str(done[0] / "runs")
    return done[1]


def colours(name):
    """(H, W, 3) of an image of ours."""
    return pixels(image_named(name))[..., :3]


# ----------------------------------------------------------------------------------------------------------- the run


@pytest.mark.slow
def test_the_panels_run_has_the_numbers_of_the_function_and_leaves_the_scene_as_it_was(done, tmp_path):
    with_window = read_strictly(done[1] / "results.json")
    # What the panel has no setting for is the preset's.
    by_function = run(walk_for_the_panel(tmp_path), tmp_path / "out", replace(SMALL, noise_target=None))
    assert without_times(with_window) == without_times(by_function)
    changed, new = differences(done[2], done[3])
    assert set(changed) == {"scenes/Scene/xihe/run_folder"} and new == []


def test_a_run_that_is_stopped_leaves_no_folder_and_the_scene_as_it_was(tmp_path):
    scene, folder = walk_for_the_panel(tmp_path), tmp_path / "run"
    folder.mkdir()
    with nothing_changes(), contextlib.closing(run_and_show(scene, folder, SMALL)) as job:
        assert all(progress.done < progress.total for _, progress in zip(range(9), job, strict=False))
        assert folder.exists()
    assert not folder.exists()


def test_a_run_that_is_stopped_before_its_file_is_saved_leaves_no_folder(tmp_path):
    scene = walk_for_the_panel(tmp_path)
    with contextlib.closing(XIHE_OT_run._job(None, scene, in_background=True)) as job:
        assert any(progress.doing == "saving a copy of the file" for progress in job)
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_fails_leaves_no_folder_and_one_line(tmp_path):
    walk_for_the_panel(tmp_path).camera.data.type = "ORTHO"
    with pytest.raises(RuntimeError, match="a phone's camera must be perspective"):
        bpy.ops.xihe.run()
    state = bpy.context.window_manager.xihe
    assert "perspective" in state.error and "\n" not in state.error
    assert not state.is_running and state.progress == 0 and state.doing == ""
    assert list(tmp_path.iterdir()) == []


def test_an_object_that_is_deleted_meanwhile_ends_the_run_with_one_line(tmp_path):
    walk_for_the_panel(tmp_path)

    def delete(scene, *_):
        if scene.name == "Xihe Reference Probe" and "Ball" in bpy.data.objects:
            bpy.data.objects.remove(bpy.data.objects["Ball"])

    deleted = pytest.raises(RuntimeError, match="was deleted meanwhile: try again")
    with handler_in(bpy.app.handlers.render_post, delete), deleted:
        bpy.ops.xihe.run()
    assert [scene.name for scene in bpy.data.scenes] == ["Scene"] and list(tmp_path.iterdir()) == []
    assert not bpy.context.window_manager.xihe.is_running


# ------------------------------------------------------------------------------------------- lost, and found again


LATER = "room_20260102-120000"


@pytest.fixture
def project(done, tmp_path):
    """A folder with a file and two runs of it in the background, which have ended; no scene shows either yet."""
    scene, folder = walk_for_the_panel(""), tmp_path / "project"
    folder.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "room.blend"))
    for name, started in (("room_20260101-120000", 1.0), (LATER, 2.0)):
        shutil.copytree(done[1], folder / "xihe_runs" / name)
        run = saved_for_run(scene, folder / "xihe_runs" / name, {})
        # As earlier versions said of a run that the file had shown once.
        write_json(run.outputs.request, as_json(replace(run.request, started=started)) | {"is_shown": True})
    return folder


def opened_project(folder):
    bpy.ops.wm.open_mainfile(filepath=str(folder / "room.blend"), load_ui=False)
    return bpy.context.window_manager.xihe


def test_a_run_that_was_lost_with_the_open_file_is_offered_until_a_scene_shows_it(project):
    job, later = opened_project(project), project / "xihe_runs" / LATER
    assert job.unshown_run == str(later) and poll_message(bpy.ops.xihe.resume_run) == ""
    bpy.ops.ed.undo_push(message="Start")
    assert bpy.ops.xihe.resume_run("EXEC_DEFAULT", True) == {"FINISHED"}
    assert bpy.context.scene.xihe.run_folder == str(later) and job.unshown_run == ""
    assert bpy.context.scene.xihe.run_made_of.endswith("on 1970-01-01"), "edits before it was taken up are not known"
    bpy.ops.ed.undo()
    assert bpy.context.scene.xihe.run_folder == "" and job.unshown_run == str(later)
    bpy.ops.ed.redo()
    assert bpy.context.scene.xihe.run_folder == str(later) and job.unshown_run == ""
    bpy.ops.xihe.remove_light()
    bpy.data.scenes.new("Other")
    bpy.ops.wm.save_mainfile()
    assert opened_project(project).unshown_run == ""
    bpy.context.scene.xihe.run_folder = str(later.with_name("room_20260101-120000"))
    assert bpy.context.window_manager.xihe.unshown_run == str(later)


def test_a_lost_run_can_be_discarded(project):
    job = opened_project(project)
    assert bpy.ops.xihe.discard_run() == {"FINISHED"}
    assert job.unshown_run == "" and not (project / "xihe_runs" / LATER).exists()
    assert (project / "xihe_runs").exists(), "another run is in it"
    saved_for_run(bpy.context.scene, project / "xihe_runs" / "room_20260101-120000", {}).discard()
    assert not (project / "xihe_runs").exists()


def test_a_lost_run_is_offered_where_its_file_was_moved_together_with_it(project, tmp_path):
    (project / "other.blend").write_bytes((project / "room.blend").read_bytes())
    moved = project.rename(tmp_path / "moved")
    assert opened_project(moved).unshown_run == str(moved / "xihe_runs" / LATER)
    bpy.ops.wm.open_mainfile(filepath=str(moved / "other.blend"), load_ui=False)
    assert bpy.context.window_manager.xihe.unshown_run == ""


def test_a_run_is_offered_in_a_file_that_was_first_saved_while_it_was_under_way(project, tmp_path):
    opened_project(project)
    bpy.context.scene.xihe.begun_run = str(project / "xihe_runs" / LATER)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(elsewhere / "room.blend"))
    assert opened_project(elsewhere).unshown_run == str(project / "xihe_runs" / LATER)
    assert bpy.ops.xihe.resume_run() == {"FINISHED"}
    bpy.ops.wm.save_mainfile()
    assert opened_project(elsewhere).unshown_run == ""


def test_a_run_is_found_where_its_file_was_moved_together_with_it(project, tmp_path):
    later = project / "xihe_runs" / LATER
    opened_project(project)
    bpy.ops.xihe.resume_run()
    bpy.context.scene.xihe.budget_folder = str(later)
    bpy.ops.wm.save_mainfile()
    moved = project.rename(tmp_path / "moved")
    job, found = opened_project(moved), moved / "xihe_runs" / LATER
    scene = bpy.context.scene
    assert scene.xihe.run_folder == str(later), "the file has not been changed by being opened"
    assert last_run_folder(scene) == found_folder(str(later)) == found and shown_runs() == {found}
    assert last_run(scene.xihe.run_folder) is not None and job.unshown_run == ""
    assert bpy.ops.xihe.apply_light() == {"FINISHED"}
    assert found_folder(rf"C:\films\xihe_runs\{LATER}") == found
    enable_preferences().cache_folder = str(tmp_path / "kept")
    assert found_folder(str(later)) == found, "beside the file, wherever new runs go"
    assert newest_run(bpy.data.filepath) == found
    gone = tmp_path / "gone" / "room_20250101-120000"
    assert found_folder(str(gone)) == gone and last_run("") is None


# -------------------------------------------------------------------------------------------------------------- light


def light_on_the_timeline():
    return {world.name: keyed(world)[0] for world in bpy.data.worlds if world.name.startswith("Xihe ")}


def test_the_light_of_the_results_is_the_one_that_the_run_put_on_the_timeline(shown):
    results = read_results(shown)
    for name in ("Ball", "Board"):
        coefficients, interpolations = keyed(bpy.data.worlds[f"Xihe {name}"])
        assert interpolations == {"CONSTANT"} and len(coefficients) > 1
        for frame in results.settings.frames:
            on_timeline = coefficients[max(known for known in coefficients if known <= frame)]
            change = max((one for one in results.lights[name] if one.frame <= frame), key=lambda one: one.frame)
            np.testing.assert_array_equal(light_in_use(results, name, frame), change.sh)
            np.testing.assert_allclose(rest_of(light_of_change(change)), on_timeline, rtol=1e-6, atol=1e-6)


def test_removing_leaves_the_file_as_before_the_run_and_applying_again_gives_what_it_left(done, shown):
    def left():
        light = {name: {f: c.tolist() for f, c in frames.items()} for name, frames in light_on_the_timeline().items()}
        return light, sorted((m.frame, m.name) for m in bpy.context.scene.timeline_markers), data_blocks(snapshot())

    bpy.context.view_layer.update()
    before = left()
    bpy.ops.xihe.remove_light()
    bpy.context.view_layer.update()
    assert data_blocks(snapshot()) == data_blocks(done[2]) and not bpy.context.scene.timeline_markers
    for _ in range(2):
        assert bpy.ops.xihe.apply_light() == {"FINISHED"}
        assert left() == before


def test_the_light_can_be_applied_to_another_file_with_the_same_objects(shown, tmp_path):
    light = light_on_the_timeline()
    scene = walk_for_the_panel(tmp_path)
    apply_results(scene, shown)
    again = light_on_the_timeline()
    assert {name: list(by_frame) for name, by_frame in again.items()} == {n: list(f) for n, f in light.items()}


def test_an_object_that_is_gone_takes_no_light_from_the_others(shown):
    scene, whole = bpy.context.scene, {name: list(of_one) for name, of_one in light_on_the_timeline().items()}
    assert left_out(scene, shown) is None
    bpy.data.objects["Ball"].name = "Renamed"
    remove_everything()
    bpy.ops.xihe.apply_light()
    light = {name: list(of_one) for name, of_one in light_on_the_timeline().items()}
    assert light == {"Xihe Board": whole["Xihe Board"]}
    missing = "'Ball' of the last run is not in this scene any more: run again, or give it back its name"
    assert left_out(scene, shown) == missing
    assert [layer.name for layer in show_lit(scene, shown).view_layers] == ["Xihe Board"]
    bpy.data.objects["Renamed"].name = "Ball"
    bpy.ops.xihe.apply_light()
    assert {name: list(of_one) for name, of_one in light_on_the_timeline().items()} == whole


def test_light_of_objects_that_are_all_gone_is_refused(shown):
    bpy.data.objects.remove(bpy.data.objects["Board"])
    bpy.data.objects.remove(bpy.data.objects["Ball"])
    with pytest.raises(RuntimeError, match="'Ball', 'Board' of the last run are not in this scene any more: run again"):
        bpy.ops.xihe.apply_light()


def test_removing_leaves_what_a_user_named_like_ours(shown):
    bpy.data.images.new("Xihe Light of mine", 4, 4)
    bpy.data.worlds.new("Xihe world of mine")
    bpy.context.scene.timeline_markers.new("Mine", frame=3)
    other = bpy.data.scenes.new("Other")
    other.timeline_markers.new("Xihe trigger (first)", frame=1)
    remove_everything()
    assert not other.timeline_markers
    assert [image.name for image in bpy.data.images if image.name.startswith("Xihe")] == ["Xihe Light of mine"]
    assert [world.name for world in bpy.data.worlds if world.name.startswith("Xihe")] == ["Xihe world of mine"]
    assert [marker.name for marker in bpy.context.scene.timeline_markers] == ["Mine"]


# ------------------------------------------------------------------------------------------------------------- curves


def test_error_and_coverage_are_curves_of_the_worlds(shown):
    results = read_results(shown)
    for name in ("Ball", "Board"):
        curves = {curve.data_path: curve for curve in f_curves(bpy.data.worlds[f"Xihe {name}"])}
        assert curves.keys() == {f'["{ERROR_CURVE}"]', f'["{COVERAGE_CURVE}"]'}
        for curve, key in ((ERROR_CURVE, "shc_rmse"), (COVERAGE_CURVE, "coverage")):
            points = curves[f'["{curve}"]'].keyframe_points
            expected = {
                entry.frame: np.mean([getattr(probe, key) for probe in entry.probes if probe.object == name])
                for entry in results.frames
                if any(probe.object == name for probe in entry.probes)
            }
            assert {round(p.co[0]): p.co[1] for p in points} == pytest.approx(expected, rel=1e-6)
            assert {point.interpolation for point in points} == {"CONSTANT"}


# ------------------------------------------------------------------------------------------------------------- images


def test_a_saved_file_keeps_its_images_without_the_run(shown):
    expected = {name: colours(name) for name in (COMPARISON_NAME, "Xihe Light Ball", "Xihe Light Board")}
    assert all(image_named(name).packed_file is not None for name in expected)
    results = read_results(shown)
    panorama = evaluate_panorama(light_in_use(results, "Ball", 1), 64, 128) / results.settings.reference_exposure
    np.testing.assert_allclose(np.sort(expected["Xihe Light Ball"], axis=None), np.sort(panorama, axis=None), rtol=1e-4)
    assert np.ptp(expected[COMPARISON_NAME]) > 0.3


def test_the_comparison_is_the_estimate_up_to_the_wipe_and_the_truth_behind(shown):
    results = read_results(shown)
    nearest = results.nearest_compared_frame(2)
    files = (shown / "pictures" / f"{kind}_{nearest:04d}.png" for kind in ("lattice", "ground_truth"))
    estimate, truth = (pixels_of_file(file)[..., :3] for file in files)
    assert np.abs(estimate - truth).max() > 0.05
    for wipe, column in ((0.0, 0), (0.25, 8), (0.5, 16), (1.0, 32)):
        picture = pixels(show_comparison(shown, 2, wipe))[..., :3]
        np.testing.assert_allclose(picture[:, :column], estimate[:, :column], atol=1e-6)
        behind = column + (0 < column < 32)
        np.testing.assert_allclose(picture[:, behind:], truth[:, behind:], atol=1e-6)
        assert (picture[:, column:behind] == 1).all()


def test_moving_the_wipe_composes_the_image_anew(shown):
    scene = bpy.context.scene
    scene.xihe.wipe = 0.0
    truth = colours(COMPARISON_NAME)
    scene.xihe.wipe = 1.0
    assert np.abs(truth - colours(COMPARISON_NAME)).max() > 0.05
    remove_everything()
    scene.xihe.wipe = 0.3
    assert image_named(COMPARISON_NAME) is None, "a slider makes nothing that was removed"


def test_the_comparison_follows_the_playhead(shown):
    results, scene = read_results(shown), bpy.context.scene
    frames = list(results.compared_frames)
    for frame in (frames[-1], frames[0]):
        scene.frame_set(frame)
        follow_playhead()
        image = image_named(COMPARISON_NAME)
        assert image["xihe_frame"] == frame
        expected = pixels_of_file(shown / "pictures" / f"ground_truth_{frame:04d}.png")[:, -1, :3]
        np.testing.assert_allclose(pixels(image)[:, -1, :3], expected, atol=1e-6)
    remove_everything()
    follow_playhead()
    assert image_named(COMPARISON_NAME) is None, "a playhead makes nothing that was removed"


@pytest.mark.slow
def test_the_image_of_a_light_is_the_environment_it_stands_for():
    """The image in an Environment Texture lights what a camera sees as the coefficients say, in every direction."""
    scene = empty_scene()
    sh = np.random.default_rng(3).normal(size=(9, 3)) * 0.1
    sh[0] += 2
    image = show_light("Ball", sh)
    world = set_world(scene)
    # No surface is lit, and an importance map costs seconds.
    world.cycles.sampling_method = "NONE"
    texture = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    world.node_tree.links.new(texture.outputs[0], node_of(world, "BACKGROUND").inputs["Color"])
    data = phone(scene, (0, 0, 0), (0, 1, 0)).data
    data.type = "PANO"
    (data if hasattr(data, "panorama_type") else data.cycles).panorama_type = "EQUIRECTANGULAR"
    expected = evaluate_panorama(sh, 32, 64)
    error = np.abs(rendered(scene, (64, 32), 4) - expected) / np.ptp(expected)
    assert np.median(error) < 0.005
    # Cycles' interpolation ends at the picture's edge, so that a seam of one texel is left.
    assert error.max() < 0.1


# ----------------------------------------------------------------------------------------------------------- timeline


def test_going_from_trigger_to_trigger_shows_the_light_of_each(shown):
    scene, results = bpy.context.scene, read_results(shown)
    frames = [entry.frame for entry in results.frames if any(probe.fired for probe in entry.probes)]
    scene.frame_set(0)
    exposure = results.settings.reference_exposure
    for frame in frames:
        assert bpy.ops.xihe.go_to_trigger(direction="NEXT") == {"FINISHED"} and scene.frame_current == frame
        mean = evaluate_panorama(light_in_use(results, "Ball", frame), 64, 128).mean() / exposure
        assert colours("Xihe Light Ball").mean() == pytest.approx(mean, rel=1e-4)
    assert bpy.ops.xihe.go_to_trigger(direction="NEXT") == {"CANCELLED"} and scene.frame_current == frames[-1]
    for frame in reversed(frames[:-1]):
        assert go_to_trigger(scene, "PREVIOUS") == frame
    assert go_to_trigger(scene, "PREVIOUS") is None
    # Without the run's folder as well.
    scene.xihe.run_folder = str(shown / "gone")
    scene.frame_set(0)
    assert bpy.ops.xihe.go_to_trigger() == {"FINISHED"}


def test_the_nearest_compared_frame_is_the_earlier_of_two(shown):
    results = read_results(shown)
    seen = replace(results.frames[0], frame=3, compared=None)
    frames = (*(replace(results.frames[0], frame=frame) for frame in (1, 5)), seen)
    assert [replace(results, frames=frames).nearest_compared_frame(f) for f in (-9, 2, 3, 4, 99)] == [1, 1, 1, 5, 5]
    assert replace(results, frames=(seen,)).nearest_compared_frame(3) is None


def test_a_run_that_would_see_no_object_is_refused_before_anything_is_written(tmp_path):
    scene = walk_for_the_panel(tmp_path)
    for frame in range(1, 6):
        look_away(scene.camera, frame)
    refused = pytest.raises(RuntimeError, match="No virtual object is in view of the camera in any frame")
    with nothing_changes(), refused:
        bpy.ops.xihe.run()
    assert bpy.context.window_manager.xihe.error.startswith("No virtual object is in view")
    assert not any(tmp_path.iterdir())


def test_a_run_that_saw_no_position_shows_no_picture(tmp_path):
    scene = walk_for_the_panel(tmp_path)
    for frame in (1, 2):
        look_away(scene.camera, frame)
    run_blocking(run_and_show(scene, tmp_path / "run", replace(SMALL, frames=(1, 2))))
    assert read_results(tmp_path / "run").nearest_compared_frame(1) is None
    assert image_named(COMPARISON_NAME) is None and image_named("Xihe Light Ball") is None


def test_a_curve_of_a_long_run_is_keyed_all_at_once_and_no_key_twice(monkeypatch):
    """One key after the other takes time by the square of their number: 0.14 s for 2,000 frames of one object."""
    frames = [
        runs.frame(k, runs.probe("Ball", coverage=k / 10, shc_rmse=None if k == 1 else k / 20)) for k in (1, 2, 5)
    ]
    asked, add_keys = [], results_in_blender.add_keys
    monkeypatch.setattr(results_in_blender, "add_keys", lambda *given: asked.append(list(given[1])) or add_keys(*given))
    world = bpy.data.worlds.new("Long")
    for _ in range(2):
        results_in_blender._key_curves(world, runs.results(frames), "Ball")
    assert asked == 2 * [[2, 5], [1, 2, 5]]
    keys = {curve.data_path: {point.co.x: point.co.y for point in curve.keyframe_points} for curve in f_curves(world)}
    assert keys['["Xihe SHC RMSE"]'] == pytest.approx({2: 0.1, 5: 0.25})
    assert keys['["Xihe coverage"]'] == pytest.approx({1: 0.1, 2: 0.2, 5: 0.5})
    assert [len(curve.keyframe_points) for curve in f_curves(world)] == [2, 3]
    assert {point.interpolation for curve in f_curves(world) for point in curve.keyframe_points} == {"CONSTANT"}
