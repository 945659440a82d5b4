"""The anchor count: how many anchors are enough?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from xihe_blender.lab.paper.clouds import several_views, view_errors
from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, measured, measured_ratio, of_rooms
from xihenet import estimators
from xihenet.sphere import AnchorLattice

PAPER_RMSE = {512: 0.0934, 768: 0.0960, 1024: 0.0959, 1280: 0.0941, 1536: 0.0938, 1792: 0.0940, 2048: 0.0942}
QUICK_SIZES = (512, 1280, 2048)
NON_EMPTY = 607 / 1280
ERROR = (
    "Light clipped at white from one view, in other rooms, by one set of weights of ours; the paper trains a network "
    "for each number of anchors."
)
SHARE = "In the paper 607 of 1280 anchors are set on average. The number depends on the angle of view and the room."


def measure(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    found = several_views(sessions, options, is_steady=True)
    rooms, rng = [view.room for view in found], options.rng
    cases = of_rooms("views", rooms)
    sizes = QUICK_SIZES if options.quick else tuple(PAPER_RMSE)
    for n in sizes:
        shares = measured([view.cloud(AnchorLattice(n)).is_set.mean() for view in found], rng, groups=rooms)
        paper = NON_EMPTY if n == 1280 else None
        what, is_detail = f"{n} anchors: set by one view", n not in QUICK_SIZES
        yield Row(what, "of all", *shares, "other data", SHARE, paper, cases, is_detail=is_detail)
    for name in ("xihenet", "projection", "lattice"):
        errors = {n: view_errors(name, found, n) for n in sizes if _takes(name, n)}
        for n, each in errors.items():
            paper = PAPER_RMSE[n] if name == "xihenet" else None
            of_all = measured(each, rng, groups=rooms)
            what, is_detail = f"{n} anchors: {name}", n not in QUICK_SIZES
            yield Row(what, "SHC RMSE", *of_all, "other data", ERROR, paper, cases, name, n, is_detail)
        if {512, 2048} <= errors.keys():
            of_all = measured_ratio(errors[2048], errors[512], rng, groups=rooms)
            paper = PAPER_RMSE[2048] / PAPER_RMSE[512] if name == "xihenet" else None
            yield Row(f"{name}, error of 2048 over 512", "times", *of_all, "other data", ERROR, paper, cases)


def _takes(name: str, n: int) -> bool:
    try:
        estimators.load(name, n, "ldr")
    except ValueError:
        return False
    return True


STUDY = Study(
    "anchor_count",
    "Number of anchors",
    80,
    "The paper trains its network for 512 to 2048 anchors, five runs each, and counts how many anchors one view sets.",
    measure,
    "anchors",
    "SHC RMSE of light clipped at white, from one view.",
)
