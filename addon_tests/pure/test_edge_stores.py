"""What every store of sessions promises, held against the one in memory and against a real Redis alike."""

from contextlib import closing
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from addon_tests.pure.made import random_cloud
from addon_tests.pure.redis_servers import RedisServer
from xihenet.codec import METHODS, decode_cloud, encode_cloud
from xihenet.edge.sessions import (
    MemoryStore,
    SeenPosition,
    SessionGone,
    StoreFull,
    StoreLimits,
    StoreLost,
    joined,
    new_session,
    new_token,
)
from xihenet.edge.stored import position_from_bytes, position_to_bytes, session_from_bytes, session_to_bytes
from xihenet.records import AnchorSurfaces, KeyLight, UnitSphereCloud

NEEDS_REDIS = pytest.mark.wheel_only("a whole Blender has no redis-py")
SEEN = SeenPosition(UnitSphereCloud.empty(8), n_frames=1)


class InMemory:
    def __init__(self):
        self.now = 0.0

    def store(self, **limits):
        return MemoryStore(StoreLimits(**limits), lambda: self.now)

    def stores(self, n, **limits):
        return [self.store(**limits)] * n

    def pass_time(self, seconds):
        self.now += seconds


class InRedis:
    """As if time had passed: what would expire later expires sooner, and what was used was used before."""

    def __init__(self, server):
        self._server, self._stores = server, []

    def store(self, **limits):
        from xihenet.edge.redis_store import RedisStore

        self._stores.append(RedisStore(self._server.url, StoreLimits(**limits)))
        return self._stores[-1]

    def stores(self, n, **limits):
        return [self.store(**limits) for _ in range(n)]

    def pass_time(self, seconds):
        with self._server.client() as client:
            for key in client.keys("xihe:1:session:*") + client.keys("xihe:1:owner:*"):
                client.pexpire(key, client.pttl(key) - round(1000 * seconds))
            for session_id in client.zrange("xihe:1:used", 0, -1):
                client.zincrby("xihe:1:used", -1000 * seconds, session_id)

    def close(self):
        for store in self._stores:
            store.close()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with RedisServer(tmp_path_factory.mktemp("redis")) as server:
        yield server


@pytest.fixture
def redis_server(server):
    """An empty one."""
    with server.client() as client:
        client.flushall()
    return server


@pytest.fixture(params=["memory", pytest.param("redis", marks=NEEDS_REDIS)])
def kept(request):
    if request.param == "memory":
        yield InMemory()
    else:
        with closing(InRedis(request.getfixturevalue("redis_server"))) as kept:
            yield kept


def session(owner=""):
    return new_session(8, "ldr", "unity", owner)


def added(store, n=1, **options):
    sessions = [session(**options) for _ in range(n)]
    for one in sessions:
        store.add(one)
    return sessions


def put(store, session_id, name, seen):
    """Whatever is there, as one that nobody overtakes."""
    return store.put_position(session_id, name, seen, store.position(session_id, name))


def test_an_idle_session_is_forgotten_and_a_used_one_kept(kept):
    store = kept.store(idle_s=100)
    idle, used = added(store, 2)
    kept.pass_time(80)
    assert store.session(used.id) == used
    kept.pass_time(40)
    assert store.session(idle.id) is None and store.session(used.id) == used
    assert store.counts() == (1, 0)


def test_whatever_asks_for_a_session_keeps_it_alive(kept):
    store = kept.store(idle_s=100)
    (one,) = added(store)
    put(store, one.id, "a", SEEN)
    uses = [
        lambda: store.positions(one.id),
        lambda: put(store, one.id, "a", SEEN),
        lambda: store.delete_position(one.id, "b"),
        lambda: store.replace(one, one),
    ]
    for use in uses:
        kept.pass_time(80)
        use()
    assert store.session(one.id) == one


def test_a_full_store_refuses_unless_a_session_was_idle_long(kept):
    store = kept.store(n_sessions=2, least_idle_s=50)
    first, second = added(store, 2)
    with pytest.raises(StoreFull, match="2 sessions"):
        store.add(session())
    kept.pass_time(60)
    store.session(first.id)
    store.add(session())
    assert store.session(first.id) == first and store.session(second.id) is None


def test_expired_sessions_make_room(kept):
    store = kept.store(n_sessions=2, idle_s=100)
    added(store, 2)
    kept.pass_time(120)
    assert added(store, 2) and store.counts() == (2, 0)


def test_positions_are_bounded_per_session_and_in_all(kept):
    store = kept.store(n_positions=3, n_positions_of_session=2, least_idle_s=50)
    one, two = added(store, 2)
    for name in "abb":
        assert put(store, one.id, name, SEEN)
    with pytest.raises(StoreFull, match="2 positions at most"):
        put(store, one.id, "c", SEEN)
    put(store, two.id, "a", SEEN)
    with pytest.raises(StoreFull, match="3 positions are known"):
        put(store, two.id, "b", SEEN)
    kept.pass_time(60)
    put(store, two.id, "b", SEEN)
    assert store.session(one.id) is None and store.counts() == (1, 2)
    assert store.delete_position(two.id, "a") and not store.delete_position(two.id, "a")
    assert set(store.positions(two.id)) == {"b"} and store.counts() == (1, 1)
    store.delete(two.id)
    assert store.counts() == (0, 0) and store.session(two.id) is None


@pytest.mark.parametrize("later_s", [60, 120])
def test_sessions_without_positions_make_no_room_for_one(kept, later_s):
    store = kept.store(n_positions=2, idle_s=100, least_idle_s=50)
    empty, one = added(store, 2)
    kept.pass_time(later_s)
    one = one if later_s == 60 else added(store, 1)[0]
    for name in "ab":
        put(store, one.id, name, SEEN)
    with pytest.raises(StoreFull, match="2 positions are known"):
        put(store, one.id, "c", SEEN)
    assert store.counts()[1] == 2 and (store.session(empty.id) is None) == (later_s == 120)


def test_what_is_not_there_is_not_kept_or_found(kept):
    store = kept.store()
    for nobody in ("nobody", "", "x" * 10_000, "\udcff", session().id):
        with pytest.raises(SessionGone):
            put(store, nobody, "a", SEEN)
        assert store.positions(nobody) == {} and store.session(nobody, is_fresh=False) is None
        assert store.session(nobody) is None and store.position(nobody, "a") is None
        assert not store.delete_position(nobody, "a")
        store.delete(nobody)
    gone = session()
    assert store.replace(gone, gone) and store.counts() == (0, 0)


def test_an_owner_lists_its_own_sessions(kept):
    store, mine = kept.store(idle_s=100), new_token()
    owned = added(store, 2, owner=mine)
    added(store, owner=new_token())
    added(store)
    assert sorted(store.owned_by(mine), key=owned.index) == owned
    assert store.owned_by("") == store.owned_by(new_token()) == []
    kept.pass_time(80)
    assert store.session(owned[1].id) == owned[1]
    kept.pass_time(40)
    assert store.owned_by(mine) == owned[1:]


def test_of_two_who_join_at_once_none_is_lost(kept):
    store, tokens = kept.store(), [new_token(), new_token()]
    (before,) = added(store, owner=new_token())
    first, second = (joined(before, token, StoreLimits()) for token in tokens)
    assert store.replace(first, before) and not store.replace(second, before)
    assert store.session(before.id) == first
    assert store.replace(joined(first, tokens[1], StoreLimits()), first)
    assert all(store.session(before.id).admits(token) for token in tokens)


def test_of_two_who_merge_at_once_the_second_merges_again(kept):
    store = kept.store()
    (one,) = added(store)
    first, second, third = (SeenPosition(random_cloud(np.random.default_rng(n), 8)) for n in range(3))
    assert store.put_position(one.id, "a", first, None) and not store.put_position(one.id, "a", second, None)
    assert store.put_position(one.id, "a", second, first) and not store.put_position(one.id, "a", third, first)
    assert_equal(store.position(one.id, "a"), second)
    assert store.delete_position(one.id, "a")
    assert not store.put_position(one.id, "a", third, second) and store.positions(one.id) == {}


def test_what_another_worker_changed_is_merged_again(kept):
    one, two = kept.stores(2)
    (here,) = added(one)
    assert two.session(here.id) == here
    first, second, third = (SeenPosition(random_cloud(np.random.default_rng(n), 8)) for n in range(3))
    assert put(one, here.id, "a", first) and put(two, here.id, "a", second)
    before = one.position(here.id, "a")
    if before.mark != second.mark:  # As it was, of the store that remembers.
        assert not one.put_position(here.id, "a", third, before)
    assert_equal(one.position(here.id, "a"), second)
    assert put(one, here.id, "a", third) and two.delete_position(here.id, "a")
    assert put(two, here.id, "a", first)
    if not one.put_position(here.id, "a", second, one.position(here.id, "a")):
        assert_equal(one.position(here.id, "a"), first)


def test_positions_come_back_whole(kept):
    store, seen = kept.store(), made_position(np.random.default_rng(0), 8)
    (one,) = added(store)
    for name in ("vase", "the big ✓", "session"):
        put(store, one.id, name, seen)
        assert_equal(store.position(one.id, name), seen)
    assert set(store.positions(one.id)) == {"vase", "the big ✓", "session"} and store.session(one.id) == one


def test_a_session_that_another_worker_deleted_refuses_positions(kept):
    one, two = kept.stores(2)
    (here,) = added(one)
    assert put(one, here.id, "a", SEEN) and one.session(here.id, is_fresh=False) == here
    two.delete(here.id)
    one.session(here.id, is_fresh=False)
    with pytest.raises(SessionGone):
        put(one, here.id, "a", SEEN)
    assert one.session(here.id, is_fresh=False) is None and one.session(here.id) is None


@NEEDS_REDIS
@pytest.mark.parametrize(("field", "stored"), [("session", b"\x80\x04pickle"), ("at:a", b"\x02"), ("at:a", b"")])
def test_bytes_that_are_not_ours_are_no_session(field, stored, redis_server):
    with closing(InRedis(redis_server)) as kept, redis_server.client() as client:
        writer, store = kept.stores(2)
        (one,) = added(writer)
        put(writer, one.id, "a", SEEN)
        client.hset(f"xihe:1:session:{one.id}", field, stored)
        assert (store.session(one.id) if field == "session" else store.position(one.id, "a")) is None
        assert store.n_unreadable == 1
        with pytest.raises(SessionGone):
            put(writer, one.id, "a", SEEN)
        assert writer.session(one.id) is None
        client.set(f"xihe:1:session:{one.id}", b"not a hash")
        assert store.session(one.id) is None and store.n_unreadable == 2
        assert store.counts() == (1, 1)  # Until it would have expired.
        kept.pass_time(1000)
        assert store.counts() == (0, 0)


@NEEDS_REDIS
def test_a_store_that_hangs_or_was_killed_is_lost_for_a_moment(redis_server, monkeypatch):
    from xihenet.edge import redis_store

    monkeypatch.setattr(redis_store, "PAUSE_S", 0.0)
    with closing(InRedis(redis_server)) as kept:
        store = kept.store()
        (one,) = added(store)
        put(store, one.id, "a", SEEN)
        redis_server.hang()
        with pytest.raises(StoreLost):
            store.session(one.id)
        redis_server.wake()
        assert store.session(one.id) == one
        redis_server.kill()
        for ask in (store.check, store.counts, lambda: store.session(one.id)):
            with pytest.raises(StoreLost):
                ask()
        redis_server.start()
        assert store.session(one.id) == one and set(store.positions(one.id)) == {"a"} and store.keeps_a_file()


@NEEDS_REDIS
def test_a_store_that_refuses_is_lost_and_says_why(redis_server, monkeypatch):
    from xihenet.edge import redis_store

    monkeypatch.setattr(redis_store, "PAUSE_S", 0.0)
    with closing(InRedis(redis_server)) as kept, redis_server.client() as client:
        store = kept.store()
        client.config_set("min-replicas-to-write", 1)  # It refuses all that writes, as where its disk is full.
        try:
            for ask in (store.check, lambda: added(store)):
                with pytest.raises(StoreLost, match="refuses") as lost:
                    ask()
                assert "replicas" in str(lost.value.__cause__)
        finally:
            client.config_set("min-replicas-to-write", 0)
        (one,) = added(store)
        assert store.session(one.id) == one
    with closing(redis_store.RedisStore(redis_server.url[:-1] + "99")) as store, pytest.raises(StoreLost) as lost:
        store.keeps_a_file()
    assert "DB index is out of range" in str(lost.value.__cause__)


@NEEDS_REDIS
def test_in_a_full_memory_sessions_are_used_and_forgotten_as_before(redis_server):
    with closing(InRedis(redis_server)) as kept, redis_server.client() as client:
        store = kept.store()
        kept_one, *_ = added(store, 3, owner=new_token())
        put(store, kept_one.id, "a", SEEN)
        kept.pass_time(60)
        assert store.session(kept_one.id)
        kept.pass_time(550)
        client.config_set("maxmemory", 1)
        try:
            with pytest.raises(StoreFull, match="memory is full"):
                put(store, kept_one.id, "b", SEEN)
            assert store.session(kept_one.id) == kept_one and set(store.positions(kept_one.id)) == {"a"}
            assert store.counts() == (1, 1)
            store.delete(kept_one.id)
            assert store.counts() == (0, 0)
        finally:
            client.config_set("maxmemory", 0)


def made_position(rng, n, *, is_bare=False, has_moved=False):
    cloud = random_cloud(rng, n)
    if is_bare:
        return SeenPosition(cloud)
    facing = AnchorSurfaces.of_facing(rng.uniform(-1, 1, n) * cloud.is_set)
    beside_m = rng.normal(size=(n, 3)) * cloud.is_set[:, None] if has_moved else None
    cloud = UnitSphereCloud(cloud.srgb, cloud.distance_m, cloud.is_set, surfaces=facing, beside_m=beside_m)
    key = KeyLight(rng.normal(size=3), rng.random(3), float(rng.random()), bool(rng.integers(2)))
    return SeenPosition(cloud, float(rng.uniform(1e-6, 1e6)), rng.normal(size=3), key, int(rng.integers(2**32)))


def assert_equal(a, b):
    np.testing.assert_equal(asdict(a), asdict(b))


@given(seed=st.integers(0, 2**32), n=st.integers(0, 70), is_bare=st.booleans(), has_moved=st.booleans())
@settings(max_examples=100, deadline=None)
def test_a_position_is_the_same_after_its_bytes(seed, n, is_bare, has_moved):
    seen = made_position(np.random.default_rng(seed), n, is_bare=is_bare, has_moved=has_moved)
    assert_equal(position_from_bytes(position_to_bytes(seen)), seen)


@given(seed=st.integers(0, 2**32), n=st.integers(0, 70), method=st.sampled_from(list(METHODS)))
@settings(max_examples=60, deadline=None)
def test_a_cloud_as_phones_send_it_is_the_same_after_its_bytes_and_short(seed, n, method):
    cloud = decode_cloud(encode_cloud(random_cloud(np.random.default_rng(seed), n), method), n, method)
    seen, n_set = SeenPosition(cloud), int(cloud.is_set.sum())
    stored = position_to_bytes(seen)
    assert_equal(position_from_bytes(stored), seen)
    if "16" in method and n:
        each = 8 if cloud.surfaces is None else 12
        assert len(stored) == len(position_to_bytes(SeenPosition(UnitSphereCloud.empty(n)))) + each * n_set


@given(
    seed=st.integers(0, 2**32),
    at=st.integers(0, 10_000),
    put=st.binary(max_size=8),
    cut=st.booleans(),
    has_moved=st.booleans(),
)
@example(seed=0, at=4041, put=b"\x00\x80\x7f", cut=False, has_moved=False)
@example(seed=0, at=1993, put=b"\x00\x80\x7f", cut=False, has_moved=False)
@settings(max_examples=200, deadline=None)
def test_bytes_that_were_changed_are_refused_or_a_legal_position(seed, at, put, cut, has_moved):
    stored = position_to_bytes(made_position(np.random.default_rng(seed), 9, has_moved=has_moved))
    at %= len(stored)
    changed = stored[:at] + put + (b"" if cut else stored[at + len(put) :])
    try:
        seen = position_from_bytes(changed)
    except ValueError:
        return
    assert_equal(position_from_bytes(position_to_bytes(seen)), seen)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_not_finite_is_refused(value):
    rng = np.random.default_rng(1)
    seen = made_position(rng, 9)
    bare, moved = position_to_bytes(SeenPosition(seen.cloud)), position_to_bytes(made_position(rng, 9, has_moved=True))
    for stored, at, kind in [
        (position_to_bytes(seen), 18, "<f8"),  # exposure
        (position_to_bytes(seen), 26, "<f8"),  # position
        (position_to_bytes(seen), 50, "<f8"),  # key light
        (bare, 28, "<f4"),  # colour of the first set anchor
        (bare, len(bare) - 4 * (1 + int(seen.cloud.is_set.sum())), "<f4"),  # distance of the last one
        (bare, len(bare) - 4, "<f4"),  # facing of the last one
        (moved, len(moved) - 4, "<f4"),  # what the last one shows
    ]:
        changed = bytearray(stored)
        changed[at : at + np.dtype(kind).itemsize] = np.array([value], kind).tobytes()
        with pytest.raises(ValueError, match="expected"):
            position_from_bytes(bytes(changed))


@given(
    n_clients=st.integers(0, 16),
    is_joinable=st.booleans(),
    is_owned=st.booleans(),
    axes=st.sampled_from(["unity", "z-up"]),
)
@settings(max_examples=30, deadline=None)
def test_a_session_is_the_same_after_its_bytes(n_clients, is_joinable, is_owned, axes):
    one = new_session(1280, "hdr", axes, new_token() if is_owned else "", joinable=is_joinable)
    for _ in range(n_clients):
        one = joined(one, new_token(), StoreLimits())
    assert session_from_bytes(one.id, session_to_bytes(one)) == one


WRONG_SESSIONS = [
    b"",
    b'\x02[8,"ldr","unity","",[],true,1.0]',
    b'\x01[8,"ldr","unity","",[],true]',
    b'\x01["8","ldr","unity","",[],true,1.0]',
    b'\x01[8,"dim","unity","",[],true,1.0]',
    b'\x01[8,"ldr","unity","mine",[],true,1.0]',
    b'\x01[8,"ldr","unity","",[1],true,1.0]',
    b'\x01[8,"ldr","sideways","",[],true,1.0]',
    b'\x01[8,["ldr"],{},"",[],true,1.0]',
    b"\x01" + b"[" * 100_000,
    b"\x01null",
    b"\x01\xff",
    b'\x01[8,"ldr",{},"",[],true,1.0]',
    b'\x01[8,"ldr","unity",null,[],true,1.0]',
    b'\x01[8,"ldr","unity","",[],true,NaN]',
]


@pytest.mark.parametrize("stored", WRONG_SESSIONS, ids=lambda stored: repr(stored[:20]))
def test_a_session_with_wrong_fields_is_refused(stored):
    with pytest.raises(ValueError, match=r"^session: expected (version 1|its fields)|there are no axes 'sideways'"):
        session_from_bytes("", stored)
