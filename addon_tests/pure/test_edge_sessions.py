"""Sessions are for those who hold their tokens, and what a position shares looks right from another."""

import asyncio

import numpy as np
import pytest

from addon_tests.pure.made import random_cloud
from xihenet.buffers import merge
from xihenet.edge.batching import Inference
from xihenet.edge.extras import Wishes
from xihenet.edge.metrics import Metrics
from xihenet.edge.protocol import CloudSent
from xihenet.edge.service import EdgeService
from xihenet.edge.sessions import (
    MemoryStore,
    SeenPosition,
    SessionGone,
    StoreFull,
    StoreLimits,
    StoreLost,
    hash_of,
    joined,
    new_session,
    new_token,
)
from xihenet.edge.sharing import re_exposed, with_others
from xihenet.records import UnitSphereCloud
from xihenet.sampling import sample_again
from xihenet.sphere import AnchorLattice


def session(owner=""):
    return new_session(8, "ldr", "unity", owner)


def test_a_token_opens_its_own_session_alone():
    mine, other = new_token(), new_token()
    kept = session(mine)
    assert kept.admits(mine) and kept.is_owned_by(mine) and not kept.is_published
    assert not kept.admits(other) and not kept.admits("") and not kept.is_owned_by("")
    assert mine not in repr(kept)


def test_who_joined_may_estimate_but_does_not_own():
    token = new_token()
    kept = joined(session(new_token()), token, StoreLimits())
    assert kept.admits(token) and not kept.is_owned_by(token)
    with pytest.raises(StoreFull, match="0 clients"):
        joined(kept, token, StoreLimits(n_clients_of_session=0))


def test_a_published_session_admits_no_token():
    assert session().is_published and not session().admits("") and not session().is_owned_by("")
    assert not session().admits(hash_of(""))


@pytest.mark.parametrize("error", [StoreFull, StoreLost, SessionGone])
def test_a_key_light_that_cannot_be_kept_is_told_all_the_same(error):
    class NoKeys(MemoryStore):
        def put_position(self, session_id, name, seen, before):
            if seen.key is not None:
                raise error
            return super().put_position(session_id, name, seen, before)

    async def answered():
        service = EdgeService(Inference("projection"), store=NoKeys())
        lit = service.open(new_session(512, "ldr", "z-up", new_token()))
        bright = np.where(AnchorLattice(512).directions[:, 2] > 0.97, 1.0, 0.2)
        lamp = UnitSphereCloud(np.outer(bright, np.ones(3)), np.ones(512), np.ones(512, bool))
        try:
            return await service.estimate(lit, "a", CloudSent(lamp), Wishes(has_key_light=True))
        finally:
            await service.close()

    assert asyncio.run(answered())["key_light"] is not None


def test_what_another_position_has_seen_fills_what_this_one_has_not():
    lattice, rng = AnchorLattice(512), np.random.default_rng(0)
    own, other = random_cloud(rng, 512, 0.3), random_cloud(rng, 512, 0.9)
    here = np.array([1.0, 2, 3])
    seen = SeenPosition(own, position_m=here)
    shared = with_others(seen, [SeenPosition(other, position_m=here)], lattice)
    expected = merge(other, own)
    assert np.array_equal(shared.srgb[own.is_set], own.srgb[own.is_set])
    assert np.mean(shared.is_set == expected.is_set) > 0.99  # A point on a border may go to the anchor beside.
    too_far = SeenPosition(other, position_m=here + [9, 0, 0])
    assert with_others(seen, [too_far, SeenPosition(other)], lattice) is own
    darker = with_others(seen, [SeenPosition(other, 2.0, here)], lattice)
    assert (darker.srgb <= shared.srgb + 1e-6).all() and darker.srgb.sum() < shared.srgb.sum()


def test_a_shared_point_lies_where_it_is_from_here():
    lattice = AnchorLattice(2048)
    ahead = int(lattice.nearest([[0, 1, 0]])[0])
    is_set = np.arange(2048) == ahead
    other = UnitSphereCloud(0.5 * np.outer(is_set, np.ones(3)), 2.0 * is_set, is_set)
    here = SeenPosition(UnitSphereCloud.empty(2048), position_m=np.array([2.0, 0, 0]))
    shared = with_others(here, [SeenPosition(other, position_m=np.zeros(3))], lattice)
    (found,) = np.flatnonzero(shared.is_set)
    assert lattice.directions[found] @ [-np.sqrt(0.5), np.sqrt(0.5), 0] > 0.995
    assert np.isclose(shared.distance_m[found], np.sqrt(8), rtol=0.05)


def test_re_exposing_clips_at_white_and_keeps_black():
    cloud = random_cloud(np.random.default_rng(5), 64)
    assert re_exposed(cloud, 1.0) is cloud
    assert np.isclose(re_exposed(cloud, 1e6).srgb.max(), 1) and not re_exposed(cloud, 4.0).srgb[~cloud.is_set].any()
    assert np.allclose(re_exposed(re_exposed(cloud, 0.25), 4.0).srgb, cloud.srgb, atol=1e-6)


def test_a_re_exposed_cloud_lies_where_it_lay():
    lattice = AnchorLattice(64)
    moved = sample_again(random_cloud(np.random.default_rng(5), 64), [0.1, 0, 0], lattice)
    again, expected = (sample_again(one, [0.1, 0, 0], lattice) for one in (re_exposed(moved, 0.5), moved))
    assert np.array_equal(again.distance_m, expected.distance_m)


def test_metrics_are_prometheus_text():
    metrics = Metrics()
    metrics.count("xihe_requests_total", route="/", status="200")
    metrics.count("xihe_requests_total", 2, route="/", status="200")
    metrics.measure("xihe_stage_seconds", 0.003, stage="decode")
    lines = metrics.text({"xihe_queue": 4}).splitlines()
    assert 'xihe_requests_total{route="/",status="200"} 3' in lines
    assert 'xihe_stage_seconds_bucket{stage="decode",le="0.002"} 0' in lines
    assert 'xihe_stage_seconds_bucket{stage="decode",le="0.005"} 1' in lines
    assert 'xihe_stage_seconds_bucket{stage="decode",le="+Inf"} 1' in lines
    assert "xihe_queue 4" in lines and metrics.counter("xihe_requests_total", route="/", status="200") == 3
