"""Several servers with one Redis: sessions go on at any of them, and outlive servers and store."""

import json
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest

from addon_tests.pure.edge_servers import EdgeServer, published_body
from addon_tests.pure.made import random_cloud
from addon_tests.pure.redis_servers import RedisServer
from xihenet.codec import encode_cloud
from xihenet.edge.batching import Inference
from xihenet.edge.client import EdgeBackend
from xihenet.edge.http_settings import ServerSettings
from xihenet.edge.server import bound
from xihenet.edge.workers import serve_by_workers
from xihenet.records import UnitSphereCloud

pytestmark = pytest.mark.wheel_only("a whole Blender has neither Tornado nor redis-py")
N = 512


@pytest.fixture(scope="module")
def redis_server(tmp_path_factory):
    with RedisServer(tmp_path_factory.mktemp("redis")) as server:
        yield server


@pytest.fixture
def two(redis_server):
    """Two servers with one store; in one process here, but they share nothing else."""
    inference, settings = Inference("projection"), ServerSettings(port=0, store=redis_server.url)
    with EdgeServer(settings, inference) as one, EdgeServer(settings, inference) as other:
        yield one, other


def clouds(n, share=0.3):
    rng = np.random.default_rng(0)
    return [random_cloud(rng, N, share) for _ in range(n)]


def published_lights(servers, bodies):
    _, opened, _ = servers[0].ask("POST", "/api/v2/session/", Anchor_Size=str(N))
    ask = ["POST", "/api/v2/lighting-estimation/"]
    return [
        servers[n % len(servers)].ask(*ask, body, Session_ID=opened["sid"])[1]["coefficients"]
        for n, body in enumerate(bodies)
    ]


def test_a_session_goes_on_at_another_server_with_the_same_light(two):
    bodies = [published_body(cloud) for cloud in clouds(6)]
    with EdgeServer() as alone:
        assert published_lights(two, bodies) == published_lights([alone], bodies)


def test_tokens_clients_and_deletions_hold_at_all_servers(two):
    one, other = two
    session, token = one.opened(n_anchors=N)
    status, joined, _ = other.ask("POST", f"/api/v3/sessions/{session}/clients")
    assert status == 201
    payload = encode_cloud(clouds(1)[0], "float32_stripped")
    assert one.light(session, token, payload)[0] == 200
    assert one.light(session, joined["token"], payload)[0] == 200
    assert one.light(session, "x" * 32, payload)[0] == 403
    _, listed, _ = other.ask("GET", "/api/v3/sessions", Xihe_Token=token)
    assert [(told["session"], told["n_clients"]) for told in listed["sessions"]] == [(session, 1)]
    assert list(listed["sessions"][0]["positions"]) == ["vase"]
    assert one.ask("DELETE", f"/api/v3/sessions/{session}", Xihe_Token=token)[0] == 200
    assert other.light(session, token, payload)[0] == one.light(session, token, payload)[0] == 404


def test_of_what_many_send_at_once_to_one_position_no_anchor_is_lost(two):
    session, token = two[0].opened(n_anchors=N)
    rng = np.random.default_rng(1)
    of_sender = rng.integers(8, size=(4, N))  # In each of four rounds, each anchor is seen by one of eight.

    def send(n_round, sender):
        is_set = of_sender[n_round] == sender
        cloud = UnitSphereCloud(0.5 * np.outer(is_set, np.ones(3)), 1.0 * is_set, is_set)
        return two[sender % 2].light(session, token, encode_cloud(cloud, "float32_stripped"), position=str(n_round))

    with ThreadPoolExecutor(8) as senders:
        for n_round in range(4):
            answers = list(senders.map(send, [n_round] * 8, range(8)))
            assert [status for status, _ in answers] == [200] * 8
            assert max(answer["coverage"] for _, answer in answers) == 1.0


@pytest.mark.slow
def test_a_store_that_is_killed_is_said_and_sessions_go_on_once_it_is_back(two, redis_server):
    session, token = two[0].opened(n_anchors=N)
    first, second = clouds(2)
    payloads = [encode_cloud(cloud, "float32_stripped") for cloud in (first, second)]
    assert two[0].light(session, token, payloads[0])[0] == 200
    redis_server.kill()
    try:
        for server in two:
            status, answer, headers = server.ask("GET", f"/api/v3/sessions/{session}", Xihe_Token=token)
            assert (
                status == 503
                and "Redis, which keeps the sessions, does not answer" in answer["error"]
                and headers["Retry-After"] == "1"
            )
            assert server.ask("POST", "/api/v3/sessions")[0] == server.light(session, token, payloads[1])[0] == 503
            status, health, headers = server.ask("GET", "/health")
            assert status == 503 and headers["Retry-After"] == "1"
            assert (health["ok"], health["store"]) == (False, "redis") and "does not answer" in health["error"]
            metrics = server.ask("GET", "/metrics")[1]
            assert "xihe_store_up 0" in metrics and re.search('what="store_lost"} [1-9]', metrics)
    finally:
        redis_server.start()
    until = time.monotonic() + 10
    while not all(server.ask("GET", "/health")[0] == 200 for server in two):
        assert time.monotonic() < until
        time.sleep(0.05)
    status, answer = two[1].light(session, token, payloads[1])
    assert status == 200 and answer["coverage"] == (first.is_set | second.is_set).mean()


def test_workers_do_not_join_those_of_another_server_at_its_port():
    with closing(bound(ServerSettings(port=0, worker=0))) as another:
        another.listen()
        settings = ServerSettings(port=another.getsockname()[1])
        with pytest.raises(OSError, match="in use"):
            serve_by_workers(Inference("projection"), settings, 0, pytest.fail, log_to=2)


@pytest.mark.slow
def test_workers_share_a_port_and_one_that_dies_is_started_anew(redis_server):
    command = [sys.executable, "-m", "xihe_blender", "serve", "--estimator", "projection", "--port", "0"]
    command += ["--workers", "2", "--store", redis_server.url]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with ExitStack() as ending:
        ending.callback(process.communicate)
        ending.callback(process.kill)
        port = int(re.search(r":(\d+), Ctrl-C", process.stdout.readline())[1])
        backend = ending.enter_context(closing(EdgeBackend(f"http://127.0.0.1:{port}", N)))
        cloud = clouds(1)[0]
        before = backend.estimate(cloud)
        assert answering(port, 40) == {"0", "1"}
        kill(workers_of(process)[0])
        assert np.array_equal(backend.estimate(cloud), before) and backend.n_opened == 1
        logged = [json.loads(process.stderr.readline()) for _ in range(4)]
        assert [line["event"] for line in logged] == ["started", "started", "worker ended", "started"]
        assert {line["worker"] for line in logged[:2]} == {0, 1} and logged[3]["worker"] == logged[2]["worker"]
        ended = workers_of(process)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
        assert len(ended) == 2 and not any(Path(f"/proc/{pid}").exists() for pid in ended)


def answering(port, n_tries):
    """The workers that answer at a port, each time asked by a new connection."""
    server, found = EdgeServer(), set()
    server.port = port
    for _ in range(n_tries):
        found |= set(re.findall(r'xihe_store_up{worker="(\d+)"} 1', server.ask("GET", "/metrics")[1]))
    return found


def workers_of(process):
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return [pid for pid in children if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def kill(pid):
    subprocess.run(["kill", "-9", pid], check=True)
