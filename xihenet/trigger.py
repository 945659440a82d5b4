"""The trigger: when is a new estimate worth its cost, and why?

The paper pools the change of each anchor's colour over a window of neighbouring anchors and fires when any pooled
change exceeds theta. It counts an anchor that was never seen before as a change from black, so a moving camera fires on
whatever bright thing it discovers, and a lamp that dims slowly hardly ever does.

Chosen (`policy="split"`): two questions with a threshold each. Has the light changed where we had looked before? Only
anchors set on both sides can say. Have we seen enough that is new? That is a share of the sphere, whatever its colour.
The paper's rule stays as `policy="reference"`. A third, `policy="light"`, asks one question of the light itself: by
what share does that of all that is known now differ from that of what the last estimate was made from
(`light_difference`)? Its one threshold fits walks, lamps and pairs of frames alike (docs/trigger.md).

A phone that walks sees reflections move: a glossy table changes its colour without any change of the light. Where both
clouds say from where an anchor was seen (`UnitSphereCloud.surfaces`), one seen from another angle is asked less. Of its
change only that part counts which a change of the light explains, the factor by which nearly all surfaces changed
alike (`light_change`); diffuse surfaces keep their colour whatever the angle, so without such a factor it is none. What
lies at another distance then is another surface, and is not asked at all. The factor is looked for twice: against what
the light in use was made from, which notices a lamp that dims slowly, and against what was last seen of each surface
(`LastSeen`). There a lamp that dims at once stands out however long the walk is: reflections move little from frame to
frame, while in a walk around a mirroring table nobody agrees on anything with the first one. Rejected: asking only
anchors seen from the same angle, which in a walk are too few to notice a lamp; and their median as the light's change,
since a table that fills the lower half makes the median.

Stateless: what happened before comes in as an argument. Paper: section 4.3.1; figures in its section 6.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from xihenet.buffers import merge
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.light_change import LightFollowing, light_change
from xihenet.light_difference import light_difference
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt, TriggerDecision, UnitSphereCloud
from xihenet.sphere import AnchorLattice

Policy = Literal["split", "light", "reference"]

# Of the light that is looked for, see `LightFollowing`; whether it is worth an estimate, theta says.
SMALLEST_STOPS, MOST_UNCHANGED = 0.25, 0.1

# Share of the surfaces that have to change alike from one frame to the next. In 466 steps of walks under light that
# stood still nothing passed for a change; with all light to a quarter, a half, twofold or fourfold 98 to 99.8 % did.
AGREEING_AT_ONCE = 0.8


@dataclass(frozen=True, eq=False)
class LastSeen:
    """A frame, and what was known when it came."""

    before: UnitSphereCloud  # each of N anchors as it was last seen before the frame
    frame: UnitSphereCloud  # what the frame alone shows, of the same N anchors


@dataclass(frozen=True)
class TriggerSettings:
    """How eager the trigger is.

    Parameters
    ----------
    theta : threshold of the pooled colour change: a mean squared difference of sRGB-encoded colour, 0 to 1. The
        default is the paper's; 0 fires at any change, reflections included
    n_neighbours : anchors in the pooling window, the anchor itself among them; at least 1
    policy : "split" tells colour and coverage apart, "light" asks how much the light of all that is known differs,
        "reference" is the paper's rule
    coverage_theta : newly seen share of the sphere above which "split" fires for coverage; 1 never does
    ignored_share : "split" sets aside this share of the anchors that can be compared, those that changed most, before
        it holds the largest change against theta. Sampling noise at edges moves a few anchors in every frame
    view_angle_deg : "split" takes a surface for seen from another angle where the camera went around it by more
        degrees. A reflection moves by as much; with 5 one in a glossy room still passed for the light, with 3 none
    same_distance : two distances of a surface seen from another angle are those of one if they differ by no more than
        this share; as in `LightFollowing`
    agreeing_share : share of the surfaces seen again since the last estimate that have to change alike for the light to
        be the cause; with 0.8 a lamp that reflects in a table passed for it
    hysteresis : theta is raised by this share right after a fire for colour, so that a light that flickers around
        the threshold does not fire in every frame; 0 switches it off
    light_theta : share by which the light has to differ for "light" to fire; it heeds nothing else here
    """

    theta: float = 0.6
    n_neighbours: int = 4
    policy: Policy = "split"
    coverage_theta: float = 0.05
    ignored_share: float = 0.0
    view_angle_deg: float = 3.0
    same_distance: float = 0.02
    agreeing_share: float = 0.9
    hysteresis: float = 0.0
    light_theta: float = 0.75

    def __post_init__(self) -> None:
        if self.policy not in (policies := get_args(Policy)):
            raise ValueError(f"TriggerSettings.policy: expected one of {', '.join(policies)}, got {self.policy!r}")
        if not (isinstance(self.n_neighbours, int | np.integer) and self.n_neighbours >= 1):
            raise ValueError(f"TriggerSettings.n_neighbours: expected a whole number >= 1, got {self.n_neighbours}")
        for name in (*_thetas(), "hysteresis"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"TriggerSettings.{name}: expected a number >= 0, got {getattr(self, name)}")
        if self.hysteresis == float("inf"):  # Times a theta of 0 it would be NaN, above which nothing ever fires.
            raise ValueError("TriggerSettings.hysteresis: expected a finite share, got inf")
        if not 0 <= self.view_angle_deg <= 180:
            raise ValueError(f"TriggerSettings.view_angle_deg: expected 0 to 180 degrees, got {self.view_angle_deg}")
        for name in ("same_distance", "agreeing_share"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"TriggerSettings.{name}: expected a share above 0, got {getattr(self, name)}")
        if not 0 <= self.ignored_share < 1:
            raise ValueError(f"TriggerSettings.ignored_share: expected 0 to below 1, got {self.ignored_share}")

    @property
    def threshold(self) -> float:
        """What the policy holds a change against; "split" has another for coverage."""
        return self.light_theta if self.policy == "light" else self.theta

    def scaled(self, factor: float) -> TriggerSettings:
        """With all thresholds times `factor`, 0 or more; with 0 it fires at any change."""
        scaled: dict[str, Any] = {name: factor * getattr(self, name) for name in _thetas()}
        return replace(self, **scaled | {"coverage_theta": min(1.0, scaled["coverage_theta"])})


def _thetas() -> list[str]:
    """Names of all thresholds."""
    return [field.name for field in fields(TriggerSettings) if field.name.endswith("theta")]


Rule = Literal["split", "light", "reference", "every-frame"]


class NamedRule(NamedTuple):
    """A rule as people choose it."""

    label: str  # what the panel calls it
    summary: str  # when light is estimated again, without a full stop
    settings: TriggerSettings


NAMED_RULES: Mapping[Rule, NamedRule] = MappingProxyType(
    {
        "split": NamedRule(
            "It Changes",
            "When surfaces change colour or new ones come into view",
            TriggerSettings(theta=0.001, ignored_share=0.25, coverage_theta=0.05),
        ),
        "light": NamedRule(
            "Light Differs",
            "When the light of all that is known differs by a fifth from that at the last estimate",
            TriggerSettings(policy="light", light_theta=0.2),
        ),
        "reference": NamedRule(
            "As the Paper",
            "By the paper's rule, when any direction changes colour by much (a lamp that dims goes unnoticed)",
            TriggerSettings(policy="reference"),
        ),
        "every-frame": NamedRule(
            "Every Frame",
            "In each frame in which anything changed, at the highest cost",
            TriggerSettings(theta=0.0, coverage_theta=0.0),
        ),
    }
)
"""What runs are told by name, their default first. With "every-frame" a frame in which nothing has changed makes none.

The paper's theta of 0.6 sleeps through a lamp that changes; see docs/trigger.md for how these were chosen."""

RULES: Mapping[Rule, TriggerSettings] = MappingProxyType({name: rule.settings for name, rule in NAMED_RULES.items()})


def decide_trigger(
    previous: UnitSphereCloud | None,
    current: UnitSphereCloud,
    lattice: AnchorLattice,
    settings: TriggerSettings,
    *,
    last: TriggerDecision | None = None,
    last_seen: LastSeen | None = None,
) -> TriggerDecision:
    """Compare what the light in use was made from with what has been seen since.

    The clouds and the lattice have N anchors, else ValueError. `previous` is the persistent cloud, None or without a
    set anchor before the first estimate, and `current` the temporary one; if nothing is set, nothing fires. `last` is
    the decision before this one, for hysteresis; `last_seen` the frame with which `current` ends, None asks only what
    changed since `previous`. `change` of the answer is None for "first".

    Records hold no NaN when they are made. An anchor whose colour became NaN in the caller's array since then counts
    as unchanged; it neither fires nor keeps the others from firing.
    """
    if previous is not None and len(previous) != len(current):
        raise ValueError(f"decide_trigger: the clouds have {len(previous)} and {len(current)} anchors")
    if not current.is_set.any():
        return TriggerDecision(False, "none", 0.0, settings.threshold)
    if previous is None or not previous.is_set.any():
        return TriggerDecision(True, "first", None, settings.threshold, int(current.is_set.sum()))
    if settings.policy == "reference":
        return _decide_as_the_paper(previous, current, _windows(lattice, len(current), settings), settings.theta)
    if settings.policy == "light":
        change = light_difference(previous, merge(previous, current), lattice)
        fire = change > settings.light_theta
        return TriggerDecision(fire, "light" if fire else "none", change, settings.light_theta)
    was_colour = last is not None and last.fire and last.reason == "colour"
    theta = settings.theta * (1 + settings.hysteresis) if was_colour else settings.theta
    pooled = _pooled_change(previous, current, lattice, settings, last_seen)
    change, n_changed = _largest(pooled, settings.ignored_share), int((pooled > theta).sum())
    if change > theta:
        return TriggerDecision(True, "colour", change, theta, n_changed)
    n_new = int(np.count_nonzero(current.is_set & ~previous.is_set))
    newly_seen = n_new / len(current)
    if newly_seen > settings.coverage_theta:
        return TriggerDecision(True, "coverage", newly_seen, settings.coverage_theta, n_new)
    return TriggerDecision(False, "none", change, theta, n_changed)


def _decide_as_the_paper(
    previous: UnitSphereCloud, current: UnitSphereCloud, window: ArrayInt, theta: float
) -> TriggerDecision:
    """Unset anchors are black; any pooled change above theta fires."""
    pooled = _mean_square(current.srgb - previous.srgb)[window].mean(axis=1)
    change, n_changed = float(pooled.max()), int((pooled > theta).sum())
    return TriggerDecision(change > theta, "colour" if change > theta else "none", change, theta, n_changed)


def colour_change(
    previous: UnitSphereCloud, current: UnitSphereCloud, lattice: AnchorLattice, settings: TriggerSettings
) -> float:
    """What the policy "split" holds against theta, for two clouds of the lattice's N anchors; 0 if none is common."""
    return _largest(_pooled_change(previous, current, lattice, settings), settings.ignored_share)


def _largest(pooled: ArrayF32, ignored_share: float) -> float:
    """The largest pooled change that is not set aside; 0 for none."""
    if not len(pooled):
        return 0.0
    kept = len(pooled) - 1 - int(ignored_share * len(pooled))
    return float(np.partition(pooled, kept)[kept])


def _pooled_change(
    previous: UnitSphereCloud,
    current: UnitSphereCloud,
    lattice: AnchorLattice,
    settings: TriggerSettings,
    last_seen: LastSeen | None = None,
) -> ArrayF32:
    """(K,) pooled change of the K anchors that both clouds know and that can be asked.

    A window's mean is taken over these anchors alone.
    """
    windows = _windows(lattice, len(current), settings)
    asked, change = _change_of_light(previous, current, lattice.directions, settings, last_seen)
    around = windows[np.flatnonzero(asked)]
    return np.where(asked, change, np.float32(0))[around].sum(axis=1) / asked[around].sum(axis=1)


def _windows(lattice: AnchorLattice, n_anchors: int, settings: TriggerSettings) -> ArrayInt:
    """(N, k) the anchors that each anchor is pooled over. ValueError for a lattice of another number of anchors."""
    window = lattice.neighbours(min(settings.n_neighbours, n_anchors))
    if len(window) != n_anchors:
        raise ValueError(f"decide_trigger: the lattice has {len(window)} anchors and the clouds {n_anchors}")
    return window


def _change_of_light(
    previous: UnitSphereCloud,
    current: UnitSphereCloud,
    directions: ArrayF64,
    settings: TriggerSettings,
    last_seen: LastSeen | None,
) -> tuple[ArrayBool, ArrayF32]:
    """(N,) which anchors can be asked, and by how much each changed as far as that may be the light's doing."""
    common, change = previous.is_set & current.is_set, _mean_square(current.srgb - previous.srgb)
    if settings.theta == 0:  # Any change at all: this is how a chain is made to estimate in every frame.
        return common, change
    turned = common & seen_from_another_angle(previous, current, directions, settings.view_angle_deg)
    if not turned.any():
        return common, change
    change[turned] = _change_by_the_light(previous, current, settings, last_seen)[turned]
    nearness = np.abs(current.distance_m - previous.distance_m)
    is_same_surface = nearness <= settings.same_distance * previous.distance_m
    return common & (~turned | is_same_surface), change


def seen_from_another_angle(
    previous: UnitSphereCloud, current: UnitSphereCloud, directions: ArrayF64, angle_deg: float
) -> ArrayBool:
    """(N,) surfaces of `current` around which the camera went by more than `angle_deg` since `previous`.

    The cameras are told from the surfaces, each in its own way: that which wins an anchor may be another point of the
    cell in the next frame, which is no move of the camera. A cell is 3 degrees wide with 1280 anchors.
    """
    before, now = previous.surfaces, current.surfaces
    if before is None or now is None:
        return np.zeros(len(current), bool)
    # From this anchor's surface to the camera of then is its own way and what lies between the two surfaces.
    outwards, way_m = directions.astype(np.float32), before.camera_distance_m
    moved_m = previous.distance_m - current.distance_m
    with np.errstate(over="ignore", invalid="ignore"):  # What is too far for float32 is taken for seen as before.
        along_m = way_m * _dot(before.view_direction, now.view_direction) + moved_m * _dot(outwards, now.view_direction)
        square = way_m**2 + moved_m * (2 * way_m * _dot(outwards, before.view_direction) + moved_m)
        is_turned = along_m < np.float32(np.cos(np.radians(angle_deg))) * np.sqrt(np.maximum(square, 0))
    is_known = (way_m > 0) & (now.camera_distance_m > 0)
    return is_known & is_turned


def _dot(a: ArrayF32, b: ArrayF32) -> ArrayF32:
    """(N,) of (N, 3)."""
    return np.einsum("nc,nc->n", a, b)


def _change_by_the_light(
    previous: UnitSphereCloud, current: UnitSphereCloud, settings: TriggerSettings, last_seen: LastSeen | None
) -> ArrayF32:
    """(N,) the change of each anchor if the light did what nearly all surfaces agree on; 0 if they do not agree.

    The light may have changed at once or since the last estimate.
    """
    alike = LightFollowing(
        SMALLEST_STOPS, AGREEING_AT_ONCE, same_distance=settings.same_distance, most_unchanged=MOST_UNCHANGED
    )
    factor = None if last_seen is None else light_change(last_seen.before, last_seen.frame, alike)
    if factor is None:
        factor = light_change(previous, current, replace(alike, agreeing_share=settings.agreeing_share))
    if factor is None:
        return np.zeros(len(current), np.float32)
    lit = linear_to_srgb(srgb_to_linear(previous.srgb.astype(np.float64)) * factor)
    return _mean_square(lit.astype(np.float32) - previous.srgb)


def _mean_square(difference: ArrayF32) -> ArrayF32:
    """(N,) mean over RGB of squared differences (N, 3) of sRGB-encoded colour; NaN counts as no change."""
    change: ArrayF32 = np.einsum("nc,nc->n", difference, difference) / np.float32(3)
    change[np.isnan(change)] = 0
    return change
