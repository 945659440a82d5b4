"""The lights of a run, and the surfaces that their shadows fall on: as results hold them, read back from there.

And lights as they are written for an engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.io.exr import read_radiance
from xihe_blender.io.outputs import write_together
from xihe_blender.io.run_results import (
    Coefficients,
    FrameResult,
    KeyLightResult,
    LightChange,
    Rgb,
    RunResults,
    SurfaceResult,
)
from xihenet.camera_path.surfaces import Surface
from xihenet.formats import as_spelled, format_names
from xihenet.light import LightParts
from xihenet.light.environments import laid_out_as_ours
from xihenet.light.exports import NamedLight, export_files, scaled
from xihenet.light.reflections import light_of_rough
from xihenet.records import ArrayF64, KeyLight, ObjectLight


def as_key(key: KeyLight | None) -> KeyLightResult | None:
    """A key light as results.json has it."""
    if key is None:
        return None
    return KeyLightResult(
        direction=as_rgb(key.direction),
        irradiance=as_rgb(key.irradiance),
        angular_radius=float(key.angular_radius),
        is_seen=bool(key.is_seen),
        certainty=float(key.certainty),
    )


def as_surface_result(surface: Surface) -> SurfaceResult:
    """A surface that catches shadows as results.json has it."""
    return SurfaceResult(
        outline_m=tuple(as_rgb(corner) for corner in surface.outline_m.round(5)), normal=as_rgb(surface.normal)
    )


def last_surfaces(frames: Sequence[FrameResult]) -> dict[str, list[Surface]]:
    """By object, where its shadow falls, as the last compared frame has it."""
    compared = [frame.compared for frame in frames if frame.compared is not None]
    found = compared[-1].surfaces if compared else {}
    return {
        name: [Surface(np.array(one.outline_m), np.array(one.normal), 0.0) for one in of_one]
        for name, of_one in found.items()
    }


def as_coefficients(light: ArrayF64) -> Coefficients:
    """(K, 3) as results hold it."""
    return tuple(as_rgb(row) for row in light)


def as_rgb(row: ArrayF64) -> Rgb:
    """(3,) as results hold it."""
    return float(row[0]), float(row[1]), float(row[2])


def light_of_change(change: LightChange) -> ObjectLight:
    """A light of results.json, carrying the session's exposure, without its reflections."""
    key, sh = change.key, np.array(change.sh, np.float64)
    if key is None:
        return ObjectLight(sh)
    direction, irradiance = np.array(key.direction, np.float64), np.array(key.irradiance, np.float64)
    return ObjectLight(sh, KeyLight(direction, irradiance, key.angular_radius, key.is_seen, key.certainty))


def light_with_reflections(change: LightChange) -> ObjectLight:
    """As `light_of_change`; beside a picture without the lamp, the sun is what is sure of the key light."""
    light = light_of_change(change)
    return light if change.reflections is None or change.reflections.has_lamp else light_of_rough(light)


def panorama_of_change(change: LightChange, folder: Path, exposure: float) -> ArrayF64 | None:
    """What glossy things reflect, (H, 2H, 3) laid out as `xihenet.panorama`, scene radiance times `exposure`.

    None for a light without reflections. UserError where its file in the run's `folder` cannot be read.
    """
    if change.reflections is None:
        return None
    path = folder / change.reflections.picture
    try:
        picture = read_radiance(path)
    except (OSError, ValueError) as error:
        raise UserError(f"{path} cannot be read ({error}): run xihe previs again, or add --light sh+key") from error
    # A run writes it as Blender's Environment Texture reads it.
    return laid_out_as_ours(np.maximum(picture.astype(np.float64), 0.0) * exposure, "+X")


UNITS = {"picture": "radiance; 1 is white in the phone's picture", "scene": "radiance of the scene in Blender"}


@dataclass(frozen=True)
class LightsAsked:
    """Which lights of a run are wanted, and how.

    Parameters
    ----------
    frame : of the run, whose light in use is wanted; None takes the last light
    everything : every light of the path instead
    objects : names of virtual objects; None takes all that have a light
    parts : what is written of a light; None takes what the run made
    units : one of UNITS
    """

    frame: int | None = None
    everything: bool = False
    objects: tuple[str, ...] | None = None
    parts: LightParts | None = None
    units: str = "picture"


def write_lights(
    lights: Sequence[NamedLight], platform: str, out: Path, units: str = "picture", reading: str | None = None
) -> list[Path]:
    """Write `lights`, in one of UNITS, for a platform into the folder `out`: all files or none. Their paths.

    UserError, naming the fix, for no light, an unknown reading, and a folder that cannot be written.
    """
    try:
        files = export_files(lights, platform, reading=reading, units=UNITS[units])
    except ValueError as error:
        raise UserError(str(error)) from error
    try:
        return write_together(out, files)
    except OSError as error:
        raise UserError(f"cannot write to {out} ({error.strerror}): choose another folder for --out") from error


def lights_asked(results: RunResults, folder: Path, asked: LightsAsked) -> list[NamedLight]:
    """Those lights of the run in `folder`; UserError, naming the fix, where there are none."""
    frames = {frame.frame: frame.time_s for frame in results.frames}
    if asked.frame is not None and asked.frame not in frames:
        nearest = min((abs(frame - asked.frame), frame) for frame in frames)[1]
        raise UserError(
            f"the run has no frame {asked.frame}: give one from {min(frames)} to {max(frames)} of its path, of which "
            f"{nearest} is nearest"
        )
    made = results.settings.light
    parts = asked.parts or made
    if get_args(LightParts).index(parts) > get_args(LightParts).index(made):
        raise UserError(
            f"the run was made with --light {made}: run xihe previs again with --light {parts}, or ask for {made}"
        )
    chosen = list(results.lights) if asked.objects is None else as_spelled(asked.objects, results.lights)
    if unknown := [name for name in chosen if name not in results.lights]:
        raise UserError(f"the run has no virtual object {unknown[0]!r}; it has {format_names(results.lights)}")
    gain = 1.0 if asked.units == "picture" else 1.0 / results.settings.reference_exposure
    found = []
    for name in chosen:
        changes = _in_force(results.lights[name], asked)
        if not changes:
            where = "" if asked.frame is None else f" at frame {asked.frame}"
            raise UserError(f"{name!r} has no estimate yet{where}: choose other objects, or a later frame")
        for change in changes:
            light, panorama = light_of_change(change), None
            if parts == "sh":
                light = replace(light, key=None)
            elif parts.endswith("reflections"):
                light = light_with_reflections(change)
                panorama = panorama_of_change(change, folder, gain * results.settings.reference_exposure)
            found.append(NamedLight(name, change.frame, frames[change.frame], scaled(light, gain), panorama))
    return found


def _in_force(changes: Sequence[LightChange], asked: LightsAsked) -> list[LightChange]:
    """All of them, or the last one at or before the frame."""
    if asked.everything:
        return list(changes)
    return [change for change in changes if asked.frame is None or change.frame <= asked.frame][-1:]
