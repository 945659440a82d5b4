"""Networks by the estimator's name: made, fed, kept between training and report, and exported as estimators read them.

A trained network is one file: the estimator's name, its target, the architecture and the weights. It is read with
torch's restricted reader, which runs no code.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from xihenet.codec import facing_of_codes
from xihenet.estimators.base import Target
from xihenet.estimators.lattice_format import LatticeArchitecture, load_weights
from xihenet.estimators.pointconv_network import PointConvArchitecture, load_pointconv_weights
from xihenet.estimators.weights_format import NetworkWeights, save_weights
from xihenet.io.whole_files import written_whole
from xihenet.nets.lattice import LatticeNet
from xihenet.nets.pointconv import PointConvNet
from xihenet.records import ArrayInt
from xihenet.training.dataset import CloudSet, Sampling


class Kind(NamedTuple):
    """A network that can be trained: which clouds it is fed, how it is made, and how its .npz is read."""

    sampling: Sampling
    architecture: Callable[..., Any]  # a dataclass of sizes
    net: Callable[[Any], nn.Module]
    load: Callable[[Path], NetworkWeights[Any]]


def _point_conv(name: str, sampling: Sampling) -> Kind:
    return Kind(sampling, PointConvArchitecture, PointConvNet, partial(load_pointconv_weights, estimator=name))


KINDS = {
    "lattice": Kind("sphere", LatticeArchitecture, LatticeNet, load_weights),
    "xihenet": _point_conv("xihenet", "sphere"),
    "pointar": _point_conv("pointar", "uniform"),
    "farthest": _point_conv("farthest", "farthest"),
}
"""By the estimator's name; `farthest` is none that is registered."""

_CLOUDS_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class Batch:
    """Clouds as tensors: srgb and points_m (B, N, 3), is_set and facing (B, N), truth (B, 9, 3)."""

    srgb: Tensor
    points_m: Tensor
    is_set: Tensor
    truth: Tensor
    facing: Tensor


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A network with what one has to know to use it."""

    estimator: str
    target: Target
    seed: int
    net: nn.Module


def make_network(estimator: str, **options: Any) -> nn.Module:
    """A fresh network; `options` go to its architecture. ValueError for an unknown estimator."""
    if estimator not in KINDS:
        raise ValueError(f"estimator: expected one of {', '.join(KINDS)}, got {estimator!r}")
    return KINDS[estimator].net(KINDS[estimator].architecture(**options))


def take_weights(net: nn.Module, estimator: str, path: Path, share: float = 1.0) -> None:
    """Give a network the weights in `path`, an .npz of the same estimator, or a `share` of them beside its own.

    ValueError if they are of another network.
    """
    stored = KINDS[estimator].load(path)
    own_sizes: Any = net.architecture
    if _sizes(stored.architecture) != _sizes(own_sizes):
        raise ValueError(f"{path}: expected weights of a network of the same kind and target")
    with torch.no_grad():
        for name, own in net.state_dict().items():
            own.lerp_(torch.from_numpy(stored.arrays[name]).to(own.device), share)


def sizes_in(path: Path, estimator: str) -> dict[str, object]:
    """Sizes of the network of `estimator` whose weights are in `path`, an .npz; ValueError where it is none."""
    return {
        name: size for name, size in _sizes(KINDS[estimator].load(path).architecture).items() if name != "opens_clipped"
    }


def _sizes(architecture: Any) -> dict[str, object]:
    """All of an architecture but in what precision it is trained."""
    return {name: size for name, size in asdict(architecture).items() if name != "is_bfloat16_in_training"}


def options_for(estimator: str, target: Target) -> dict[str, object]:
    """Options of the architecture that a target asks for."""
    return {"opens_clipped": True} if (estimator, target) == ("lattice", "hdr") else {}


def run_network(net: nn.Module, batch: Batch) -> tuple[Tensor, Tensor | None]:
    """(B, 9, 3) coefficients and, from networks that know it, the expected error (B,)."""
    if isinstance(net, LatticeNet):
        light, expected_error = net(batch.srgb, batch.points_m.norm(dim=2), batch.is_set, batch.facing)
        return light, expected_error
    return net(batch.points_m, batch.srgb, batch.is_set), None


def read_batch(clouds: CloudSet, rows: ArrayInt, target: Target, device: str) -> Batch:
    """The clouds of the given rows."""
    rows = np.sort(rows)  # in the order of the file
    arrays = [array[rows] for array in (clouds.srgb_u8, clouds.points_m, clouds.is_set, clouds.truth(target))]
    arrays.append(facing_of_codes(clouds.facing_i8[rows]))
    srgb, points_m, is_set, truth, facing = (torch.from_numpy(array).to(device) for array in arrays)
    return Batch(srgb.float() / 255, points_m.float(), is_set, truth, facing)


def predict(net: nn.Module, clouds: CloudSet, target: Target, device: str) -> tuple[Any, Any]:
    """(M, 9, 3) coefficients and (M,) expected errors or None, NumPy float32, of all clouds in their order."""
    net.eval()
    lights = [np.zeros((0, 9, 3), np.float32)]
    errors = [np.zeros(0, np.float32)] if isinstance(net, LatticeNet) else []
    with torch.no_grad():
        for start in range(0, len(clouds), _CLOUDS_AT_ONCE):
            rows = np.arange(start, min(start + _CLOUDS_AT_ONCE, len(clouds)))
            light, error = run_network(net, read_batch(clouds, rows, target, device))
            lights.append(light.cpu().numpy())
            if error is not None:
                errors.append(error.cpu().numpy())
    return np.concatenate(lights), np.concatenate(errors) if errors else None


def save_network(path: Path, trained: TrainedNetwork) -> None:
    """Write whole or not at all."""
    architecture: Any = trained.net.architecture
    known = {name: getattr(trained, name) for name in ("estimator", "target", "seed")}
    write_torch(path, {**known, "architecture": asdict(architecture), "weights": trained.net.state_dict()})


def load_network(path: Path, device: str = "cpu") -> TrainedNetwork:
    """Read what `save_network` wrote, or weights of `lattice` (.npz), to estimate with: in evaluation mode.

    ValueError naming the file if it is neither.
    """
    if path.suffix == ".npz":
        stored = load_weights(path)
        lattice = make_network("lattice", **asdict(stored.architecture)).to(device)
        lattice.load_state_dict({name: torch.from_numpy(array) for name, array in stored.arrays.items()})
        return TrainedNetwork("lattice", stored.target, stored.seed or 0, lattice.eval())
    content = read_torch(path, device)
    try:
        net = make_network(content["estimator"], **content["architecture"]).to(device)
        net.load_state_dict(content["weights"])
    except (KeyError, TypeError, RuntimeError) as error:
        raise ValueError(f"{path}: expected a trained network of this version ({error})") from None
    return TrainedNetwork(content["estimator"], content["target"], content["seed"], net.eval())


def write_torch(path: Path, content: Mapping[str, object]) -> None:
    """Write whole or not at all, in torch's format."""
    with written_whole(path) as beside, beside.open("wb") as file:  # Into a path, torch would write its name as well.
        torch.save(content, file)


def read_torch(path: Path, device: str) -> dict[str, Any]:
    """Read what `write_torch` wrote, plain values and tensors only; ValueError naming the file if it is broken."""
    try:
        content = torch.load(path, map_location=device, weights_only=True)
    except FileNotFoundError:
        raise ValueError(f"{path}: expected a file of training, found none") from None
    except (RuntimeError, EOFError, ValueError, KeyError, OSError, pickle.UnpicklingError) as error:
        raise ValueError(f"{path}: expected a file of training ({error})") from None
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected a file of training, got {type(content).__name__}")
    return content


def weights_of(net: Any, target: Target, **notes: Any) -> NetworkWeights[Any]:
    """What `save_weights` keeps of a torch network; `notes` are its estimator, data, seed, figures and n_points."""
    arrays = {name: value.detach().cpu().numpy().astype(np.float32) for name, value in net.state_dict().items()}
    return NetworkWeights(net.architecture, target, arrays, **notes)


def export_network(
    trained: Path, out: Path, *, data: str = "", figures: Mapping[str, Any] | None = None, n_points: int | None = None,
    is_half: bool = True,
) -> None:  # fmt: skip
    """Write the network in `trained` (.pt, or .npz of `lattice`) to `out` (.npz), in float16 unless `is_half` is False.

    `data` and `figures` are for people to read. `n_points` are the anchors or points of the clouds it was trained with:
    `pointar` draws as many. ValueError if the file is broken or float16 cannot hold the weights.
    """
    loaded = load_network(trained)
    if trained.suffix == ".npz":  # What it says of itself stays, but for what is given.
        stored = load_weights(trained)
        data, figures, n_points = data or stored.data, figures or stored.figures, n_points or stored.n_points
    notes = {"data": data, "seed": loaded.seed, "figures": figures or {}, "n_points": n_points}
    weights = weights_of(loaded.net, loaded.target, estimator=loaded.estimator, **notes)
    out.parent.mkdir(parents=True, exist_ok=True)
    save_weights(out, weights, is_half=is_half)
