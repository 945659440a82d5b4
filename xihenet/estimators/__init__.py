"""Which estimators are there, and how do I get one?

The registry is a table of names, where each lives, and what panel and report say of it. A module is imported when it
is asked for, so that the report, which knows no NumPy, can read the table. A new estimator is one file and one row.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from xihenet.estimators.base import EstimateContext, Estimator, Target

__all__ = ["DEFAULT", "EstimateContext", "Estimator", "Target", "kind", "label", "load", "names", "summary"]


class _Row(NamedTuple):
    module: str  # of this package
    class_name: str
    label: str
    summary: str


_REGISTRY = {
    "ambient": _Row(
        "ambient",
        "Ambient",
        "Ambient",
        "Average brightness and colour, the same from all directions, as a phone's light sensor reports",
    ),
    "projection": _Row(
        "projection",
        "Projection",
        "Projection",
        "Least-squares fit to the surroundings seen so far; no learning",
    ),
    "pointar": _Row("pointconv", "PointAR", "PointAR", "Neural network on randomly chosen points"),
    "xihenet": _Row("pointconv", "XiheNet", "XiheNet", "The paper's neural network on unit-sphere samples"),
    "lattice": _Row("lattice", "Lattice", "Lattice", "Neural network on fixed directions; takes about a millisecond"),
    "truth": _Row(
        "truth",
        "Truth",
        "Ground Truth",
        "No estimate: the true light rendered at each object, the best that can be reached",
    ),
}
DEFAULT = "lattice"


def __getattr__(name: str) -> Any:
    """What is offered here of `base`, which needs NumPy."""
    if name in ("EstimateContext", "Estimator", "Target"):
        return getattr(importlib.import_module(f"{__name__}.base"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def names() -> list[str]:
    """All registered estimators."""
    return list(_REGISTRY)


def label(name: str) -> str:
    """What people read for the name of an estimator."""
    return _REGISTRY[name].label


def summary(name: str) -> str:
    """What an estimator is, in one sentence without its full stop."""
    return _REGISTRY[name].summary


def kind(name: str) -> type[Estimator]:
    """The class of that name, which says what it needs without loading weights; ValueError for an unknown name."""
    if name not in _REGISTRY:
        raise ValueError(f"there is no estimator {name!r}; choose one of {', '.join(names())}")
    row = _REGISTRY[name]
    found: type[Estimator] = getattr(importlib.import_module(f"{__name__}.{row.module}"), row.class_name)
    return found


def load(name: str, n_anchors: int = 1280, target: Target = "ldr") -> Estimator:
    """The estimator of that name, for clouds of `n_anchors`; ValueError for an unknown name or illegal other values."""
    return kind(name)(n_anchors, target)
