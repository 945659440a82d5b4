"""The pictures of a recording as a numbered sequence, which is how Blender plays them behind a camera.

Image files of the recording are linked where the disk can, in all of their pixels; other frames are written as PNG.
Every frame of the timeline has a file: between two pictures the earlier one stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import link_or_copy, write_picture
from xihe_blender.scene.phone_capture import stored_path
from xihenet.captures.capture import CapturedFrame
from xihenet.records import RgbdFrame

READABLE = {".png": ".png", ".jpg": ".jpg", ".jpeg": ".jpg"}


def new_footage_folder(beside: Path, name: str) -> Path:
    """A folder that is not there yet, for the pictures of the recording `name`."""
    folder, number = beside / f"{name}_footage", 2
    while folder.exists():
        folder, number = beside / f"{name}_footage_{number}", number + 1
    return folder


def are_linked(frames: Sequence[CapturedFrame]) -> bool:
    """Whether the recording has an image file for each frame that Blender can show, all of one kind."""
    suffixes = {None if one.picture is None else READABLE.get(one.picture.suffix.lower()) for one in frames}
    return len(suffixes) == 1 and None not in suffixes


class Footage:
    """A sequence under way in `folder`, of pictures at frames of the timeline, in order; `first` is its first file."""

    def __init__(self, folder: Path, captured: Mapping[int, CapturedFrame]) -> None:
        self.folder, self.captured = folder, captured
        self.numbers = range(min(captured), max(captured) + 1)
        self.links = are_linked(list(captured.values()))
        picture = captured[self.numbers.start].picture
        self.suffix = READABLE[picture.suffix.lower()] if self.links and picture is not None else ".png"
        folder.mkdir(parents=True)

    @property
    def first(self) -> Path:
        return self._file(self.numbers.start)

    def _file(self, number: int) -> Path:
        return self.folder / f"frame_{number - self.numbers.start + 1:04d}{self.suffix}"

    def add(self, number: int, frame: RgbdFrame | None) -> None:
        """The picture of the frame of the timeline `number`; `frame` may be missing where pictures are linked."""
        own = self.captured[number].picture
        if self.links and own is not None:
            link_or_copy(own, self._file(number))
        else:
            assert frame is not None
            write_picture(self._file(number), frame.srgb_u8)

    def close_gaps(self) -> None:
        """Let the earlier picture stand where the timeline has a frame between two."""
        for number in self.numbers:
            if number not in self.captured:
                link_or_copy(self._file(number - 1), self._file(number))


def show_behind(camera: bpy.types.Camera, footage: Footage, name: str, blend_folder: Path | None) -> tuple[int, int]:
    """Show a finished sequence behind a camera, as it was taken; its width and height in pixels.

    `blend_folder` as of `stored_path`. UserError if Blender cannot read it.
    """
    try:
        image = bpy.data.images.load(str(footage.first))
    except RuntimeError as error:
        raise UserError(f"Blender cannot read {footage.first}: {str(error).strip()}") from error
    width, height = image.size  # Of a sequence it is not known before it is shown.
    image.name, image.source = name, "SEQUENCE"
    image.filepath = stored_path(footage.first, blend_folder)
    camera.show_background_images = True
    behind = camera.background_images.new()
    behind.image, behind.alpha, behind.frame_method = image, 1.0, "STRETCH"
    user = behind.image_user
    user.frame_start, user.frame_duration, user.frame_offset = footage.numbers.start, len(footage.numbers), 0
    user.use_auto_refresh = True
    return width, height
