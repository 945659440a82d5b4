"""`xihe previs --backend`: a run whose light comes from an edge service is the run without one."""

from dataclasses import replace

import numpy as np
import pytest
from previs_runs import SMALL, run, walk

from addon_tests.pure.edge_servers import NEEDS_TORNADO, EdgeServer
from xihe_blender.errors import UserError
from xihe_blender.previs.settings import load_estimators
from xihenet.edge.batching import Inference
from xihenet.metrics import shc_rmse

pytestmark = NEEDS_TORNADO


def lights(results):
    return {
        (frame["frame"], one["name"]): np.array(one["sh"]) for frame in results["frames"] for one in frame["probes"]
    }


def test_a_run_over_the_service_is_the_local_one(tmp_path):
    settings = replace(SMALL, frames=(1, 2))
    here = run(walk(), tmp_path / "here", settings)
    with EdgeServer(inference=Inference("lattice")) as server:
        url = f"http://127.0.0.1:{server.port}"
        there = run(walk(), tmp_path / "there", replace(settings, backend=url))
    assert here["settings"]["backend"] is None and there["settings"]["backend"] == url
    assert any("Estimates came from an edge service: lattice at" in note for note in there["notes"])
    local, edge = lights(here), lights(there)
    assert local and local.keys() == edge.keys()
    assert max(shc_rmse(local[at], edge[at]) for at in local) < 1e-3


def test_a_service_that_estimates_otherwise_is_a_mistake_of_the_users():
    with EdgeServer() as server, pytest.raises(UserError, match=r"--backend: .* give --estimator projection"):
        load_estimators(replace(SMALL, backend=f"http://127.0.0.1:{server.port}"))
