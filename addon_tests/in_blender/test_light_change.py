"""A lamp that goes down while the phone looks away: what it does not see follows what it sees."""

from dataclasses import replace

import numpy as np
import pytest
from previs_runs import LOOKS_AWAY, SMALL, run, walk
from results_schema import check_results


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Of the same walk, whose lamp falls to a sixth while the phone looks away: following, and as in the paper."""
    out = tmp_path_factory.mktemp("lamp")
    settings = {"following": SMALL, "keeping": replace(SMALL, following=None)}
    return {name: run(walk(), out / name, chosen) for name, chosen in settings.items()}


def ball_after(results):
    """The ball's probe in the last frame."""
    return next(probe for probe in results["frames"][-1]["probes"] if probe["name"] == "Ball")


def test_after_the_lamp_went_down_the_light_is_nearer_to_the_truth(results):
    following, keeping = (ball_after(results[name]) for name in ("following", "keeping"))
    assert following["shc_rmse"] < keeping["shc_rmse"]
    followed, kept, truth = (np.sum(light) for light in (following["sh"][0], keeping["sh"][0], keeping["sh_truth"][0]))
    assert kept > 1.5 * truth and abs(followed - truth) < 0.3 * (kept - truth)


def test_following_is_said_and_where_it_is_off_nothing_is_followed(results):
    for content in results.values():
        check_results(content)
    following, keeping = results["following"], results["keeping"]
    when = {entry["frame"] for entry in following["frames"] if any(p["n_followed_anchors"] for p in entry["probes"])}
    assert when == {LOOKS_AWAY + 1}
    assert any(f"At frame {LOOKS_AWAY + 1} the light in view changed as a whole" in n for n in following["notes"])
    assert keeping["summary"]["n_followed_anchors"] == 0 and keeping["settings"]["following"] is None
    assert following["settings"]["following"]["smallest_stops"] == 0.5


def test_before_the_light_changes_both_are_the_same(results):
    before = [[e["probes"] for e in content["frames"] if e["frame"] <= LOOKS_AWAY] for content in results.values()]
    assert before[0] == before[1]
