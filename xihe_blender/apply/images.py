"""Pictures of ours as images of the open file, packed into it."""

from __future__ import annotations

import bpy
import numpy as np

from xihe_blender.apply.datablocks import MADE_BY, image_named
from xihe_blender.scene.colour_management import in_working_space
from xihenet.records import ArrayF32, ArrayF64


def write_image(name: str, picture: ArrayF32 | ArrayF64, *, is_float: bool) -> bpy.types.Image:
    """Put (H, W, 3), row 0 at the top, into our image `name`, and pack it: what is only generated is not saved.

    One of floats is light in linear Rec.709; any other is encoded in sRGB.
    """
    height, width, _ = picture.shape
    image = image_named(name)
    if image is None:
        image = bpy.data.images.new(name, width, height, float_buffer=is_float)
        image[MADE_BY] = name
        image.use_fake_user = True
    if tuple(image.size) != (width, height):
        image.scale(width, height)
    picture = in_working_space(np.asarray(picture, np.float32)) if is_float else picture
    opaque = np.concatenate([picture, np.ones((height, width, 1), np.float32)], axis=-1)
    image.pixels.foreach_set(np.ascontiguousarray(opaque[::-1], np.float32).ravel())
    image.update()
    image.pack()
    return image
