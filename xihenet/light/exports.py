"""The files that carry a light into an engine: what `xihe export` writes, as names and bytes.

Engines that take coefficients get one JSON with all lights, and what it says of axes, units and main light is what
`xihenet.light.platforms` knows. glTF and USD get a document for each light, model-viewer and PlayCanvas a picture for
each; Unity gets a script that reads its JSON. What glossy things reflect is a picture beside, where a light has one.
"""

from __future__ import annotations

import base64
import itertools
import json
import math
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from typing import Any

import numpy as np

from xihenet import __version__
from xihenet.io.png import encode_png
from xihenet.light.cube_maps import cube_levels, encode_rgbd
from xihenet.light.environments import encode_hdr, environment_picture, laid_out, reflections_picture
from xihenet.light.key_light import brighter
from xihenet.light.platforms import (
    PLATFORMS,
    Convention,
    Layout,
    MainLight,
    coefficients_for,
    convention_of,
    main_light_for,
    soft_light,
)
from xihenet.records import ArrayF64, ObjectLight

REFLECTIONS: Layout = "+X"
"""How they are laid out where an engine takes no other picture: as in three.js."""

NAME_BYTES = 60
"""Of a file's name for the object, which engines and file systems all take."""


@dataclass(frozen=True, eq=False)
class NamedLight:
    """The light of a virtual object from a frame on, in the units of the export.

    `panorama` (H, 2H, 3) is what glossy things reflect, for a light that has it as a picture and not by directions.
    """

    object_name: str
    frame: int
    time_s: float
    light: ObjectLight
    panorama: ArrayF64 | None = None


def scaled(light: ObjectLight, gain: float) -> ObjectLight:
    """The light `gain` times as bright."""
    reflections = light.reflections
    if reflections is not None:
        reflections = replace(reflections, radiance=reflections.radiance * gain)
    return replace(light, sh=light.sh * gain, key=light.key and brighter(light.key, gain), reflections=reflections)


def export_files(
    lights: Sequence[NamedLight], platform: str, *, reading: str | None = None, units: str = "radiance"
) -> dict[str, bytes]:
    """The files for `platform`, by name; `units` says in words what radiance 1 is.

    ValueError for an unknown platform or reading, for no light, and for two lights of one object at one frame.
    """
    if not lights:
        raise ValueError("export_files: expected at least one light")
    names = file_names([one.object_name for one in lights])
    stems = [f"{names[one.object_name]}_{one.frame:04d}" for one in lights]
    stem, n = Counter(stems).most_common(1)[0]
    if n > 1:
        raise ValueError(f"two lights would be written to files named {stem!r}: rename one of the objects")
    known = PLATFORMS.get(platform)
    takes_a_picture = known is not None and not known.readings and reading is None
    convention = None if takes_a_picture else convention_of(platform, reading)
    files: dict[str, bytes] = {}
    entries = []
    for one, stem in zip(lights, stems, strict=True):
        entry, of_one = _entry(one, stem, platform, convention)
        entries.append(entry)
        files |= of_one
    files[f"{platform}.json"] = _json(
        {
            "target": platform,
            "for": PLATFORMS[platform].title,
            **({} if convention is None else _facts(platform, convention, reading)),
            "units": units,
            **({"pictures": _format_pictures(platform)} if any(name.endswith(".hdr") for name in files) else {}),
            "software": f"xihe {__version__}",
            "lights": entries,
        }
    )
    script = PLATFORMS[platform].script
    if script:
        files[script] = resources.files("xihenet.light").joinpath(script).read_bytes()
    return files


def file_names(object_names: Sequence[str]) -> dict[str, str]:
    """What files of each object are named by: letters, of all alphabets, and digits of its name, and no two alike.

    Objects whose names differ in nothing else are numbered. Upper and lower case count as alike, as file systems do.
    """
    names: dict[str, str] = {}
    taken: set[str] = set()
    for object_name in dict.fromkeys(object_names):
        whole = unicodedata.normalize("NFC", object_name)
        # Marks are the vowels of many alphabets.
        kept = (one if one.isalnum() or unicodedata.category(one).startswith("M") else " " for one in whole)
        cut = "_".join("".join(kept).split()).encode()[:NAME_BYTES].decode(errors="ignore").rstrip("_") or "object"
        numbered = itertools.chain([cut], (f"{cut}_{number}" for number in itertools.count(2)))
        names[object_name] = next(name for name in numbered if name.casefold() not in taken)
        taken.add(names[object_name].casefold())
    return names


def _facts(platform: str, convention: Convention, reading: str | None) -> dict[str, Any]:
    of_main = {"direction": convention.direction, "intensity": convention.main_unit}
    facts: dict[str, Any] = {"axes": convention.axes_text, "mainLight": of_main}
    if PLATFORMS[platform].picture is None:
        facts["coefficients"] = "all of red, green, blue" if convention.by_colour else "red, green, blue of each"
    if len(PLATFORMS[platform].readings) > 1:
        facts["reading"] = reading or next(iter(PLATFORMS[platform].readings))
    return facts


def _format_pictures(platform: str) -> str:
    return (
        f"equirectangular, seen from within: the top row is up, the middle column looks along Blender's "
        f"{PLATFORMS[platform].picture or REFLECTIONS}, what lies to the right of that is to the right"
    )


def _entry(
    one: NamedLight, stem: str, platform: str, convention: Convention | None
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """What the JSON says of a light, and the files beside it, whose names begin with `stem`."""
    known, files = PLATFORMS[platform], dict[str, bytes]()
    entry: dict[str, Any] = {"object": one.object_name, "frame": one.frame, "time_s": one.time_s}
    main = None
    if convention is not None and known.main_light_apart:
        main = main_light_for(one.light, convention)
        entry["mainLight"] = None if main is None else _main_entry(main)
    if known.picture is not None:
        entry["environment"] = f"{stem}.hdr"
        picture = environment_picture(one.light, known)
        files[entry["environment"]] = encode_hdr(laid_out(picture, known.picture))
    elif convention is not None:
        entry["sh"] = coefficients_for(soft_light(one.light, known), convention).tolist()
        if platform == "openxr":
            entry["sh_total"] = coefficients_for(one.light.sh, convention).tolist()
    reflected = reflections_picture(one.light) if one.panorama is None else one.panorama
    if reflected is not None:
        entry["reflections"] = f"{stem}_reflections.hdr"
        files[entry["reflections"]] = encode_hdr(laid_out(reflected, known.picture or REFLECTIONS))
    if platform == "usd":
        files[f"{stem}.usda"] = usd_document(entry["environment"], main).encode()
    if platform == "gltf":
        picture = environment_picture(one.light, known) if reflected is None else reflected
        assert convention is not None
        levels = cube_levels(picture, convention.axes_of_soft_light)
        files[f"{stem}.gltf"] = _json(gltf_document(entry["sh"], main, levels))
    return entry, files


def _main_entry(main: MainLight) -> dict[str, Any]:
    return {
        "direction": list(main.direction),
        "color": list(main.colour),
        "intensity": main.intensity,
        "angularDiameterDegrees": main.angular_diameter_deg,
    }


def _json(content: Mapping[str, Any]) -> bytes:
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def usd_document(texture: str, main: MainLight | None) -> str:
    """A stage, Y up, with a DomeLight and the key light as a DistantLight: its intensity is the irradiance."""
    distant = ""
    if main is not None:
        w, x, y, z = turn_from_minus_z(main.direction)
        distant = f"""
    def DistantLight "Key"
    {{
        float inputs:angle = {main.angular_diameter_deg:.9g}
        color3f inputs:color = ({", ".join(f"{c:.9g}" for c in main.colour)})
        float inputs:intensity = {main.intensity:.9g}
        bool inputs:normalize = true
        quatf xformOp:orient = ({w:.9g}, {x:.9g}, {y:.9g}, {z:.9g})
        uniform token[] xformOpOrder = ["xformOp:orient"]
    }}
"""
    return f"""#usda 1.0
(
    defaultPrim = "Light"
    metersPerUnit = 1
    upAxis = "Y"
)

def Xform "Light"
{{
    def DomeLight "Soft"
    {{
        float inputs:intensity = 1
        asset inputs:texture:file = @./{texture}@
        token inputs:texture:format = "latlong"
    }}
{distant}}}
"""


def gltf_document(coefficients: Sequence[float], main: MainLight | None, levels: Sequence[ArrayF64]) -> dict[str, Any]:
    """A scene lit by EXT_lights_image_based, with the `cube_levels`, and by KHR_lights_punctual."""
    # The extension has each face flipped, and Babylon.js turns it back: rows begin at the lower edge.
    faces = [encode_png(encode_rgbd(face[::-1])) for level in levels for face in level]
    pictures = [base64.b64encode(face).decode() for face in faces]
    nodes = {} if main is None else {"nodes": [0]}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"xihe {__version__}"},
        "extensionsUsed": ["EXT_lights_image_based"],
        "scene": 0,
        "scenes": [{**nodes, "extensions": {"EXT_lights_image_based": {"light": 0}}}],
        "images": [{"mimeType": "image/png", "uri": f"data:image/png;base64,{picture}"} for picture in pictures],
        "extensions": {
            "EXT_lights_image_based": {
                "lights": [
                    {
                        "name": "Soft",
                        "intensity": 1.0,
                        "rotation": [0, 0, 0, 1],
                        "irradianceCoefficients": np.reshape(coefficients, (9, 3)).tolist(),
                        "specularImageSize": levels[0].shape[1],
                        "specularImages": np.arange(len(faces)).reshape(-1, 6).tolist(),
                    }
                ]
            }
        },
    }
    if main is not None:
        w, x, y, z = turn_from_minus_z(main.direction)
        light = {"name": "Key", "type": "directional", "color": list(main.colour), "intensity": main.intensity}
        document["extensionsUsed"].append("KHR_lights_punctual")
        document["extensions"]["KHR_lights_punctual"] = {"lights": [light]}
        extension = {"KHR_lights_punctual": {"light": 0}}
        document["nodes"] = [{"name": "Key", "rotation": [x, y, z, w], "extensions": extension}]
    return document


def turn_from_minus_z(travel: Sequence[float]) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z) that turns -Z, where lights of glTF and USD shine, into the direction of travel."""
    x, y, z = travel
    if z > 1 - 1e-12:
        return 0.0, 0.0, 1.0, 0.0
    # Half the way between both directions: w = 1 + (-Z . travel), the axis is their cross product.
    w, axis = 1 - z, (y, -x, 0.0)
    length = math.sqrt(w * w + axis[0] ** 2 + axis[1] ** 2)
    return w / length, axis[0] / length, axis[1] / length, 0.0
