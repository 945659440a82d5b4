"""Images as phones and depth cameras deliver them: colour in 8 bits, plane depth in 16, read by Pillow.

A photo has fifty megapixels, a phone's plane depth fifty thousand, and a small file may hold far more than either. So
the header decides whether anything is unpacked, and what is unpacked is taken by strips: in 8 bits a photo of 50
megapixels is 200 MB, in the float64 that averages of linear light take it would be 1200.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.camera import encode_exposed
from xihenet.colour import LINEAR_OF_CODE
from xihenet.io.picture_size import MOST_PIXELS, MOST_POINTS, TooLarge, check_size, picked_pixels, same_field
from xihenet.records import ArrayF32, ArrayF64, ArrayU8

# Those that take no more than ten bytes a pixel to read (a progressive JPEG); WebP takes sixteen.
IMAGE_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "PPM")

PIXELS_IN_STRIP, MOST_ROWS_IN_STRIP = 2**19, 128
LINEAR_BY_BYTE = LINEAR_OF_CODE.astype(np.float32)
NONE_IN_16_BITS = 65535
ORIENTATION_TAG = 0x0112
ROUNDING = 2  # Of codes, in which the profiles of sRGB that are in use differ


def read_plane_depth(path: Path, depth_scale: float) -> tuple[ArrayF32, tuple[int, int]]:
    """Plane depth (H, W) of a grey image of 16 or 32 bits, and the width and height of the whole image.

    0 where there is none; thinned where there are more than MOST_POINTS. Raises what `_loading` says.
    """
    if path.suffix.lower() == ".exr" and path.is_file():
        raise ValueError(
            f"{path}: plane depth alone is not read from OpenEXR: save it in whole millimetres, in a PNG of 16 bits"
        )
    with _loading(path) as image:
        if not image.mode.startswith("I"):
            raise ValueError(
                f"{path}: expected a grey image of 16 bits, got pixels of mode {image.mode}: "
                "save distances as whole numbers, such as millimetres, in a PNG of 16 bits"
            )
        brightest = _brightest_in_file(image)
    rows, columns = picked_pixels(image.height, image.width, MOST_POINTS)
    picked, top = [], 0
    for strip in _strips(image):
        start, end = np.searchsorted(rows, [top, top + len(strip)])
        picked.append(strip[np.ix_(rows[start:end] - top, columns)].astype(np.float64))
        top += len(strip)
    units = np.concatenate(picked)
    if brightest is not None:
        units = np.rint(units * (brightest / NONE_IN_16_BITS))
    if image.mode != "I" or image.format in ("PNG", "PPM"):  # Pillow may read 16 bits of these into 32.
        units[units == NONE_IN_16_BITS] = 0
    with np.errstate(over="ignore"):  # What is beyond any number is infinite, and no distance.
        return (units * depth_scale).astype(np.float32), image.size


def _brightest_in_file(image: Any) -> int | None:
    """What a PGM says is white, by which Pillow stretches its numbers to 65535; None where they are as in the file."""
    if image.format != "PPM":
        return None
    codec, _, _, said = image.tile[0]
    return None if codec == "raw" else int(said[1])


def read_colour(
    path: Path, beside: Path, field: tuple[int, int], height: int, width: int, content: bytes | None = None
) -> ArrayU8:
    """(height, width, 3) sRGB of an image of the same field as `beside`, which has `field` (width, height) pixels.

    Colour is what its profile says, and sRGB without one, or where that cannot be read. Grey becomes equal channels,
    alpha is left out, and of 16 bits the upper 8 are taken. `content` as of `_loading`, which says what is raised; and
    ValueError for another ratio of width to height.
    """
    with _loading(path, content) as image:
        if image.mode.startswith(("I", "F")):
            raise ValueError(f"{path}: expected a colour image of 8 bits, got pixels of mode {image.mode}")
        _check_field(path, image.size, beside, field)
    if image.size == (width, height):
        return np.asarray(_to_srgb(image)(image))
    strips = (LINEAR_BY_BYTE[strip] for strip in _strips(image, _to_srgb(image)))
    averaged = area_averaged(strips, image.height, height, width)
    del image, strips  # 200 MB of 50 megapixels, before encoding takes as much
    return encode_exposed(averaged, 1.0)


def shrunk_colour(
    path: Path, pixels: ArrayU8, beside: Path, field: tuple[int, int], height: int, width: int
) -> ArrayU8:
    """As `read_colour`, of pixels (H, W, 3) sRGB that are in memory, such as those of a video."""
    _check_field(path, (pixels.shape[1], pixels.shape[0]), beside, field)
    if pixels.shape[:2] == (height, width):
        return pixels
    tops = range(0, len(pixels), MOST_ROWS_IN_STRIP)
    strips = (LINEAR_BY_BYTE[pixels[top : top + MOST_ROWS_IN_STRIP]] for top in tops)
    return encode_exposed(area_averaged(strips, len(pixels), height, width), 1.0)


def _check_field(path: Path, size: tuple[int, int], beside: Path, field: tuple[int, int]) -> None:
    if not same_field(*size, *field):
        raise ValueError(
            f"{path} has {size[0]}x{size[1]} pixels and {beside} {field[0]}x{field[1]}: "
            "expected the same ratio of width to height, of one field of view"
        )


def read_grey(path: Path) -> ArrayU8:
    """(H, W) of a grey image of 8 bits. Raises what `_loading` says."""
    with _loading(path) as image:
        if image.mode != "L":
            raise ValueError(f"{path}: expected a grey image of 8 bits, got pixels of mode {image.mode}")
    return np.asarray(image)


def _to_srgb(image: Any) -> Callable[[Any], Any]:
    """What makes sRGB of the picture, or of a part of it: photos of iPhones, for one, are in Display P3."""
    from PIL import ImageCms

    with contextlib.suppress(KeyError, ImportError, OSError, ValueError, ImageCms.PyCMSError):
        mode, of_profile = _srgb_of(image.info["icc_profile"])
        if of_profile and (image.mode != "CMYK" if mode == "RGB" else image.mode in ("L", "LA")):
            return lambda part: ImageCms.applyTransform(part.convert(mode), of_profile)
    return lambda part: part.convert("RGB")


@lru_cache(maxsize=8)
def _srgb_of(profile: bytes) -> tuple[str, Any]:
    """The mode of the pictures that a profile is for, and what makes sRGB of them; None where that is what they are."""
    from PIL import Image, ImageCms

    source = ImageCms.getOpenProfile(io.BytesIO(profile))
    mode = "L" if source.profile.xcolor_space == "GRAY" else "RGB"
    made = ImageCms.buildTransform(source, ImageCms.createProfile("sRGB"), mode, "RGB")
    # Names do not tell: linear light has profiles whose name says sRGB.
    steps = np.arange(0, 256, 17, dtype=np.uint8)
    colours = Image.fromarray(np.stack(np.meshgrid(steps, steps, steps), -1).reshape(1, -1, 3)).convert(mode)
    found, same = ImageCms.applyTransform(colours, made), colours.convert("RGB")
    is_same = np.abs(np.asarray(found, np.int16) - np.asarray(same, np.int16)).max() <= ROUNDING
    return mode, None if is_same else made


def _strips(image: Any, changed: Callable[[Any], Any] = lambda strip: strip) -> Iterator[NDArray[Any]]:
    """Rows of a picture from top to bottom, some at a time, `changed`."""
    n_rows = min(MOST_ROWS_IN_STRIP, max(1, PIXELS_IN_STRIP // image.width))
    for top in range(0, image.height, n_rows):
        strip = image.crop((0, top, image.width, min(top + n_rows, image.height)))
        yield np.asarray(changed(strip))


def area_averaged(strips: Iterable[NDArray[Any]], n_rows: int, height: int, width: int) -> ArrayF64:
    """An image (n_rows, W, 3), whose `strips` come from top to bottom, in another size.

    (height, width, 3) float64; each new pixel is the mean over the area it covers, parts of pixels included. The mean
    of the whole image stays what it was; larger sizes repeat pixels.
    """
    averaged, top = np.zeros((height, width, 3)), 0
    edges = np.arange(height + 1) * n_rows / height
    for strip in strips:
        rows = np.arange(top, top + len(strip))
        first = int(np.searchsorted(edges, top, "right")) - 1
        end = int(np.searchsorted(edges, top + len(strip)))
        covered = np.minimum(rows + 1, edges[first + 1 : end + 1, None]) - np.maximum(rows, edges[first:end, None])
        shares = (np.maximum(covered, 0) * (height / n_rows)).astype(strip.dtype)
        columns_first = np.tensordot(shares, strip, 1).swapaxes(0, 1)
        averaged[first:end] += _averaged_rows(columns_first, width).swapaxes(0, 1)
        top += len(strip)
    return averaged


def _averaged_rows(image: NDArray[Any], n_rows: int) -> ArrayF64:
    """Means between evenly spaced edges: differences of the running sum, which is linear inside a row."""
    edges = np.arange(n_rows + 1) * len(image) / n_rows
    row = np.minimum(edges.astype(np.intp), len(image) - 1)
    before = np.concatenate([np.zeros_like(image[:1], np.float64), np.cumsum(image, axis=0, dtype=np.float64)])
    at_edges = before[row] + (edges - row)[:, None, None] * image[row]
    return np.diff(at_edges, axis=0) * (n_rows / len(image))


@contextlib.contextmanager
def _loading(path: Path, content: bytes | None = None) -> Iterator[Any]:
    """A picture of which the block may judge the header; its pixels are in memory after it.

    `content` is that of a file that lies in an archive; `path` then only names it.
    OSError if the file cannot be opened; ImportError without Pillow; ValueError if it is no image, is cut short, has
    too many pixels, or is stored turned.
    """
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError("colour images are read by pillow: pip install 'xihe-blender[images]'") from error
    with path.open("rb") if content is None else io.BytesIO(content) as file:
        with _image_errors(path), warnings.catch_warnings():
            # Our own limit follows, which is said in one line.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(file, formats=IMAGE_FORMATS)
        check_size(path, image.height, image.width)
        yield image
        with _image_errors(path):
            image.load()
            orientation = image.getexif().get(ORIENTATION_TAG, 1)
    if orientation != 1:
        raise ValueError(f"{path} is stored turned, as its EXIF orientation says: save it upright and without the mark")


@contextlib.contextmanager
def _image_errors(path: Path) -> Iterator[None]:
    """What Pillow says of a file that is no image, or of one with far more pixels than are read."""
    from PIL import Image

    try:
        yield
    except Image.DecompressionBombError:
        most = f"{MOST_PIXELS // 10**6} megapixels"
        raise TooLarge(f"{path}: it has too many pixels: save it with at most {most}") from None
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        formats = ", ".join(IMAGE_FORMATS)
        raise ValueError(f"{path}: expected an image ({formats}), and could not read it ({error})") from error
