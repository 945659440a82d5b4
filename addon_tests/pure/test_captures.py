"""Recordings in the layouts of others: what is read is what was seen. Broken ones are in test_broken_captures.py."""

import json
import unicodedata
import zipfile
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.broken_recordings import FORMATS
from addon_tests.pure.recordings import (
    LAYOUTS,
    LOSSY,
    PACKED,
    SMALL,
    TUM,
    VIDEO,
    as_nerfstudio,
    as_plain,
    as_plain_files,
    as_polycam,
    as_polycam_uncorrected,
    as_record3d,
    as_stray_of_one_camera,
    as_tum,
    doubted,
    layouts,
    walk,
)
from addon_tests.pure.test_estimate_command import read_strictly
from xihe_blender.cli import replay as replay_command
from xihe_blender.cli.main import main
from xihenet import estimators
from xihenet.captures import open_capture
from xihenet.captures.capture import inside
from xihenet.captures.reading import READERS
from xihenet.captures.reading.values import rotation_of
from xihenet.captures.replay import never_in_view, replay
from xihenet.captures.writing.pictures import in_y_up
from xihenet.records import Intrinsics

AT = (0.4, 0.3, -0.5)
Y_UP = ("Record3D", "Stray Scanner", "Polycam")


@pytest.fixture(scope="module", params=layouts())
def recorded(request, tmp_path_factory):
    """Format, frames, and what to open."""
    write, intrinsics = LAYOUTS[request.param]
    frames = walk(intrinsics)
    return request.param.split(",")[0], frames, write(tmp_path_factory.mktemp("recorded"), frames)


def test_every_format_is_written_by_a_test_and_read_back_sound_and_broken():
    assert set(FORMATS) == set(READERS) == {name.split(",")[0] for name in LAYOUTS} | {"Xihe session"}


def test_what_is_read_is_what_was_seen(recorded):
    name, frames, path = recorded
    capture = open_capture(path)
    assert capture.format_name == name and len(capture.frames) == len(frames)
    if name != "7-Scenes":  # Of which test_floor.py asks it.
        of_file = in_y_up(np.eye(4))[:3, :3] if name in Y_UP else np.eye(3)
        np.testing.assert_array_equal(capture.blender_from_file @ of_file, np.eye(3))
    # Where up is the floor's normal, the world is turned by what rounding moves that.
    first = next(iter(capture)).world_from_camera[:3, :3] @ frames[0].world_from_camera[:3, :3].T
    turn = first if name == "7-Scenes" else np.eye(3)
    assert np.degrees(np.arccos(np.clip(turn[2, 2], -1, 1))) < 0.2
    for read, made in zip(capture, frames, strict=True):
        assert read.frame - made.frame == capture.frames[0].number - 1
        off = np.abs(read.srgb_u8.astype(float) - made.srgb_u8)
        assert off.mean() <= LOSSY.get(name, 0.0) and np.median(off) <= (2 if name in LOSSY else 0)
        np.testing.assert_allclose(read.plane_depth_m, made.plane_depth_m, atol=6e-4)
        np.testing.assert_allclose(read.world_from_camera[:3], turn @ made.world_from_camera[:3], atol=1e-5)
        assert vars(read.intrinsics) == pytest.approx(vars(made.intrinsics))
        assert read.time_s == pytest.approx(made.time_s, abs=1e-4)


def test_pictures_of_tums_own_size_are_read_with_its_own_intrinsics(tmp_path):
    (made,) = walk(TUM, 1)
    (read,) = open_capture(as_tum(tmp_path, [made]))
    assert not (tmp_path / "camera.json").exists()  # It stands beside other intrinsics than the benchmark's.
    assert read.intrinsics == made.intrinsics and (read.srgb_u8 == made.srgb_u8).all()
    np.testing.assert_allclose(read.plane_depth_m, made.plane_depth_m, atol=6e-4)


def test_pictures_of_another_size_than_tums_are_told_to_bring_their_own_camera(tmp_path):
    k = Intrinsics(848, 480, 600.0, 600.0, 424.0, 240.0)
    as_tum(tmp_path, walk(k, 1))
    assert vars(next(iter(open_capture(tmp_path))).intrinsics) == pytest.approx(vars(k))
    (tmp_path / "camera.json").unlink()
    with pytest.raises(ValueError, match=r"have 848x480 pixels.*640x480\. For another camera, write its"):
        open_capture(tmp_path)


def test_the_light_is_that_of_the_session_itself(tmp_path):
    whole = open_capture(as_polycam(tmp_path / "in", walk(SMALL)))
    typed = ",".join(f"{value:.9g}" for value in whole.blender_from_file.T @ AT)  # +Y is up there.
    asked = [f"--at={typed}", "--out", str(tmp_path), "--to", "three"]
    assert main(["replay", str(tmp_path / "in"), *asked]) == 0
    written = read_strictly((tmp_path / "replay.json").read_text())
    lights = written["positions"][0]["lights"]
    assert written["blender_from_recording"] == whole.blender_from_file.tolist()
    positions_m = {"place_0": np.array(AT)}
    unseen = never_in_view(whole, positions_m)
    lattice = estimators.load("lattice", target="hdr")
    steps = list(replay(list(whole), positions_m, lattice, has_key_light=True, never_in_view=unseen))
    fired = [step.frame for step in steps if "place_0" in step.reports and step.reports["place_0"].decision.fire]
    assert written["format"] == "Polycam" and [light["frame"] for light in lights] == fired
    for light, step in zip(lights, [step for step in steps if step.frame in fired], strict=True):
        true = step.reports["place_0"].estimate.sh_radiance
        assert np.abs(np.array(light["sh_radiance"]) - true).max() < 1e-3 * np.abs(true).max()
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Polycam" in page and page.count("data:image/png") == 2 + len(whole.frames)
    exported = read_strictly((tmp_path / "three" / "three.json").read_text())["lights"]
    assert [light["frame"] for light in exported] == fired and (tmp_path / "place_0.png").is_file()
    assert all((tmp_path / "three" / light["reflections"]).is_file() for light in exported)


@pytest.mark.parametrize("name", layouts(["Record3D", "Stray Scanner", "Polycam", "plain folder"]))
def test_depth_that_the_sensor_doubts_is_left_out_and_counted(tmp_path, name):
    write, intrinsics = LAYOUTS[name]
    (read,) = open_capture(write(tmp_path, made := doubted(walk(intrinsics, 1))))
    doubts = made[0].confidence == 0
    assert read.invalid == {"low_confidence": doubts.sum()} and (read.confidence == made[0].confidence).all()
    assert not read.plane_depth_m[doubts].any() and (read.plane_depth_m[~doubts] > 0).all()


@pytest.mark.parametrize("name", layouts([name for name in LAYOUTS if "," not in name]))
def test_a_frame_that_shows_nothing_is_read_as_one(tmp_path, name):
    write, intrinsics = LAYOUTS[name]
    nothing = [replace(frame, plane_depth_m=frame.plane_depth_m * 0) for frame in walk(intrinsics, 2)]
    path = write(tmp_path / "in", nothing)
    assert main(["replay", str(path), "--at", "0,0,0", "--out", str(tmp_path / "out")]) == 0


@pytest.mark.parametrize(("is_doubted", "why"), [(False, "no distance was measured"), (True, "the sensor itself says")])
def test_where_no_light_can_be_known_replay_says_why(tmp_path, capfd, is_doubted, why):
    frames = walk(SMALL, 2)
    if is_doubted:
        dark = [replace(frame, confidence=np.zeros(frame.plane_depth_m.shape, np.uint8)) for frame in frames]
    else:
        dark = [replace(frame, plane_depth_m=frame.plane_depth_m * 0) for frame in frames]
    path = as_plain(tmp_path / "in", dark)
    assert (
        main(["replay", str(path), "--at", "0,0,0", "--out", str(tmp_path / "out"), "--estimator", "projection"]) == 0
    )
    said = capfd.readouterr().out.splitlines()[-1]
    assert said.startswith("0,0,0: no light could be known in 2 frames: no surface was seen from there; 6144 points")
    assert why in said
    (place,) = read_strictly((tmp_path / "out" / "replay.json").read_text())["positions"]
    assert place["unknown"] == {"nothing_seen": 2}
    assert ">2 frames</span>" in (tmp_path / "out" / "report.html").read_text()


def test_replay_warns_of_a_place_that_lies_behind_what_every_frame_shows_there_or_in_view_of_none(tmp_path, capfd):
    frames = walk(SMALL, 3)
    near, far, unseen = (frames[0].world_from_camera @ [0, 0, -metres, 1] for metres in (0.3, 50.0, -30.0))
    places = [",".join(f"{value:.6f}" for value in place[:3]) for place in (near, far, unseen)]
    command = ["replay", str(as_plain(tmp_path / "in", frames)), *(f"--at={place}" for place in places)]
    assert main([*command, "--out", str(tmp_path / "out"), "--estimator", "ambient"]) == 0
    said = capfd.readouterr().err.splitlines()
    assert len([line for line in said if "is in view of no frame" in line and "check --at" in line]) == 1
    warned = [line for line in said if "lies behind" in line]
    assert len(warned) == 1 and "check --at" in warned[0]
    assert warned[0].split()[4].startswith(f"{far[0]:g}"[:4])


def test_frames_that_are_kept_are_read_once_and_the_others_as_often_as_asked(tmp_path):
    n_read = []
    capture = open_capture(as_tum(tmp_path, walk(TUM, 4)))
    counted = [replace(one, load=lambda one=one: n_read.append(one.number) or one.load()) for one in capture.frames]
    of_one = sum(getattr(value, "nbytes", 0) for value in vars(capture.frames[0].load()).values())
    kept = replace(capture, frames=counted).kept_once_read(2 * of_one)
    numbers = [frame.number for frame in capture.frames]
    for _ in range(2):
        for found, expected in zip(kept, capture, strict=True):
            assert found.frame == expected.frame and found.time_s == expected.time_s
            np.testing.assert_array_equal(found.srgb_u8, expected.srgb_u8)
            np.testing.assert_array_equal(found.plane_depth_m, expected.plane_depth_m)
    assert n_read == [*numbers, *numbers[2:]]


def test_a_long_replay_says_how_far_it_is(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(replay_command, "SHOWN_EVERY_S", 0.0)
    path = as_plain(tmp_path / "in", walk(SMALL, 3))
    assert main(["replay", str(path), "--at", "0,0,1", "--out", str(tmp_path / "out"), "--estimator", "ambient"]) == 0
    said = [line.partition(", ")[::2] for line in capfd.readouterr().err.splitlines() if "%" in line]
    assert [purpose for purpose, _ in said] == [
        "  0%  following the exposure",
        " 17%  following the exposure",
        " 33%  following the exposure",
        " 50%  estimating light",
        " 67%  estimating light",
        " 83%  estimating light",
        "100%  all frames read",
    ]
    assert [left.partition(",")[0] for _, left in said[:6]] == 2 * ["frame 1 of 3", "frame 2 of 3", "frame 3 of 3"]
    assert main(["replay", str(path), "--score", "--drift", "ignored", "--out", str(tmp_path / "scored")]) == 0
    said = [line for line in capfd.readouterr().err.splitlines() if "%" in line]
    assert len(said) == 12 + 3 + 1 and "choosing places, frame 12 of 12" in said[11] and "frame 1 of 3" in said[12]


@pytest.mark.parametrize(("stored", "named"), [("NFD", "NFC"), ("NFC", "NFD"), ("NFD", "NFD")])
def test_names_with_accents_are_found_in_either_form(tmp_path, stored, named):
    there = tmp_path / unicodedata.normalize(stored, "Küche/Gerät ä.png")
    there.parent.mkdir()
    there.touch()
    assert inside(tmp_path, unicodedata.normalize(named, "Küche/Gerät ä.png")).is_file()
    assert not inside(tmp_path, "Küche/ö.png").exists() and not inside(tmp_path, "é/ö.png").exists()
    with pytest.raises(ValueError, match="lies outside"):
        inside(there.parent, "../é/../../ö.png")


def test_names_with_the_separators_of_windows_are_found_where_there_are_others(tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "ä.png").touch()
    assert inside(tmp_path, ".\\images\\ä.png").is_file()
    for whole in ("C:\\walk\\images\\ä.png", "C:/walk/images/ä.png", "\\\\server\\walk\\images\\ä.png"):
        assert inside(tmp_path, whole) == tmp_path / "images" / "ä.png"
    (tmp_path / "ä.png").touch()
    for other in ("C:\\walk\\ä.png", "C:\\walk\\depth\\ä.png"):
        with suppress(ValueError):  # On Windows they lie outside.
            assert not inside(tmp_path, other).exists()
    with pytest.raises(ValueError, match=r"lies outside .*: copy the file there"):
        inside(tmp_path, "..\\images\\ä.png")


def test_pictures_with_accents_that_are_copied_later_are_found(tmp_path):
    as_nerfstudio(tmp_path, walk(SMALL, 2))
    said = json.loads((tmp_path / "transforms.json").read_text())
    picture = tmp_path / said["frames"][1]["file_path"]
    said["frames"][1]["file_path"] = "ä.png"
    (tmp_path / "transforms.json").write_text(json.dumps(said))
    assert len(open_capture(tmp_path).frames) == 1
    picture.rename(tmp_path / unicodedata.normalize("NFD", "ä.png"))
    assert len(open_capture(tmp_path).frames) == 2


def test_files_of_a_plain_folder_belong_together_in_either_form_of_their_accents(tmp_path):
    as_plain_files(tmp_path, walk(SMALL, 2))
    for number, name in enumerate(("colour", "depth", "confidence", "poses")):
        for path in list((tmp_path / name).iterdir()):
            path.rename(path.with_stem(unicodedata.normalize(("NFC", "NFD")[number % 2], f"Gerät {path.stem}")))
    capture = open_capture(str(tmp_path))
    assert len(capture.frames) == 2 and not any("left out" in note or "confidence" in note for note in capture.notes)


def test_frames_can_be_left_out_and_missing_pictures_are_counted(tmp_path):
    frames = walk(LAYOUTS["Nerfstudio"][1])
    as_nerfstudio(tmp_path, frames)
    (tmp_path / "depth" / "2.png").unlink()
    capture = open_capture(tmp_path)
    assert [frame.number for frame in capture.frames] == [1, 3, 4, 5, 6]
    assert "1 frame without colour or depth left out." in capture.notes
    assert main(["replay", str(tmp_path), "--at", "0,0,0", "--out", str(tmp_path / "out"), "--every", "2"]) == 0
    replayed = read_strictly((tmp_path / "out" / "replay.json").read_text())["frames"]
    assert [one["frame"] for one in replayed] == [1, 4, 6]


@PACKED
def test_an_unpacked_r3d_file_is_told_to_be_given_as_it_was(tmp_path):
    with zipfile.ZipFile(as_record3d(tmp_path, walk(SMALL, 1))) as file:
        file.extractall(tmp_path / "unpacked")
    with pytest.raises(ValueError, match=r"unpacked is an unpacked \.r3d file: give that file, or a zip of"):
        open_capture(tmp_path / "unpacked")


@pytest.mark.parametrize("name", layouts(["Record3D", "Nerfstudio"]))
def test_a_folder_around_a_recording_says_which_one_is_in_it(tmp_path, name):
    write, intrinsics = LAYOUTS[name]
    path = write(tmp_path / "recorded", walk(intrinsics, 2))
    with pytest.raises(ValueError, match="holds no recording itself: give ") as said:
        open_capture(path.parent)
    assert str(path) in str(said.value)


def test_record3ds_export_of_exr_is_told_to_be_exported_as_r3d(tmp_path):
    for name in ("metadata.json", "rgb/0.jpg", "depth/0.exr"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    with pytest.raises(ValueError, match=r"exports as EXR and JPG: export the recording as \.r3d instead"):
        open_capture(tmp_path)
    as_nerfstudio(tmp_path, walk(SMALL, 1))  # Converted where it lies.
    assert len(open_capture(tmp_path).frames) == 1


@PACKED
def test_a_camera_of_record3d_that_stands_still_is_not_taken_for_one_without_poses(tmp_path):
    still = [replace(walk(SMALL, 1)[0], time_s=number / 30) for number in range(3)]
    assert not any("record with LiDAR" in note for note in open_capture(as_record3d(tmp_path, still)).notes)


@pytest.mark.parametrize(("write", "part"), [(as_nerfstudio, "transforms.json"), (as_polycam, "keyframes")])
def test_a_part_of_a_recording_says_which_folder_to_give(tmp_path, write, part):
    write(tmp_path, walk(SMALL, 1))
    with pytest.raises(ValueError, match=f"{part} is a part of a recording: give ") as said:
        open_capture(tmp_path / part)
    assert str(said.value).endswith(f"give {tmp_path}")


def test_colour_goes_with_the_depth_and_pose_next_to_it_in_time(tmp_path):
    frames = walk(LAYOUTS["TUM RGB-D"][1], 3)
    as_tum(tmp_path, frames)
    late = (tmp_path / "groundtruth.txt").read_text().splitlines()[:3]
    (tmp_path / "groundtruth.txt").write_text("\n".join(late))
    capture = open_capture(tmp_path)
    assert [frame.number for frame in capture.frames] == [1]
    assert any("2 frames without colour, depth or a pose" in note for note in capture.notes)


def test_a_pose_between_two_is_as_near_to_either_whatever_the_lengths_of_their_quaternions(tmp_path):
    as_tum(tmp_path, walk(LAYOUTS["TUM RGB-D"][1], 1))
    time_s = float((tmp_path / "rgb.txt").read_text().splitlines()[-1].split()[0])
    around = f"{time_s - 0.01} 0 0 0 0 0 0 1\n{time_s + 0.01} 0 0 0 0 0 10 10\n"  # A quarter turn about +Z
    (tmp_path / "groundtruth.txt").write_text(around)
    across = open_capture(tmp_path).frames[0].camera.world_from_camera[:3, 0]
    np.testing.assert_allclose(across, [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-6)


@VIDEO
def test_the_oldest_recordings_of_stray_scanner_have_a_line_for_each_picture_and_no_times(tmp_path):
    frames = walk(SMALL, 3)
    path = as_stray_of_one_camera(tmp_path, frames) / "odometry.csv"
    path.write_text("\n".join(line.split(", ", 2)[2] for line in path.read_text().splitlines()))
    capture = open_capture(tmp_path)
    assert [frame.number for frame in capture.frames] == [0, 1, 2]
    np.testing.assert_allclose([frame.time_s for frame in capture.frames], np.arange(3) / 60)
    np.testing.assert_allclose(capture.frames[2].read().world_from_camera, frames[2].world_from_camera, atol=1e-5)
    assert "Times are not known: 60 frames a second are assumed." in capture.notes


def test_corrected_cameras_of_polycam_have_the_size_of_the_others_where_they_say_none(tmp_path):
    frames = walk(SMALL, 2)
    for path in (as_polycam(tmp_path, frames) / "keyframes" / "corrected_cameras").iterdir():
        said = json.loads(path.read_text())
        path.write_text(json.dumps({name: value for name, value in said.items() if name not in ("width", "height")}))
    for read, made in zip(open_capture(tmp_path), frames, strict=True):
        assert vars(read.intrinsics) == pytest.approx(vars(made.intrinsics))
        np.testing.assert_allclose(read.world_from_camera, made.world_from_camera, atol=1e-6)


def test_cameras_of_polycam_count_where_the_folder_of_corrected_ones_is_empty(tmp_path):
    (as_polycam_uncorrected(tmp_path, walk(SMALL, 2)) / "keyframes" / "corrected_cameras").mkdir()
    capture = open_capture(tmp_path)
    assert len(capture.frames) == 2 and not any("corrected" in note for note in capture.notes)


def test_a_name_without_an_ending_is_that_of_a_png_as_of_instant_ngp(tmp_path):
    path = as_nerfstudio(tmp_path, walk(SMALL, 2)) / "transforms.json"
    path.write_text(path.read_text().replace('"file_path": "images/1.png"', '"file_path": "images/1"'))
    capture = open_capture(tmp_path)
    assert [frame.picture.name for frame in capture.frames] == ["1.png", "2.png"]


def test_depth_of_nerfstudio_may_be_npy_and_exr_is_told_to_be_saved_as_png(tmp_path):
    frames = walk(SMALL, 2)
    path = as_nerfstudio(tmp_path, frames) / "transforms.json"
    path.write_text(path.read_text().replace("depth/1.png", "depth/1.npy").replace("depth/2.png", "depth/2.exr"))
    np.save(tmp_path / "depth" / "1.npy", frames[0].plane_depth_m * 1000)
    (tmp_path / "depth" / "2.exr").touch()
    capture = open_capture(tmp_path)
    np.testing.assert_allclose(capture.frames[0].read().plane_depth_m, frames[0].plane_depth_m, rtol=1e-6)
    with pytest.raises(ValueError, match=r"2\.exr: plane depth alone is not read from OpenEXR: save it in whole"):
        capture.frames[1].read()


def test_of_nerfstudio_it_is_said_that_z_is_taken_to_be_up_unless_up_is_given(tmp_path):
    as_nerfstudio(tmp_path, walk(SMALL, 1))
    assert [any("give --up y" in note for note in open_capture(tmp_path, up).notes) for up in (None, "y")] == [1, 0]


@pytest.mark.parametrize("unit", ["depth_unit_scale_factor", "integer_depth_scale"])
def test_depth_of_nerfstudio_is_in_the_unit_that_the_file_says(tmp_path, unit):
    frames = walk(SMALL, 2)
    path = as_nerfstudio(tmp_path, frames) / "transforms.json"
    path.write_text(path.read_text().replace("depth_file_path", "depth_path").replace("{", f'{{"{unit}": 0.002, ', 1))
    np.testing.assert_allclose(open_capture(tmp_path).frames[0].read().plane_depth_m, 2 * frames[0].plane_depth_m, 0.01)


def test_frames_of_nerfstudio_follow_each_other_by_the_names_of_their_pictures(tmp_path):
    frames = walk(SMALL, 11)
    path = as_nerfstudio(tmp_path, frames) / "transforms.json"
    said = json.loads(path.read_text())
    path.write_text(json.dumps(said | {"frames": said["frames"][1::2] + said["frames"][::2]}))  # As COLMAP matched them
    capture = open_capture(tmp_path)
    assert [frame.number for frame in capture.frames] == list(range(1, 12))
    for one, made in zip(capture.frames, frames, strict=True):
        np.testing.assert_allclose(one.camera.world_from_camera, made.world_from_camera)


def test_places_that_nerfstudio_scaled_are_metres_again(tmp_path):
    path = as_nerfstudio(tmp_path, walk(LAYOUTS["Nerfstudio"][1], 2)) / "transforms.json"
    said, places = json.loads(path.read_text()), []
    for scale in (1.0, 0.25):
        for frame in said["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] *= scale
        path.write_text(json.dumps(said | {"applied_scale": scale}))
        places.append([frame.camera.world_from_camera for frame in open_capture(tmp_path).frames])
    np.testing.assert_allclose(*places)


TEXTUAL = [name for name in LAYOUTS if not name.startswith("Record3D")]


@pytest.mark.parametrize("name", layouts(TEXTUAL))
def test_text_may_begin_with_a_byte_order_mark_as_windows_writes_it(tmp_path, name):
    write, intrinsics = LAYOUTS[name]
    frames = walk(intrinsics, 2)
    path = write(tmp_path / "recorded", frames)
    texts = [one for one in path.rglob("*") if one.suffix in (".json", ".txt", ".csv")]
    assert texts
    for text in texts:
        text.write_bytes(b"\xef\xbb\xbf" + text.read_bytes())
    assert [frame.camera.world_from_camera.shape for frame in open_capture(path).frames] == [(4, 4)] * 2


@pytest.mark.parametrize("name", layouts(TEXTUAL))
def test_what_macos_and_windows_put_beside_files_is_no_part_of_a_recording(tmp_path, name):
    write, intrinsics = LAYOUTS[name]
    path = write(tmp_path / "recorded", walk(intrinsics, 2))
    for one in (path, *path.rglob("*")):
        beside = one / ".DS_Store" if one.is_dir() else one.with_name(f"._{one.name}")  # The second on other disks.
        beside.write_bytes(b"\x00\x05\x16\x07\x00\x02")
        if one.is_dir():
            (one / "Thumbs.db").touch()
    assert len([frame.read() for frame in open_capture(path).frames]) == 2


@pytest.mark.parametrize("seed", range(6))
def test_a_quaternion_is_a_rotation_whatever_its_length(seed):
    quaternion = np.random.default_rng(seed).normal(size=4) * 3
    rotation = rotation_of(quaternion)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1) and np.allclose(rotation, rotation_of(-quaternion))


def test_a_file_that_is_only_named_like_a_pose_of_7_scenes_is_no_recording(tmp_path):
    (tmp_path / "frame-first.pose.txt").touch()
    with pytest.raises(ValueError, match="holds no recording that is known"):
        open_capture(tmp_path)
