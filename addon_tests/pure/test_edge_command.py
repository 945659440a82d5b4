"""`xihe serve` as a process that starts, stops and is killed, and `xihe replay --backend` that estimates by it."""

import json
import signal
import socket
import sys
from contextlib import closing, suppress

import numpy as np
import pytest

from addon_tests.pure.commands import assert_refused, xihe_here
from addon_tests.pure.edge_servers import NEEDS_TORNADO, EdgeServer, serving
from addon_tests.pure.made import random_cloud
from addon_tests.pure.recordings import LAYOUTS, walk
from xihe_blender.cli.main import main
from xihenet.edge.batching import Inference
from xihenet.edge.client import EdgeBackend
from xihenet.metrics import shc_rmse

pytestmark = NEEDS_TORNADO


PROJECTION = ("--estimator", "projection", "--port")


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_it_serves_until_it_is_told_to_stop_and_logs_json(how):
    with serving(*PROJECTION, "0", "--log", "all") as (process, port):
        with closing(EdgeBackend(f"http://127.0.0.1:{port}", 512)) as backend:
            assert backend.estimate(random_cloud(np.random.default_rng(0), 512)).any()
            token, session = backend._session["token"], backend._session["session"]
        process.send_signal(how)
        _, logged = process.communicate(timeout=20)
        assert process.returncode == 0
    lines = [json.loads(line) for line in logged.splitlines()]
    assert [line["event"] for line in lines] == ["started", "request", "request", "request", "stopping"]
    assert lines[2]["status"] == 200 and lines[2]["body_bytes"] > 1000
    assert token not in logged and session not in logged


AS_ON_WINDOWS = """
import asyncio, signal, sys

def refuse(loop, *_):
    signal.set_wakeup_fd(loop._csock.fileno())  # As loops of Windows do, or a signal just before they wait is not seen.
    raise NotImplementedError

asyncio.SelectorEventLoop.add_signal_handler = refuse
signal.signal(signal.SIGINT, signal.default_int_handler)  # Shells ignore it in the background.
from xihe_blender.cli.main import main
sys.exit(main())
"""


def test_ctrl_c_is_its_end_and_no_fault_where_event_loops_know_no_signals():
    with serving(*PROJECTION, "0", xihe=("-c", AS_ON_WINDOWS)) as (process, _):
        process.send_signal(signal.SIGINT)
        _, logged = process.communicate(timeout=20)
        assert process.returncode == 0
    assert [json.loads(line)["event"] for line in logged.splitlines()] == ["started", "stopping"]


def has_ipv6():
    with suppress(OSError), socket.create_server(("::1", 0), family=socket.AF_INET6):
        return True
    return False


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
def test_an_ipv6_address_is_said_as_it_is_opened():
    with (
        serving(*PROJECTION, "0", "--host", "::1", host=r"\[::1\]") as (_, port),
        closing(EdgeBackend(f"http://[::1]:{port}", 512)) as backend,
    ):
        assert backend.name == "projection"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--estimator", "truth"], "choose another estimator"),
        (["--estimator", "magic"], "choose one of ambient"),
        (["--sizes", "0"], "--sizes: expected numbers from 1 to 2048"),
        (["--port", "70000"], "--port: expected 0 to 65535"),
        (["--expire", "0"], "--expire: expected more than 0"),
        (["--expire", "inf"], "1000000000 at most"),
        (["--sessions", "0"], "--sessions: expected 1 or more"),
        (["--workers", "0"], "--workers: expected 1 or more"),
        (["--workers", "2"], "give --store redis://HOST:PORT/DB as well"),
        (["--store", "127.0.0.1:6379"], "--store: expected redis://HOST:PORT/DB"),
        (["--store", "redis://127.0.0.1:x/0"], "--store: expected redis://HOST:PORT/DB"),
        (["--store", "redis://:secret@127.0.0.1:9/0"], "start redis-server there"),
        (["--key", "k.pem"], "give --certificate as well"),
        (["--bearer", "missing.txt"], "give a file with a token in it"),
        (["--port", "0", "--certificate", "missing.pem"], "check --certificate and --key"),
        (["--port", "0", "--certificate", __file__], "cannot speak HTTPS with"),
        (["--host", "192.0.2.1"], "choose another --host or --port"),
        (["--host", "127.0.0..1"], "choose another --host or --port"),
        (["--allow-origin", "https://app.example/"], "--allow-origin: expected what browsers send"),
        (["--allow-origin", "app.example"], "--allow-origin: expected what browsers send"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_fix(options, said, capfd):
    assert main(["serve", *options]) == 2
    error = capfd.readouterr().err.strip().splitlines()
    assert len([line for line in error if line.startswith("xihe: ")]) == 1 and said in error[-1]
    assert "secret" not in " ".join(error)


def test_without_tornado_the_extra_is_named(monkeypatch):
    for name in [name for name in sys.modules if name.startswith(("tornado", "xihenet.edge.server"))]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("handler", "requests", "routes"):
        monkeypatch.delitem(sys.modules, f"xihenet.edge.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "tornado", None)
    assert_refused(xihe_here("serve"), "pip install 'xihe-blender[edge]'")


def test_without_redis_py_the_extra_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "xihenet.edge.redis_store", raising=False)
    monkeypatch.setitem(sys.modules, "redis", None)
    asked = xihe_here("serve", "--store", "redis://127.0.0.1:9/0")
    assert_refused(asked, "--store needs redis-py: pip install 'xihe-blender[edge]'")


def test_without_torch_the_extra_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "xihenet.edge.torch_networks", raising=False)
    monkeypatch.setitem(sys.modules, "torch", None)
    asked = xihe_here("serve", "--device", "cuda")
    assert_refused(asked, "--device cuda needs torch: pip install 'xihe-blender[edge,train]'")


def test_a_replay_over_the_service_is_the_local_one(tmp_path, capfd):
    write, intrinsics = LAYOUTS["Nerfstudio"]
    write(tmp_path / "session", walk(intrinsics, 4))
    ask = ["replay", str(tmp_path / "session"), "--at", "0.3,0.2,0.1"]
    assert main([*ask, "--out", str(tmp_path / "here")]) == 0
    with EdgeServer(inference=Inference("lattice")) as server:
        url = f"http://127.0.0.1:{server.port}"
        assert main([*ask, "--out", str(tmp_path / "there"), "--backend", url]) == 0
        assert f"note: lattice at {url}" in capfd.readouterr().err
        assert server.service.store.counts() == (0, 0)
        wrong = xihe_here(*ask, "--out", tmp_path / "x", "--backend", url, "--estimator", "projection")
        assert_refused(wrong, "give --estimator lattice")
    here, there = (json.loads((tmp_path / name / "replay.json").read_text()) for name in ("here", "there"))
    assert here["backend"] is None and there["backend"] == url
    pairs = list(zip(here["positions"][0]["lights"], there["positions"][0]["lights"], strict=True))
    assert len(pairs) > 1
    assert all(shc_rmse(np.array(a["sh_radiance"]), np.array(b["sh_radiance"])) < 1e-3 for a, b in pairs)


def test_a_service_that_is_not_there_is_said(tmp_path, monkeypatch):
    write, intrinsics = LAYOUTS["Nerfstudio"]
    write(tmp_path, walk(intrinsics, 2))
    monkeypatch.setattr("xihenet.edge.connection.time.sleep", lambda _: None)
    ask = ["replay", str(tmp_path), "--at", "0,0,0", "--out", str(tmp_path / "out")]
    assert_refused(xihe_here(*ask, "--backend", "http://127.0.0.1:9"), "does not answer")
    assert_refused(xihe_here(*ask, "--backend", "127.0.0.1:8550"), "such as http://127.0.0.1:8550")
