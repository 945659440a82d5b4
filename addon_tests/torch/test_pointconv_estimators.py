"""The PointConv network beside its plain form, and the estimators that run it from a file of weights."""

import numpy as np
import pytest
import torch

from addon_tests.pure.cloud_batches import NASTY, nasty_clouds, random_clouds
from addon_tests.pure.test_pointconv import light_of, raw_points
from xihenet.estimators.pointconv import PointAR, XiheNet
from xihenet.estimators.pointconv_network import PointConvArchitecture, load_pointconv_weights
from xihenet.estimators.weights_format import save_weights
from xihenet.nets.pointconv import PointConvNet
from xihenet.records import UnitSphereCloud
from xihenet.sphere import AnchorLattice
from xihenet.training.networks import TrainedNetwork, export_network, save_network, weights_of

N = 256
SMALL = {"centroids": (32, 8), "n_neighbours": 8}
ESTIMATORS = {"xihenet": XiheNet, "pointar": PointAR}


def fresh_net(seed=0, **options):
    torch.manual_seed(seed)
    return PointConvNet(PointConvArchitecture(**{**SMALL, **options}))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Exported fresh networks by estimator, and the networks."""
    folder = tmp_path_factory.mktemp("weights")
    made = {}
    for name in ESTIMATORS:
        net = fresh_net().eval()
        save_network(folder / f"{name}.pt", TrainedNetwork(name, "ldr", 4, net))
        path = folder / f"{name}.npz"
        export_network(folder / f"{name}.pt", path, data="none", figures={"rmse": 1.0}, n_points=N, is_half=False)
        made[name] = path, net
    return made


def as_points(srgb, distance_m, is_set):
    directions = AnchorLattice(is_set.shape[1]).directions.astype(np.float32)
    points = directions * np.minimum(distance_m, np.float32(65504))[..., None]
    return tuple(torch.from_numpy(part) for part in (points, srgb, is_set))


# The network as the paper's formulas have it, cloud by cloud and layer by layer, with the same parameters.


def plain_farthest(places, n):
    chosen = [int(places.square().sum(1).argmax())]
    while len(chosen) < n:
        remaining = torch.stack([(places - places[i]).square().sum(1) for i in chosen]).amin(0)
        if remaining.max() == 0:
            break
        chosen.append(int(remaining.argmax()))
    return chosen


def plain_block(block, points_m, features):
    places = points_m / points_m.norm(dim=1).mean().clamp(min=1e-3)
    squared = (places[:, None] - places[None]).square().sum(2)
    inverse_density = 1 / torch.exp(-squared / (2 * block.bandwidth**2)).sum(1)
    inverse_density = inverse_density / inverse_density.max()
    centroids = plain_farthest(places, block.n_centroids)
    out = []
    for centroid in centroids:
        near = squared[centroid].argsort(stable=True)[: block.n_neighbours]
        relative = places[near] - places[centroid]
        per_point = block.per_point(torch.cat([relative, features[near]], 1))
        per_point = per_point * block.density(inverse_density[near, None])
        mixed = per_point.T @ block.weights(relative) / block.n_neighbours
        out.append(block.combine(mixed.flatten()))
    return points_m[centroids], torch.stack(out)


def plain_network(net, points_m, srgb, is_set):
    lights = []
    for points, colours, known in zip(points_m, srgb, is_set, strict=True):
        if net.architecture.keeps_unset_at_origin:
            points, colours = points * known[:, None], colours * known[:, None]
        else:
            points, colours = points[known], colours[known]
        summary = torch.zeros(512)
        if len(points):
            places, features = plain_block(net.block_1, points, colours)
            _, features = plain_block(net.block_2, places, features)
            summary = torch.cat([features.mean(0), features.amax(0)])
        lights.append(net.head(summary).reshape(9, 3))
    return torch.stack(lights)


def gradients(net, light):
    weight = torch.randn(light.shape, generator=torch.Generator().manual_seed(0))
    net.zero_grad(set_to_none=True)
    (light * weight).sum().backward()
    return torch.cat([parameter.grad.flatten() for parameter in net.parameters()])


@pytest.mark.parametrize("options", [{}, {"centroids": (48, 12), "n_neighbours": 32}, {"keeps_unset_at_origin": True}])
def test_the_fast_form_gives_what_the_plain_form_gives(options):
    net = fresh_net(**options)
    # Without those with many points at one place or at one distance: which of them comes first is nobody's matter.
    for parts in (random_clouds(N), nasty_clouds(N, NASTY)):
        parts = as_points(*parts)
        with torch.no_grad():
            np.testing.assert_allclose(net(*parts).numpy(), plain_network(net, *parts).numpy(), atol=1e-5)


def test_the_fast_form_has_the_gradients_of_the_plain_form():
    net, parts = fresh_net(), as_points(*random_clouds(N, 3))
    fast, plain = gradients(net, net(*parts)), gradients(net, plain_network(net, *parts))
    assert float((fast - plain).norm()) < 1e-5 * float(plain.norm())


def test_bfloat16_changes_training_a_little_and_estimates_not_at_all():
    parts = as_points(*random_clouds(N, 5))
    exact, halved = fresh_net(), fresh_net(is_bfloat16_in_training=True)
    a, b = gradients(exact, exact(*parts)), gradients(halved, halved(*parts))
    assert 1e-5 < float((a - b).norm() / a.norm()) < 0.1
    with torch.no_grad():
        assert torch.equal(exact.eval()(*parts), halved.eval()(*parts))
        assert torch.equal(exact(*parts), exact.train()(*parts))


def test_the_files_arrays_are_those_of_the_network():
    for net in (fresh_net(), fresh_net(n_weights=8), PointConvNet()):
        shapes = {name: tuple(value.shape) for name, value in net.state_dict().items()}
        assert shapes == net.architecture.array_shapes()


def test_the_estimator_gives_what_the_network_gives(files):
    path, net = files["xihenet"]
    estimator = XiheNet(N, weights=path)
    for parts in (random_clouds(N, n_clouds=20), nasty_clouds(N, NASTY)):
        batch = estimator.estimate_batch(*parts)
        with torch.no_grad():
            np.testing.assert_allclose(batch, net(*as_points(*parts)).numpy(), atol=1e-5)
        for light, *one in zip(batch, *parts, strict=True):
            np.testing.assert_allclose(estimator.estimate(UnitSphereCloud(*one)), light, atol=1e-5)


def test_pointar_draws_as_many_points_as_it_was_trained_with(files):
    path, net = files["pointar"]
    few = raw_points(N)
    with torch.no_grad():
        position = np.array([0.5, 0.0, 1.0], np.float32)
        points = torch.from_numpy(few.points_m - position)[None]
        expected = net(points, torch.tensor(few.srgb)[None], torch.ones(1, N) > 0)[0]
    np.testing.assert_allclose(light_of(PointAR(1280, weights=path), few), expected.numpy(), atol=1e-5)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_exported_file_holds_the_network_and_where_it_comes_from(files, name):
    path, net = files[name]
    weights = load_pointconv_weights(path, name)
    assert (weights.architecture, weights.estimator, weights.seed) == (net.architecture, name, 4)
    assert (weights.data, weights.figures, weights.n_points) == ("none", {"rmse": 1.0}, N)
    for key, value in net.state_dict().items():
        np.testing.assert_array_equal(weights.arrays[key], value.numpy())


def test_the_papers_network_fits_into_four_megabytes_and_half_precision_changes_little(tmp_path):
    torch.manual_seed(1)
    net = PointConvNet().eval()
    save_weights(tmp_path / "half.npz", weights_of(net, "hdr", estimator="xihenet"), is_half=True)
    parts = random_clouds(N, n_clouds=2)
    with torch.no_grad():
        exact = net(*as_points(*parts)).numpy()
    half = XiheNet(N, "hdr", weights=tmp_path / "half.npz").estimate_batch(*parts)
    assert 1e-7 < np.abs(half - exact).max() < 5e-3
    assert (tmp_path / "half.npz").stat().st_size < 4e6
