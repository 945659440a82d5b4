"""The lights of a run on the timeline: for each virtual object a world that is keyed wherever its light changes.

Beside the world a sun where the run has key lights, a picture where it has reflections, and markers at the triggers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy

from xihe_blender.apply import key_suns, sh_worlds
from xihe_blender.apply.datablocks import LightOf, world_name
from xihe_blender.apply.reflection_pictures import forget_reflections, reflect_on_timeline
from xihe_blender.io.run_lights import light_of_change
from xihe_blender.io.run_results import FrameResult, LightChange
from xihenet.light.key_light import rest_of
from xihenet.light.reflections import light_of_rough
from xihenet.records import ObjectLight


@dataclass(frozen=True)
class Reflected:
    """What an object reflects: a file from each of these frames on.

    With `has_lamp` they show the lamp of the key light, so that its sun is not reflected.
    """

    pictures: Mapping[int, Path]
    has_lamp: bool


NOTHING_REFLECTED = Reflected({}, False)


def reflected_of(changes: Sequence[LightChange], folder: Path) -> Reflected:
    """What is reflected from each frame of `changes` on, in the run's `folder`; nothing where a file is gone."""
    known = {one.frame: one.reflections for one in changes if one.reflections is not None}
    pictures = {frame: folder / one.picture for frame, one in known.items()}
    if not all(path.is_file() for path in pictures.values()):
        return NOTHING_REFLECTED
    return Reflected(pictures, any(one.has_lamp for one in known.values()))


def apply_lights(
    scene: bpy.types.Scene,
    changes: Mapping[str, Sequence[LightChange]],
    frames: Sequence[FrameResult],
    exposure: float,
    folder: Path,
    *,
    has_key_light: bool,
) -> None:
    """Key a world per virtual object at every frame at which its light changes; mark the triggers.

    `changes` are by virtual object, as results.json has them, carrying `exposure`; the pictures of the comparison are
    made with the same. Worlds and suns of earlier runs are keyed anew. `frames` are those of results.json, for the
    triggers; `folder` is the run's, with the pictures of reflections.
    """
    sh_worlds.remove_trigger_markers(scene)
    for name, of_one in changes.items():
        world = sh_worlds.make_sh_world(world_name(name))
        world.use_fake_user = True
        lights = {change.frame: light_of_change(change) for change in of_one}
        key_object_light(world, name, lights, exposure, reflected_of(of_one, folder), has_key_light=has_key_light)
        replace(light_of(name, frames), run=folder.name).write(world)
    for entry in frames:
        reasons = [probe.reason for probe in entry.probes if probe.fired]
        if reasons:
            sh_worlds.mark_trigger(scene, entry.frame, reasons)


def key_object_light(
    world: bpy.types.World, name: str, lights: Mapping[int, ObjectLight], exposure: float,
    reflected: Reflected = NOTHING_REFLECTED, *, has_key_light: bool,
) -> None:  # fmt: skip
    """Key the light of virtual object `name`, by frame, onto its world and, with `has_key_light`, onto its sun.

    Without it a sun of an earlier run is taken away; and so are its reflections where nothing is `reflected`. A sun
    that is reflected has as much light as is sure, see `light_of_rough`.
    """
    forget_reflections(world)
    if reflected.pictures and not reflected.has_lamp:
        lights = {frame: light_of_rough(one) for frame, one in lights.items()}
    sh_worlds.key_light_changes(world, {frame: rest_of(light) for frame, light in lights.items()}, exposure)
    reflect_on_timeline(world, reflected.pictures)
    if has_key_light:
        sun = key_suns.make_key_sun(key_suns.sun_name(name))
        sun.use_fake_user = True
        key_suns.show_in_reflections(sun, not reflected.has_lamp)
        key_suns.key_sun_changes(sun, {frame: light.key for frame, light in lights.items()}, exposure)
    else:
        key_suns.remove_key_sun(key_suns.key_sun(key_suns.sun_name(name)))


def light_of(name: str, frames: Sequence[FrameResult]) -> LightOf:
    """Where the positions of virtual object `name` were in a run."""
    places: dict[str, tuple[float, float, float]] = {}
    moves = False
    for probe in (probe for entry in frames for probe in entry.probes if probe.object == name):
        moves |= places.setdefault(probe.name, probe.position_m) != probe.position_m
    return LightOf(places, moves)
