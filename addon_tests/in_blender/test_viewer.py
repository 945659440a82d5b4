"""The viewer of a run: what is in the page, and what cannot be shown.

A browser looks at it in addon_tests/engines/prove_viewer.py.
"""

import base64
import json
import re
import shutil
import subprocess
import tempfile
import zlib
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from addon_runs import registered_addon
from previs_runs import walk
from tiny_scenes import box, empty_scene, linked, saved

from addon_tests.pure.commands import assert_refused, xihe_here
from xihe_blender.addon.result_operators import second_blender
from xihe_blender.apply.datablocks import LightOf, applied_worlds
from xihe_blender.apply.sh_worlds import key_light_changes
from xihe_blender.cli.main import main
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import read_results
from xihe_blender.jobs import run_blocking
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.shader_nodes import new_material
from xihe_blender.viewer import page as module
from xihe_blender.viewer.save import save_viewer, viewed_objects
from xihenet.io.recording import load_frame
from xihenet.light.platforms import Y_UP, coefficients_for, convention_of


@pytest.fixture(scope="module")
def done(finished, tmp_path_factory):
    """A run's folder, and its page."""
    folder = shutil.copytree(finished.outputs.folder, tmp_path_factory.mktemp("viewer") / "out")
    assert main(["export", str(folder / "results.json"), "--to", "viewer"]) == 0
    return folder, (folder / "viewer.html").read_text(encoding="utf-8")


def data_of(page):
    return json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])


def test_the_page_is_one_file_that_asks_for_nothing(done):
    _, page = done
    assert "default-src 'none'" in page and "Permission is hereby granted" in page
    assert "connect-src blob:" in page, "three.js fetches the textures of a glTF file from within the page"
    assert not re.search(r'(src|href)="', page) and page.count("<script") == page.count("</script>") == 3
    assert "$" not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert "needs WebGL 2" in page and "<noscript><p>This page draws with JavaScript" in page


def test_frames_have_what_the_phone_saw_and_where_it_was(done):
    folder, page = done
    data, results = data_of(page), read_results(folder)
    outputs = RunOutputs(folder, "")
    assert data["exposure"] == results.settings.reference_exposure
    assert [frame["frame"] for frame in data["frames"]] == [frame.frame for frame in results.captured_frames]
    for frame in data["frames"]:
        seen = load_frame(outputs.capture(frame["frame"]))
        np.testing.assert_allclose(np.array(frame["gain"]) * data["exposure"], seen.exposure)
        matrix = np.array(frame["camera"]["matrix"]).reshape(4, 4).T
        np.testing.assert_allclose(matrix[:3, 3], Y_UP @ seen.world_from_camera[:3, 3], atol=1e-5)
        depth_mm = np.frombuffer(zlib.decompress(base64.b64decode(data["depths"][frame["depth"]])), "<u2")
        near = np.isfinite(seen.plane_depth_m) & (seen.plane_depth_m < 60) & (seen.plane_depth_m > 0)
        shown_m = depth_mm.reshape(seen.plane_depth_m.shape)[near] / 1000
        np.testing.assert_allclose(shown_m, seen.plane_depth_m[near], atol=6e-4)
    compared = {frame["frame"] for frame in data["frames"] if frame["truth"] is not None}
    assert compared == set(results.compared_frames)
    told = [name for name, figures in data["frames"][0]["by_method"].items() if "Time of" in figures[-1][0]]
    assert told == [results.settings.estimator] == list(results.summary.estimate_ms)


def test_lights_are_those_of_the_run(done):
    folder, page = done
    data, results = data_of(page), read_results(folder)
    assert [one["name"] for one in data["methods"]] == [results.settings.estimator, "truth", "ambient"]
    own = data["methods"][0]["lights"]
    assert {name: [one["frame"] for one in lights] for name, lights in own.items()} == {
        name: [change.frame for change in changes] for name, changes in results.lights.items()
    }
    truth = data["methods"][1]["lights"]["Ball"][0]
    first = next(p for frame in results.frames for p in frame.probes if p.object == "Ball")
    expected = coefficients_for(np.array(first.sh_truth), convention_of("three"))
    np.testing.assert_allclose(truth["sh"], expected, atol=1e-5)


def test_objects_are_gltf_and_stay_where_they_are(done):
    _, page = done
    for one in data_of(page)["objects"]:
        assert base64.b64decode(one["glb"])[:4] == b"glTF" and one["radius"] > 0.05
        assert [np.round(matrix, 5).tolist() for matrix in one["matrices"]] == [np.eye(4).ravel().tolist()]


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("RUN --to viewer --frame 1", "leave out --frame"),
        ("RUN --to viewer --all", "leave out --all"),
        ("RUN --to viewer --units scene", "leave out --units"),
        ("RUN --to viewer --objects Nobody", "no virtual object 'Nobody'"),
        ("RUN --to viewer --objects Table", "the run has no virtual object 'Table'; it has B"),
        ("RUN --to viewer --from nowhere.blend", "there is no nowhere.blend"),
        ("--to three", "give either RESULTS.json or --from"),
        ("--to three --from nowhere.blend", "nowhere.blend"),
        ("--to three --from LIT --objects Nobody", "has no lit virtual object 'Nobody'; it has B"),
        ("--to three --from LIT --light sh", "--light does not apply to a file: leave it out"),
    ],
)
def test_what_cannot_be_shown_or_is_not_in_a_file_is_one_line(done, tmp_path, typed, words):
    paths = {"RUN": done[0], "LIT": next(done[0].glob("*_lit.blend"))}
    arguments = (paths.get(word, word) for word in typed.split())
    assert_refused(xihe_here("export", *arguments, "--out", tmp_path), words)
    assert not list(tmp_path.iterdir())


def test_lost_captures_and_too_many_triangles_are_one_line(done, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    shutil.copytree(done[0], folder)
    monkeypatch.setattr("xihe_blender.viewer.save.MOST_TRIANGLES", 10)
    assert_refused(xihe_here("export", folder, "--to", "viewer"), "triangles")
    shutil.rmtree(folder / "work")
    assert_refused(xihe_here("export", folder, "--to", "viewer"), "is gone: run xihe previs again")


def material_of(glb):
    """The first one of a GLB, or None."""
    length = int.from_bytes(glb[12:16], "little")
    return json.loads(glb[20 : 20 + length]).get("materials", [None])[0]


def test_a_page_that_no_browser_would_open_is_refused_before_a_frame_is_read(done, monkeypatch):
    results, outputs = read_results(done[0]), RunOutputs(done[0])
    monkeypatch.setattr(module, "MOST_PICTURES", 1000)
    monkeypatch.setattr(module, "load_frame", None)
    words = (
        r"the pictures of \d+ frames have [0-9.]+ kB, and browsers open a page with 1.0 kB: run again with fewer frames"
    )
    with pytest.raises(UserError, match=words):
        module.viewed_frames(results, outputs)


def test_pictures_that_are_the_same_count_once_for_what_a_browser_opens(done, tmp_path, monkeypatch):
    """The page has each of them once; a phone that stands still has thousands."""
    folder = shutil.copytree(done[0], tmp_path / "run")
    first, *others = sorted(folder.joinpath("pictures").glob("captured_*.png"))
    for picture in [*others, *folder.joinpath("pictures").glob("ground_truth_*.png")]:
        shutil.copyfile(first, picture)
    monkeypatch.setattr(module, "MOST_PICTURES", first.stat().st_size)
    assert others and module.viewed_frames(read_results(folder), RunOutputs(folder))


def test_an_object_without_a_material_is_the_grey_that_cycles_has_for_it():
    scene = walk()
    ball = bpy.data.objects["Ball"]
    ball.data.materials.clear()
    grey = material_of(viewed_objects(scene, [ball], [1])[0].glb)["pbrMetallicRoughness"]
    assert grey["metallicFactor"] == 0 and grey["baseColorFactor"][:3] == pytest.approx([0.8] * 3, abs=1e-3)


def test_an_object_in_millimetres_far_from_the_origin_stands_still():
    scene = walk()
    ball = bpy.data.objects["Ball"]
    ball.location, ball.scale = (1e6, -1e6, 0), (1e-3, 1e-3, 1e-3)
    for move in viewed_objects(scene, [ball], [1, 2])[0].matrices:
        np.testing.assert_allclose(move, np.eye(4), atol=1e-6)


@pytest.mark.parametrize("kind", ["mesh", "curve"])
def test_an_object_without_a_face_is_a_whole_file(kind):
    scene = walk()
    data = bpy.data.meshes.new("Empty") if kind == "mesh" else bpy.data.curves.new("Empty", "CURVE")
    empty = bpy.data.objects.new("Empty", data)
    scene.collection.objects.link(empty)
    glb = viewed_objects(scene, [empty], [1])[0].glb
    assert int.from_bytes(glb[8:12], "little") == len(glb)


def test_shares_beyond_0_and_1_are_those_that_cycles_has_for_them():
    scene = walk()
    ball = bpy.data.objects["Ball"]
    material = new_material("Shares")
    shader = material.node_tree.nodes["Principled BSDF"]
    ball.material_slots[0].material = material
    for name, share in {"Alpha": 1.2, "Metallic": -0.3, "Roughness": 1.7}.items():
        value = material.node_tree.nodes.new("ShaderNodeValue")
        value.outputs[0].default_value = share
        material.node_tree.links.new(value.outputs[0], shader.inputs[name])
    exported = material_of(viewed_objects(scene, [ball], [1])[0].glb)
    shares = exported["pbrMetallicRoughness"]
    assert shares["baseColorFactor"][3] == 1 and "alphaMode" not in exported
    assert shares["metallicFactor"] == 0 and shares.get("roughnessFactor", 1) == 1


@pytest.mark.parametrize("hidden", ["by its eye", "in viewports", "with its collection", "by the view layer"])
def test_an_object_that_the_viewport_hides_is_exported_as_a_run_shows_it(hidden):
    shown = viewed_objects(walk(), [bpy.data.objects["Ball"]], [1])[0].glb
    scene = walk()
    ball, layer = bpy.data.objects["Ball"], bpy.context.view_layer
    home = layer.layer_collection.children["Xihe Virtual"]
    if hidden == "by its eye":
        ball.hide_set(True)
    elif hidden == "in viewports":
        ball.hide_viewport = True
    elif hidden == "with its collection":
        home.hide_viewport = True
    else:
        home.exclude = True
    assert viewed_objects(scene, [ball], [1])[0].glb == shown


def test_a_hidden_object_of_a_library_is_exported_beside_one_of_its_name(tmp_path):
    walk()
    library = saved(tmp_path / "library.blend")
    scene = empty_scene()
    (virtual,) = linked(library, "collections", "Xihe Virtual")
    scene.collection.children.link(virtual)
    box(scene, "Ball", (0, 0, 0), (1, 1, 1))
    scene.view_layers[0].layer_collection.children["Xihe Virtual"].exclude = True
    assert material_of(viewed_objects(scene, [virtual.objects["Ball"]], [1])[0].glb) is not None


@pytest.mark.parametrize("is_first", [True, False])
def test_of_a_virtual_object_and_another_of_its_name_the_virtual_one_is_shown(tmp_path, monkeypatch, is_first):
    walk()
    library = saved(tmp_path / "library.blend")
    scene = empty_scene()
    (virtual,) = linked(library, "collections", "Xihe Virtual")
    room = bpy.data.collections.new("Room")
    for child in (virtual, room) if is_first else (room, virtual):
        scene.collection.children.link(child)
    room.objects.link(bpy.data.objects.new("Ball", bpy.data.meshes.new("Ball")))
    shown, results = [], SimpleNamespace(scene=SimpleNamespace(file="lit.blend"), lights={"Ball": None})
    monkeypatch.setattr("xihe_blender.viewer.save.viewed_frames", lambda *_: {1: None})
    monkeypatch.setattr("xihe_blender.viewer.save.viewed_objects", lambda _scene, items, _frames: shown.extend(items))
    monkeypatch.setattr("xihe_blender.viewer.save.viewer_page", lambda *_: "")
    save_viewer(results, tmp_path, blend=saved(tmp_path / "lit.blend"))
    assert [(item.name, item.library is not None) for item in shown] == [("Ball", True)]


@pytest.mark.slow
def test_the_button_writes_the_same_page_and_leaves_the_open_file_alone(done):
    folder, page = done
    walk()
    chosen = [item.name for item in bpy.context.selected_objects]
    (folder / "viewer.html").unlink()
    run_blocking(second_blender(["export", "--to", "viewer", str(folder)], "saving"))
    assert (folder / "viewer.html").read_text(encoding="utf-8") == page
    assert [item.name for item in bpy.context.selected_objects] == chosen
    with pytest.raises(UserError, match=r"nowhere is no run: give the run's folder"):
        run_blocking(second_blender(["export", "--to", "viewer", str(folder / "nowhere")], "saving"))


def test_a_button_that_is_stopped_ends_what_it_started_and_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    started, popen, environments = [], subprocess.Popen, []

    def start(*given, **how):
        environments.append(how["env"])
        started.append(popen(*given, **how))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    job = second_blender(["video", str(tmp_path / "run")], "saving the video")
    assert next(job).doing == "saving the video"
    job.close()
    assert started[0].returncode is not None
    assert not list(tmp_path.iterdir())
    # Blender asks the second first on Windows, and the third elsewhere.
    (folder,) = {environments[0][name] for name in ("TMPDIR", "TEMP", "TMP")}
    assert Path(folder).parent == tmp_path


def test_the_button_exports_what_the_command_does(done, tmp_path):
    folder, _ = done
    with registered_addon():
        scene = walk()
        scene.xihe.run_folder = str(folder)
        scene.frame_set(2)
        assert bpy.ops.xihe.export_light(target="three") == {"FINISHED"}
    by_button = (folder / "exports" / "three" / "three.json").read_bytes()
    assert main(["export", str(folder), "--to", "three", "--frame", "2", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "three.json").read_bytes() == by_button


def lights(folder):
    return json.loads((folder / "three.json").read_text())["lights"]


def test_a_lit_file_has_the_lights_of_its_run(done, tmp_path):
    folder, _ = done
    lit = next(folder.glob("*_lit.blend"))
    assert (
        main(["export", str(folder), "--to", "three", "--all", "--light", "sh+key", "--out", str(tmp_path / "a")]) == 0
    )
    assert main(["export", "--from", str(lit), "--to", "three", "--all", "--out", str(tmp_path / "b")]) == 0
    of_run, of_file = lights(tmp_path / "a"), lights(tmp_path / "b")
    of_run = [one for one in of_run if one["object"] in {other["object"] for other in of_file}]
    assert [(one["object"], one["frame"]) for one in of_file] == [(one["object"], one["frame"]) for one in of_run]
    for read, made in zip(of_file, of_run, strict=True):
        np.testing.assert_allclose(read["sh"], made["sh"], atol=2e-5)
        assert (read["mainLight"] is None) == (made["mainLight"] is None)
        if read["mainLight"] is not None:
            np.testing.assert_allclose(read["mainLight"]["direction"], made["mainLight"]["direction"], atol=1e-5)
            assert read["mainLight"]["intensity"] == pytest.approx(made["mainLight"]["intensity"], rel=1e-5)
        assert read["time_s"] == pytest.approx(made["time_s"])


def test_an_object_that_was_moved_is_exported_with_the_light_of_its_new_place(done):
    folder, _ = done
    with registered_addon():
        scene = open_blend(next(folder.glob("*_lit.blend")))
        scene.xihe.run_folder = str(folder)
        world = applied_worlds(scene)["Ball"]
        LightOf({"Ball": (0.0, 0.0, 0.0)}, live={"Ball": (0.5, None)}).write(world)
        moved = np.eye(9)[0][:, None] * (0.3, 0.2, 0.1)
        key_light_changes(world, {1: moved}, 1.0)
        assert bpy.ops.xihe.export_light(target="three") == {"FINISHED"}
    ball = next(one for one in lights(folder / "exports" / "three") if one["object"] == "Ball")
    np.testing.assert_allclose(np.reshape(ball["sh"], (9, 3))[0], (0.3, 0.2, 0.1), atol=1e-5)
