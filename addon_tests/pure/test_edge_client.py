"""The backend at the other end: the light of here and there are one, and a lost server costs no light."""

import contextlib
import gc
import json
import socket
import ssl
import threading
import time
import weakref
from dataclasses import replace

import numpy as np
import pytest
import trustme

from addon_tests.pure.edge_servers import NEEDS_TORNADO, DelayingProxy, EdgeServer, free_port
from addon_tests.pure.made import frame_of, random_cloud, with_facing
from addon_tests.pure.recordings import walk
from xihenet import estimators
from xihenet.backend import InferenceBackend, LocalBackend, NoAnswer, estimate_light, estimate_lights
from xihenet.camera import unproject_frame
from xihenet.controller import ControllerSettings, XiheController
from xihenet.edge import client
from xihenet.edge.batching import Inference
from xihenet.edge.client import EdgeBackend, backend_at
from xihenet.edge.connection import EdgeRefused, Patience, PatientConnection, TryAgain
from xihenet.edge.http_settings import ServerSettings
from xihenet.edge.service import ServiceSettings
from xihenet.edge.sessions import StoreLimits
from xihenet.estimators import EstimateContext
from xihenet.metrics import shc_rmse
from xihenet.phone.network import LINKS, arrival_frames
from xihenet.records import Intrinsics, LightEstimate, PointCloud, UnitSphereCloud
from xihenet.trigger import TriggerSettings

pytestmark = NEEDS_TORNADO
N = 512
QUICK = Patience(timeout_s=2.0, n_tries=3, first_wait_s=0.01, longest_wait_s=0.05, rest_s=0.2)
SMALL = Intrinsics(32, 24, 18.0, 18.0, 16.0, 12.0)
EAGER = ControllerSettings(TriggerSettings(theta=0.0, coverage_theta=0.0))
"""Estimates in every frame that shows anything new."""


@pytest.fixture(scope="module")
def server():
    with EdgeServer(inference=Inference("lattice")) as server:
        yield server


@pytest.fixture
def backend_to():
    """Makes backends to a server, closed at the end."""
    with contextlib.ExitStack() as stack:

        def make(server, **settings):
            settings = {"n_anchors": N, "patience": QUICK} | settings
            return stack.enter_context(contextlib.closing(EdgeBackend(f"http://127.0.0.1:{server.port}", **settings)))

        yield make


@pytest.mark.parametrize("target", ["ldr", "hdr"])
@pytest.mark.parametrize("share", [0.005, 0.5, 1.0])
def test_here_and_there_the_same_cloud_gives_the_same_light(server, backend_to, target, share):
    rng = np.random.default_rng(0)
    backend, local = backend_to(server, target=target), estimators.load("lattice", N, target)
    frame = frame_of(np.ones((2, 2)), exposure=0.5, ambient=[0.2, 0.3, 0.4])
    assert isinstance(backend, InferenceBackend) and backend.name == "lattice" and backend.farthest_m == 100
    for context in (
        EstimateContext(),
        EstimateContext(frame, position_m=np.zeros(3), reference_exposure=0.7),
        EstimateContext(frame_of(np.ones((2, 2))), reference_exposure=0.7),
    ):
        cloud = with_facing(random_cloud(rng, N, share), rng)
        here, there = local.estimate_with_error(cloud, context), backend.estimate_with_error(cloud, context)
        assert shc_rmse(here[0], there[0]) < 1e-3 and here[1] == pytest.approx(there[1], rel=0.01)


def test_without_rounding_the_lights_are_equal(server, backend_to):
    backend, local = backend_to(server, method="float32"), estimators.load("lattice", N, "ldr")
    cloud = random_cloud(np.random.default_rng(1), N)
    assert np.allclose(backend.estimate(cloud), local.estimate(cloud), atol=1e-6)


@pytest.mark.slow
def test_a_session_of_200_frames_loses_nothing_and_equals_the_local_one(server, backend_to):
    backend, local = backend_to(server, target="hdr"), LocalBackend(estimators.load("lattice", N, "hdr"))
    session = XiheController(backend, EAGER, others=[local])
    session.add_position("vase", (0.0, 1.0, 0.0))
    largest, n_estimates = 0.0, 0
    # As points alone, without the surfaces that a picture's points lie on, which take most of the time.
    frames = [(frame, replace(unproject_frame(frame), grid=None)) for frame in walk(SMALL, 50)]
    for number in range(200):
        frame, points = frames[number % len(frames)]
        # The light of the whole room goes up and down, so that every frame is worth an estimate.
        dimmed = PointCloud(points.points_m, points.srgb * (0.8 + 0.2 * np.sin(number)))
        report = session.step(frame, active=["vase"], points=dimmed)["vase"]
        if report.estimate is not None:
            assert report.estimate.is_valid
            n_estimates += 1
            largest = max(largest, shc_rmse(report.estimate.sh_radiance, report.estimate.others["lattice"]))
    assert n_estimates > 180 and largest < 1e-3
    assert (
        backend.n_answered == n_estimates
        and backend.connection.n_retries == backend.connection.n_failed == 0
        and backend.n_opened == 1
    )
    print(f"{n_estimates} estimates, largest SHC RMSE {largest:.1e}, {backend.state()}")


def test_a_server_that_was_restarted_gets_a_new_session_and_the_light_goes_on(backend_to):
    server = EdgeServer().start()
    backend = backend_to(server, patience=Patience(n_tries=60, first_wait_s=0.02, longest_wait_s=0.1))
    cloud = random_cloud(np.random.default_rng(2), N)
    before = backend.estimate(cloud)
    server.stop()
    restart = threading.Timer(0.3, server.start)
    restart.start()
    try:
        assert np.array_equal(backend.estimate(cloud), before)
    finally:
        restart.join()
        server.stop()
    assert (
        backend.n_opened == 2
        and backend.connection.n_retries > 0
        and "1 sessions lost and opened again" in backend.state()
    )


def test_while_the_server_is_lost_the_last_light_stays_and_the_trigger_asks_again(backend_to):
    server = EdgeServer().start()
    backend = backend_to(server)
    session = XiheController(backend, ControllerSettings(TriggerSettings(theta=0.0)))
    session.add_position("vase", (0.0, 1.0, 0.0))
    first, second = walk(SMALL, 2)
    session.step(first, active=["vase"])
    light = session.light("vase")
    server.stop()
    report = session.step(second, active=["vase"])["vase"]
    assert report.unknown_because == "no_answer" and not report.estimate.is_valid
    assert session.light("vase") is light
    assert "no answer from" in backend.state() and "the last light is kept" in backend.state()
    started = time.monotonic()
    assert session.step(second, active=["vase"])["vase"].unknown_because == "no_answer"
    assert time.monotonic() - started < 0.5  # It rests, and no frame waits for it.
    server.start()
    try:
        time.sleep(QUICK.rest_s)
        report = session.step(second, active=["vase"])["vase"]
        assert report.estimate.is_valid and session.light("vase") is report.estimate
        assert "no answer" not in backend.state()
    finally:
        server.stop()


def test_an_expired_session_is_opened_anew(server, backend_to):
    backend = backend_to(server)
    cloud = random_cloud(np.random.default_rng(3), N)
    light = backend.estimate(cloud)
    server.service.store.delete(backend._session["session"])
    assert np.array_equal(backend.estimate(cloud), light) and backend.n_opened == 2


class BadServer:
    """Answers connection after connection with the bytes of `answers`, then closes it; the last one for ever."""

    def __init__(self, *answers):
        self.answers, self.requests = list(answers), []
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self):
        while True:
            try:
                connection, _ = self._listening.accept()
            except OSError:
                return
            with connection, contextlib.suppress(OSError):
                self.requests.append(connection.recv(65536))
                answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
                if answer is None:
                    time.sleep(1.5)
                else:
                    connection.sendall(answer)

    def close(self):
        self._listening.close()


def answer_of(status, content, *headers):
    body = content if isinstance(content, bytes) else json.dumps(content).encode()
    lines = [f"HTTP/1.1 {status} X", f"Content-Length: {len(body)}", "Connection: close", *headers]
    return "\r\n".join(lines).encode() + b"\r\n\r\n" + body


OPENED = answer_of(201, {"ok": True, "session": "s", "token": "t", "estimator": "lattice", "farthest_m": 100})
LIGHT = answer_of(200, {"ok": True, "coefficients": [0.5] * 27, "exposure": 1, "expected_error": 0.1, "is_valid": True})


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        LIGHT[:-20],
        b"\x00\xff nonsense\r\n\r\n",
        answer_of(200, b"not JSON"),
        answer_of(503, {"ok": False, "error": "full"}, "Retry-After: 0"),
        answer_of(500, b"<html>"),
        answer_of(429, {"error": "slow down"}, "Retry-After: Wed, 21 Oct 2026 07:28:00 GMT"),
        None,
    ],
)
def test_what_may_pass_is_tried_again(bad):
    with contextlib.closing(BadServer(OPENED, bad, LIGHT)) as server:
        backend = EdgeBackend(f"http://127.0.0.1:{server.port}", N, patience=Patience(1.0, 3, 0.01))
        assert backend.estimate(random_cloud(np.random.default_rng(4), N))[0, 0] == 0.5
        assert backend.connection.n_retries == 1 and backend.n_answered == 1


def test_what_will_not_pass_is_said_at_once():
    with contextlib.closing(BadServer(answer_of(401, {"error": "this service needs its bearer token"}))) as server:
        with pytest.raises(EdgeRefused, match="bearer token"):
            EdgeBackend(f"http://127.0.0.1:{server.port}", N, patience=QUICK)
        assert len(server.requests) == 1


@pytest.mark.parametrize("bearer", ["secret\n", "secr\N{SNOWMAN}t"])
def test_a_bearer_token_that_no_header_can_carry_is_refused_without_being_shown(bearer):
    with pytest.raises(ValueError, match=r"^the bearer token has") as refused:
        EdgeBackend("http://127.0.0.1:9", N, patience=QUICK, bearer=bearer)
    assert "secr" not in str(refused.value)


def test_a_proxy_that_answers_with_a_page_is_said():
    page = answer_of(502, b"<html>Bad Gateway</html>", "Content-Type: text/html; charset=utf-8")
    with contextlib.closing(BadServer(page)) as server:
        url = f"http://127.0.0.1:{server.port}"
        said = f"^{url} does not answer: something that is no edge service answers there, with text/html and status 502"
        with pytest.raises(NoAnswer, match=said):
            EdgeBackend(url, N, patience=QUICK)


def test_another_kind_of_service_is_said():
    refused = pytest.raises(EdgeRefused, match="is no edge service: its answer has no estimator")
    with contextlib.closing(BadServer(answer_of(200, {"status": "up"}))) as server, refused:
        EdgeBackend(f"http://127.0.0.1:{server.port}", N, patience=QUICK)


@pytest.mark.parametrize(
    "url",
    [
        "127.0.0.1:8550",
        "ftp://a",
        "http://",
        "http://a/b",
        "http://a:b",
        "http://[1",
        "",
        "http://a b",
        "http://1..2",
        "http://a:0",
    ],
)
def test_an_address_that_is_none_is_refused(url):
    with pytest.raises(ValueError, match="address of an edge service"):
        EdgeBackend(url)


def test_a_server_that_is_not_there_is_said_with_what_to_do(monkeypatch):
    monkeypatch.setattr(client, "OF_A_COMMAND", QUICK)
    said = "does not answer: ConnectionRefusedError.*refused: start xihe serve there, or leave --backend out"
    with pytest.raises(NoAnswer, match=said):
        backend_at(f"http://127.0.0.1:{free_port()}", "lattice", N, "ldr")


def test_a_command_says_which_estimator_the_server_has(server):
    with pytest.raises(ValueError, match="give --estimator lattice"):
        backend_at(f"http://127.0.0.1:{server.port}", "projection", N, "ldr")


def test_a_failure_keeps_nothing_of_its_attempts_alive():
    connections = []

    def attempt():
        here = {1}
        connections.append(weakref.ref(here))
        raise TryAgain("busy")

    gc.disable()
    try:
        with contextlib.suppress(NoAnswer):
            PatientConnection("http://127.0.0.1:9", QUICK).persist(attempt)
        assert [made() for made in connections] == [None] * QUICK.n_tries
    finally:
        gc.enable()


def test_a_key_with_a_password_is_refused_without_asking_for_it(tmp_path):
    from xihenet.edge.server import tls_of

    certificate, key = tmp_path / "certificate.pem", tmp_path / "key.pem"
    certificate.write_bytes(trustme.CA().issue_cert("localhost").cert_chain_pems[0].bytes())
    named = f"Proc-Type: 4,ENCRYPTED\nDEK-Info: AES-128-CBC,{'0' * 32}"
    key.write_text(f"-----BEGIN RSA PRIVATE KEY-----\n{named}\n\n{'A' * 64}\n-----END RSA PRIVATE KEY-----\n")
    with pytest.raises(ssl.SSLError):
        tls_of(ServerSettings(port=0, certificate=certificate, key=key))


def test_a_server_without_room_for_more_sessions_is_not_asked_for_them_in_every_frame(backend_to):
    settings = ServerSettings(port=0, service=ServiceSettings(limits=StoreLimits(n_sessions=1)))
    clouds = [random_cloud(np.random.default_rng(seed), N) for seed in range(2)]
    with EdgeServer(settings) as server:
        backend, n_refused = backend_to(server), []
        for _ in range(3):
            lights = backend.estimate_together(clouds, [EstimateContext()] * 2)
            assert all(isinstance(light, tuple) for light in lights)
            n_refused.append(server.service.metrics.counter("xihe_refused_total", what="store"))
        assert n_refused == [QUICK.n_tries] * 3


def test_over_tls_a_client_that_trusts_the_certificate_gets_light_and_another_says_why_not(tmp_path, monkeypatch):
    authority, certificate, key = trustme.CA(), tmp_path / "certificate.pem", tmp_path / "key.pem"
    issued = authority.issue_cert("127.0.0.1")
    issued.private_key_pem.write_to_path(key)
    certificate.write_bytes(b"".join(one.bytes() for one in issued.cert_chain_pems))
    settings = ServerSettings(port=0, certificate=certificate, key=key, bearer="secret", header_s=0.4)
    cloud = random_cloud(np.random.default_rng(8), N)
    with EdgeServer(settings) as server:
        url, local = f"https://127.0.0.1:{server.port}", estimators.load("projection", N)
        trusting = ssl.create_default_context()
        authority.configure_trust(trusting)
        with contextlib.closing(EdgeBackend(url, N, patience=QUICK, bearer="secret", tls=trusting)) as backend:
            assert shc_rmse(backend.estimate(cloud), local.estimate(cloud)) < 1e-3
            assert len(backend.estimate_together([cloud] * 2, [EstimateContext()] * 2)) == 2 == 1 + len(backend._beside)
        with pytest.raises(NoAnswer, match="CERTIFICATE_VERIFY_FAILED"):
            EdgeBackend(url, N, patience=QUICK, bearer="secret")
        monkeypatch.setattr(client, "OF_A_COMMAND", QUICK)
        with pytest.raises(NoAnswer, match="in the variable SSL_CERT_FILE, or leave --backend out"):
            backend_at(url, "projection", N, "ldr")
        with pytest.raises(NoAnswer):  # It speaks no TLS.
            EdgeBackend(url.replace("https", "http"), N, patience=QUICK, bearer="secret")
        # Who connects and never shakes hands is cut off like any other who is late.
        with socket.create_connection(("127.0.0.1", server.port), timeout=10) as silent:
            assert silent.recv(100) == b""


def test_the_simulated_network_tells_what_a_delayed_one_takes(server, backend_to):
    cloud, delay_s = random_cloud(np.random.default_rng(6), N), 0.04
    direct = backend_to(server)
    with (
        DelayingProxy(server.port, delay_s) as proxy,
        contextlib.closing(EdgeBackend(f"http://127.0.0.1:{proxy.port}", N, patience=QUICK)) as delayed,
    ):
        for _ in range(12):
            direct.estimate(cloud)
            delayed.estimate(cloud)
    # The link says what comes beside the work on the server: here a delay on the way there and one on the way back.
    link = replace(
        LINKS["wifi"], processing_s=float(np.median(direct.times_s)), median_s=2 * delay_s, floor_s=2 * delay_s,
        spread=0.0, loss=0.0,
    )  # fmt: skip
    simulated_s = arrival_frames([0.0], 4249, link, np.random.default_rng(0))[0]
    assert min(delayed.times_s) >= 2 * delay_s and np.median(delayed.times_s) == pytest.approx(simulated_s, rel=0.3)


def test_nothing_seen_is_not_asked(server, backend_to):
    backend = backend_to(server)
    light = estimate_light(backend, UnitSphereCloud.empty(N), EstimateContext(), 1.0)
    assert light.unknown_because == "nothing_seen" and backend.n_answered == 0
    with pytest.raises(ValueError, match="512 anchors"):
        backend.estimate(UnitSphereCloud.empty(8))


class Theirs(Inference):
    """An estimator of somebody's own that knows as much as `ambient`, or nothing of what is less than half seen."""

    def __init__(self):
        super().__init__("ambient")
        self.name = "theirs"

    def estimator(self, n_anchors, target):
        return estimators.load("ambient", n_anchors, target)

    def __call__(self, jobs):
        lights = zip(super().__call__(jobs), jobs, strict=True)
        unknown = LightEstimate(np.zeros((9, 3)), 1.0, 0.0, "lattice", False, None, "nothing_seen")
        return [unknown if 0 < job.cloud.is_set.mean() < 0.5 else light for light, job in lights]


def test_what_the_light_of_nothing_seen_is_the_servers_estimator_says(backend_to):
    with EdgeServer(inference=Theirs()) as server:
        backend = backend_to(server)
        frame = frame_of(np.ones((2, 2)), exposure=0.5, ambient=[0.2, 0.3, 0.4])
        context, empty = EstimateContext(frame), UnitSphereCloud.empty(N)
        local = LocalBackend(estimators.load("ambient", N))
        here, there = (estimate_light(one, empty, context, 0.5) for one in (local, backend))
        assert here.is_valid and there.is_valid and np.allclose(here.sh_radiance, there.sh_radiance, atol=1e-9)
        assert estimate_light(backend, empty, EstimateContext(), 1.0).unknown_because == "nothing_seen"
        little = random_cloud(np.random.default_rng(0), N, 0.1)
        assert estimate_light(backend, little, context, 0.5).unknown_because == "nothing_seen"


# ------------------------------------------------------------------------------------------------------------ together


@pytest.mark.parametrize("n", [1, 2, 4, 7])
def test_what_is_asked_for_together_is_what_comes_one_after_the_other(server, backend_to, n):
    rng, backend = np.random.default_rng(n), backend_to(server)
    clouds = [random_cloud(rng, N, share) for share in rng.uniform(0.1, 1, n)]
    clouds[-1] = UnitSphereCloud.empty(N) if n == 7 else clouds[-1]
    contexts = [EstimateContext(reference_exposure=1.0)] * n
    together = estimate_lights(backend, clouds, contexts, 1.0)
    for cloud, context, light in zip(clouds, contexts, together, strict=True):
        alone = estimate_light(backend, cloud, context, 1.0)
        np.testing.assert_allclose(light.sh_radiance, alone.sh_radiance, rtol=0, atol=1e-6)
        assert (light.is_valid, light.unknown_because) == (alone.is_valid, alone.unknown_because)
    assert light.is_valid == (n != 7)


def test_several_positions_have_the_light_of_a_local_session_and_leave_no_session_behind(server):
    before = server.service.store.counts()[0]
    backend = EdgeBackend(f"http://127.0.0.1:{server.port}", N, patience=QUICK)
    sessions = [XiheController(one, EAGER) for one in (backend, LocalBackend(estimators.load("lattice", N)))]
    frames = walk(SMALL, 4)
    names = [f"place {number}" for number in range(4)]
    for session in sessions:
        for number, name in enumerate(names):
            session.add_position(name, (0.2 * number, 0.5, 0.8))
    for i in range(4):
        there, here = (session.step(frames[i], active=names) for session in sessions)
        for name in names:
            assert shc_rmse(there[name].estimate.sh_radiance, here[name].estimate.sh_radiance) < 1e-3
            assert there[name].stage_ms["estimate"] > 0
    assert server.service.store.counts()[0] == before + 4 and "16 answers" in backend.state()
    backend.close()
    assert server.service.store.counts()[0] == before


def test_without_a_server_every_position_keeps_its_light():
    with EdgeServer(inference=Inference("projection")) as server:
        backend = EdgeBackend(f"http://127.0.0.1:{server.port}", N, patience=replace(QUICK, n_tries=1))
        session = XiheController(backend, EAGER)
        for number in range(3):
            session.add_position(str(number), (0.2 * number, 0.5, 0.8))
        frames = walk(SMALL, 2)
        session.step(frames[0], active=["0", "1", "2"])
        lights = {name: session.light(name) for name in session.positions}
    for _ in range(2):
        for report in session.step(frames[1], active=["0", "1", "2"]).values():
            assert report.unknown_because == "no_answer"
    assert all(session.light(name) is light for name, light in lights.items())
    assert "the last light is kept" in backend.state()
