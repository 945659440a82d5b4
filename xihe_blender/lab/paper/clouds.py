"""Clouds of a session from its places, as the studies take them: of one view, or of all of a walk."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.lab.paper.records import Place, Session, StudyOptions
from xihenet import estimators
from xihenet.buffers import merge
from xihenet.camera import in_view, unproject_frame
from xihenet.camera_path.placement import evenly_chosen
from xihenet.estimators import EstimateContext
from xihenet.metrics import shc_rmse
from xihenet.records import ArrayF64, PointCloud, RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice


@dataclass(frozen=True, eq=False)
class View:
    """A place that a frame has in view, and the frame's points at the session's exposure."""

    room: str
    place: Place
    frame: RgbdFrame
    points: PointCloud
    exposure: float

    def cloud(self, lattice: AnchorLattice) -> UnitSphereCloud:
        """What the frame alone shows from the place."""
        return sample_unit_sphere(self.points, self.place.position_m, lattice)


def views(sessions: Sequence[Session], most: int) -> Iterator[View]:
    """At most so many of each room, evenly spread over its frames and places in view."""
    for session in sessions:
        found = [
            (frame, place)
            for frame in session.frames
            for place in session.places
            if in_view(place.position_m[None], frame.intrinsics, frame.world_from_camera)[0]
        ]
        for frame, place in evenly_chosen(found, most):
            points = unproject_frame(frame, reference_exposure=session.exposure)
            yield View(session.name, place, frame, points, session.exposure)


def several_views(sessions: Sequence[Session], options: StudyOptions, *, is_steady: bool = False) -> list[View]:
    """20 of each room if it is to be quick, else 100, of steady rooms alone or of all. UserError for fewer than two."""
    found = list(views(with_truth(sessions) if is_steady else sessions, 20 if options.quick else 100))
    if len(found) < 2:
        rooms = "rooms whose light stands still" if is_steady else "the rooms"
        raise UserError(f"fewer than two frames of {rooms} have a place in view: give more --scenes")
    return found


def view_errors(
    name: str, found: Sequence[View], n_anchors: int = 1280, points: Sequence[PointCloud] | None = None
) -> ArrayF64:
    """SHC RMSE of an estimator's light from each view's cloud, and from `points` or all that it shows."""
    estimator, lattice = estimators.load(name, n_anchors, "ldr"), AnchorLattice(n_anchors)
    errors = []
    for view, seen in zip(found, points or [view.points for view in found], strict=True):
        context = EstimateContext(view.frame, seen, view.place.position_m, None, view.exposure)
        errors.append(shc_rmse(estimator.estimate(view.cloud(lattice), context), view.place.true_ldr))
    return np.array(errors)


def walk_errors(
    sessions: Sequence[Session],
    lattice: AnchorLattice,
    estimate: Callable[[UnitSphereCloud], ArrayF64],
    **sampling: Any,
) -> list[float]:
    """SHC RMSE of what is estimated, clipped at white, from all that the walk shows of each place, room by room."""
    return [
        shc_rmse(estimate(cloud), place.true_ldr)
        for session in sessions
        for cloud, place in zip(walked(session, lattice, **sampling), session.places, strict=True)
    ]


def walked(session: Session, lattice: AnchorLattice, **sampling: Any) -> list[UnitSphereCloud]:
    """All that the walk shows from each place, in their order."""
    points = [unproject_frame(frame, reference_exposure=session.exposure) for frame in session.frames]
    return [
        reduce(merge, [sample_unit_sphere(cloud, place.position_m, lattice, **sampling) for cloud in points])
        for place in session.places
    ]


def with_truth(sessions: Sequence[Session]) -> list[Session]:
    """Those whose light stays the same, so that the truth is known."""
    return [session for session in sessions if session.has_truth]
