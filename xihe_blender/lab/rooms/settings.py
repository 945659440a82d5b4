"""Settings of a build of rooms."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from xihe_blender.capture.reference_probe import ProbeSettings
from xihe_blender.capture.render import RenderSettings
from xihe_blender.errors import UserError
from xihe_blender.lab.rooms.store import FORMAT_VERSION, METERING
from xihenet.training.rooms import SPLITS, Split, split_of

MAX_ROOMS = 1_000_000
MAX_WALK = 240
MIN_VIEWS, MAX_VIEWS = 5, 50


@dataclass(frozen=True)
class RoomRenderSettings:
    """Sizes in pixels and samples per pixel. The seed of Cycles is fixed: noise differs by room anyway.

    The reference probe takes `probe_samples` pictures, of `probe_size` pixels along a side of the mirror ball, an even
    number; they are stored at half that size. In training rooms it is `train_probe_size`: their noise averages out over
    the rooms, which cost half as much, and more rooms teach more than cleaner ones. Fewer pictures are taken where the
    noise has come down to `noise_target`, relative to the light; it is not one of the `numbers`.
    """

    view_size: tuple[int, int] = (128, 96)
    view_samples: int = 4
    probe_size: int = 160
    probe_samples: int = 2
    train_probe_size: int = 80
    noise_target: float | None = None

    @property
    def view(self) -> RenderSettings:
        return RenderSettings(self.view_size, self.view_samples)

    def probe(self, split: Split = "test") -> ProbeSettings:
        size = self.train_probe_size if split == "train" else self.probe_size
        return ProbeSettings(size, self.probe_samples, self.noise_target)

    @property
    def numbers(self) -> list[int]:
        """As the manifest of a folder has them."""
        return [*self.view_size, self.view_samples, self.probe_size, self.probe_samples, self.train_probe_size]


@dataclass(frozen=True)
class BuildSettings:
    """What to build."""

    n_rooms: int  # room numbers are below this; more may be added later with the same seed
    seed: int = 0  # of the whole data set, at least 0
    n_workers: int | None = None  # processes, one thread each; None for one per core of this process
    render: RoomRenderSettings = RoomRenderSettings()
    walk: int | None = None  # frames of a walk in place of the free views; None for free views
    views: int | None = None  # free views of each room; None for the usual number
    varied: float = 0.0  # share of the training rooms that are far more varied than homes and offices, 0 to 1
    by_day: float = 0.0  # share of the training rooms whose lamps are off, by day, where they have windows
    split: Split | None = None  # make the rooms of this split alone; None for all
    scheduler: str | None = None  # of Dask, by its address, whose workers make the rooms; None for processes of our own

    def __post_init__(self) -> None:
        for option, number, least, most, words in (
            ("rooms", self.n_rooms, 1, MAX_ROOMS, f"1 to {MAX_ROOMS}"),
            ("seed", self.seed, 0, math.inf, "0 or more"),
            ("workers", self.n_workers, 1, math.inf, "1 or more"),
            ("walk", self.walk, 2, MAX_WALK, f"2 to {MAX_WALK} frames"),
            ("views", self.views, MIN_VIEWS, MAX_VIEWS, f"{MIN_VIEWS} to {MAX_VIEWS}"),
        ):
            if number is not None and not least <= number <= most:
                raise UserError(f"--{option} {number}: give {words}")
        if self.views is not None and self.walk is not None:
            raise UserError("--views and --walk: give one of them")
        for name, share in (("varied", self.varied), ("by-day", self.by_day)):
            if not 0 <= share <= 1:
                raise UserError(f"--{name} {share:g}: give a share between 0 and 1")
        if self.split is not None and self.split not in SPLITS:
            raise UserError(f"--split {self.split}: choose one of {', '.join(SPLITS)}")
        if not self.wanted():
            raise UserError(f"--rooms {self.n_rooms}: none of these rooms is in the split {self.split}, give more")

    def wanted(self) -> list[int]:
        return [i for i in range(self.n_rooms) if self.split is None or split_of((self.seed, i)) == self.split]

    @property
    def provenance(self) -> dict[str, Any]:
        """What all rooms of a folder share. What the first data sets did not know is named where it is used."""
        shared = {"format": FORMAT_VERSION, "seed": self.seed, "render": self.render.numbers, "metering": METERING}
        optional = {"walk": self.walk, "views": self.views, "varied": self.varied, "by_day": self.by_day}
        return shared | {name: value for name, value in optional.items() if value}
