"""The networks in torch: equal to NumPy, also in batches, unmoved by what is not set, and able to learn."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from addon_tests.pure.cloud_batches import nasty_clouds, random_clouds
from xihenet.colour import srgb_to_linear
from xihenet.estimators.lattice import Lattice, given_light
from xihenet.estimators.lattice_format import load_weights
from xihenet.estimators.lattice_network import LatticeNetwork
from xihenet.estimators.pointconv_network import PointConvArchitecture
from xihenet.estimators.weights_format import save_weights
from xihenet.nets.lattice import LatticeNet
from xihenet.nets.pointconv import PointConvNet, farthest_points
from xihenet.training.networks import make_network, options_for, weights_of

SMALL = PointConvArchitecture(centroids=(32, 8), n_neighbours=8)


def lively_net(target="ldr"):
    """A network whose last layers do not start at 0."""
    torch.manual_seed(3)
    net = make_network("lattice", **options_for("lattice", target))
    for name in ("radiance", "gate"):
        torch.nn.init.normal_(net.layer(name).weight, 0, 0.3)
    return net


def clouds(n, seed=0):
    """Eight random ones, then nasty ones."""
    return [np.concatenate(parts) for parts in zip(random_clouds(n, seed, 8), nasty_clouds(n), strict=True)]


def points(n=64, n_clouds=5, seed=0):
    rng = torch.Generator().manual_seed(seed)
    is_set = torch.rand(n_clouds, n, generator=rng) < 0.6
    is_set[0] = False
    is_set[1] = torch.arange(n) == 4
    return torch.randn(n_clouds, n, 3, generator=rng), torch.rand(n_clouds, n, 3, generator=rng), is_set


@pytest.mark.parametrize(("n", "target"), [(512, "ldr"), (777, "hdr"), (1280, "ldr"), (1280, "hdr"), (2048, "ldr")])
def test_numpy_gives_what_torch_gives(tmp_path, n, target):
    net = lively_net(target).eval()
    save_weights(tmp_path / "w.npz", weights_of(net, target))
    parts = clouds(n, seed=n)
    estimator, lights = Lattice(n, target, weights=tmp_path / "w.npz"), []
    network = LatticeNetwork(load_weights(tmp_path / "w.npz"), n)
    for facing in (None, np.random.default_rng(n).uniform(-1, 1, parts[2].shape).astype(np.float32)):
        with torch.no_grad():
            given = (*parts, facing) if facing is not None else parts
            light, expected_error = net(*map(torch.from_numpy, given))
        in_numpy, error_in_numpy = estimator.estimate_batch(*parts, facing=facing), network.run(*parts, facing)[1]
        in_torch = light.numpy() if target == "ldr" else given_light(light.numpy(), parts[2].mean(axis=1), target)
        np.testing.assert_allclose(in_numpy, in_torch, atol=1e-5)
        np.testing.assert_allclose(error_in_numpy, expected_error.numpy(), atol=1e-5)
        lights.append(in_numpy)
    assert np.abs(lights[1] - lights[0]).max() > 1e-3


@pytest.mark.parametrize("coverage", [0.1, 0.4, 0.8])
@pytest.mark.parametrize(
    ("target", "where", "unit"), [("ldr", "unseen", 60), ("hdr", "unseen", 20), ("hdr", "lamps", 4)]
)
def test_lamps_and_guesses_count_by_their_logarithm_and_in_hdr_guesses_by_how_sure_they_are(
    coverage, target, where, unit
):
    """With lamps, here, nothing is guessed: a cloud without holes, and no gates. Without them all that is added is."""
    rng, has_lamps = np.random.default_rng(0), where == "lamps"
    known = np.arange(1280)[None] < (1280 if has_lamps else round(1280 * coverage))
    colours = rng.uniform(0, 0.9, (1, 1280, 3)).astype(np.float32) * known[..., None]
    colours[:, : round(1000 * coverage) if has_lamps else 0] = 1
    cloud = tuple(map(torch.from_numpy, (colours, rng.uniform(0.5, 3, (1, 1280)).astype(np.float32) * known, known)))
    net = lively_net(target)
    with torch.no_grad():
        net.layer("error").weight.zero_()
        net.layer("error").bias.fill_(5.0)  # so that what is added is not cut
        net.layer("radiance").weight.mul_(8)
        if has_lamps:
            net.layer("gate").weight.zero_()
            net.layer("gate").bias.zero_()
        projection = LatticeNet(net.architecture)(*cloud)[0]
        whole = net.train()(*cloud)[0]
        mean = srgb_to_linear(colours[0, known[0]].astype(float)).mean(axis=0)
        added, seen = (np.asarray(light[0], float) / mean for light in (whole - projection, projection))
        size = np.sqrt(np.mean(added**2))
        net.layer("error").bias.fill_(float(np.log(np.expm1(4 * size))))
        said, expected_error = net.eval()(*cloud)
    in_numpy = LatticeNetwork(weights_of(net, target), 1280).run(*map(np.asarray, cloud))[0]
    np.testing.assert_allclose(in_numpy, said, rtol=1e-3, atol=2e-6)
    doubt = 0.3 * float(expected_error[0]) / mean.mean() / size
    share = 1 / (1 + doubt**4) if target == "hdr" and not has_lamps else 1.0
    unit *= np.sqrt(np.mean(seen**2)) * (1.0 if has_lamps else (1 - known.mean()) ** 2)
    excess = share * size / unit
    expected = added * mean * share * np.log1p(excess) / excess
    np.testing.assert_allclose((said - projection)[0, 1:], expected[1:], rtol=1e-3, atol=2e-6)
    assert excess > 0.002


def test_every_layer_can_learn_and_gradients_are_finite_on_nasty_clouds():
    net = lively_net()
    light, expected_error = net(*map(torch.from_numpy, clouds(512)))
    (light.square().sum() + expected_error.sum()).backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None and torch.isfinite(parameter.grad).all() and parameter.grad.any(), name


def test_the_expected_error_sends_no_gradient_into_the_light():
    net = lively_net()
    net(*map(torch.from_numpy, clouds(512)))[1].sum().backward()
    reached = {name for name, parameter in net.named_parameters() if parameter.grad is not None}
    assert reached == {"error.weight", "error.bias", "error_hidden.weight", "error_hidden.bias"}


@pytest.mark.parametrize("target", ["ldr", "hdr"])
@pytest.mark.parametrize("off", [("error",), ("error", "gate")])
def test_gradients_of_every_layer_that_makes_the_light_are_those_of_small_steps(target, off):
    """Also where all that the sphere's code says goes into radiance, beside which the gates weigh most."""
    net, cloud = lively_net(target), [torch.from_numpy(part[:2]) for part in clouds(512)]
    with torch.no_grad():
        for name in off:
            net.layer(name).weight.zero_()
        net.layer("error").bias.fill_(5.0)  # so that what is added is not cut
    towards = torch.randn(2, 9, 3)

    def along():
        return (net(*cloud)[0] * towards).sum()

    along().backward()
    for name in net.architecture.layer_sizes().keys() - {"error", "error_hidden"}:
        weight = net.layer(name).weight
        step, changes = 3e-3 * weight.grad / weight.grad.norm(), []
        with torch.no_grad():
            for way in (step, -step):
                weight.add_(way)
                changes.append(along())
                weight.sub_(way)
        slope = (changes[0] - changes[1]) / (2 * step.norm())
        assert slope == pytest.approx(float(weight.grad.norm()), rel=0.03), name


def test_a_fresh_lattice_network_has_the_size_the_documentation_gives():
    assert sum(p.numel() for p in LatticeNet().parameters()) == 165_138


@pytest.mark.parametrize("keeps", [False, True])
def test_pointconv_is_finite_with_finite_gradients_also_without_points(keeps):
    torch.manual_seed(0)
    net = PointConvNet(replace(SMALL, keeps_unset_at_origin=keeps))
    light = net(*points())
    light.square().sum().backward()
    assert light.shape == (5, 9, 3) and torch.isfinite(light).all()
    assert all(torch.isfinite(parameter.grad).all() for parameter in net.parameters())


def test_pointconv_has_about_the_papers_size():
    assert 1.3e6 < sum(p.numel() for p in PointConvNet().parameters()) < 1.6e6


def test_farthest_points_are_those_of_the_plain_loop_and_never_repeat():
    places, _, known = points(seed=4)
    chosen, is_new = farthest_points(places, known, 16)
    assert is_new.sum(1).tolist() == [min(16, int(k)) for k in known.sum(1)]
    cloud, usable = places[2].numpy(), np.flatnonzero(known[2].numpy())
    picked = [usable[np.linalg.norm(cloud[usable], axis=1).argmax()]]
    while len(picked) < 16:
        distance = np.linalg.norm(cloud[usable][:, None] - cloud[picked], axis=2).min(axis=1)
        picked.append(usable[distance.argmax()])
    assert chosen[2].tolist() == picked
