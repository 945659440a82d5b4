"""Settings of the HTTP server: where it listens, who may ask, and what it bears."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from xihenet.edge.protocol import PORT
from xihenet.edge.service import ServiceSettings

MAX_BODY_BYTES = 65_536
"""A cloud of 2048 anchors has 36,864 bytes in the longest encoding."""


@dataclass(frozen=True)
class ServerSettings:
    """How `xihe serve` listens. Without a certificate it speaks plain HTTP, without a bearer token to anyone."""

    host: str = "127.0.0.1"
    port: int = PORT  # 0 takes a free one
    store: str = ""  # address of a Redis that keeps the sessions, see `redis_store`; without one they are in memory
    worker: int | None = None  # which of several processes that share the port this is; None for one alone
    service: ServiceSettings = field(default_factory=ServiceSettings)
    origins: tuple[str, ...] = ()  # of web pages that may ask, besides the server's own; "*" for all
    certificate: Path | None = None  # PEM, with `key` beside
    key: Path | None = None
    bearer: str = ""  # token that each request must carry, but for health
    log: Literal["faults", "all"] = "faults"
    header_s: float = 30.0  # from a connection's start, or its last answer, to the end of the next headers; and for an
    # answer to be taken
    body_s: float = 5.0  # to the end of the body
    max_header_bytes: int = 16_384
    max_connections: int = 512  # each holds 64 kB of body at most
