"""The PointConv network beside its plain form, and the estimators that run it from a file of weights."""

import json
import subprocess
import sys

import numpy as np
import pytest
import torch

from xihenet.backend import LocalBackend, estimate_light
from xihenet.estimators.base import EstimateContext
from xihenet.estimators.lattice_format import load_weights
from xihenet.estimators.pointconv import PointAR, PointConvArchitecture, XiheNet, load_pointconv_weights
from xihenet.estimators.weights_format import save_weights
from xihenet.nets.pointconv import PointConvNet, weights_of
from xihenet.records import PointCloud, UnitSphereCloud
from xihenet.sphere import AnchorLattice
from xihenet.training.networks import TrainedNetwork, export_network, save_network

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


def random_clouds(seed=0, n_clouds=6, n=N):
    rng = np.random.default_rng(seed)
    is_set = rng.random((n_clouds, n)) < np.linspace(0.1, 1, n_clouds)[:, None]
    srgb = rng.random((n_clouds, n, 3)) * is_set[..., None]
    return srgb.astype(np.float32), (rng.random((n_clouds, n)) * 5 * is_set).astype(np.float32), is_set


def test_pointar_knows_no_light_without_a_point_in_the_frame_whatever_was_seen_before(files):
    estimator, cloud = PointAR(N, weights=files["pointar"][0]), UnitSphereCloud(*(part[5] for part in random_clouds()))
    seen = PointCloud([[1.0, 2.0, 3.0], [np.nan] * 3], [[0.5] * 3] * 2)
    blind = PointCloud([[np.nan] * 3, [1.0, 2.0, 3.0]], [[0.5] * 3, [np.inf] * 3])
    reasons = [
        estimator.unknown_because(cloud, EstimateContext(points=p, position_m=np.zeros(3))) for p in (seen, blind)
    ]
    assert reasons == ["", "no_points"]
    light = estimate_light(LocalBackend(estimator), cloud, EstimateContext(points=blind, position_m=np.zeros(3)), 1.0)
    assert not light.is_valid and light.unknown_because == "no_points" and not light.sh_radiance.any()


def nasty_clouds(n=N):
    """Nothing set, one anchor, black, white, all at no distance, too far, one far and the rest near, fewer than k."""
    is_set = np.ones((8, n), bool)
    is_set[0], is_set[1], is_set[7] = False, np.arange(n) == 5, np.arange(n) < 6
    rng = np.random.default_rng(1)
    srgb, distance_m = rng.random((8, n, 3)).astype(np.float32), rng.uniform(1, 3, (8, n)).astype(np.float32)
    srgb[2], srgb[3] = 0, 1
    distance_m[4], distance_m[5], distance_m[6, 0] = 0, 3e38, 6e4
    return srgb * is_set[..., None], distance_m * is_set, is_set


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
    # Without those whose points lie at one place or at one distance: which of them comes first is nobody's matter.
    for parts in (random_clouds(), [part[[0, 1, 2, 3, 6, 7]] for part in nasty_clouds()]):
        parts = as_points(*parts)
        with torch.no_grad():
            np.testing.assert_allclose(net(*parts).numpy(), plain_network(net, *parts).numpy(), atol=1e-5)


def test_the_fast_form_has_the_gradients_of_the_plain_form():
    net, parts = fresh_net(), as_points(*random_clouds(3))
    fast, plain = gradients(net, net(*parts)), gradients(net, plain_network(net, *parts))
    assert float((fast - plain).norm()) < 1e-5 * float(plain.norm())


def test_bfloat16_changes_training_a_little_and_estimates_not_at_all():
    parts = as_points(*random_clouds(5))
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
    for parts in (random_clouds(n_clouds=20), nasty_clouds()):
        batch = XiheNet(N, weights=path).estimate_batch(*parts)
        with torch.no_grad():
            np.testing.assert_allclose(batch, net(*as_points(*parts)).numpy(), atol=1e-5)
        for light, *one in zip(batch, *parts, strict=True):
            np.testing.assert_allclose(XiheNet(N, weights=path).estimate(UnitSphereCloud(*one)), light, atol=1e-5)


def test_nasty_clouds_give_finite_light(files):
    light = XiheNet(N, weights=files["xihenet"][0]).estimate_batch(*nasty_clouds())
    assert light.shape == (8, 9, 3) and np.isfinite(light).all()


def test_a_batch_without_clouds_is_legal(files):
    parts = [part[:0] for part in random_clouds()]
    assert XiheNet(N, weights=files["xihenet"][0]).estimate_batch(*parts).shape == (0, 9, 3)


def test_the_order_of_the_points_changes_nothing(files):
    net = files["xihenet"][1]
    points, srgb, is_set = as_points(*random_clouds(2))
    order = torch.randperm(N, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        light, shuffled = net(points, srgb, is_set), net(points[:, order], srgb[:, order], is_set[:, order])
    np.testing.assert_allclose(shuffled.numpy(), light.numpy(), atol=1e-5)


def test_what_stands_at_unset_anchors_changes_nothing(files):
    srgb, distance_m, is_set = random_clouds(6)
    estimator = XiheNet(N, weights=files["xihenet"][0])
    light = estimator.estimate_batch(srgb, distance_m, is_set)
    for colour, metres in ((0.9, 3.0), (np.nan, -7.0)):
        garbage = np.where(is_set[..., None], srgb, colour), np.where(is_set, distance_m, metres), is_set
        np.testing.assert_array_equal(estimator.estimate_batch(*garbage), light)


@pytest.mark.parametrize(("part", "value"), [(0, np.nan), (0, 1.5), (1, np.inf), (1, -1.0), (1, np.nan)])
def test_input_out_of_range_is_refused(files, part, value):
    clouds = [array.copy() for array in random_clouds()]
    clouds[2][2, 5] = True
    clouds[part][2, 5] = value
    with pytest.raises(ValueError, match="expected"):
        XiheNet(N, weights=files["xihenet"][0]).estimate_batch(*clouds)


def test_another_number_of_anchors_is_refused(files):
    with pytest.raises(ValueError, match="n = 512"):
        XiheNet(512, weights=files["xihenet"][0]).estimate_batch(*random_clouds())


def raw_points(n=2000, seed=0):
    rng = np.random.default_rng(seed)
    return PointCloud(rng.normal(size=(n, 3)) * 2, rng.random((n, 3)))


def light_of(estimator, points, position=(0.5, 0.0, 1.0)):
    context = EstimateContext(points=points, position_m=np.array(position))
    return estimator.estimate(UnitSphereCloud.empty(estimator.n_anchors), context)


def test_pointar_gives_the_same_light_for_the_same_points(files):
    estimator, points = PointAR(1280, weights=files["pointar"][0]), raw_points()
    light = light_of(estimator, points)
    np.testing.assert_array_equal(light_of(estimator, points), light)
    assert np.abs(light_of(estimator, raw_points(seed=1)) - light).max() > 1e-4


def test_pointar_draws_as_many_points_as_it_was_trained_with(files):
    path, net = files["pointar"]
    few = raw_points(N)
    with torch.no_grad():
        position = np.array([0.5, 0.0, 1.0], np.float32)
        points = torch.from_numpy(few.points_m - position)[None]
        expected = net(points, torch.tensor(few.srgb)[None], torch.ones(1, N) > 0)[0]
    np.testing.assert_allclose(light_of(PointAR(1280, weights=path), few), expected.numpy(), atol=1e-5)


def test_pointar_sees_points_from_the_position(files):
    estimator, points = PointAR(N, weights=files["pointar"][0]), raw_points()
    shift = np.array([4.0, -2.0, 8.0])
    moved = PointCloud(points.points_m + shift, points.srgb)
    light = light_of(estimator, points, (0, 0, 0))
    np.testing.assert_allclose(light_of(estimator, moved, shift), light, atol=1e-5)
    assert np.abs(light_of(estimator, moved, (0, 0, 0)) - light).max() > 1e-4


@pytest.mark.parametrize("n", [0, 1, 3])
def test_pointar_is_finite_with_hardly_any_points_and_leaves_out_broken_ones(files, n):
    estimator, points = PointAR(N, weights=files["pointar"][0]), raw_points(n)
    broken = PointCloud(
        np.concatenate([points.points_m, [[np.nan, 0, 0], [np.inf, 0, 0]]]),
        np.concatenate([points.srgb, np.ones((2, 3))]),
    )
    light = light_of(estimator, points)
    assert np.isfinite(light).all()
    np.testing.assert_array_equal(light_of(estimator, broken), light)


def test_pointar_says_what_it_needs(files):
    estimator = PointAR(N, weights=files["pointar"][0])
    cloud = UnitSphereCloud.empty(N)
    with pytest.raises(ValueError, match="pointar: needs the raw points"):
        estimator.estimate(cloud)
    with pytest.raises(ValueError, match="pointar: needs the raw points"):
        estimator.estimate(cloud, EstimateContext(points=raw_points()))
    with pytest.raises(ValueError, match="three finite numbers"):
        light_of(estimator, raw_points(), (np.nan, 0, 0))
    with pytest.raises(ValueError, match="clouds of anchors no longer hold"):
        estimator.estimate_batch(*random_clouds())


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
    parts = random_clouds(n_clouds=2)
    with torch.no_grad():
        exact = net(*as_points(*parts)).numpy()
    half = XiheNet(N, "hdr", weights=tmp_path / "half.npz").estimate_batch(*parts)
    assert 1e-7 < np.abs(half - exact).max() < 5e-3
    assert (tmp_path / "half.npz").stat().st_size < 4e6


@pytest.mark.parametrize("kept", [0, 10, 0.5, 0.99])
def test_a_truncated_file_is_refused_by_name(tmp_path, files, kept):
    content = files["xihenet"][0].read_bytes()
    (tmp_path / "cut.npz").write_bytes(content[: int(kept * len(content)) if isinstance(kept, float) else kept])
    with pytest.raises(ValueError, match=r"cut\.npz: expected an \.npz of xihenet weights"):
        XiheNet(N, weights=tmp_path / "cut.npz")


def with_header(**changes):
    def change(content):
        content["header"] = np.array(json.dumps(json.loads(content["header"].item()) | changes))

    return change


CHANGES = {
    "NaN": (lambda content: content["head.3.weight"].fill(np.nan), "head.3.weight: expected finite weights"),
    "another estimator": (with_header(estimator="pointar"), "expected weights of 'xihenet', got 'pointar'"),
    "another format": (with_header(format=2), "expected format 1, got 2"),
    "no number of points": (with_header(n_points=0), "n_points: expected"),
    "an unknown size": (with_header(architecture={"centroids": [32, 8], "depth": 3}), "depth"),
    "three blocks": (with_header(architecture={"centroids": [32, 8, 4]}), "expected two blocks"),
    "another size": (with_header(architecture={"centroids": [32, 8], "n_weights": 4}), "expected 263168 bytes at most"),
    "no bandwidth": (with_header(architecture={"centroids": [32, 8], "bandwidth": 0.0}), "positive bandwidth"),
    "a switch that is a word": (
        with_header(architecture={"centroids": [32, 8], "keeps_unset_at_origin": "no"}),
        "true or false",
    ),
    "a missing array": (lambda content: content.pop("head.0.bias"), "arrays: expected"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_file_is_refused_with_what_was_expected(tmp_path, files, name):
    change, message = CHANGES[name]
    with np.load(files["xihenet"][0]) as stored:
        content = dict(stored)
    change(content)
    np.savez(tmp_path / "changed.npz", **content)
    with pytest.raises(ValueError, match=rf"changed\.npz: .*{message}"):
        XiheNet(N, weights=tmp_path / "changed.npz")


@pytest.mark.parametrize("name", ESTIMATORS)
def test_weights_of_another_target_estimator_or_kind_are_refused(files, name):
    path, other = files[name][0], files["pointar" if name == "xihenet" else "xihenet"][0]
    with pytest.raises(ValueError, match=rf"{name}\.npz: expected weights for the target 'hdr', got 'ldr'"):
        ESTIMATORS[name](N, "hdr", weights=path)
    with pytest.raises(ValueError, match=rf"{other.name}: .*expected weights of '{name}'"):
        ESTIMATORS[name](N, weights=other)
    with pytest.raises(ValueError, match=rf"{name}\.npz: .*expected weights of 'lattice', got '{name}'"):
        load_weights(path)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_missing_weights_are_named_with_what_to_do(tmp_path, name):
    with pytest.raises(ValueError, match=r"none\.npz: expected .* weights, found no file.* train the network"):
        ESTIMATORS[name](N, weights=tmp_path / "none.npz")


def test_without_torch_the_estimators_name_the_extra_in_one_line():
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from xihenet.estimators.pointconv import PointAR, XiheNet\n"
        "for made in (XiheNet, PointAR):\n"
        "    try: made()\n"
        "    except ImportError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "xihenet needs torch: pip install 'xihe-blender[train]'",
        "pointar needs torch: pip install 'xihe-blender[train]'",
    ]


def test_torch_is_imported_when_an_estimator_is_made_and_not_before():
    code = "import sys, xihenet.estimators.pointconv; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
