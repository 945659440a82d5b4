"""Estimators are told apart by what left-out frames show, whichever places a recording has."""

import numpy as np
import pytest

from addon_tests.pure.commands import assert_refused, xihe_here
from addon_tests.pure.made import constant
from addon_tests.pure.recordings import HALF, LAYOUTS, as_nerfstudio, walk
from addon_tests.pure.test_estimate_command import read_strictly
from xihe_blender.cli.main import main
from xihe_blender.report.replay import write_replay_report
from xihenet import estimators
from xihenet.left_out import score_places, score_session
from xihenet.records import Intrinsics

CAMERA = Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)


class Knows:
    """An estimator of constant light, of which the nearer to the room's mean the better."""

    n_anchors, needs = 1280, frozenset()

    def __init__(self, radiance):
        self.radiance = radiance

    def estimate(self, cloud, context=None):
        return constant(self.radiance)


def scored(frames, loaded, places_m, seed=0):
    return score_session(iter(frames), len(frames), places_m, loaded, np.random.default_rng(seed))


def test_the_better_guess_has_the_lower_score_and_the_same_seed_the_same_interval():
    frames = walk(CAMERA, 12)
    places_m = score_places(frames)
    assert 4 <= len(places_m) <= 16 and (np.abs(places_m) < HALF).all()
    loaded = {"black": Knows(0.0), "near": Knows(0.25), "white": Knows(1.0)}
    scores = scored(frames, loaded, places_m)
    by_name = {one.estimator: one for one in scores}
    assert list(by_name) == list(loaded)
    assert by_name["near"].rmse < by_name["black"].rmse < by_name["white"].rmse
    assert by_name["near"].share_better == 1 and by_name["white"].share_better == 0
    assert all(one.low <= one.rmse <= one.high and one.n_places == len(places_m) for one in scores)
    assert scores == scored(frames, loaded, places_m) != scored(frames, loaded, places_m, seed=1)


@pytest.mark.parametrize("n", [2, 5, 6])
def test_fewer_than_six_places_have_no_interval(n):
    """Of two places such an interval holds the truth in half of all cases, whatever is done."""
    frames = walk(CAMERA, 12)
    (only,) = scored(frames, {"near": Knows(0.25)}, score_places(frames, most=n))
    assert only.n_places == n and ((only.low is None) is (only.high is None) is (n < 6))


def test_what_the_room_shows_beats_one_colour():
    frames = walk(CAMERA, 12)
    loaded = {name: estimators.load(name, target="ldr") for name in ("ambient", "projection")}
    ambient, projection = scored(frames, loaded, score_places(frames))
    assert projection.rmse < ambient.rmse


def test_where_every_part_shows_the_same_nothing_can_be_asked():
    frames = walk(CAMERA, 1) * 6
    assert scored(frames, {"black": Knows(0.0)}, np.zeros((1, 3))) == []
    assert scored([], {"black": Knows(0.0)}, np.zeros((0, 3))) == []
    assert score_places([]).shape == (0, 3)


def test_estimators_of_different_sizes_are_refused():
    other = Knows(0.0)
    other.n_anchors = 512
    with pytest.raises(ValueError, match="one number of anchors"):
        scored([], {"a": Knows(0.0), "b": other}, np.zeros((0, 3)))


def test_a_page_of_scores_alone_shows_no_table_of_lights(tmp_path):
    content = {"format": "a recording", "source": "", "frames": [], "positions": [], "notes": [], "score": None}
    write_replay_report(tmp_path / "page.html", content | {"estimator": "lattice", "target": "hdr"}, {}, [])
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "no light was asked for" in page and "no frames" not in page and "The light<" not in page


@pytest.mark.slow
def test_the_command_writes_the_table(tmp_path, capfd):
    as_nerfstudio(tmp_path / "in", walk(LAYOUTS["Nerfstudio"][1], 9))
    assert main(["replay", str(tmp_path / "in"), "--score", "--out", str(tmp_path / "out")]) == 0
    said = capfd.readouterr()
    assert "better than ambient at" in said.out and "it is no error of the light" in said.err
    written = read_strictly((tmp_path / "out" / "replay.json").read_text())["score"]["estimators"]
    by_cloud = [name for name in estimators.names() if not estimators.load(name).needs]
    assert [one["estimator"] for one in written] == ["ambient", *by_cloud] and "lattice" in by_cloud
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Estimators without a true light" in page and "What the phone saw" in page and 'src="http' not in page
    again = ["replay", tmp_path / "in", "--out", tmp_path / "out"]
    assert_refused(xihe_here(*again), "say where")
    assert_refused(xihe_here(*again, "--score", "--every", "5"), "give 3 frames or more")
