"""Which light does an SH world show: as it is now, and along the timeline?"""

import numpy as np

from xihe_blender.apply.datablocks import NODE_GROUP_NAME
from xihe_blender.apply.keys import f_curves
from xihe_blender.apply.sh_worlds import COEFFICIENTS, GAIN


def shown_light(world):
    """(9, 3) coefficients, and the gain."""
    inputs = world.node_tree.nodes[NODE_GROUP_NAME].inputs
    return np.array([inputs[name].default_value for name in COEFFICIENTS]), inputs[GAIN].default_value


def keyed(world):
    """{frame: (9, 3) coefficients} of a world's F-curves, and their interpolations."""
    table, interpolations = {}, set()
    for curve in f_curves(world.node_tree):
        for point in curve.keyframe_points:
            interpolations.add(point.interpolation)
            table.setdefault(round(point.co[0]), {})[curve.data_path, curve.array_index] = point.co[1]
    node = world.node_tree.nodes[NODE_GROUP_NAME]
    paths = [node.inputs[name].path_from_id("default_value") for name in COEFFICIENTS]
    coefficients = {f: np.array([[values[path, c] for c in range(3)] for path in paths]) for f, values in table.items()}
    return coefficients, interpolations
