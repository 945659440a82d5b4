"""How does the artist get the estimated light? As worlds keyed on the timeline, and as a .blend that shows them.

The saved copy of the user's file has a second scene, `Xihe Lit`: only the virtual objects, each in a view layer under
its own keyed world, film transparent, ready to be put over the captured frames.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy

from xihe_blender.apply import key_suns, sh_worlds
from xihe_blender.apply.datablocks import LIT_SCENE, LightOf
from xihe_blender.apply.images import as_environment
from xihe_blender.apply.lit_scene import remove_lit_collections, remove_lit_scene, set_up_lit_scene, show_only_in
from xihe_blender.apply.reflection_pictures import forget_reflections, has_sun_for_lamp, reflect_on_timeline
from xihe_blender.apply.shadow_catchers import (
    catch_shadows,
    catch_shadows_of,
    catcher_name,
    make_shadow_catcher,
    remove_shadow_catchers,
    shadow_catchers,
    triangles_of,
)
from xihe_blender.capture.render import can_denoise
from xihe_blender.io.exr import write_radiance
from xihe_blender.io.outputs import RunOutputs, written_whole
from xihe_blender.io.run_lights import light_of_change
from xihe_blender.io.run_results import FrameResult, LightChange, ReflectionsResult
from xihe_blender.previs.plan import PrevisPlan
from xihe_blender.previs.results import as_coefficients, as_key
from xihe_blender.scene.phone_capture import scan_of
from xihe_blender.scene.units import metres_per_unit
from xihenet.light.key_light import rest_of
from xihenet.light.reflections import light_of_rough, reflection_panorama
from xihenet.records import ObjectLight
from xihenet.surfaces import Surface

LIFTED_M = 0.003
"""Of a catcher: copies of the room's own surfaces hold out what is behind them, and it must not be."""

Changes = Mapping[str, Sequence[LightChange]]
"""By virtual object, as results.json has them."""


def light_changes(
    plan: PrevisPlan, lights: Mapping[int, Mapping[str, ObjectLight]], outputs: RunOutputs, exposure: float
) -> Changes:
    """The light of each virtual object wherever it changes; what it reflects is written to `outputs`.

    `lights` are by frame and virtual object, and carry `exposure`.
    """
    changes: dict[str, tuple[LightChange, ...]] = {}
    for index, item in enumerate(plan.objects):
        of_one: list[LightChange] = []
        has_sun = has_sun_for_lamp(item)
        pictures: dict[bytes, ReflectionsResult] = {}
        for frame, light in ((frame, of_all[item.name]) for frame, of_all in lights.items()):
            reflected = None
            if light.reflections is not None:
                path = outputs.reflections(index, item.name, len(pictures) + 1)
                shown = light_of_rough(light).reflections if has_sun else light.reflections
                assert shown is not None
                pixels = shown.radiance.tobytes()
                if pixels not in pictures:
                    write_radiance(path, as_environment(reflection_panorama(shown) / exposure))
                    seen_share = float(light.reflections.seen_share)
                    pictures[pixels] = ReflectionsResult(
                        picture=outputs.relative(path), seen_share=seen_share, has_lamp=not has_sun
                    )
                reflected = pictures[pixels]
            sh, key = as_coefficients(light.sh), as_key(light.key)
            change = LightChange(frame=frame, sh=sh, key=key, reflections=reflected)
            if not of_one or replace(of_one[-1], frame=frame) != change:
                of_one.append(change)
        changes[item.name] = tuple(of_one)
    return changes


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
    scene: bpy.types.Scene, changes: Changes, frames: Sequence[FrameResult], exposure: float, folder: Path,
    *, has_key_light: bool,
) -> None:  # fmt: skip
    """Key a world per virtual object at every frame at which its light changes; mark the triggers.

    `changes` are as of `light_changes`, carrying `exposure`; the pictures of the comparison are made with the same.
    Worlds and suns of earlier runs are keyed anew. `frames` are those of results.json, for the triggers; `folder` is
    the run's, with the pictures of reflections.
    """
    sh_worlds.remove_trigger_markers(scene)
    for name, of_one in changes.items():
        world = sh_worlds.make_sh_world(sh_worlds.world_name(name))
        world.use_fake_user = True
        lights = {change.frame: light_of_change(change) for change in of_one}
        key_object_light(world, name, lights, exposure, reflected_of(of_one, folder), has_key_light=has_key_light)
        light_of(name, frames).write(world)
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


def make_lit_scene(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], surfaces: Mapping[str, Sequence[Surface]]
) -> bpy.types.Scene:
    """A copy of `scene` with only `objects`, each in a view layer under the world that a run left for it.

    `surfaces` are those that catch shadows, by object; the scan of a recording does in their place. KeyError for an
    object without a world.
    """
    found = sh_worlds.applied_worlds(scene)
    worlds = {item.name: found[item.name] for item in objects}
    lit = scene.copy()
    lit.name = LIT_SCENE
    # A copied scene has no user, and what has none is not saved.
    lit.use_extra_user = True
    for layer in list(lit.view_layers)[1:]:
        lit.view_layers.remove(layer)
    set_up_lit_scene(lit, objects, {world.name: (name, world) for name, world in worlds.items()})
    suns = key_suns.applied_suns(scene)
    for name in suns.keys() & worlds.keys():
        show_only_in(lit, suns[name], [worlds[name].name])
    scan = scan_of(scene) if suns else None
    triangles = None if scan is None else triangles_of(scan)
    for name in [name for name in worlds if triangles is not None or surfaces.get(name)]:
        catcher = make_shadow_catcher(catcher_name(name))
        if triangles is not None:
            catch_shadows_of(catcher, triangles)
        else:
            catch_shadows(catcher, surfaces[name], metres_per_unit(scene), LIFTED_M)
        show_only_in(lit, catcher, [worlds[name].name])
    lit.world = next(iter(worlds.values()))
    lit.render.engine = "CYCLES"
    # Denoised as the report's pictures are. A build without the denoiser would refuse to render with it.
    lit.cycles.use_denoising = can_denoise(lit) and lit.cycles.use_denoising
    return lit


def save_lit_blend(
    scene: bpy.types.Scene, plan: PrevisPlan, surfaces: Mapping[str, Sequence[Surface]], path: Path
) -> None:
    """Save a copy of the open file to `path`, whole or not at all, with the scene `Xihe Lit` in it; OSError if not."""
    remove_lit_scene()
    lit = make_lit_scene(scene, plan.objects, surfaces)
    try:
        with written_whole(path) as beside:
            bpy.ops.wm.save_as_mainfile(filepath=str(beside), copy=True, compress=True)
            _check_is_whole(beside, lit.name)
    finally:
        remove_shadow_catchers(shadow_catchers(lit))
        bpy.data.scenes.remove(lit)
        remove_lit_collections()


def _check_is_whole(path: Path, scene_name: str) -> None:
    """OSError if Blender cannot read back what it saved: it does not say so when the end of a file did not fit."""
    with contextlib.suppress(OSError), bpy.data.libraries.load(str(path)) as (saved, _):
        if scene_name in saved.scenes:
            return
    raise OSError(errno.ENOSPC, "Blender could save only a part of it", str(path))
