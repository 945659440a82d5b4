"""A camera path that was captured, kept: from its frames follows the light at any place, without another picture.

What the chain of a session has learned of the room does not depend on the places that it was asked for. So it is run
again on the same frames, with the same settings, for others: light, coverage and expected error there are those that
the session would have found, in its frames and at its exposure.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from xihenet.camera import in_view, unproject_frame
from xihenet.controller import ControllerSettings
from xihenet.estimators import Estimator
from xihenet.phone import Link
from xihenet.phone.session import PhoneSession
from xihenet.records import ArrayF64, Intrinsics, ObjectLight, PointCloud, RgbdFrame


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """One frame as the phone saw it, its points, and the camera as it truly was: intrinsics and (4, 4) pose.

    `points` are three quarters of the memory. They are None on a path for which that is too much, see `unprojected`.
    """

    seen: RgbdFrame
    points: PointCloud | None
    camera: tuple[Intrinsics, ArrayF64]

    def unprojected(self, exposure: float) -> PointCloud:
        """The points, at the session's `exposure`; anew where they are not kept."""
        return unproject_frame(self.seen, reference_exposure=exposure) if self.points is None else self.points


@dataclass(eq=False)
class FoundLight:
    """What a session comes to know of one position, by frame.

    `lights` are those in use, carrying the session's exposure: until the first estimate the ambient one.
    `coverage` is the share of the anchors that are known, `expected_error` SHC RMSE, None for an estimator that expects
    none or before there is an estimate. `was_in_view` says whether the position ever was.
    """

    lights: dict[int, ObjectLight] = field(default_factory=dict)
    coverage: dict[int, float] = field(default_factory=dict)
    expected_error: dict[int, float | None] = field(default_factory=dict)
    was_in_view: bool = False

    @property
    def sh(self) -> dict[int, ArrayF64]:
        """(9, 3) coefficients of all of the light."""
        return {frame: light.sh for frame, light in self.lights.items()}


@dataclass(frozen=True, eq=False)
class KeptPath:
    """All that the chain of a session needs to be run again; `link` and `seed` as of `PhoneSession`."""

    frames: tuple[SeenFrame, ...]
    chain: ControllerSettings
    estimator: Estimator
    link: Link | None = None
    seed: int = 0

    def find_light(self, places_m: Mapping[str, ArrayLike]) -> Generator[int, None, dict[str, FoundLight]]:
        """The light at positions ((3,) world, metres) that stay where they are, by name; a step per frame.

        Each step says how many frames are done. The same as a session's, to the last bit.
        """
        positions = [_Fixed(name, np.asarray(place, np.float64)) for name, place in places_m.items()]
        session = PhoneSession(positions, self.chain, self.estimator, self.link, seed=self.seed)
        found, positions_m = {name: FoundLight() for name in places_m}, np.array(list(places_m.values())).reshape(-1, 3)
        for done, one in enumerate(self.frames):
            yield done
            are_seen = in_view(positions_m, *one.camera)
            active = [name for name, is_seen in zip(places_m, are_seen, strict=True) if is_seen]
            session.step(one.seen, {}, active, one.points)
            for name, light in found.items():
                frame, time_s = one.seen.frame, one.seen.time_s
                light.lights[frame] = session.object_light([name], time_s)
                light.coverage[frame] = session.controller.coverage(name)
                light.expected_error[frame] = session.expected_error(name, time_s)
                light.was_in_view |= name in active
        return found


@dataclass(frozen=True, eq=False)
class _Fixed:
    """A position that stays where it is."""

    name: str
    position_m: ArrayF64

    def at(self, frame: int) -> ArrayF64:
        return self.position_m
