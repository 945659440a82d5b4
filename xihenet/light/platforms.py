"""Platforms: which axes, signs, order and scale does each engine expect of a light, and what of it apart?

Ours is radiance in the real orthonormal basis of order 2 without signs, index l (l + 1) + m, in Blender's axes: +Z up,
right-handed. All engines use the same polynomials in their own axes, so a `Convention` is axes, a factor for each
coefficient, and the order in which they are stored. The key light goes apart wherever an engine takes a main light, and
the coefficients are then what is left of the light, so that nothing is applied twice.

Where an engine's sources contradict each other, or say nothing, each reading of them is a convention with a name. What
was proven by rendering in the engine and what was only read is in docs/platforms.md, with the sources.

Pictures of the environment, for engines that take these, are made in `xihenet.light.environments`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from xihenet.light.key_light import rest_of
from xihenet.records import ArrayF64, ObjectLight
from xihenet.sh import cosine_lobe, rotate
from xihenet.sh_basis import per_coefficient

NORMALISATION = np.sqrt(np.array([1, 3, 3, 3, 15, 15, 5 / 4, 15, 15 / 4]) / (4 * np.pi))
"""Of the basis functions: each is this times its polynomial, 1, y, z, x, xy, yz, 3z2 - 1, xz, x2 - y2."""

SIGNS = np.array([1, -1, 1, -1, 1, -1, 1, -1, 1.0])
"""Of Condon and Shortley: minus where m is odd."""

_OF_COSINE = per_coefficient(cosine_lobe(2))
LAMBERT = NORMALISATION * _OF_COSINE / np.pi
"""Times radiance coefficients they weight the bare polynomials; the sum is what a white diffuse surface sends back."""

IN_ORDER = (0, 1, 2, 3, 4, 5, 6, 7, 8)
MIRRORED_X = np.array([1, 1, 1, -1, -1, 1, 1, -1, 1.0])
"""(9,) -1 for the spherical harmonics that change their sign with x."""

Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
X_MIRRORED, Z_MIRRORED = np.diag([-1.0, 1, 1]) @ Y_UP, np.diag([1.0, 1, -1]) @ Y_UP
Y_MIRRORED_Z_UP = np.diag([1.0, -1, 1])

Direction = Literal["towards the light", "along its travel"]
Layout = Literal["+X", "-Y"]
"""Which of Blender's axes is in the middle of a panorama, where ours have +Y."""


@dataclass(frozen=True, eq=False)
class Convention:
    """How an engine stores a light.

    Parameters
    ----------
    axes : (3, 3) orthonormal; a direction in Blender's axes times this is the same direction in the engine's. A
        determinant of -1 makes them left-handed
    axes_text : where Blender's (x, y, z) is found
    factors : (9,) what each radiance coefficient is multiplied by, in our order
    order : which of ours stands at each place
    by_colour : whether all nine of red come first, then green and blue; else red, green and blue of each
    direction : which way that of the main light points
    main_scale : what the main light's irradiance is multiplied by to give its intensity
    main_unit : of that intensity, in words
    main_gamma : power that the engine takes of its colour to make it linear, where it has to carry intensities below 1
    soft_axes : as `axes`, of the coefficients and of a cube map, where the engine does not turn them with the objects;
        None for the same
    """

    axes: ArrayF64
    axes_text: str
    factors: ArrayF64 = field(default_factory=lambda: np.ones(9))
    order: tuple[int, ...] = IN_ORDER
    by_colour: bool = False
    direction: Direction = "towards the light"
    main_scale: float = 1.0
    main_unit: str = "irradiance of a surface that faces it"
    main_gamma: float = 1.0
    soft_axes: ArrayF64 | None = None

    @property
    def axes_of_soft_light(self) -> ArrayF64:
        """(3, 3) of the coefficients and of a cube map."""
        return self.axes if self.soft_axes is None else self.soft_axes


@dataclass(frozen=True, eq=False)
class Platform:
    """An engine, or a file format.

    Parameters
    ----------
    title : its name
    readings : conventions by name, the default one first; none where it takes a picture alone
    main_light_apart : whether it takes the key light apart
    picture : layout of the picture that its soft light is; None where it takes coefficients
    script : file beside this one that reads the JSON there, to be written with it
    """

    title: str
    readings: Mapping[str, Convention] = field(default_factory=dict)
    main_light_apart: bool = True
    picture: Layout | None = None
    script: str = ""


@dataclass(frozen=True)
class MainLight:
    """A key light as an engine takes it: unit `direction`, `colour` of at most 1, and `intensity`."""

    direction: tuple[float, float, float]
    colour: tuple[float, float, float]
    intensity: float
    angular_diameter_deg: float


_RIGHT = Convention(Y_UP, "right-handed, Y up: Blender's (x, y, z) is (x, z, -y)")
_SOFT_APART = _RIGHT.axes_text + "; but coefficients and cube map have {} mirrored, for {}"
_SIGNED = replace(_RIGHT, factors=SIGNS)
_TRAVELS = replace(_RIGHT, direction="along its travel")
_UNITY = Convention(
    Z_MIRRORED,
    "left-handed, Y up: Blender's (x, y, z) is (x, z, y)",
    factors=LAMBERT,
    by_colour=True,
    direction="along its travel",
    main_scale=1 / np.pi,
    main_unit="that of a Light whose intensity is linear, see GraphicsSettings.lightsUseLinearIntensity; times pi, lux "
    "in the high definition pipeline",
)
_ARKIT = replace(
    _RIGHT,
    by_colour=True,
    direction="along its travel",
    main_scale=1000 / np.pi,
    main_unit="lumen, where 1000 is taken for a white surface that is as bright as white in the picture",
)
_SWAPPED = (0, 1, 2, 3, 4, 5, 7, 6, 8)

PLATFORMS: Mapping[str, Platform] = MappingProxyType(
    {
        "three": Platform("three.js LightProbe and DirectionalLight", {"default": _RIGHT}),
        "babylon": Platform(
            "Babylon.js SphericalHarmonics and DirectionalLight",
            {
                "left-handed": Convention(
                    X_MIRRORED,
                    "left-handed, Y up, as its glTF loader turns things: Blender's (x, y, z) is (-x, z, -y)",
                    factors=SIGNS,
                    direction="along its travel",
                ),
                "right-handed": replace(
                    _TRAVELS,
                    axes_text=_SOFT_APART.format("z", "its right-handed scenes"),
                    factors=SIGNS,
                    soft_axes=Z_MIRRORED,
                ),
            },
        ),
        "filament": Platform(
            "Filament IndirectLight and directional light",
            {
                "irradiance": replace(_TRAVELS, factors=LAMBERT, main_unit="lux where the light's intensity is 1"),
                "radiance": replace(_TRAVELS, factors=SIGNS, main_unit="lux where the light's intensity is 1"),
            },
        ),
        "model-viewer": Platform("model-viewer environment-image", main_light_apart=False, picture="+X"),
        "playcanvas": Platform(
            "PlayCanvas environment atlas and directional light",
            {
                "default": replace(
                    _TRAVELS,
                    main_scale=1 / np.pi,
                    main_unit="what a white surface that faces it sends back; the color is not linear",
                    main_gamma=2.2,
                )
            },
            picture="-Y",
        ),
        "unity": Platform(
            "Unity SphericalHarmonicsL2 and Light",
            {
                "ar-foundation": _UNITY,
                "fbx": replace(
                    _UNITY, axes=X_MIRRORED, axes_text="left-handed, Y up: Blender's (x, y, z) is (-x, z, -y)"
                ),
            },
            script="XiheLight.cs",
        ),
        "unreal": Platform(
            "Unreal FSHVectorRGB3 and directional light",
            {
                "default": Convention(
                    Y_MIRRORED_Z_UP,
                    "left-handed, Z up: Blender's (x, y, z) is (x, -y, z)",
                    factors=SIGNS,
                    by_colour=True,
                    direction="along its travel",
                    main_unit="lux",
                )
            },
        ),
        "arcore": Platform(
            "ARCore Environmental HDR",
            {"condon-shortley": _SIGNED, "positive": _RIGHT, "sceneform": replace(_SIGNED, order=_SWAPPED)},
        ),
        "arkit": Platform(
            "ARKit ARDirectionalLightEstimate",
            {"radiance": _ARKIT, "unity": replace(_ARKIT, factors=LAMBERT)},
        ),
        "openxr": Platform("OpenXR XR_ANDROID_light_estimation", {"default": _RIGHT}),
        "webxr": Platform(
            "WebXR XRLightEstimate", {"positive": _RIGHT, "condon-shortley": _SIGNED}, script="webxr_replay.js"
        ),
        "gltf": Platform(
            "glTF EXT_lights_image_based and KHR_lights_punctual",
            {
                "condon-shortley": replace(
                    _TRAVELS,
                    axes_text=_SOFT_APART.format("x", "a scene of Babylon.js that is not right-handed"),
                    factors=SIGNS * _OF_COSINE,
                    soft_axes=X_MIRRORED,
                ),
                "right-handed": replace(
                    _TRAVELS,
                    axes_text=_SOFT_APART.format("z", "a right-handed scene of Babylon.js"),
                    factors=SIGNS * _OF_COSINE,
                    soft_axes=Z_MIRRORED,
                ),
                "positive": replace(_TRAVELS, factors=_OF_COSINE),
            },
        ),
        "usd": Platform(
            "UsdLux DomeLight and DistantLight",
            {
                "specification": _TRAVELS,
                "blender": replace(
                    _TRAVELS, main_scale=0.25, main_unit="a quarter of the irradiance: Blender multiplies a sun by four"
                ),
            },
            picture="-Y",
        ),
    }
)


def convention_of(name: str, reading: str | None = None) -> Convention:
    """That of a platform, by one of its readings or the default one; ValueError, naming the choices, for others."""
    if name not in PLATFORMS:
        raise ValueError(f"there is no platform {name!r}; choose one of {', '.join(PLATFORMS)}")
    readings = PLATFORMS[name].readings
    if not readings:
        raise ValueError(f"{name} takes a picture of the environment and no coefficients")
    if reading is not None and reading not in readings:
        raise ValueError(f"{name} has no reading {reading!r}; choose one of {', '.join(readings)}")
    return next(iter(readings.values())) if reading is None else readings[reading]


def in_axes(sh_radiance: ArrayF64, axes: ArrayF64) -> ArrayF64:
    """(9, 3) of the same light in the axes of an engine, (3, 3) as of `Convention`."""
    if np.linalg.det(axes) > 0:
        return rotate(sh_radiance, axes)
    # Turned first, and mirrored in the engine's own x, where the functions that are odd in x change sign.
    return MIRRORED_X[:, None] * rotate(sh_radiance, np.diag([-1.0, 1, 1]) @ axes)


def coefficients_for(sh_radiance: ArrayF64, convention: Convention) -> ArrayF64:
    """(27,) as the engine stores them, of radiance coefficients (9, 3) in Blender's axes.

    ValueError for coefficients of another shape, NaN or infinite.
    """
    own = (in_axes(sh_radiance, convention.axes_of_soft_light) * convention.factors[:, None])[list(convention.order)]
    return (own.T if convention.by_colour else own).ravel()


def main_light_for(light: ObjectLight, convention: Convention) -> MainLight | None:
    """The key light as the engine takes it; None where there is none, or it is black."""
    key = light.key
    if key is None or not key.irradiance.max() > 0:
        return None
    towards = convention.axes @ key.direction
    x, y, z = towards if convention.direction == "towards the light" else -towards
    emitted = np.maximum(key.irradiance, 0) * convention.main_scale
    intensity = float(emitted.max())
    if convention.main_gamma != 1:
        intensity = max(intensity, 1.0)
    red, green, blue = (emitted / intensity) ** (1 / convention.main_gamma)
    return MainLight(
        (float(x), float(y), float(z)),
        (float(red), float(green), float(blue)),
        intensity,
        float(np.degrees(2 * key.angular_radius)),
    )


def soft_light(light: ObjectLight, platform: Platform) -> ArrayF64:
    """(9, 3) radiance coefficients of what the engine does not take apart: all of the light where it takes none."""
    return rest_of(light) if platform.main_light_apart else np.asarray(light.sh, np.float64)
