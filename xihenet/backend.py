"""The backend: does an estimate come from this machine or from another one, and what if it cannot be known?

The controller asks an `InferenceBackend` and does not know. What it gets back is a `LightEstimate` in any case: of a
light that cannot be known, or that comes back NaN, it says so and why, and the one who asked keeps the light before.
Rejected: an exception there, which would end a session for one frame. Paper: section 5, `InferenceBackend`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from xihenet.completeness import coverage
from xihenet.estimators.base import EstimateContext, Estimator, NotFinite
from xihenet.records import ArrayF64, LightEstimate, UnitSphereCloud


class NoAnswer(ValueError):
    """A backend elsewhere did not answer in time, which says nothing of the cloud."""

    reason = "no_answer"


class LightBackend(Protocol):
    """The least that the controller can work with: a name, a number of anchors, and (9, 3) from a cloud."""

    name: str
    n_anchors: int

    def estimate(self, cloud: UnitSphereCloud, context: EstimateContext | None = None) -> ArrayF64: ...


@runtime_checkable
class InferenceBackend(LightBackend, Protocol):
    """Turns a cloud into (9, 3) radiance coefficients that carry the session's exposure; says what it knows of them.

    Distances beyond `farthest_m` are clamped by it, which is counted; infinite where none are.
    """

    farthest_m: float

    def estimate_with_error(
        self, cloud: UnitSphereCloud, context: EstimateContext | None = None
    ) -> tuple[ArrayF64, float | None]:
        """As `estimate`, and the SHC RMSE that is expected of it; None where that is not known."""

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        """Why the light of `cloud` cannot be known, one of `invalid.UNKNOWN`; empty where it can."""


class LightAlone:
    """An `InferenceBackend` of one that gives light and no more: no error is known, and an empty cloud has no light."""

    farthest_m = float("inf")

    def __init__(self, backend: LightBackend) -> None:
        self.name, self.n_anchors, self.estimate = backend.name, backend.n_anchors, backend.estimate

    def estimate_with_error(
        self, cloud: UnitSphereCloud, context: EstimateContext | None = None
    ) -> tuple[ArrayF64, float | None]:
        return self.estimate(cloud, context), None

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        return "" if cloud.is_set.any() else "nothing_seen"


def as_inference_backend(backend: LightBackend) -> InferenceBackend:
    """`backend` itself where it is an `InferenceBackend`, else it as `LightAlone`."""
    return backend if isinstance(backend, InferenceBackend) else LightAlone(backend)


class LocalBackend:
    """An `InferenceBackend` in this process: `estimator` answers, and raises, as itself."""

    def __init__(self, estimator: Estimator) -> None:
        self.estimator = estimator
        self.name, self.n_anchors, self.farthest_m = estimator.name, estimator.n_anchors, estimator.farthest_m
        self.estimate, self.estimate_with_error = estimator.estimate, estimator.estimate_with_error
        self.unknown_because = estimator.unknown_because


Answer = tuple[ArrayF64, float | None]


@runtime_checkable
class TogetherBackend(Protocol):
    """A backend whose estimates take less time together than one after the other."""

    def estimate_together(
        self, clouds: Sequence[UnitSphereCloud], contexts: Sequence[EstimateContext]
    ) -> list[Answer | NoAnswer | NotFinite]:
        """For each cloud what `estimate_with_error` gives, or raises of these two; ValueError as it raises it."""


def estimate_lights(
    backend: InferenceBackend, clouds: Sequence[UnitSphereCloud], contexts: Sequence[EstimateContext], exposure: float
) -> list[LightEstimate]:
    """The light that each of the clouds shows, with its context, carrying `exposure`; where it is not known, 0 and why.

    All are asked for together where that can be. ValueError as the backend raises it, but for a result that is not
    finite and an answer that does not come.
    """
    reasons = [backend.unknown_because(*one) for one in zip(clouds, contexts, strict=True)]
    asked = [number for number, reason in enumerate(reasons) if not reason]
    if len(asked) > 1 and isinstance(backend, TogetherBackend):
        answers = backend.estimate_together([clouds[k] for k in asked], [contexts[k] for k in asked])
    else:
        answers = [answer_of(backend, clouds[k], contexts[k]) for k in asked]
    found = dict(zip(asked, answers, strict=True))
    return [
        _light(backend, cloud, exposure, reason, found.get(number))
        for number, (cloud, reason) in enumerate(zip(clouds, reasons, strict=True))
    ]


def estimate_light(
    backend: InferenceBackend, cloud: UnitSphereCloud, context: EstimateContext, exposure: float
) -> LightEstimate:
    """`estimate_lights` of one."""
    return estimate_lights(backend, [cloud], [context], exposure)[0]


def answer_of(
    backend: InferenceBackend, cloud: UnitSphereCloud, context: EstimateContext
) -> Answer | NoAnswer | NotFinite:
    """What `estimate_with_error` gives, or raises of these two."""
    try:
        return backend.estimate_with_error(cloud, context)
    except (NoAnswer, NotFinite) as error:
        return error


def _light(
    backend: InferenceBackend,
    cloud: UnitSphereCloud,
    exposure: float,
    reason: str,
    answer: Answer | NoAnswer | NotFinite | None,
) -> LightEstimate:
    sh_radiance, expected_error = np.zeros((9, 3)), None
    if isinstance(answer, NoAnswer | NotFinite):
        reason = answer.reason
    elif answer is not None:
        found, error = answer
        if np.isfinite(found).all() and (error is None or np.isfinite(error)):
            sh_radiance, expected_error = found, error
        else:
            reason = "estimate_not_finite"
    return LightEstimate(sh_radiance, exposure, coverage(cloud), backend.name, not reason, expected_error, reason)
