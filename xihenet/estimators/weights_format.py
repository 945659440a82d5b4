"""The format of weights: how are those of a network kept, and how is a wrong file told from a right one?

One .npz: named float16 or float32 arrays and a JSON header (format version, estimator, architecture, target, data,
seed, figures, points). One reader and one writer serve all networks; what their sizes mean stands with each of them.
Sizes are in the header, so the shape of every array is known, and whatever does not fit is refused with the file's
name: a silent wrong light is worse than none. Rejected: torch's own format, which needs torch and runs code when it is
read.
"""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from xihenet.estimators import is_outside, kind
from xihenet.estimators.base import Estimator, Target
from xihenet.io.json_files import parse_json
from xihenet.io.npz_files import read_npz
from xihenet.io.whole_files import written_whole
from xihenet.records import ArrayF32

FORMAT_VERSION = 1
WEIGHTS_FOLDER = Path(__file__).resolve().parents[1] / "weights"
"""Where the shipped ones lie, as `<estimator>_<target>.npz`."""

IN_HEADER = ("estimator", "architecture", "target", "data", "seed", "figures", "n_points")


class Architecture(Protocol):
    """Sizes of a network: a dataclass of plain values from which the shape of every array follows."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def array_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each array of a weights file, by name."""


AnyArchitecture = TypeVar("AnyArchitecture", bound=Architecture)


@dataclass(frozen=True, eq=False)
class NetworkWeights(Generic[AnyArchitecture]):
    """Everything a weights file holds."""

    architecture: AnyArchitecture
    target: Target  # what the network was trained to give
    arrays: Mapping[str, ArrayF32]  # float32, named and shaped as `architecture.array_shapes` says
    data: str = ""  # what it was trained on; this and the next two are for people to read
    seed: int = 0
    figures: Mapping[str, Any] = field(default_factory=dict)  # what it reached
    estimator: str = "lattice"  # name of the one that it was trained for
    n_points: int | None = None  # anchors or points of the clouds it was trained with, or None where that is not known

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
    header = {"format": FORMAT_VERSION, **{name: getattr(weights, name) for name in IN_HEADER}}
    header["architecture"] = asdict(weights.architecture)
    content: dict[str, Any] = {"header": np.array(json.dumps(header))}
    for name, array in weights.arrays.items():
        if is_half and np.abs(array).max(initial=0) > np.finfo(np.float16).max:
            raise ValueError(f"{path}: {name} does not fit into float16")
        content[name] = array.astype(np.float16) if is_half else array
    with written_whole(path) as beside, beside.open("wb") as file:
        np.savez(file, **content)


def read_weights(
    path: Path, estimator: str, architecture_from: Callable[[dict[str, Any]], AnyArchitecture]
) -> NetworkWeights[AnyArchitecture]:
    """Read and check what `save_weights` wrote for `estimator`; `architecture_from` takes the header's sizes.

    ValueError naming the file and what was expected, also if it is missing.
    """
    try:
        stored = read_npz(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: expected an .npz of {estimator} weights ({error})") from None
    try:
        header = _header_from(stored, estimator)
        architecture = architecture_from(dict(header["architecture"]))
        return _weights_from(stored, header, architecture)
    except (OSError, ValueError, TypeError, KeyError, OverflowError) as error:
        raise ValueError(f"{path}: not the {estimator} weights this version reads: {error}") from None


def shipped_weights(name: str, target: Target) -> Path:
    """The weights file of an estimator, which may have none.

    Of a network that is shipped for clipped light alone, that: as of `projection`, both targets give the same light.
    """
    own = WEIGHTS_FOLDER / f"{name}_{target}.npz"
    return own if own.exists() else WEIGHTS_FOLDER / f"{name}_ldr.npz"


def weights_sha256(names: Iterable[str], target: Target) -> dict[str, str]:
    """By estimator, the digest of its weights file; those without weights are left out.

    Of one that another package brought, the file that its class is in: what else it reads is not known.
    """
    files = {
        name: Path(inspect.getfile(kind(name))) if is_outside(name) else shipped_weights(name, target) for name in names
    }
    return {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in files.items() if file.exists()}


def loaded_for(
    estimator: Estimator, path: Path | None, load: Callable[[Path], NetworkWeights[AnyArchitecture]]
) -> NetworkWeights[AnyArchitecture]:
    """The weights that `load` reads, of the shipped file without a path; ValueError for those of another target."""
    if path is None:
        return load(shipped_weights(estimator.name, estimator.target))
    loaded = load(path)
    if loaded.target != estimator.target:
        raise ValueError(f"{path}: expected weights for the target {estimator.target!r}, got {loaded.target!r}")
    return loaded


def _weights_from(
    content: dict[str, NDArray[Any]], header: dict[str, Any], architecture: AnyArchitecture
) -> NetworkWeights[AnyArchitecture]:
    stored = {name: array for name, array in content.items() if name != "header"}
    for name, array in stored.items():
        if array.dtype not in (np.float16, np.float32):
            raise ValueError(f"{name}: expected float16 or float32, got {array.dtype}")
    arrays = {name: np.asarray(array, np.float32) for name, array in stored.items()}
    notes = {name: header[name] for name in ("data", "seed", "figures", "estimator", "n_points") if name in header}
    if not isinstance(notes.get("figures", {}), dict):
        raise ValueError(f"figures: expected a JSON object, got {notes['figures']!r:.80}")
    return NetworkWeights(architecture, header["target"], arrays, **notes)


def _header_from(content: dict[str, NDArray[Any]], estimator: str) -> dict[str, Any]:
    if "header" not in content or content["header"].dtype.kind != "U":
        raise ValueError("expected a header in JSON, got none")
    header = parse_json(content["header"].item())
    found = header.get("format") if isinstance(header, dict) else header
    if not isinstance(header, dict) or found != FORMAT_VERSION:
        raise ValueError(f"expected format {FORMAT_VERSION}, got {found!r:.80}")
    if header.get("estimator", "lattice") != estimator:
        raise ValueError(f"expected weights of {estimator!r}, got {header['estimator']!r:.80}")
    return header
