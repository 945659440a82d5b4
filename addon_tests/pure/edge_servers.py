"""A server in a thread of the test, requests to it over a socket, and the published client as its snapshot behaves."""

import asyncio
import contextlib
import http.client
import json
import re
import socket
import struct
import subprocess
import sys
import threading
from dataclasses import replace

import pytest

from xihenet.edge.batching import Inference
from xihenet.edge.http_settings import ServerSettings
from xihenet.edge.protocol import content_type_of

NEEDS_TORNADO = pytest.mark.wheel_only("a whole Blender has no Tornado")


def asked(port, method, path, body=b"", **headers):
    """Status, answer (JSON, or text) and headers; underscores in names of headers stand for hyphens."""
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=20)) as connection:
        connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
        response = connection.getresponse()
        text = response.read()
        is_json = response.headers.get("Content-Type") == "application/json"
        return response.status, json.loads(text) if is_json else text.decode(), response.headers


def free_port():
    """A port of this machine at which nobody listens."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


@contextlib.contextmanager
def serving(*options, stderr=subprocess.PIPE, host=r"127\.0\.0\.1", xihe=("-m", "xihe_blender")):
    """The process of `xihe serve`, and its port; `host` is how it says where it listens, `xihe` what Python runs."""
    command = [sys.executable, *xihe, "serve", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
    try:
        said = process.stdout.readline()
        found = re.search(rf"serving at https?://{host}:(\d+), Ctrl-C to stop", said)
        assert found, process.stderr and process.stderr.read()
        yield process, int(found[1])
    finally:
        process.kill()
        process.communicate()


class EdgeServer:
    """Listens at `port` from `start` to `stop`; can be started again at the same one."""

    def __init__(self, settings=None, inference=None):
        self.settings = settings or ServerSettings(port=0)
        self.inference = inference or Inference("projection")
        self.port = self.service = self._loop = self._stopping = self._thread = None

    def start(self):
        ready = threading.Event()

        async def run():
            from xihenet.edge.server import running

            self._loop, self._stopping = asyncio.get_running_loop(), asyncio.Event()
            async with running(self.inference, self.settings) as (self.service, self.port):
                ready.set()
                await self._stopping.wait()

        self._thread = threading.Thread(target=asyncio.run, args=(run(),))
        self._thread.start()
        assert ready.wait(20)
        self.settings = replace(self.settings, port=self.port)
        return self

    def stop(self):
        self._loop.call_soon_threadsafe(self._stopping.set)
        self._thread.join(20)
        assert not self._thread.is_alive()

    def __enter__(self):
        return self.start()

    def __exit__(self, *_):
        self.stop()

    def ask(self, method, path, body=b"", **headers):
        """As `asked`."""
        return asked(self.port, method, path, body, **headers)

    def raw(self, sent, timeout_s=10):
        """All that comes back until the connection closes, or nothing more comes."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=timeout_s) as connection:
            connection.sendall(sent)
            received = b""
            with contextlib.suppress(ConnectionError, TimeoutError):
                while part := connection.recv(65536):
                    received += part
            return received

    def opened(self, **wanted):
        """Id and token of a session of our own client."""
        status, answer, _ = self.ask("POST", "/api/v3/sessions", json.dumps(wanted).encode())
        assert status == 201, answer
        return answer["session"], answer["token"]

    def light(self, session, token, payload, *, position="vase", query="", method="float32_stripped", **headers):
        """The clean form's status and answer."""
        headers = {"Xihe-Token": token, "Content-Type": content_type_of(method), "Xihe-Exposure": "1"} | headers
        status, answer, _ = self.ask(
            "POST", f"/api/v3/sessions/{session}/positions/{position}{query}", payload, **headers
        )
        return status, answer


class DelayingProxy:
    """Hands on what comes to a server and back, each byte `delay_s` later, as a network does."""

    def __init__(self, port, delay_s):
        self._to, self._delay_s, self.port, self._writers = port, delay_s, None, []
        self._ready = threading.Event()
        self._thread = threading.Thread(target=asyncio.run, args=(self._run(),))

    async def _run(self):
        self._loop, self._stopping = asyncio.get_running_loop(), asyncio.Event()
        server = await asyncio.start_server(self._connected, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        self._ready.set()
        async with server:
            await self._stopping.wait()
            # From Python 3.12 on a server that is closed waits for its connections.
            for writer in self._writers:
                writer.close()
            await asyncio.gather(*(writer.wait_closed() for writer in self._writers), return_exceptions=True)

    async def _connected(self, reader, writer):
        there, back = await asyncio.open_connection("127.0.0.1", self._to)
        self._writers += [writer, back]
        await asyncio.gather(self._handed_on(reader, back), self._handed_on(there, writer))

    async def _handed_on(self, reader, writer):
        while part := await reader.read(65536):
            self._loop.call_later(self._delay_s, writer.write, part)

    def __enter__(self):
        self._thread.start()
        assert self._ready.wait(20)
        return self

    def __exit__(self, *_):
        self._loop.call_soon_threadsafe(self._stopping.set)
        self._thread.join(20)
        assert not self._thread.is_alive()


def published_body(cloud):
    """What the published client's snapshot sends of a cloud: dark anchors left out, and the tail lost."""
    body, n_written = bytearray(7 * len(cloud)), 0
    for anchor in range(len(cloud)):
        if cloud.srgb[anchor].sum() >= 0.05:
            codes = [round(255 * float(c)) for c in cloud.srgb[anchor]]
            struct.pack_into("<HBBBe", body, 7 * anchor, anchor, *codes, float(cloud.distance_m[anchor]))
            n_written += 1
    return bytes(body[: 7 * n_written])
