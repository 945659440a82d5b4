"""Grid of the runs that make up a batch, and what they share.

A trial is one run: a scene, a seed, a phone, an estimator. All trials of one scene and seed see the same room, so its
captures, light probes and path-traced pictures are rendered once for all of them: that is a unit, the piece of work
that is handed out. Rejected: a unit per phone, which would render the same room for each of them, and a unit per trial,
which would wait for others' renders.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import cut_stem
from xihenet import estimators
from xihenet.estimators import Target
from xihenet.light import LightParts
from xihenet.trigger import Rule

if TYPE_CHECKING:
    from xihe_blender.previs.settings import PrevisSettings

FORMAT_VERSION = 3
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
    samples: Annotated[int | None, AS_IN_A_RUN] = None
    trigger: Annotated[Rule, "its name"] = "split"
    network: Annotated[str | None, AS_IN_A_RUN] = None

    def __post_init__(self) -> None:
        for option, names in (("--estimators", self.estimators), ("--profiles", self.phones)):
            if not names or len(set(names)) < len(names):
                raise UserError(f"{option} {','.join(names)}: give each name once, with commas between them")

    def named(self) -> BatchSettings:
        """The same with the phones' names in place of their files, which may be moved."""
        names = short_names(map(Path, self.phones))
        return replace(self, phones=tuple(names[Path(phone)] for phone in self.phones))

    def trials(self) -> list[tuple[str, str]]:
        """(phone, estimator) of every trial of a unit, in the order in which results list them."""
        return [(phone, estimator) for phone in self.phones for estimator in self.estimators]

    def of_trial(self, phone: str, estimator: str, seed: int) -> PrevisSettings:
        """The settings that `xihe previs` would have; UserError, in its words, where they make no sense."""
        # Workers know of units, and must not load Blender: it does not work beside the thread that they work in.
        from xihe_blender.previs.settings import settings_of

        shared = {name: value for name, value in vars(self).items() if name not in ("estimators", "phones")}
        # Frames without an object in view have no numbers, and cost as much as the others.
        own = {"estimator": estimator, "phone": phone, "seed": seed, "captured": "in-view"}
        return settings_of(shared | own)


@dataclass(frozen=True)
class Unit:
    """One .blend with one seed; `digest` is of its content, and of where it lies if that tells copies apart."""

    scene: Path
    seed: int
    digest: str
    content_sha256: str

    @property
    def name(self) -> str:
        """Of its folder, and in what is said of it."""
        return f"{cut_stem(self.scene.stem)}_{self.digest[:8]}_seed{self.seed}"


def planned_units(scenes: Sequence[Path], seeds: Sequence[int]) -> tuple[list[Unit], dict[str, str]]:
    """Every scene with every seed, each once, and by name what is wrong with files that cannot be read."""
    units: list[Unit] = []
    broken: dict[str, str] = {}
    contents: dict[Path, bytes] = {}
    for scene in scenes:
        try:
            contents[scene.resolve()] = hashlib.sha256(scene.read_bytes()).digest()
        except OSError as error:
            broken[str(scene)] = error.strerror or str(error)
    for scene, content in contents.items():
        # A copy of it beside other pictures may show another room. The first keeps its name when copies are added, and
        # the others have as many folders in theirs as tell them apart, which stay what they are where all is moved.
        copies = [other for other in contents if (other.name, contents[other]) == (scene.name, content)]
        apart = "" if scene == copies[0] else short_names(copies)[scene]
        digest = hashlib.sha256(content + os.fsencode(apart)).hexdigest()
        units += [Unit(scene, seed, digest, content.hex()) for seed in seeds]
    return units, broken


def short_names(files: Iterable[Path]) -> dict[Path, str]:
    """The stem of each file, after as many of its folders as tell it from another with the same stem."""
    paths = {file: file.with_suffix("").parts for file in files}
    names = {}
    for file, parts in paths.items():
        others = [other for path, other in paths.items() if path != file]
        n_parts = (n for n in range(1, len(parts)) if all(other[-n:] != parts[-n:] for other in others))
        n = next(n_parts, None)
        names[file] = str(file) if n is None else "/".join(parts[-n:])
    return names


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
