"""Extras of an answer, beside the coefficients: the key light, and what glossy things reflect, for those who ask."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from xihenet.edge.axes import vector_in
from xihenet.light.key_light import find_key_light
from xihenet.light.reflections import fill_reflections
from xihenet.records import KeyLight, LightEstimate, ObjectLight, Reflections, UnitSphereCloud
from xihenet.sphere import AnchorLattice


@dataclass(frozen=True)
class Wishes:
    """What a client of the clean form may ask for."""

    replaces: bool = False  # the cloud takes the place of what is known of the position, instead of being merged
    is_shared: bool = False  # directions that were not seen are filled from other positions, see `sharing`
    has_key_light: bool = False
    has_reflections: bool = False


def extras_of(
    light: LightEstimate, cloud: UnitSphereCloud, before: KeyLight | None, wishes: Wishes
) -> tuple[KeyLight | None, Reflections | None]:
    """The key light, and reflections if they are wished for; `before` is the key light of the answer before."""
    lattice = AnchorLattice(len(cloud))
    key = find_key_light(light.sh_radiance, cloud, lattice, before, expected_error=light.expected_error)
    if not wishes.has_reflections:
        return key, None
    return key, fill_reflections(cloud, lattice, ObjectLight(light.sh_radiance, key))


def format_extras(
    key: KeyLight | None, reflections: Reflections | None, axes: str, wishes: Wishes
) -> Mapping[str, Any]:
    """What answers say of them: radiance by anchor in base64 of float16, little endian, red, green, blue."""
    told: dict[str, Any] = {}
    if wishes.has_key_light:
        told["key_light"] = (
            None
            if key is None
            else {
                "direction": vector_in(key.direction, axes),
                "irradiance": key.irradiance.tolist(),
                "angular_radius": key.angular_radius,
                "is_seen": key.is_seen,
                "certainty": key.certainty,
            }
        )
    if reflections is not None:
        radiance = reflections.radiance.astype("<f2").tobytes()
        told["reflections"] = {
            "radiance_float16": base64.b64encode(radiance).decode(),
            "seen_share": reflections.seen_share,
        }
    return told
