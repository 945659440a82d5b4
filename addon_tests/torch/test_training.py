"""From rooms to weights: the clouds, the splits, and a training that can be stopped and gives the same each time."""

import csv
import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch

from addon_tests.pure.made import UPRIGHT, pose_of
from xihenet.camera import encode_exposed
from xihenet.colour import linear_to_srgb
from xihenet.estimators.lattice import Lattice
from xihenet.estimators.lattice_format import load_weights
from xihenet.estimators.weights_format import WEIGHTS_FOLDER
from xihenet.mirror_ball import ball_directions, project_mirror_ball
from xihenet.records import PointCloud, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import project_anchors, rotate
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice
from xihenet.training import __main__ as command_line
from xihenet.training import loop
from xihenet.training.baselines import projected
from xihenet.training.dataset import (
    CACHE_VERSION,
    SAMPLINGS,
    CacheSettings,
    RoomChange,
    build_cache,
    open_split,
    rotation_about_vertical,
)
from xihenet.training.loop import TrainSettings, hide_caps, rows_of_first_rooms, train, training_loss
from xihenet.training.networks import Batch, export_network, load_network, run_network
from xihenet.training.rooms import SPLITS, pairs_that_count, read_room, room_files, split_of

N = 96
TINY_POINTCONV = {"centroids": (16, 4), "n_neighbours": 4}


def lights_of_room(balls):
    """What a room at an exposure of 2 keeps of mirror balls (P, n, n, 3) of scene radiance."""
    clipped = np.stack([project_mirror_ball(np.minimum(2.0 * ball, 1.0)) for ball in balls])
    whole = np.stack([project_mirror_ball(2.0 * ball) for ball in balls])
    return {"balls": balls.astype(np.float16), "sh_ldr": clipped, "sh_hdr": whole}


def write_room(path, index, **changes):
    """Two views and two positions of pictures that hold nothing but noise of a room's own colour; the file."""
    rng = np.random.default_rng(index)
    pose, tint = pose_of(UPRIGHT), rng.random(3)
    radiance = rng.random((2, 12, 16, 3)) * tint
    arrays = {
        "srgb_u8": encode_exposed(radiance, 2.0), "radiance": radiance.astype(np.float16),
        "plane_depth_m": (1 + 2 * rng.random((2, 12, 16))).astype(np.float16),
        "world_from_camera": np.stack([pose, pose]), "intrinsics": np.array([16, 12, 10, 10, 8, 6.0]),
        "exposure": np.array(2.0), "positions_m": rng.normal(size=(2, 3)) * 0.1 + [0, 1.5, 0],
        **lights_of_room(rng.random((2, 16, 16, 3)) * tint),
        "is_in_view": np.array([[True, True], [False, True]]), "seed": np.array([0, index]),
    }  # fmt: skip
    file = path / f"room_{index:06d}.npz"
    np.savez_compressed(file, **(arrays | changes))
    return file


WALL = {"plane_depth_m": np.full((2, 12, 16), 2.5, np.float16)}
"""Instead of noise, so that pixels are of one surface."""


def indices(split, n):
    return [i for i in range(400) if split_of((0, i)) == split][:n]


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
        build_cache([rooms], folder / sampling, CacheSettings(N, sampling, changes_per_pair=2, merged_per_position=2))
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


@pytest.mark.parametrize("angle", [0.4, 2.0, 5.5, 0.0])
@pytest.mark.parametrize("is_mirrored", [False, True])
def test_a_turned_and_mirrored_cloud_shows_the_turned_and_mirrored_light(angle, is_mirrored):
    light = np.random.default_rng(0).normal(size=(9, 3)) * 0.05
    light[0] = 1.5
    directions, lattice = AnchorLattice(20_000).directions, AnchorLattice(1280)
    position, change = np.array([0.3, -2.0, 1.0]), RoomChange(angle, is_mirrored)
    srgb = linear_to_srgb(basis(directions) @ light).astype(np.float32)
    cloud = PointCloud((position + 2 * directions).astype(np.float32), srgb)
    seen = sample_unit_sphere(change.of_cloud(cloud, position, None), np.zeros(3), lattice)
    expected = change.of_light(light)
    if not is_mirrored:
        np.testing.assert_allclose(expected, rotate(light, rotation_about_vertical(angle)))
    # Of the points around an anchor any may be the nearest by rounding: an anchor's width of noise stays.
    assert np.abs(project_anchors(seen, lattice) - expected).max() < 5e-3
    assert (np.abs(light - expected).max() > 0.02) == bool(angle or is_mirrored)


def test_a_brighter_room_is_clipped_as_its_picture_would_be(rooms):
    room = read_room(next(iter(sorted(rooms.glob("*.npz")))))
    gains = np.array([2.0, 1.5, 0.5])
    cloud = RoomChange(gains=gains).of_cloud(room.views[0], np.zeros(3), room.radiance[0])
    encoded = linear_to_srgb(np.clip(room.radiance[0] * gains, 0, 1))
    assert np.abs(cloud.srgb - encoded).max() <= 0.5 / 255 + 1e-6
    ldr, hdr = room.truth(0, gains)
    unchanged_ldr, unchanged_hdr = room.truth(0, np.ones(3))
    np.testing.assert_allclose(hdr, unchanged_hdr * gains)
    assert (ldr[0] <= hdr[0] + 1e-12).all() and ldr[0, 0] < 2 * unchanged_ldr[0, 0]
    with pytest.raises(ValueError, match="radiance"):  # other colours need the linear ones
        RoomChange(gains=gains).of_cloud(room.views[0], np.zeros(3), None)


def test_patches_and_facing_are_those_of_the_room_as_it_stands(tmp_path):
    """Moved, mirrored and turned together with the camera, pixels show the same patches of surface."""
    room = read_room(write_room(tmp_path, 0, **WALL))
    cloud, position, lattice = room.views[0], room.positions_m[0], AnchorLattice(N)
    plain = sample_unit_sphere(cloud, position, lattice)
    assert (plain.surfaces.facing > 0.5).sum() > 10
    same = sample_unit_sphere(RoomChange().of_cloud(cloud, position, None), np.zeros(3), lattice)
    np.testing.assert_array_equal(same.is_set, plain.is_set)
    np.testing.assert_allclose(same.surfaces.facing, plain.surfaces.facing, atol=1e-3)
    np.testing.assert_allclose(same.surfaces.camera_distance_m, plain.surfaces.camera_distance_m, rtol=1e-4)
    change = RoomChange(2.0, True)
    moved = change.of_cloud(cloud, position, None)
    expected = rotation_about_vertical(2.0) @ ((cloud.grid.camera_m - position) * [-1, 1, 1])
    np.testing.assert_allclose(moved.grid.camera_m, expected, atol=1e-12)
    before, after = (np.linalg.norm(one.points_m - one.grid.camera_m, axis=1) for one in (cloud, moved))
    np.testing.assert_allclose(after, before, rtol=1e-5)


def test_clouds_keep_how_their_surfaces_face_and_projection_asks_it(caches, tmp_path):
    room = read_room(write_room(tmp_path, 0, **WALL))
    settings = CacheSettings(N, is_test_only=True, only=("test",))
    for name, has_patches in (("patches", True), ("points", False)):
        build_cache([tmp_path], tmp_path / name, dataclasses.replace(settings, has_patches=has_patches))
    patches, points = (open_split(tmp_path / name, "test") for name in ("patches", "points"))
    assert patches.facing_i8[patches.is_set].any() and not patches.facing_i8[~patches.is_set].any()
    assert not points.facing_i8.any() and not open_split(caches["uniform"], "test").facing_i8.any()
    moved = RoomChange().of_cloud(room.views[0], room.positions_m[0], None)
    seen = sample_unit_sphere(moved, np.zeros(3), AnchorLattice(N))
    assert np.abs(patches.facing_i8[0] / 127 - seen.surfaces.facing).max() <= 0.5 / 127 + 1e-6
    np.testing.assert_allclose(projected(patches)[0], project_anchors(seen, AnchorLattice(N)), atol=0.02)
    unasked = dataclasses.replace(patches, facing_i8=np.zeros_like(patches.facing_i8))
    assert np.abs(projected(unasked) - projected(patches)).max() > 1e-3


def test_a_cache_of_another_version_is_refused_in_one_line(caches, tmp_path, capsys):
    shutil.copytree(caches["sphere"], tmp_path / "old")
    found = json.loads((tmp_path / "old" / "settings.json").read_text())
    (tmp_path / "old" / "settings.json").write_text(json.dumps({**found, "version": 3}))
    with pytest.raises(ValueError, match=f"expected sampled clouds of version {CACHE_VERSION}, got 3"):
        open_split(tmp_path / "old", "test")
    assert command_line.main(["report", "--clouds", str(tmp_path / "old")]) == 2
    said = capsys.readouterr().err
    assert (
        said.splitlines()[-1].startswith("xihe train: ") and f"version {CACHE_VERSION}, got 3" in said.splitlines()[-1]
    )


def test_changes_are_of_any_angle_and_no_more_than_a_factor_of_4():
    rng = np.random.default_rng(0)
    changes = [RoomChange.drawn(CacheSettings(exposure_spread=2.0), rng) for _ in range(300)]
    gains = np.array([change.gains for change in changes])
    assert gains.min() > 0.249 and gains.max() < 4.01 and gains.std() > 0.5
    assert 0.4 < np.mean([change.is_mirrored for change in changes]) < 0.6
    assert np.histogram([change.angle for change in changes], 4, (0, 2 * np.pi))[0].min() > 50
    warm = CacheSettings(exposure_spread=0.0, tint_spread=0.0, warmth_spread=0.2)
    red, green, blue = np.log([RoomChange.drawn(warm, rng).gains for _ in range(300)]).T
    np.testing.assert_allclose(red, -blue, atol=1e-12)
    assert not green.any() and 0.15 < red.std() < 0.25


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
    np.testing.assert_allclose(clouds.truth_ldr[0], room.truth(0, np.ones(3))[0], atol=1e-6)
    with np.load(rooms / f"room_{index:06d}.npz") as stored:
        brightest = 2.0 * stored["balls"][0].astype(float).max()
    assert (clouds.truth_hdr[0, 0] <= brightest * 4).all() and (clouds.truth_ldr[:, 0] <= clouds.truth_hdr[:, 0]).all()
    assert (clouds.truth_ldr[:, 0] < 2 * np.sqrt(np.pi)).all() and clouds.truth_hdr[:, 0].max() > 0


def test_the_whole_sphere_shows_the_probe_itself(tmp_path):
    light = np.random.default_rng(0).normal(size=(9, 3)) * 0.03
    light[0] = 1.5
    ball = (basis(ball_directions(128)[0].reshape(-1, 3)) @ light).reshape(128, 128, 3)
    write_room(tmp_path, 0, **lights_of_room(np.stack([ball / 2.0] * 2)))
    build_cache([tmp_path], tmp_path / "cache", CacheSettings(1280, is_test_only=True, is_whole_sphere=True))
    clouds = open_split(tmp_path / "cache", "test")
    assert len(clouds) == 2 and clouds.is_set.all() and not len(open_split(tmp_path / "cache", "train"))
    srgb, distance_m = clouds.srgb_u8[0] / np.float32(255), np.linalg.norm(clouds.points_m[0].astype(float), axis=1)
    seen = UnitSphereCloud(srgb, distance_m.astype(np.float32), clouds.is_set[0])
    assert np.abs(project_anchors(seen, AnchorLattice(1280)) - light).max() < 0.01


def test_an_upright_phone_sees_the_middle_of_the_same_picture(rooms):
    path = next(iter(sorted(rooms.glob("*.npz"))))
    wide, upright = read_room(path), read_room(path, is_upright=True)
    middle = np.arange(12 * 16).reshape(12, 16)[:, 3:12].ravel()  # 9 of 16 columns, 12 rows
    moved = np.abs(wide.views[0].points_m[middle + 0] - upright.views[0].points_m)
    assert np.nanmax(moved) < 1e-5
    np.testing.assert_array_equal(wide.radiance[:, middle], upright.radiance)
    np.testing.assert_array_equal(pairs_that_count(path, is_upright=True), upright.is_in_view)


def test_a_cache_is_the_same_twice_also_of_test_rooms_alone_and_is_kept(rooms, caches, tmp_path):
    settings = CacheSettings(N, "sphere", changes_per_pair=2, merged_per_position=2)
    lines = []
    build_cache([rooms], tmp_path / "again", settings, lines.append)
    build_cache([rooms], tmp_path / "test", dataclasses.replace(settings, only=("test",)))
    assert not len(open_split(tmp_path / "test", "train"))
    for split, again in (("train", "again"), ("test", "again"), ("test", "test")):
        for file in sorted((caches["sphere"] / split).iterdir()):
            assert file.read_bytes() == (tmp_path / again / split / file.name).read_bytes()
    n_lines = len(lines)
    build_cache([rooms], tmp_path / "again", settings, lines.append)
    assert len(lines) == n_lines > 0


def test_what_a_killed_build_left_is_named(rooms, tmp_path):
    (left := tmp_path / ".clouds.1.part").mkdir()
    (tmp_path / ".other.1.part").mkdir()
    lines = []
    build_cache([rooms], tmp_path / "clouds", CacheSettings(N, only=("test",)), lines.append)
    assert [line for line in lines if ".part" in line] == [
        f"{left} is of another build, or left by one that was killed: delete it if none is running"
    ]


def test_rooms_of_two_data_sets_are_told_apart_and_the_same_room_twice_is_refused(rooms, tmp_path):
    settings, n_rooms = CacheSettings(N, "sphere", changes_per_pair=1, merged_per_position=1), 0
    for name, more in (("others", 1), ("same", 0)):
        (tmp_path / name).mkdir()
        for path in rooms.glob("*.npz"):
            stored = dict(np.load(path))
            np.savez(tmp_path / name / path.name, **stored | {"seed": stored["seed"] + [more, 0]})
            n_rooms += more
    build_cache([rooms, tmp_path / "others"], tmp_path / "both", settings)
    numbers = [set(open_split(tmp_path / "both", split).room) for split in SPLITS]
    assert sum(map(len, numbers)) == 2 * n_rooms == len(set.union(*numbers))
    with pytest.raises(ValueError, match="the same room twice"):
        build_cache([rooms, tmp_path / "same"], tmp_path / "twice", settings)


def test_a_folder_without_rooms_and_a_file_that_is_none_are_refused(tmp_path):
    with pytest.raises(ValueError, match="expected rooms"):
        build_cache([tmp_path], tmp_path / "cache", CacheSettings())
    (tmp_path / "room_000001.npz").write_bytes(b"PK nothing")
    with pytest.raises(ValueError, match=r"room_000001\.npz: expected a room"):
        build_cache([tmp_path], tmp_path / "cache", CacheSettings())


def test_a_damaged_room_is_named_with_what_to_do(tmp_path):
    path = write_room(tmp_path, 0, sh_ldr=np.full((2, 9, 3), np.nan))
    with pytest.raises(ValueError, match=r"room_000000\.npz: .*sh_ldr is not finite.*delete it and build again"):
        build_cache([tmp_path], tmp_path / "cache", CacheSettings(N, is_test_only=True))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"room_000000\.npz: .*delete it and build again"):
        build_cache([tmp_path], tmp_path / "cache", CacheSettings(N, is_test_only=True))
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize(("content", "said"), [('{"format": 1}', "1"), ("{", "'none'"), ("[]", "'none'")])
def test_rooms_of_another_format_are_refused_as_the_build_does(tmp_path, content, said):
    write_room(tmp_path, 0)
    (tmp_path / "dataset.json").write_text(content)
    with pytest.raises(ValueError, match=f"dataset.json: expected rooms of format 2, got {said}; build them again"):
        room_files(tmp_path)
    (tmp_path / "dataset.json").write_text('{"format": 2}')
    assert len(room_files(tmp_path)) == 1


def curve(folder, column):
    with (folder / "curves.csv").open() as file:
        return [float(row[column]) for row in csv.DictReader(file)]


def test_training_makes_the_loss_smaller_and_writes_its_curve(caches, tmp_path):
    lines = []
    best = train(quick(caches["sphere"], tmp_path, epochs=6), progress=lines.append)
    losses = curve(tmp_path, "loss")
    assert len(losses) == len(lines) == 6 and " left" in lines[0] and best.exists() and losses[-1] < losses[0]


@pytest.mark.parametrize(("estimator", "sampling"), [("lattice", "sphere"), ("pointar", "uniform")])
def test_a_stopped_training_ends_where_an_undisturbed_one_does(caches, tmp_path, estimator, sampling):
    options = TINY_POINTCONV if estimator == "pointar" else {}
    given = {"estimator": estimator, "options": options, "epochs": 3}
    whole, stopped = (quick(caches[sampling], tmp_path / name, **given) for name in ("whole", "stopped"))
    undisturbed = weights(train(whole))
    train(stopped, stop_after=1)
    train(stopped, stop_after=1)
    assert same_weights(undisturbed, weights(train(stopped)))
    assert (tmp_path / "whole" / "curves.csv").read_text() == (tmp_path / "stopped" / "curves.csv").read_text()


@pytest.mark.parametrize(
    ("estimator", "other_sizes"), [("lattice", {"stem": 5, "middle": 7, "code": 9}), ("xihenet", TINY_POINTCONV)]
)
def test_a_training_begins_with_other_weights_and_keeps_a_share_of_them(caches, tmp_path, estimator, other_sizes):
    first = train(quick(caches["sphere"], tmp_path / "first", estimator=estimator, options=other_sizes, epochs=1))
    export_network(first, tmp_path / "start.npz", is_half=False)
    start = weights(tmp_path / "first" / "best.pt")
    begun = {"estimator": estimator, "start": tmp_path / "start.npz", "epochs": 1}
    still = train(quick(caches["sphere"], tmp_path / "still", learning_rate=0.0, **begun))
    assert same_weights(start, weights(still))
    kept = weights(train(quick(caches["sphere"], tmp_path / "kept", start_share=0.75, **begun)))
    moved = weights(train(quick(caches["sphere"], tmp_path / "moved", **begun)))
    assert not same_weights(start, moved)
    for name, value in kept.items():
        torch.testing.assert_close(value, 0.75 * start[name] + 0.25 * moved[name], rtol=0, atol=1e-6)


def test_a_share_of_no_weights_or_weights_of_another_network_are_refused(caches, tmp_path):
    with pytest.raises(ValueError, match="start_share"):
        quick(caches["sphere"], tmp_path, start_share=0.5)
    with pytest.raises(ValueError, match="expected weights of a network of the same"):
        train(quick(caches["sphere"], tmp_path / "x", start=WEIGHTS_FOLDER / "lattice_hdr.npz"))


@pytest.mark.parametrize("n_steps", [1, 5])
def test_a_training_stopped_within_an_epoch_goes_on_from_what_was_kept(caches, tmp_path, monkeypatch, n_steps):
    """In epochs of three steps."""
    n = len(open_split(caches["sphere"], "train"))
    whole, stopped = (quick(caches["sphere"], tmp_path / name, epochs=2, batch_size=-(-n // 3)) for name in "ab")
    best = weights(train(whole))
    monkeypatch.setattr(loop, "KEEP_EVERY_S", 0.0)
    left = iter(range(n_steps))

    def stopping(*parts):
        next(left)
        return training_loss(*parts)

    with monkeypatch.context() as patch, pytest.raises(StopIteration):
        patch.setattr(loop, "training_loss", stopping)
        train(stopped)
    steps = []
    with monkeypatch.context() as patch:
        patch.setattr(loop, "training_loss", lambda *parts: steps.append(1) or training_loss(*parts))
        assert same_weights(best, weights(train(stopped)))
    assert len(steps) == 6 - n_steps
    assert (tmp_path / "a" / "curves.csv").read_text() == (tmp_path / "b" / "curves.csv").read_text()


def test_a_learning_curve_takes_the_first_rooms_alone_and_another_seed_gives_other_weights(caches, tmp_path):
    clouds = open_split(caches["sphere"], "train")
    rows = rows_of_first_rooms(clouds, 2)
    assert set(clouds.room[rows]) == set(indices("train", 2))
    assert len(rows) == np.isin(clouds.room, clouds.room[rows]).sum()
    assert len(rows_of_first_rooms(clouds, None)) == len(clouds)
    every = quick(caches["sphere"], tmp_path / "every", epochs=1)
    others = [{"n_rooms": 2, "out": tmp_path / "few"}, {"seed": 1, "out": tmp_path / "seed"}]
    first = weights(train(every))
    assert not any(same_weights(first, weights(train(dataclasses.replace(every, **other)))) for other in others)
    with pytest.raises(ValueError, match="the same settings"):
        train(dataclasses.replace(every, learning_rate=1e-5))
    with pytest.raises(ValueError, match="expected 1 to 4 training rooms"):
        rows_of_first_rooms(clouds, 5)


def train_by_command(data, out, *more):
    common = f"--data {data} --out {out} --anchors {N} --changes 1 --merged-clouds 1 --epochs 1".split()
    return command_line.main(["train", *common, *map(str, more)])


def test_a_training_on_other_clouds_or_of_an_older_version_is_refused_before_anything_is_removed(
    rooms, tmp_path, capsys
):
    for name, n_left_out, brighter in (("fewer", 1, 1.0), ("other", 0, 2.0)):
        (tmp_path / name).mkdir()
        for path in sorted(rooms.glob("*.npz"))[n_left_out:]:
            stored = dict(np.load(path))
            np.savez(tmp_path / name / path.name, **stored | {"sh_ldr": stored["sh_ldr"] * brighter})
    out = tmp_path / "out"
    assert train_by_command(rooms, out) == 0
    there = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    capsys.readouterr()
    cases = [
        ("data", tmp_path / "other"), ("data", tmp_path / "fewer"), ("changes", rooms, "--changes", 2),
        ("data, epochs", tmp_path / "other", "--epochs", 5),
    ]  # fmt: skip
    for differs, data, *more in cases:
        assert train_by_command(data, out, *more) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and f"other {differs}; choose another --out" in said
        assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == there
    assert train_by_command(rooms, out) == 0
    checkpoint = out / "lattice_ldr_0" / "checkpoint.pt"
    torch.save({k: v for k, v in torch.load(checkpoint, weights_only=True).items() if k != "clouds"}, checkpoint)
    capsys.readouterr()
    assert train_by_command(rooms, out) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "with other" in said and ", version" in said and "choose another --out" in said


def test_too_few_rooms_are_said_with_how_many_before_any_is_sampled(tmp_path, capsys):
    (tmp_path / "rooms").mkdir()
    first = indices("validation", 1)[0]
    for index in range(2):
        write_room(tmp_path / "rooms", index)
    assert train_by_command(tmp_path / "rooms", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "got 2 and 0" in said and f"at least {first + 1} rooms of seed 0" in said
    assert not list((tmp_path / "out").iterdir())


def test_training_stops_when_validation_no_longer_improves(caches, tmp_path):
    settings = quick(caches["sphere"], tmp_path, epochs=40, patience=2, learning_rate=0.05)
    train(settings)
    errors = curve(tmp_path, "validation_rmse")
    assert len(errors) < 40 and len(errors) - 1 - int(np.argmin(errors)) == 2


def test_a_training_that_diverges_ends_with_what_to_do_and_not_as_if_it_were_done(caches, tmp_path):
    with pytest.raises(ValueError, match=r"diverged in epoch 1, .* lower --learning-rate"):
        train(quick(caches["sphere"], tmp_path, learning_rate=1e10))


def test_a_network_that_was_taken_away_after_its_training_is_missed(caches, tmp_path):
    train(quick(caches["sphere"], tmp_path, epochs=1)).unlink()
    with pytest.raises(ValueError, match=r"best\.pt is not there, .* train again"):
        train(quick(caches["sphere"], tmp_path, epochs=1))


def test_the_expected_error_learns_the_mean_error(tmp_path):
    made, settings = torch.full((4, 9, 3), 0.3), quick(tmp_path, tmp_path)
    losses = {e: training_loss(made, torch.full((4,), e), torch.zeros(4, 9, 3), settings) for e in (0.2, 0.3, 0.4)}
    assert losses[0.3] < losses[0.2] and losses[0.3] < losses[0.4]


def test_a_logarithmic_loss_counts_factors_alike_in_bright_and_dark_lights_and_in_large_and_small_errors(tmp_path):
    plain, logarithmic = (quick(tmp_path, tmp_path, is_logarithmic=on) for on in (False, True))
    rng = np.random.default_rng(0)
    truth, off = (torch.from_numpy(rng.normal(size=(8, 9, 3)).astype(np.float32)) * 100 for _ in range(2))

    def loss(error, settings, brightness=1.0):
        return float(training_loss((truth + error) * brightness, None, truth * brightness, settings))

    assert loss(off, plain, 10) > 5 * loss(off, plain)
    assert loss(off, logarithmic, 10) == pytest.approx(loss(off, logarithmic), rel=0.01)
    halved = [loss(error, logarithmic) - loss(error / 2, logarithmic) for error in (10 * off, 2 * off)]
    assert halved[0] == pytest.approx(halved[1], rel=0.05)
    assert loss(off, logarithmic) == loss(-off, logarithmic) and loss(0 * off, logarithmic) == 0


def test_hidden_caps_leave_a_part_of_some_clouds_and_nothing_of_what_was_hidden():
    rng = np.random.default_rng(0)
    points = torch.from_numpy((3 * AnchorLattice(N).directions).astype(np.float32)).expand(200, N, 3)
    is_set = torch.from_numpy(rng.random((200, N)) < 0.5)
    is_set[0] = False
    known = is_set[..., None]
    whole = Batch(torch.rand(200, N, 3) * known, points * known, is_set, torch.zeros(200, 9, 3), 1.0 * is_set)
    hidden = hide_caps(whole, 0.5, rng)
    n_changed = int((hidden.is_set != is_set).any(1).sum())
    assert 60 < n_changed < 120 and not (hidden.is_set & ~is_set).any()
    assert hidden.is_set.any(1)[1:].all() and not hidden.is_set[0].any()
    assert not hidden.srgb[~hidden.is_set].any() and not hidden.points_m[~hidden.is_set].any()
    assert torch.equal(hidden.facing > 0, hidden.is_set)
    assert torch.equal(hidden.srgb[hidden.is_set], whole.srgb[hidden.is_set])
    assert torch.equal(hide_caps(whole, 0.0, rng).is_set, is_set)


def test_an_exported_network_gives_what_the_trained_one_gives(caches, tmp_path):
    trained = train(quick(caches["sphere"], tmp_path, epochs=2))
    export_network(trained, tmp_path / "w.npz", data="noise", is_half=False)
    clouds = open_split(caches["sphere"], "test")
    srgb, points = clouds.srgb_u8 / np.float32(255), np.asarray(clouds.points_m, np.float32)
    facing = np.random.default_rng(0).uniform(-1, 1, clouds.is_set.shape).astype(np.float32)
    tensors = [torch.from_numpy(np.array(p)) for p in (srgb, points, clouds.is_set, clouds.truth_ldr, facing)]
    with torch.no_grad():
        light, _ = run_network(load_network(trained).net, Batch(*tensors))
    seen = srgb, np.linalg.norm(points, axis=2), clouds.is_set
    in_numpy = Lattice(N, weights=tmp_path / "w.npz").estimate_batch(*seen, facing=facing)
    np.testing.assert_allclose(in_numpy, light.numpy(), atol=1e-5)


def test_weights_that_are_exported_again_keep_what_they_say_of_themselves(tmp_path):
    shipped, again = WEIGHTS_FOLDER / "lattice_hdr.npz", tmp_path / "again.npz"
    assert command_line.main(["export", str(shipped), str(again)]) == 0
    first, second = map(load_weights, (shipped, again))
    for name in ("data", "seed", "figures", "n_points", "target", "architecture"):
        assert getattr(second, name) == getattr(first, name), name
    assert first.figures and first.data
    assert command_line.main(["export", str(shipped), str(again), "--data", "others"]) == 0
    assert load_weights(again).data == "others" and load_weights(again).figures == first.figures


def test_the_command_line_trains_exports_and_reports(rooms, tmp_path, capsys):
    common = f"--data {rooms} --out {tmp_path} --anchors {N} --changes 1 --merged-clouds 1".split()
    assert command_line.main(["train", *common, "--epochs", "1"]) == 0
    best = tmp_path / "lattice_ldr_0" / "best.pt"
    assert capsys.readouterr().out.strip() == str(best)
    assert command_line.main(["export", str(best), str(tmp_path / "w.npz")]) == 0
    assert Lattice(N, weights=tmp_path / "w.npz").n_anchors == N
    clouds = str(tmp_path / f"clouds_sphere_{N}")
    assert command_line.main(["report", "--clouds", clouds, "--network", f"ours={best}", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["tables"][0]["rows"][-1]["name"] == "ours"


@pytest.mark.parametrize(
    "arguments",
    [
        ["report", "--clouds", "/nowhere"], ["report", "--network", "a"], ["export", "/nowhere.pt", "/nowhere.npz"],
        ["export", __file__, "/nowhere.npz"],
    ],
)  # fmt: skip
def test_a_users_mistake_is_one_line_and_exit_2(arguments, capsys):
    assert command_line.main(arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1
