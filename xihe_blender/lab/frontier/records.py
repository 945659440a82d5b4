"""Records of a frontier: what frontier.json says, field by field, and how it is read back.

Errors are shares of the light, times milliseconds. docs/frontier.schema.json is made from these records
(`python -m xihe_blender.lab.frontier.records`). Nothing here needs Blender, since the report of a batch reads them too.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Literal

from xihe_blender.io.json_records import ABSENT, INLINE, json_schema
from xihenet.codec import EncodingMethod
from xihenet.estimators import DEFAULT
from xihenet.formats import format_count
from xihenet.sphere import TABLE_SIZE, NearestMethod

SCHEMA_VERSION: Literal[1] = 1
STEADY = 0.95
"""A choice flickers if it is on the front in more than 1 - STEADY and less than STEADY of the resamples."""

Front = Literal["render", "compute", "total"]


def _theta_of_a_run() -> float:
    from xihe_blender.previs.settings import PREVIS_TRIGGER  # A run's settings need Blender.

    return PREVIS_TRIGGER.theta


@dataclass(frozen=True)
class ComputeChoice:
    """How the light is computed from what was captured; the base, without arguments, is what a run takes.

    Parameters
    ----------
    estimator : its registered name
    order : of the coefficients; only `projection` has another than 2
    n_anchors : of the unit sphere
    nearest : how points find their anchor
    table_size : cells of "table" over azimuth and polar angle; None for another way
    every_pixel : of each row and column every n-th pixel is used
    theta : threshold of the trigger for colour; 0 estimates in every frame
    wire : format in which clouds go to the estimator and back; None for one on the same machine
    """

    estimator: str = DEFAULT
    order: int = 2
    n_anchors: int = 1280
    nearest: NearestMethod = "exact"
    table_size: tuple[int, int] | None = None
    every_pixel: int = 1
    theta: float = field(default_factory=_theta_of_a_run)
    wire: EncodingMethod | None = None

    @property
    def label(self) -> str:
        """What differs from the base, in words."""
        base, size = ComputeChoice(), "" if self.table_size is None else f" {self.table_size[0]}x{self.table_size[1]}"
        words = {
            "estimator": self.estimator,
            "order": f"order {self.order}",
            "n_anchors": f"{self.n_anchors} anchors",
            "nearest": {"table": f"table{size}", "brute": "brute force"}.get(self.nearest, self.nearest),
            "every_pixel": f"1 pixel in {self.every_pixel**2}",
            "theta": f"theta {self.theta:g}",
            "wire": f"over the wire as {self.wire}",
        }
        return ", ".join(told for name, told in words.items() if getattr(self, name) != getattr(base, name)) or "base"

    @property
    def cells(self) -> tuple[int, int]:
        """Of the table, if there is one."""
        return self.table_size or TABLE_SIZE


@dataclass(frozen=True)
class RenderChoice:
    """How a frame is rendered.

    Parameters
    ----------
    size : of the frame in pixels
    samples : per pixel
    max_bounces : of any kind; None takes what the scene calls for
    is_denoised : with OpenImageDenoise
    """

    size: tuple[int, int]
    samples: int
    max_bounces: int | None = None
    is_denoised: bool = True

    @property
    def label(self) -> str:
        """In words: "128x96, 16 samples, 4 bounces"."""
        words = f"{self.size[0]}x{self.size[1]}, {format_count(self.samples, 'sample')}"
        if self.max_bounces is not None:
            words += f", {self.max_bounces} bounce{'' if self.max_bounces == 1 else 's'}"
        return words if self.is_denoised else f"{words}, not denoised"


@dataclass(frozen=True)
class StudySize:
    """How much is measured.

    Parameters
    ----------
    n_walk_frames : of the path, at most, over which computing is measured
    walk_samples : of their captures; what noise they have is the same for all choices
    probe_samples : pictures of the reference probe that estimates are held against, at most
    n_rounds : in which each way to compute is timed
    n_views : frames in which each way to render is measured
    n_seeds : of each render in each of them
    reference_samples : of the exhaustive render
    ladder : samples that are measured
    n_picture_views : frames whose pictures are compared; 0 compares none
    """

    n_walk_frames: int
    walk_samples: int
    probe_samples: int
    n_rounds: int
    n_views: int
    n_seeds: int
    reference_samples: int
    ladder: tuple[int, ...]
    n_picture_views: int


@dataclass(frozen=True)
class FrontierSettings:
    """What is measured.

    Parameters
    ----------
    is_quick : fewer choices
    seed : of everything that is random
    size : of the largest frame; None takes that of a run
    study_size : None takes that of a quick or a full study
    """

    is_quick: bool = False
    seed: int = 0
    size: tuple[int, int] | None = None
    study_size: StudySize | None = None


@dataclass(frozen=True, kw_only=True)
class ChoiceSettings:
    """A choice, and what came of it.

    Parameters
    ----------
    rendering, computing : None where it is the same for all that are compared; their fields stand among these in a file
    picture_samples : per pixel of the pictures; absent where none is made
    estimates, steps : that a walk took, and in how many it could have; absent for renders
    """

    rendering: RenderChoice | None = field(default=None, metadata=INLINE)
    picture_samples: int | None = field(default=None, metadata=ABSENT)
    computing: ComputeChoice | None = field(default=None, metadata=INLINE)
    estimates: int | None = field(default=None, metadata=ABSENT)
    steps: int | None = field(default=None, metadata=ABSENT)


@dataclass(frozen=True, kw_only=True)
class PointSettings(ChoiceSettings):
    """The settings of a point.

    Parameters
    ----------
    error_kind : what the error is of; "_truth" at its end: against the truth, else against the exhaustive setting
    """

    error_kind: str


@dataclass(frozen=True, kw_only=True)
class FrontierPoint:
    """A choice on one front, by one kind of error.

    Parameters
    ----------
    scene : stem of its file
    front : what the time is of: the capture (for pictures the comparison too), the chain, or both
    settings : the choice, and `error_kind`
    error, error_spread : root mean square over places, and the distance between the quartiles
    time_ms, spread_ms : processor time of a frame, the median over rounds, and the distance between the quartiles
    on_front : no other choice of this scene, front and kind has no more error in no more time, and less of one
    front_share : of resampled measurements that put it there
    preset : whose choice it is on this scene, or None
    label : in words
    instead : label of one on the front to take instead; None for one that is there
    """

    scene: str
    front: Front
    settings: PointSettings
    error: float
    error_spread: float
    time_ms: float
    spread_ms: float
    on_front: bool
    front_share: float
    preset: str | None
    label: str
    instead: str | None

    @property
    def kind(self) -> str:
        return self.settings.error_kind

    @property
    def name(self) -> str:
        """What the choice is called: a preset with what it is on the scene."""
        return self.label if self.preset is None else f"{self.preset} ({self.label})"

    @property
    def flickers(self) -> bool:
        """Whether chance decides if it is on the front."""
        return 1 - STEADY < self.front_share < STEADY

    @property
    def computing(self) -> ComputeChoice:
        """How its light is computed: the base for a render that is judged alone."""
        return self.settings.computing or ComputeChoice()


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What the fronts of a scene say to a question.

    Parameters
    ----------
    scene, question, answer : in sentences
    """

    scene: str
    question: str
    answer: str


@dataclass(frozen=True, kw_only=True)
class FrontierScene:
    """A scene that was measured.

    Parameters
    ----------
    name : stem of its file
    missing_estimators : that could not be loaded
    exposure : of the session
    size : of the largest frame
    n_walk_frames, n_places : over which computing was measured; a place is a position in a frame
    views : frames in which rendering was measured
    presets : what they are on this scene
    """

    name: str
    missing_estimators: tuple[str, ...]
    exposure: float
    size: tuple[int, int]
    n_walk_frames: int
    n_places: int
    views: tuple[int, ...]
    presets: dict[str, RenderChoice]


@dataclass(frozen=True, kw_only=True)
class Frontier:
    """All of frontier.json.

    Parameters
    ----------
    schema_version : of the file
    software : versions, and the `command` that was typed
    machine : platform, processor, cores
    settings, scenes : see there
    answers : to what people ask, by scene
    points : of all choices, fronts and kinds of error
    """

    schema_version: Literal[1] = SCHEMA_VERSION
    software: dict[str, str]
    machine: dict[str, str | int | None]
    settings: FrontierSettings
    scenes: tuple[FrontierScene, ...]
    answers: tuple[Answer, ...]
    points: tuple[FrontierPoint, ...]


if __name__ == "__main__":
    print(json.dumps(json_schema(Frontier), indent=1))
