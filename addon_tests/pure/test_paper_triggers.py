"""What the evaluation's two studies of triggering count, on rooms that are ray-cast here."""

from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.furnished import furniture, seen, walk_poses
from xihe_blender.errors import UserError
from xihe_blender.lab.paper import records
from xihe_blender.lab.paper.records import Place, Session, StudyOptions
from xihe_blender.lab.paper.studies import trigger_labelled, trigger_sessions
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import ControllerSettings, XiheController
from xihenet.sphere import AnchorLattice
from xihenet.trigger import TriggerSettings

PLACES_M = np.array([[0.3, 0.2, 0.5], [-0.8, 0.4, 0.7]])
LATTICE = AnchorLattice(1280)


def walk_of(name, seed, level=0.3, dims_at=None):
    """A session of 8 frames; `dims_at` is the frame from which the light is a third."""
    frames = [
        seen(pose, furniture(seed), k, gain=1 / 3 if dims_at is not None and k >= dims_at else 1.0)
        for k, pose in enumerate(walk_poses(seed, 8))
    ]
    rng = np.random.default_rng(seed)
    lights = [np.concatenate([np.full((1, 3), level * 3.5), rng.normal(0, 0.1 * level, (8, 3))]) for _ in PLACES_M]
    truth = [None, None] if dims_at is not None else lights
    return Session(name, frames, 1.0, [Place(f"p{k}", PLACES_M[k], truth[k]) for k in range(2)])


@pytest.fixture(autouse=True)
def few_draws(monkeypatch):
    """The width of intervals is no question here."""
    monkeypatch.setattr(records, "N_DRAWS", 30)


def options(tmp_path):
    return StudyOptions(quick=True, seed=3, folder=tmp_path)


def test_labels_are_the_ends_of_the_order():
    chosen, is_change = trigger_labelled.labelled(np.array([0.9, 0.1, 0.5, 1.0, 0.2]), 0.4)
    assert chosen[is_change].tolist() == [1, 4] and sorted(chosen[~is_change].tolist()) == [0, 3]


def test_the_best_theta_is_that_of_trying_them_all():
    rng = np.random.default_rng(5)
    for _ in range(30):
        change, is_change = rng.integers(0, 8, 25) / 8, rng.random(25) < 0.5
        best = trigger_labelled.right(change, is_change, trigger_labelled.best_theta(change, is_change)).mean()
        tried = [trigger_labelled.right(change, is_change, t).mean() for t in np.arange(-0.1, 1.1, 1 / 16)]
        assert best == pytest.approx(max(tried))


def test_every_strategy_is_judged_on_the_same_pairs(tmp_path, monkeypatch):
    monkeypatch.setattr(trigger_labelled, "N_PAIRS", 40)
    drawn = set()

    def measured(cases, rng, *, groups):
        drawn.update(groups)
        return records.measured(cases, rng, groups=groups)

    monkeypatch.setattr(trigger_labelled, "measured", measured)
    sessions = [walk_of("dim", 1, 0.05), walk_of("bright", 2, 0.4)]
    rows = list(trigger_labelled.measure(sessions, options(tmp_path)))
    best = [row for row in rows if row.what.endswith("best theta: split 50%")]
    assert len(best) == 5 and {row.n for row in best} == {40}
    assert len(drawn) == 3  # Either room, and both: in whatever order.
    over_theta = [row for row in rows if row.series == "window 4"]
    assert [row.at for row in over_theta] == list(trigger_labelled.THETAS)
    assert len({row.value for row in rows if row.series.startswith("ours")}) == 1
    with pytest.raises(UserError, match="light stays the same"):
        next(trigger_labelled.measure([walk_of("lamp", 1, dims_at=4)], options(tmp_path)))


@pytest.mark.parametrize("rule, policy", [(trigger_sessions.OURS, "light"), (trigger_sessions.PAPERS, "reference")])
def test_a_session_is_walked_as_the_chain_walks_it(rule, policy):
    session, theta = walk_of("lamp", 4, dims_at=5), 0.15
    settings = TriggerSettings(policy=policy, theta=theta, light_theta=theta)
    chain = XiheController(
        LocalBackend(estimators.load(estimators.DEFAULT, 1280, "ldr")),
        ControllerSettings(settings, following=None, reference_exposure=1.0),
    )
    for place in session.places:
        chain.add_position(place.name, place.position_m)
    names = [place.name for place in session.places]
    followed = dict(zip(names, trigger_sessions.follow(session, LATTICE), strict=True))
    n_fired = dict.fromkeys(followed, 0)
    for k, frame in enumerate(session.frames):
        for name, report in chain.step(frame, active=list(followed)).items():
            n_fired[name] += report.decision.fire
            if report.decision.fire:
                light = report.estimate.sh_radiance
                np.testing.assert_allclose(followed[name].lights[k], light, atol=2e-3)  # The wire rounds.
    change = trigger_sessions.changes_by_rule(LATTICE)[rule]
    walked = {name: trigger_sessions.walk(place, rule, change, theta)[0] + 1 for name, place in followed.items()}
    assert walked == n_fired and min(n_fired.values()) > 1


def test_a_rule_that_always_asks_is_never_off_and_one_that_never_does_keeps_the_first_light():
    place = trigger_sessions.follow(walk_of("room", 6), LATTICE)[0]
    change = trigger_sessions.changes_by_rule(LATTICE)[trigger_sessions.OURS]
    n_always, off = trigger_sessions.walk(place, trigger_sessions.OURS, change, -1.0)
    assert n_always == len(place.seen) - 1 and off.max() == 0
    n_never, off = trigger_sessions.walk(place, trigger_sessions.OURS, change, np.inf)
    assert n_never == 0 and off.max() > 0


def test_estimates_at_an_error_are_the_fewest_that_any_theta_takes():
    curve = np.array([[10, 0.0], [6, 0.02], [8, 0.03], [2, 0.04]])
    found = [trigger_sessions.fires_at(error, curve) for error in (0.0, 0.01, 0.03, 0.035, 0.1)]
    assert found == pytest.approx([10, 8, 6, 4, 2])


def test_sessions_yield_the_table_and_the_curves_of_both_rules(tmp_path):
    lamp = replace(walk_of("light_intensity", 7, dims_at=3), name="light_intensity")
    rows = list(trigger_sessions.measure([lamp, walk_of("walk_around", 8)], options(tmp_path)))
    together = [row for row in rows if "one theta for all" in row.what]
    assert len(together) == 2 and all(row.value >= 0 and row.n == 4 for row in together)
    of_paper = {row.what: row.paper for row in rows if "light_intensity, the paper's rule, theta 0.6: " in row.what}
    assert list(of_paper.values()) == [0.011, 0.0038, 0.0024]  # Mean, spread, frames with an estimate.
    assert {row.series for row in rows if row.series} >= {"light_intensity, our rule", "walk_around, the paper's rule"}
