"""What files of tests share."""

import pytest
from addon_runs import lit_walk, registered_addon
from previs_runs import IPAD, QuickPrevis, finished_run
from tiny_scenes import opened, room_with_a_virtual_sphere, saved

from xihe_blender.capture.scanner import meter_exposure


@pytest.fixture(scope="session", autouse=True)
def coarse_metering():
    """An exposure is metered in this process with few rays: no test asks how little noise it has."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(meter_exposure.__kwdefaults__, "samples", 2)
        yield


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


@pytest.fixture(scope="session")
def ipad(tmp_path_factory):
    """The same with the phone of `IPAD`; nothing may change its folder."""
    return finished_run(tmp_path_factory.mktemp("ipad") / "out", IPAD)


@pytest.fixture(scope="module")
def addon():
    """The add-on is registered while the tests of a file run."""
    with registered_addon():
        yield


@pytest.fixture(scope="module")
def lit_run(finished, addon, tmp_path_factory):
    """The folder of a copy of `finished`, with `after.blend` that shows its light; for a registered add-on."""
    return lit_walk(tmp_path_factory.mktemp("lit") / "out", finished=finished)


@pytest.fixture(scope="session")
def room_file(tmp_path_factory):
    """The file of a room with a ball, whose path has three frames."""
    room_with_a_virtual_sphere(3)
    return saved(tmp_path_factory.mktemp("room") / "room.blend")


@pytest.fixture
def scene(room_file):
    """The scene of that file, which is open."""
    return opened(room_file)


@pytest.fixture
def out(room_file, tmp_path):
    """A folder to be made, beside a copy of `room_file`."""
    (tmp_path / "room.blend").write_bytes(room_file.read_bytes())
    return tmp_path / "out"
