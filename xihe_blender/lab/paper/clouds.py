"""What a session's frames show from its places, as the studies take it: one view, or all of a walk."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

from xihe_blender.lab.paper.records import Place, Session
from xihenet.buffers import merge
from xihenet.camera import in_view, unproject_frame
from xihenet.records import PointCloud, RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice
from xihenet.walk.placement import evenly_chosen


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
