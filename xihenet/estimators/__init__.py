"""Which estimators are there, and how do I get one?

The registry is a table of names and where each lives; a module is imported when it is asked for, so listing the names
needs nothing installed. A new estimator is one file and one row.
"""

from __future__ import annotations

import importlib

from xihenet.estimators.base import EstimateContext, Estimator, Target

__all__ = ["DEFAULT", "EstimateContext", "Estimator", "Target", "load", "names"]

_REGISTRY = {
    "ambient": ("xihenet.estimators.ambient", "Ambient"),
    "projection": ("xihenet.estimators.projection", "Projection"),
    "pointar": ("xihenet.estimators.pointconv", "PointAR"),
    "xihenet": ("xihenet.estimators.pointconv", "XiheNet"),
    "lattice": ("xihenet.estimators.lattice", "Lattice"),
    "truth": ("xihenet.estimators.truth", "Truth"),
}
DEFAULT = "lattice"


def names() -> list[str]:
    """All registered estimators."""
    return list(_REGISTRY)


def load(name: str, n_anchors: int = 1280, target: Target = "ldr") -> Estimator:
    """The estimator of that name, for clouds of `n_anchors`; ValueError for an unknown name or illegal other values."""
    if name not in _REGISTRY:
        raise ValueError(f"there is no estimator {name!r}; choose one of {', '.join(names())}")
    module, class_name = _REGISTRY[name]
    estimator: Estimator = getattr(importlib.import_module(module), class_name)(n_anchors, target)
    return estimator
