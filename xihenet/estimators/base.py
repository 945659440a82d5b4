"""The protocol of every estimator: a cloud goes in, nine finite coefficients per channel come out.

The checks that all estimators share (anchor count, finite output, what a context must hold) live here once; an
estimator writes `_estimate`. Each says by `unknown_because` whether the light can be known at all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from xihenet.invalid import UNKNOWN
from xihenet.records import AnchorSurfaces, ArrayBool, ArrayF32, ArrayF64, PointCloud, RgbdFrame, UnitSphereCloud

Target = Literal["ldr", "hdr"]


@dataclass(frozen=True, eq=False)
class EstimateContext:
    """What an estimator may use besides the cloud; every part is optional."""

    frame: RgbdFrame | None = None  # the capture of this moment, for its ambient light sensor
    points: PointCloud | None = None  # the raw ones of this moment
    position_m: ArrayF64 | None = None  # (3,) estimation position, world, metres
    truth_sh: ArrayF64 | None = None  # (9, 3) of the light probe rendered there, carrying the session's exposure
    reference_exposure: float | None = None  # the session's exposure; None stands for the frame's own


class NotFinite(ValueError):
    """An estimator's result is not nine finite triples; `reason` of `xihenet.invalid.UNKNOWN` says why."""

    def __init__(self, message: str, reason: str = "estimate_not_finite") -> None:
        super().__init__(message)
        self.reason = reason if reason in UNKNOWN else "estimate_not_finite"


class Estimator(ABC):
    """One way to know the light at a position, from clouds of `n_anchors`.

    The `target` "ldr" is light clipped at 1 after exposure, as the paper trains; "hdr" the whole light.
    """

    name: ClassVar[str]
    needs: ClassVar[frozenset[str]] = frozenset()  # fields of `EstimateContext` that this estimator is made for
    uses_anchors: ClassVar[bool] = True  # False where the light comes from elsewhere, so that no trigger changes it
    farthest_m: ClassVar[float] = np.inf  # distances beyond are taken for this one
    is_quick: ClassVar[bool] = False  # whether 16 estimates take some 15 ms at most, so that a server needs no thread

    def __init__(self, n_anchors: int = 1280, target: Target = "ldr") -> None:
        if n_anchors < 1:
            raise ValueError(f"{self.name}: expected at least one anchor, got {n_anchors}")
        if target not in ("ldr", "hdr"):
            raise ValueError(f"{self.name}: expected the target 'ldr' or 'hdr', got {target!r}")
        self.n_anchors = n_anchors
        self.target: Target = target

    def estimate(self, cloud: UnitSphereCloud, context: EstimateContext | None = None) -> ArrayF64:
        """(9, 3) radiance coefficients carrying the session's exposure.

        A cloud without a set anchor is legal; what it gives is the estimator's guess, finite in any case.
        ValueError for another number of anchors, a missing part of the context or a result of another shape;
        `NotFinite`, which is one, for a result that is not finite.
        """
        self._check_size(cloud)
        try:
            light = self._estimate(cloud, context or EstimateContext())
        except ValueError as error:
            if type(error) is not ValueError or str(error).startswith(f"{self.name}:"):
                raise  # Such as NotFinite and NoAnswer, which callers know.
            raise ValueError(f"{self.name}: {error}") from error  # Such as NumPy's, of an estimator of somebody else.
        return self._checked(light)

    def estimate_with_error(
        self, cloud: UnitSphereCloud, context: EstimateContext | None = None
    ) -> tuple[ArrayF64, float | None]:
        """As `estimate`, and the SHC RMSE the estimator expects of it; None from one that does not know."""
        return self.estimate(cloud, context), None

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        """Reason of `xihenet.invalid.UNKNOWN` why the light cannot be known from this; empty where it can."""
        return "" if cloud.is_set.any() else "nothing_seen"

    def estimate_batch(
        self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike, *, facing: ArrayLike | None = None
    ) -> ArrayF64:
        """(B, 9, 3) from srgb (B, N, 3), distance_m (B, N) and is_set (B, N); equals B single estimates. B may be 0.

        `facing` (B, N) as in `AnchorSurfaces`, for estimators that ask it; None where nobody looked. Which colours and
        distances stand at anchors that are not set does not matter. ValueError for shapes or values that do not fit.
        """
        colours, distances, known = self._checked_shapes(srgb, distance_m, np.asarray(is_set, bool))
        colours, distances = np.where(known[..., None], colours, 0), np.where(known, distances, 0)
        turned = [None] * len(known) if facing is None else [AnchorSurfaces.of_facing(f) for f in np.asarray(facing)]
        parts = zip(colours, distances, known, turned, strict=True)
        clouds = (UnitSphereCloud(c, d, k, surfaces=s) for c, d, k, s in parts)
        return np.array([self.estimate(cloud) for cloud in clouds]).reshape(-1, 9, 3)

    def _checked_shapes(
        self, srgb: ArrayLike, distance_m: ArrayLike, known: ArrayBool
    ) -> tuple[ArrayF32, ArrayF32, ArrayBool]:
        """The arrays of a batch as float32; ValueError for shapes that do not fit `estimate_batch`."""
        with np.errstate(over="ignore"):  # What float32 cannot hold becomes infinite.
            colours, distances = np.asarray(srgb, np.float32), np.asarray(distance_m, np.float32)
        expected = (len(known) if known.ndim else 0, self.n_anchors)
        if known.shape != expected or distances.shape != expected or colours.shape != (*expected, 3):
            shapes = f"{colours.shape}, {distances.shape} and {known.shape}"
            raise ValueError(f"{self.name}: expected (B, n, 3), (B, n), (B, n) with n = {self.n_anchors}, got {shapes}")
        return colours, distances, known

    def _check_size(self, cloud: UnitSphereCloud) -> None:
        if len(cloud) != self.n_anchors:
            raise ValueError(f"{self.name}: made for {self.n_anchors} anchors, got a cloud of {len(cloud)}")

    def _checked(self, sh_radiance: ArrayLike) -> ArrayF64:
        light = np.asarray(sh_radiance, np.float64)
        if light.shape != (9, 3):
            raise ValueError(f"{self.name}: expected coefficients of order 2, (9, 3), got {light.shape}")
        if not np.isfinite(light).all():
            raise NotFinite(f"{self.name}: the estimate is not nine finite triples; refusing to pass it on")
        return light

    @abstractmethod
    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        """The estimate proper; the caller checks its input and its output."""
