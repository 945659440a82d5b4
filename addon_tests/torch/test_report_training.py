"""The training's report: what it is made of, that its figures are right, and that it can be shown."""

import dataclasses
import json
import re
import shutil
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import torch

from xihenet.colour import linear_to_srgb
from xihenet.estimators.calibration import SHARES_ASKED, Calibration
from xihenet.estimators.lattice_format import load_weights
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice
from xihenet.svg import linear_axis
from xihenet.training import __main__ as command_line
from xihenet.training import calibration
from xihenet.training import report as figures_of
from xihenet.training.baselines import BASELINES, MEAN, fit_baselines, fit_linear, projected
from xihenet.training.calibration import calibration_elsewhere, fit_calibration, promises_left_out
from xihenet.training.dataset import CACHE_VERSION, CloudSet, open_split
from xihenet.training.networks import TrainedNetwork, make_network, save_network
from xihenet.training.plots import line_chart, report_plots, series_look
from xihenet.training.predictions import Group, Prediction, open_group, over_seeds, training_clouds
from xihenet.training.report import ALL_VIEWS, ONE_VIEW, WALK, WHOLE, ReportSettings, make_report, report_json
from xihenet.training.report_text import report_markdown
from xihenet.training.rooms import split_of
from xihenet.training.stress import DISTURBANCES, add_noise, blacken, blow_out, leave_cap, leave_one_anchor

N = 96
N_COPIES = 3
TEST_ROOMS = np.array([i for i in range(400) if split_of((0, i)) == "test"][:4])
TINY_POINTCONV = {"centroids": (16, 4), "n_neighbours": 4}


def random_clouds(rng, rooms, n_pairs, n_merged, n_anchors=N, coverage=(0.2, 0.6)):
    """Clouds that show the light they have as their truth; the same for each room: pairs first, then merged ones."""
    room = np.repeat(rooms, n_pairs + n_merged)
    n = len(room)
    truth = rng.normal(size=(n, 9, 3)) * 0.05
    truth[:, 0] = rng.uniform(0.5, 2.0, (n, 1)) * rng.uniform(0.8, 1.2, (n, 3))
    directions = AnchorLattice(n_anchors).directions
    radiance = np.clip(np.einsum("ni,mic->mnc", basis(directions), truth), 0, 1)
    n_views = np.tile(np.r_[np.ones(n_pairs, int), np.full(n_merged, 2)], len(rooms))
    is_set = rng.random((n, n_anchors)) < rng.uniform(*coverage, (n, 1))
    is_set[:, 0] = True
    known = is_set[..., None]
    points = directions * rng.uniform(1, 4, (n, n_anchors, 1))
    srgb, lights, sensed = np.rint(linear_to_srgb(radiance) * 255), truth.astype(np.float32), radiance.mean(axis=1)
    return CloudSet(
        (srgb * known).astype(np.uint8), (points * known).astype(np.float16), is_set, lights, lights,
        sensed.astype(np.float32), room.astype(np.int64), n_views.astype(np.int64), np.zeros((n, n_anchors), np.int8),
    )  # fmt: skip


def write_cache(folder, sampling="sphere", n_anchors=N, is_test_only=False, coverage=(0.2, 0.6), seed=0, n_pairs=4):
    rng = np.random.default_rng(seed)
    for split, rooms, n_single, n_merged in (
        ("train", np.arange(12), 2 * N_COPIES, 4),
        ("validation", np.arange(20, 26), 3, 2),
        ("test", TEST_ROOMS, n_pairs, 2),
    ):
        clouds = random_clouds(rng, rooms, n_single, n_merged, n_anchors, coverage)
        if split == "train":
            clouds.n_views[9::10] = 1  # of those merged the last has one view by chance, where a pair could begin
        if sampling != "sphere":
            clouds = dataclasses.replace(clouds, is_set=np.ones_like(clouds.is_set))
        (folder / split).mkdir(parents=True)
        for field in dataclasses.fields(CloudSet):
            np.save(folder / split / f"{field.name}.npy", getattr(clouds, field.name))
    settings = {"sampling": sampling, "n_anchors": n_anchors, "changes_per_pair": N_COPIES, "version": CACHE_VERSION}
    rooms = [[0, int(room)] for room in TEST_ROOMS]
    (folder / "settings.json").write_text(json.dumps({**settings, "is_test_only": is_test_only, "rooms": rooms}))
    return folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("caches")
    return {
        "sphere": write_cache(folder / "sphere"),
        "uniform": write_cache(folder / "uniform", "uniform"),
        "walk": write_cache(folder / "walk", is_test_only=True, coverage=(0.7, 0.9), seed=1),
        "whole": write_cache(folder / "whole", is_test_only=True, coverage=(1.0, 1.0), seed=2, n_pairs=0),
        "fewer": write_cache(folder / "fewer", n_anchors=64, seed=3),
    }


@pytest.fixture(scope="module")
def networks(tmp_path_factory):
    """Networks as they are before training, which is all a report needs."""
    folder = tmp_path_factory.mktemp("networks")
    files = {}
    for name, seed, options in (("lattice_0", 0, {}), ("lattice_1", 1, {}), ("pointar", 0, TINY_POINTCONV)):
        torch.manual_seed(seed)
        files[name], estimator = folder / f"{name}.pt", name.partition("_")[0]
        save_network(files[name], TrainedNetwork(estimator, "ldr", seed, make_network(estimator, **options)))
    return files


def settings_of(folders, files, **changes):
    lattice, walks = [files["lattice_0"], files["lattice_1"]], [folders["walk"]]
    given = {
        "networks": {"lattice": lattice, "pointar": [files["pointar"]]}, "learning": {6: lattice[:1], 12: lattice},
        "walks": walks, "whole": [folders["whole"]], "scenes": {"hotel": walks},
        "stress": {"64 anchors": [folders["fewer"]]},
    }  # fmt: skip
    return ReportSettings([folders["uniform"], folders["sphere"]], **{**given, **changes})


@pytest.fixture(scope="module")
def report(folders, networks):
    return make_report(settings_of(folders, networks))


@pytest.fixture(scope="module")
def validation(folders, networks):
    return make_report(settings_of(folders, networks, split="validation", scenes={}))


def test_each_group_has_a_table_with_a_row_for_each_predictor(report):
    tables = {table.name: table for table in report.tables}
    assert list(tables) == [ONE_VIEW, ALL_VIEWS, WALK, f"hotel, {ONE_VIEW}", "hotel, all views", WHOLE]
    names = [row.name for row in tables[ONE_VIEW].rows]
    assert names == [*BASELINES, "lattice", "pointar"] and tables[ONE_VIEW].n_clouds == 16
    assert tables[ALL_VIEWS].n_clouds == 8 and tables[WALK].coverage["p5"] > 0.6
    assert [row.name for row in tables[WHOLE].rows] == [*BASELINES, "lattice"]
    assert tables[WHOLE].n_clouds == 8 and tables[WHOLE].coverage == {"p5": 1.0, "p50": 1.0, "p95": 1.0}
    for table in tables.values():
        assert table.rows[0].figures.ratio == 1.0 and all(row.figures.ratio > 0 for row in table.rows)
        assert sum(table.n_in_coverage) == table.n_clouds
    # What shows its light has the floor of the projection.
    ratios = {row.name: row.figures.ratio for row in tables[WHOLE].rows}
    assert ratios["projection"] < 0.1 and ratios["projection, linear fit"] < 0.6 and ratios["ambient"] < 0.6


def test_seeds_give_a_mean_and_a_spread(report, folders, networks):
    row = report.tables[0].rows[-2]
    alone, singles = {"walks": (), "whole": (), "scenes": {}, "stress": {}, "learning": {}}, []
    for name in ("lattice_0", "lattice_1"):
        given = settings_of(folders, networks, networks={"lattice": [networks[name]]}, **alone)
        singles.append(make_report(given).tables[0].rows[-1])
    ratios = [single.figures.ratio for single in singles]
    np.testing.assert_allclose([row.figures.ratio, row.spread.ratio], [np.mean(ratios), np.std(ratios, ddof=1)])
    assert row.n_seeds == 2 and singles[0].spread.ratio is None


def test_learning_stress_rooms_and_calibration_are_there(report):
    assert [point.n_rooms for point in report.learning] == [6, 12]
    assert report.learning[1].groups[ONE_VIEW][1] >= 0 and report.learning[0].groups[ONE_VIEW][1] is None
    assert [group.name for group in report.stress] == ["undisturbed", *DISTURBANCES, "64 anchors"]
    assert report.stress[-1].n_anchors == 64
    assert all(row.is_finite for group in report.stress for row in group.rows)
    assert [row.name for row in report.rooms] == [*BASELINES, "lattice", "pointar"]
    assert [row.name for row in report.calibration] == ["lattice"]
    assert report.calibration[0].figures.all.n_clouds == 24


def test_the_report_is_markdown_without_a_gap(report):
    text = report_markdown(report)
    assert not re.search(r"\b(nan|none|inf)\b", text.lower())
    tables = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert len(tables) == 2 * 6 + 4
    for table in tables:
        assert len({line.count("|") for line in table}) == 1


def test_plots_are_well_formed_and_stay_within_their_edges(report):
    plots = report_plots(report)
    assert set(plots) - {"coverage"} == {"rooms", "calibration_lattice"}
    for svg in plots.values():
        root = ElementTree.fromstring(svg)
        width, height = (float(v) for v in root.get("viewBox").split()[2:])
        texts = [element for element in root.iter() if element.tag.endswith("text")]
        assert len(texts) > 8
        for text in texts:
            x = text.get("x")
            assert 0 <= float(x.rstrip("%")) <= 100 if x.endswith("%") else -8 <= float(x) <= width
            assert 0 <= float(text.get("y")) <= height


@pytest.mark.parametrize("values", [[0.4, 1.25], [0.6], [0.0], [1e-9, 2e-9], [3.0, 3.0], [-1.0, 2.0], [120.0, 4000.0]])
def test_an_axis_holds_its_values_and_few_short_ticks(values):
    for low in (min(values), min(0.0, *values)):
        axis = linear_axis(low, max(values), n_steps=5)
        assert axis.low <= low + 1e-9 and max(values) <= axis.high + 1e-9 and axis.low < axis.high
        assert 2 <= len(axis.ticks) <= 8 and all(len(axis.label(tick)) <= 9 for tick in axis.ticks)


def test_no_two_series_look_alike_names_are_escaped_and_a_plot_without_points_is_refused():
    assert len({series_look(i) for i in range(32)}) == 32
    axis = linear_axis(0, 0.7, n_steps=5)
    assert axis.low == 0 and 0.7 <= axis.high <= 1
    with pytest.raises(ValueError, match="at least one series"):
        line_chart("empty", [("a", [])], axis, axis, ("x", "y"))
    drawn = line_chart("a < b", [("<x>", [(0.1, 0.2, 0.05), (0.3, 0.4, None)])], axis, axis, ("x", "b & c"))
    assert "a < bb & c" in "".join(ElementTree.fromstring(drawn).itertext()).replace("\n", "")


def test_validation_clouds_are_not_judged_by_a_calibration_that_saw_them(validation):
    assert validation.head.split == "validation" and validation.tables[0].n_clouds == 18
    figures = validation.calibration[0].figures.all
    assert figures.n_clouds == 30 and abs(figures.expected / figures.made - 1) < 0.5


def test_baselines_are_fitted_to_pairs_as_they_are_and_to_merged_clouds(folders):
    every, some = open_split(folders["sphere"], "train"), training_clouds([folders["sphere"]])
    assert len(every) == 12 * 10 and len(some) == 12 * 5
    of_a_room = np.flatnonzero(every.room == 5)
    np.testing.assert_array_equal(some.truth_ldr[some.room == 5], every.truth_ldr[of_a_room[[0, N_COPIES, 6, 7, 8]]])
    single = some.n_views == 1
    np.testing.assert_allclose(fit_baselines(some, "ldr").mean_light, some.truth_ldr[single].mean(axis=0), rtol=1e-5)


def test_walks_count_in_rooms_of_the_split_alone_and_scenes_of_others_whole(folders):
    assert len(open_group(WALK, [folders["walk"]], "test", "merged").cases) == 8
    assert len(open_group(WALK, [folders["walk"]], "validation", "merged").cases) == 0
    assert len(open_group("hotel", [folders["walk"]], "validation", "merged", is_of_strangers=True).cases) == 8


def test_a_report_without_clouds_in_a_group_has_gaps_and_no_error(validation):
    walk = next(table for table in validation.tables if table.name == WALK)
    assert walk.n_clouds == 0 and all(row.figures.ratio is None for row in walk.rows)
    assert "No such clouds." in report_markdown(validation) and json.loads(report_json(validation))


def test_a_report_on_rooms_of_which_none_is_in_the_split_has_gaps_and_no_error(folders, networks, tmp_path):
    without = tmp_path / "clouds"
    shutil.copytree(folders["sphere"], without)
    for file in (without / "test").glob("*.npy"):
        np.save(file, np.load(file)[:0])
    report = make_report(ReportSettings([without], {"lattice": [networks["lattice_0"]]}))
    assert "No such clouds." in report_markdown(report) and json.loads(report_json(report))
    assert report_plots(report) == {} and report.calibration[0].figures.all.n_clouds == 0


def test_the_linear_fit_finds_a_linear_law():
    rng = np.random.default_rng(0)
    features, slopes, offset = rng.normal(size=(5000, 4)), rng.normal(size=(4, 27)), rng.normal(size=27)
    fit = fit_linear(features, (features @ slopes + offset).reshape(-1, 9, 3))
    np.testing.assert_allclose(fit, np.vstack([slopes, offset]), atol=5e-3)


def test_baselines_say_what_their_estimators_say(folders):
    clouds = open_group("", [folders["sphere"]], "test", "one").cases
    lights = fit_baselines(training_clouds([folders["sphere"]]), "ldr").lights(clouds)
    assert tuple(lights) == BASELINES and all(light.shape == (16, 9, 3) for light in lights.values())
    np.testing.assert_array_equal(lights["projection"], projected(clouds))
    np.testing.assert_allclose(lights["ambient"][:, 0], 2 * np.sqrt(np.pi) * clouds.ambient, rtol=1e-6)
    assert not lights["ambient"][:, 1:].any() and (np.ptp(lights[MEAN], axis=0) == 0).all()


def test_disturbances_leave_the_truth_and_say_what_a_sensor_would():
    clouds = random_clouds(np.random.default_rng(1), np.arange(5), 4, 0)
    dark = {name: 0 * getattr(clouds, name) for name in ("srgb_u8", "points_m")}
    empty = dataclasses.replace(clouds, is_set=np.zeros_like(clouds.is_set), **dark)
    for disturb in DISTURBANCES.values():
        of_nothing = disturb(empty, np.random.default_rng(0))
        assert not of_nothing.is_set.any() and np.isfinite(of_nothing.ambient).all()
        disturbed = disturb(clouds, np.random.default_rng(2))
        np.testing.assert_array_equal(disturbed.truth_ldr, clouds.truth_ldr)
        assert not (disturbed.is_set & ~clouds.is_set).any() and disturbed.is_set.any(axis=1).all()
        assert not disturbed.srgb_u8[~disturbed.is_set].any() and not disturbed.points_m[~disturbed.is_set].any()
        again = disturb(clouds, np.random.default_rng(2))
        np.testing.assert_array_equal(disturbed.srgb_u8, again.srgb_u8)
    rng = np.random.default_rng(3)
    assert not blacken(clouds, rng).ambient.any() and (blow_out(clouds, rng).ambient == 1).all()
    assert (leave_one_anchor(clouds, rng).is_set.sum(axis=1) == 1).all()
    np.testing.assert_array_equal(leave_cap(clouds, rng).ambient, clouds.ambient)
    assert (add_noise(clouds, rng).srgb_u8 != clouds.srgb_u8)[clouds.is_set].mean() > 0.9


def test_a_cap_is_what_lies_around_one_anchor():
    clouds = random_clouds(np.random.default_rng(1), np.arange(5), 4, 0)
    cut = leave_cap(clouds, np.random.default_rng(4), share=0.1)
    directions = AnchorLattice(N).directions
    assert (cut.is_set.sum(axis=1) == np.minimum(round(0.1 * N), clouds.is_set.sum(axis=1))).all()
    for left, known in zip(cut.is_set, clouds.is_set, strict=True):
        nearness = directions @ directions[left].T
        assert any((nearness[left, i].min() >= nearness[known & ~left, i].max(initial=-1)) for i in range(left.sum()))


def test_the_error_of_one_room_is_found(folders):
    cases = open_group("", [folders["sphere"]], "test", "one").cases
    light = cases.truth_ldr.astype(float)
    light[cases.room == TEST_ROOMS[2]] += 0.5
    found = figures_of.room_figures("one wrong room", [Prediction(cases, "ldr", light)])
    worst = found.worst_rooms[0]
    assert worst.room == TEST_ROOMS[2] and worst.share == pytest.approx(1) and worst.rmse == pytest.approx(0.5)
    assert found.of_worst_rooms == pytest.approx(1) and found.of_worst_clouds == pytest.approx(0.25)
    nothing = figures_of.room_figures("perfect", [Prediction(cases, "ldr", cases.truth_ldr.astype(float))])
    assert nothing.of_worst_clouds is None


def test_the_curve_is_none_where_clouds_are_few_and_right_where_not():
    clouds = random_clouds(np.random.default_rng(5), np.arange(10), 10, 0)
    off_by = {MEAN: 0.2, "half": 0.1}
    said = {name: [Prediction(clouds, "ldr", clouds.truth_ldr.astype(float) + off)] for name, off in off_by.items()}
    group = Group("g", clouds, {"sphere_96": clouds}, said)
    curve = figures_of.coverage_curve([group])
    assert sum(curve.n_clouds) == 100
    for n, ratio in zip(curve.n_clouds, curve.rows["half"].ratio, strict=True):
        assert (ratio is None) == (n < 10) and (ratio is None or ratio == pytest.approx(0.5))
    assert figures_of.group_table(group).rows[1].figures.ratio == pytest.approx(0.5)


def test_a_calibration_finds_its_law_and_keeps_its_promises():
    rng = np.random.default_rng(0)
    raw, coverage = rng.uniform(0.02, 0.3, 20_000), rng.uniform(0, 1, 20_000)
    made = 2.0 * raw**1.5 * np.exp(-0.8 * coverage) * rng.gamma(4.0, 0.25, len(raw))
    found = fit_calibration(raw, made, coverage)
    np.testing.assert_allclose([found.factor, found.power, found.slope], [2.0, 1.5, -0.8], rtol=0.05)
    expected = found.expected(raw, coverage)
    np.testing.assert_allclose(np.mean(made / expected), 1.0)
    for seen in (coverage >= 0, coverage < 0.25, coverage > 0.75):
        kept = [np.mean(made[seen] <= multiple * expected[seen]) for multiple in found.quantiles]
        np.testing.assert_allclose(kept, SHARES_ASKED, atol=1e-3 if seen.all() else 0.03)
    assert (np.diff(found.expected(np.linspace(0, 1, 50), 0.5)) > 0).all()


def asked_of(n_rooms):
    """What promises of so many rooms hold, so that they hold in one more."""
    return [min(share * (n_rooms + 1) / n_rooms, 1) for share in SHARES_ASKED]


def test_rooms_of_another_kind_set_the_power_the_level_the_slope_and_the_promises_each_room_alike():
    rng = np.random.default_rng(0)
    raw, coverage = rng.uniform(0.02, 0.3, 30_000), rng.uniform(0, 1, 30_000)
    room = rng.choice(4, len(raw), p=[0.7, 0.1, 0.1, 0.1])
    of_rooms = 3.0 * np.exp(-0.8 * coverage) * np.array([0.5, 1.0, 1.0, 1.5])[room]
    made = raw * of_rooms * rng.gamma(4.0, 0.25, len(raw))
    found = calibration_elsewhere(raw, made, coverage, room)
    assert found.power == pytest.approx(1.0, abs=0.03)
    np.testing.assert_allclose(found.expected(0.15, 0), 3.0 * 0.15, rtol=0.02)
    assert found.slope == pytest.approx(-0.8, abs=0.05)
    far_off = made.copy()
    far_off[np.flatnonzero(room == 1)[0]] *= 1e9
    unmoved = calibration_elsewhere(raw, far_off, coverage, room)
    np.testing.assert_allclose([unmoved.factor, unmoved.slope], [found.factor, found.slope], rtol=0.01)
    is_kept = made <= np.outer(found.quantiles, found.expected(raw, coverage))
    for seen, tolerance in ((coverage >= 0, 0.01), (coverage < 0.25, 0.03), (coverage > 0.75, 0.03)):
        kept = np.mean([np.mean(is_kept[:, seen & (room == number)], axis=1) for number in range(4)], axis=0)
        np.testing.assert_allclose(kept, asked_of(4), atol=tolerance)
    everything = np.ones(len(raw), bool)
    left_out = promises_left_out(raw, made, coverage, room, everything)
    assert all(held < share + 0.02 for held, share in zip(left_out, asked_of(3), strict=True)) and left_out[0] > 0.3
    of_many = rng.integers(0, 60, len(raw))
    told = calibration_elsewhere(raw, made, coverage, of_many)
    held = np.mean(made <= np.outer(told.quantiles, told.expected(raw, coverage)), axis=1)
    np.testing.assert_allclose(held, asked_of(60), atol=0.01)
    np.testing.assert_allclose(held, SHARES_ASKED, atol=0.03)
    nothing = calibration_elsewhere(raw, np.zeros(len(raw)), coverage, room)
    assert nothing.slope == 0 and nothing.factor < 1e-5
    alike = 3.0 * raw * rng.gamma(4.0, 0.25, len(raw))
    for judged in (everything, (coverage > 0.8) & (room > 0)):
        kept = promises_left_out(raw, alike, coverage, room, judged)
        np.testing.assert_allclose(kept, asked_of(3), atol=0.02 if judged.all() else 0.03)


def test_weights_are_calibrated_by_rooms_of_another_kind_and_say_how_well(folders, networks, tmp_path, capsys):
    """A trained network, and the weights that came of it, calibrated anew."""
    elsewhere = ["--elsewhere", *[str(folders["sphere"])] * 2]
    assert command_line.main(["export", str(networks["lattice_0"]), str(tmp_path / "a.npz"), *elsewhere]) == 0
    assert "kept in rooms left out, one view: 50% in " in capsys.readouterr().err
    told, _ = calibration.calibrate_elsewhere(networks["lattice_0"], [folders["sphere"]] * 2)
    assert Calibration.from_figures(load_weights(tmp_path / "a.npz").figures) == told and told.factor > 0
    assert command_line.main(["export", str(tmp_path / "a.npz"), str(tmp_path / "b.npz"), *elsewhere]) == 0
    once, again = load_weights(tmp_path / "a.npz"), load_weights(tmp_path / "b.npz")
    assert again.seed == once.seed and all((again.arrays[name] == once.arrays[name]).all() for name in once.arrays)
    found = Calibration.from_figures(again.figures)
    np.testing.assert_allclose([found.factor, found.power], [told.factor, told.power], rtol=0.02)  # of half floats
    assert command_line.main(["export", str(networks["lattice_0"]), str(tmp_path / "c.npz"), *elsewhere[:2]]) == 2
    assert "two rooms or more, got 1" in capsys.readouterr().err


def test_a_calibration_goes_through_the_header_of_a_weights_file():
    found = Calibration(1.2, 0.8, -0.5, (0.9, 1.1, 1.7))
    assert Calibration.from_figures(json.loads(json.dumps(found.as_figures()))) == found
    np.testing.assert_allclose(Calibration.from_figures({}).expected([0.1, 0.2], 0.3), [0.1, 0.2])
    with pytest.raises(ValueError, match="expected error_law"):
        Calibration.from_figures({"error_law": [1.0, 1.0]})
    with pytest.raises(ValueError, match="run `xihe train export` on it again"):
        Calibration.from_figures({"error_scale": [1.0, 1.0, 0.0]})


def test_a_network_is_calibrated_for_its_weights_as_the_report_says(folders, networks, report):
    found = calibration.calibrate_network(networks["lattice_0"], [folders["uniform"], folders["sphere"]])
    assert found == report.calibration[0].by_seed[0]
    with pytest.raises(ValueError, match="a network that knows its error"):
        calibration.calibrate_network(networks["pointar"], [folders["sphere"], folders["uniform"]])


def test_a_constant_expectation_is_calibrated_to_the_mean_error_and_errors_that_are_none_to_nothing():
    found = fit_calibration([0.1, 0.1, 0.1], [0.2, 0.4, 0.6], [0.5, 0.5, 0.5])
    np.testing.assert_allclose(found.expected([0.1, 5.0], [0.1, 0.9]), 0.4)
    for made in ([0.1, np.nan], [0.1, -0.1], [0.1]):
        with pytest.raises(ValueError, match="calibration: expected"):
            fit_calibration([0.1, 0.2], made, [0.5, 0.5])


def test_figures_of_seeds_are_averaged_and_what_is_missing_stays_missing():
    mean, spread = over_seeds([{"a": 1.0, "b": (2.0, None), "n": 3}, {"a": 3.0, "b": (2.0, 1.0), "n": 3}])
    assert mean == {"a": 2.0, "b": (2.0, None), "n": 3} and spread["b"] == (0.0, None)
    calibrations = [Calibration(1.0, 1.0, 0.0, (1.0, 2.0)), Calibration(3.0, 1.0, 0.0, (3.0, 2.0))]
    assert over_seeds(calibrations)[0] == Calibration(2.0, 1.0, 0.0, (2.0, 2.0))
    assert spread["a"] == pytest.approx(np.sqrt(2)) and over_seeds([{"a": 1.0}]) == ({"a": 1.0}, {"a": None})


def test_folders_that_do_not_fit_are_refused(folders, networks, tmp_path):
    with pytest.raises(ValueError, match="expected sampled clouds"):
        open_group("g", [tmp_path], "test", "one")
    with pytest.raises(ValueError, match="sampled on the sphere, got uniform_96"):
        open_group("g", [folders["uniform"]], "test", "one")
    other = write_cache(tmp_path / "other", "uniform")
    np.save(other / "test" / "room.npy", np.arange(24))
    with pytest.raises(ValueError, match="the same cases in all folders"):
        open_group("g", [folders["sphere"], other], "test", "one")
    with pytest.raises(ValueError, match="trained for 'hdr', got 'ldr'"):
        make_report(settings_of(folders, networks, target="hdr"))
    mixed = {"both": [networks["lattice_0"], networks["pointar"]]}
    with pytest.raises(ValueError, match="expected lattice as the others of both"):
        make_report(settings_of(folders, networks, networks=mixed))


def test_the_command_writes_all_that_was_asked_for(folders, networks, tmp_path, capsys):
    common = ["--report", "--clouds", str(folders["sphere"]), "--network", f"lattice={networks['lattice_0']}"]
    common += [f"lattice={networks['lattice_1']}", "--learning", f"12={networks['lattice_0']}"]
    out = {name: tmp_path / "made" / name for name in ("r.json", "r.md", "plots")}
    files = ["--json", str(out["r.json"]), "--markdown", str(out["r.md"]), "--plots", str(out["plots"])]
    assert command_line.main([*common, *files, "--walk", str(folders["walk"])]) == 0
    assert capsys.readouterr().out == ""
    asked = {"networks": {"lattice": [networks["lattice_0"], networks["lattice_1"]]}, "walks": [folders["walk"]]}
    made = make_report(ReportSettings([folders["sphere"]], learning={12: [networks["lattice_0"]]}, **asked))
    assert out["r.json"].read_text() == report_json(made) and out["r.md"].read_text() == report_markdown(made)
    assert {path.stem for path in out["plots"].iterdir()} == set(report_plots(made))
    assert command_line.main([*common, "--learning", f"many={networks['lattice_0']}"]) == 2
    assert "expected ROOMS=FILE" in capsys.readouterr().err
