"""A live AR session inside Blender: the controller of the science, plus placing an object and lighting it at once.

Paper: section 5, `PlaceAndEstimateAt`.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector
from numpy.typing import ArrayLike

from xihe_blender.apply.datablocks import world_name
from xihe_blender.apply.sh_worlds import apply_sh_to_world, make_sh_world
from xihe_blender.scene.estimation_positions import named_positions
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet import controller
from xihenet.records import LightEstimate
from xihenet.sampling import checked_position


class XiheController(controller.XiheController):
    """`xihenet.controller.XiheController` for a scene; `place_and_estimate_at` is what it adds."""

    def place_and_estimate_at(
        self, item: bpy.types.Object, position_m: ArrayLike, *, is_deringed: bool = False
    ) -> LightEstimate:
        """Put a virtual object somewhere, estimate its light from the last frame, and light its world with it.

        Parameters
        ----------
        item : linked into the virtual collection of the current scene if it is not there yet
        position_m : (3,) world, metres: where its origin goes
        is_deringed : whether its world is rid of negative light, see `apply_sh_to_world`; the estimate stays

        Gives the estimate at the object's estimation position; of a big object that has several, the mean of those that
        could be known. Its positions are followed by `step` from now on. Where none could be known it says why, and the
        world is left as it was. ValueError before the first frame, or for a position that is not three finite numbers.
        """
        position = checked_position(position_m)
        scene = bpy.context.scene
        if item not in virtual_objects(scene):
            collection = virtual_collection(scene, create=True)
            assert collection is not None
            collection.objects.link(item)
        item.matrix_world.translation = Vector(position / metres_per_unit(scene))
        bpy.context.view_layer.update()
        positions = named_positions(item)
        estimates = [self.estimate_at(place) for place in positions.values()]
        for name, place in positions.items():
            self.add_position(name, place)
        estimate = _mean(estimates)
        if estimate.is_valid:
            world = make_sh_world(world_name(item.name))
            apply_sh_to_world(world, estimate.sh_radiance, estimate.exposure, is_deringed=is_deringed)
        return estimate


def _mean(estimates: list[LightEstimate]) -> LightEstimate:
    """One light for one object, from the valid ones of its positions."""
    valid = [estimate for estimate in estimates if estimate.is_valid]
    if not valid:
        return estimates[0]
    return LightEstimate(
        np.mean([estimate.sh_radiance for estimate in valid], axis=0),
        valid[0].exposure,
        float(np.mean([estimate.coverage for estimate in estimates])),
        valid[0].estimator,
    )
