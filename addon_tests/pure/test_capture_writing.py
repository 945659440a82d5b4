"""What is written in the layouts of others, read by other means than our readers: zip, CSV, JSON, Pillow, PyAV."""

import csv
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from addon_tests.pure import made
from addon_tests.pure.commands import fresh_python
from addon_tests.pure.recordings import PACKED, SMALL, TUM, UPRIGHT, VIDEO, doubted, walk
from xihenet.camera import unproject_frame
from xihenet.captures import open_capture
from xihenet.captures.writing import WRITERS, nerfstudio, record3d, stray, tum


def points_of(depth_m, fx, fy, cx, cy, pose, looks_down_z):
    """(P, 3) in the pose's world, the long way: a loop over pixels, as a tool of others would do it."""
    points = []
    for row in range(depth_m.shape[0]):
        for column in range(depth_m.shape[1]):
            z = float(depth_m[row, column])
            x, y = (column + 0.5 - cx) / fx * z, (row + 0.5 - cy) / fy * z
            points.append(pose @ ([x, -y, -z, 1] if looks_down_z else [x, y, z, 1]))
    return np.array(points)[:, :3]


def pose_of(place, q):
    """`q` is x, y, z, w, of length 1 as every tool expects it."""
    assert np.linalg.norm(q) == pytest.approx(1, abs=1e-5)
    return made.pose_of(Rotation.from_quat(q).as_matrix(), place)


def z_up(points):
    """ARKit's world has +Y up."""
    return points[:, [0, 2, 1]] * [1, -1, 1]


@PACKED
@pytest.mark.parametrize("intrinsics", [SMALL, UPRIGHT])
def test_a_record3d_file_opens_by_hand(tmp_path, intrinsics):
    import lzfse

    frames = [replace(frame, time_s=15 * frame.time_s) for frame in doubted(walk(intrinsics, 3))]  # Two a second
    assert record3d.write(tmp_path / "a.r3d", frames).n_frames == 3
    with zipfile.ZipFile(tmp_path / "a.r3d") as file:
        assert file.testzip() is None and not list(tmp_path.glob(".*"))
        said = json.loads(file.read("metadata"))
        k = np.array(said["K"]).reshape(3, 3).T
        assert (said["w"], said["h"]) == (intrinsics.width * 4, intrinsics.height * 4)
        assert said["poses"][0] == pytest.approx([0, 0, 0, 1, 0, 0, 0], abs=1e-6)
        assert [n / said["fps"] for n in range(len(frames))] == pytest.approx([frame.time_s for frame in frames])
        for n, frame in enumerate(frames):
            depth = np.frombuffer(lzfse.decompress(file.read(f"rgbd/{n}.depth")), np.float32)
            depth = depth.reshape(intrinsics.height, intrinsics.width)
            conf = np.frombuffer(lzfse.decompress(file.read(f"rgbd/{n}.conf")), np.uint8)
            assert (conf.reshape(depth.shape) == frame.confidence).all()
            with file.open(f"rgbd/{n}.jpg") as stored:
                assert Image.open(stored).size == (said["w"], said["h"])
            start, pose = (pose_of(row[4:], row[:4]) for row in (said["initPose"], said["poses"][n]))
            scale = depth.shape[1] / said["w"]
            seen = points_of(depth, *(k[[0, 1, 0, 1], [0, 1, 2, 2]] * scale), start @ pose, looks_down_z=True)
            np.testing.assert_allclose(z_up(seen), unproject_frame(frame).points_m, atol=1e-5)


@VIDEO
def test_a_folder_of_stray_scanner_opens_by_hand(tmp_path):
    import av

    frames = doubted(walk(SMALL, 3))
    stray.write(tmp_path, frames)
    with (tmp_path / "odometry.csv").open(newline="") as file:
        rows = list(csv.DictReader(file, skipinitialspace=True))
    with (tmp_path / "camera_matrix.csv").open(newline="") as file:
        k = np.array([[float(cell) for cell in row] for row in csv.reader(file)])
    with av.open(str(tmp_path / "rgb.mp4")) as video:
        assert video.streams.video[0].codec_context.name in ("hevc", "h264")
        pictures = [picture.to_ndarray(format="rgb24") for picture in video.decode(video=0)]
    for row, frame, picture in zip(rows, frames, pictures, strict=True):
        depth = np.asarray(Image.open(tmp_path / "depth" / f"{row['frame']}.png"))
        assert depth.dtype == np.uint16
        confidence = np.asarray(Image.open(tmp_path / "confidence" / f"{row['frame']}.png"))
        assert (confidence == frame.confidence).all() and float(row["fx"]) == k[0, 0]
        pose = pose_of(*([float(row[name]) for name in names] for names in (("x", "y", "z"), ("qx", "qy", "qz", "qw"))))
        seen = points_of(depth / 1000, *(k[[0, 1, 0, 1], [0, 1, 2, 2]] / 4), pose, looks_down_z=False)
        np.testing.assert_allclose(z_up(seen), unproject_frame(frame).points_m, atol=2e-3)
        assert np.abs(picture[::4, ::4].astype(float) - frame.srgb_u8).mean() < 5


def test_nerfstudio_and_tum_open_by_hand(tmp_path):
    frames = walk(SMALL, 2)
    nerfstudio.write(tmp_path / "n", frames)
    said = json.loads((tmp_path / "n/transforms.json").read_text())
    for entry, frame in zip(said["frames"], frames, strict=True):
        with Image.open(tmp_path / "n" / entry["file_path"]) as colour:
            assert colour.size == (said["w"], said["h"]) == (64, 48)
        depth = np.asarray(Image.open(tmp_path / "n" / entry["depth_file_path"])) / 1000
        k = np.array([said["fl_x"], said["fl_y"], said["cx"], said["cy"]])
        seen = points_of(depth, *k, np.array(entry["transform_matrix"]), looks_down_z=True)
        np.testing.assert_allclose(seen, unproject_frame(frame).points_m, atol=2e-3)
    tum.write(tmp_path / "t", frames := walk(TUM, 1))
    pose = np.loadtxt(tmp_path / "t/groundtruth.txt")[1:]
    name = (tmp_path / "t/depth.txt").read_text().split()[-1]
    depth = np.asarray(Image.open(tmp_path / "t" / name))[::40, ::40] / 5000
    seen = points_of(
        depth, 525 / 40, 525 / 40, 320 / 40 + 0.4875, 240 / 40 + 0.4875, pose_of(pose[:3], pose[3:]), False
    )
    whole = unproject_frame(frames[0]).points_m.reshape(480, 640, 3)[::40, ::40].reshape(-1, 3)
    np.testing.assert_allclose(seen, whole, atol=2e-3)


def test_intrinsics_may_change_from_frame_to_frame(tmp_path):
    frames = [replace(f, intrinsics=replace(f.intrinsics, fx=40.0 + f.frame)) for f in walk(SMALL, 3)]
    nerfstudio.write(tmp_path, frames)
    assert [frame.camera.intrinsics.fx for frame in open_capture(tmp_path).frames] == [41.0, 42.0, 43.0]


def test_depth_that_a_layout_cannot_hold_is_counted_and_left_out(tmp_path):
    far = [replace(f, plane_depth_m=f.plane_depth_m * np.linspace(1, 60, 64)) for f in walk(SMALL, 1)]
    n_far = int((far[0].plane_depth_m > 65.5345).sum())
    assert nerfstudio.write(tmp_path, far).n_unheld == n_far > 0
    assert next(iter(open_capture(tmp_path))).invalid == {"no_distance": n_far}
    near = [replace(f, plane_depth_m=f.plane_depth_m * np.where(np.arange(64) < 5, 1e-4, 1)) for f in walk(SMALL, 1)]
    n_near = int((near[0].plane_depth_m < 5e-4).sum())
    assert nerfstudio.write(tmp_path, near).n_unheld == n_near > 0
    assert next(iter(open_capture(tmp_path))).invalid == {"no_distance": n_near}


@pytest.mark.parametrize("name", [pytest.param("record3d", marks=PACKED), pytest.param("stray", marks=VIDEO)])
def test_frames_of_several_sizes_or_none_are_refused(tmp_path, name):
    with pytest.raises(ValueError, match="frames of one size"):
        WRITERS[name](tmp_path / "a", [*walk(SMALL, 1), *walk(UPRIGHT, 1)])
    with pytest.raises(ValueError, match="at least one frame"):
        WRITERS[name](tmp_path / "b", [])
    assert not (tmp_path / "a").is_file() and not (tmp_path / "b").is_file() and not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("numbers", [(-10, -9, -1, 0, 10), (0, 0, 0, 0, 0)])
def test_frames_keep_their_order_as_nerfstudio_whatever_their_numbers_are(tmp_path, numbers):
    frames = [replace(frame, frame=number) for frame, number in zip(walk(SMALL, 5), numbers, strict=True)]
    nerfstudio.write(tmp_path, frames)
    for one, other in zip(frames, open_capture(tmp_path), strict=True):
        np.testing.assert_allclose(other.world_from_camera, one.world_from_camera, atol=1e-12)
        np.testing.assert_array_equal(other.srgb_u8, one.srgb_u8)


@pytest.mark.parametrize("x_axis", [(-1, 0, 0), (0.8, 0.6, 0)])
@pytest.mark.parametrize("name", ["tum", pytest.param("record3d", marks=PACKED), pytest.param("stray", marks=VIDEO)])
def test_cameras_that_mirror_or_shear_are_refused_where_poses_are_quaternions(tmp_path, name, x_axis):
    frame = walk(SMALL, 1)[0]
    pose = frame.world_from_camera.copy()
    pose[:3, 0] = pose[:3, :3] @ x_axis
    with pytest.raises(ValueError, match="mirrored or sheared"):
        WRITERS[name](tmp_path / "a", [replace(frame, world_from_camera=pose)])


def test_what_tum_has_no_place_for_is_refused(tmp_path):
    with pytest.raises(ValueError, match="its intrinsics change"):
        tum.write(tmp_path, [*walk(SMALL, 1), *walk(TUM, 1)])
    with pytest.raises(ValueError, match="times that rise"):
        tum.write(tmp_path, [replace(frame, time_s=1.0) for frame in walk(TUM, 2)])


def test_the_camera_of_another_tum_recording_lies_beside_it(tmp_path):
    frames = walk(SMALL, 2)
    tum.write(tmp_path, frames)
    capture = open_capture(tmp_path)
    assert capture.frames[0].camera.intrinsics == SMALL and not capture.notes
    np.testing.assert_allclose(capture.frames[1].read().plane_depth_m, frames[1].plane_depth_m, atol=1.1e-4)
    (tmp_path / "camera.json").write_text("[]")
    with pytest.raises(ValueError, match=r"camera\.json: expected a JSON object"):
        open_capture(tmp_path)
    tum.write(tmp_path, walk(TUM, 2))
    assert open_capture(tmp_path).frames[0].camera.intrinsics == TUM


@PACKED
def test_without_their_packages_the_extra_to_install_is_named(tmp_path):
    stray.write(tmp_path / "s", walk(SMALL, 1))
    record3d.write(tmp_path / "a.r3d", walk(SMALL, 1))
    code = (
        "import sys; sys.modules['av'] = sys.modules['lzfse'] = None\n"
        "from xihe_blender.cli.main import main\n"
        f"print(*(main(['replay', path, '--at', '0,0,0', '--out', {str(tmp_path / 'out')!r}])"
        f" for path in {[str(tmp_path / 's'), str(tmp_path / 'a.r3d')]}))"
    )
    done = fresh_python(code)
    lines = done.stderr.splitlines()
    assert done.stdout.split() == ["2", "2"] and len(lines) == 2
    assert all("pip install 'xihe-blender[captures]'" in line for line in lines)
