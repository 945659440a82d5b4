"""Estimates between being asked for and arriving: the light in force against a plain look through all of them."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from xihenet.phone import LINKS, EstimatesUnderWay
from xihenet.records import LightEstimate

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
        assert under_way.in_force("a", t).frame == last_valid
    assert all(request.latency_s == 0 for request in asked["a"])


@pytest.mark.parametrize("seed", range(5))
def test_the_light_is_the_youngest_valid_estimate_that_has_arrived(seed):
    under_way, asked = session(UNSTEADY, seed)
    requests = asked["a"]
    overtaken = [later.arrival_s < request.arrival_s for request, later in itertools.pairwise(requests)]
    assert any(overtaken) and any(request.latency_s is None for request in requests)
    for t in np.linspace(-0.1, 3, 200):
        there = [i for i, r in enumerate(requests) if r.arrival_s <= t and r.estimate.is_valid]
        found = under_way.in_force("a", t)
        assert found is (requests[max(there)] if there else None)


def test_luck_depends_on_seed_frame_and_position_and_on_nothing_else():
    _, asked = session(UNSTEADY, 3)
    _, alone = session(UNSTEADY, 3, names=("b",))
    _, other = session(UNSTEADY, 4)
    arrivals = {key: [r.arrival_s for r in requests] for key, requests in asked.items()}
    assert [r.arrival_s for r in alone["b"]] == arrivals["b"]
    assert arrivals["a"] != arrivals["b"] and [r.arrival_s for r in other["a"]] != arrivals["a"]


def test_a_position_that_never_asked_has_no_light():
    assert EstimatesUnderWay(None, 0).in_force("nobody", 1.0) is None
