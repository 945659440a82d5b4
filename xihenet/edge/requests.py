"""Requests as they arrive, bounded in size and time, on Tornado's HTTP server.

Tornado reads and checks the HTTP. What it has above that, its handlers and a timer for each step of a request, takes
longer than decoding a cloud and is not used: a look around in a while closes what is late. The headers of a request
have a time to be complete in, and its body another, however the bytes trickle. An answer has the time of headers to be
taken in.

A body that is too long is refused as soon as that is known, and then read on and thrown away: closing the connection
under what still arrives would reset it, and its client would not get to read why. The connection is closed at once
where the client asked first (`Expect: 100-continue`), or has more than `MOST_READ_BYTES`.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from http import HTTPStatus
from typing import Any

from tornado import httpserver, httputil, iostream

from xihenet.edge.http_settings import MAX_BODY_BYTES, ServerSettings

MOST_READ_BYTES = 16 * 2**20
"""Of a body that was refused."""

LOOKS = 8
"""Looks around in the shorter of the two times: a connection is closed late by an eighth of it."""


ENDINGS = {"HTTP/1.1": "close", "HTTP/1.0": "keep-alive"}
"""What a client may say of its connection that is otherwise not so in its version, and is then told as well."""


def headers_text(headers: Mapping[str, str]) -> str:
    """Headers as they are sent. Names and values are our own words, so nothing needs escaping."""
    return "".join([f"{name}: {value}\r\n" for name, value in headers.items()])


class Request(httputil.HTTPMessageDelegate):
    """One request: `method`, `path` and `query` as sent, `headers`, and `body` if it is not longer than allowed."""

    def __init__(self, server: Server, connection: Any) -> None:
        self._server, self._connection = server, connection
        self._parts: list[bytes] = []
        self._is_read = self._is_answered = self._is_last = False
        self.n_bytes = 0
        """Of the body, as far as it is known."""
        server.expect(connection.stream, server.settings.header_s)

    def headers_received(self, start_line: Any, headers: httputil.HTTPHeaders) -> None:
        host = headers.get("Host", "" if start_line.version == "HTTP/1.0" else ",")
        if "," in host:
            raise httputil.HTTPInputError("expected one Host header")
        self.method: str = start_line.method
        target: str = start_line.path
        if not target.startswith("/"):  # Proxies may send the whole address.
            target = "/" + target.partition("://")[2].partition("/")[2]
        self.path, _, self.query = target.partition("?")
        self.headers = headers
        said = [one.strip().lower() for one in headers.get("Connection", "").split(",")]
        self._ending = said[0] if said == [ENDINGS.get(start_line.version)] else ""
        if "close" in said:
            # Tornado reads it only where it stands alone.
            self._ending, self._connection._disconnect_on_finish = "close", True
        self._server.expect(self._connection.stream, self._server.settings.body_s)
        announced = headers.get("Content-Length", "")
        if len(announced) > 4 and announced.isdecimal() and int(announced[:18]) > MAX_BODY_BYTES:
            self.n_bytes = int(announced[:18])
            self._is_last = self._is_read = "Expect" in headers or self.n_bytes > MOST_READ_BYTES
            self._server.answer(self)

    def data_received(self, chunk: bytes) -> None:
        if self.is_too_long:
            return
        self._parts.append(chunk)
        self.n_bytes += len(chunk)
        if self.is_too_long:
            self._parts.clear()
            self._server.answer(self)

    def finish(self) -> None:
        self._server.expect_nothing(self._connection.stream)
        self._is_read = True
        if self._is_answered:
            self._finish()
        else:
            self._server.answer(self)

    def send(self, status: HTTPStatus, head: str, body: bytes) -> None:
        """The answer, once; `head` as of `headers_text`. Tornado's `write_headers` takes twice as long."""
        self._is_answered = True
        ending = "close" if self._is_last else self._ending
        if ending:
            head += headers_text({"Connection": ending})
        text = f"HTTP/1.1 {status:d} {status.phrase}\r\n{head}\r\n"
        self._connection.write(text.encode("latin1") + (b"" if self.method == "HEAD" else body))
        if self._is_read:
            self._finish()

    def _finish(self) -> None:
        # Whoever does not take the answer would keep the connection for good.
        self._server.expect(self._connection.stream, self._server.settings.header_s)
        self._connection.finish()

    @property
    def is_too_long(self) -> bool:
        return self.n_bytes > MAX_BODY_BYTES

    @property
    def body(self) -> bytes:
        return b"".join(self._parts)


class Server(httpserver.HTTPServer):
    """Gives requests to `answer`; closes connections beyond the limit at once, and those that are late."""

    settings: ServerSettings
    answer: Callable[[Request], None]
    _due_s: dict[iostream.IOStream, float]

    @classmethod
    def made(cls, settings: ServerSettings, answer: Callable[[Request], None], tls: Any) -> Server:
        """A server that does not listen yet; `close_late` is to run beside it."""
        server = cls(
            answer,
            ssl_options=tls,
            max_body_size=MOST_READ_BYTES,
            max_buffer_size=2 * MAX_BODY_BYTES,
            max_header_size=settings.max_header_bytes,
        )
        server.conn_params.header_timeout = None
        server.settings, server.answer = settings, answer
        server._due_s = {}
        return server

    def handle_stream(self, stream: iostream.IOStream, address: tuple[Any, ...]) -> None:
        if len(self._connections) >= self.settings.max_connections:
            stream.close()
            return
        stream.set_nodelay(True)
        # Answers are sent whole. Tornado would switch it on and off at each, two calls that let the inference go first.
        stream.set_nodelay = lambda value: None  # type: ignore[method-assign]
        super().handle_stream(stream, address)

    def start_request(self, server_conn: object, request_conn: httputil.HTTPConnection) -> Request:
        return Request(self, request_conn)

    def on_close(self, server_conn: Any) -> None:
        self.expect_nothing(server_conn.stream)
        super().on_close(server_conn)

    def expect(self, stream: iostream.IOStream, within_s: float) -> None:
        """What a connection sends next is to be there within this time."""
        self._due_s[stream] = time.monotonic() + within_s

    def expect_nothing(self, stream: iostream.IOStream) -> None:
        """It is the server's turn, or the connection is gone."""
        self._due_s.pop(stream, None)

    async def close_late(self) -> None:
        """Close connections whose time is over, for as long as it runs."""
        while True:
            await asyncio.sleep(min(self.settings.header_s, self.settings.body_s) / LOOKS)
            now_s = time.monotonic()
            for stream in [stream for stream, due_s in self._due_s.items() if due_s < now_s]:
                del self._due_s[stream]
                stream.close()

    @property
    def n_connections(self) -> int:
        return len(self._connections)
