"""Movement of virtual objects: where are the estimation positions at each frame, if they move along the path?

They keep their share of the object's box, which turns as the object does: so an object that moves by keys, parents,
constraints, bones or physics takes them with it, and one that spins or breathes hardly does. Rejected: splitting the
box anew at each frame, which for a long shelf that turns gives other positions, and another number of them.
"""

from __future__ import annotations

import bpy
import numpy as np

from xihe_blender.previs.plan import PrevisPlan
from xihe_blender.scene.estimation_positions import box_corners_m
from xihenet.controller import MOVED_M
from xihenet.records import ArrayF64


class MovementSurvey:
    """Gathers the places of the estimation positions of `plan`, one evaluated frame after the other.

    `moved` has those that are not where the plan has them, by frame. One stays where it was until it is further than
    MOVED_M from there, and in frames in which its object is nowhere.
    """

    def __init__(self, plan: PrevisPlan) -> None:
        self.plan = plan
        self.places = {probe.name: probe.position_m for probe in plan.probes}
        self.first: dict[str, tuple[ArrayF64, ArrayF64]] = {}
        """By object: its axes (3, 3) in the first frame, and which share of its box (K, 3) the positions have."""
        self.moved: dict[int, dict[str, tuple[float, ...]]] = {}

    def look_at(self, depsgraph: bpy.types.Depsgraph) -> None:
        for item in self.plan.objects:
            probes, axes = self.plan.probes_of(item.name), _axes(item.evaluated_get(depsgraph))
            if item.name not in self.first:
                low_m, size_m = _box(item, depsgraph, np.eye(3))
                within_m = np.stack([probe.position_m for probe in probes]) - low_m
                # Outside of the box is one that the plan, which does not look as renders do, has found elsewhere.
                is_known = (size_m > MOVED_M) & (within_m > 0) & (within_m < size_m)
                self.first[item.name] = axes, np.where(is_known, within_m / np.where(is_known, size_m, 1), 0.5)
            first_axes, shares = self.first[item.name]
            turn = axes @ first_axes.T
            low_m, size_m = _box(item, depsgraph, turn)
            for probe, place in zip(probes, (low_m + shares * size_m) @ turn.T, strict=True):
                if np.linalg.norm(place - self.places[probe.name]) > MOVED_M:
                    self.places[probe.name] = place
        self.moved[depsgraph.scene.frame_current] = {
            probe.name: tuple(self.places[probe.name].tolist())
            for probe in self.plan.probes
            if self.places[probe.name] is not probe.position_m
        }


def _axes(item: bpy.types.Object) -> ArrayF64:
    """(3, 3) a rotation, whatever the scale."""
    return np.array(item.matrix_world.to_quaternion().normalized().to_matrix(), np.float64)


def _box(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph, axes: ArrayF64) -> tuple[ArrayF64, ArrayF64]:
    """(3,) the low corner and the size of the object's box along the columns of `axes`, in metres."""
    corners_m = box_corners_m(item, depsgraph) @ axes
    low_m: ArrayF64 = corners_m.min(axis=0)
    return low_m, corners_m.max(axis=0) - low_m
