"""The plan of a previs run: which frames, which virtual objects, and where light is estimated.

What is wrong with the scene itself is found here, what is wrong with a frame of its path by the survey.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.capture.scanner import phone_camera, sized_for
from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import WORK, contents_sha256
from xihe_blender.previs.files_read import files_read
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.estimation_positions import all_box_corners_m, named_positions
from xihe_blender.scene.phone_capture import remembered_capture
from xihe_blender.scene.virtual_objects import COLLECTION_NAME, collections_of, virtual_objects
from xihenet import __version__
from xihenet.camera import DEFAULT_SIZE, Intrinsics
from xihenet.formats import as_spelled, format_names
from xihenet.records import ArrayF64


@dataclass(frozen=True, eq=False)
class Probe:
    """One estimation position: its name in results, the virtual object it lights, and where it is in the world.

    `moved_m` says where it is in those frames in which it is not at `position_m`, its place in the first.
    """

    name: str
    object_name: str
    position_m: ArrayF64
    moved_m: Mapping[int, ArrayF64] = field(default_factory=dict)

    def at(self, frame: int) -> ArrayF64:
        return self.moved_m.get(frame, self.position_m)


@dataclass(frozen=True, eq=False)
class PrevisPlan:
    """The frames of the camera path, the size of its pictures, the virtual objects and their estimation positions.

    `first_view` is the phone's camera in the first frame: intrinsics and (4, 4) world_from_camera; None where nobody
    has looked.
    """

    frames: tuple[int, ...]
    size: tuple[int, int]
    objects: tuple[bpy.types.Object, ...]
    probes: tuple[Probe, ...]
    first_view: tuple[Intrinsics, ArrayF64] | None = None

    def probes_of(self, object_name: str) -> list[Probe]:
        return [probe for probe in self.probes if probe.object_name == object_name]


def plan_previs(scene: bpy.types.Scene, settings: PrevisSettings) -> PrevisPlan:
    """Check `scene` against `settings`: what would a run do? UserError names the fix; the scene stays as it is."""
    check_nothing_is_missing(scene)
    frames = planned_frames(scene, settings.frames)
    objects = planned_objects(scene, settings.objects)
    size = captured_size(scene, settings)
    with working_scene(scene, "Xihe Plan", RenderSettings(size, samples=1)) as working:
        working.frame_set(frames[0])
        first_view = phone_camera(working)
        corners_m = all_box_corners_m(objects, working.view_layers[0].depsgraph)
        named = [(item, named_positions(item, corners_m=corners_m[item])) for item in objects]
    probes = [Probe(name, item.name, place) for item, places in named for name, place in places.items()]
    owners: dict[str, str] = {}
    for probe in probes:
        if (owner := owners.setdefault(probe.name, probe.object_name)) != probe.object_name:
            raise UserError(
                f"virtual objects {owner!r} and {probe.object_name!r} both have an estimation position that is named "
                f"{probe.name!r}: rename one of them"
            )
    return PrevisPlan(tuple(frames), size, tuple(objects), tuple(probes), first_view)


def captured_size(scene: bpy.types.Scene, settings: PrevisSettings) -> tuple[int, int]:
    """Of the phone's pictures: what was asked for, else DEFAULT_SIZE, upright for a scene that is."""
    return settings.size or sized_for(scene, RenderSettings(DEFAULT_SIZE, samples=1)).size


def check_nothing_is_missing(scene: bpy.types.Scene) -> None:
    """UserError if a part of `scene` is linked from a library that is not there: Blender would render without it."""
    missing = [block for block in (*scene.collection.children_recursive, *scene.objects) if block.is_missing]
    if missing:
        raise UserError(
            f"{missing[0].name!r} is missing, its library {missing[0].library.filepath} was not found: "
            "put it back, or relocate it in Blender's outliner"
        )


def check_is_rendered(scene: bpy.types.Scene) -> None:
    """UserError where `scene` shows a phone's recording, which cannot be rendered from anywhere else."""
    if remembered_capture(scene) is not None:
        raise UserError(
            f"scene {scene.name!r} shows a phone's recording, which cannot be rendered from elsewhere: use Run, or "
            "`xihe previs`"
        )


def planned_frames(scene: bpy.types.Scene, wanted: Sequence[int] | None) -> list[int]:
    """The frames of the camera path. UserError for frames outside the scene's range, or none at all."""
    first, last = scene.frame_start, scene.frame_end
    frames = sorted(set(range(first, last + 1, scene.frame_step) if wanted is None else wanted))
    if not frames:
        raise UserError("there are no frames to capture: give --frames A:B with A no later than B")
    outside = [frame for frame in frames if not first <= frame <= last]
    if outside:
        raise UserError(f"frame {outside[0]} is outside the scene's range {first} to {last}: choose frames within it")
    return frames


def planned_objects(scene: bpy.types.Scene, wanted: Sequence[str] | None) -> list[bpy.types.Object]:
    """The virtual objects of the run. UserError if there is none, a name is unknown, or one is part of the room too."""
    items = virtual_objects(scene)
    found = {item.name: item for item in items}
    if not found:
        raise UserError(
            f"scene {scene.name!r} has no virtual object: put the objects that the phone should insert into a "
            f"collection named {COLLECTION_NAME!r}"
        )
    if wanted is not None and not wanted:
        raise UserError(
            f"no virtual object is chosen: choose among {format_names(found)}, or leave --objects out for all"
        )
    for item, other in itertools.pairwise(items):
        # Results go by name, and an object of a linked library may have the name of another.
        if item.name == other.name:
            linked = item if item.library is not None else other
            raise UserError(
                f"two virtual objects are named {item.name!r}, one of them linked from {linked.library.filepath}: "
                "rename one of them"
            )
    names = list(found) if wanted is None else as_spelled(wanted, found)
    if unknown := [name for name in names if name not in found]:
        raise UserError(f"there is no virtual object {unknown[0]!r}: choose among {format_names(found)}")
    chosen = [item for item in items if item.name in names]
    _, room = collections_of(scene)
    for item in chosen:
        home = next((home for home in item.users_collection if home in room), None)
        if home is not None:  # It would be captured, and would light itself.
            raise UserError(f"virtual object {item.name!r} is also in collection {home.name!r}: unlink it from there")
    return chosen


def compared_frames(active: Sequence[int], step: int) -> list[int]:
    """Every `step`-th of the active frames, and the last of them; may be empty."""
    return sorted({*active[::step], *active[-1:]})


def made_of(
    work: str, scene: bpy.types.Scene, file: Path, settings: PrevisSettings, plan: PrevisPlan
) -> dict[str, Any]:
    """All that decides what is rendered for `plan`, and the numbers of a run, as a `FolderManifest` compares it."""
    return {
        WORK: work,
        "xihe": __version__,
        "blender": bpy.app.version_string,
        "blend_sha256": hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else None,
        "linked_sha256": contents_sha256(files_read()),
        "scene": scene.name,
        # A phone of the user's own may have been moved, or its file may have changed; objects are below, as spelled.
        "settings": asdict(settings)
        | {"phone": Path(settings.phone).stem, "trigger": asdict(settings.trigger_in_use), "objects": None},
        "phone": asdict(settings.profile),
        "preset": settings.preset_values.decides,
        "frames": plan.frames,
        "size": plan.size,
        "objects": [item.name for item in plan.objects],
    }
