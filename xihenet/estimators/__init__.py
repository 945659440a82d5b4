"""The estimators: which are there, and how do I get one?

The registry is a table of names, where each lives, and what panel and report say of it. A module is imported when it
is asked for, so that the report, which knows no NumPy, can read the table. A new estimator is one file and one row.
Those that other packages offer by entry points have rows as well (docs/python.md).
"""

from __future__ import annotations

import functools
import importlib
import inspect
from importlib import metadata
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from xihenet.estimators.base import EstimateContext, Estimator, Target

__all__ = [
    "DEFAULT", "EstimateContext", "Estimator", "Target", "is_outside", "kind", "label", "load", "names",
    "packages", "summary",
]  # fmt: skip


class _Row(NamedTuple):
    module: str  # after a dot, of this package
    class_name: str
    label: str
    summary: str


_OURS = {
    "ambient": _Row(
        ".ambient",
        "Ambient",
        "Ambient",
        "Average brightness and colour, the same from all directions, as a phone's light sensor reports",
    ),
    "projection": _Row(
        ".projection",
        "Projection",
        "Projection",
        "Least-squares fit to the surroundings seen so far; no learning",
    ),
    "pointar": _Row(".pointconv", "PointAR", "PointAR", "Neural network on randomly chosen points"),
    "xihenet": _Row(".pointconv", "XiheNet", "XiheNet", "The paper's neural network on unit-sphere samples"),
    "lattice": _Row(".lattice", "Lattice", "Lattice", "Neural network on fixed directions; takes about a millisecond"),
    "truth": _Row(
        ".truth",
        "Truth",
        "Reference Light",
        "No estimate: the true light rendered at each object, the best that can be reached",
    ),
}
DEFAULT = "lattice"
IN_EVERY_RUN = ("ambient", "truth")
"""Those that every run compares with its own: what a phone knows today, and the best that order 2 can do."""

OUTSIDE = "xihe.estimators"
"""Group of the entry points by which other packages offer theirs."""


def __getattr__(name: str) -> Any:
    """What is offered here of `base`, which needs NumPy."""
    if name in ("EstimateContext", "Estimator", "Target"):
        return getattr(importlib.import_module(f"{__name__}.base"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


@functools.cache
def _outside() -> dict[str, metadata.EntryPoint]:
    """What other packages offer, by name; none takes a name of ours."""
    return {one.name: one for one in metadata.entry_points(group=OUTSIDE) if one.name not in _OURS}


def _registry() -> dict[str, _Row]:
    """Our rows, then those of other packages, whose description stands for a summary."""
    rows = dict(_OURS)
    for name, one in _outside().items():
        words = (one.dist and one.dist.metadata["Summary"]) or f"Estimator of {one.module}"
        rows[name] = _Row(one.module, one.attr, name, words.rstrip("."))
    return rows


def packages() -> dict[str, str]:
    """Versions of the other packages that offer estimators, by their names."""
    return {one.dist.name: one.dist.version for one in _outside().values() if one.dist is not None}


def is_outside(name: str) -> bool:
    """Whether another package brought the estimator."""
    return name not in _OURS


def names() -> list[str]:
    """All registered estimators, ours first."""
    return list(_registry())


def label(name: str) -> str:
    """What people read for the name of an estimator."""
    return _registry()[name].label


def summary(name: str) -> str:
    """What an estimator is, in one sentence without its full stop."""
    return _registry()[name].summary


def kind(name: str) -> type[Estimator]:
    """The class of that name, which says what it needs without loading weights.

    ValueError for an unknown name; ImportError for one of another package that has no such class of that name.
    """
    if name not in _registry():
        raise ValueError(f"there is no estimator {name!r}; choose one of {', '.join(names())}")
    row = _registry()[name]
    try:
        found: type[Estimator] = getattr(importlib.import_module(row.module, __name__), row.class_name)
    except (ImportError, AttributeError) as error:
        raise ImportError(f"{row.module} does not offer {row.class_name} ({error}): mend or uninstall it") from error
    from xihenet.estimators.base import Estimator

    if not (isinstance(found, type) and issubclass(found, Estimator)):
        raise ImportError(f"{row.module}: {row.class_name} is no subclass of xihenet.estimators.Estimator")
    if (own := getattr(found, "name", None)) != name:
        raise ImportError(f"{row.module}: the name of {row.class_name} is {own!r}, and {name!r} is expected")
    if is_outside(name):
        try:
            inspect.signature(found).bind(1280, "ldr")
        except TypeError as error:
            raise ImportError(f"{row.module}: {row.class_name} is made of n_anchors and target ({error})") from error
    return found


def load(name: str, n_anchors: int = 1280, target: Target = "ldr") -> Estimator:
    """The estimator of that name, for clouds of `n_anchors`; ValueError for an unknown name or illegal other values."""
    return kind(name)(n_anchors, target)
