"""`xihe evaluate` in processes of its own: workers, mistakes, and what is done in spite of them."""

import json
import shutil

import bpy
import pytest
from jsonschema import Draft202012Validator
from tiny_scenes import room_with_a_virtual_sphere, saved
from xihe_process import xihe

from addon_tests.pure.commands import assert_refused, xihe_here
from xihe_blender.io.json_records import from_json
from xihe_blender.lab.batch.results import BatchResults, batch_schema

pytestmark = [pytest.mark.slow, pytest.mark.wheel_only("a whole Blender's Python has no Dask")]

TINY = ("--size", "16x12", "--samples", "1", "--estimators", "projection,ambient")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Two scenes that are good, and one without a camera; without walls, between which light takes long."""
    folder = tmp_path_factory.mktemp("scenes")
    scene = room_with_a_virtual_sphere(1)
    bpy.data.objects.remove(bpy.data.objects["Room"])
    for name in ("good", "as_good", "blind"):
        if name == "blind":
            bpy.data.objects.remove(scene.camera)
        saved(folder / f"{name}.blend")
    return folder


@pytest.fixture(scope="module")
def done(scenes, tmp_path_factory):
    """A batch with a broken scene and a missing one among good ones, over two workers."""
    out = tmp_path_factory.mktemp("batch") / "out"
    files = [scenes / f"{name}.blend" for name in ("good", "blind", "none", "as_good")]
    return out, files, xihe("evaluate", *files, "--out", out, *TINY, "--workers", "2")


def test_a_broken_scene_is_named_and_stops_no_other(done):
    out, _, told = done
    assert told.returncode == 1, told.stderr
    complaints = [line for line in told.stderr.splitlines() if line.startswith("xihe: ")]
    assert len(complaints) == 2 and "none.blend" in complaints[0] and "camera" in complaints[1]
    content = json.loads((out / "results.json").read_text())
    Draft202012Validator(batch_schema()).validate(content)
    results = from_json(BatchResults, content)
    assert [(t.scene, t.estimator) for t in results.trials] == [
        (scene, name) for scene in ("good", "as_good") for name in ("projection", "ambient")
    ]
    assert len(results.failed) == 2 and (out / "report.html").read_text().count("<svg") > 0


def test_one_worker_comes_to_the_same_bytes_and_does_nothing_again(done, tmp_path):
    out, files, _ = done
    shutil.copytree(out, tmp_path / "copy")
    missing = next((tmp_path / "copy").rglob("as_good_*"))
    shutil.rmtree(missing)
    told = xihe_here("evaluate", files[0], files[3], "--out", tmp_path / "copy", *TINY, "--workers", "1")
    assert told.returncode == 0 and "1 of them done now" in told.stdout, told.stderr
    assert missing.exists()
    for table in ("trials.csv", "frames.csv"):
        assert (tmp_path / "copy" / table).read_bytes() == (out / table).read_bytes()


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--estimators", "magic", "choose one of"),
        ("--profiles", "nokia", "--profiles nokia: there is no phone profile 'nokia': choose one of"),
        ("--workers", "0", "give 1 or more"),
        ("--scheduler", "nowhere", "no scheduler answers"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(scenes, tmp_path, option, value, words):
    assert_refused(xihe_here("evaluate", scenes / "good.blend", "--out", tmp_path / "a", option, value), words)
    assert not (tmp_path / "a").exists()
