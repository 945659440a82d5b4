"""Files of random weights of any network, and the same with something wrong."""

import json

import numpy as np


def random_arrays(architecture, seed=0):
    """Weights that keep values about as large as they come in."""
    rng = np.random.default_rng(seed)
    return {
        name: (rng.normal(size=shape) / np.sqrt(shape[-1])).astype(np.float32)
        for name, shape in architecture.array_shapes().items()
    }


def changed_file(path, change):
    """A file "changed.npz" beside `path`, with `change` made to the arrays of that one."""
    with np.load(path) as stored:
        content = dict(stored)
    change(content)
    np.savez(path.with_name("changed.npz"), **content)
    return path.with_name("changed.npz")


def with_header(**changes):
    """A change of entries of the header."""

    def change(content):
        content["header"] = np.array(json.dumps(json.loads(content["header"].item()) | changes))

    return change


def with_arrays(**changes):
    """A change of arrays, their dots written as two underscores."""
    return lambda content: content.update({name.replace("__", "."): array for name, array in changes.items()})


def without(name):
    """A change that leaves out an array."""
    return lambda content: content.pop(name)
