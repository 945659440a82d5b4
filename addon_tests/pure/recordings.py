"""A walk through a room of coloured walls, ray-cast here, and recordings of it in the layouts that others write."""

import json

import numpy as np
from PIL import Image

from xihenet.records import Intrinsics, RgbdFrame

HALF = np.array([2.0, 1.5, 1.2])
WALLS = np.array([[(180, 60, 50), (60, 160, 70)], [(70, 80, 190), (200, 190, 60)], [(120, 110, 100), (225, 220, 210)]])
"""sRGB by axis: at its lower and at its upper end."""


def looking(azimuth, pitch, place):
    """(4, 4) of a camera, Blender's axes: along its own -Z, +Y up."""
    forward = np.array([np.cos(azimuth) * np.cos(pitch), np.sin(azimuth) * np.cos(pitch), np.sin(pitch)])
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(right, forward), -forward, np.array(place)], axis=1)
    return pose


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


def write_depth(path, frame, units_per_metre):
    units = np.where(np.isfinite(frame.plane_depth_m), np.rint(frame.plane_depth_m * units_per_metre), 0)
    Image.fromarray(units.astype(np.uint16)).save(path)


def opencv(pose):
    return pose @ np.diag([1.0, -1.0, -1.0, 1.0])


def as_nerfstudio(folder, frames):
    k, entries = frames[0].intrinsics, []
    for frame in frames:
        names = f"images/{frame.frame}.png", f"depth/{frame.frame}.png"
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True, parents=True)
        Image.fromarray(frame.srgb_u8).save(folder / names[0])
        write_depth(folder / names[1], frame, 1000)
        pose = frame.world_from_camera.tolist()
        entries.append({"file_path": names[0], "depth_file_path": names[1], "transform_matrix": pose})
    content = {"w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy, "frames": entries}
    (folder / "transforms.json").write_text(json.dumps(content))


def quaternion(rotation):
    """x, y, z, w of a rotation (3, 3), by the largest eigenvector of Bar-Itzhack's matrix."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r.trace()],
        ]
    )
    values, vectors = np.linalg.eigh(k)
    return vectors[:, values.argmax()]


def as_tum(folder, frames):
    lists = {"rgb": [], "depth": [], "groundtruth": []}
    for frame in frames:
        time_s = 1305031102.0 + frame.time_s
        for kind in ("rgb", "depth"):
            (folder / kind).mkdir(exist_ok=True, parents=True)
        Image.fromarray(frame.srgb_u8).save(folder / f"rgb/{time_s:.4f}.png")
        write_depth(folder / f"depth/{time_s:.4f}.png", frame, 5000)
        lists["rgb"].append(f"{time_s:.4f} rgb/{time_s:.4f}.png")
        # Depth comes a little later than colour, and poses come more often than both.
        lists["depth"].append(f"{time_s + 0.008:.4f} depth/{time_s:.4f}.png")
        pose = opencv(frame.world_from_camera)
        numbers = " ".join(f"{value:.9f}" for value in (*pose[:3, 3], *quaternion(pose[:3, :3])))
        lists["groundtruth"] += [f"{time_s + shift:.4f} {numbers}" for shift in (-0.004, 0.004)]
    for kind, lines in lists.items():
        (folder / f"{kind}.txt").write_text("# as the benchmark writes it\n" + "\n".join(lines) + "\n")


def as_seven_scenes(folder, frames):
    folder.mkdir(exist_ok=True, parents=True)
    # Its world is that of a camera: -Y is up there.
    down = np.eye(4)
    down[:3, :3] = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    for frame in frames:
        stem = f"frame-{frame.frame:06d}"
        Image.fromarray(frame.srgb_u8).save(folder / f"{stem}.color.png")
        write_depth(folder / f"{stem}.depth.png", frame, 1000)
        np.savetxt(folder / f"{stem}.pose.txt", down @ opencv(frame.world_from_camera), fmt="%.8f")


LAYOUTS = {
    "Nerfstudio": (as_nerfstudio, Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)),
    "TUM RGB-D": (as_tum, Intrinsics(640, 480, 525.0, 525.0, 320.0, 240.0)),
    "7-Scenes": (as_seven_scenes, Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)),
}
