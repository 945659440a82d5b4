"""How are the weights of the lattice network kept, and how is a wrong file told from a right one?

One .npz: named float16 or float32 arrays and a JSON header (format version, architecture, target, data, seed,
figures). Sizes are in the header, so the shape of every array is known before it is read, and whatever does not fit is
refused with the file's name: a silent wrong light is worse than none. Rejected: torch's own format, which needs torch
and runs code when it is read.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.estimators.base import Target
from xihenet.records import ArrayF32

FORMAT_VERSION = 1
N_ANCHOR_FEATURES = 14  # relative and encoded colour, clipped or not, log distance, direction, projection there
N_LEVEL_FEATURES = 7  # share set, direction, projection there
N_GLOBAL_FEATURES = 29  # projection's 27 coefficients, coverage, log of the mean
N_ERROR_HIDDEN = 32


@dataclass(frozen=True)
class LatticeArchitecture:
    """Sizes of the network; the defaults make 265,061 parameters.

    Parameters
    ----------
    levels : anchors of the three coarser lattices; radiance is predicted in the directions of the second
    stem, fine, middle, coarse : features per anchor of the input and of the three levels
    narrow : features of each of the coarsest anchors that go into the dense layers, which know their places
    hidden, code : sizes of the dense layers
    spread : features that the code gives to each direction of the output, each by weights of its own
    decoder : features per direction before the radiance
    is_exposure_normalised : colours are taken relative to the mean of the set anchors and the light scaled back
    """

    levels: tuple[int, int, int] = (320, 80, 20)
    stem: int = 16
    fine: int = 32
    middle: int = 64
    coarse: int = 64
    narrow: int = 24
    hidden: int = 256
    code: int = 128
    spread: int = 8
    decoder: int = 48
    is_exposure_normalised: bool = True

    def __post_init__(self) -> None:
        sizes = [*self.levels, *(v for k, v in asdict(self).items() if k not in ("levels", "is_exposure_normalised"))]
        if len(self.levels) != 3 or any(type(size) is not int or not 1 <= size <= 65_536 for size in sizes):
            raise ValueError(f"architecture: expected three levels and sizes of 1 to 65536, got {asdict(self)}")
        if type(self.is_exposure_normalised) is not bool:
            raise ValueError(
                f"architecture: is_exposure_normalised is true or false, not {self.is_exposure_normalised}"
            )

    def layer_sizes(self) -> dict[str, tuple[int, int]]:
        """Inputs and outputs of each layer, by name."""
        return {
            "stem": (N_ANCHOR_FEATURES, self.stem),
            "fine": (self.stem + N_LEVEL_FEATURES, self.fine),
            "middle": (self.fine + N_LEVEL_FEATURES, self.middle),
            "coarse": (self.middle + N_LEVEL_FEATURES, self.coarse),
            "narrow": (self.coarse, self.narrow),
            "dense": (self.levels[2] * self.narrow + N_GLOBAL_FEATURES, self.hidden),
            "code": (self.hidden, self.code),
            "spread": (self.code, self.levels[1] * self.spread),
            "decoder": (self.middle + self.spread + N_LEVEL_FEATURES, self.decoder),
            "radiance": (self.decoder, 3),
            "gate": (self.code, 9),
            "error_hidden": (self.code, N_ERROR_HIDDEN),
            "error": (N_ERROR_HIDDEN, 1),
        }

    def array_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each array of a weights file: `<layer>.weight` (outputs, inputs) and `<layer>.bias` (outputs,)."""
        shapes: dict[str, tuple[int, ...]] = {}
        for name, (n_in, n_out) in self.layer_sizes().items():
            shapes[f"{name}.weight"], shapes[f"{name}.bias"] = (n_out, n_in), (n_out,)
        return shapes

    def n_parameters(self) -> int:
        """Weights and biases together."""
        return sum((n_in + 1) * n_out for n_in, n_out in self.layer_sizes().values())


@dataclass(frozen=True, eq=False)
class LatticeWeights:
    """Everything a weights file holds.

    Parameters
    ----------
    architecture : sizes
    target : "ldr" or "hdr", the light the network was trained to give
    arrays : float32, named and shaped as `LatticeArchitecture.array_shapes` says
    data, seed, figures : what it was trained on, from which seed, and what it reached; for people to read
    """

    architecture: LatticeArchitecture
    target: Target
    arrays: Mapping[str, ArrayF32]
    data: str = ""
    seed: int = 0
    figures: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.target not in ("ldr", "hdr"):
            raise ValueError(f"target: expected 'ldr' or 'hdr', got {self.target!r}")
        shapes = self.architecture.array_shapes()
        if set(self.arrays) != set(shapes):
            raise ValueError(f"arrays: expected {sorted(shapes)}, got {sorted(self.arrays)}")
        for name, shape in shapes.items():
            array = self.arrays[name]
            if array.shape != shape or array.dtype != np.float32:
                raise ValueError(f"{name}: expected float32 of shape {shape}, got {array.dtype} of {array.shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"{name}: expected finite weights, got NaN or infinity")


def save_weights(path: Path, weights: LatticeWeights, *, is_half: bool = False) -> None:
    """Write `weights` whole or not at all; as float16 if `is_half`. ValueError for what float16 cannot hold."""
    header = {
        "format": FORMAT_VERSION,
        "architecture": asdict(weights.architecture),
        "target": weights.target,
        "data": weights.data,
        "seed": weights.seed,
        "figures": dict(weights.figures),
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


def load_weights(path: Path) -> LatticeWeights:
    """Read and check what `save_weights` wrote. ValueError naming the file and what was expected, also if missing."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            content = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise ValueError(f"{path}: expected an .npz of lattice weights ({error})") from None
    try:
        return _weights_from(content)
    except (ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{path}: not the lattice weights this version reads: {error}") from None


def _weights_from(content: dict[str, NDArray[Any]]) -> LatticeWeights:
    if "header" not in content or content["header"].dtype.kind != "U":
        raise ValueError("expected a header in JSON, got none")
    header = json.loads(content.pop("header").item())
    found = header.get("format") if isinstance(header, dict) else header
    if not isinstance(header, dict) or found != FORMAT_VERSION:
        raise ValueError(f"expected format {FORMAT_VERSION}, got {found!r}")
    sizes = dict(header["architecture"])
    sizes["levels"] = tuple(sizes["levels"])
    for name, array in content.items():
        if array.dtype not in (np.float16, np.float32):
            raise ValueError(f"{name}: expected float16 or float32, got {array.dtype}")
    arrays = {name: np.asarray(array, np.float32) for name, array in content.items()}
    return LatticeWeights(LatticeArchitecture(**sizes), header["target"], arrays, header.get("data", ""),
                          header.get("seed", 0), header.get("figures", {}))  # fmt: skip
