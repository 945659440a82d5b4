"""The colour space that Blender calculates in: linear Rec.709, unless the file or a configuration has another.

From Blender 5.0 on a file may calculate in Rec.2020 or ACEScg, and in every Blender a studio's own OpenColorIO
configuration may. Networks, exports and displays know Rec.709 alone. Chosen: light becomes Rec.709 where it leaves
Blender (every render) and the file's own where it enters it (worlds, suns, images). Rejected: rendering in Rec.709, in
which saturated light spreads through a room otherwise than in the user's own renders.

Colours that Rec.709 cannot hold have channels below 0; a picture clips them, sums of light do not.

A configuration also has names of its own for spaces, displays and views: those of Blender and of ACES are known here.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import bpy
import numpy as np
from mathutils import Color

from xihenet.records import ArrayF32, ArrayF64

_Light = TypeVar("_Light", ArrayF32, ArrayF64)

SAME = 1e-4
"""Between matrices: Blender 4.5 is off by 1e-6 where both spaces are Rec.709."""

LINEAR_REC709 = ("Linear Rec.709", "Linear Rec.709 (sRGB)", "Utility - Linear - Rec.709", "Utility - Linear - sRGB")
SRGB_DISPLAYS, PLAIN_VIEWS = ("sRGB", "sRGB - Display"), ("Standard", "Un-tone-mapped")


def read_as_linear_rec709(image: bpy.types.Image) -> None:
    """Have Blender take the numbers of `image`, a file, for light in linear Rec.709."""
    _set_to_first_known(image.colorspace_settings, "name", LINEAR_REC709)


def show_as_it_is(scene: bpy.types.Scene) -> None:
    """Have `scene` show and write light encoded in sRGB, without a tone curve or a look."""
    _set_to_first_known(scene.display_settings, "display_device", SRGB_DISPLAYS)
    _set_to_first_known(scene.view_settings, "view_transform", PLAIN_VIEWS)
    scene.view_settings.look = "None"


def _set_to_first_known(owner: Any, attribute: str, names: Sequence[str]) -> None:
    """Leave it as it is where the configuration has none of `names`."""
    for name in names:
        with contextlib.suppress(TypeError):
            setattr(owner, attribute, name)
            return


def is_rec709() -> bool:
    """Whether Blender calculates in linear Rec.709."""
    one = np.eye(3)
    return in_rec709(one) is one


def in_rec709(rgb: _Light) -> _Light:
    """Light (..., 3) as Blender calculates it, in linear Rec.709; `rgb` itself where that is the same."""
    return _converted(rgb, Color.from_scene_linear_to_rec709_linear)


def in_working_space(rgb: _Light) -> _Light:
    """Light (..., 3) in linear Rec.709, as Blender calculates it; `rgb` itself where that is the same."""
    return _converted(rgb, Color.from_rec709_linear_to_scene_linear)


def _converted(rgb: _Light, convert: Callable[[Color], Color]) -> _Light:
    matrix = np.array([convert(Color(one)) for one in np.eye(3)], rgb.dtype)
    return rgb if np.abs(matrix - np.eye(3)).max() < SAME else rgb @ matrix
