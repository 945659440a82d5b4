"""Grid of the runs that make up a batch, and what they share.

A trial is one run: a scene, a seed, a phone, an estimator. All trials of one scene and seed see the same room, so its
captures, light probes and path-traced pictures are rendered once for all of them: that is a unit, the piece of work
that is handed out. Rejected: a unit per phone, which would render the same room for each of them, and a unit per trial,
which would wait for others' renders.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import cut_stem
from xihenet import estimators
from xihenet.estimators import Target
from xihenet.light import LightParts

if TYPE_CHECKING:
    from xihe_blender.previs.settings import PrevisSettings

FORMAT_VERSION = 1
DEFAULT_ESTIMATORS = ("lattice", "projection", "ambient", "truth")
NAMES = "names, at least one of each, none twice; every phone runs with every estimator"
AS_IN_A_RUN = "as in PrevisSettings"


@dataclass(frozen=True)
class BatchSettings:
    """What all units of a batch share."""

    estimators: Annotated[tuple[str, ...], NAMES] = DEFAULT_ESTIMATORS
    phones: Annotated[tuple[str, ...], NAMES] = ("perfect",)
    preset: Annotated[str, AS_IN_A_RUN] = "draft"
    target: Annotated[Target, AS_IN_A_RUN] = "hdr"
    light: Annotated[LightParts, AS_IN_A_RUN] = "sh"
    size: Annotated[tuple[int, int] | None, AS_IN_A_RUN] = None
    frames: Annotated[tuple[int, ...] | None, AS_IN_A_RUN] = None
    noise_target: Annotated[float | None, AS_IN_A_RUN] = None
    samples: Annotated[int | None, AS_IN_A_RUN] = None
    network: Annotated[str | None, AS_IN_A_RUN] = None

    def __post_init__(self) -> None:
        for option, names in (("--estimators", self.estimators), ("--profiles", self.phones)):
            if not names or len(set(names)) < len(names):
                raise UserError(f"{option} {','.join(names)}: give each name once, with commas between them")

    def trials(self) -> list[tuple[str, str]]:
        """(phone, estimator) of every trial of a unit, in the order in which results list them."""
        return [(phone, estimator) for phone in self.phones for estimator in self.estimators]

    def of_trial(self, phone: str, estimator: str, seed: int) -> PrevisSettings:
        """The settings that `xihe previs` would have; UserError, in its words, where they make no sense."""
        # Workers know of units, and must not load Blender: it does not work beside the thread that they work in.
        from xihe_blender.previs.settings import PrevisSettings

        shared = {name: value for name, value in vars(self).items() if name not in ("estimators", "phones")}
        # Frames without an object in view have no numbers, and cost as much as the others.
        return PrevisSettings(estimator=estimator, phone=phone, seed=seed, captured="in-view", **shared)


@dataclass(frozen=True)
class Unit:
    """One .blend, whose content and folder have this digest, with one seed."""

    scene: Path
    seed: int
    digest: str

    @property
    def name(self) -> str:
        """Of its folder, and in what is said of it."""
        return f"{cut_stem(self.scene.stem)}_{self.digest[:8]}_seed{self.seed}"


def planned_units(scenes: Sequence[Path], seeds: Sequence[int]) -> tuple[list[Unit], dict[str, str]]:
    """Every scene with every seed, each once, and by name what is wrong with files that cannot be read."""
    units: dict[str, Unit] = {}
    broken: dict[str, str] = {}
    for scene in scenes:
        try:
            # With its folder: a copy beside other pictures may show another room.
            content = hashlib.sha256(scene.read_bytes()).digest()
            digest = hashlib.sha256(content + os.fsencode(scene.resolve().parent)).hexdigest()
        except OSError as error:
            broken[str(scene)] = error.strerror or str(error)
            continue
        for seed in seeds:
            unit = Unit(scene.resolve(), seed, digest)
            units.setdefault(unit.name, unit)
    return list(units.values()), broken


def check_settings(settings: BatchSettings, seeds: Sequence[int]) -> None:
    """UserError for an unknown estimator, phone or preset, a seed out of range, or a package that is missing."""
    if not seeds or len(set(seeds)) < len(seeds):
        raise UserError("--seeds: give each number once, with commas between them, such as 0,1,2")
    for seed in seeds:
        for phone, estimator in settings.trials():
            # Asking for the profile reads it.
            assert settings.of_trial(phone, estimator, seed).profile is not None
    for name in settings.estimators:
        try:
            estimators.load(name, target=settings.target)
        except (ImportError, ValueError) as error:
            raise UserError(f"--estimators {name}: {error}") from error
