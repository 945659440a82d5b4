"""Results in Blender itself: a run as curves, as pictures, and on the timeline.

The worlds that light the virtual objects carry their error and coverage as keyed custom properties, so that the Graph
Editor shows them above the light's own curves. Two kinds of images show one frame: the estimated light of each object,
and estimate against ground truth with a wipe between them. They are packed, so that a saved file keeps them without the
run's folder and without the add-on.

Everything is made from results.json and the pictures beside it, in `folder`, the run's: a run can be shown again in any
file with the same objects. `remove_everything` takes away all that this and `apply.sh_worlds` leave, and nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.addon.runs_folder import other_unit
from xihe_blender.apply.applied_lights import lights_after_run
from xihe_blender.apply.datablocks import (
    COMPARISON_NAME,
    FRAME,
    LIGHT_PREFIX,
    OF_RUN,
    LightOf,
    applied_worlds,
    image_named,
    lit_scene,
    our_images,
    trigger_markers,
    world_name,
)
from xihe_blender.apply.images import write_image
from xihe_blender.apply.key_suns import key_suns, remove_key_sun
from xihe_blender.apply.keys import add_keys, clear_keys, f_curves, hold_keys
from xihe_blender.apply.lit_scene import (
    CapturedFrames,
    has_its_frames,
    hide_behind_room,
    is_of_run,
    is_over_frames,
    put_over_frames,
    remove_lit_scene,
    show_room_anew,
)
from xihe_blender.apply.lit_timeline import apply_lights, key_object_light, light_of, reflected_of
from xihe_blender.apply.placement_map import remove_placement_map
from xihe_blender.apply.sh_worlds import make_sh_world, remove_applied_light, remove_trigger_markers
from xihe_blender.compare.side_by_side import middle_of_change, read_picture, wiped
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_lights import last_surfaces
from xihe_blender.io.run_results import RunResults, read_results
from xihe_blender.previs.better_camera import remove_better_camera
from xihe_blender.previs.lit_blend import make_lit_scene
from xihe_blender.scene.blend_file import ROOM
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.camera_path.kept_path import FoundLight
from xihenet.io.frame_files import FrameCamera
from xihenet.io.recording import read_header
from xihenet.light.environments import laid_out
from xihenet.light.key_light import mean_light
from xihenet.panorama import evaluate_panorama
from xihenet.records import ArrayF64, ObjectLight

ERROR_CURVE, COVERAGE_CURVE, EXPECTED_CURVE = "Xihe SHC RMSE", "Xihe coverage", "Xihe expected error"
LIGHT_HEIGHT = 64
"""Of the panorama; order 2 has no detail that more pixels would show."""

MOST_FRAMES_AFTER = 1000
"""After the run for which the last captured frame is shown: each is a link, of which Windows allows 1,023 a file."""


def show_results(scene: bpy.types.Scene, folder: Path) -> None:
    """Show a run whose light is on the timeline of `scene` already: curves and pictures."""
    results = read_results(folder)
    for name in lit_here(scene, results):
        # The file's own world: one of a linked library may have the same name.
        _key_curves(bpy.data.worlds[world_name(name), None], results, name)
    show_images(scene, folder)


def apply_results(scene: bpy.types.Scene, folder: Path) -> None:
    """Put the light of a run onto the timeline of `scene` and show the run, from its folder alone.

    Objects of the run that are not in the scene any more are left out; UserError if none is.
    """
    results = read_results(folder)
    lights = {name: results.lights[name] for name in lit_here(scene, results)}
    if not lights and (missing := left_out(scene, folder)) is not None:
        raise UserError(missing)
    made = results.settings
    exposure, has_key_light = made.reference_exposure, made.has_key_light
    apply_lights(scene, lights, results.frames, exposure, folder, has_key_light=has_key_light)
    show_results(scene, folder)


def lit_here(scene: bpy.types.Scene, results: RunResults) -> list[str]:
    """Names of the virtual objects that the run lit and that are still in `scene`."""
    here = {item.name for item in virtual_objects(scene)}
    return [name for name in results.lights if name in here]


def left_out(scene: bpy.types.Scene, folder: Path) -> str | None:
    """Which objects of the run in `folder` are not in `scene`, in a sentence; None if all are."""
    results = read_results(folder)
    missing = [repr(name) for name in results.lights if name not in lit_here(scene, results)]
    if not missing:
        return None
    said, names = ("is", "it back its name") if len(missing) == 1 else ("are", "them back their names")
    return f"{', '.join(missing)} of the last run {said} not in this scene any more: run again, or give {names}"


def show_lit(scene: bpy.types.Scene, folder: Path, active: str = "") -> bpy.types.Scene:
    """A scene `Xihe Lit` in the open file for a run of `scene`; its world is `active`'s.

    The one that is there, as the user left it, if it is of the same run and objects; else in its place.
    UserError if no virtual object of the run is in the scene any more, or if nothing was captured.
    """
    results = read_results(folder)
    if said := other_unit(scene, results):
        raise UserError(said)
    captured = [entry.frame for entry in results.captured_frames]
    pictures = {frame: RunOutputs(folder).picture("captured", frame) for frame in captured}
    gone = [path for path in pictures.values() if not path.is_file()]
    if gone or not pictures:
        raise UserError(f"{gone[0]} is gone: run again" if gone else "no virtual object was ever in view: run again")
    here = lit_here(scene, results)
    if (results.lights and not here) or not all(_is_lit_by(folder, applied_worlds(scene).get(name)) for name in here):
        apply_results(scene, folder)
    objects, worlds, lit = virtual_objects(scene), applied_worlds(scene), lit_scene()
    shown = [item for item in objects if item.name in worlds]
    is_kept = lit is not None and is_of_run(lit, scene, folder.name, shown) and has_its_frames(lit)
    if lit is not None and is_kept:
        show_room_anew(lit, scene, objects)
    else:
        remove_lit_scene()
        lit = make_lit_scene(scene, shown, last_surfaces(results.frames))
        hide_behind_room(lit, scene, objects)
        lit[ROOM], lit[OF_RUN] = scene, folder.name
    if not is_over_frames(lit):
        exposure = results.settings.reference_exposure
        # Where the light of the first and of the last frame holds, to the scene's start and end, so must its picture.
        first, last = results.frames[0].frame, results.frames[-1].frame
        end = min(scene.frame_end, last + MOST_FRAMES_AFTER)
        path = range(min(scene.frame_start, first), max(end, last) + 1)
        size, cameras = results.settings.size, phone_cameras(folder, captured)
        frames = CapturedFrames(pictures, path, folder / "lit", size, exposure, cameras)
        put_over_frames(lit, frames)
    lit.world = applied_worlds(scene).get(active, lit.world)
    return lit


def _is_lit_by(folder: Path, world: bpy.types.World | None) -> bool:
    """Whether `world` has the light of the run in `folder`: a scene that shares its objects may have had another."""
    of = None if world is None else LightOf.read(world) or LightOf()
    return of is not None and of.run in ("", folder.name)


def phone_cameras(folder: Path, captured: Sequence[int]) -> dict[int, FrameCamera]:
    """The phone at each frame that the run in `folder` captured; empty where a capture is not kept any more."""
    try:
        headers = [read_header(RunOutputs(folder).capture(frame)) for frame in captured]
    except (OSError, ValueError):
        return {}
    poses = [FrameCamera(header.intrinsics, header.world_from_camera, np.eye(3)) for header in headers]
    return dict(zip(captured, poses, strict=True))


def show_found_light(
    scene: bpy.types.Scene, folder: Path, name: str, places_m: Mapping[str, ArrayF64], found: Mapping[str, FoundLight]
) -> None:
    """Light virtual object `name` as it was found at its positions after the run in `folder`.

    Its error is not known there: ground truth and reference light are of the run.
    """
    results, lights = read_results(folder), list(found.values())
    of_frames = {frame: mean_light([light.lights[frame] for light in lights]) for frame in lights[0].lights}
    exposure, known = results.settings.reference_exposure, applied_worlds(scene).get(name)
    world = known or make_sh_world(world_name(name))
    world.use_fake_user = True
    last = next(reversed(of_frames))
    at_run = light_of(name, results.frames)
    places = {name: place.tolist() for name, place in places_m.items()}
    is_at_run = at_run.is_of(places)
    reflected = reflected_of(results.lights.get(name, ()) if is_at_run else (), folder)
    has_key_light = results.settings.has_key_light
    key_object_light(world, name, _changes(of_frames), exposure, reflected, has_key_light=has_key_light)
    live = {name: (light.coverage[last], light.expected_error[last]) for name, light in found.items()}
    LightOf(places, live={} if is_at_run else live, run=folder.name).write(world)
    if is_at_run:
        _key_curves(world, results, name)
    else:
        world.pop(ERROR_CURVE, None)
        coverage = {frame: [light.coverage[frame] for light in lights] for frame in of_frames}
        errors = {frame: [light.expected_error[frame] for light in lights] for frame in of_frames}
        expected = {frame: [one for one in each if one is not None] for frame, each in errors.items()}
        _key(world, {COVERAGE_CURVE: coverage, EXPECTED_CURVE: expected})
    reached = max((frame for frame in of_frames if frame <= scene.frame_current), default=min(of_frames))
    show_light(name, of_frames[reached].sh / exposure)


def _changes(lights: Mapping[int, ObjectLight]) -> dict[int, ObjectLight]:
    """Those of `lights` that differ from the one before."""
    kept: dict[int, ObjectLight] = {}
    for frame, light in lights.items():
        if not kept or light.tobytes() != next(reversed(kept.values())).tobytes():
            kept[frame] = light
    return kept


def light_in_use(results: RunResults, name: str, frame: int) -> ArrayF64:
    """(9, 3) the light of virtual object `name` at `frame`, carrying the run's exposure; before the first, the first.

    Of one that the run lit.
    """
    changes = results.lights[name]
    reached = [change for change in changes if change.frame <= frame]
    return np.array((reached or changes)[-1 if reached else 0].sh, np.float64)


# ------------------------------------------------------------------------------------------------------------- curves


def _key_curves(world: bpy.types.World, results: RunResults, name: str) -> None:
    """Error and coverage of an object at each frame in which it was in view: the mean over its positions."""
    probes = {entry.frame: [probe for probe in entry.probes if probe.object == name] for entry in results.frames}
    errors = {f: [one.shc_rmse for one in each if one.shc_rmse is not None] for f, each in probes.items()}
    coverage = {frame: [one.coverage for one in each] for frame, each in probes.items()}
    _key(world, {ERROR_CURVE: errors, COVERAGE_CURVE: coverage})


def _key(world: bpy.types.World, curves: Mapping[str, Mapping[int, Sequence[float]]]) -> None:
    """Key the mean of the values at each frame that has any, by curve, in place of all keys of `world` itself."""
    clear_keys(world)
    for name, values in curves.items():
        means = {frame: float(np.mean(each)) for frame, each in values.items() if each}
        if means:
            path, frames = f'["{name}"]', list(means)
            world[name] = means[frames[-1]]
            world.keyframe_insert(path, frame=frames[0])
            (curve,) = (one for one in f_curves(world) if one.data_path == path)
            add_keys(curve, frames, list(means.values()))
    hold_keys(world)


# ------------------------------------------------------------------------------------------------------------- images


def show_images(scene: bpy.types.Scene, folder: Path) -> None:
    """Make the images of a run show the current frame of `scene`.

    Objects that were moved or added since have the light of where they are.
    """
    results, frame = read_results(folder), scene.frame_current
    now = lights_after_run(scene, frame, "scene")
    for name in dict.fromkeys([*lit_here(scene, results), *now]):
        if name in now:
            show_light(name, now[name].light.sh)
        elif results.lights[name]:
            show_light(name, light_in_use(results, name, frame) / results.settings.reference_exposure)
        else:
            # Nothing was ever in view, and a picture of an earlier run would say otherwise.
            _remove_image(f"{LIGHT_PREFIX}{name}")
    if show_comparison(folder, frame, scene.xihe.wipe) is None:
        _remove_image(COMPARISON_NAME)


def show_light(name: str, sh_radiance: ArrayF64) -> bpy.types.Image:
    """The image of the light of virtual object `name`, (9, 3) in scene radiance: 32-bit.

    Laid out as Blender's Environment Texture reads it, so that it lights a world as it lit the object.
    """
    panorama = evaluate_panorama(sh_radiance, LIGHT_HEIGHT, 2 * LIGHT_HEIGHT)
    return write_image(f"{LIGHT_PREFIX}{name}", laid_out(panorama, "+X"), is_float=True)


def show_comparison(folder: Path, frame: int, wipe: float) -> bpy.types.Image | None:
    """The image of estimate against ground truth at the compared frame next to `frame`; None if none was compared.

    `wipe` is 0 to 1, see `wiped`. UserError if its pictures are gone.
    """
    results = read_results(folder)
    nearest = results.nearest_compared_frame(frame)
    if nearest is None:
        return None
    pictures = results.compared_frames[nearest].pictures
    estimate, truth = (read_picture(folder / pictures[kind]) for kind in (results.settings.estimator, "ground_truth"))
    image = write_image(COMPARISON_NAME, wiped(estimate, truth, wipe), is_float=False)
    image[FRAME] = nearest
    return image


def wipe_through_objects(folder: Path, frame: int) -> float:
    """Where a wipe has half of the virtual objects' pixels on either side, at the compared frame next to `frame`.

    UserError if its pictures are gone; 0.5 if none was compared.
    """
    results = read_results(folder)
    nearest = results.nearest_compared_frame(frame)
    if nearest is None:
        return 0.5
    pictures = results.compared_frames[nearest].pictures
    estimate, captured = (read_picture(folder / pictures[kind]) for kind in (results.settings.estimator, "captured"))
    return middle_of_change(captured, estimate)


def _remove_image(name: str) -> None:
    image = image_named(name)
    if image is not None:
        bpy.data.images.remove(image)


# ----------------------------------------------------------------------------------------------------------- timeline


def go_to_trigger(scene: bpy.types.Scene, direction: str) -> int | None:
    """Go to the trigger before ("PREVIOUS") or after ("NEXT") the current frame; its frame, or None without one."""
    frames = sorted(marker.frame for marker in trigger_markers(scene))
    if direction == "PREVIOUS":
        found = max((frame for frame in frames if frame < scene.frame_current), default=None)
    else:
        found = min((frame for frame in frames if frame > scene.frame_current), default=None)
    if found is not None:
        scene.frame_set(found)
    return found


# ------------------------------------------------------------------------------------------------------------ removal


def remove_everything() -> None:
    """Take away all that runs left: worlds, node group, markers, images, lit scene, placement map, camera.

    Of all scenes: without their worlds their markers would say what is not so. UserError where no other scene is left.
    """
    if all(ROOM in scene for scene in bpy.data.scenes if scene.library is None):
        raise UserError("Blender cannot delete Xihe Lit, the last scene: add a scene, and remove the light then")
    while lit_scene() is not None:  # The user may have copied it.
        remove_lit_scene()
    remove_lit_scene()  # What is left of one that the user has deleted.
    remove_placement_map()
    remove_applied_light()
    for sun in key_suns():
        remove_key_sun(sun)
    for scene in [scene for scene in bpy.data.scenes if scene.library is None]:
        remove_trigger_markers(scene)
    for image in list(our_images()):
        bpy.data.images.remove(image)
    remove_better_camera()
