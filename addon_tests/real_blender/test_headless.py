"""Blender without a window: the command, a script, and the packages themselves do one and the same."""

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from results_schema import check_results, read_strictly, without_times

from addon_tests.pure.commands import assert_refused
from addon_tests.real_blender.whole_blender import ROOT, SCENE, SMALL

EXAMPLE = ROOT / "docs" / "previs_in_blender.py"
AS_MODULE = (
    "import runpy, sys; sys.argv = ['xihe', *sys.argv[sys.argv.index('--') + 1 :]];"
    "runpy.run_module('xihe_blender', run_name='__main__')"
)

FROM_THE_PANEL = """
import bpy
chosen = bpy.context.scene.xihe
chosen.preset, chosen.use_own_size, chosen.size = "draft", True, (32, 24)
chosen.use_own_frames, chosen.frame_start, chosen.frame_end, chosen.frame_step = True, 1, 13, 6
assert bpy.ops.xihe.run() == {"FINISHED"}
"""


@pytest.fixture(scope="module")
def commanded(blender, tmp_path_factory):
    """A run by the command: what it said, and its folder."""
    out = tmp_path_factory.mktemp("commanded") / "out"
    return blender.xihe("previs", SCENE, "--out", out, *SMALL), out


def results_of(out):
    return without_times(read_strictly(out / "results.json"))


def test_the_command_makes_a_whole_run(commanded):
    done, out = commanded
    assert done.returncode == 0, done.stderr
    check_results(read_strictly(out / "results.json"))
    result, report = done.stdout.splitlines()
    assert "3 of 3 frames" in result and report == str(out / "report.html")


def test_a_script_with_the_public_api_gives_the_same_results(blender, commanded, tmp_path):
    said = blender.background(SCENE, "--python", EXAMPLE, "--", tmp_path / "out")
    assert "estimates, see" in said
    assert results_of(tmp_path / "out") == results_of(commanded[1])


def test_the_package_run_as_a_module_gives_the_same_results(blender, commanded, tmp_path):
    blender.background("--python-expr", AS_MODULE, "--", "previs", SCENE, "--out", tmp_path / "out", *SMALL)
    assert results_of(tmp_path / "out") == results_of(commanded[1])


def test_a_run_from_the_panel_gives_the_same_results(blender, commanded, tmp_path):
    # Its folder lies beside the file.
    scene = shutil.copy(SCENE, tmp_path)
    said = blender.background(scene, "--python-exit-code", "1", "--python-expr", FROM_THE_PANEL)
    # Blender tells of every picture that a render writes by itself.
    assert "Saved:" not in said
    (out,) = (tmp_path / "xihe_runs").iterdir()
    assert results_of(out) == results_of(commanded[1])


def test_with_json_stdout_holds_the_json_alone(blender):
    done = blender.xihe("effects", SCENE, "--plan-only", "--frames", "1", "--json")
    assert done.returncode == 0, done.stderr
    assert {"name", "state"} <= json.loads(done.stdout)[0].keys()


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("prewiew", "'prewiew'"),
        ("previs {folder}/nowhere.blend --out {folder}/out", "no such file"),
        ("train", "torch is not installed"),
        ("package --out {folder}", "checkout"),
        ("scenes build", "checkout"),
    ],
)
def test_a_mistake_and_what_needs_more_than_blender_are_one_line_and_exit_code_2(blender, tmp_path, typed, words):
    assert_refused(blender.xihe(*typed.format(folder=tmp_path).split()), words)


@pytest.mark.parametrize("compression", ["ZIP_COMPRESSION", "PIZ_COMPRESSION"])
def test_frames_of_other_programs_are_read_or_refused_with_what_to_do(blender, tmp_path, compression):
    path = tmp_path / "frame.exr"
    header = {"compression": getattr(OpenEXR, compression), "type": OpenEXR.scanlineimage}
    pixels = np.random.default_rng(0).random((12, 16)).astype(np.float32) + 1
    with OpenEXR.File(header, {name: OpenEXR.Channel(pixels) for name in "RGBZ"}) as file:
        file.write(str(path))
    camera = {"width": 16, "height": 12, "fx": 16, "fy": 16, "cx": 8, "cy": 6, "world_from_camera": np.eye(4).tolist()}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    done = blender.xihe("estimate", path, "--camera", tmp_path / "camera.json", "--at", "0,0,-1", "--json")
    if compression == "PIZ_COMPRESSION":
        assert_refused(done, "save it in scan lines with ZIP compression")
        return
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["positions"][0]["is_valid"]


def test_a_data_set_is_built_by_more_blenders(blender, tmp_path):
    done = blender.xihe("dataset", "build", "--rooms", "1", "--workers", "1", "--out", tmp_path / "rooms")
    assert done.returncode == 0, done.stderr
    assert [path.name for path in (tmp_path / "rooms").glob("*.npz")] == ["room_000000.npz"]


def blender_process(*words):
    """The id of the Blender whose arguments contain `words`, once it is there."""
    for _ in range(100):
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                arguments = (folder / "cmdline").read_bytes().decode().split("\0")
            except OSError:
                continue
            if Path(arguments[0]).name.startswith("blender") and set(words) <= set(arguments):
                return int(folder.name)
        time.sleep(0.1)
    raise AssertionError(f"no Blender with {words}")


def test_ctrl_c_stops_a_run_that_the_same_command_finishes(blender, commanded, tmp_path):
    out = tmp_path / "out"
    arguments = ("--command", "xihe", "previs", SCENE, "--out", out, *SMALL)
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(blender.user)}
    with subprocess.Popen(
        blender.command(*arguments), env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        for line in process.stderr:
            if "capturing frame 7" in line:
                os.kill(blender_process(str(out)), signal.SIGINT)
                break
        stdout, stderr = process.communicate(timeout=100)
    assert process.returncode == 130, stderr
    assert stdout == "" and "run the same command again to resume" in stderr
    assert not (out / "results.json").exists()
    assert blender.run(*arguments).returncode == 0
    assert results_of(out) == results_of(commanded[1])
