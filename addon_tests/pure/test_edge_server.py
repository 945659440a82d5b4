"""The service over sockets: the published requests byte by byte, our own routes, and whoever does it wrong."""

import base64
import contextlib
import http.client
import json
import re
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from addon_tests.pure.edge_servers import NEEDS_TORNADO, EdgeServer, published_body
from addon_tests.pure.made import random_cloud
from xihenet import estimators, sphere
from xihenet.buffers import merge
from xihenet.codec import encode_cloud
from xihenet.edge.axes import sh_from, vector_from
from xihenet.edge.batching import Inference
from xihenet.edge.http_settings import ServerSettings
from xihenet.edge.protocol import content_type_of, read_published
from xihenet.edge.service import ServiceSettings
from xihenet.edge.sessions import SeenPosition, StoreLimits
from xihenet.light.key_light import find_key_light
from xihenet.metrics import shc_rmse
from xihenet.records import UnitSphereCloud
from xihenet.sphere import AnchorLattice

pytestmark = NEEDS_TORNADO
N = 512
UUID = r"[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}"


@pytest.fixture(scope="module")
def server():
    with EdgeServer(inference=Inference("lattice")) as server:
        yield server


@pytest.fixture(scope="module")
def lattice():
    return estimators.load("lattice", N, "ldr")


def cloud_of(seed, share=0.5):
    return random_cloud(np.random.default_rng(seed), N, share)


def published_light(server, session_id, body, **headers):
    status, answer, said = server.ask("POST", "/api/v2/lighting-estimation/", body, Session_ID=session_id, **headers)
    assert status == 200 and list(answer) == ["ok", "coefficients"], answer
    return answer["coefficients"], said


def test_the_published_requests_byte_by_byte(server, lattice):
    head = b"POST /api/v2/session/ HTTP/1.1\r\nHost: xihe\r\nAnchor-Size: 512\r\nContent-Length: 0\r\n\r\n"
    first, second = published_body(cloud_of(1)), published_body(cloud_of(2))

    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as connection:

        def answered(sent):
            connection.sendall(sent)
            received = b""
            while b"\r\n\r\n" not in received:
                received += connection.recv(65536)
            begin, _, body = received.partition(b"\r\n\r\n")
            length = int(re.search(rb"Content-Length: (\d+)", begin)[1])
            while len(body) < length:
                body += connection.recv(65536)
            assert begin.startswith(b"HTTP/1.1 200 OK")
            return json.loads(body)

        opened = answered(head)
        assert set(opened) == {"ok", "sid"} and opened["ok"] is True and re.fullmatch(UUID, opened["sid"])
        lights = []
        for body in (first, second):
            ask = "POST /api/v2/lighting-estimation/ HTTP/1.1\r\nHost: xihe\r\n"
            ask += f"Session-ID: {opened['sid']}\r\nContent-Length: {len(body)}\r\n\r\n"
            lights.append(answered(ask.encode() + body)["coefficients"])
    seen = [read_published(body, N, "unity").cloud for body in (first, second)]
    for light, cloud in zip(lights, (seen[0], merge(*seen)), strict=True):
        assert shc_rmse(sh_from(light, "unity"), lattice.estimate(cloud)) < 1e-5


def test_the_quirks_are_counted(server):
    _, opened, _ = server.ask("POST", "/api/v2/session/", Anchor_Size=str(N))
    cloud = cloud_of(3)
    n_written = int((cloud.srgb.sum(axis=1) >= 0.05).sum())
    before = server.service.metrics.counter("xihe_records_total", quirk="lost")
    _, said = published_light(server, opened["sid"], published_body(cloud))
    n_lost = n_written - int((cloud.srgb[:n_written].sum(axis=1) >= 0.05).sum())
    assert n_lost > 50 and said["Xihe-Lost-Records"] == said["Xihe-Dropped-Records"] == str(n_lost)
    assert server.service.metrics.counter("xihe_records_total", quirk="lost") == before + n_lost


def test_the_clean_form_gives_the_same_light_for_the_same_frames(server):
    _, opened, _ = server.ask("POST", "/api/v2/session/", Anchor_Size=str(N))
    session, token = server.opened(n_anchors=N)
    for seed in range(4):
        payload = encode_cloud(cloud_of(seed, 0.2))
        published, _ = published_light(server, opened["sid"], payload)
        status, answer = server.light(session, token, payload, method="uint8_float16_stripped")
        assert status == 200
        ours = sh_from(answer["coefficients"], "z-up")
        assert np.allclose(sh_from(published, "unity"), ours, atol=1e-6)


@pytest.mark.parametrize("n_stored", [0, 768])
def test_a_stored_position_that_does_not_fit_its_session_is_replaced(server, n_stored):
    session, token = server.opened(n_anchors=N)
    stored = SeenPosition(UnitSphereCloud.empty(n_stored), position_m=np.zeros(3))
    for name in ("vase", "lamp"):
        assert server.service.store.put_position(session, name, stored, None)
    status, told, _ = server.ask("GET", f"/api/v3/sessions/{session}", Xihe_Token=token)
    assert status == 200 and told["positions"]["vase"]["coverage"] == 0
    cloud, here = cloud_of(6), {"Xihe_Position": "0,1,0"}
    payload = encode_cloud(cloud, "float32_stripped")
    for n_frames in (1, 2):
        status, answer = server.light(session, token, payload, query="?share=yes", **here)
        assert status == 200 and answer["coverage"] == cloud.is_set.mean() and answer["n_shared_anchors"] == 0
        assert server.service.store.position(session, "vase").n_frames == n_frames


def test_an_answer_says_what_is_known_of_the_light(server, lattice):
    session, token = server.opened(n_anchors=N)
    cloud = cloud_of(5)
    status, answer = server.light(session, token, encode_cloud(cloud, "float32_stripped"), Xihe_Exposure="0.25")
    light, error = lattice.estimate_with_error(cloud)
    assert status == 200 and shc_rmse(sh_from(answer["coefficients"], "z-up"), light) < 1e-6
    assert answer["expected_error"] == pytest.approx(error, rel=1e-4)
    assert answer["coverage"] == cloud.is_set.mean() and answer["exposure"] == 0.25
    assert answer["is_valid"] and answer["unknown_because"] == "" and answer["target"] == "ldr"
    assert "key_light" not in answer and "reflections" not in answer


def test_a_light_that_cannot_be_known_says_so(server):
    session, token = server.opened(n_anchors=N)
    status, answer = server.light(session, token, b"")
    assert status == 200 and not answer["is_valid"] and answer["unknown_because"] == "nothing_seen"
    assert answer["coefficients"] == [0.0] * 27 and answer["expected_error"] is None
    coefficients, _ = published_light(
        server, server.ask("POST", "/api/v2/session/", Anchor_Size=str(N))[1]["sid"], bytes(7 * 20)
    )
    assert coefficients == [0.0] * 27


def test_key_light_and_reflections_are_made_if_asked_for(server):
    directions = AnchorLattice(N).directions
    srgb = np.where(directions @ [0.6, 0, 0.8] > 0.95, 1.0, 0.3)[:, None] * np.ones(3)
    cloud = UnitSphereCloud(srgb, np.full(N, 2.0), np.ones(N, bool))
    session, token = server.opened(n_anchors=N)
    query = "?key_light=yes&reflections=yes"
    payload = encode_cloud(cloud, "float32_stripped")
    status, answer = server.light(session, token, payload, query=query, Xihe_Axes="y-up")
    assert status == 200
    key = find_key_light(sh_from(answer["coefficients"], "y-up"), cloud, AnchorLattice(N))
    assert np.allclose(vector_from(answer["key_light"]["direction"], "y-up"), key.direction)
    assert np.allclose(answer["key_light"]["irradiance"], key.irradiance) and answer["key_light"]["is_seen"]
    radiance = np.frombuffer(base64.b64decode(answer["reflections"]["radiance_float16"]), "<f2")
    assert radiance.shape == (3 * N,) and np.isfinite(radiance).all() and answer["reflections"]["seen_share"] == 1


def test_clients_and_positions_share_a_session(server):
    session, token = server.opened(n_anchors=N)
    _, joined, _ = server.ask("POST", f"/api/v3/sessions/{session}/clients")
    one, two = cloud_of(6, 0.3), cloud_of(7, 0.3)
    place = {"Xihe_Position": "1,2,3"}
    server.light(session, token, encode_cloud(one, "float32_stripped"), position="a", **place)
    status, alone = server.light(session, joined["token"], encode_cloud(two, "float32_stripped"), position="b", **place)
    assert status == 200 and alone["n_shared_anchors"] == 0 and alone["coverage"] == two.is_set.mean()
    _, shared = server.light(session, joined["token"], b"", position="b", query="?share=yes", **place)
    assert shared["n_shared_anchors"] > 0 and shared["coverage"] > alone["coverage"]
    _, merged = server.light(session, joined["token"], encode_cloud(two, "float32_stripped"), position="a")
    assert merged["coverage"] == (one.is_set | two.is_set).mean()
    _, replaced = server.light(
        session, token, encode_cloud(two, "float32_stripped"), position="a", query="?replace=yes"
    )
    assert replaced["coverage"] == two.is_set.mean()
    _, described, _ = server.ask("GET", f"/api/v3/sessions/{session}", Xihe_Token=token)
    assert described["n_clients"] == 1 and described["positions"]["a"]["n_frames"] == 3
    status, _, _ = server.ask("DELETE", f"/api/v3/sessions/{session}/positions/b", Xihe_Token=joined["token"])
    assert status == 200
    status, refused, _ = server.ask("DELETE", f"/api/v3/sessions/{session}", Xihe_Token=joined["token"])
    assert status == 403 and "owner" in refused["error"]
    assert server.ask("DELETE", f"/api/v3/sessions/{session}", Xihe_Token=token)[0] == 200
    assert server.ask("GET", f"/api/v3/sessions/{session}", Xihe_Token=token)[0] == 404


def test_a_session_takes_sixteen_positions_and_waiting_does_not_help(server):
    session, token = server.opened(n_anchors=N)
    lights = [server.light(session, token, b"", position=f"place_{number}") for number in range(17)]
    assert [status for status, _ in lights] == 16 * [200] + [409]
    assert lights[-1][1]["error"] == ("a session has 16 positions at most: have it forget one, or open another session")
    assert server.ask("DELETE", f"/api/v3/sessions/{session}/positions/place_3", Xihe_Token=token)[0] == 200
    assert server.light(session, token, b"", position="one_more")[0] == 200


def test_what_moved_positions_take_is_made_beside_the_event_loop_when_a_session_is_opened(server):
    made = sphere._exact_table
    made.cache_clear()
    server.opened(n_anchors=N)
    until_s = time.monotonic() + 20
    while not made.cache_info().currsize and time.monotonic() < until_s:
        time.sleep(0.02)
    assert made.cache_info().currsize == 1


def test_a_compressed_body_is_refused_and_not_read_as_a_cloud(server):
    session, token = server.opened(n_anchors=N)
    for encoding, status in (("gzip", 415), ("br", 415), ("identity", 200)):
        answered, answer = server.light(session, token, b"", Content_Encoding=encoding)
        assert answered == status and (
            status == 200 or f"leave out Content-Encoding, got '{encoding}'" in answer["error"]
        )


def test_openapi_names_all_that_answers_hold(server):
    opened, token = server.opened(n_anchors=N)
    wanted = {
        "Xihe_Token": token,
        "Xihe_Exposure": "1",
        "Content_Type": "application/vnd.xihe.cloud; method=float32_stripped",
    }
    place, cloud = "/api/v3/sessions/{session}/positions/{position}", encode_cloud(cloud_of(3, 0.5), "float32_stripped")
    asked = {
        "/api/v3/sessions": ("", b"", {}),
        "/api/v3/sessions/{session}/clients": ("", b"", {}),
        place: ("?key_light=yes&reflections=yes", cloud, wanted),
        "/api/v2/session/": ("", b"", {"Anchor_Size": str(N)}),
    }
    _, document, _ = server.ask("GET", "/openapi.json")
    for path, (query, body, headers) in asked.items():
        status, answer, _ = server.ask("POST", path.format(session=opened, position="a") + query, body, **headers)
        told = document["paths"][path]["post"]["responses"][str(status)]["content"]["application/json"]["schema"]
        assert told["properties"].keys() == answer.keys() and set(told["required"]) <= answer.keys(), path
        jsonschema.validate(answer, told)


def test_clouds_of_another_exposure_are_brought_to_that_of_the_position(server):
    session, token = server.opened(n_anchors=N)
    grey = UnitSphereCloud(np.full((N, 3), 0.4), np.full(N, 2.0), np.ones(N, bool))
    payload = encode_cloud(grey, "float32_stripped")
    _, first = server.light(session, token, payload, Xihe_Exposure="1")
    _, second = server.light(session, token, payload, Xihe_Exposure="2")
    assert second["exposure"] == 1 and np.allclose(second["coefficients"][0], first["coefficients"][0] / 2, rtol=1e-4)


def test_a_position_that_moves_keeps_what_it_knows_of_the_room(server):
    session, token = server.opened(n_anchors=N)
    cloud = UnitSphereCloud(np.full((N, 3), 0.4), np.full(N, 2.0), np.ones(N, bool))
    server.light(session, token, encode_cloud(cloud, "float32_stripped"), Xihe_Position="0,0,0")
    _, moved = server.light(session, token, b"", Xihe_Position="0.5,0,0")
    assert 0.5 < moved["coverage"] < 1 and moved["is_valid"]


def test_an_owner_lists_its_sessions_and_nobody_elses(server):
    first, token = server.opened(n_anchors=N)
    status, second, _ = server.ask("POST", "/api/v3/sessions", b'{"joinable": false}', Xihe_Token=token)
    assert status == 201 and second["token"] == token
    server.opened()
    listed = server.ask("GET", "/api/v3/sessions", Xihe_Token=token)[1]["sessions"]
    assert [one["session"] for one in listed] == [first, second["session"]]
    assert server.ask("GET", "/api/v3/sessions")[0] == 401
    assert server.ask("POST", f"/api/v3/sessions/{second['session']}/clients")[0] == 403


def test_nobody_uses_anothers_session(server):
    session, token = server.opened(n_anchors=N)
    _, stranger = server.opened(n_anchors=N)
    payload = encode_cloud(cloud_of(8))
    for wrong, expected in ((stranger, 403), ("", 401), ("x" * 40, 403)):
        assert server.light(session, wrong, payload)[0] == expected
        assert server.ask("GET", f"/api/v3/sessions/{session}", Xihe_Token=wrong)[0] == expected
        assert server.ask("DELETE", f"/api/v3/sessions/{session}", Xihe_Token=wrong)[0] == expected
        assert server.ask("DELETE", f"/api/v3/sessions/{session}/positions/vase", Xihe_Token=wrong)[0] == expected
    # The published route has no tokens, so it must not open a session that has one.
    assert server.ask("POST", "/api/v2/lighting-estimation/", payload, Session_ID=session)[0] == 404
    assert server.service.store.positions(session) == {}
    assert server.ask("GET", f"/api/v3/sessions/{session}", Xihe_Token=token)[0] == 200


@pytest.mark.parametrize(
    ("headers", "body", "status", "said"),
    [
        ({}, b"", 400, "Session-ID"),
        ({"Session_ID": "nonsense"}, b"", 404, "open a new one"),
        ({"Session_ID": "00000000-0000-0000-0000-000000000000"}, b"", 404, "open a new one"),
        ({"Session_ID": "THIS"}, b"123", 400, "multiple of 7"),
        ({"Session_ID": "THIS", "Xihe_Axes": "sideways"}, b"", 400, "unity, y-up, z-up"),
    ],
)
def test_a_wrong_published_request_is_told_what_is_wrong(server, headers, body, status, said):
    _, opened, _ = server.ask("POST", "/api/v2/session/", Anchor_Size=str(N))
    headers = {name: opened["sid"] if value == "THIS" else value for name, value in headers.items()}
    found, answer, _ = server.ask("POST", "/api/v2/lighting-estimation/", body, **headers)
    assert found == status and answer["ok"] is False and said in answer["error"]


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        (b"{", "JSON object"),
        (b"[1]", "JSON object"),
        (b"\xff", "JSON object"),
        (b"[" * 60000, "JSON object"),
        (b'{"n_anchors": 3}', "choose one of 512"),
        (b'{"n_anchors": [512]}', "number of anchors"),
        (b'{"target": "x"}', "ldr or hdr"),
        (b'{"traget": "hdr"}', "'traget': there is no such field; there are n_anchors, target, joinable"),
        (b'{"joinable": 1}', "true or false"),
    ],
)
def test_a_wrong_session_is_told_what_is_wrong(server, wanted, said):
    status, answer, _ = server.ask("POST", "/api/v3/sessions", wanted)
    assert status == 400 and said in answer["error"]


def test_other_wrong_requests(server):
    session, token = server.opened(n_anchors=N)
    status, answer, _ = server.ask("POST", "/api/v2/session/")
    assert status == 400 and answer["error"].startswith("Anchor-Size: expected the number of anchors, one of 512")
    status, _, said = server.ask("GET", "/api/v2/session/")
    assert status == 405 and said["Allow"] == "POST, OPTIONS"
    assert server.ask("GET", "/nowhere")[0] == 404
    status, answer, _ = server.ask("POST", f"/api/v3/sessions/{session}/positions/a", b"", Xihe_Token=token)
    assert status == 415 and "application/vnd.xihe.cloud" in answer["error"]
    for query, said in (("?share=maybe", "yes or no"), ("?share=yes", "where the position is")):
        status, answer = server.light(session, token, b"", query=query)
        assert status == 400 and said in answer["error"]
    assert server.light(session, token, b"", position="a" * 65)[0] == 400
    assert server.light(session, token, b"", position="%0A")[0] == 400
    assert server.ask("POST", "/api/v3/sessions", Xihe_Token="short")[0] == 400
    assert server.ask("POST", "/api/v3/sessions", Xihe_Token="")[0] == 400


def test_a_cloud_that_is_to_be_shared_from_nowhere_is_not_kept(server):
    session, token = server.opened(n_anchors=N)
    sent = encode_cloud(cloud_of(1), "float32_stripped")
    assert server.light(session, token, sent, query="?share=yes")[0] == 400
    assert server.light(session, token, b"")[1]["coverage"] == 0


def test_health_metrics_page_and_openapi_are_there(server):
    from xihenet.edge.server import ROUTES

    assert server.ask("GET", "/health")[1]["estimator"] == "lattice"
    server.light(*server.opened(n_anchors=N), encode_cloud(cloud_of(1), "float32_stripped"))
    status, text, _ = server.ask("GET", "/metrics")
    assert status == 200 and "xihe_connections 1" in text and 'stage="inference"' in text
    assert "<html" in server.ask("GET", "/")[1]
    _, document, _ = server.ask("GET", "/openapi.json")
    served = {re.sub(r"\(\[\^/\]\+\)", "{}", pattern) for pattern in ROUTES} - {"/metrics", "/openapi.json", "/"}
    assert {re.sub(r"\{\w+\}", "{}", path) for path in document["paths"]} == served


def test_a_misspelt_name_in_the_query_or_among_the_headers_is_refused_and_changes_nothing(server):
    session, token = server.opened(n_anchors=N)
    place = f"/api/v3/sessions/{session}/positions/a"
    for query, said in (("?keylight=yes", "'keylight'.*key_light"), ("?share", "share: expected yes or no")):
        status, answer = server.light(session, token, b"", position="a", query=query)
        assert status == 400 and re.search(said, answer["error"])
    status, answer = server.light(session, token, b"", position="a", Xihe_Postion="0,1,0")
    assert status == 400 and "Xihe-Postion: there is no such header; there are Xihe-Axes" in answer["error"]
    for method, path in (("POST", "/api/v3/sessions?n_anchors=512"), ("DELETE", f"{place}?all=yes")):
        status, answer, _ = server.ask(method, path, Xihe_Token=token)
        assert status == 400 and "the query has no such name" in answer["error"]
    assert server.ask("GET", f"/api/v3/sessions/{session}", Xihe_Token=token)[1]["positions"] == {}
    assert server.ask("GET", "/health?from=monitor")[0] == 200


@pytest.mark.parametrize("said", ["close", "TE, close", "close, TE", "TE\r\nConnection: close"])
def test_a_connection_is_closed_where_close_is_among_what_is_said_of_it(server, said):
    answer = server.raw(f"GET /health HTTP/1.1\r\nHost: xihe\r\nConnection: {said}\r\n\r\n".encode(), timeout_s=1)
    assert answer.startswith(b"HTTP/1.1 200") and b"\r\nConnection: close\r\n" in answer


@pytest.mark.parametrize("path", ["/", "/health", "/metrics", "/openapi.json"])
def test_head_is_answered_as_get_without_the_body(server, path):
    # Load balancers and `curl -I` ask so whether a server is there.
    answers = {
        method: server.raw(f"{method} {path} HTTP/1.0\r\n\r\n".encode()) for method in ("GET", "HEAD", "OPTIONS")
    }
    heads = {method: answer.partition(b"\r\n\r\n")[0] for method, answer in answers.items()}
    lines = {method: [line.split(b":")[0] for line in head.splitlines()] for method, head in heads.items()}
    assert lines["HEAD"] == lines["GET"] and answers["HEAD"] == heads["HEAD"] + b"\r\n\r\n"
    assert b"204 No Content" in heads["OPTIONS"] and b"Allow: GET, HEAD, OPTIONS" in heads["OPTIONS"]


def test_a_request_may_name_the_whole_address_as_proxies_do(server):
    for address in (b"http://xihe/health?a=b", b"https://xihe:8550/health"):
        answer = server.raw(b"GET " + address + b" HTTP/1.1\r\nHost: xihe\r\nConnection: close\r\n\r\n")
        assert b" 200 OK" in answer and b'"estimator": "lattice"' in answer


def test_web_pages_may_ask_if_their_origin_is_allowed():
    settings = ServerSettings(port=0, origins=("https://app.example",))
    with EdgeServer(settings) as server:
        status, _, said = server.ask("OPTIONS", "/api/v2/session/", Origin="https://app.example")
        assert status == 204 and said["Access-Control-Allow-Origin"] == "https://app.example"
        assert "Anchor-Size" in said["Access-Control-Allow-Headers"]
        _, _, said = server.ask("POST", "/api/v2/session/", Origin="https://app.example")
        assert said["Access-Control-Allow-Origin"] == "https://app.example"  # Also of an error
        assert "Access-Control-Allow-Origin" not in server.ask("GET", "/health", Origin="https://other.example")[2]


def test_a_bearer_token_is_asked_of_all_routes_but_health():
    with EdgeServer(ServerSettings(port=0, bearer="secret")) as server:
        assert server.ask("GET", "/health")[0] == 200
        assert server.ask("GET", "/metrics")[0] == server.ask("POST", "/api/v2/session/", Anchor_Size="512")[0] == 401
        assert server.ask("POST", "/api/v2/session/", Anchor_Size="512", Authorization="Bearer guess")[0] == 401
        assert server.ask("POST", "/api/v2/session/", Anchor_Size="512", Authorization="Bearer secret")[0] == 200


def test_full_stores_and_queues_answer_503_and_when_to_come_again():
    limits = StoreLimits(n_sessions=2, n_clients_of_session=1)
    with EdgeServer(ServerSettings(port=0, service=ServiceSettings(limits=limits, max_queue=0))) as server:
        session, token = server.opened(n_anchors=N)
        server.opened()
        status, answer, said = server.ask("POST", "/api/v2/session/", Anchor_Size="512")
        assert status == 503 and said["Retry-After"] == "1" and "2 sessions" in answer["error"]
        assert server.light(session, token, b"")[0] == 503
        assert server.ask("POST", f"/api/v3/sessions/{session}/clients")[0] == 201
        assert server.ask("POST", f"/api/v3/sessions/{session}/clients")[0] == 409


LONG = b"POST /api/v2/lighting-estimation/ HTTP/1.1\r\nHost: xihe\r\n"
CHUNK = b"8000\r\n" + bytes(0x8000) + b"\r\n"


@pytest.mark.parametrize(
    "sent",
    [
        LONG + b"Content-Length: 10000000\r\n\r\n" + bytes(10**7),
        LONG + b"Transfer-Encoding: chunked\r\n\r\n" + 300 * CHUNK + b"0\r\n\r\n",
        LONG + b"Content-Length: 10000000\r\nExpect: 100-continue\r\n\r\n",
        LONG + b"Content-Length: 99999999999999999999\r\n\r\n",
    ],
)
def test_a_body_that_is_too_long_is_refused_where_its_client_can_read_it(server, sent):
    is_last = b"Expect" in sent or b"9999" in sent
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as connection:
        connection.sendall(sent)
        received = connection.recv(65536)
        if not is_last:
            # The connection is as good as before, since all of the body has been read.
            connection.sendall(b"GET /health HTTP/1.1\r\nHost: xihe\r\nConnection: close\r\n\r\n")
        while part := connection.recv(65536):
            received += part
    head, _, body = received.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 413") and b"application/json" in head
    assert b"expected a body of at most 65536 bytes" in body
    assert (b"Connection: close" in head) == is_last and (b'"estimator": "lattice"' in body) != is_last


def test_headers_and_bodies_that_do_not_end_are_cut_off(server):
    assert server.raw(b"GET / HTTP/1.1\r\nA: " + b"a" * 100_000 + b"\r\n\r\n")[:12] in (b"HTTP/1.1 400", b"")
    endless = LONG + b"Transfer-Encoding: chunked\r\n\r\n" + 600 * CHUNK
    with contextlib.suppress(ConnectionError):
        assert server.raw(endless).startswith(b"HTTP/1.1 413")
    assert server.ask("GET", "/health")[0] == 200


class Clock:
    """What the server takes for its clock: it stands still but for what a test adds."""

    def __init__(self):
        self.now_s = 0.0

    def monotonic(self):
        return self.now_s


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("xihenet.edge.requests.time", clock)
    return clock


def n_connected(server):
    """Connections but for the one that asks, after the server has looked around for late ones twice."""
    time.sleep(server.settings.body_s / 4)
    return int(re.search(r"^xihe_connections (\d+)$", server.ask("GET", "/metrics")[1], re.M)[1]) - 1


def comes_true(is_true):
    """Whether it does so however busy this machine is."""
    return any(is_true() or time.sleep(0.05) for _ in range(400))


def test_slow_clients_are_cut_off_and_others_answered_meanwhile(clock):
    settings = ServerSettings(port=0, header_s=0.8, body_s=0.4)
    with EdgeServer(settings) as server, contextlib.ExitStack() as kept:
        address = "127.0.0.1", server.port
        slow = [kept.enter_context(socket.create_connection(address, timeout=10)) for _ in range(40)]
        beginnings = (b"POST /api/v2/ses", b"POST /api/v2/session/ HTTP/1.1\r\nHost: x\r\nContent-Length: 70\r\n\r\n1")
        for number, connection in enumerate(slow):
            connection.sendall(beginnings[number % 2])
        assert n_connected(server) == 40
        for at_s, n_left in ((0.39, 40), (0.41, 20), (0.79, 20), (0.81, 0)):
            clock.now_s = at_s
            assert comes_true(lambda: n_connected(server) == n_left), at_s  # noqa: B023
        for connection in slow:
            assert connection.recv(100) == b""


def test_a_client_that_does_not_take_its_answers_is_cut_off(clock):
    with (
        EdgeServer(ServerSettings(port=0, header_s=0.8, body_s=0.4)) as server,
        socket.socket() as connection,
    ):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # Few answers fill it.
        connection.connect(("127.0.0.1", server.port))
        connection.settimeout(0.2)
        with contextlib.suppress(TimeoutError):
            for _ in range(10_000):
                connection.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n" * 100)
        n_answered = [-1, 0]
        while n_answered[0] < n_answered[1]:  # Until it cannot send any more
            assert n_connected(server) == 1
            n = server.service.metrics.counter("xihe_requests_total", route="/", status="200")
            n_answered = [n_answered[1], n]
        assert n > 0
        for at_s, n_left in ((0.79, 1), (0.81, 0)):
            clock.now_s = at_s
            assert comes_true(lambda: n_connected(server) == n_left), at_s  # noqa: B023


def test_a_client_whose_bytes_trickle_is_cut_off_all_the_same():
    with EdgeServer(ServerSettings(port=0, header_s=0.4, body_s=0.4)) as server:
        for whole in (b"GET /health HTTP/1.1\r\nHost: x\r\nA: ", LONG + b"Content-Length: 100\r\n\r\n"):
            started = time.monotonic()
            with (
                socket.create_connection(("127.0.0.1", server.port), timeout=10) as connection,
                contextlib.suppress(ConnectionError),
            ):
                connection.sendall(whole)
                connection.settimeout(0.05)
                while time.monotonic() - started < 5:
                    connection.sendall(b"a")
                    with contextlib.suppress(TimeoutError):
                        assert connection.recv(100) == b""
                        break
            assert 0.3 < time.monotonic() - started < 2


@pytest.mark.slow
def test_a_connection_that_is_kept_may_rest_between_requests_and_is_closed_in_the_end():
    with EdgeServer(ServerSettings(port=0, header_s=0.6, body_s=0.6)) as server:
        started = time.monotonic()
        with socket.create_connection(("127.0.0.1", server.port), timeout=10) as connection:
            for _ in range(4):  # In all longer than a request may take
                time.sleep(0.25)
                connection.sendall(b"GET /health HTTP/1.1\r\nHost: x\r\n\r\n")
                assert connection.recv(4096).startswith(b"HTTP/1.1 200")
            assert connection.recv(100) == b""
        assert 1.5 < time.monotonic() - started < 4


def test_a_connection_that_is_cut_within_a_body_leaves_nothing(server):
    session, token = server.opened(n_anchors=N)
    for _ in range(5):
        with socket.create_connection(("127.0.0.1", server.port), timeout=10) as connection:
            head = f"POST /api/v3/sessions/{session}/positions/a HTTP/1.1\r\nHost: x\r\nXihe-Token: {token}\r\n"
            connection.sendall(head.encode() + b"Content-Length: 700\r\n\r\n" + bytes(300))
    assert server.ask("GET", f"/api/v3/sessions/{session}", Xihe_Token=token)[1]["positions"] == {}


def test_a_server_that_stops_answers_what_waits_and_refuses_the_rest():
    server, statuses = EdgeServer(inference=SlowInference("projection")).start(), []
    session, token = server.opened(n_anchors=N)
    path = f"/api/v3/sessions/{session}/positions/a?key_light=yes"
    headers = {"Xihe-Token": token, "Content-Type": content_type_of("float32_stripped"), "Xihe-Exposure": "1"}
    until = time.monotonic() + 5  # Who stops earlier did not wait for those who go on to ask.

    def ask():
        connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20)
        with contextlib.closing(connection), contextlib.suppress(ConnectionError, http.client.HTTPException):
            while time.monotonic() < until:
                connection.request("POST", path, encode_cloud(cloud_of(1), "float32_stripped"), headers)
                response = connection.getresponse()
                response.read()
                statuses.append(response.status)

    with ThreadPoolExecutor(6) as clients:
        for _ in range(6):
            clients.submit(ask)
            time.sleep(0.03)  # So that some wait whenever others are answered.
        server.stop()
        assert time.monotonic() < until
    assert set(statuses) <= {200, 503} and statuses.count(200) >= 6


class SlowInference(Inference):
    def __init__(self, name):
        super().__init__(name)
        self.is_quick = False

    def __call__(self, jobs):
        time.sleep(0.05)
        return super().__call__(jobs)


def test_too_many_connections_are_closed_at_once():
    with EdgeServer(replace(ServerSettings(port=0), max_connections=4)) as server:
        kept = [socket.create_connection(("127.0.0.1", server.port), timeout=10) for _ in range(4)]
        time.sleep(0.1)
        assert server.raw(b"GET /health HTTP/1.1\r\nHost: x\r\n\r\n") == b""
        for connection in kept:
            connection.close()
        time.sleep(0.1)
        assert server.ask("GET", "/health")[0] == 200
