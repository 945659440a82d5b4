"""Depth dropout, where a range sensor gives no answer: dark, glossy, transparent and grazing surfaces, and depth edges.

Each effect gives an (H, W) mask of such pixels; `depth.cleared` makes them 0. A sensor's light comes back from a rough
bright surface that faces it. What a picture alone cannot tell (roughness, transmission, reflectance, true normals) the
caller gives as `SurfaceFacts`; where it gives none, darkness is judged by the picture and grazing angles by normals
from the plane depth itself, and glossy and transparent surfaces keep their depth.

Chosen: thresholds, as the published simulation of the Azure Kinect has them. Rejected: a probability per pixel, which
makes a lace that no sensor shows; real dropout takes whole surfaces.
Not here: what a mirror makes a sensor measure instead (the mirrored room).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from xihenet.camera import pixel_rays, valid_plane_depth
from xihenet.phone.depth import window_span_m
from xihenet.phone.settings import Required, Section, SessionFacts, known, number
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt, Intrinsics, RgbdFrame


@dataclass(frozen=True, eq=False)
class SurfaceFacts:
    """What the caller knows of the surface in each pixel of one frame; None where it does not."""

    normals: ArrayF32 | None = None  # (H, W, 3) world, any length; one that is 0 or not finite faces the camera
    roughness: ArrayF32 | None = None  # (H, W) 0 for a mirror, 1 for chalk
    transmission: ArrayF32 | None = None  # (H, W) share of the light that goes through
    reflectance: ArrayF32 | None = None  # (H, W) share that comes back, at the sensor's wavelength or as grey

    def checked_for(self, intrinsics: Intrinsics) -> SurfaceFacts:
        """Itself; ValueError naming the array whose size is not that of the picture."""
        size = (intrinsics.height, intrinsics.width)
        for name, values in vars(self).items():
            expected = (*size, 3) if name == "normals" else size
            if values is not None and np.shape(values) != expected:
                raise ValueError(f"SurfaceFacts.{name}: expected shape {expected}, got {np.shape(values)}")
        return self

    def taken_from(self, source: ArrayInt) -> SurfaceFacts:
        """The facts of pixels `source` (H, W), each an index in row order."""
        known = {name: values for name, values in vars(self).items() if values is not None}
        flat = {name: values.reshape(source.size, *values.shape[2:]) for name, values in known.items()}
        return SurfaceFacts(**{name: values[source] for name, values in flat.items()})


@dataclass(frozen=True, eq=False)
class SeenSurfaces:
    """What the sensor meets in one frame, facts about its surfaces, and the plane depth (H, W) as it was measured."""

    frame: RgbdFrame
    facts: SurfaceFacts
    measured_m: ArrayF32

    @cached_property
    def facing(self) -> ArrayF64:
        """(H, W) of `facing_cosines`."""
        return facing_cosines(self.frame, self.facts)


@dataclass(frozen=True, kw_only=True)
class DepthDropout(Section):
    """An effect that takes pixels away."""

    asks_surfaces: ClassVar[bool] = False  # for `SurfaceFacts`, which then have to be rendered

    def mask(self, seen: SeenSurfaces) -> ArrayBool:
        """(H, W) where the sensor has no answer."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class DarkDropout(DepthDropout):
    """No answer where less than `below_grey` comes back: of the surface's reflectance, or of the picture's grey."""

    asks_surfaces = True
    below_grey: float = number("of white", 0.0, 1.0)

    def required_by(self, facts: SessionFacts) -> Required:
        grey = known(facts.darkest_grey, "how dark the darkest surface is")
        if grey < self.below_grey:
            return True, f"some surfaces are darker ({grey:.2f}) than the sensor needs"
        return False, "no surface is too dark for the sensor"

    def mask(self, seen: SeenSurfaces) -> ArrayBool:
        """By reflectance where it is known, else by the picture's sRGB grey (the mean of the three bytes)."""
        known_share = seen.facts.reflectance
        grey = seen.frame.srgb_u8.mean(axis=2, dtype=np.float32) / 255 if known_share is None else known_share
        return np.less(grey, self.below_grey)


@dataclass(frozen=True, kw_only=True)
class GlossyDropout(DepthDropout):
    """No answer from a surface smoother than `below_roughness` that is turned away more than `beyond_deg`."""

    asks_surfaces = True
    below_roughness: float = number("of Blender's roughness", 0.0, 1.0)
    beyond_deg: float = number("degrees", 0.0, 90.0)

    def required_by(self, facts: SessionFacts) -> Required:
        if known(facts.smoothest_roughness, "how glossy the glossiest surface is") < self.below_roughness:
            return True, "there are surfaces that mirror the sensor's light away"
        return False, "no surface in view is glossy enough to mirror the sensor's light away"

    def mask(self, seen: SeenSurfaces) -> ArrayBool:
        """None where roughness is not known."""
        if seen.facts.roughness is None:
            return np.zeros(seen.measured_m.shape, bool)
        is_turned_away = seen.facing < np.cos(np.radians(self.beyond_deg))
        return np.logical_and(is_turned_away, seen.facts.roughness < self.below_roughness)


@dataclass(frozen=True, kw_only=True)
class TransparentDropout(DepthDropout):
    """No answer where more than `above_transmission` of the light goes through."""

    asks_surfaces = True
    above_transmission: float = number("of the light", 0.0, 1.0)

    def required_by(self, facts: SessionFacts) -> Required:
        if known(facts.highest_transmission, "whether anything is transparent") > self.above_transmission:
            return True, "the sensor's light goes through something in view"
        return False, "no transmissive material is visible to the camera"

    def mask(self, seen: SeenSurfaces) -> ArrayBool:
        """None where transmission is not known."""
        if seen.facts.transmission is None:
            return np.zeros(seen.measured_m.shape, bool)
        return np.greater(seen.facts.transmission, self.above_transmission)


@dataclass(frozen=True, kw_only=True)
class GrazingDropout(DepthDropout):
    """No answer where the surface's normal is more than `beyond_deg` away from the ray back to the camera."""

    beyond_deg: float = number("degrees", 0.0, 90.0)

    def required_by(self, facts: SessionFacts) -> Required:
        steepest_deg = known(facts.steepest_deg, "how flat the camera looks along surfaces")
        if steepest_deg > self.beyond_deg:
            return True, f"some surfaces are turned {steepest_deg:.0f} degrees away from the camera"
        return False, f"no surface is turned more than {self.beyond_deg:.0f} degrees away from the camera"

    def mask(self, seen: SeenSurfaces) -> ArrayBool:
        return np.less(seen.facing, np.cos(np.radians(self.beyond_deg)))


@dataclass(frozen=True, kw_only=True)
class SpanDropout(DepthDropout):
    """No answer where the plane depth spans more than `span_m` in a window of 3 x 3 pixels."""

    span_m: float = number("m", 0.0, 100.0)

    def required_by(self, facts: SessionFacts) -> Required:
        return facts.has_step_over(self.span_m)

    def mask(self, seen: SeenSurfaces) -> ArrayBool:
        """Of the plane depth as it was measured, noise included."""
        return np.greater(window_span_m(seen.measured_m, 1), self.span_m)


def facing_cosines(frame: RgbdFrame, facts: SurfaceFacts) -> ArrayF64:
    """(H, W) cosine between each surface's normal and the ray back to the camera, 0 to 1; both sides count.

    Without normals they come from the plane depth: from the flatter neighbour along each axis, so that a depth edge is
    not taken for a grazing surface. Pixels that are invalid, or alone, face the camera (1).
    """
    rays = pixel_rays(frame.intrinsics)
    if facts.normals is not None:
        is_finite = np.isfinite(facts.normals).all(axis=2, keepdims=True)
        in_camera = np.where(is_finite, facts.normals, 0).astype(np.float64) @ frame.world_from_camera[:3, :3]
    else:
        in_camera = _normals_in_camera(frame.plane_depth_m, rays)
    lengths = np.linalg.norm(in_camera, axis=2) * np.linalg.norm(rays, axis=2)
    dots = np.abs(np.einsum("hwc,hwc->hw", in_camera, rays))
    cosines = np.divide(dots, lengths, out=np.ones(lengths.shape), where=lengths > 0)
    return np.minimum(cosines, 1.0, out=cosines)  # Rounding may leave it above.


def _normals_in_camera(plane_depth_m: ArrayF32, rays: ArrayF64) -> ArrayF64:
    """(H, W, 3), 0 where a neighbour is missing."""
    valid = valid_plane_depth(plane_depth_m)
    points = rays * np.where(valid, plane_depth_m, np.nan)[..., None]
    return np.cross(_flatter_step(points, axis=1), _flatter_step(points, axis=0))


def _flatter_step(points: ArrayF64, axis: int) -> ArrayF64:
    """(H, W, 3) to the next or from the previous point along `axis`, whichever changes plane depth less; else 0."""
    steps = np.diff(points, axis=axis)
    edge = [(0, 0)] * 3
    edge[axis] = (0, 1)
    ahead = np.pad(steps, edge, constant_values=np.nan)
    edge[axis] = (1, 0)
    behind = np.pad(steps, edge, constant_values=np.nan)
    change_ahead, change_behind = (np.nan_to_num(np.abs(s[..., 2]), nan=np.inf) for s in (ahead, behind))
    chosen = np.where((change_ahead <= change_behind)[..., None], ahead, behind)
    return np.nan_to_num(chosen, nan=0.0)
