"""The network: when answers arrive, and the light in use against a plain look through all that are under way."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from xihenet.phone.network import (
    LINKS,
    REFERENCE_PAYLOAD_BYTES,
    EstimatesUnderWay,
    Link,
    arrival_frames,
)
from xihenet.records import LightEstimate


@pytest.mark.parametrize(("name", "end_to_end_ms"), [("wifi", 20.67), ("home", 37.27), ("lte", 79.17)])
def test_links_have_the_papers_median_end_to_end(name, end_to_end_ms):
    arrivals = arrival_frames(np.zeros(20000), REFERENCE_PAYLOAD_BYTES, LINKS[name], np.random.default_rng(1))
    assert 1e3 * np.median(arrivals) == pytest.approx(end_to_end_ms, rel=0.02)
    assert arrivals.min() >= LINKS[name].processing_s + LINKS[name].floor_s


def test_four_positions_cost_the_papers_128_percent_of_network_time():
    link, n = LINKS["wifi"], np.zeros(20000)
    one, four = (
        np.median(arrival_frames(n, k * 4249, link, np.random.default_rng(2))) - link.processing_s for k in (1, 4)
    )
    assert four / one == pytest.approx(1.28, rel=0.02)


def lossy(loss, n_sends=3):
    return Link(source="test", label="Test", summary="Made up", processing_s=0.01, median_s=0.02, floor_s=0.01,
                spread=0.2, uplink_bit_per_s=1e7, loss=loss, resend_s=0.2, n_sends=n_sends)  # fmt: skip


def test_lost_requests_come_late_or_never_in_the_stated_shares():
    arrivals = arrival_frames(np.zeros(40000), 100, lossy(0.3), np.random.default_rng(3))
    assert np.isinf(arrivals).mean() == pytest.approx(0.3**3, rel=0.1)
    late = (arrivals > 0.2) & (arrivals < 0.4)
    assert late.mean() == pytest.approx(0.3 * 0.7, rel=0.03)


def test_a_link_that_loses_all_delivers_nothing_and_one_that_loses_none_delivers_all():
    assert np.isinf(arrival_frames([0, 1], 100, lossy(1.0), np.random.default_rng(0))).all()
    assert np.isfinite(arrival_frames(np.zeros(999), 100, lossy(0.0), np.random.default_rng(0))).all()


def test_arrivals_are_seeded_and_shift_with_their_triggers():
    triggers = np.array([0.5, 0.1, 3.0])
    first, again = (arrival_frames(triggers, 100, lossy(0.3), np.random.default_rng(4)) for _ in range(2))
    later = arrival_frames(triggers + 10, 100, lossy(0.3), np.random.default_rng(4))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_allclose(later, first + 10)


def test_a_phone_that_estimates_itself_waits_for_nothing():
    np.testing.assert_array_equal(arrival_frames([0.0, 2.0], 100, None, np.random.default_rng(0)), [0.0, 2.0])
    assert arrival_frames([], 100, lossy(0.1), np.random.default_rng(0)).shape == (0,)


def test_negative_payloads_are_refused():
    with pytest.raises(ValueError, match="0 or more bytes"):
        arrival_frames([0.0], -1, lossy(0.1), np.random.default_rng(0))


def test_a_link_faster_than_its_floor_is_refused():
    with pytest.raises(ValueError, match="floor_s: expected at most median_s"):
        Link(**{**vars(lossy(0.1)), "floor_s": 0.5})
    with pytest.raises(ValueError, match="n_sends: expected a whole number"):
        Link(**{**vars(lossy(0.1)), "n_sends": 1.5})


# -------------------------------------------------------------------------------------------------- estimates under way

FRAMES_S = np.arange(40) / 24
UNSTEADY = replace(LINKS["lte"], loss=0.4, resend_s=0.1, n_sends=2)
"""Every sixth request is lost, and one that was sent twice may be overtaken."""


def estimate(number, *, is_valid=True):
    return LightEstimate(np.full((9, 3), float(number)), 1.0, 0.5, "truth", is_valid)


def session(link, seed, names=("a", "b")):
    """Every position asks in every frame; requests by position."""
    under_way = EstimatesUnderWay(link, seed)
    asked = {
        name: [
            under_way.ask(name, estimate(i, is_valid=i % 5 != 4), frame=i, asked_s=t, payload_bytes=4249)
            for i, t in enumerate(FRAMES_S)
        ]
        for name in names
    }
    return under_way, asked


def test_without_a_link_every_valid_estimate_is_there_at_once():
    under_way, asked = session(None, 0)
    for i, t in enumerate(FRAMES_S):
        last_valid = i - 1 if i % 5 == 4 else i
        assert under_way.in_use("a", t).frame == last_valid
    assert all(request.latency_s == 0 for request in asked["a"])


@pytest.mark.parametrize("seed", range(5))
def test_the_light_is_the_youngest_valid_estimate_that_has_arrived(seed):
    under_way, asked = session(UNSTEADY, seed)
    requests = asked["a"]
    overtaken = [later.arrival_s < request.arrival_s for request, later in itertools.pairwise(requests)]
    assert any(overtaken) and any(request.latency_s is None for request in requests)
    for t in np.linspace(-0.1, 3, 200):
        there = [i for i, r in enumerate(requests) if r.arrival_s <= t and r.estimate.is_valid]
        found = under_way.in_use("a", t)
        assert found is (requests[max(there)] if there else None)


def test_luck_depends_on_seed_frame_and_position_and_on_nothing_else():
    _, asked = session(UNSTEADY, 3)
    _, alone = session(UNSTEADY, 3, names=("b",))
    _, other = session(UNSTEADY, 4)
    arrivals = {key: [r.arrival_s for r in requests] for key, requests in asked.items()}
    assert [r.arrival_s for r in alone["b"]] == arrivals["b"]
    assert arrivals["a"] != arrivals["b"] and [r.arrival_s for r in other["a"]] != arrivals["a"]


def test_a_position_that_never_asked_has_no_light():
    assert EstimatesUnderWay(None, 0).in_use("nobody", 1.0) is None


def test_of_estimates_that_were_asked_for_at_the_same_time_the_last_one_is_in_use():
    """As in a session whose frames have no times."""
    under_way, estimate = EstimatesUnderWay(None, 0), LightEstimate(np.zeros((9, 3)), 1.0, 0.5, "test")
    for frame in range(3):
        under_way.ask("a", estimate, frame=frame, asked_s=0.0, payload_bytes=0)
        assert under_way.in_use("a", 0.0).frame == frame
