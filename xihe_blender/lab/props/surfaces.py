"""Surfaces: the materials that things are made of.

Every material is a Principled shader whose colour and relief come from procedural textures in object space, which
keeps a scene at some hundred kilobytes where photographs would need megabytes. Mix factors are moderate: at 16 samples
and 256 pixels fine high-contrast grain would only look like noise.

Colours are linear Rec.709, albedo below 0.85: brighter walls make interreflection endless and are not paint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import bpy

from xihe_blender.lab.props import Material

Colour: TypeAlias = Sequence[float]
Inputs: TypeAlias = dict[str | int, Any]


class Nodes:
    """The nodes of a material, a light or a world under construction."""

    def __init__(self, owner: Any) -> None:
        if owner.node_tree is None:  # from 5.0 on what is new has its nodes, and asking for them warns
            owner.use_nodes = True
        self.nodes, self.links = owner.node_tree.nodes, owner.node_tree.links

    def first(self, kind: str) -> Any:
        """The first node of a type: what is new has some."""
        return next(node for node in self.nodes if node.type == kind)

    def add(self, kind: str, inputs: Mapping[str | int, Any] | None = None, **properties: Any) -> Any:
        """A new node of `ShaderNode<kind>`; an input is a value or another node's socket."""
        node = self.nodes.new("ShaderNode" + kind)
        for name, value in properties.items():
            setattr(node, name, value)
        self.set(node, inputs or {})
        return node

    def set(self, node: Any, inputs: Mapping[str | int, Any]) -> None:
        for name, value in inputs.items():
            socket = node.inputs[name]
            if isinstance(value, bpy.types.NodeSocket):
                self.links.new(value, socket)
            else:
                socket.default_value = (*value, 1.0) if socket.type == "RGBA" and len(value) == 3 else value

    def ramp(self, factor: Any, *stops: tuple[float, Colour]) -> Any:
        node = self.add("ValToRGB", {0: factor})
        elements = node.color_ramp.elements
        while len(elements) < len(stops):
            elements.new(0.5)
        for element, (place, colour) in zip(elements, stops, strict=True):
            element.position, element.color = place, (*colour, 1.0)
        return node.outputs[0]


class Shader(Nodes):
    """A material under construction; `look` names inputs of its Principled shader, as in roughness=0.3."""

    def __init__(self, name: str, **look: Any) -> None:
        self.material = bpy.data.materials.new(name)
        super().__init__(self.material)
        self.surface, self.output = self.first("BSDF_PRINCIPLED"), self.first("OUTPUT_MATERIAL")
        names = {key: key.replace("_", " ").title().replace("Ior", "IOR") for key in look}
        self.set(self.surface, {names[key]: value for key, value in look.items()})

    def position(self, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> Any:
        """Object-space coordinates, stretched."""
        mapping = self.add("Mapping", {"Vector": self.add("TexCoord").outputs["Object"], "Scale": scale})
        return mapping.outputs["Vector"]

    def noise(self, scale: float, *, stretch: Sequence[float] = (1.0, 1.0, 1.0), detail: float = 3.0) -> Any:
        """A noise between 0 and 1."""
        return self.add("TexNoise", {"Vector": self.position(stretch), "Scale": scale, "Detail": detail}).outputs[0]

    def coloured(self, colour: Any, height: Any = None, distance_m: float = 0.0, strength: float = 0.0) -> Material:
        """The material in a colour; a height between 0 and 1 bumps it."""
        self.set(self.surface, {"Base Color": colour})
        if height is not None:
            bump = self.add("Bump", {"Height": height, "Distance": distance_m, "Strength": strength})
            self.set(self.surface, {"Normal": bump.outputs[0]})
        return self.material

    def translucent(self, colour: Any, share: float) -> Material:
        """The material, through which a share of the light comes in a colour."""
        through = self.add("BsdfTranslucent", {"Color": colour})
        mixed = self.add("MixShader", {0: share, 1: self.surface.outputs[0], 2: through.outputs[0]})
        self.set(self.output, {"Surface": mixed.outputs[0]})
        return self.material


def shade(colour: Colour, factor: float) -> tuple[float, ...]:
    return tuple(min(0.85, c * factor) for c in colour)


def plain(name: str, colour: Colour, **look: Any) -> Material:
    """One colour; `look` names further Principled inputs, as in roughness=0.3."""
    return Shader(name, base_color=colour, **{"roughness": 0.5, **look}).material


def paint(name: str, colour: Colour, *, mottling: float = 0.06, roughness: float = 0.75) -> Material:
    """Painted plaster: broad, faint stains and a little roller grain."""
    shader = Shader(name, roughness=roughness, specular_ior_level=0.3)
    stains = shader.ramp(shader.noise(0.8), (0.3, shade(colour, 1 - mottling)), (0.7, shade(colour, 1 + mottling)))
    return shader.coloured(stains, shader.noise(90.0), 0.002, 0.15)


def wood(name: str, dark: Colour, light: Colour, *, grain: str = "X", roughness: float = 0.45) -> Material:
    """Wood with the grain along an object axis."""
    shader = Shader(name, roughness=roughness, specular_ior_level=0.4)
    stretch = tuple(0.06 if axis == grain else 1.0 for axis in "XYZ")
    rings = shader.noise(14.0, stretch=stretch, detail=5.0)
    return shader.coloured(shader.ramp(rings, (0.3, dark), (0.7, light)), rings, 0.002, 0.2)


def planks(name: str, dark: Colour, light: Colour, *, width_m: float = 0.14) -> Material:
    """A plank floor: each board its own tone, grain along X, dark joints."""
    shader = Shader(name, specular_ior_level=0.4)
    tones: Inputs = {"Color1": dark, "Color2": light, "Mortar": shade(dark, 0.25), "Scale": 1.0}
    sizes: Inputs = {"Mortar Size": 0.003, "Mortar Smooth": 0.1, "Brick Width": 1.3, "Row Height": width_m}
    boards = shader.add("TexBrick", {"Vector": shader.position(), **tones, **sizes}, offset=0.37)
    grain = shader.noise(9.0, stretch=(0.08, 1.0, 1.0), detail=6.0)
    fibres = shader.ramp(grain, (0.25, (0.62, 0.6, 0.58)), (0.75, (1.0, 1.0, 1.0)))
    mixed = shader.add("Mix", {0: 1.0, 6: boards.outputs[0], 7: fibres}, data_type="RGBA", blend_type="MULTIPLY")
    gloss = shader.add("MapRange", {0: grain, 3: 0.32, 4: 0.5})
    shader.set(shader.surface, {"Roughness": gloss.outputs[0]})
    return shader.coloured(mixed.outputs[2], boards.outputs[1], -0.002, 0.4)


def masonry(
    name: str, tones: tuple[Colour, Colour, Colour], brick_m: tuple[float, float], *, joint_m: float = 0.01,
    upright: bool = False, offset: float = 0.5, roughness: float = 0.85,
) -> Material:  # fmt: skip
    """Bricks, slabs or tiles of two tones and a joint colour, laid flat in XY or upright in XZ and YZ."""
    shader = Shader(name, roughness=roughness, specular_ior_level=0.3)
    place = shader.position()
    if upright:  # rows go up; along a wall of either direction x + y runs on
        parts = shader.add("SeparateXYZ", {0: place}).outputs
        along = shader.add("Math", {0: parts[0], 1: parts[1]}, operation="ADD").outputs[0]
        place = shader.add("CombineXYZ", {0: along, 1: parts[2]}).outputs[0]
    colours: Inputs = dict(zip(("Color1", "Color2", "Mortar"), tones, strict=True))
    width_m, height_m = brick_m
    sizes: Inputs = {"Scale": 1.0, "Mortar Size": joint_m / 2, "Brick Width": width_m, "Row Height": height_m}
    bricks = shader.add("TexBrick", {"Vector": place, **colours, **sizes}, offset=offset)
    stains = shader.ramp(shader.noise(2.5, detail=6.0), (0.25, (0.7, 0.68, 0.66)), (0.75, (1.0, 1.0, 1.0)))
    mixed = shader.add("Mix", {0: 1.0, 6: bricks.outputs[0], 7: stains}, data_type="RGBA", blend_type="MULTIPLY")
    return shader.coloured(mixed.outputs[2], bricks.outputs[1], -0.006, 0.6)


def fabric(name: str, colour: Colour, *, weave_per_m: float = 160.0, contrast: float = 0.25) -> Material:
    """Woven cloth: patches of wear, a weave in the relief, a little sheen."""
    shader = Shader(name, roughness=0.95, specular_ior_level=0.1, sheen_weight=0.15)
    wear = shader.noise(7.0, detail=5.0)
    tones = shader.ramp(wear, (0.3, shade(colour, 1 - contrast)), (0.7, shade(colour, 1 + contrast)))
    return shader.coloured(tones, shader.noise(weave_per_m), 0.004, 0.35)


def carpet(name: str, ground: Colour, figure: Colour, line: Colour) -> Material:
    """A rug with rows of lozenges: two crossing waves, cut into steps."""
    shader = Shader(name, roughness=1.0, specular_ior_level=0.0)
    waves = [
        shader.add("TexWave", {"Vector": shader.position((1.0, s, 1.0)), "Scale": 1.6, "Distortion": 0.4},
                   bands_direction="DIAGONAL", wave_profile="TRI").outputs[1]
        for s in (1.0, -1.0)
    ]  # fmt: skip
    crossing = shader.add("Math", {0: waves[0], 1: waves[1]}, operation="MULTIPLY").outputs[0]
    pattern = shader.ramp(crossing, (0.0, figure), (0.12, line), (0.17, ground), (0.6, ground), (0.66, figure))
    return shader.coloured(pattern, shader.noise(220.0), 0.006, 0.5)


def coloured_by_face(name: str) -> Material:
    """Takes the colour attribute `Colour` of the mesh: one material and one object for a shelf of books."""
    shader = Shader(name, roughness=0.6, specular_ior_level=0.3)
    return shader.coloured(shader.add("Attribute", attribute_name="Colour").outputs["Color"])


def foliage(name: str, dark: Colour, light: Colour) -> Material:
    """Leaves: light comes through them a little."""
    shader = Shader(name, roughness=0.5, specular_ior_level=0.4)
    tones = shader.ramp(shader.noise(6.0), (0.3, dark), (0.7, light))
    shader.coloured(tones)
    return shader.translucent(tones, 0.3)


def curtain_cloth(name: str, colour: Colour) -> Material:
    """Cloth that daylight shines through."""
    return Shader(name, base_color=colour, roughness=1.0, specular_ior_level=0.0).translucent(colour, 0.4)


def painting(name: str, stops: Sequence[tuple[float, Colour]], *, scale: float = 1.7) -> Material:
    """An abstract picture: bands of colour along a warped noise."""
    shader = Shader(name, roughness=0.6, specular_ior_level=0.2)
    return shader.coloured(shader.ramp(shader.noise(scale, stretch=(0.6, 0.6, 1.4), detail=1.5), *stops))


def patches(name: str, one: Colour, other: Colour, *, size_m: float, roughness: float) -> Material:
    """Sharp-edged patches of two colours: a print, marble, stains."""
    shader = Shader(name, roughness=roughness)
    return shader.coloured(shader.ramp(shader.noise(1 / size_m, detail=4.0), (0.48, one), (0.52, other)))


def glowing(name: str, kelvin: float, radiance: float) -> Material:
    """A lit lampshade: emits a black body's colour at about this luminance; the node is named for keying.

    It reflects next to nothing: a shade that the bulb lights from 10 cm away is itself a fierce light that only chance
    hits find, and gave four fifths of the noise of a lamp-lit room (RMSE 0.086 against 0.020 at 16 samples).
    """
    shader = Shader(name, base_color=(0.03, 0.03, 0.03), roughness=0.9, specular_ior_level=0.0)
    tint = shader.add("Blackbody", {0: kelvin}, name="Temperature", label="Temperature")
    shader.set(shader.surface, {"Emission Color": tint.outputs[0], "Emission Strength": radiance})
    return shader.material
