"""Choices that trade accuracy for time, and which of them are measured.

Around the base, which is what a run takes by default, one choice is varied at a time; then come combinations that could
be better than any of these: few anchors with the fast table, a small frame with many samples, and the like. Rejected:
every combination of everything, some 50,000 for computing alone.

The exhaustive setting is the one that spares nothing: every point to its true nearest anchor by comparing all of them,
an estimate in every frame, and for renders the most samples and all bounces that the scene calls for. It has the base's
1280 anchors and not the most that are measured: on 1,179 clouds of test rooms 2048 anchors are no nearer to the truth
(0.607 against 0.603 of the error of `ambient`), so that distance from them is no error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from xihe_blender.lab.frontier.records import ComputeChoice, RenderChoice, StudySize
from xihenet.light import LightParts
from xihenet.sphere import TABLE_SIZE

EXHAUSTIVE = ComputeChoice(nearest="brute", theta=0.0)
SMALL_TABLE, PAPERS_TABLE, LARGE_TABLE = (256, 128), TABLE_SIZE, (4096, 2048)

FULL = StudySize(24, 8, 32, 25, 3, 2, 256, (1, 2, 4, 8, 16, 32, 64), 2)
QUICK = StudySize(6, 4, 16, 15, 1, 2, 96, (1, 4, 16), 0)


@dataclass(frozen=True)
class RenderCandidate:
    """A way to render that is measured: a preset's on the scene at hand, or one of the others (None).

    With `picture_samples`, per pixel, it is the pictures of the comparison that are measured, and `light` is what
    objects in them are lit with.
    """

    choice: RenderChoice
    preset: str | None = None
    picture_samples: int | None = None
    light: LightParts | None = None

    @property
    def label(self) -> str:
        if self.picture_samples is None:
            return self.choice.label
        words = f"capture {self.choice.label}; pictures {self.picture_samples} samples"
        return words if self.light == "sh" else f"{words}, {self.light}"

    @property
    def key(self) -> str:
        """What it is kept under: two presets may render alike on a scene, and are measured twice all the same."""
        return self.label if self.preset is None else f"{self.preset}: {self.label}"


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
        replace(base, wire="uint8_float16_facing_stripped"),
    ]
    combined = [
        replace(base, n_anchors=512, every_pixel=4),
        replace(base, n_anchors=512, nearest="table", table_size=SMALL_TABLE, every_pixel=2),
        replace(base, n_anchors=2048, theta=0.0),
        replace(base, n_anchors=2048, every_pixel=2),
        replace(base, n_anchors=512, theta=0.6),
        replace(base, nearest="table", table_size=PAPERS_TABLE, theta=0.0),
    ]
    other_estimators = [
        *(replace(base, estimator=name) for name in ("ambient", "xihenet", "pointar")),
        *(replace(base, estimator="projection", order=order) for order in range(5)),
        replace(base, estimator="projection", n_anchors=512),
        replace(base, estimator="projection", n_anchors=2048, theta=0.0),
    ]
    return list(dict.fromkeys([*single, *combined, *other_estimators, EXHAUSTIVE]))


def render_choices(
    presets: Mapping[str, RenderChoice], size: tuple[int, int], study_size: StudySize, *, is_quick: bool
) -> list[RenderCandidate]:
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
    others = dict.fromkeys(choice for choice in (*single, *combined) if choice not in presets.values())
    return [*(RenderCandidate(choice, name) for name, choice in presets.items()), *map(RenderCandidate, others)]
