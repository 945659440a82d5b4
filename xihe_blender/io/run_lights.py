"""The lights of a run, read back from its results and pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.io.run_results import LightChange
from xihenet.exr import read_exr
from xihenet.light import LightParts
from xihenet.light.environments import laid_out_as_ours
from xihenet.records import ArrayF64, KeyLight, ObjectLight


def light_of_change(
    change: LightChange, parts: LightParts, folder: Path, exposure: float
) -> tuple[ObjectLight, ArrayF64 | None]:
    """A light of results.json, carrying the session's exposure, and the panorama that glossy things reflect.

    The panorama, (H, 2H, 3) laid out as `xihenet.panorama`, is scene radiance times `exposure`; None where `parts` or
    the light has none. UserError where its file in the run's `folder` cannot be read.
    """
    light, panorama = ObjectLight(np.array(change.sh, np.float64)), None
    if parts != "sh" and change.key is not None:
        key = change.key
        direction, irradiance = np.array(key.direction), np.array(key.irradiance)
        light = replace(light, key=KeyLight(direction, irradiance, key.angular_radius, key.is_seen))
    if parts.endswith("reflections") and change.reflections is not None:
        path = folder / change.reflections.picture
        try:
            channels = read_exr(path)
            picture = np.stack([channels[channel] for channel in "RGB"], axis=-1)
        except (OSError, ValueError, KeyError) as error:
            raise UserError(f"{path} cannot be read ({error}): run xihe previs again, or add --light sh+key") from error
        # A run writes it as Blender's Environment Texture reads it.
        panorama = laid_out_as_ours(np.maximum(picture.astype(np.float64), 0.0) * exposure, "+X")
    return light, panorama
