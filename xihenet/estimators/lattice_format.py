"""What sizes does the lattice network have, and which arrays follow from them?"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from xihenet.estimators.weights_format import NetworkWeights, read_weights

N_ANCHOR_FEATURES = 14  # relative and encoded colour, clipped or not, log distance, projection there, direction
N_LEVEL_FEATURES = 7  # share set, direction, projection there
N_GLOBAL_FEATURES = 29  # projection's 27 coefficients, coverage, log of the mean
N_ERROR_HIDDEN = 32


@dataclass(frozen=True)
class LatticeArchitecture:
    """Sizes of the network; the defaults make 265,077 parameters.

    `levels` are anchors of the three coarser lattices; radiance is predicted in the directions of the second.
    """

    levels: tuple[int, int, int] = (320, 80, 20)
    stem: int = 16  # features per anchor of the input, and then of the three levels
    fine: int = 32
    middle: int = 64
    coarse: int = 64
    narrow: int = 24  # features of each of the coarsest anchors that go into the dense layers, which know their places
    hidden: int = 256  # of the first dense layer
    code: int = 128  # of the second
    spread: int = 8  # features that the code gives to each direction of the output, each by weights of its own
    decoder: int = 48  # features per direction before the radiance
    is_exposure_normalised: bool = True  # colours are relative to the mean of the set anchors, the light scaled back
    knows_facing: bool = True  # how surfaces face the position weighs the projection and is told to the network

    def __post_init__(self) -> None:
        switches = {"is_exposure_normalised": self.is_exposure_normalised, "knows_facing": self.knows_facing}
        sizes = [*self.levels, *(v for k, v in asdict(self).items() if k not in ("levels", *switches))]
        if len(self.levels) != 3 or any(type(size) is not int or not 1 <= size <= 65_536 for size in sizes):
            raise ValueError(f"architecture: expected three levels and sizes of 1 to 65536, got {asdict(self)}")
        for name, switch in switches.items():
            if type(switch) is not bool:
                raise ValueError(f"architecture: {name} is true or false, not {switch}")

    def layer_sizes(self) -> dict[str, tuple[int, int]]:
        """Inputs and outputs of each layer, by name."""
        return {
            "stem": (N_ANCHOR_FEATURES + self.knows_facing, self.stem),
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


LatticeWeights = NetworkWeights[LatticeArchitecture]


def load_weights(path: Path) -> LatticeWeights:
    """Read and check lattice weights. ValueError naming the file and what was expected, also if it is missing."""
    return read_weights(path, "lattice", _lattice_architecture)


def _lattice_architecture(sizes: dict[str, Any]) -> LatticeArchitecture:
    # Files of before 2026-11-23 do not say, and their networks know nothing of it.
    return LatticeArchitecture(**{"knows_facing": False, **sizes, "levels": tuple(sizes["levels"])})
