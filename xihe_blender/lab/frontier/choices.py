"""Choices that trade accuracy for time, and which of them are measured.

Around the base, which is what a run takes by default, one choice is varied at a time; then come combinations that could
be better than any of these: few anchors with the fast table, a small frame with many samples, and the like. Rejected:
every combination of everything, some 50,000 for computing alone.

The exhaustive setting is the one that spares nothing: every point to its true nearest anchor by comparing all of them,
an estimate in every frame, and for renders the most samples and all bounces that the scene calls for. It has the base's
1280 anchors and not the most that are measured: on 1,179 clouds of test rooms 2048 anchors are no nearer to the truth
(0.607 against 0.603 of the error of `ambient`, see docs/estimators.md), so that distance from them is no error.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from xihe_blender.previs.settings import PREVIS_TRIGGER
from xihenet.codec import EncodingMethod
from xihenet.estimators import DEFAULT
from xihenet.formats import format_count
from xihenet.sphere import TABLE_SIZE, NearestMethod


@dataclass(frozen=True)
class ComputeChoice:
    """How the light is computed from what was captured.

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
    theta: float = PREVIS_TRIGGER.theta
    wire: EncodingMethod | None = None

    @property
    def label(self) -> str:
        """What differs from the base, in words."""
        return ", ".join(_words(self, ComputeChoice())) or "base"

    @property
    def cells(self) -> tuple[int, int]:
        """Of the table, if there is one."""
        return self.table_size or TABLE_SIZE

    def as_json(self) -> dict[str, Any]:
        return _plain(asdict(self))


EXHAUSTIVE = ComputeChoice(nearest="brute", theta=0.0)
SMALL_TABLE, PAPERS_TABLE, LARGE_TABLE = (256, 128), TABLE_SIZE, (4096, 2048)


@dataclass(frozen=True)
class RenderChoice:
    """How a frame is rendered.

    Parameters
    ----------
    size : of the frame in pixels
    samples : per pixel
    max_bounces : of any kind; None takes what the scene calls for
    is_denoised : with OpenImageDenoise
    preset : whose choice this is on the scene at hand, or None
    """

    size: tuple[int, int]
    samples: int
    max_bounces: int | None = None
    is_denoised: bool = True
    preset: str | None = None

    @property
    def label(self) -> str:
        """In words: "128x96, 16 samples, 4 bounces"."""
        words = [f"{self.size[0]}x{self.size[1]}", format_count(self.samples, "sample")]
        if self.max_bounces is not None:
            words.append(f"{self.max_bounces} bounce{'' if self.max_bounces == 1 else 's'}")
        return ", ".join([*words, *([] if self.is_denoised else ["not denoised"])])

    def as_json(self) -> dict[str, Any]:
        return _plain({name: value for name, value in asdict(self).items() if name != "preset"})


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


FULL = StudySize(24, 8, 32, 25, 3, 2, 256, (1, 2, 4, 8, 16, 32, 64), 2)
QUICK = StudySize(6, 4, 16, 15, 1, 2, 96, (1, 4, 16), 0)


def compute_choices(*, is_quick: bool) -> list[ComputeChoice]:
    """Ways to compute, the base first and the exhaustive one last; each once."""
    base = ComputeChoice()
    single = [
        base,
        *(replace(base, n_anchors=n) for n in ((512, 2048) if is_quick else (512, 768, 1024, 1536, 2048))),
        *(replace(base, nearest="table", table_size=size) for size in (SMALL_TABLE, PAPERS_TABLE, LARGE_TABLE)),
        replace(base, nearest="brute"),
        *(replace(base, every_pixel=step) for step in (2, 4)),
        *(replace(base, theta=theta) for theta in ((0.0, 0.6) if is_quick else (0.0, 0.005, 0.1, 0.6))),
        replace(base, wire="float32_stripped"),
        replace(base, wire="uint8_float16_stripped"),
    ]
    combined = [
        replace(base, n_anchors=512, every_pixel=4),
        replace(base, n_anchors=512, nearest="table", table_size=SMALL_TABLE, every_pixel=2),
        replace(base, n_anchors=2048, theta=0.0),
        replace(base, n_anchors=2048, every_pixel=2),
        replace(base, n_anchors=512, theta=0.6),
        replace(base, nearest="table", table_size=PAPERS_TABLE, theta=0.0),
    ]
    return list(dict.fromkeys([*single, *combined, *_other_estimators(), EXHAUSTIVE]))


def _other_estimators() -> Iterable[ComputeChoice]:
    """Other estimators than the default, among them `projection` by order."""
    yield ComputeChoice(estimator="ambient")
    yield from (ComputeChoice(estimator=name) for name in ("xihenet", "pointar"))
    yield from (ComputeChoice(estimator="projection", order=order) for order in range(5))
    yield ComputeChoice(estimator="projection", n_anchors=512)
    yield ComputeChoice(estimator="projection", n_anchors=2048, theta=0.0)


def render_choices(
    presets: Mapping[str, RenderChoice], size: tuple[int, int], study_size: StudySize, *, is_quick: bool
) -> list[RenderChoice]:
    """Ways to render a frame, those of the presets first; `size` is that of a phone's frame."""
    middle = presets["draft" if is_quick else "balanced"].samples
    half, quarter = ((size[0] // k, size[1] // k) for k in (2, 4))
    base = RenderChoice(size, middle)
    single = [
        *(replace(base, samples=n) for n in study_size.ladder),
        *(replace(base, max_bounces=n) for n in ((0, 2) if is_quick else (0, 1, 2, 4, 8))),
        replace(base, is_denoised=False),
        *(replace(base, size=smaller) for smaller in (half, quarter)),
    ]
    combined = [
        *(replace(base, size=half, samples=n) for n in study_size.ladder if n >= 4),
        *(replace(base, size=quarter, samples=n) for n in study_size.ladder if n >= 16),
        *(replace(base, size=half, samples=n, is_denoised=False) for n in study_size.ladder if n == 16),
        *(replace(base, samples=n, max_bounces=2) for n in study_size.ladder if n == 1),
    ]
    own = {replace(choice, preset=None) for choice in presets.values()}
    others = dict.fromkeys(choice for choice in (*single, *combined) if choice not in own)
    return [*presets.values(), *others]


def _words(choice: ComputeChoice, base: ComputeChoice) -> Iterable[str]:
    if choice.estimator != base.estimator:
        yield choice.estimator
    if choice.order != base.order:
        yield f"order {choice.order}"
    if choice.n_anchors != base.n_anchors:
        yield f"{choice.n_anchors} anchors"
    if choice.nearest != base.nearest:
        size = "" if choice.table_size is None else f" {choice.table_size[0]}x{choice.table_size[1]}"
        yield {"table": f"table{size}", "brute": "brute force"}.get(choice.nearest, choice.nearest)
    if choice.every_pixel != base.every_pixel:
        yield f"1 pixel in {choice.every_pixel**2}"
    if choice.theta != base.theta:
        yield f"theta {choice.theta:g}"
    if choice.wire is not None:
        yield f"over the wire as {choice.wire}"


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """As JSON holds it."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in settings.items()}
