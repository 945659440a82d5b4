"""Work over Dask: what dies is tried again, what cannot be done says so, and rooms are the same whoever makes them."""

import importlib.metadata
import signal
import subprocess
import sys
import threading
from pathlib import Path
from urllib.request import urlopen

import bpy
import pytest
from small_rooms import small_build

from addon_tests.pure.test_broken_pipes import AS_IN_BLENDER
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.rooms.build import build_dataset
from xihe_blender.lab.rooms.render_room import make_room
from xihe_blender.lab.rooms.store import room_path, save_room
from xihe_blender.lab.workers import dask_workers
from xihe_blender.lab.workers.dask_workers import Work, dashboard, open_dask_workers, own_program
from xihe_blender.lab.workers.processes import EXIT_CRASHED, module_command

pytestmark = pytest.mark.wheel_only("a whole Blender's Python has no Dask")


def cluster_here(n_workers=1, dashboard_address=None):
    """A scheduler with workers in this process."""
    from distributed import LocalCluster

    on_loopback = {"protocol": "tcp", "host": "127.0.0.1", "dashboard_address": dashboard_address}
    return LocalCluster(n_workers=n_workers, threads_per_worker=1, processes=False, **on_loopback)


@pytest.fixture(scope="module")
def scheduler():
    """The address of one with two workers."""
    with cluster_here(2, "127.0.0.1:0") as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def scripts(tmp_path, monkeypatch):
    """A folder whose modules a worker's processes can run."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path


def asked(name, *arguments):
    return Work(f"{name} {arguments}", name, arguments)


def run(scheduler, *work):
    """What failed, and why."""
    with open_dask_workers(None, scheduler) as workers:
        assert list(workers.run(work, "piece of work"))[-1].done == len(work)
        return workers.failed


def test_a_process_that_dies_is_tried_again(scheduler, scripts):
    (scripts / "dies_once.py").write_text(
        "import os, sys, pathlib; n = pathlib.Path(sys.argv[1]); n.exists() or (n.touch(), os.kill(os.getpid(), 9))"
    )
    assert run(scheduler, asked("dies_once", str(scripts / "mark"))) == {}
    assert (scripts / "mark").exists()


def test_lines_of_blenders_own_may_have_any_encoding(scheduler, scripts):
    code = "import sys; sys.stdout.buffer.write(b'Read blend: C:\\\\caf\\xe9.blend\\n0.5\\n')"
    (scripts / "says_more.py").write_text(code)
    assert run(scheduler, Work("one", "says_more", told={})) == {}


def test_a_blender_ends_without_a_trace_when_nobody_reads_it_any_more():
    work = f"""
{AS_IN_BLENDER if hasattr(signal, "SIGPIPE") else ""}
import time; from xihe_blender.lab.workers.processes import *
print("in", bpy.app.tempdir, flush=True)
with only_with_a_reader(1): time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", work], stdout=subprocess.PIPE, text=True) as process:
        own_folder = Path(next(line for line in process.stdout if line.startswith("in "))[3:].strip())
        assert own_folder.is_dir()
        process.stdout.close()
        assert process.wait(20) == EXIT_CRASHED
    assert not own_folder.exists()


def test_one_that_always_dies_is_named_and_the_others_are_done(scheduler, scripts):
    (scripts / "dies.py").write_text("import os; os.abort()")
    (scripts / "works.py").write_text("import sys, pathlib; pathlib.Path(sys.argv[1]).touch()")
    work = [asked("dies"), *(asked("works", str(scripts / f"done {k}")) for k in range(3))]
    failed = run(scheduler, *work)
    assert list(failed) == ["dies ()"] and "exit code -6" in failed["dies ()"]
    assert all((scripts / f"done {k}").exists() for k in range(3))


def test_what_the_user_can_mend_is_not_tried_again(scheduler, scripts):
    (scripts / "says.py").write_text(
        "import sys; open(sys.argv[1], 'a').write('x'); print('mend it', file=sys.stderr); sys.exit(2)"
    )
    assert list(run(scheduler, asked("says", str(scripts / "tries"))).values()) == ["mend it"]
    assert (scripts / "tries").read_text() == "x"


def test_work_of_a_whole_blender_is_done_by_another_of_it(scheduler, scripts, monkeypatch):
    blender = scripts / "blender"
    blender.write_text(f'#!/bin/sh\necho Blender 4.3.2\nexec {sys.executable} "$4" -- "$6" "$7" "$8"\n')
    blender.chmod(0o755)
    (scripts / "tells.py").write_text(
        "import json, sys; print(1.0); json.dump(json.load(sys.stdin), open(sys.argv[1], 'w'))"
    )
    assert own_program("tells") == (sys.executable, "-m", "tells")
    monkeypatch.syspath_prepend(scripts)
    program = tuple(module_command("tells", str(blender)))
    assert run(scheduler, Work("tells", "tells", (str(scripts / "told"),), {"seed": 7}, program)) == {}
    assert (scripts / "told").read_text() == '{"seed": 7}'


@pytest.mark.slow
def test_rooms_made_over_a_scheduler_are_those_of_one_process(scheduler, tmp_path):
    over = small_build(1, scheduler=scheduler)
    save_room(tmp_path / "here.npz", make_room(over, 0))
    assert run_blocking(build_dataset(tmp_path / "there", over)) == 1
    assert run_blocking(build_dataset(tmp_path / "there", over)) == 0
    assert room_path(tmp_path / "there", 0).read_bytes() == (tmp_path / "here.npz").read_bytes()


def test_a_dashboard_is_named_where_there_is_one(scheduler):
    # With bokeh there is one, and without it Dask answers with how to get it.
    with open_dask_workers(None, scheduler) as workers:
        said = dashboard(workers)
        with urlopen(workers.client.dashboard_link, timeout=20) as page:
            is_there = b"Dask needs bokeh" not in page.read()
        none = "no dashboard: it takes a scheduler with bokeh installed"
        assert said == (f"dashboard: {page.url}" if is_there else none)
    assert page.url.startswith("http://127.0.0.1:") and page.url.endswith("/status")


def test_a_scheduler_that_was_started_without_a_dashboard_has_none():
    with cluster_here() as cluster, open_dask_workers(None, cluster.scheduler_address) as workers:
        assert dashboard(workers).startswith("no dashboard")


def test_a_folder_that_no_worker_sees_is_one_line(scheduler, tmp_path):
    with open_dask_workers(None, scheduler) as workers, pytest.raises(UserError, match="under the same path"):
        workers.check_workers(str(tmp_path / "none"), [])


def test_a_worker_with_another_blender_is_one_line(scheduler, tmp_path, monkeypatch):
    there = {"module": "4.4.0"}

    def version():
        return "4.5.0" if threading.current_thread() is threading.main_thread() else there["module"]

    monkeypatch.setattr(dask_workers, "blender_version", version)
    with open_dask_workers(None, scheduler) as workers:
        for there["module"], said in (("4.4.0", "Blender 4.4.0"), (None, "no Blender as a Python module")):
            with pytest.raises(UserError, match=f"has {said} and this is Blender 4.5.0, which may render differently"):
                workers.check_workers(str(tmp_path), [])
        there["module"] = "4.5.0"
        workers.check_workers(str(tmp_path), [])


def test_a_whole_blender_which_has_no_package_knows_its_version(monkeypatch):
    def none(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", none)
    assert dask_workers.blender_version() == ".".join(map(str, bpy.app.version))
    monkeypatch.delitem(sys.modules, "bpy")
    assert dask_workers.blender_version() is None


def test_a_scheduler_that_is_lost_is_one_line_and_nothing_has_failed(scripts):
    (scripts / "waits.py").write_text("import time; time.sleep(0.3)")
    with cluster_here() as cluster, open_dask_workers(None, cluster.scheduler_address) as workers:
        job = workers.run([asked("waits", "1"), asked("waits", "2")], "piece of work")
        next(job)
        (to_us,) = cluster.scheduler.client_comms.values()
        cluster.loop.add_callback(to_us.comm.abort)
        with pytest.raises(UserError, match="cannot be reached any more: start it"):
            list(job)
        assert workers.failed == {}


def test_an_address_that_is_none_is_one_line(monkeypatch):
    monkeypatch.setattr("xihe_blender.lab.workers.dask_workers.CONNECT_S", 1.0)
    for address in ("nowhere", "", "foo://127.0.0.1:1", "tls://127.0.0.1:1", "tcp://127.0.0.1:1"):
        with pytest.raises(UserError, match="no scheduler answers"), open_dask_workers(None, address):
            pass
