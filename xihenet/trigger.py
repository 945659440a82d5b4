"""When is a new estimate worth its cost, and why?

The paper pools the change of each anchor's colour over a window of neighbouring anchors and fires when any pooled
change exceeds theta. It counts an anchor that was never seen before as a change from black, so a moving camera fires on
whatever bright thing it discovers, and a lamp that dims slowly hardly ever does.

Chosen (`policy="split"`): two questions with a threshold each. Has the light changed where we had looked before? Only
anchors set on both sides can say. Have we seen enough that is new? That is a share of the sphere, whatever its colour.
The paper's rule stays as `policy="reference"`.

Stateless: what happened before comes in as an argument. Paper: section 4.3.1; figures in its section 6.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from xihenet.records import ArrayBool, ArrayF32, ArrayInt, TriggerDecision, UnitSphereCloud


class Neighbourhood(Protocol):
    """What the trigger needs of an anchor lattice."""

    def neighbours(self, k: int) -> ArrayInt: ...


@dataclass(frozen=True)
class TriggerSettings:
    """How eager the trigger is.

    Parameters
    ----------
    theta : threshold of the pooled colour change: a mean squared difference of sRGB-encoded colour, 0 to 1. The
        default is the paper's
    n_neighbours : anchors in the pooling window, the anchor itself among them; at least 1
    policy : "split" tells colour and coverage apart, "reference" is the paper's rule
    coverage_theta : newly seen share of the sphere above which "split" fires for coverage; 1 never does
    ignored_share : "split" sets aside this share of the anchors that can be compared, those that changed most, before
        it holds the largest change against theta. Sampling noise at edges moves a few anchors in every frame
    hysteresis : theta is raised by this share right after a fire for colour, so that a light that flickers around
        the threshold does not fire in every frame; 0 switches it off
    """

    theta: float = 0.6
    n_neighbours: int = 4
    policy: Literal["split", "reference"] = "split"
    coverage_theta: float = 0.05
    ignored_share: float = 0.0
    hysteresis: float = 0.0

    def __post_init__(self) -> None:
        if self.policy not in ("split", "reference"):
            raise ValueError(f"TriggerSettings.policy: expected 'split' or 'reference', got {self.policy!r}")
        if self.n_neighbours < 1:
            raise ValueError(f"TriggerSettings.n_neighbours: expected at least 1, got {self.n_neighbours}")
        for name in ("theta", "coverage_theta", "hysteresis"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"TriggerSettings.{name}: expected a number >= 0, got {getattr(self, name)}")
        if self.hysteresis == float("inf"):  # Times a theta of 0 it would be NaN, above which nothing ever fires.
            raise ValueError("TriggerSettings.hysteresis: expected a finite share, got inf")
        if not 0 <= self.ignored_share < 1:
            raise ValueError(f"TriggerSettings.ignored_share: expected 0 to below 1, got {self.ignored_share}")


def decide_trigger(
    previous: UnitSphereCloud | None,
    current: UnitSphereCloud,
    lattice: Neighbourhood,
    settings: TriggerSettings,
    *,
    last: TriggerDecision | None = None,
) -> TriggerDecision:
    """Compare what the light in force was made from with what has been seen since.

    Parameters
    ----------
    previous : persistent cloud, N anchors; None or without a set anchor before the first estimate
    current : temporary cloud, N anchors; if nothing is set, nothing fires
    lattice : of the same N anchors
    settings : thresholds and policy
    last : the decision before this one, for hysteresis

    Returns
    -------
    TriggerDecision; `change` is None for "first"

    Raises
    ------
    ValueError if the clouds or the lattice differ in their number of anchors

    Notes
    -----
    Records hold no NaN when they are made. An anchor whose colour became NaN in the caller's array since then counts
    as unchanged; it neither fires nor keeps the others from firing.
    """
    if previous is not None and len(previous) != len(current):
        raise ValueError(f"decide_trigger: the clouds have {len(previous)} and {len(current)} anchors")
    if not current.is_set.any():
        return TriggerDecision(False, "none", 0.0, settings.theta)
    if previous is None or not previous.is_set.any():
        return TriggerDecision(True, "first", None, settings.theta, int(current.is_set.sum()))
    window = lattice.neighbours(min(settings.n_neighbours, len(current)))
    if len(window) != len(current):
        raise ValueError(f"decide_trigger: the lattice has {len(window)} anchors and the clouds {len(current)}")
    if settings.policy == "reference":
        return _decide_as_the_paper(previous, current, window, settings.theta)
    was_colour = last is not None and last.fire and last.reason == "colour"
    theta = settings.theta * (1 + settings.hysteresis) if was_colour else settings.theta
    return _decide_split(previous, current, window, theta, settings)


def _decide_as_the_paper(
    previous: UnitSphereCloud, current: UnitSphereCloud, window: ArrayInt, theta: float
) -> TriggerDecision:
    """Unset anchors are black; any pooled change above theta fires."""
    pooled = _anchor_change(previous, current)[window].mean(axis=1)
    change = float(pooled.max())
    return _colour_decision(change, theta, int((pooled > theta).sum()))


def _decide_split(
    previous: UnitSphereCloud, current: UnitSphereCloud, window: ArrayInt, theta: float, settings: TriggerSettings
) -> TriggerDecision:
    """Colour over the anchors that both clouds know, then the share of the sphere that only the current one knows."""
    common = previous.is_set & current.is_set
    change, n_changed = _common_change(previous, current, common, window, theta, settings.ignored_share)
    if change > theta:
        return TriggerDecision(True, "colour", change, theta, n_changed)
    n_new = int(current.is_set.sum()) - int(common.sum())
    newly_seen = n_new / len(current)
    if newly_seen > settings.coverage_theta:
        return TriggerDecision(True, "coverage", newly_seen, settings.coverage_theta, n_new)
    return TriggerDecision(False, "none", change, theta, n_changed)


def _common_change(
    previous: UnitSphereCloud,
    current: UnitSphereCloud,
    common: ArrayBool,
    window: ArrayInt,
    theta: float,
    ignored_share: float,
) -> tuple[float, int]:
    """The largest pooled change that is not set aside, and how many anchors exceed theta; only common anchors count.

    A window's mean is taken over its common anchors alone. No common anchor: no change.
    """
    known = np.flatnonzero(common)
    if not len(known):
        return 0.0, 0
    change = np.where(common, _anchor_change(previous, current), np.float32(0))
    around = window[known]
    pooled = change[around].sum(axis=1) / common[around].sum(axis=1)
    n_aside = int(ignored_share * len(known))
    largest = np.partition(pooled, len(known) - 1 - n_aside)[len(known) - 1 - n_aside]
    return float(largest), int((pooled > theta).sum())


def _anchor_change(previous: UnitSphereCloud, current: UnitSphereCloud) -> ArrayF32:
    """(N,) mean over RGB of the squared difference of sRGB-encoded colour."""
    difference = current.srgb - previous.srgb
    change: ArrayF32 = np.einsum("nc,nc->n", difference, difference) / np.float32(3)
    change[np.isnan(change)] = 0
    return change


def _colour_decision(change: float, theta: float, n_changed: int) -> TriggerDecision:
    fire = change > theta
    return TriggerDecision(fire, "colour" if fire else "none", change, theta, n_changed)
