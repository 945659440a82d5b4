"""Do other programs find the points of a session where we do? Layouts that we write, read and unprojected by Open3D.

    pip install open3d-cpu pillow
    python addon_tests/bench/layouts_by_open3d.py SESSION

For TUM RGB-D and Nerfstudio the largest distance between a point by Open3D and by us, and the largest that rounding
depth to the layout's whole numbers explains: half a step along the ray of a pixel in the corner. Open3D counts pixels
from the middle of the first one, where we count from its corner.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import open3d
from given import paths

from xihenet.camera import unproject_frame, valid_plane_depth
from xihenet.captures import open_capture
from xihenet.captures.writing import WRITERS
from xihenet.records import ArrayF64, RgbdFrame

STEPS_A_METRE = {"tum": 5000, "nerfstudio": 1000}
OPENCV_AXES = np.diag([1.0, -1.0, -1.0, 1.0])


def of_tum(folder: Path) -> Iterator[tuple[Any, Path, ArrayF64, float]]:
    """Intrinsics, image of depth, pose and metres a step of each frame, by the benchmark's own files."""
    camera = json.loads((folder / "camera.json").read_text(encoding="utf-8"))
    poses, depths, colours = (
        [line.split() for line in (folder / name).read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
        for name in ("groundtruth.txt", "depth.txt", "rgb.txt")
    )
    for pose, depth, colour in zip(poses, depths, colours, strict=True):
        assert pose[0] == depth[0] == colour[0], "the three files name the same moments"
        x, y, z, *turn = (float(number) for number in pose[1:])
        matrix = np.eye(4)
        matrix[:3, :3] = open3d.geometry.get_rotation_matrix_from_quaternion([turn[3], *turn[:3]])
        matrix[:3, 3] = x, y, z
        yield [camera[name] for name in ("fx", "fy", "cx", "cy")], folder / depth[1], matrix, 1 / 5000


def of_nerfstudio(folder: Path) -> Iterator[tuple[Any, Path, ArrayF64, float]]:
    content = json.loads((folder / "transforms.json").read_text(encoding="utf-8"))
    for frame in content["frames"]:
        matrix = np.array(frame["transform_matrix"]) @ OPENCV_AXES
        intrinsics = [content[name] for name in ("fl_x", "fl_y", "cx", "cy")]
        yield intrinsics, folder / frame["depth_file_path"], matrix, 1e-3


READERS = {"tum": of_tum, "nerfstudio": of_nerfstudio}


def farthest_apart(frame: RgbdFrame, intrinsics: Any, image: Path, pose: ArrayF64, metres: float) -> tuple[float, int]:
    """Metres, and the number of points."""
    height, width = frame.plane_depth_m.shape
    fx, fy, cx, cy = intrinsics
    camera = open3d.camera.PinholeCameraIntrinsic(width, height, fx, fy, cx - 0.5, cy - 0.5)
    stored = open3d.io.read_image(str(image))
    theirs = open3d.geometry.PointCloud.create_from_depth_image(
        stored, camera, np.eye(4), depth_scale=1 / metres, depth_trunc=1e6, project_valid_depth_only=False
    )
    points = np.asarray(theirs.points) @ pose[:3, :3].T + pose[:3, 3]
    # The largest number of 16 bits is no depth to Open3D.
    is_held = (np.rint(frame.plane_depth_m / metres) < 2**16 - 1) & valid_plane_depth(frame.plane_depth_m)
    apart = np.linalg.norm(points - unproject_frame(frame).points_m, axis=1)[is_held.ravel()]
    assert np.isfinite(apart).all(), "Open3D has no depth where we have"
    return float(apart.max()), len(apart)


def main() -> None:
    frames = list(open_capture(*paths(__doc__, "RECORDING", 1)))
    for layout, read in READERS.items():
        with tempfile.TemporaryDirectory() as beside:
            folder = Path(beside) / layout
            WRITERS[layout](folder, frames)
            found = [farthest_apart(frame, *one) for frame, one in zip(frames, read(folder), strict=True)]
        k = frames[0].intrinsics
        slant = np.sqrt(1 + (max(k.cx, k.width - k.cx) / k.fx) ** 2 + (max(k.cy, k.height - k.cy) / k.fy) ** 2)
        print(
            f"{layout}: {sum(n for _, n in found)} points of {len(frames)} frames, at most "
            f"{1e3 * max(apart for apart, _ in found):.3f} mm apart; rounding explains "
            f"{1e3 * slant / 2 / STEPS_A_METRE[layout]:.3f} mm"
        )


if __name__ == "__main__":
    main()
