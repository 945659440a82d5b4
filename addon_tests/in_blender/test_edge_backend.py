"""`xihe previs --backend`: a run whose light comes from an edge service is the run without one."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from addon_runs import registered_addon, small_panel_runs, walk_for_the_panel
from previs_runs import SMALL, run, walk, with_renders_of

from addon_tests.pure.edge_servers import NEEDS_TORNADO, EdgeServer
from xihe_blender.addon.error_budget import XIHE_OT_measure_budget
from xihe_blender.addon.planning_operators import XIHE_OT_measure_run
from xihe_blender.addon.run_settings import previs_settings
from xihe_blender.errors import UserError
from xihe_blender.io.run_results import RecordingResult, read_results
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.results_notes import recorded_notes
from xihe_blender.previs.settings import close_backends, load_estimators
from xihenet.edge.batching import Inference
from xihenet.metrics import shc_rmse

pytestmark = NEEDS_TORNADO


def lights(results):
    return {
        (frame["frame"], one["name"]): np.array(one["sh"]) for frame in results["frames"] for one in frame["probes"]
    }


@pytest.mark.slow
def test_a_run_over_the_service_is_the_local_one(finished, tmp_path):
    here = finished.results
    with EdgeServer(inference=Inference("lattice")) as server:
        url = f"http://127.0.0.1:{server.port}"
        there = run(walk(), with_renders_of(finished.outputs.folder, tmp_path), replace(SMALL, backend=url))
    assert here["settings"]["backend"] is None and there["settings"]["backend"] == url
    assert any("Estimates came from an edge service: lattice at" in note for note in there["notes"])
    local, edge = lights(here), lights(there)
    assert local and local.keys() == edge.keys()
    assert max(shc_rmse(local[at], edge[at]) for at in local) < 1e-3


def test_a_service_that_estimates_otherwise_is_a_mistake_of_the_users():
    with EdgeServer() as server, pytest.raises(UserError, match=r"--backend: .* give --estimator projection"):
        load_estimators(replace(SMALL, backend=f"http://127.0.0.1:{server.port}"))


def test_a_run_on_a_recording_says_too_which_edge_service_estimated():
    with EdgeServer() as server:
        settings = replace(SMALL, estimator="projection", light="sh", backend=f"http://127.0.0.1:{server.port}")
        (backend,) = load_estimators(settings)
        run = SimpleNamespace(estimator=backend, settings=settings, survey=SimpleNamespace(faults=()))
        told = list(recorded_notes(run, [], RecordingResult(name="walk", format="TUM RGB-D", said="3 frames")))
        close_backends([backend])
    assert any(f"Estimates came from an edge service: projection at {settings.backend}" in note for note in told)


@pytest.fixture
def addon_for_small_runs():
    with registered_addon(), small_panel_runs():
        yield


def test_the_panels_edge_server_estimates_and_its_state_is_in_the_results(tmp_path, addon_for_small_runs):
    from xihe_blender.addon.panels import result_rows

    with EdgeServer(inference=Inference("lattice")) as server:
        url = f"http://127.0.0.1:{server.port}"
        two_frames = {"use_own_frames": True, "frame_end": 2}
        scene = walk_for_the_panel(tmp_path, estimator="lattice", uses_edge_server=True, edge_server=url, **two_frames)
        assert previs_settings(scene).backend == url
        assert bpy.ops.xihe.run() == {"FINISHED"}
    (row,) = [row for row in result_rows(read_results(Path(scene.xihe.run_folder))) if row[0] == "Edge Server"]
    assert row[1] == f"127.0.0.1:{server.port}" and "lattice at" in row[2] and "answers" in row[2]
    scene.xihe.uses_edge_server = False
    assert previs_settings(scene).backend is None


def test_an_edge_server_that_is_not_there_is_one_line(tmp_path, addon_for_small_runs, monkeypatch):
    monkeypatch.setattr("xihenet.edge.connection.time.sleep", lambda _: None)
    with EdgeServer() as server:
        url = f"http://127.0.0.1:{server.port}"
    walk_for_the_panel(tmp_path / "runs", estimator="lattice", uses_edge_server=True, edge_server=url)
    with pytest.raises(RuntimeError, match=f"Edge Server: {url} does not answer") as told:
        bpy.ops.xihe.run()
    assert len(str(told.value).strip().splitlines()) == 1
    assert not (tmp_path / "runs").exists(), "it is asked before anything is written"
    for start_job in (XIHE_OT_measure_run.start_job, XIHE_OT_measure_budget.start_job):
        job = start_job(SimpleNamespace(scene=bpy.context.scene), bpy.context)
        assert next(job).doing == "asking the edge server", "beside the window"
        with pytest.raises(UserError, match="does not answer"):
            run_blocking(job)
