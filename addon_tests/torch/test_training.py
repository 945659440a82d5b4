"""From rooms to weights: the clouds, the splits, and a training that can be stopped and gives the same each time."""

import csv
import json

import numpy as np
import pytest
import torch

from xihenet.colour import linear_to_srgb
from xihenet.estimators.lattice import Lattice
from xihenet.records import PointCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import project_anchors, rotate
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice
from xihenet.training import __main__ as command_line
from xihenet.training.dataset import (
    SAMPLINGS,
    CacheSettings,
    build_cache,
    open_split,
    rotation_about_vertical,
    turned_cloud,
)
from xihenet.training.export import export_lattice
from xihenet.training.loop import TrainSettings, train, training_loss
from xihenet.training.networks import Batch, load_network, run_network
from xihenet.training.report import fit_linear, make_report
from xihenet.training.rooms import read_room, split_of

N = 96
TINY_POINTCONV = {"centroids": (16, 4), "n_neighbours": 4}


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def write_room(path, index):
    """Two views and two positions of pictures that hold nothing but noise of a room's own colour."""
    rng = np.random.default_rng(index)
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    tint = rng.random(3)
    np.savez_compressed(
        path / f"room_{index:06d}.npz",
        srgb_u8=(rng.random((2, 12, 16, 3)) * 255 * tint).astype(np.uint8),
        plane_depth_m=(1 + 2 * rng.random((2, 12, 16))).astype(np.float16),
        world_from_camera=np.stack([pose, pose]),
        intrinsics=np.array([16, 12, 10, 10, 8, 6.0]),
        exposure=np.array(2.0),
        positions_m=rng.normal(size=(2, 3)) * 0.1 + [0, 1.5, 0],
        panoramas=(rng.random((2, 8, 16, 3)) * tint).astype(np.float16),
        is_in_view=np.array([[True, True], [False, True]]),
        seed=np.array([7, index]),
    )


def indices(split, n):
    return [i for i in range(400) if split_of((7, i)) == split][:n]


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rooms")
    for index in [*indices("train", 4), *indices("validation", 2), *indices("test", 2)]:
        write_room(folder, index)
    return folder


@pytest.fixture(scope="module")
def caches(rooms, tmp_path_factory):
    folder = tmp_path_factory.mktemp("caches")
    for sampling in SAMPLINGS:
        build_cache(rooms, folder / sampling, CacheSettings(N, sampling, turns_per_pair=2, merged_per_position=2))
    return {sampling: folder / sampling for sampling in SAMPLINGS}


def quick(cache, out, **changes):
    return TrainSettings(cache, out, **{"epochs": 4, "batch_size": 8, **changes})


def weights(path):
    return load_network(path).net.state_dict()


def same_weights(a, b):
    return all(torch.equal(value, b[name]) for name, value in a.items())


def test_rooms_are_split_in_eight_one_and_one_tenths_and_stay_where_they_are():
    splits = [split_of((0, i)) for i in range(4000)]
    assert abs(splits.count("train") / 4000 - 0.8) < 0.02 and abs(splits.count("test") / 4000 - 0.1) < 0.02
    assert splits[:10] == [split_of((0, i)) for i in range(10)]


def test_turning_the_cloud_and_turning_the_light_are_the_same():
    rng = np.random.default_rng(0)
    light = rng.normal(size=(9, 3)) * 0.05
    light[0] = 1.5
    directions = AnchorLattice(20_000).directions
    position = np.array([0.3, -2.0, 1.0])
    srgb = linear_to_srgb(basis(directions) @ light).astype(np.float32)
    cloud = PointCloud((position + 2 * directions).astype(np.float32), srgb)
    lattice = AnchorLattice(1280)
    for angle in (0.4, 2.0, 5.5):
        seen = sample_unit_sphere(turned_cloud(cloud, position, angle), np.zeros(3), lattice)
        expected = rotate(light, rotation_about_vertical(angle))
        # Of the points around an anchor any may be the nearest by rounding: an anchor's width of noise stays.
        assert np.abs(project_anchors(seen, lattice) - expected).max() < 5e-3
        assert np.abs(light - expected).max() > 0.02


def test_the_cache_holds_what_was_asked_for(caches):
    for sampling, cache in caches.items():
        clouds = open_split(cache, "train")
        assert len(clouds) == 4 * (3 * 2 + 2 * 2) and clouds.srgb_u8.shape == (len(clouds), N, 3)
        assert set(np.unique(clouds.n_views)) <= {1, 2} and clouds.is_set.any(axis=1).all()
        if sampling != "sphere":
            assert clouds.is_set[clouds.n_views == 1].all()
        assert set(open_split(cache, "test").room) == set(indices("test", 2))


def test_truth_is_clipped_for_ldr_and_carries_the_exposure(caches, rooms):
    clouds = open_split(caches["sphere"], "test")
    index = int(clouds.room[0])
    room = read_room(rooms / f"room_{index:06d}.npz")
    np.testing.assert_allclose(clouds.truth_ldr[0], room.truth_ldr[0], atol=1e-6)
    with np.load(rooms / f"room_{index:06d}.npz") as stored:
        mean = 2.0 * stored["panoramas"][0].astype(float)
    assert (clouds.truth_hdr[0, 0] <= mean.max() * 4).all() and (clouds.truth_ldr[:, 0] <= clouds.truth_hdr[:, 0]).all()
    assert (room.truth_ldr[:, 0] < 2 * np.sqrt(np.pi)).all() and room.truth_hdr[:, 0].max() > 0


def test_a_cache_is_the_same_twice_and_is_kept(rooms, caches, tmp_path):
    settings = CacheSettings(N, "sphere", turns_per_pair=2, merged_per_position=2)
    lines = []
    build_cache(rooms, tmp_path / "again", settings, lines.append)
    for file in sorted((caches["sphere"] / "train").iterdir()):
        assert file.read_bytes() == (tmp_path / "again" / "train" / file.name).read_bytes()
    n_lines = len(lines)
    build_cache(rooms, tmp_path / "again", settings, lines.append)
    assert len(lines) == n_lines > 0


def test_a_folder_without_rooms_and_a_file_that_is_none_are_refused(tmp_path):
    with pytest.raises(ValueError, match="expected rooms"):
        build_cache(tmp_path, tmp_path / "cache", CacheSettings())
    (tmp_path / "room_000001.npz").write_bytes(b"PK nothing")
    with pytest.raises(ValueError, match=r"room_000001\.npz: expected a room"):
        build_cache(tmp_path, tmp_path / "cache", CacheSettings())


def test_training_makes_the_loss_smaller_and_writes_its_curve(caches, tmp_path):
    lines = []
    best = train(quick(caches["sphere"], tmp_path, epochs=12), progress=lines.append)
    with (tmp_path / "curves.csv").open() as file:
        curve = list(csv.DictReader(file))
    assert len(curve) == len(lines) == 12 and "min left" in lines[0] and best.exists()
    assert float(curve[-1]["loss"]) < float(curve[0]["loss"])


@pytest.mark.parametrize(("estimator", "sampling"), [("lattice", "sphere"), ("pointar", "uniform")])
def test_a_stopped_training_ends_where_an_undisturbed_one_does(caches, tmp_path, estimator, sampling):
    options = TINY_POINTCONV if estimator == "pointar" else {}
    whole = train(quick(caches[sampling], tmp_path / "whole", estimator=estimator, options=options))
    stopped = quick(caches[sampling], tmp_path / "stopped", estimator=estimator, options=options)
    train(stopped, stop_after=1)
    train(stopped, stop_after=2)
    assert same_weights(weights(whole), weights(train(stopped)))
    assert (tmp_path / "whole" / "curves.csv").read_text() == (tmp_path / "stopped" / "curves.csv").read_text()


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(caches, tmp_path):
    a, b, c = (
        weights(train(quick(caches["sphere"], tmp_path / name, epochs=2, seed=seed)))
        for name, seed in (("a", 1), ("b", 1), ("c", 2))
    )
    assert same_weights(a, b) and not same_weights(a, c)


def test_other_settings_do_not_go_on_with_a_stopped_training(caches, tmp_path):
    train(quick(caches["sphere"], tmp_path), stop_after=1)
    with pytest.raises(ValueError, match="the same settings"):
        train(quick(caches["sphere"], tmp_path, learning_rate=1e-5))


def test_training_stops_when_validation_no_longer_improves(caches, tmp_path):
    settings = quick(caches["sphere"], tmp_path, epochs=40, patience=2, learning_rate=0.05)
    train(settings)
    with (tmp_path / "curves.csv").open() as file:
        errors = [float(row["validation_rmse"]) for row in csv.DictReader(file)]
    assert len(errors) < 40 and len(errors) - 1 - int(np.argmin(errors)) == 2


def test_the_expected_error_learns_the_mean_error(tmp_path):
    made, settings = torch.full((4, 9, 3), 0.3), quick(tmp_path, tmp_path)
    losses = {e: training_loss(made, torch.full((4,), e), torch.zeros(4, 9, 3), settings) for e in (0.2, 0.3, 0.4)}
    assert losses[0.3] < losses[0.2] and losses[0.3] < losses[0.4]


def test_an_exported_network_gives_what_the_trained_one_gives(caches, tmp_path):
    trained = train(quick(caches["sphere"], tmp_path, epochs=2))
    export_lattice(trained, tmp_path / "w.npz", data="noise", is_half=False)
    clouds = open_split(caches["sphere"], "test")
    srgb, points = clouds.srgb_u8 / np.float32(255), np.asarray(clouds.points_m, np.float32)
    tensors = [torch.from_numpy(np.array(part)) for part in (srgb, points, clouds.is_set, clouds.truth_ldr)]
    with torch.no_grad():
        light, _ = run_network(load_network(trained).net, Batch(*tensors))
    in_numpy = Lattice(N, weights=tmp_path / "w.npz").estimate_batch(
        srgb, np.linalg.norm(points, axis=2), clouds.is_set
    )
    np.testing.assert_allclose(in_numpy, light.numpy(), atol=1e-5)


def test_a_pointconv_network_cannot_be_exported_as_lattice_weights(caches, tmp_path):
    trained = train(quick(caches["uniform"], tmp_path, estimator="pointar", options=TINY_POINTCONV, epochs=1))
    with pytest.raises(ValueError, match="expected a trained lattice network, got pointar"):
        export_lattice(trained, tmp_path / "w.npz")


@pytest.mark.parametrize("is_merged", [False, True])
def test_the_report_has_a_row_for_each_predictor(caches, tmp_path, is_merged):
    lattice = train(quick(caches["sphere"], tmp_path / "lattice"))
    pointar = train(quick(caches["uniform"], tmp_path / "p", estimator="pointar", options=TINY_POINTCONV, epochs=1))
    report = make_report(caches, {"lattice": lattice, "uniform:pointar": pointar}, is_merged=is_merged)
    names = ["ambient", "ambient, fitted", "projection", "projection, linear fit", "lattice", "pointar"]
    assert [row.name for row in report.rows] == names and report.n_rooms == 2
    assert report.n_clouds == (4 if is_merged else 6)
    assert all(row.ratio > 0 for row in report.rows) and len(report.rows[4].calibration) == 3
    assert json.loads(json.dumps(report.as_dict(), allow_nan=False))["n_clouds"] == report.n_clouds
    assert all(f"| {name} |" in report.as_markdown() for name in names)


def test_the_linear_fit_finds_a_linear_law():
    rng = np.random.default_rng(0)
    features, slopes, offset = rng.normal(size=(5000, 4)), rng.normal(size=(4, 27)), rng.normal(size=27)
    fit = fit_linear(features, (features @ slopes + offset).reshape(-1, 9, 3))
    np.testing.assert_allclose(fit, np.vstack([slopes, offset]), atol=5e-3)


def test_the_command_line_trains_exports_and_reports(rooms, tmp_path, capsys):
    common = ["--data", str(rooms), "--out", str(tmp_path), "--anchors", str(N), "--turns", "1", "--merged-clouds", "1"]
    assert command_line.main(["train", *common, "--epochs", "1"]) == 0
    best = tmp_path / "lattice_ldr_0" / "best.pt"
    assert capsys.readouterr().out.strip() == str(best)
    assert command_line.main(["export", str(best), str(tmp_path / "w.npz")]) == 0
    assert Lattice(N, weights=tmp_path / "w.npz").n_anchors == N
    clouds = f"sphere={tmp_path / f'clouds_sphere_{N}'}"
    assert command_line.main(["report", "--clouds", clouds, "--network", f"ours={best}", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rows"][-1]["name"] == "ours"


@pytest.mark.parametrize(
    "arguments",
    [["report", "--clouds", "sphere=/nowhere"], ["export", "/nowhere.pt", "/nowhere.npz"], ["report", "--clouds", "a"]],
)
def test_a_users_mistake_is_one_line_and_exit_2(arguments, capsys):
    assert command_line.main(arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1
