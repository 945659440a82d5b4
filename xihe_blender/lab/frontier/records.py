"""Records of a frontier: what frontier.json says, field by field, and how it is read back.

Errors are shares of the light, times milliseconds. docs/frontier.schema.json is made from these records
(`python -m xihe_blender.lab.frontier.records`). Nothing here needs Blender, since the report of a batch reads them too.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Annotated, Literal

from xihe_blender.io.json_records import ABSENT, INLINE, json_schema
from xihenet.codec import EncodingMethod
from xihenet.estimators import DEFAULT
from xihenet.formats import format_count
from xihenet.light import LightParts
from xihenet.sphere import TABLE_SIZE, NearestMethod
from xihenet.trigger import RULES

SCHEMA_VERSION: Literal[1] = 1
STEADY = 0.95
"""A choice flickers if it is on the front in more than 1 - STEADY and less than STEADY of the resamples."""

Front = Literal["render", "compute", "total"]


@dataclass(frozen=True)
class ComputeChoice:
    """How the light is computed from what was captured; the base, without arguments, is what a run takes."""

    estimator: Annotated[str, "its registered name"] = DEFAULT
    order: Annotated[int, "of the coefficients; only `projection` has another than 2"] = 2
    n_anchors: Annotated[int, "of the unit sphere"] = 1280
    nearest: Annotated[NearestMethod, "how points find their anchor"] = "exact"
    table_size: Annotated[tuple[int, int] | None, 'cells of "table" over azimuth and polar angle; else None'] = None
    every_pixel: Annotated[int, "of each row and column every n-th pixel is used"] = 1
    theta: Annotated[float, "of the trigger, for colour; 0 estimates always"] = RULES["split"].theta
    wire: Annotated[EncodingMethod | None, "format of clouds to the estimator and back; None: it stays here"] = None

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
    """How a frame is rendered."""

    size: Annotated[tuple[int, int], "of the frame in pixels"]
    samples: Annotated[int, "per pixel"]
    max_bounces: Annotated[int | None, "of any kind; None takes what the scene calls for"] = None
    is_denoised: Annotated[bool, "with OpenImageDenoise"] = True

    @property
    def label(self) -> str:
        """In words: "128x96, 16 samples, 4 bounces"."""
        words = f"{self.size[0]}x{self.size[1]}, {format_count(self.samples, 'sample')}"
        if self.max_bounces is not None:
            words += f", {self.max_bounces} bounce{'' if self.max_bounces == 1 else 's'}"
        return words if self.is_denoised else f"{words}, not denoised"


@dataclass(frozen=True)
class StudySize:
    """How much is measured."""

    n_walk_frames: Annotated[int, "of the path, at most, over which computing is measured"]
    walk_samples: Annotated[int, "of their captures; what noise they have is the same for all choices"]
    probe_samples: Annotated[int, "pictures of the reference probe that estimates are held against, at most"]
    n_rounds: Annotated[int, "in which each way to compute is timed"]
    n_views: Annotated[int, "frames in which each way to render is measured"]
    n_seeds: Annotated[int, "of each render in each of them"]
    reference_samples: Annotated[int, "of the exhaustive render, at least; twice those of any preset besides"]
    ladder: Annotated[tuple[int, ...], "samples that are measured"]
    n_picture_views: Annotated[int, "frames whose pictures are compared; 0 compares none"]


@dataclass(frozen=True)
class FrontierSettings:
    """What is measured."""

    is_quick: Annotated[bool, "fewer choices"] = False
    seed: Annotated[int, "of everything that is random"] = 0
    size: Annotated[tuple[int, int] | None, "of the largest frame; None takes that of a run"] = None
    study_size: Annotated[StudySize | None, "None takes that of a quick or a full study"] = None


@dataclass(frozen=True, kw_only=True)
class ChoiceSettings:
    """A choice, and what came of it.

    `rendering` or `computing` is None where it is the same for all that are compared, and the fields of both stand
    among these in a file. Of the others one is absent, and None here, where it does not apply.
    """

    rendering: RenderChoice | None = field(default=None, metadata=INLINE)
    picture_samples: Annotated[int | None, "per pixel of the pictures"] = field(default=None, metadata=ABSENT)
    light: Annotated[LightParts | None, "of objects in the pictures"] = field(default=None, metadata=ABSENT)
    computing: ComputeChoice | None = field(default=None, metadata=INLINE)
    estimates: Annotated[int | None, "that a walk took"] = field(default=None, metadata=ABSENT)
    steps: Annotated[int | None, "in which it could have taken one"] = field(default=None, metadata=ABSENT)


@dataclass(frozen=True, kw_only=True)
class PointSettings(ChoiceSettings):
    """The settings of a point."""

    error_kind: Annotated[str, 'of what; "_truth" at its end: against the truth, else against the exhaustive setting']


@dataclass(frozen=True, kw_only=True)
class FrontierPoint:
    """A choice on one front, by one kind of error."""

    scene: Annotated[str, "stem of its file"]
    front: Annotated[Front, "what the time is of: the capture (for pictures the comparison too), the chain, or both"]
    settings: Annotated[PointSettings, "the choice, and `error_kind`"]
    error: Annotated[float, "root mean square over places"]
    error_spread: Annotated[float, "distance between the quartiles over places"]
    time_ms: Annotated[float, "processor time of a frame, the median over rounds"]
    spread_ms: Annotated[float, "distance between the quartiles over rounds"]
    on_front: Annotated[bool, "none of this scene, front and kind has no more error in no more time, and less of one"]
    front_share: Annotated[float, "of resampled measurements that put it there"]
    preset: Annotated[str | None, "whose choice it is on this scene, or None"]
    label: Annotated[str, "in words"]
    instead: Annotated[str | None, "label of one on the front to take instead; None for one that is there"]

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
    """What the fronts of a scene say to a question."""

    scene: Annotated[str, "stem of its file"]
    question: Annotated[str, "in sentences"]
    answer: Annotated[str, "in sentences"]


@dataclass(frozen=True, kw_only=True)
class FrontierScene:
    """A scene that was measured."""

    name: Annotated[str, "stem of its file"]
    exposure: Annotated[float, "of the session"]
    size: Annotated[tuple[int, int], "of the largest frame"]
    n_walk_frames: Annotated[int, "over which computing was measured"]
    n_places: Annotated[int, "in them; a place is a position in a frame"]
    views: Annotated[tuple[int, ...], "frames in which rendering was measured"]
    presets: Annotated[dict[str, RenderChoice], "what they are on this scene"]
    exhaustive_samples: Annotated[int, "of the exhaustive render"]


@dataclass(frozen=True, kw_only=True)
class Frontier:
    """All of frontier.json."""

    schema_version: Annotated[Literal[1], "of the file"] = SCHEMA_VERSION
    software: Annotated[dict[str, str], "versions, and the `command` that was typed"]
    machine: Annotated[dict[str, str | int | None], "platform, processor, cores"]
    settings: Annotated[FrontierSettings, "see there"]
    scenes: Annotated[tuple[FrontierScene, ...], "see there"]
    answers: Annotated[tuple[Answer, ...], "to what people ask, by scene"]
    points: Annotated[tuple[FrontierPoint, ...], "of all choices, fronts and kinds of error"]


if __name__ == "__main__":
    print(json.dumps(json_schema(Frontier), indent=1))
