"""Frames as files, for tests: a camera at the origin looking along +Y into a box whose walls differ in colour."""

import json
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from xihenet.io import exr
from xihenet.records import Intrinsics

WIDTH, HEIGHT = 32, 24
INTRINSICS = Intrinsics(WIDTH, HEIGHT, fx=20.0, fy=20.0, cx=16.0, cy=12.0)
NEEDS_OPENEXR = pytest.mark.wheel_only(
    "the OpenEXR package shares its symbols with Blender's own library and crashes beside it"
)
LOOKING_ALONG_Y = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def box_radiance_and_plane_depth():
    """(H, W, 3) and (H, W): right half red, left half blue, the wall 3 m ahead; the floor nearer."""
    radiance = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    radiance[:, WIDTH // 2 :] = [0.6, 0.1, 0.1]
    radiance[:, : WIDTH // 2] = [0.1, 0.1, 0.6]
    plane_depth_m = np.full((HEIGHT, WIDTH), 3.0, np.float32)
    plane_depth_m[-6:] = np.linspace(2.5, 1.5, 6)[:, None]
    return radiance, plane_depth_m


def write_camera(path, **changes):
    content = {name: getattr(INTRINSICS, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    content |= {"world_from_camera": LOOKING_ALONG_Y.tolist()} | changes
    path.write_text(json.dumps({name: value for name, value in content.items() if value is not None}))
    return path


def write_channels(path, channels):
    exr.write_exr(path, channels)
    return path


def write_exr(path, radiance, plane_depth_m, colour="{}", plane_depth="Z"):
    """`colour` and `plane_depth` name the channels, such as "ViewLayer.Combined.{}" and "ViewLayer.Depth.Z"."""
    channels = {colour.format(c): radiance[..., index] for index, c in enumerate("RGB")}
    return write_channels(path, channels | ({plane_depth: plane_depth_m} if plane_depth else {}))


def write_by_package(path, channels, compression):
    """As `write_channels`, by the OpenEXR package, in a compression that only it may write."""
    import OpenEXR

    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {name: np.ascontiguousarray(pixels) for name, pixels in channels.items()}) as file:
        file.write(str(path))
    return path


def write_image(path, pixels):
    Image.fromarray(pixels).save(path)
    return path


def colour_profile(primaries, gamma):
    """An ICC profile of red, green and blue by XYZ under D50, (3, 3) in columns, and a power of each channel."""

    def fixed(*values):
        return b"".join(struct.pack(">i", round(value * 65536)) for value in values)

    curve = b"curv" + bytes(4) + struct.pack(">IH", 1, round(gamma * 256)) + bytes(2)
    said = b"not sRGB\0"
    tags = {b"desc": b"desc" + bytes(4) + struct.pack(">I", len(said)) + said + bytes(79)}
    tags[b"wtpt"] = b"XYZ " + bytes(4) + fixed(0.9642, 1, 0.8249)
    for name, column in zip((b"r", b"g", b"b"), primaries.T, strict=True):
        tags |= {name + b"XYZ": b"XYZ " + bytes(4) + fixed(*column), name + b"TRC": curve}
    table, content, at = b"", b"", 128 + 4 + 12 * len(tags)
    for name, one in tags.items():
        padded = one + bytes(-len(one) % 4)
        table += struct.pack(">4sII", name, at + len(content), len(one))
        content += padded
    head = struct.pack(
        ">I4sI4s4s4s12s4s", at + len(content), bytes(4), 0x02100000, b"mntr", b"RGB ", b"XYZ ", bytes(12), b"acsp"
    )
    head = head.ljust(68, b"\0") + fixed(0.9642, 1, 0.8249)
    return head.ljust(128, b"\0") + struct.pack(">I", len(tags)) + table + content


def png(width, height, *, depth=8, rows=b""):
    """A PNG of RGB whose header says this, whatever it holds."""

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, depth, 2, 0, 0, 0)
    chunks = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks
