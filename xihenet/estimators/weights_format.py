"""How are the weights of a network kept, and how is a wrong file told from a right one?

One .npz: named float16 or float32 arrays and a JSON header (format version, estimator, architecture, target, data,
seed, figures, points). One reader and one writer serve all networks; what their sizes mean stands with each of them.
Sizes are in the header, so the shape of every array is known before it is read, and whatever does not fit is refused
with the file's name: a silent wrong light is worse than none. Rejected: torch's own format, which needs torch and runs
code when it is read.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from xihenet.estimators.base import Target
from xihenet.npz_files import read_npz
from xihenet.records import ArrayF32

FORMAT_VERSION = 1
WEIGHTS_FOLDER = Path(__file__).resolve().parents[1] / "weights"
"""Where the shipped ones lie, as `<estimator>_<target>.npz`."""


class Architecture(Protocol):
    """Sizes of a network: a dataclass of plain values from which the shape of every array follows."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def array_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each array of a weights file, by name."""


AnyArchitecture = TypeVar("AnyArchitecture", bound=Architecture)


@dataclass(frozen=True, eq=False)
class NetworkWeights(Generic[AnyArchitecture]):
    """Everything a weights file holds.

    Parameters
    ----------
    architecture : sizes
    target : "ldr" or "hdr", the light the network was trained to give
    arrays : float32, named and shaped as `architecture.array_shapes` says
    data, seed, figures : what it was trained on, from which seed, and what it reached; for people to read
    estimator : name of the estimator it was trained for
    n_points : anchors or points of the clouds it was trained with, or None where that is not known
    """

    architecture: AnyArchitecture
    target: Target
    arrays: Mapping[str, ArrayF32]
    data: str = ""
    seed: int = 0
    figures: Mapping[str, Any] = field(default_factory=dict)
    estimator: str = "lattice"
    n_points: int | None = None

    def __post_init__(self) -> None:
        if self.target not in ("ldr", "hdr"):
            raise ValueError(f"target: expected 'ldr' or 'hdr', got {self.target!r}")
        if self.n_points is not None and (type(self.n_points) is not int or self.n_points < 1):
            raise ValueError(f"n_points: expected a positive number or none, got {self.n_points!r}")
        shapes = self.architecture.array_shapes()
        if set(self.arrays) != set(shapes):
            raise ValueError(f"arrays: expected {sorted(shapes)}, got {sorted(self.arrays)}")
        for name, shape in shapes.items():
            array = self.arrays[name]
            if array.shape != shape or array.dtype != np.float32:
                raise ValueError(f"{name}: expected float32 of shape {shape}, got {array.dtype} of {array.shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"{name}: expected finite weights, got NaN or infinity")


def save_weights(path: Path, weights: NetworkWeights[Any], *, is_half: bool = False) -> None:
    """Write `weights` whole or not at all; as float16 if `is_half`. ValueError for what float16 cannot hold."""
    header = {
        "format": FORMAT_VERSION,
        "estimator": weights.estimator,
        "architecture": asdict(weights.architecture),
        "target": weights.target,
        "data": weights.data,
        "seed": weights.seed,
        "figures": dict(weights.figures),
        "n_points": weights.n_points,
    }
    content: dict[str, Any] = {"header": np.array(json.dumps(header))}
    for name, array in weights.arrays.items():
        if is_half and np.abs(array).max(initial=0) > np.finfo(np.float16).max:
            raise ValueError(f"{path}: {name} does not fit into float16")
        content[name] = array.astype(np.float16) if is_half else array
    stored = io.BytesIO()
    np.savez(stored, **content)
    beside = path.with_name(f".{path.name}.part")
    beside.write_bytes(stored.getvalue())
    beside.replace(path)


def read_weights(
    path: Path, estimator: str, architecture_from: Callable[[dict[str, Any]], AnyArchitecture]
) -> NetworkWeights[AnyArchitecture]:
    """Read and check what `save_weights` wrote for `estimator`; `architecture_from` takes the header's sizes.

    ValueError naming the file and what was expected, also if it is missing.
    """
    try:
        content = read_npz(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: expected an .npz of {estimator} weights ({error})") from None
    try:
        return _weights_from(content, estimator, architecture_from)
    except (ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{path}: not the {estimator} weights this version reads: {error}") from None


def _weights_from(
    content: dict[str, NDArray[Any]], estimator: str, architecture_from: Callable[[dict[str, Any]], AnyArchitecture]
) -> NetworkWeights[AnyArchitecture]:
    header = _header_from(content)
    if header.get("estimator", "lattice") != estimator:
        raise ValueError(f"expected weights of {estimator!r}, got {header['estimator']!r}")
    for name, array in content.items():
        if array.dtype not in (np.float16, np.float32):
            raise ValueError(f"{name}: expected float16 or float32, got {array.dtype}")
    return NetworkWeights(
        architecture_from(dict(header["architecture"])),
        header["target"],
        {name: np.asarray(array, np.float32) for name, array in content.items()},
        header.get("data", ""),
        header.get("seed", 0),
        header.get("figures", {}),
        estimator,
        header.get("n_points"),
    )


def _header_from(content: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """The header, taken out of `content`."""
    if "header" not in content or content["header"].dtype.kind != "U":
        raise ValueError("expected a header in JSON, got none")
    header = json.loads(content.pop("header").item())
    found = header.get("format") if isinstance(header, dict) else header
    if not isinstance(header, dict) or found != FORMAT_VERSION:
        raise ValueError(f"expected format {FORMAT_VERSION}, got {found!r}")
    return header
