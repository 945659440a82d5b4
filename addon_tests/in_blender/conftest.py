"""What files of tests share."""

import pytest
from previs_runs import QuickPrevis, finished_run


@pytest.fixture(scope="module")
def small_light_probes():
    """Commands in this process render them with few rays: what is asked is not how good they are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("xihe_blender.previs.settings.PrevisSettings", QuickPrevis)
        yield


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """An undisturbed run of `walk`; nothing may change its folder."""
    return finished_run(tmp_path_factory.mktemp("finished") / "out")
