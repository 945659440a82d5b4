"""Surfaces that a range sensor meets, by pixel: reflectance, transmission, roughness, from the capture's own render.

Passes of the working scene's view layer bring them without another render and without a change to a material: the
colour passes say how much light comes back and goes through, textures included, and Cryptomatte says which material it
is, whose roughness the node tree tells. The picture stays the same bytes. Rejected: rays cast per pixel (half a second
a picture), and judging darkness by the picture, in which a bright wall at night is dark, though the sensor brings its
own light.

Not here: reading node trees, see `RoomSurvey`; and roughness that a texture drives, which stays not known (NaN) and
loses no depth.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np

from xihenet.io.npz_files import read_npz
from xihenet.io.whole_files import written_whole
from xihenet.phone import SurfaceFacts
from xihenet.records import ArrayF32

DIFFUSE_RETURN = 0.05
"""Of white: a lacquered table mirrors, but what its wood spreads comes back; below this a surface is a mirror only."""

COLOUR_PASSES = {
    "diffuse": ("DiffCol", "Diffuse Color"),
    "glossy": ("GlossCol", "Glossy Color"),
    "transmission": ("TransCol", "Transmission Color"),
    "emission": ("Emit", "Emission"),
}
"""Names of the passes in a file, before and from Blender 5.0 on."""


def ask_for_surfaces(layer: bpy.types.ViewLayer) -> None:
    """Make renders of `layer`, one of a working scene's, bring the passes that `surfaces_in` reads."""
    layer.use_pass_diffuse_color = layer.use_pass_glossy_color = layer.use_pass_transmission_color = True
    layer.use_pass_emit = layer.use_pass_cryptomatte_material = True
    layer.pass_cryptomatte_depth = 2


def surfaces_in(passes: Mapping[str, ArrayF32], roughness: Mapping[str, float | None]) -> SurfaceFacts:
    """Of one picture: `passes` (H, W) by "<pass>.<channel>", rendered after `ask_for_surfaces`.

    `roughness` is the smoothest by material name, None where it is not known; other materials count as chalk.
    """
    grey = {kind: _grey(passes, names) for kind, names in COLOUR_PASSES.items()}
    # Colour passes of a lamp are black, but lamps are made of something.
    glows = grey["emission"] > 0
    sent_on = grey["diffuse"] + grey["glossy"] + grey["transmission"]
    material_ids = passes["CryptoMaterial00.r"]  # Of the one that covers most of each pixel.
    rough = np.ones(material_ids.shape, np.float32)
    for name, value in roughness.items():
        rough[material_ids == cryptomatte_id(name)] = np.nan if value is None else value
    return SurfaceFacts(
        reflectance=np.where(glows, np.float32(1), np.minimum(sent_on, 1)).astype(np.float32),
        transmission=np.clip(grey["transmission"], 0, 1),
        roughness=np.where(glows | (grey["diffuse"] > DIFFUSE_RETURN), np.float32(1), rough).astype(np.float32),
    )


def save_surfaces(path: Path, surfaces: SurfaceFacts) -> None:
    """Write what `surfaces_in` gave; OSError if that fails."""
    with written_whole(path) as beside:
        known = {name: values for name, values in vars(surfaces).items() if values is not None}
        np.savez_compressed(beside, **known)


def load_surfaces(path: Path) -> SurfaceFacts:
    """Read what `save_surfaces` wrote; ValueError naming the file if it is broken."""
    try:
        return SurfaceFacts(**read_npz(path))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: not what a range sensor meets ({error})") from None


def _grey(passes: Mapping[str, ArrayF32], names: Sequence[str]) -> ArrayF32:
    name = next(name for name in names if f"{name}.R" in passes)
    mean: ArrayF32 = sum(passes[f"{name}.{channel}"] for channel in "RGB") / np.float32(3)  # type: ignore[assignment]
    return mean


def cryptomatte_id(name: str) -> np.float32:
    """The number that Cryptomatte gives `name`: its 32-bit MurmurHash3, made a finite float (Cryptomatte 1.2)."""
    bits = _murmur3(name.encode())
    exponent = min(max(bits >> 23 & 255, 1), 254)
    bits = bits & 0x807FFFFF | exponent << 23
    return np.float32(struct.unpack("<f", struct.pack("<I", bits))[0])


def _murmur3(key: bytes) -> int:
    """MurmurHash3 x86 32 bit, seed 0."""
    hashed = 0
    whole = len(key) // 4 * 4
    for (block,) in struct.iter_unpack("<I", key[:whole]):
        hashed = _rotated(hashed ^ _scrambled(block), 13) * 5 + 0xE6546B64 & 0xFFFFFFFF
    hashed ^= _scrambled(int.from_bytes(key[whole:], "little")) ^ len(key)
    hashed = (hashed ^ hashed >> 16) * 0x85EBCA6B & 0xFFFFFFFF
    hashed = (hashed ^ hashed >> 13) * 0xC2B2AE35 & 0xFFFFFFFF
    return hashed ^ hashed >> 16


def _scrambled(block: int) -> int:
    return _rotated(block * 0xCC9E2D51 & 0xFFFFFFFF, 15) * 0x1B873593 & 0xFFFFFFFF


def _rotated(value: int, by: int) -> int:
    return (value << by | value >> 32 - by) & 0xFFFFFFFF
