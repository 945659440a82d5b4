"""The torch path for batches gives what NumPy gives."""

import numpy as np
import pytest

from xihenet.estimators.lattice import Lattice
from xihenet.estimators.lattice_format import LatticeArchitecture, LatticeWeights
from xihenet.estimators.weights_format import save_weights
from xihenet.nets import batch
from xihenet.nets.batch import estimate_batch_torch


def random_weights(seed):
    rng = np.random.default_rng(seed)
    shapes = LatticeArchitecture().array_shapes()
    arrays = {name: (rng.normal(size=s) / np.sqrt(s[-1])).astype(np.float32) for name, s in shapes.items()}
    return LatticeWeights(LatticeArchitecture(), "ldr", arrays)


def clouds(n, seed):
    """None set, one set, clipped, black, far and near beyond measure, and six random ones."""
    rng = np.random.default_rng(seed)
    is_set, srgb, distance_m = (
        rng.random((12, n)) < rng.random((12, 1)),
        rng.random((12, n, 3)),
        rng.random((12, n)) * 6,
    )
    is_set[0], is_set[1], is_set[2:6] = False, np.arange(n) == 5, True
    srgb[2], srgb[3], distance_m[4], distance_m[5] = 1, 0, 3e38, 0
    return srgb.astype(np.float32), distance_m.astype(np.float32), is_set


@pytest.mark.parametrize("n", [512, 1280])
def test_torch_gives_what_numpy_gives_in_chunks_too(tmp_path, monkeypatch, n):
    weights = random_weights(n)
    save_weights(tmp_path / "w.npz", weights)
    parts, facing = clouds(n, 1), np.random.default_rng(0).uniform(-1, 1, (12, n))
    expected = Lattice(n, weights=tmp_path / "w.npz").estimate_batch(*parts, facing=facing)
    for at_once in (5, 256):
        monkeypatch.setattr(batch, "CLOUDS_AT_ONCE", at_once)
        np.testing.assert_allclose(estimate_batch_torch(weights, *parts, facing=facing), expected, atol=1e-5)


def test_no_clouds_are_legal_and_wrong_shapes_are_not():
    srgb, distance_m, is_set = clouds(512, 2)
    assert estimate_batch_torch(random_weights(0), srgb[:0], distance_m[:0], is_set[:0]).shape == (0, 9, 3)
    with pytest.raises(ValueError, match=r"expected \(B, N, 3\)"):
        estimate_batch_torch(random_weights(0), srgb, distance_m[:2], is_set)
