"""What must never happen to a service that runs, whatever arrives: a fault, an end, or memory that grows.

`make fuzz` sends far more, all of it to one process, see `addon_tests/fuzz.py`.
"""

import contextlib
import os
import re
import select
import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addon_tests.fuzz import FAULT, FUZZED_SERVICE, is_searching, some_examples
from addon_tests.pure.any_requests import N, any_request, right_requests
from addon_tests.pure.edge_servers import NEEDS_TORNADO, asked, serving

pytestmark = NEEDS_TORNADO
REQUESTS_OF_AN_EXAMPLE = 10 if is_searching() else 30  # Each example waits for what is silent.


@pytest.fixture(scope="module")
def port(tmp_path_factory):
    """Of the service that `make fuzz` has started, or of one for these tests, which must not have logged a fault."""
    if FUZZED_SERVICE in os.environ:
        yield int(os.environ[FUZZED_SERVICE])
        return
    log = tmp_path_factory.mktemp("service") / "log"
    with log.open("w") as stderr, serving("--port", "0", "--estimator", "lattice", stderr=stderr) as (_, port):
        yield port
    assert not FAULT.search(log.read_text())


@pytest.fixture(scope="module")
def requests(port):
    _, published, _ = asked(port, "POST", "/api/v2/session/", Anchor_Size=str(N))
    _, opened, _ = asked(port, "POST", "/api/v3/sessions", b'{"n_anchors": %d}' % N)
    return right_requests(published["sid"], opened["session"], opened["token"])


def answers_to(port, requests):
    """The first bytes of each, on its own connection; empty where nothing comes, as after a request that is cut."""
    with contextlib.ExitStack() as stack:
        connections = [stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=10)) for _ in requests]
        for connection, sent in zip(connections, requests, strict=True):
            with contextlib.suppress(ConnectionError, TimeoutError):
                connection.sendall(sent)
        received, waiting = dict.fromkeys(connections, b""), set(connections)
        # What is silent is waited for once, and not one after the other.
        while waiting and (ready := select.select(waiting, [], [], 0.1)[0]):
            for connection in ready:
                part = b""
                with contextlib.suppress(ConnectionError):
                    part = connection.recv(65536)
                received[connection] += part
                if not part or len(received[connection]) >= 13:
                    waiting.remove(connection)
        return list(received.values())


def test_all_requests_are_right_before_they_are_changed(port, requests):
    for method, path, headers, body in requests:
        status, answer, _ = asked(port, method, path, body, **headers)
        assert status in (200, 201) or (status == 404 and method == "DELETE"), answer


@pytest.mark.slow
@some_examples(10)
@given(seed=st.integers(0, 2**32 - 1))
def test_whatever_arrives_is_answered_or_refused_and_the_service_goes_on(port, requests, seed):
    rng = np.random.default_rng(seed)
    for answer in answers_to(port, [any_request(rng, requests) for _ in range(REQUESTS_OF_AN_EXAMPLE)]):
        assert re.match(rb"HTTP/1\.1 (100|20[014]|40[013459]|413|415|503) |$", answer), answer[:200]
    status, metrics, _ = asked(port, "GET", "/metrics")
    assert status == 200 and not re.search(r'status="5(?!03)', metrics)
