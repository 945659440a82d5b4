"""The settings of a previs run: what can a user choose, and what follows from it for each step?"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast, get_args

from xihe_blender.capture.reference_probe import ProbeSettings
from xihe_blender.capture.render import MAX_SEED, RenderSettings
from xihe_blender.errors import UserError
from xihe_blender.light_transport.overrides import checked
from xihe_blender.previs import presets
from xihe_blender.previs.presets import PRESETS, Preset
from xihenet import estimators
from xihenet.controller import ControllerSettings
from xihenet.edge.client import EdgeBackend, backend_at
from xihenet.estimators import Estimator, Target
from xihenet.light import BetweenEstimates, LightChoice
from xihenet.light_change import LightFollowing
from xihenet.phone import LINKS, NETWORK, PHONE_EFFECTS, Link, PhoneProfile, load_profile
from xihenet.phone.metering import METERINGS, Metering
from xihenet.trigger import RULES, TriggerSettings

Captured = Literal["path", "in-view"]
"""Frames that a phone of a run takes in: the whole path, or those in which an estimation position is in view."""

RULER_SHARE = 0.4
"""Noise of the reference over that of captures, at most; of 20 seeds one is 2.5 times as far off."""

MAX_SAMPLES = 65536

PREVIS_TRIGGER = RULES["split"]


@dataclass(frozen=True)
class PrevisSettings:
    """One previs run.

    Parameters
    ----------
    estimator : its registered name
    others : names of estimators that are compared with it, from the same clouds; `ambient` and `truth` always are
    preset : name of one of PRESETS
    target : which light is estimated and compared: "hdr" all of it, "ldr" light clipped at 1, as in the paper
    light : what objects are lit with: "sh"; "sh+key", where the key light of an estimate is a sun; or
        "sh+key+reflections", where glossy things show a picture of what was seen besides. "auto" is the last where a
        virtual object is shiny, else the second; a prepared run has no "auto" any more
    size : of captures and comparisons; None takes 256x192, upright where the scene's picture is
    frames : frame numbers along the path; None takes the scene's range and step
    captured : "path" also captures frames in which no virtual object is in view, and learns from all that it captures
        at every position; "in-view" does neither, as the paper's phone
    objects : names of virtual objects to estimate for; None takes all
    exposure : of the phone, locked for the session; None meters it
    metering : one of METERINGS, of the session and of a phone that exposes by itself; None takes the phone's own
    seed : of everything that is random
    noise_target : relative error of the light that rendering may cause; None takes the preset's
    samples : of every capture and light probe, whatever the noise; None takes what the noise target calls for
    n_anchors : of the unit sphere
    trigger : when a new estimate is worth its cost; None takes PREVIS_TRIGGER, or in a recording its own
    following : how what is out of view follows a change of the light; None lets it be
    between_estimates : "carried", so that the light in use changes as the light in view does until the next
        estimate is there, or "kept" as it was estimated
    phone : name of a profile, or path of a user's TOML file; see docs/phone.md
    network : name of one of LINKS, over which estimates are asked for; None lets them arrive in their own frame
    backend : address of an edge service that estimates in place of this process; None for none
    effect_choices : effect: "auto", "on" or "off"; wins over what the .blend remembers, which wins over the scene
    """

    estimator: str = estimators.DEFAULT
    others: tuple[str, ...] = ()
    preset: str = presets.DEFAULT
    target: Target = "hdr"
    light: LightChoice = "auto"
    size: tuple[int, int] | None = None
    frames: tuple[int, ...] | None = None
    captured: Captured = "path"
    objects: tuple[str, ...] | None = None
    exposure: float | None = None
    metering: Metering | None = None
    seed: int = 0
    n_anchors: int = 1280
    noise_target: float | None = None
    samples: int | None = None
    trigger: TriggerSettings | None = None
    following: LightFollowing | None = field(default_factory=LightFollowing)
    between_estimates: BetweenEstimates = "carried"
    phone: str = "perfect"
    network: str | None = None
    backend: str | None = None
    effect_choices: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for kind, name, known in (
            *(("estimator", name, estimators.names()) for name in (self.estimator, *self.others)),
            ("preset", self.preset, PRESETS),
            ("metering", self.metering, METERINGS),
            ("captured", self.captured, get_args(Captured)),
            ("light", self.light, get_args(LightChoice)),
            ("between-estimates", self.between_estimates, get_args(BetweenEstimates)),
        ):
            if name is not None and name not in known:
                raise UserError(f"there is no {kind} {name!r}: choose one of {', '.join(known)}")
        listed = (self.estimator, *estimators.IN_EVERY_RUN)
        kept = [name for name in dict.fromkeys(self.others) if name not in listed]
        object.__setattr__(self, "others", tuple(kept))
        if self.size is not None and not all(4 <= side <= 8192 for side in self.size):
            raise UserError(
                f"a picture of {self.size[0]}x{self.size[1]} pixels cannot be captured: use 4 to 8192 a side"
            )
        if self.exposure is not None and not (math.isfinite(self.exposure) and self.exposure > 0):
            raise UserError(f"an exposure of {self.exposure:g} is not usable: give a positive factor, or leave it out")
        if not 0 <= self.seed <= MAX_SEED:
            raise UserError(f"a seed of {self.seed} is out of Cycles' range: give 0 to {MAX_SEED}")
        if self.network is not None and self.network not in LINKS:
            raise UserError(f"there is no network {self.network!r}: choose one of {', '.join(LINKS)}, or leave it out")
        self._check_choices()
        if self.noise_target is not None and not 0 < self.noise_target < 1:
            raise UserError(
                f"a noise target of {self.noise_target:g} is not usable: give a share of the light, such as 0.03"
            )
        if self.samples is not None and not 1 <= self.samples <= MAX_SAMPLES:
            raise UserError(f"{self.samples} samples cannot be rendered: give 1 to {MAX_SAMPLES}, or leave it out")

    def _check_choices(self) -> None:
        profile = self.profile
        for name, state in checked(self.effect_choices).items():
            if name == NETWORK and state == "on" and self.link is None:
                raise UserError("effect 'network' cannot be on without a network: choose one with --network")
            if name in PHONE_EFFECTS and name not in (NETWORK, *profile.effects) and state == "on":
                raise UserError(
                    f"effect {name!r} cannot be on: {profile.name} does not have it; choose another --phone"
                )

    @property
    def preset_values(self) -> Preset:
        return PRESETS[self.preset]

    @property
    def profile(self) -> PhoneProfile:
        """The phone; UserError if there is none of that name, or its file is wrong."""
        try:
            return load_profile(self.phone)
        except ValueError as error:
            raise UserError(f"--phone: {error}") from error

    @property
    def metering_in_force(self) -> Metering:
        return self.profile.metering if self.metering is None else self.metering

    @property
    def has_key_light(self) -> bool:
        return self.light != "sh"

    @property
    def has_reflections(self) -> bool:
        return self.light == "sh+key+reflections"

    @property
    def link(self) -> Link | None:
        return None if self.network is None else LINKS[self.network]

    @property
    def noise_aim(self) -> float:
        """The noise target in use: the user's or the preset's."""
        return self.preset_values.noise_target if self.noise_target is None else self.noise_target

    @property
    def trigger_in_use(self) -> TriggerSettings:
        return self.trigger or PREVIS_TRIGGER

    def chain(self, exposure: float) -> ControllerSettings:
        """Of a session whose anchors and estimates carry `exposure`."""
        return ControllerSettings(
            self.trigger_in_use,
            reference_exposure=exposure,
            following=self.following,
            learns_out_of_view=self.captured == "path",
            has_key_light=self.has_key_light,
            has_reflections=self.has_reflections,
            between_estimates=self.between_estimates,
        )

    def capture(self, size: tuple[int, int], samples: int) -> RenderSettings:
        return RenderSettings(size, samples, self.seed)

    @property
    def reference(self) -> ProbeSettings:
        """Of the light that estimates are held against: better by `RULER_SHARE` than what is measured by it."""
        if self.samples is not None:
            return ProbeSettings(max_samples=self.samples, noise_target=None, seed=self.seed)
        most, aim = self.preset_values.probe_samples, RULER_SHARE * self.noise_aim
        return ProbeSettings(max_samples=most, noise_target=aim, seed=self.seed, aims_at_ldr=self.target == "ldr")

    def comparison(self, size: tuple[int, int]) -> RenderSettings:
        return RenderSettings(size, self.preset_values.comparison_samples, self.seed)


def settings_of(choices: Mapping[str, Any]) -> PrevisSettings:
    """Of choices that a JSON file can hold: `trigger` is the name of one of `RULES`, or None."""
    name = choices["trigger"]
    return PrevisSettings(**{**choices, "trigger": None if name is None else RULES[name]})


def load_estimators(settings: PrevisSettings) -> list[Estimator]:
    """The estimator of a run, then the others; UserError if a package or a file of weights is missing."""
    loaded = []
    for name in (settings.estimator, *settings.others):
        option = f"estimator {name}" if name == settings.estimator else f"others {name}"
        try:
            if settings.backend is not None and name == settings.estimator:
                option = "backend"
                backend = backend_at(settings.backend, name, settings.n_anchors, settings.target)
                # With all that a session asks of one of its own: it cannot estimate batches.
                loaded.append(cast(Estimator, backend))
            else:
                loaded.append(estimators.load(name, settings.n_anchors, settings.target))
        except (ImportError, ValueError) as error:
            raise UserError(f"--{option}: {error}") from error
    return loaded


def close_backends(loaded: Sequence[object]) -> None:
    """Have edge services forget the sessions of a run that is done."""
    for one in loaded:
        if isinstance(one, EdgeBackend):
            one.close()
