"""Frame files: how does one RGB-D frame from anywhere become an `RgbdFrame`?

Colour and plane depth come as an OpenEXR file (linear, with a Z pass, as renderers write it) or as a colour image with
a 16-bit image of plane depth (as phones and depth cameras deliver it); intrinsics and pose come as JSON. Whatever does
not fit together is refused with what was found: a frame that is read wrongly gives a light that looks right.

The two images may differ in size. Colour is then averaged over the area of each depth pixel, in linear light;
enlarging plane depth instead was rejected, since it invents surfaces between near and far ones. Sizes are judged by
the header, and a frame of more than 2 megapixels is thinned to that (`picture_size`). Colour is taken as sRGB or linear
Rec.709, or as what an image says by its profile, and an OpenEXR file by its Color Interop ID or its chromaticities. Not
here: pixels of images (`image_files`), lens distortion, and images that do not show the same field of view.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from xihenet.camera import encode_exposed, sensed_ambient, sound_plane_depth, valid_plane_depth
from xihenet.io import exr, openexr_package
from xihenet.io.image_files import read_colour, read_plane_depth
from xihenet.io.json_files import named, number_in, read_json, side_in
from xihenet.io.picture_size import MOST_POINTS, TooLarge, check_size, picked_pixels, same_field
from xihenet.phone.metering import metered_exposure
from xihenet.records import POSE_TOLERANCE, ArrayF32, ArrayF64, ArrayU8, Intrinsics, RgbdFrame, check_last_row

PLANE_DEPTH_CHANNELS = ("Depth.Z", "Depth.V", "Z")
MOST_VALUES_BY_PACKAGE = 64_000_000  # Of all channels, which the package unpacks together: 16 megapixels of four
CAMERA_KEYS = ("width", "height", "fx", "fy", "cx", "cy", "world_from_camera", "convention", "up")
BLENDER_FROM_OPENCV_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])
BLENDER_FROM_UP: Mapping[str, ArrayF64] = {
    "z": np.eye(3),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "x": np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-x": np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
}
"""What turns a world upright, by the axis that points up in it: (x, y, z) with +Y up is Blender's (x, -z, y)."""


REC709_FROM: Mapping[str, ArrayF64] = {
    "lin_rec2020_scene": np.array(
        [[1.660491, -0.5876403, -0.0728492], [-0.1245504, 1.1329002, -0.0083489], [-0.0181508, -0.1005792, 1.1187301]]
    ),
    "lin_ap1_scene": np.array(
        [[1.705051, -0.6217912, -0.0832581], [-0.1302563, 1.1408046, -0.0105478], [-0.0240034, -0.1289693, 1.1529725]]
    ),
}
"""What turns linear colour of a file into Rec.709, by the file's Color Interop ID: of Rec.2020 and ACEScg, in which a
.blend may calculate. ACEScg's white, D60, becomes D65 by Bradford's adaptation, as in Blender."""
IS_REC709 = ("", "lin_rec709_scene", "data", "unknown")


@dataclass(frozen=True, eq=False)
class FrameCamera:
    """What a camera file says, in Blender's axes."""

    intrinsics: Intrinsics  # of either image of the frame, or of any other size that shows the same field
    world_from_camera: ArrayF64  # (4, 4)
    # (3, 3) what turns positions in the file's world into Blender's; the identity with +Z up.
    blender_from_file: ArrayF64


def read_frame(
    path: Path,
    camera: FrameCamera,
    *,
    plane_depth: Path | None = None,
    depth_scale: float = 1e-3,
    exposure: float | None = None,
) -> RgbdFrame:
    """One frame from files; what `path` is shows in its first bytes, not in its name.

    It has the size of the plane depth, or is thinned to MOST_POINTS, and at least one valid pixel; those without a
    valid plane depth, or with a colour that is NaN, are 0 and counted. OSError if a file is missing or cannot be read,
    ValueError if what the files hold is no frame, ImportError without the package that reads them, naming the extra.

    Parameters
    ----------
    path : OpenEXR file with colour and plane depth, or a colour image of 8 bits
    plane_depth : 16-bit image of plane depth, 0 or 65535 where there is none; for a colour image, and only for one
    depth_scale : metres per unit of that image
    exposure : to be applied to an OpenEXR file (None meters it); of a colour image the one it was taken with (None: 1)
    """
    if exposure is not None and not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"exposure: expected a positive factor, got {exposure}")
    with path.open("rb") as file:
        is_exr = file.read(4) == exr.MAGIC
    if is_exr:
        if plane_depth is not None:
            raise ValueError(f"{path} is an OpenEXR file and brings its own plane depth: leave out {plane_depth}")
        return _exr_frame(path, camera, exposure)
    if plane_depth is None:
        raise ValueError(f"{path} is no OpenEXR file: a colour image needs a 16-bit image of plane depth as well")
    if not (np.isfinite(depth_scale) and depth_scale > 0):
        raise ValueError(f"depth scale: expected a positive number of metres per unit, got {depth_scale}")
    plane_depth_m, field = read_plane_depth(plane_depth, depth_scale)
    height, width = plane_depth_m.shape
    srgb_u8 = read_colour(path, plane_depth, field, height, width)
    fix = "0 and, in 16 bits, 65535 stand for none, check the image"
    taken_with = 1.0 if exposure is None else exposure
    return _frame(srgb_u8, sound_plane_depth(plane_depth_m), field, camera, taken_with, plane_depth, fix)


def read_camera(path: Path) -> FrameCamera:
    """Intrinsics and pose from a JSON file.

    Keys: `width`, `height`, `fx`, `fy`, `cx`, `cy` in pixels (pixel centres at +0.5) and `world_from_camera`, four rows
    of four, metres. Optional: `convention`, "blender" (the camera looks down -Z with +Y up, as in ARKit and OpenGL;
    the default) or "opencv" (down +Z with +Y down); `up`, the world's axis that points up, "z" (the default), "y", "x",
    "-z", "-y" (as where the world is the first camera of OpenCV) or "-x".

    OSError if the file cannot be read; ValueError if something is missing, misspelt, of the wrong kind, not finite, or
    the pose is no rotation and translation.
    """
    content = read_json(path)
    with named(path):
        intrinsics, is_opencv, up = camera_facts(content, CAMERA_KEYS)
        if "world_from_camera" not in content:
            raise ValueError("world_from_camera is missing")
        return frame_camera(intrinsics, content["world_from_camera"], is_opencv=is_opencv, up=up)


def camera_facts(content: Any, keys: Collection[str]) -> tuple[Intrinsics, bool, str]:
    """Intrinsics, whether camera axes are OpenCV's, and the axis that is up, as of `read_camera`.

    ValueError for what is wrong with them, and for a key that is not one of `keys`.
    """
    if not isinstance(content, dict):
        raise ValueError(f"expected a JSON object with {', '.join(keys)}")
    _check_keys(content, keys)
    k = (number_in(content, name) for name in ("fx", "fy", "cx", "cy"))
    intrinsics = Intrinsics(side_in(content, "width"), side_in(content, "height"), *k)
    is_opencv = _choice(content, "convention", ("blender", "opencv")) == "opencv"
    return intrinsics, is_opencv, _choice(content, "up", tuple(BLENDER_FROM_UP))


def frame_camera(
    intrinsics: Intrinsics, world_from_camera: Any, *, is_opencv: bool = False, up: str = "z"
) -> FrameCamera:
    """A camera as a file gives it: four rows of four, metres; `up` is one of BLENDER_FROM_UP.

    ValueError where the pose is no finite rotation and translation.
    """
    pose = _pose(world_from_camera) @ (BLENDER_FROM_OPENCV_CAMERA if is_opencv else np.eye(4))
    blender_from_file = BLENDER_FROM_UP[up]
    pose[:3] = blender_from_file @ pose[:3]
    return FrameCamera(intrinsics, pose, blender_from_file)


def off_centre(intrinsics: Intrinsics) -> str | None:
    """A clause where the principal point is not within the picture, as it is with a lens that is not shifted far."""
    k = intrinsics
    if 0 < k.cx < k.width and 0 < k.cy < k.height:
        return None
    return (
        f"the principal point lies at the edge of the picture or outside of it, at {k.cx:g}, {k.cy:g} of "
        f"{k.width}x{k.height} pixels: check cx and cy"
    )


def _check_keys(content: dict[str, Any], keys: Collection[str]) -> None:
    """ValueError for a key that nothing would read, which would be a misspelt one that counts for nothing."""
    for name in (name for name in content if name not in keys):
        near = difflib.get_close_matches(name.lower(), keys, n=1)
        fix = f"did you mean {near[0]!r}?" if near else f"leave it out; there are {', '.join(keys)}"
        if re.fullmatch(r"dist.*|[kp]\d", name.lower()):
            fix = "leave it out, and undistort the pictures first, since the lens' distortion is not taken out"
        raise ValueError(f"{name[:80]!r}: there is no such key; {fix}")


def _choice(content: dict[str, Any], name: str, allowed: tuple[str, ...]) -> str:
    """One of `allowed`, of which the first is the default."""
    value = content.get(name, allowed[0])
    if value not in allowed:
        raise ValueError(f"{name}: expected {' or '.join(map(repr, allowed))}, got {value!r:.80}")
    return str(value)


def _pose(rows: Any) -> ArrayF64:
    """(4, 4) of nested lists; ValueError unless it is a rotation and a translation."""
    try:
        pose = np.array(rows, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError("world_from_camera: expected four rows of four numbers") from error
    if pose.shape != (4, 4):
        raise ValueError(f"world_from_camera: expected four rows of four numbers, got an array of shape {pose.shape}")
    if not np.isfinite(pose).all():
        raise ValueError("world_from_camera: expected finite numbers, got NaN or infinity")
    check_last_row(pose, "world_from_camera")
    axes = pose[:3, :3]
    skew = float(np.abs(axes.T @ axes - np.eye(3)).max())
    determinant = float(np.linalg.det(axes))
    if abs(determinant) < POSE_TOLERANCE:
        raise ValueError("world_from_camera: it is singular, its axes do not span space; expected a rotation")
    if skew > POSE_TOLERANCE:
        raise ValueError(
            f"world_from_camera: expected a rotation without scale or shear, got an error of {skew:.3g}: write it with "
            "four digits or more, and its first three columns with length 1 and at right angles"
        )
    if determinant < 0:
        raise ValueError("world_from_camera: it mirrors; expected right-handed axes (negate one of them)")
    return pose


def intrinsics_for(camera: Intrinsics, field: tuple[int, int], width: int, height: int) -> Intrinsics:
    """The same field of view in another number of pixels, of a file that has `field` (width, height).

    ValueError for another ratio of width to height.
    """
    if not same_field(camera.width, camera.height, *field):
        raise ValueError(
            f"the intrinsics are for {camera.width}x{camera.height} pixels and the plane depth has "
            f"{field[0]}x{field[1]}: expected the same ratio of width to height"
        )
    across, down = width / camera.width, height / camera.height
    return Intrinsics(width, height, camera.fx * across, camera.fy * down, camera.cx * across, camera.cy * down)


def _frame(
    srgb_u8: ArrayU8,
    measured: tuple[ArrayF32, dict[str, int]],
    field: tuple[int, int],
    camera: FrameCamera,
    exposure: float,
    source: Path,
    fix: str,
) -> RgbdFrame:
    """The record of what `sound_plane_depth` left of a file of `field` (width, height) pixels.

    ValueError with `fix` in it if no plane depth is valid.
    """
    plane_depth_m, invalid = measured
    if not valid_plane_depth(plane_depth_m).any():
        if invalid.get("colour_not_finite"):
            raise ValueError(f"{source}: the colour is NaN wherever there is a plane depth: render or export it again")
        raise ValueError(
            f"{source}: no pixel has a valid plane depth (all are 0, negative, not finite or misses): {fix}"
        )
    height, width = plane_depth_m.shape
    return RgbdFrame(
        srgb_u8,
        plane_depth_m,
        intrinsics_for(camera.intrinsics, field, width, height),
        camera.world_from_camera,
        exposure,
        sensed_ambient(srgb_u8, exposure),
        invalid=invalid,
    )


def read_exr_channels(
    path: Path, names: Collection[str] | None = None, *, most_pixels: int | None = None
) -> dict[str, ArrayF32]:
    """As `exr.read_exr`, and by the OpenEXR package what only that reads, where it is installed.

    OSError if the file cannot be opened; ValueError if it is none, is cut short, or is in a form that needs it.
    """
    try:
        return exr.read_exr(path, names, most_pixels=most_pixels)
    except exr.OtherExr as error:
        if not openexr_package.is_installed():
            raise ValueError(f"{error}: save it in scan lines with ZIP compression, or pip install OpenEXR") from error
        sizes = exr.exr_sizes(path)
        if sum(height * width for height, width in sizes.values()) > MOST_VALUES_BY_PACKAGE:
            most = f"{MOST_VALUES_BY_PACKAGE // 10**6} million"
            raise TooLarge(f"{error} here, and it has more than {most} values: save it with ZIP compression") from error
    channels = openexr_package.read_by_package(path, names)
    # A part whose pixels are broken is left out without an error.
    if not channels or (names is not None and not set(names) <= channels.keys()):
        raise ValueError(f"{path}: its pixels cannot be read, it may be cut short: copy or save it again")
    return {
        name: pixels[np.ix_(*picked_pixels(*sizes[name], most_pixels))] if name in sizes else pixels
        for name, pixels in channels.items()
    }


def _exr_frame(path: Path, camera: FrameCamera, exposure: float | None) -> RgbdFrame:
    sizes = exr.exr_sizes(path)
    colour, plane_depth_channel = _frame_channels(sizes, path)
    of_frame = {sizes[name] for name in (*colour, plane_depth_channel)}
    if len(of_frame) > 1:
        raise ValueError(f"{path}: expected colour and plane depth of one size, got {sorted(of_frame)} (rows, columns)")
    height, width = sizes[plane_depth_channel]
    check_size(path, height, width)
    _check_is_all(path, (width, height), exr.exr_displayed_sizes(path)[plane_depth_channel][::-1], camera.intrinsics)
    channels = read_exr_channels(path, {*colour, plane_depth_channel}, most_pixels=MOST_POINTS)
    radiance, plane_depth_m = np.stack([channels[name] for name in colour], axis=-1), channels[plane_depth_channel]
    radiance = _in_rec709(radiance, exr.exr_colour_space(path), path)
    if exposure is None:
        is_finite = np.isfinite(radiance).all(axis=2)
        exposure = metered_exposure([radiance[is_finite]]) if is_finite.any() else 1.0
    fix = "save the Z pass too, and let the camera see surfaces"
    measured = sound_plane_depth(plane_depth_m, radiance)
    return _frame(encode_exposed(radiance, exposure), measured, (width, height), camera, exposure, path, fix)


def _check_is_all(path: Path, stored: tuple[int, int], displayed: tuple[int, int], k: Intrinsics) -> None:
    """ValueError where a file of which `stored` pixels are a part of the picture, or more, has intrinsics for another
    number of pixels: scaled to the file's they would be those of another field of view."""
    if displayed != stored != (k.width, k.height):
        size, whole = (f"{width}x{height}" for width, height in (stored, displayed))
        raise ValueError(
            f"{path}: it has {size} pixels of a picture of {whole}, and the intrinsics are for {k.width}x{k.height}: "
            f"save all of the picture and no more, or give intrinsics for the {size} pixels"
        )


def _in_rec709(radiance: ArrayF32, space: str, path: Path) -> ArrayF32:
    if space in IS_REC709:
        return radiance
    if space not in REC709_FROM:
        raise ValueError(f"{path}: its colours are {space!r}: save it in linear Rec.709, Rec.2020 or ACEScg")
    with np.errstate(over="ignore", invalid="ignore"):  # An infinite colour has no other one, and stays as it is.
        converted = radiance @ REC709_FROM[space].T.astype(np.float32)
    return np.where(np.isinf(radiance).any(axis=2, keepdims=True), radiance, converted)


def _frame_channels(channels: Mapping[str, object], path: Path) -> tuple[list[str], str]:
    """Names of R, G, B and of the plane depth of one layer; of several, the first in the file with both."""
    befores = [name[:-1] for name in channels if name == "R" or name.endswith(".R")]
    colours = {
        before: [before + c for c in "RGB"] for before in befores if {before + "G", before + "B"} <= channels.keys()
    }
    if not colours:
        raise ValueError(f"{path}: expected colour as R, G, B or <layer>.Combined.R, G, B, found {_found(channels)}")
    for before, colour in colours.items():
        layer = before.removesuffix("Combined.")
        for name in PLANE_DEPTH_CHANNELS:
            if layer + name in channels:
                return colour, layer + name
    raise ValueError(
        f"{path}: expected plane depth as Z, Depth.V or <layer>.Depth.Z beside the colour, found {_found(channels)}: "
        "save the Z pass too"
    )


def _found(channels: Mapping[str, object]) -> str:
    names = sorted(channels)
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
