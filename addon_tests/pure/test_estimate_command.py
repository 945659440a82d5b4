"""`xihe estimate` as a user types it, where there is no Blender: what it says, what it writes, what it refuses."""

import json
import shlex
import subprocess
import sys

import numpy as np
import pytest

from addon_tests.pure.commands import ROOT, assert_refused, fresh_python, xihe_here
from addon_tests.pure.frame_makers import box_radiance_and_plane_depth, write_camera, write_exr, write_image
from xihe_blender.cli.main import main
from xihenet import __version__, estimators, sh
from xihenet.camera import encode_exposed, unproject_frame
from xihenet.estimators.projection import Projection
from xihenet.io.frame_files import read_camera, read_frame
from xihenet.io.png import encode_png
from xihenet.light.light_picture import light_picture
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

RADIANCE, PLANE_DEPTH_M = box_radiance_and_plane_depth()
COLOUR, MILLIMETRES = encode_exposed(RADIANCE, 1), np.rint(PLANE_DEPTH_M * 1000).astype(np.uint16)
AT = "0,2,-0.3"
WITHOUT_BLENDER = (
    "import sys\n"
    "for name in ('bpy', 'bmesh', 'mathutils', 'bpy_extras', 'torch', 'scipy'): sys.modules[name] = None\n"
    "from xihe_blender.cli.main import main\n"
    "sys.exit(main(sys.argv[1:]))"
)


def xihe_without_blender(*arguments):
    """The command in a process in which importing bpy fails, and in which warnings are errors."""
    return fresh_python(WITHOUT_BLENDER, *arguments, check=False)


def test_without_blender_a_command_that_needs_it_says_what_to_install():
    done = xihe_without_blender("previs", "a.blend", "--out", "b")
    assert_refused(done, "pip install 'xihe-blender[blender]'", "3.11 or 3.13")


def estimate(*arguments):
    return main(["estimate", *map(str, arguments)])


def no_constant(name):
    raise AssertionError(f"{name} is no JSON")


def read_strictly(text):
    return json.loads(text, parse_constant=no_constant)


@pytest.fixture
def answer(capfd):
    """Runs the command: the JSON that it prints, and what it says beside that."""

    def run(*arguments):
        assert estimate(*arguments, "--json") == 0
        said = capfd.readouterr()
        return read_strictly(said.out), said.err

    return run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("frame")
    write_camera(folder / "camera.json")
    write_exr(folder / "frame.exr", RADIANCE, PLANE_DEPTH_M)
    write_image(folder / "colour.png", COLOUR)
    write_image(folder / "plane_depth.png", MILLIMETRES)
    (folder / "text.exr").write_text("a shopping list")
    return folder


@pytest.fixture
def exr(folder):
    return [folder / "frame.exr", "--camera", folder / "camera.json"]


@pytest.fixture
def images(folder):
    return [folder / "colour.png", "--plane-depth", folder / "plane_depth.png", "--camera", folder / "camera.json"]


def test_it_runs_where_blender_is_not_installed_and_json_is_all_that_stdout_holds(exr):
    done = xihe_without_blender("estimate", *exr, "--at", AT, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    content = read_strictly(done.stdout)
    assert content["positions"][0]["is_valid"]


def test_without_blender_a_mistake_is_one_line_and_exit_2(folder):
    done = xihe_without_blender("estimate", folder / "none.exr", "--camera", folder / "camera.json", "--at", AT)
    assert_refused(done, "xihe: cannot read")


def test_the_home_folder_is_known_where_no_shell_puts_it_in(exr, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert estimate(*exr, "--at", AT, "--out=~/answer") == 0
    assert estimate(*exr, "--at", AT, "--out", "~nobody_of_that_name") == 0
    assert (tmp_path / "answer" / "estimate.json").is_file()
    assert [path.name for path in (tmp_path / "here").iterdir()] == ["~nobody_of_that_name"]


def test_no_number_of_a_light_is_minus_0(exr, capfd):
    assert estimate(*exr, "--at", AT, "--exposure", "1e20", "--estimator", "projection") == 0
    assert " 0.0000" in (said := capfd.readouterr().out) and "-0.0000" not in said


def test_an_empty_path_is_refused_and_not_taken_for_the_current_folder(exr, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(xihe_here("estimate", *exr, "--at", AT, "--out", ""), "--out", "give a file or folder")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("redirected", ["| true", ">&-", "2>&-", "2>/dev/full", "<&- >&- 2>&-"])
def test_a_job_is_done_whoever_has_stopped_reading(exr, tmp_path, redirected):
    done = in_a_shell(exr, tmp_path, redirected)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "estimate.json").is_file()


def test_a_result_that_the_disk_has_no_room_for_is_one_line(exr, tmp_path):
    done = in_a_shell(exr, tmp_path, ">/dev/full")
    assert_refused(done, "xihe: standard output: No space left on device; free some space")


def in_a_shell(exr, out, redirected):
    """The command as a shell runs it, with its output `redirected`."""
    words = shlex.join([*map(str, exr), f"--at={AT}", f"--out={out}"])
    script = f"set -o pipefail; {shlex.quote(sys.executable)} -W error -m xihe_blender estimate {words} {redirected}"
    return subprocess.run(["bash", "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=60)


def test_the_estimator_and_the_anchors_that_were_asked_for_are_used(exr, folder, answer):
    frame = read_frame(folder / "frame.exr", read_camera(folder / "camera.json"))
    cloud = sample_unit_sphere(unproject_frame(frame), (0, 2, -0.3), AnchorLattice(640))
    content, _ = answer(*exr, "--at", AT, "--anchors", 640, "--estimator", "projection")
    expected = estimators.load("projection", 640).estimate(cloud)
    np.testing.assert_allclose(content["positions"][0]["sh_radiance"], expected, rtol=1e-12)
    assert content["exposure"] == frame.exposure
    content, _ = answer(*exr, "--at", AT, "--estimator", "ambient")
    flat = np.array(content["positions"][0]["sh_radiance"])
    assert flat[0].all() and not flat[1:].any()


def test_light_is_fit_to_be_looked_at_only_if_asked_for(exr, tmp_path, monkeypatch):
    light = np.vstack([np.ones((1, 3)), np.full((8, 3), 0.9)])
    monkeypatch.setattr(Projection, "estimate", lambda *_: light)
    plain, shown = tmp_path / "plain", tmp_path / "shown"
    for folder, asked in ((plain, []), (shown, ["--dering"])):
        assert estimate(*exr, "--at", AT, "--estimator", "projection", "--out", folder, *asked) == 0
    before, after = (read_strictly((folder / "estimate.json").read_text()) for folder in (plain, shown))
    assert (before["is_deringed"], after["is_deringed"]) == (False, True)
    np.testing.assert_array_equal(before["positions"][0].pop("sh_radiance"), light)
    np.testing.assert_array_equal(after["positions"][0].pop("sh_radiance"), sh.dering_for_display(light))
    assert before["positions"] == after["positions"]
    assert (plain / "light_0.png").read_bytes() != (shown / "light_0.png").read_bytes()


def test_the_json_says_all_there_is_to_say(exr, answer):
    content, _ = answer(*exr, "--at", AT, "--at=-1,2,0", "--target", "hdr", "--estimator", "projection")
    positions = content.pop("positions")
    assert content.pop("exposure") > 0
    assert content.pop("frame") == {
        "size": [32, 24], "nearest_m": 1.5, "farthest_m": 3.0, "metres_per_unit": 1.0, "intrinsics_given_for": None,
        "invalid": {},
    }  # fmt: skip
    assert content == {
        "schema_version": 1,
        "software": {"xihe": __version__, "numpy": np.__version__},
        "estimator": "projection",
        "target": "hdr",
        "n_anchors": 1280,
        "sh_axes": "right-handed, +Z up",
        "is_deringed": False,
    }
    assert [one["position_m"] for one in positions] == [[0, 2, -0.3], [-1, 2, 0]]
    for one in positions:
        assert np.shape(one["sh_radiance"]) == (9, 3) and np.isfinite(one["sh_radiance"]).all()
        assert 0 < one["coverage"] < 1 and one["n_invalid_points"] == 0
        assert (one["in_view"], one["is_valid"], one["expected_error"]) == (True, True, None)
        assert one["behind_m"] == 0


def test_positions_are_in_the_world_of_the_camera_file_and_light_is_upright(exr, folder, answer):
    write_camera(folder / "y_up.json", world_from_camera=np.eye(4).tolist(), up="y")
    z_up, _ = answer(*exr, "--at", "0.2,2,-0.3")
    y_up, _ = answer(folder / "frame.exr", "--camera", folder / "y_up.json", "--at", "0.2,-0.3,-2")
    (of_z_up,), (of_y_up,) = z_up["positions"], y_up["positions"]
    assert of_y_up["position_m"] == [0.2, -0.3, -2] and of_y_up["in_view"]
    np.testing.assert_allclose(of_y_up["sh_radiance"], of_z_up["sh_radiance"], atol=1e-6)


def test_a_position_outside_of_the_view_is_estimated_with_a_warning(exr, answer):
    content, said = answer(*exr, "--at", "0,-2,0", "--at", AT)
    assert [one["in_view"] for one in content["positions"]] == [False, True]
    assert content["positions"][0]["is_valid"]
    assert said == "xihe: warning: 0,-2,0 is not in the frame's view: its light is estimated from other surfaces\n"


def test_a_position_in_the_coordinates_of_a_map_is_named_as_it_was_given(exr, answer):
    *_, said = answer(*exr, "--at", "448262.31,5411932.705,3")
    assert "448262.31,5411932.705,3" in said


def test_a_position_so_far_that_nothing_is_seen_from_there_is_told_so(exr, answer):
    content, said = answer(*exr, "--at", "1e39,0,0")
    assert not content["positions"][0]["is_valid"]
    assert said == "xihe: warning: the light at 1e+39,0,0 cannot be known: no surface was seen from there\n"


def test_a_position_behind_what_is_seen_there_is_estimated_with_a_warning(exr, answer):
    # The wall is at 3 m: what lies in it, or behind it by less than sensors err, is let pass.
    content, said = answer(*exr, "--at", "0,4,0", "--at", "0,3,0", "--at", "0,3.25,0")
    assert [one["behind_m"] for one in content["positions"]] == [pytest.approx(1.0), 0, 0]
    (line,) = said.splitlines()
    assert line.startswith("xihe: warning: 0,4,0 lies 1 m behind the surface seen there")


def test_a_principal_point_outside_of_the_picture_is_estimated_with_a_warning(folder, tmp_path, answer):
    camera = json.loads((folder / "camera.json").read_text())
    (tmp_path / "camera.json").write_text(json.dumps({**camera, "cx": 0, "cy": 0}))
    _, said = answer(folder / "frame.exr", "--camera", tmp_path / "camera.json", "--at", AT)
    assert said.startswith(
        "xihe: warning: the principal point lies at the edge of the picture or outside of it, at 0, 0"
    )


def test_a_position_in_front_of_a_hole_is_behind_nothing(folder, answer):
    holes = write_exr(folder / "holes.exr", RADIANCE, np.where(PLANE_DEPTH_M == 3, 0, PLANE_DEPTH_M))
    assert answer(holes, "--camera", folder / "camera.json", "--at", "0,4,0")[1] == ""


def test_what_was_read_is_told_in_metres_with_the_unit_that_was_assumed(folder, images, answer, capfd):
    assert estimate(*images, "--at", "0,20,-3", "--depth-scale", 0.01) == 0
    said = "frame of 32x24 pixels, plane depth from 15 m to 30 m (1 in the file is 0.01 m)"
    assert capfd.readouterr().out.startswith(f"{said}\n\n0,20,-3: in view")
    larger = {"width": 320, "height": 240, "fx": 200.0, "fy": 200.0, "cx": 160.0, "cy": 120.0}
    camera = write_camera(folder / "larger.json", **larger)
    assert estimate(*images[:-1], camera, "--at", AT) == 0
    assert capfd.readouterr().out.splitlines()[1] == "intrinsics given for 320x240 pixels, scaled to these"
    assert answer(*images[:-1], camera, "--at", AT)[0]["frame"]["intrinsics_given_for"] == [320, 240]


def test_a_position_that_begins_with_a_minus_needs_no_equals_sign(exr, answer):
    content, _ = answer(*exr, "--at", "-0.5,2,0", "--at", "-.5,2,0")
    assert [one["position_m"] for one in content["positions"]] == [[-0.5, 2, 0]] * 2


def test_the_table_holds_the_numbers_of_the_json(exr, answer, capfd):
    content, _ = answer(*exr, "--at", AT, "--at", "0,-2,0")
    assert estimate(*exr, "--at", AT, "--at", "0,-2,0") == 0
    _, first, second = capfd.readouterr().out.strip().split("\n\n")
    for table, one in zip((first, second), content["positions"], strict=True):
        numbers = [[float(word) for word in line.split()] for line in table.splitlines()[2:]]
        np.testing.assert_allclose(np.array(numbers)[:, 2:], one["sh_radiance"], atol=5.1e-5)
        assert [row[0] ** 2 + row[0] + row[1] for row in numbers] == list(range(9))
    assert first.startswith(f"{AT}: in view, ") and second.startswith("0,-2,0: not in view, ")


def test_a_folder_gets_the_json_and_a_picture_of_each_light(exr, tmp_path, answer):
    out = tmp_path / "new" / "folder"
    content, _ = answer(*exr, "--at", AT, "--at", "0.5,2,0", "--out", out)
    assert content == read_strictly((out / "estimate.json").read_text(encoding="utf-8"))
    assert sorted(path.name for path in out.iterdir()) == ["estimate.json", "light_0.png", "light_1.png"]
    for index, one in enumerate(content["positions"]):
        assert (out / f"light_{index}.png").read_bytes() == encode_png(light_picture(one["sh_radiance"]))


def test_the_same_command_gives_the_same_bytes_and_replaces_what_was_there(exr, tmp_path, capfd):
    def contents():
        assert estimate(*exr, "--at", AT, "--out", tmp_path) == 0
        assert capfd.readouterr().out.splitlines()[-1] == str(tmp_path / "light_0.png")
        return {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    first = contents()
    (tmp_path / "light_0.png").write_bytes(b"old")
    assert contents() == first


def test_where_one_picture_cannot_be_written_nothing_is(exr, tmp_path, capfd):
    # A folder that is not empty, where the second picture belongs.
    (tmp_path / "light_1.png" / "full").mkdir(parents=True)
    assert estimate(*exr, "--at", AT, "--at", "0.5,2,0", "--out", tmp_path) == 2
    assert "choose another folder for --out" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["light_1.png"]


EXR = ["frame.exr", "--camera", "camera.json"]
IMAGES = ["colour.png", "--plane-depth", "plane_depth.png", "--camera", "camera.json"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([*EXR], "--at"),
        ([*EXR, "--at", "1,2"], "'1,2' is not a position: give X,Y,Z"),
        ([*EXR, "--at", "1,2,3,4"], "is not a position"),
        ([*EXR, "--at", "1,2,nan"], "is not a position"),
        ([*EXR, "--at", "here"], "is not a position"),
        (["frame.exr", "--at", AT], "--camera"),
        (["none.exr", "--camera", "camera.json", "--at", AT], "none.exr (No such file or directory)"),
        (["frame.exr", "--camera", "none.json", "--at", AT], "none.json (No such file or directory)"),
        ([".", "--camera", "camera.json", "--at", AT], "(Is a directory)"),
        (["text.exr", "--camera", "camera.json", "--at", AT], "is no OpenEXR file"),
        (["colour.png", "--camera", "camera.json", "--at", AT], "plane depth"),
        ([*IMAGES, "--at", AT, "--depth-scale", "0"], "depth scale"),
        ([*EXR, "--at", AT, "--depth-scale", "0.01"], "an OpenEXR file has its distances in metres"),
        ([*EXR, "--at", AT, "--exposure", "-1"], "exposure"),
        ([*EXR, "--at", AT, "--estimator", "truth"], "choose another --estimator"),
        ([*EXR, "--at", AT, "--estimator", "oracle"], "choose one of"),
        ([*EXR, "--at", AT, "--anchors", "0"], "--anchors: expected 1 to"),
        ([*EXR, "--at", AT, "--anchors", "1000000000"], "--anchors: expected 1 to"),
        ([*EXR, "--at", AT, "--target", "sdr"], "--target"),
        ([*EXR, "--at", AT, "--out", "frame.exr"], "choose another folder for --out"),
    ],
)
def test_a_mistake_gets_one_line_that_names_it_and_leaves_nothing(folder, monkeypatch, arguments, said):
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    out = [] if "--out" in arguments else ["--out", "out"]
    assert_refused(xihe_here("estimate", *arguments, *out), said)
    assert sorted(folder.rglob("*")) == before


def test_pixels_that_give_no_point_are_counted_by_reason(folder, answer, capfd):
    radiance, plane_depth_m = RADIANCE.copy(), PLANE_DEPTH_M.copy()
    radiance[0, :2], radiance[1, 0, 1], radiance[1, 1] = np.nan, -1.0, np.inf
    plane_depth_m[2, :3], plane_depth_m[3, 0], plane_depth_m[4, :4] = 1e10, np.nan, 0.0
    broken = write_exr(folder / "broken.exr", radiance, plane_depth_m)
    asked = [broken, "--camera", folder / "camera.json", "--at", AT]
    made = answer(*asked)[0]
    (one,) = made["positions"]
    without_distance = {"not_finite": 1, "no_surface": 3, "no_distance": 4, "colour_not_finite": 2}
    assert made["frame"]["invalid"] == without_distance
    assert one["invalid"] == {
        "not_finite": 1, "colour_not_finite": 2, "negative_colour": 1, "infinite_colour": 1,
    }  # fmt: skip
    assert one["n_invalid_points"] == 3 and one["unknown_because"] is None
    assert estimate(*asked) == 0
    said = capfd.readouterr().out
    assert "pixels without a distance: " in said and "4 (" in said
    assert "points left out or clamped: 1 (a plane depth or a position that is NaN" in said


def test_a_light_that_cannot_be_known_is_black_and_says_why(folder, answer, capfd):
    plane_depth_m = np.full_like(PLANE_DEPTH_M, np.nan)
    plane_depth_m[5, 7] = 2.0
    alone = write_exr(folder / "alone.exr", RADIANCE, plane_depth_m)
    frame = read_frame(alone, read_camera(folder / "camera.json"))
    at = unproject_frame(frame).points_m[5 * RADIANCE.shape[1] + 7].astype(float).tolist()
    asked = [alone, "--camera", folder / "camera.json", f"--at={','.join(map(repr, at))}"]
    (one,) = answer(*asked)[0]["positions"]
    assert (one["is_valid"], one["unknown_because"], one["coverage"]) == (False, "nothing_seen", 0)
    assert one["invalid"] == {"not_finite": plane_depth_m.size - 1, "at_probe": 1}
    assert not np.any(one["sh_radiance"]) and one["expected_error"] is None
    assert estimate(*asked) == 0
    assert "the light cannot be known: no surface was seen from there" in capfd.readouterr().out
    assert answer(*asked, "--estimator", "ambient")[0]["positions"][0]["is_valid"]
