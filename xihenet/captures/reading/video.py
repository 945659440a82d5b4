"""Pictures of a video by their number, by PyAV: one after the other as they come, and never all in memory.

Numbers are counted from the first picture, whatever times the file gives them. Going back begins anew at the first one:
files say where they may be entered by time, not by number. A file that was cut short still says where each picture
lies, so that those that are not in it any more are known before one is decoded.

Only MP4 and MOV are opened, by their own demuxer and as a file: a list of files or addresses that calls itself a video
is not followed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from xihenet.captures.capture import EXTRA
from xihenet.io.picture_size import check_size
from xihenet.records import ArrayU8

DEMUXER = "mov"
# Of FFmpeg's conversion: bicubic, with accurate rounding and colour at full width both ways. As it comes it cuts
# numbers off, and every colour is darker by 1.1 of 255, which is 4 % of the light of a dark wall.
EXACTLY = 0x4 | 0x40000 | 0x2000 | 0x4000


class Video:
    """An MP4 or MOV file.

    OSError if it cannot be opened; ValueError, naming it, if it is no video that can be read; ImportError without PyAV.

    Attributes
    ----------
    width, height : of its pictures, pixels
    n_frames : pictures that lie in the file
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        container = self._open()
        try:
            stream = self._stream(container)
            self.width, self.height = int(stream.codec_context.width), int(stream.codec_context.height)
            check_size(path, self.height, self.width)
            self.n_frames = _n_frames(container, stream, path.stat().st_size)
        finally:
            container.close()
        if not self.n_frames:
            raise ValueError(f"{path}: it has no pictures: record again")
        self._pictures: Iterator[Any] | None = None
        self._next = 0

    def read(self, number: int) -> ArrayU8:
        """(height, width, 3) sRGB of the picture of that number; cheap for one that comes after the last one read.

        ValueError, naming the file, if it cannot be decoded, or the video ends before it.
        """
        if number >= self.n_frames:
            raise ValueError(f"{self.path}: it ends before picture {number}: record again, or cut odometry.csv")
        if self._pictures is None or number < self._next:
            self.close()
            self._pictures = self._decoded()
        try:
            for picture in self._pictures:
                self._next += 1
                if self._next > number:
                    return self._pixels(picture)
        except ValueError:
            self.close()
            raise
        self.close()
        raise ValueError(f"{self.path}: picture {number} cannot be decoded: record again, or cut odometry.csv")

    def close(self) -> None:
        """Let go of the file; reading opens it again."""
        if self._pictures is not None:
            self._pictures.close()  # type: ignore[attr-defined]
        self._pictures, self._next = None, 0

    def _decoded(self) -> Iterator[Any]:
        """Pictures as they are stored, from the first one on; ends where the file does."""
        import av

        container = self._open()
        try:
            stream = self._stream(container)
            stream.thread_type = "AUTO"
            for packet in container.demux(stream):
                if packet.is_corrupt:  # The file ends within it: what was decoded before comes out.
                    yield from stream.decode(None)
                    return
                yield from stream.decode(packet)
        except av.error.FFmpegError as error:
            raise ValueError(f"{self.path}: a picture cannot be decoded ({error.strerror})") from None
        finally:
            container.close()

    def _pixels(self, picture: Any) -> ArrayU8:
        if (picture.width, picture.height) != (self.width, self.height):
            raise ValueError(f"{self.path}: its pictures change their size, from {self.width}x{self.height}")
        return np.asarray(picture.reformat(format="rgb24", interpolation=EXACTLY).to_ndarray())

    def _open(self) -> Any:
        try:
            import av
        except ImportError as error:
            raise ImportError(f"videos are read by PyAV: {EXTRA}") from error
        with self.path.open("rb"):
            pass  # What the file system says of it comes from there.
        try:
            return av.open(f"file:{self.path}", format=DEMUXER)
        except av.error.FFmpegError as error:
            raise ValueError(f"{self.path}: expected a video, MP4 or MOV ({error.strerror}): record again") from None

    def _stream(self, container: Any) -> Any:
        if not container.streams.video:
            raise ValueError(f"{self.path}: expected a video, and it has no pictures: record again")
        stream = container.streams.video[0]
        if stream.codec_context is None:
            raise ValueError(
                f"{self.path}: expected a video, and its codec is not known: record again, or save it as H.264 or HEVC"
            )
        return stream


def _n_frames(container: Any, stream: Any, n_bytes: int) -> int:
    """Pictures that come out right of the `n_bytes` of the stream's file; all that it says it has with an older PyAV.

    Pictures are stored in the order of decoding. One that is missing may be shown before some that are there: before
    as many as the stream decodes ahead. So many times of decoding lie before its first picture.
    """
    entries = getattr(stream, "index_entries", None)  # Of PyAV 15 and newer
    if not entries:
        return int(stream.frames)
    kept = [entry for entry in entries if not entry.is_discard]
    n_whole = next((i for i, entry in enumerate(kept) if entry.pos + entry.size > n_bytes), len(kept))
    if n_whole == len(kept):
        return n_whole
    shown = [packet.pts for packet in container.demux(stream) if packet.pts is not None and not packet.is_corrupt]
    n_ahead = sum(entry.timestamp < min(shown) for entry in kept) if shown else 0
    return max(0, n_whole - n_ahead)
