"""What a run foresees of its own work."""

from types import SimpleNamespace

import pytest

from xihe_blender.previs.prepare import PreparedRun


def work_with(n_objects):
    run = SimpleNamespace(
        has_truth=True,
        n_renders={"capture": 2, "probe": 2 * n_objects, "comparison": 2},
        plan=SimpleNamespace(size=(160, 120), objects=range(n_objects)),
        capture=SimpleNamespace(samples=1),
        comparison=SimpleNamespace(samples=32),
        settings=SimpleNamespace(has_key_light=True),
        methods=("lattice", "ambient", "truth"),
    )
    return PreparedRun.work.func(run)


def test_a_model_of_many_parts_is_foreseen_to_be_compared_for_longer():
    """Each part has a view layer for each method; the ground truth is one picture."""
    few, many = work_with(3), work_with(66)
    assert many["methods"] == pytest.approx(22 * few["methods"])
    assert many["ground truth"] == few["ground truth"] and work_with(1)["methods"] == few["methods"]
