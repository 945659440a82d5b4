"""`xihe serve`: the edge service, which answers phones with the light of what they have seen."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import re
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import adder, one_of, whole_numbers
from xihe_blender.errors import UserError
from xihenet import estimators
from xihenet.codec import MAX_STRIPPED_ANCHORS
from xihenet.edge.batching import Inference, unserved_because
from xihenet.edge.bench import bench_lines
from xihenet.edge.client import BEARER_VARIABLE
from xihenet.edge.http_settings import ServerSettings
from xihenet.edge.protocol import PORT
from xihenet.edge.service import PUBLISHED_SIZES, ServiceSettings
from xihenet.edge.sessions import StoreLimits, StoreLost

NEEDS_TORNADO = "the server needs Tornado: pip install 'xihe-blender[edge]'"
NEEDS_REDIS = "--store needs redis-py: pip install 'xihe-blender[edge]'"
STORE_VARIABLE = "XIHE_EDGE_STORE"
MOST_EXPIRE_S = 1e9
"""Some thirty years: Redis keeps times in whole milliseconds."""

NO_FILE = "note: the store's append-only file is off, so that sessions are lost when it restarts"
ORIGIN = re.compile(r"[a-z][a-z0-9+.-]*://[^/?#\sA-Z]+")
"""A scheme and a host in lower case, and a port: browsers send nothing else, and it is compared as text."""
SIZES = f"numbers of anchors that sessions may have; default: {', '.join(map(str, PUBLISHED_SIZES))}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    add("--host ADDRESS", "address to listen at; 0.0.0.0 for all of this machine's", default="127.0.0.1")
    add("--port PORT", "port to listen at; 0 for a free one", int, default=PORT)
    served = one_of(name for name in estimators.names() if not unserved_because(name))
    add("--estimator NAME", f"{served}; default: {estimators.DEFAULT}", default=estimators.DEFAULT)
    add("--device", "where the network runs: cpu, or cuda in torch", choices=("cpu", "cuda"), default="cpu")
    target = "light that published clients get: clipped at white (ldr, as in the paper) or all of it (hdr)"
    add("--target", target, choices=("ldr", "hdr"), default="ldr")
    add("--sizes N,M", SIZES, whole_numbers, default=PUBLISHED_SIZES)
    add("--expire SECONDS", "forget a session that was idle for this long", float, default=StoreLimits.idle_s)
    add("--sessions N", "sessions that may be open at a time", int, default=StoreLimits.n_sessions)
    store = f"keep sessions in Redis, redis://HOST:PORT/DB, which outlives the server; or the variable {STORE_VARIABLE}"
    add("--store URL", store)
    add("--workers N", "processes that share the port; more than one need --store", int, default=1)
    add("--allow-origin ORIGIN", "web pages that may ask, or *; may be repeated", action="append", default=[])
    add("--certificate FILE.pem", "speak HTTPS, with this certificate", Path)
    add("--key FILE.pem", "its private key, if that is in a file of its own", Path)
    bearer = f"answer only those who send the token of this file, or of the variable {BEARER_VARIABLE}"
    add("--bearer FILE", bearer, Path)
    add("--bench", "measure what estimates cost on this machine, print the tables and stop", action="store_true")
    add("--log", "requests that are logged on stderr, a line of JSON each", choices=("faults", "all"), default="faults")


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    try:
        from xihenet.edge.handler import logged_to
        from xihenet.edge.server import serve, tls_of
        from xihenet.edge.workers import CannotStart, serve_by_workers
    except ModuleNotFoundError as error:
        if error.name != "tornado":
            raise
        raise UserError(NEEDS_TORNADO) from error
    settings = server_settings(options)
    try:
        tls_of(settings)
    except OSError as error:
        files = " and ".join(str(path) for path in (options.certificate, options.key) if path is not None)
        raise UserError(
            f"cannot speak HTTPS with {files} ({error.strerror or error}): check --certificate and --key, which are "
            "PEM files that belong together, the key without a password"
        ) from error
    try:
        inference = Inference(options.estimator, options.device)
    except ValueError as error:
        raise UserError(f"--estimator {options.estimator}: {error}") from error
    except ImportError as error:
        raise UserError(f"--device {options.device} needs torch: pip install 'xihe-blender[edge,train]'") from error
    if options.bench:
        for line in bench_lines(inference):
            print(line, file=stdout, flush=True)
        return
    if settings.store:
        _check_store(settings.store, stderr)
    scheme = "http" if settings.certificate is None else "https"
    host = f"[{options.host}]" if ":" in options.host else options.host  # IPv6, as it is in URLs

    def ready(port: int) -> None:
        print(f"serving at {scheme}://{host}:{port}, Ctrl-C to stop", file=stdout, flush=True)

    try:
        with logged_to(stderr), contextlib.suppress(KeyboardInterrupt):  # Of Windows: it is how a server ends.
            if options.workers > 1:
                serve_by_workers(inference, settings, options.workers, ready, log_to=stderr.fileno())
            else:
                asyncio.run(serve(inference, settings, ready))
    except CannotStart as error:
        raise UserError(f"--workers {options.workers}: {error}") from error
    except OSError as error:
        reason = error.strerror or error
        raise UserError(
            f"cannot listen at {host}:{options.port} ({reason}): choose another --host or --port"
        ) from error


def server_settings(options: argparse.Namespace) -> ServerSettings:
    """The settings that the options say; UserError for those that cannot be."""
    sizes = tuple(sorted(set(options.sizes)))
    if not sizes or sizes[0] < 1 or sizes[-1] > min(MAX_STRIPPED_ANCHORS, PUBLISHED_SIZES[-1]):
        raise UserError(f"--sizes: expected numbers from 1 to {PUBLISHED_SIZES[-1]}, got {options.sizes}")
    if not 0 <= options.port <= 65535:
        raise UserError(f"--port: expected 0 to 65535, got {options.port}")
    if not 0 < options.expire <= MOST_EXPIRE_S:
        raise UserError(f"--expire: expected more than 0, and {MOST_EXPIRE_S:.0f} at most, got {options.expire:g}")
    if options.sessions < 1:
        raise UserError(f"--sessions: expected 1 or more, got {options.sessions}")
    if options.key is not None and options.certificate is None:
        raise UserError("--key belongs to a certificate: give --certificate as well")
    for origin in options.allow_origin:
        if origin not in ("*", "null") and not ORIGIN.fullmatch(origin):
            raise UserError(
                f"--allow-origin: expected what browsers send as Origin, such as https://app.example, without a path "
                f"or a slash at the end, or *, got {origin!r}"
            )
    if options.workers < 1:
        raise UserError(f"--workers: expected 1 or more, got {options.workers}")
    store = options.store or os.environ.get(STORE_VARIABLE, "")
    if options.workers > 1 and not store:
        raise UserError("--workers above 1 share their sessions in a store: give --store redis://HOST:PORT/DB as well")
    n_positions = max(StoreLimits.n_positions, 4 * options.sessions)
    limits = StoreLimits(options.sessions, n_positions, idle_s=options.expire)
    return ServerSettings(
        options.host,
        options.port,
        store,
        service=ServiceSettings(sizes, options.target, limits=limits),
        origins=tuple(options.allow_origin),
        certificate=options.certificate,
        key=options.key,
        bearer=_bearer(options.bearer),
        log=options.log,
    )


def _check_store(url: str, stderr: Any) -> None:
    """UserError for a store that cannot be or does not answer; a note if it forgets. The URL may hold a password."""
    try:
        from xihenet.edge.redis_store import RedisStore

        with contextlib.closing(RedisStore(url)) as store:
            store.check()
            if not store.keeps_a_file():
                print(NO_FILE, file=stderr)
    except ModuleNotFoundError as error:
        if error.name != "redis":
            raise
        raise UserError(NEEDS_REDIS) from error
    except ValueError as error:
        raise UserError(f"--store: expected redis://HOST:PORT/DB ({error})") from error
    except StoreLost as error:
        raise UserError(
            f"--store: {str(error.__cause__).rstrip('.')}: start redis-server there, or give its address, password and "
            "number of the database"
        ) from error


def _bearer(path: Path | None) -> str:
    if path is None:
        return os.environ.get(BEARER_VARIABLE, "")
    try:
        token = path.read_text(encoding="utf-8-sig").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"--bearer: cannot read {path} ({error}): give a file with a token in it") from error
    if not token:
        raise UserError(f"--bearer: {path} is empty: give a file with a token in it")
    return token
