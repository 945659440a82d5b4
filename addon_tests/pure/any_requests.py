"""Requests to the edge service that were right once: changed in their bytes, headers, path, length, or cut."""

import json

import numpy as np

from addon_tests.pure.made import random_cloud
from xihenet.codec import METHODS, encode_cloud
from xihenet.edge.protocol import OUR_HEADERS, content_type_of

N = 512
HEADERS = (*OUR_HEADERS, "Content-Type", "Session-ID", "Anchor-Size", "Authorization", "Origin", "Host", "Expect")
TEXTS = (
    "",
    "0",
    "-1",
    "nan",
    "inf",
    "1e999",
    "1,2,3",
    "1,2",
    "é",
    "\x7f",
    "unity",
    "y-up",
    "%s%n",
    "a" * 5000,
    "9" * 40,
)
PARTS = ("", "..", "%00", "%ff", "%2F", "a" * 70, "positions", "clients", "sessions", "api", "x%zz", "a b")


def right_requests(published, session, token):
    """Each route's, as (method, path, headers, body), of sessions that there are."""
    own, room = {"Xihe-Token": token}, f"/api/v3/sessions/{session}"
    cloud = random_cloud(np.random.default_rng(0), N)
    requests = [
        ("POST", "/api/v2/session/", {"Anchor-Size": str(N)}, b""),
        ("POST", "/api/v2/lighting-estimation/", {"Session-ID": published}, encode_cloud(cloud)),
        ("POST", "/api/v3/sessions", own, json.dumps({"n_anchors": N, "target": "hdr", "joinable": True}).encode()),
        ("GET", "/api/v3/sessions", own, b""),
        ("GET", room, own, b""),
        ("POST", room + "/clients", {}, b""),
        ("DELETE", room + "/positions/a", own, b""),
        *(("GET", path, {}, b"") for path in ("/", "/health", "/metrics", "/openapi.json")),
    ]
    wishes = ("replace=no", "share=yes", "key_light=yes", "reflections=yes")
    for number, method in enumerate(METHODS):
        seen = {"Content-Type": content_type_of(method), "Xihe-Exposure": "0.5", "Xihe-Position": "1,2,3"} | own
        path = f"{room}/positions/{'ab'[number % 2]}?{'&'.join(wishes[:number])}"
        requests.append(("POST", path, seen, encode_cloud(cloud, method)))
    return requests


def any_request(rng, requests):
    """Bytes of one of them, changed now and then in each way; what is sent after them may be nothing at all."""
    method, path, headers, body = requests[rng.integers(len(requests))]
    headers, is_changed = dict(headers), lambda: rng.random() < 0.15
    if is_changed():
        method = str(rng.choice(["GET", "POST", "PUT", "DELETE", "HEAD", "OPTIONS", "PATCH", "get", "X" * 30]))
    if is_changed():
        parts = path.split("/")
        parts[rng.integers(len(parts))] = str(rng.choice(PARTS))
        path = "/".join(parts) or "/"
    for _ in range(3):
        if is_changed():
            headers[str(rng.choice(HEADERS))] = str(rng.choice(TEXTS))
    if headers and is_changed():
        headers.pop(str(rng.choice(list(headers))))
    body = changed(rng, body) if is_changed() else body
    if is_changed():
        body = rng.bytes(int(rng.integers(0, 200_000)))
    lines = [f"{method} {path} HTTP/1.{rng.integers(2)}", "Host: xihe", "Connection: close"]
    sent = "\r\n".join([*lines, *(f"{name}: {value}" for name, value in headers.items()), ""]).encode("latin1")
    if rng.random() < 0.2:
        sent += b"Transfer-Encoding: chunked\r\n\r\n%x\r\n" % len(body) + body + b"\r\n0\r\n\r\n" * bool(body)
    else:
        length = len(body) if not is_changed() else int(rng.choice([0, 1, 7, 10**5, 10**8, 10**18, -1]))
        sent += f"Content-Length: {length}\r\n\r\n".encode() + body
    if is_changed():
        sent = changed(rng, sent)
    return sent[: rng.integers(len(sent))] if is_changed() else sent


def changed(rng, content):
    """A few bytes others, or some cut out or doubled."""
    content = bytearray(content or b"\0")
    for index in rng.integers(0, len(content), rng.integers(1, 5)):
        content[index] = rng.integers(256)
    start, length = rng.integers(0, len(content)), rng.integers(1, 50)
    content[start : start + length] = bytes(content[start : start + length]) * int(rng.integers(0, 3))
    return bytes(content)
