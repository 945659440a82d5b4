"""Effects, of light transport and of the phone: one record for each, and the planner that says which are simulated.

A rule looks at what is known of a scene or a session and gives a `Requirement`. `plan_effects` makes an `Effect` of
that and of the user's choice; the results, the panel, the command line and the report all read this one record. An
effect of light transport is a rule in `xihe_blender.light_transport.rules`; one of the phone is a `Section` with a
`required_by`, named in `xihenet.phone.EFFECTS`. What is not known counts as required: leaving an effect out needs
proof.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

State = Literal["on", "off"]
Setting = bool | int | float


@dataclass(frozen=True)
class Change:
    """What leaving an effect out does to a mean, relative to the mean with it: -0.1 is 10 % darker.

    `standard_error` is of that difference, over the seeds: a change within two of them may be chance.
    """

    relative: float
    standard_error: float


@dataclass(frozen=True)
class EffectCost:
    """What one effect costs and does, measured."""

    # Render time with the effect over that without, less 1: 0.1 is 10 % slower; the median over the seeds.
    time_share: float
    time_standard_error: float  # of `time_share`; on a machine that is busy with other things it is large
    light: Change | None  # of the light probe's mean radiance; None without an estimation position, or in the dark
    picture: Change | None  # of the picture's mean radiance; None without a camera, or for a black picture


@dataclass(frozen=True)
class Requirement:
    """What a rule says of an effect: is it required, why, and the settings of both states: a user may want the other.

    `left_out` are those of an effect that is not required, where they are not those of `off`, which a user asks for.
    """

    is_required: bool
    reason: str
    on: Mapping[str, Setting]
    off: Mapping[str, Setting]
    left_out: Mapping[str, Setting] | None = None

    @property
    def is_switchable(self) -> bool:
        """Whether anything can be set: not where the device does not have it, or a material or a camera decides."""
        return bool(self.on or self.off)


@dataclass(frozen=True)
class Effect:
    """One effect of a run."""

    name: str  # as shown and as choices name it
    state: State
    reason: str  # why, for a lighting artist
    parameters: Mapping[str, Setting]  # of Cycles, or of the phone's profile; empty where nothing can be set
    origin: Literal["auto", "user"] = "auto"  # "user" for a choice
    is_switchable: bool = True  # whether a choice has any effect
    cost: EffectCost | None = None  # None where it was not measured


def plan_effects(required: Mapping[str, Requirement], choices: Mapping[str, str]) -> dict[str, Effect]:
    """The effects of a run by name, in the order of `required`.

    `choices` ("auto", "on" or "off" by effect; ValueError for another) win over what is required, and the reason then
    says what would be without them; those about effects that cannot be switched, or are not in `required`, are ignored.
    """
    return {name: _planned(name, one, choices.get(name, "auto")) for name, one in required.items()}


def _planned(name: str, required: Requirement, choice: str) -> Effect:
    if choice not in ("auto", "on", "off"):
        raise ValueError(f"plan_effects: {name}: expected auto, on or off, got {choice!r}")
    state: State = "on" if required.is_required else "off"
    if choice == "auto" or not required.is_switchable:
        left_out = required.off if required.left_out is None else required.left_out
        settings = required.on if required.is_required else left_out
        return Effect(name, state, required.reason, dict(settings), is_switchable=required.is_switchable)
    reason = f"you turned it {choice}; by itself it would be {state}: {required.reason}"
    if choice == "on":
        return Effect(name, "on", reason, dict(required.on), "user")
    return Effect(name, "off", reason, dict(required.off), "user")


def effects_as_json(effects: Mapping[str, Effect], *, with_cost: bool = False) -> list[dict[str, Any]]:
    """[{name, state, reason, parameters, origin}], as results.json holds them; `cost` as well if asked for."""
    keys = ("name", "state", "reason", "parameters", "origin", *(("cost",) if with_cost else ()))
    rows = [asdict(effect) for effect in effects.values()]
    return [{key: row[key] for key in keys} for row in rows]


def effects_from_json(rows: Iterable[Mapping[str, Any]]) -> dict[str, Effect]:
    """What `effects_as_json` wrote."""
    return {row["name"]: Effect(**row) for row in rows}


def names_that_are_on(effects: Mapping[str, Effect]) -> frozenset[str]:
    return frozenset(name for name, effect in effects.items() if effect.state == "on")
