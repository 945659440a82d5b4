"""Frames as the app Stray Scanner has them; the layout is that of `xihenet.captures.reading.stray`.

The video is HEVC, as the app's is, or H.264 where PyAV has no encoder for that: pictures are near what they were, and
not the same.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from xihenet.captures.capture import EXTRA
from xihenet.captures.reading.stray import COLUMNS, INTRINSICS, MATRIX, ODOMETRY, VIDEO
from xihenet.captures.reading.values import quaternion_of
from xihenet.captures.reading.video import EXACTLY
from xihenet.captures.writing.pictures import Written, confidence_of, enlarged, in_y_up, save_depth, save_png
from xihenet.io.frame_files import BLENDER_FROM_OPENCV_CAMERA
from xihenet.records import RgbdFrame

UNITS_PER_METRE, FPS = 1000, 30
# Without pictures between pictures, as phones record: with them short videos could not be written, at times.
ENCODERS = {"libx265": {"x265-params": "log-level=none:bframes=0:rc-lookahead=10:frame-threads=2"}, "libx264": {}}
PRESET = "veryfast"  # The default takes nearly three times as long, 0.65 s for 1792x1344 on two busy cores
QUALITY = "4"  # Constant rate factor; 12 takes half the bytes, and moves the light of a room by 1.3 % in place of 0.9 %
BT709, LIMITED = 1, 1  # As phones say, in the numbers of ITU-T H.273


def write(folder: Path, frames: Iterable[RgbdFrame]) -> Written:
    """A folder, with intrinsics on each line of odometry.csv, as newer recordings have.

    OSError if it cannot be written; ValueError for frames of several sizes or none; ImportError without PyAV.
    """
    folder.mkdir(exist_ok=True, parents=True)
    n, n_unheld, k = 0, 0, None
    with _video(folder / VIDEO) as encode, (folder / ODOMETRY).open("w", encoding="utf-8") as odometry:
        odometry.write(", ".join(COLUMNS + INTRINSICS) + "\n")
        for n, frame in enumerate(frames, start=1):
            number = f"{n - 1:06d}"
            colour, k = enlarged(frame)
            encode(colour)
            n_unheld += save_depth(folder / "depth" / f"{number}.png", frame, UNITS_PER_METRE)
            save_png(folder / "confidence" / f"{number}.png", confidence_of(frame))
            pose = in_y_up(frame.world_from_camera) @ BLENDER_FROM_OPENCV_CAMERA
            values = [*pose[:3, 3], *quaternion_of(pose[:3, :3]), k.fx, k.fy, k.cx, k.cy]
            line = ", ".join(f"{value:.9f}" for value in values)
            odometry.write(f"{frame.time_s:.6f}, {number}, {line}\n")
    if k is None:
        raise ValueError("Stray Scanner: expected at least one frame")
    rows = np.array([[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1]])
    text = "".join(", ".join(f"{value:.9f}" for value in row) + "\n" for row in rows)
    (folder / MATRIX).write_text(text, encoding="utf-8")
    return Written(n, n_unheld)


@contextmanager
def _video(path: Path) -> Iterator[Any]:
    """What takes pictures (H, W, 3) sRGB, one after the other, into a file."""
    try:
        import av
    except ImportError as error:
        raise ImportError(f"videos are written by PyAV: {EXTRA}") from error
    opened: Any = av.open(str(path), "w", format="mp4")
    with opened as container:
        stream: Any = None
        n = 0

        def encode(pixels: Any) -> None:
            nonlocal stream, n
            height, width = pixels.shape[:2]
            stream = stream or _begun(container, width, height, av.codecs_available)
            if (stream.width, stream.height) != (width, height):
                raise ValueError("Stray Scanner: expected frames of one size, as pictures of a video are")
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
            picture = picture.reformat(format="yuv420p", dst_colorspace="ITU709", interpolation=EXACTLY)
            picture.pts, picture.time_base = n, Fraction(1, FPS)
            n += 1
            container.mux(stream.encode(picture))

        yield encode
        if stream is not None:
            container.mux(stream.encode())


def _begun(container: Any, width: int, height: int, available: Collection[str]) -> Any:
    """A stream of pictures of that size."""
    names = [name for name in ENCODERS if name in available]
    if not names:
        raise ValueError("Stray Scanner: PyAV has no encoder for HEVC or H.264 here: write another layout")
    stream = container.add_stream(names[0], rate=FPS, options={"crf": QUALITY, "preset": PRESET, **ENCODERS[names[0]]})
    stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
    of_colour = stream.codec_context
    of_colour.colorspace, of_colour.color_primaries, of_colour.color_trc = BT709, BT709, BT709
    of_colour.color_range = LIMITED
    return stream
