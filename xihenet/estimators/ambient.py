"""Ambient light, as a phone gives it today: one colour for light from everywhere.

Stands for the ambient light estimates of ARKit (intensity and colour temperature) and ARCore (intensity and colour
correction): a constant sphere of light, l = 0 only. The sensor's RGB is used whole: a colour temperature would lose its
tint, and the baseline should not lose by that.
"""

from __future__ import annotations

import numpy as np

from xihenet.colour import srgb_to_linear
from xihenet.estimators.base import EstimateContext, Estimator
from xihenet.records import ArrayF64, UnitSphereCloud


class Ambient(Estimator):
    """Constant light from the frame's sensor; without one, the mean of the set anchors; without those, black."""

    name = "ambient"
    is_quick, uses_anchors = True, False
    needs = frozenset({"frame"})

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        """A sensor knows it wherever the camera looks."""
        return "" if _sensed_radiance(context) is not None else super().unknown_because(cloud, context)

    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        radiance = _sensed_radiance(context)
        if radiance is None:
            # Sums of thousands of colours in float32 are off by up to 6e-4 of themselves.
            seen = cloud.srgb[cloud.is_set].astype(np.float64)
            radiance = srgb_to_linear(seen).mean(axis=0) if len(seen) else np.zeros(3)
        return constant_light(np.minimum(radiance, 1.0) if self.target == "ldr" else radiance)


def constant_light(radiance: ArrayF64) -> ArrayF64:
    """(9, 3) coefficients of light of `radiance` ((3,)) from everywhere: its integral with Y_00 = 1 / (2 sqrt(pi))."""
    sh_radiance = np.zeros((9, 3))
    sh_radiance[0] = 2 * np.sqrt(np.pi) * radiance
    return sh_radiance


def _sensed_radiance(context: EstimateContext) -> ArrayF64 | None:
    """(3,) mean radiance of the sensor at the session's exposure, or None without a sensor."""
    frame = context.frame
    if frame is None or frame.ambient is None:
        return None
    return frame.ambient * (context.reference_exposure or frame.exposure)
