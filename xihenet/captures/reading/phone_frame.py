"""A moment that a phone stored, as an `RgbdFrame`: colour, depth from its sensor, and its confidence.

A depth sensor says itself which of its pixels it doubts. Those of low confidence lose their depth and are counted, so
that edges and glass put no point where there is none; the others keep theirs, and all levels stay in the frame. A frame
of which no pixel is left is read as one that shows nothing, since a phone that is held to a wall is no broken file.
Rejected: to keep high confidence only, which leaves little of a dark room.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from xihenet.camera import sensed_ambient, sound_plane_depth, valid_plane_depth
from xihenet.captures.capture import CapturedFrame
from xihenet.formats import format_count
from xihenet.invalid import counted
from xihenet.io.frame_files import FrameCamera, intrinsics_for
from xihenet.io.image_files import read_colour, read_grey, read_plane_depth, shrunk_colour
from xihenet.io.json_files import named
from xihenet.io.picture_size import MOST_POINTS, check_size, picked_pixels
from xihenet.records import ArrayF32, ArrayF64, ArrayU8, RgbdFrame

HIGH, LARGEST_LEVEL = 170, 2  # Apps that store bytes have 0, something in between, and 255


@dataclass(frozen=True, eq=False)
class Measured:
    """What a depth sensor measured.

    Parameters
    ----------
    source : file, or file and member, that is named where something is wrong
    plane_depth_m : (H, W), 0 where there is none; any value is legal
    field : width and height of the whole image, of which the pixels may be picked
    confidence : (H, W), 0 low, 1 medium, 2 high; None where the sensor says none
    """

    source: Path
    plane_depth_m: ArrayF32
    field: tuple[int, int]
    confidence: ArrayU8 | None = None


def measured(source: Path, plane_depth_m: ArrayF32 | ArrayF64, confidence: ArrayU8 | None = None) -> Measured:
    """Of whole images (H, W), thinned where there are more than MOST_POINTS.

    ValueError for more pixels than are read, and for a confidence of another size.
    """
    height, width = plane_depth_m.shape
    check_size(source, height, width)
    if confidence is not None and confidence.shape != plane_depth_m.shape:
        raise ValueError(
            f"{source}: its confidence has {confidence.shape[1]}x{confidence.shape[0]} pixels and its depth "
            f"{width}x{height}: expected the same"
        )
    picked = np.ix_(*picked_pixels(height, width, MOST_POINTS))
    with np.errstate(over="ignore"):  # What float32 cannot hold is a miss.
        kept = plane_depth_m[picked].astype(np.float32)
    return Measured(source, kept, (width, height), None if confidence is None else confidence[picked])


def read_measured(plane_depth: Path, metres_per_unit: float, confidence: Path | None) -> Measured:
    """Of two image files, depth also as .npy; the second may be missing.

    OSError or ValueError, naming the file, for what is broken.
    """
    if plane_depth.suffix.lower() == ".npy":
        return _npy(plane_depth, metres_per_unit, confidence)
    plane_depth_m, field = read_plane_depth(plane_depth, metres_per_unit)
    levels = read_confidence(confidence, field) if confidence is not None and confidence.is_file() else None
    return Measured(plane_depth, plane_depth_m, field, levels)


def _npy(path: Path, metres_per_unit: float, confidence: Path | None) -> Measured:
    """Nothing is unpickled, and nothing read before its size is judged."""
    try:
        with path.open("rb"):
            stored = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError, SyntaxError, TypeError, MemoryError, OverflowError) as error:
        raise ValueError(f"{path}: expected distances as .npy, and could not read it ({error})") from None
    if not isinstance(stored, np.ndarray) or stored.ndim != 2 or stored.dtype.kind not in "uif" or not stored.size:
        raise ValueError(f"{path}: expected distances in rows and columns, as .npy")
    height, width = stored.shape
    check_size(path, height, width)
    levels = read_confidence(confidence, (width, height)) if confidence is not None and confidence.is_file() else None
    return measured(path, np.asarray(stored, np.float64) * metres_per_unit, levels)


def read_confidence(path: Path, field: tuple[int, int]) -> ArrayU8:
    """(H, W) of an image for depth of `field` (width, height) pixels, thinned as that is."""
    stored = read_grey(path)
    height, width = stored.shape
    if (width, height) != field:
        raise ValueError(f"{path} has {width}x{height} pixels: expected {field[0]}x{field[1]}, as depth has")
    return confidence_levels(stored[np.ix_(*picked_pixels(height, width, MOST_POINTS))])


def left_out(n_frames: int, without: str) -> tuple[str, ...]:
    """A note of how many frames are not read, if any, and of what each has none."""
    return (f"{format_count(n_frames, 'frame')} without {without} left out.",) if n_frames else ()


def without_confidence(are_there: Sequence[bool]) -> tuple[str, ...]:
    """A note of how many frames of a recording that stores confidence have none."""
    n_missing = len(are_there) - sum(are_there)
    has, its = ("has", "its") if n_missing == 1 else ("have", "their")
    note = f"{format_count(n_missing, 'frame')} {has} no confidence: all of {its} depth is used."
    return (note,) if n_missing else ()


def confidence_levels(stored: ArrayU8) -> ArrayU8:
    """(H, W) 0, 1 or 2 of what an app stores: these, or bytes of which 0 is low and those from 170 on are high."""
    if not stored.size or stored.max() <= LARGEST_LEVEL:
        return stored
    return ((stored > 0).astype(np.uint8) + (stored >= HIGH)).astype(np.uint8)


def picture_frame(
    number: int,
    time_s: float,
    camera: FrameCamera,
    colour: Path,
    plane_depth: Path,
    metres_per_unit: float,
    confidence: Path | None = None,
) -> CapturedFrame:
    """A moment that is two files as of `read_measured`, or three, of which the third may be missing."""

    def load() -> RgbdFrame:
        return phone_frame(colour, None, read_measured(plane_depth, metres_per_unit, confidence), camera)

    return CapturedFrame(number, time_s, camera, load, colour)


def phone_frame(colour: Path, of_colour: bytes | ArrayU8 | None, depth: Measured, camera: FrameCamera) -> RgbdFrame:
    """The frame of what was `measured`, in the size of its depth.

    `colour` is an image file, or names one of which `of_colour` is the content or the pixels (H, W, 3) sRGB.
    OSError or ValueError, naming the file, if it cannot be read or shows another field of view than the depth.
    """
    height, width = depth.plane_depth_m.shape
    if isinstance(of_colour, np.ndarray):
        srgb_u8 = shrunk_colour(colour, of_colour, depth.source, depth.field, height, width)
    else:
        srgb_u8 = read_colour(colour, depth.source, depth.field, height, width, of_colour)
    with named(depth.source):
        intrinsics = intrinsics_for(camera.intrinsics, depth.field, width, height)
    plane_depth_m, invalid = sound_plane_depth(depth.plane_depth_m)
    if depth.confidence is not None:
        is_doubted = valid_plane_depth(plane_depth_m) & (depth.confidence == 0)
        plane_depth_m = np.where(is_doubted, np.float32(0), plane_depth_m)
        invalid = counted(low_confidence=np.count_nonzero(is_doubted)) | invalid
    return RgbdFrame(
        srgb_u8,
        plane_depth_m,
        intrinsics,
        camera.world_from_camera,
        ambient=sensed_ambient(srgb_u8, 1.0),
        invalid=invalid,
        confidence=depth.confidence,
    )
