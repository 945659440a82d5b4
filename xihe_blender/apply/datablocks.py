"""Datablocks of a run in the open file: worlds, markers and images, known by their names and by what made them.

The panel asks at every redraw whether there is anything to remove, so nothing here needs NumPy; what makes these things
is in `sh_worlds` and `addon.results_in_blender`.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import bpy

from xihe_blender.scene.blend_file import ROOM
from xihe_blender.scene.virtual_objects import virtual_objects

NODE_GROUP_NAME = "Xihe SH Radiance"
PREFIX = "Xihe "
MAX_NAME_BYTES = 63
MARKER_PREFIX = "Xihe trigger"
COMPARISON_NAME = "Xihe Comparison"
LIGHT_PREFIX = "Xihe Light "
LIT_SCENE = "Xihe Lit"
BETTER_PATH = "Xihe Better Path"
"""Camera that does an advised look, and its custom property: the frame of the path at which it looks away."""

SAME_PLACE_M = 5e-3
"""Places nearer than this share their light. Versions of Blender differ by millimetres in the box of a subdivided
object, which no one has moved."""

RUN_BESIDE = "xihe_run"
"""Custom property of `Xihe Lit` in the lit file of a run: where the run lies, relative to that file."""

OF_RUN = "xihe_of_run"
"""Custom property of `Xihe Lit`: the name of the folder of the run that it shows."""

MADE_BY = "xihe_image"
"""Custom property of our images, so that one of the user's of the same name is left alone."""

KEY_LIGHT = "xihe_key_light"
"""Custom property of a sun of ours: its name, whatever Blender calls it now."""

SHADOW_CATCHER = "xihe_shadow_catcher"
"""Custom property of a shadow catcher of ours: its name, whatever Blender calls it now."""

LIGHT_OF = "xihe_light_of"
"""Custom property of a world of ours: the places that its light is of, see `LightOf`."""

MAP = "xihe_placement_map"
"""Custom property of the mesh of the placement map; see `apply.placement_map`."""

FRAME = "xihe_frame"
"""Custom property of the comparison: the compared frame that it shows."""


@dataclass(frozen=True)
class LightOf:
    """What the keys of a world stand for: estimation positions, by name, and where they are (world, metres).

    `moves` where they move along the path. `live` has coverage and expected error (None: unknown) at the last frame,
    by position, where the light was estimated after the run, from its frames, for other places than the run's. `run` is
    the name of the run's folder; empty where an earlier version did not note it.
    """

    places_m: Mapping[str, Sequence[float]] = field(default_factory=dict)
    moves: bool = False
    live: Mapping[str, tuple[float, float | None]] = field(default_factory=dict)
    run: str = ""

    def write(self, world: bpy.types.World) -> None:
        # As text: a custom property's own keys are shorter than the names of objects may be.
        world[LIGHT_OF] = json.dumps(vars(self))

    @classmethod
    def read(cls, world: bpy.types.World) -> LightOf | None:
        """None for a world that was keyed before this was noted, or by hand."""
        try:
            return cls(**json.loads(world[LIGHT_OF]))
        except (KeyError, TypeError, ValueError):
            return None

    def is_of(self, places_m: Mapping[str, Sequence[float]]) -> bool:
        """Whether the light is that of these places; of positions that were never in view nothing is known."""
        known = [(self.places_m[name], place) for name, place in places_m.items() if name in self.places_m]
        return bool(known) and all(math.dist(was, place) < SAME_PLACE_M for was, place in known)


def shortened(name: str) -> str:
    """`name` in the 63 bytes that every Blender keeps of one.

    A longer one is cut, and ends with a checksum of all of it: objects whose long names begin alike stay apart.
    """
    whole = name.encode()
    if len(whole) <= MAX_NAME_BYTES:
        return name
    return f"{whole[: MAX_NAME_BYTES - 9].decode(errors='ignore')} {zlib.crc32(whole):08x}"


def world_name(virtual_object: str) -> str:
    """Name of the world that lights a virtual object, as `shortened` gives it."""
    return shortened(f"{PREFIX}{virtual_object}")


def applied_worlds(scene: bpy.types.Scene) -> dict[str, bpy.types.World]:
    """The world that lights each virtual object of `scene`, for those that have one."""
    # Of the file itself: one of a linked library may have the same name.
    found = {item.name: bpy.data.worlds.get((world_name(item.name), None)) for item in virtual_objects(scene)}
    return {name: world for name, world in found.items() if world is not None}


def moved_positions(scene: bpy.types.Scene) -> dict[str, tuple[float, float | None]]:
    """Coverage and expected error, by position, of light of `scene` that was estimated after a run."""
    return {name: (coverage, error) for of in _lights_of(scene) for name, (coverage, error) in of.live.items()}


def still_positions(scene: bpy.types.Scene) -> dict[str, Sequence[float]]:
    """Where the light of `scene` is of, in metres by position, for objects that do not move along the path."""
    return {name: place for of in _lights_of(scene) if not of.moves for name, place in of.places_m.items()}


def _lights_of(scene: bpy.types.Scene) -> list[LightOf]:
    return [of for world in applied_worlds(scene).values() if (of := LightOf.read(world)) is not None]


def has_anything(scene: bpy.types.Scene) -> bool:
    """Whether there is something for `results_in_blender.remove_everything` to remove."""
    lit = any(lights_by_sh(world) and world.library is None for world in bpy.data.worlds)
    lit |= any((KEY_LIGHT in one or SHADOW_CATCHER in one) and one.library is None for one in bpy.data.objects)
    blocks = (lit_scene(), next(our_images(), None), placement_map(), better_path_camera())
    return lit or bool(trigger_markers(scene)) or any(block is not None for block in blocks)


def placement_map() -> bpy.types.Object | None:
    """The placement map of the open file, whatever Blender calls it now."""
    meshes = [mesh for mesh in bpy.data.meshes if MAP in mesh and mesh.library is None]
    return next((item for item in bpy.data.objects if item.data in meshes), None) if meshes else None


def better_path_camera() -> bpy.types.Object | None:
    """Our camera that does an advised look, whatever Blender calls it now; None where there is none."""
    return next((item for item in bpy.data.objects if BETTER_PATH in item and item.library is None), None)


def lit_scene() -> bpy.types.Scene | None:
    """The scene `Xihe Lit` of the open file, whatever Blender calls it now; None where it is not shown."""
    return next((scene for scene in bpy.data.scenes if ROOM in scene and scene.library is None), None)


def remove_lit_collections() -> None:
    """Remove the collections that were made for `Xihe Lit` and that no scene uses any more."""
    for collection in [c for c in bpy.data.collections if c.name.startswith(f"{LIT_SCENE} ") and c.users == 0]:
        bpy.data.collections.remove(collection)


def lights_by_sh(world: bpy.types.World) -> bool:
    """Whether `world` is one of ours: named so and lit by our node group."""
    return world.name.startswith(PREFIX) and world.node_tree is not None and NODE_GROUP_NAME in world.node_tree.nodes


def trigger_markers(scene: bpy.types.Scene) -> list[bpy.types.TimelineMarker]:
    """The markers that runs set; the user's own are not among them."""
    return [marker for marker in scene.timeline_markers if marker.name.startswith(MARKER_PREFIX)]


def image_named(name: str) -> bpy.types.Image | None:
    """Our image of that name, whatever Blender calls it now."""
    return next((image for image in our_images() if image[MADE_BY] == name), None)


def our_images() -> Iterator[bpy.types.Image]:
    """All images of the file itself that results were shown in."""
    return (image for image in bpy.data.images if MADE_BY in image and image.library is None)
