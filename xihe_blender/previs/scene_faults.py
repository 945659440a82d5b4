"""What of a scene cannot be lit or believed as it stands, and what does a run say of it?

Cycles drops a sample that is not finite without a word: a lamp of NaN watts gives a black room, and so does an emission
whose light overflows single precision. Chosen: such numbers are refused by name before anything is rendered; what is
legal, but no phone could see or no float could hold, is a fault that results and report name. Rejected: looking for
black in the pictures, where a dropped sample is like any other darkness.

Values are read where they are constants. What textures or arithmetic make of them only Cycles knows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.light_transport.animation import is_animated, is_film
from xihe_blender.light_transport.nodes import constant, has_nodes
from xihe_blender.scene.units import metres_per_unit
from xihenet.records import ArrayF32, ArrayF64

BRIGHTEST = 1e30
"""Watts or strength from which Cycles' single precision overflows within a few bounces (measured: from 1e37 on)."""

COARSEST_M = 1e-3
"""Coordinates that are rounded to more than this put surfaces beside each other where they should touch."""

NEAREST_M, FARTHEST_M = 0.02, 100.0
"""Of a phone from a virtual object. Beyond it estimators know no rooms, and the unit scale is mostly wrong."""

COUNTED_AT_ONCE = 2**20
"""Pixels: an HDRI may have a hundred million."""

NEGLIGIBLE_SHARE = 1e-4
"""Of an image's light: what colours outside Rec.709 take away as negative numbers, in HDRIs from real places."""

EMISSION_INPUTS = {
    "EMISSION": ("Color", "Strength"),
    "BACKGROUND": ("Color", "Strength"),
    "BSDF_PRINCIPLED": ("Emission Color", "Emission Strength"),
}
"""By type of node: the inputs that say how brightly it shines. Negative ones take light away."""


@dataclass(frozen=True)
class SceneFault:
    """What is wrong, of which data-block, how often, and a sentence for a reader of the results."""

    name: str
    n: int
    said: str


def faults_at_frame(depsgraph: bpy.types.Depsgraph, *, is_first: bool = True) -> list[SceneFault]:
    """Light that is negative, objects and vertices that are nowhere, at the frame of `depsgraph`.

    Data-blocks without animation are looked at only where `is_first`. UserError for the first lamp or shader with
    a number that is NaN or infinite, or that shines with BRIGHTEST.
    """
    seen = [block for block in depsgraph.ids if is_first or is_animated(block.original)]
    faults = []
    for found in _constants(seen):
        _check(found, depsgraph.scene.frame_current)
        if found.shines and found.value < 0:
            said = f"The light of {found.where} is negative: it darkens what Cycles renders, and no phone sees it."
            faults.append(SceneFault(found.where, 1, said))
    faults += [_nowhere(item) for item in depsgraph.objects if not _is_somewhere(item)]
    return faults + [fault for block in seen if isinstance(block, bpy.types.Mesh) for fault in _mesh_faults(block)]


def _check(found: _Constant, frame: int) -> None:
    if not abs(found.value) < (BRIGHTEST if found.shines else math.inf):
        raise UserError(
            f"{found.where} has {found.value:g} as its {found.name.lower()} at frame {frame}, which Cycles leaves out: "
            f"give it a number{f' below {BRIGHTEST:g}' if found.shines else ''}"
        )


@dataclass(frozen=True)
class _Constant:
    """A number of the data-block `where`; `shines` if it says how brightly."""

    where: str
    name: str
    value: float
    shines: bool


def _constants(blocks: Iterable[bpy.types.ID]) -> Iterator[_Constant]:
    """The constants of all lamps, and of all shaders of materials and worlds, among `blocks`."""
    for block in blocks:
        if isinstance(block, bpy.types.Light):
            where = f"lamp {block.name!r}"
            yield from (_Constant(where, "Strength", float(value), True) for value in (block.energy, *block.color))
        elif isinstance(block, bpy.types.Material | bpy.types.World):
            where = f"{block.bl_rna.name.lower()} {block.name!r}"
        else:
            continue
        if has_nodes(block):
            sockets = [socket for node in block.node_tree.nodes for socket in node.inputs]
            yield from (found for socket in sockets for found in _socket_constants(where, socket))


def _socket_constants(where: str, socket: Any) -> Iterator[_Constant]:
    value = constant(socket, ()) if socket.type in ("VALUE", "RGBA", "VECTOR") else None
    shines = socket.name in EMISSION_INPUTS.get(socket.node.type, ())
    numbers = value if isinstance(value, tuple) else () if value is None else (value,)
    yield from (_Constant(where, socket.name, float(number), shines) for number in numbers)


def _is_somewhere(item: bpy.types.Object) -> bool:
    """Whether all of the transform of an evaluated object is finite."""
    return math.isfinite(sum(sum(abs(number) for number in row) for row in item.matrix_world))


def _nowhere(item: bpy.types.Object) -> SceneFault:
    said = f"Object {item.name!r} has no finite location: Cycles leaves it out. Check its scale and its constraints."
    return SceneFault(item.name, 1, said)


def _mesh_faults(mesh: bpy.types.Mesh) -> Iterator[SceneFault]:
    places = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", places)
    n_broken = int(np.count_nonzero(~np.isfinite(places.reshape(-1, 3)).all(axis=1)))
    if n_broken:
        said = f"{n_broken} vertices of mesh {mesh.name!r} are NaN or infinite: Cycles leaves their faces out."
        yield SceneFault(mesh.name, n_broken, said)


def image_faults(world: bpy.types.World | None) -> list[SceneFault]:
    """Environment textures of `world` with negative pixels, or ones that are NaN or infinite, black to Cycles."""
    faults = []
    for image in dict.fromkeys(_environment_images(world)):
        n_broken, n_negative = _broken_and_negative(image)
        if n_broken:
            said = f"{n_broken} pixels of image {image.name!r} are NaN or infinite: Cycles takes them for black."
            faults.append(SceneFault(image.name, n_broken, said))
        if n_negative:
            said = f"{n_negative} pixels of image {image.name!r} are negative: they darken what Cycles renders."
            faults.append(SceneFault(image.name, n_negative, said))
    return faults


def _environment_images(world: bpy.types.World | None) -> Iterator[bpy.types.Image]:
    if world is None or not has_nodes(world):
        return
    for node in world.node_tree.nodes:
        if node.type == "TEX_ENVIRONMENT" and node.image is not None and not is_film(node.image):
            yield node.image


def _broken_and_negative(image: bpy.types.Image) -> tuple[int, int]:
    """How many pixels of an image have a channel that is not finite, and how many others one that takes light away."""
    if not (image.is_float and image.channels and len(image.pixels)):
        return 0, 0
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    # NaN passes through a minimum: one look tells whether there is anything to count.
    if values.min() >= 0 and values.max() < np.inf:
        return 0, 0
    pixels = values.reshape(-1, image.channels)[:, :3]
    parts = [_counted(pixels[start : start + COUNTED_AT_ONCE]) for start in range(0, len(pixels), COUNTED_AT_ONCE)]
    n_broken, n_negative, taken, given = (sum(of_each) for of_each in zip(*parts, strict=True))
    return int(n_broken), int(n_negative) if taken > NEGLIGIBLE_SHARE * given else 0


def _counted(pixels: ArrayF32) -> tuple[int, int, float, float]:
    """Of (P, 3): pixels that are not finite, others that are negative, the light these take away, all light given."""
    is_finite = np.isfinite(pixels).all(axis=1)
    known = pixels[is_finite].astype(np.float64)
    n_negative = np.count_nonzero((known < 0).any(axis=1))
    return (
        int(np.count_nonzero(~is_finite)),
        n_negative,
        float(-known.clip(max=0).sum()),
        float(known.clip(min=0).sum()),
    )


def place_faults(scene: bpy.types.Scene, positions_m: dict[str, ArrayF64], cameras_m: ArrayF64) -> list[SceneFault]:
    """Estimation positions so far from the world's origin that float32 rounds them, or from every camera (F, 3)."""
    faults, metres = [], metres_per_unit(scene)
    for name, position_m in positions_m.items():
        step_m = float(np.spacing(np.float32(np.abs(position_m / metres).max()))) * metres
        if step_m > COARSEST_M:
            said = (
                f"{name!r} lies so far from the world's origin that Blender's coordinates have steps of {step_m:.2g} m."
            )
            faults.append(SceneFault(name, 1, said))
    if not positions_m:
        return faults
    offsets = cameras_m[:, None] - np.stack(list(positions_m.values()))
    nearest_m = float(np.linalg.norm(offsets, axis=-1).min())
    if not NEAREST_M <= nearest_m <= FARTHEST_M:
        said = (
            f"The phone's smallest distance from a virtual object is {nearest_m:.3g} m: "
            f"is the unit scale (Scene > Units) right? One Blender unit is {metres:g} m."
        )
        faults.append(SceneFault(scene.name, 1, said))
    return faults
