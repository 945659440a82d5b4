"""A walk through a room of coloured walls, ray-cast here, and recordings of it in the layouts that others write."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from addon_tests.pure.made import pose_of
from xihenet.captures.reading.values import quaternion_of
from xihenet.captures.writing import nerfstudio, record3d, stray, tum
from xihenet.captures.writing.pictures import confidence_of, enlarged, in_y_up, save_depth
from xihenet.records import Intrinsics, RgbdFrame

HALF = np.array([2.0, 1.5, 1.2])
WALLS = np.array([[(180, 60, 50), (60, 160, 70)], [(70, 80, 190), (200, 190, 60)], [(120, 110, 100), (225, 220, 210)]])
"""sRGB by axis: at its lower and at its upper end."""


def looking(azimuth, pitch, place):
    """(4, 4) of a camera, Blender's axes: along its own -Z, +Y up."""
    forward = np.array([np.cos(azimuth) * np.cos(pitch), np.sin(azimuth) * np.cos(pitch), np.sin(pitch)])
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    return pose_of(np.stack([right, np.cross(right, forward), -forward], axis=1), place)


def seen(intrinsics, pose, number=1, time_s=0.0):
    """The room from a pose within it."""
    k = intrinsics
    x, y = np.meshgrid((np.arange(k.width) + 0.5 - k.cx) / k.fx, (np.arange(k.height) + 0.5 - k.cy) / k.fy)
    rays = np.stack([x, -y, -np.ones_like(x)], axis=-1) @ pose[:3, :3].T
    with np.errstate(divide="ignore"):  # A ray along a wall never meets it: the infinite reach loses to another wall.
        reach = (np.where(rays > 0, HALF, -HALF) - pose[:3, 3]) / rays
    axis = reach.argmin(axis=-1)
    ends = (np.take_along_axis(rays, axis[..., None], -1)[..., 0] > 0).astype(int)
    return RgbdFrame(
        WALLS[axis, ends].astype(np.uint8), reach.min(axis=-1).astype(np.float32), k, pose, frame=number, time_s=time_s
    )


def walk(intrinsics, n=6):
    """Frames of a walk that turns once around."""
    poses = [looking(2 * np.pi * i / n, 0.3 * np.sin(i), (0.3 * np.cos(i), 0.2 * np.sin(i), 0.1)) for i in range(n)]
    return [seen(intrinsics, pose, 1 + i, i / 30) for i, pose in enumerate(poses)]


def opencv(pose):
    return pose @ np.diag([1.0, -1.0, -1.0, 1.0])


def as_nerfstudio(folder, frames):
    nerfstudio.write(folder, frames)
    return folder


def as_record3d(folder, frames):
    record3d.write(folder / "walk.r3d", frames)
    return folder / "walk.r3d"


def as_stray(folder, frames):
    stray.write(folder, frames)
    return folder


def as_stray_of_one_camera(folder, frames):
    """Intrinsics in camera_matrix.csv alone."""
    odometry = as_stray(folder, frames) / "odometry.csv"
    lines = [line.split(", ")[:9] for line in odometry.read_text().splitlines()]
    odometry.write_text("".join(", ".join(line) + "\n" for line in lines))
    return folder


def as_older_stray(folder, frames):
    as_stray_of_one_camera(folder, frames)
    for path in (folder / "depth").glob("*.png"):
        np.save(path.with_suffix(".npy"), np.asarray(Image.open(path)))
        path.unlink()
    return folder


def as_tum(folder, frames):
    """As the benchmark has it: depth comes a little later than colour, and poses come more often than both."""
    tum.write(folder, frames)
    later = {"depth.txt": (0.008,), "groundtruth.txt": (-0.004, 0.004)}
    for name, shifts in later.items():
        head, *lines = (folder / name).read_text().splitlines()
        rows = [line.split(maxsplit=1) for line in lines]
        shifted = [f"{float(time_s) + shift:.4f} {said}" for time_s, said in rows for shift in shifts]
        (folder / name).write_text("\n".join([head, *shifted]) + "\n")
    return folder


def as_seven_scenes(folder, frames, down=None):
    folder.mkdir(exist_ok=True, parents=True)
    if down is None:  # Its world is that of a camera: -Y is up there.
        down = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    for frame in frames:
        stem = f"frame-{frame.frame:06d}"
        Image.fromarray(frame.srgb_u8).save(folder / f"{stem}.color.png")
        save_depth(folder / f"{stem}.depth.png", frame, 1000)
        pose = opencv(frame.world_from_camera)
        pose[:3] = down @ pose[:3]
        np.savetxt(folder / f"{stem}.pose.txt", pose, fmt="%.8f")
    return folder


def as_polycam(folder, frames, which="corrected_"):
    """Raw data; with corrected cameras there are uncorrected ones as well, which are wrong."""
    keyframes = folder / "keyframes"
    for name in ("images", "cameras", "corrected_images", "corrected_cameras", "depth", "confidence"):
        if which or not name.startswith("corrected_"):
            (keyframes / name).mkdir(parents=True, exist_ok=True)
    for frame in frames:
        stem = str(60_829_387_374 + round(frame.time_s * 1e6))
        for one in {which, ""}:
            colour, k = enlarged(frame)
            said = {"width": k.width, "height": k.height, "fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy}
            pose = in_y_up(frame.world_from_camera) if one == which else np.eye(4)
            said |= {f"t_{row}{column}": pose[row, column] for row in range(3) for column in range(4)}
            (keyframes / f"{one}cameras" / f"{stem}.json").write_text(json.dumps({**said, "blur_score": 81.5}))
            Image.fromarray(colour).save(keyframes / f"{one}images" / f"{stem}.jpg", quality=95)
        save_depth(keyframes / "depth" / f"{stem}.png", frame, 1000)
        levels = np.array([0, 127, 255], np.uint8)[confidence_of(frame)]
        Image.fromarray(levels).save(keyframes / "confidence" / f"{stem}.png")
    return folder


def as_polycam_uncorrected(folder, frames):
    return as_polycam(folder, frames, "")


def as_plain(folder, frames, has_lines=True):
    """With OpenCV's axes, lossless, and poses in lines of 8 numbers or in files of 16."""
    for name in ("colour", "depth", "confidence", "poses"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    lines = []
    for frame in frames:
        Image.fromarray(frame.srgb_u8).save(folder / "colour" / f"{frame.frame}.png")
        Image.fromarray(confidence_of(frame)).save(folder / "confidence" / f"{frame.frame}.png")
        save_depth(folder / "depth" / f"{frame.frame}.png", frame, 5000)
        pose = opencv(frame.world_from_camera)
        if not has_lines:
            np.savetxt(folder / "poses" / f"{frame.frame}.txt", pose)
        lines.append(" ".join(map(repr, [frame.time_s, *pose[:3, 3].tolist(), *quaternion_of(pose[:3, :3]).tolist()])))
    if has_lines:
        (folder / "poses.txt").write_text("# t x y z qx qy qz qw\n" + "\n".join(lines) + "\n")
    k = frames[0].intrinsics
    said = {"width": k.width, "height": k.height, "fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy}
    said |= {"convention": "opencv", "metres_per_unit": 0.0002}
    (folder / "camera.json").write_text(json.dumps(said))
    return folder


def as_plain_files(folder, frames):
    return as_plain(folder, frames, has_lines=False)


SMALL = Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)
UPRIGHT = Intrinsics(36, 48, 30.0, 30.0, 18.3, 24.0)
TUM = Intrinsics(640, 480, 525.0, 525.0, 320.0, 240.0)
QUARTER_TUM = Intrinsics(160, 120, 131.25, 131.25, 80.0, 60.0)
QUARTER_SCENES = Intrinsics(160, 120, 146.25, 146.25, 80.0, 60.0)
VIDEO = pytest.mark.wheel_only("a whole Blender's Python has no PyAV, whose FFmpeg is not Blender's")
PACKED = pytest.mark.wheel_only("a whole Blender's Python has no lzfse")
LAYOUTS = {
    "Nerfstudio": (as_nerfstudio, SMALL),
    "TUM RGB-D": (as_tum, QUARTER_TUM),
    "7-Scenes": (as_seven_scenes, QUARTER_SCENES),
    "Record3D": (as_record3d, SMALL),
    "Record3D, upright": (as_record3d, UPRIGHT),
    "Stray Scanner": (as_stray, SMALL),
    "Stray Scanner, older": (as_older_stray, SMALL),
    "Polycam": (as_polycam, SMALL),
    "Polycam, not corrected, upright": (as_polycam_uncorrected, UPRIGHT),
    "plain folder": (as_plain, SMALL),
    "plain folder, upright, poses in files": (as_plain_files, UPRIGHT),
}
"""By format and what is odd of it: writes frames into a folder and returns what to open; and intrinsics for them."""


def layouts(names=LAYOUTS):
    """The names, each with the mark of what it takes."""
    marks = {"Stray Scanner": VIDEO, "Record3D": PACKED}
    return [pytest.param(name, marks=marks.get(name.split(",")[0], ())) for name in names]


LOSSY = {"Record3D": 2.0, "Stray Scanner": 3.0, "Polycam": 2.0}
"""Mean difference of colours that is legal, of 255, where a format packs them."""


def doubted(frames):
    """The frames with a confidence: low in the left quarter, medium in the second."""
    levels = np.full((frames[0].intrinsics.height, frames[0].intrinsics.width), 2, np.uint8)
    levels[:, : levels.shape[1] // 2] = 1
    levels[:, : levels.shape[1] // 4] = 0
    return [replace(frame, confidence=levels) for frame in frames]
