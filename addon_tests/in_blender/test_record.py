"""What a phone stores of a scene is what a run sees in it, and the true light beside it is the room's."""

import contextlib
import json
from dataclasses import replace

import numpy as np
import pytest
from previs_runs import IPAD, LOOKS_AWAY, N_FRAMES, SMALL, QuickPrevis, counted_renders, unfinished_files, walk
from results_schema import read_strictly
from tiny_scenes import empty_scene, key, phone, room_with_a_virtual_sphere, saved, set_world

from addon_tests.pure.commands import assert_refused, xihe_here
from xihe_blender.capture.three_spheres import open_three_spheres
from xihe_blender.cli.main import main
from xihe_blender.errors import UserError
from xihe_blender.io.exr import read_radiance
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.record import RecordWishes, record_session
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet import estimators
from xihenet.captures import open_capture
from xihenet.captures.replay import never_in_view, replay
from xihenet.captures.writing import WRITERS
from xihenet.io.recording import load_frame
from xihenet.light.light_picture import sphere_mask

FEW = replace(SMALL, samples=1, exposure=1.0)


class NoisyProbes(QuickPrevis):
    """Light probes that seven pictures do not make good enough, for a run that asks for all of the light."""

    @property
    def reference(self):
        return replace(super().reference, max_samples=7, aims_at_ldr=False)


def record(scene, out, settings=SMALL, **wishes):
    return run_blocking(record_session(scene, out, settings, RecordWishes(**wishes), blend_file=out / "none.blend"))


def fired_by_position(results):
    """(frame, coefficients) of the valid estimates of a run by position, and where these are."""
    found, at = {}, {}
    for entry in results["frames"]:
        for probe in entry["probes"]:
            at[probe["name"]] = np.array(probe["position_m"])
            if probe["fired"] and probe["is_valid"]:
                found.setdefault(probe["name"], []).append((entry["frame"], probe["sh"]))
    return found, at


def replayed(folder, positions_m):
    capture, found = open_capture(folder), {}
    own = {"trigger": capture.trigger, "reference_exposure": capture.reference_exposure}
    lattice, unseen = estimators.load("lattice", target="hdr"), never_in_view(capture, positions_m)
    for step in replay(capture, positions_m, lattice, never_in_view=unseen, **own):
        for name, report in step.reports.items():
            if report.estimate is not None and report.estimate.is_valid:
                found.setdefault(name, []).append((step.frame, report.estimate.sh_radiance.tolist()))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("ran", "settings"), [("finished", SMALL), ("ipad", IPAD)], ids=["perfect", "ipad"])
def test_a_recorded_session_gives_the_light_of_the_run_to_the_last_bit(request, tmp_path, ran, settings):
    ran = request.getfixturevalue(ran)
    direct, at = fired_by_position(ran.results)
    assert record(walk(), tmp_path / "session", settings) == [f"{N_FRAMES} frames in {tmp_path / 'session'}"]
    assert (tmp_path / "session" / "session.json").is_file() and not unfinished_files(tmp_path / "session")
    assert set(direct) == {"Ball", "Board 1", "Board 2"}
    for one in (tmp_path / "session", ran.outputs.folder):
        assert replayed(one, at) == direct


@pytest.mark.slow
def test_the_true_light_is_that_of_the_run_and_measured_again_where_the_light_changes(finished, tmp_path):
    only = replace(SMALL, objects=("Ball",))
    assert record(walk(), tmp_path, only, has_truth=True)[-1] == "the true light at 1 place in truth.json"
    content = read_strictly(tmp_path / "truth.json")
    of_run = {(e["frame"], p["name"]): p["sh_truth"] for e in finished.results["frames"] for p in e["probes"]}
    assert content["exposure"] == finished.results["settings"]["reference_exposure"]
    by_frame = {(one["frame"], one["name"]): one for one in content["places"]}
    assert {frame for frame, _ in by_frame} == {1, LOOKS_AWAY + 1}
    shared = [which for which in by_frame if which in of_run]
    assert len(shared) == 2
    for which in shared:
        np.testing.assert_allclose(by_frame[which]["hdr"], of_run[which], rtol=1e-9, atol=1e-12)
        for name in by_frame[which]["files"].values():
            assert (tmp_path / name).stat().st_size > 0
    dimmed = [np.linalg.norm(by_frame[frame, "Ball"]["hdr"]) for frame in (1, LOOKS_AWAY + 1)]
    spheres = [read_radiance(tmp_path / by_frame[frame, "Ball"]["files"]["spheres"]) for frame in (1, LOOKS_AWAY + 1)]
    # The lamp is a sixth of what it was, and so is what the spheres show.
    assert dimmed[0] / dimmed[1] == pytest.approx(spheres[0].mean() / spheres[1].mean(), rel=0.2) and dimmed[1] > 0


def test_the_true_light_of_an_object_that_moves_is_measured_where_it_is(tmp_path, small_light_probes):
    scene = room_with_a_virtual_sphere(2, is_still=True)
    key(scene.objects["Ball"], "location", {1: (0, 0, 0.85), 2: (0.5, 0, 0.85)})
    record(scene, tmp_path / "out", FEW, has_truth=True)
    first, second = read_strictly(tmp_path / "out" / "truth.json")["places"]
    moved_m = np.array(second["position_m"]) - first["position_m"]
    assert np.linalg.norm(moved_m) > 0.4 and first["hdr"] != second["hdr"]


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    """A small session, recorded in our own layout."""
    folder = tmp_path_factory.mktemp("ours") / "ours"
    record(walk(2), folder, FEW)
    return open_capture(folder)


@pytest.mark.parametrize("layout", WRITERS)
def test_other_layouts_are_read_as_the_session_that_was_recorded(ours, tmp_path, layout):
    said = record(walk(2), tmp_path / "out", FEW, layout=layout)
    path = tmp_path / "out" / "recording.r3d" if layout == "record3d" else tmp_path / "out"
    theirs = open_capture(path)
    assert said[0] == f"2 frames in {path}" and len(theirs.frames) == len(ours.frames) == 2
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(other.plane_depth_m, one.plane_depth_m, atol=6e-4)
        # JPEG and video mix the colours of neighbours.
        off = np.abs(other.srgb_u8.astype(int) - one.srgb_u8)
        assert off.max() == 0 if layout in ("nerfstudio", "tum") else off.mean() < 3
        np.testing.assert_allclose(other.world_from_camera, one.world_from_camera, atol=1e-5)


def test_spheres_show_even_light_as_it_is():
    scene = empty_scene()
    phone(scene, (0, -2, 1), (0, 0, 1))
    set_world(scene, (0.3, 0.4, 0.2))
    with open_three_spheres(scene, SMALL.comparison((32, 32)), 32) as spheres:
        shown = spheres.seen_at(1, np.array([0.0, 0.0, 1.0]), 2.0)
    assert shown.shape == (32, 96, 3)
    inside = np.tile(sphere_mask(32), (1, 3))
    inner = inside & np.roll(inside, 2, axis=1) & np.roll(inside, -2, axis=1)
    np.testing.assert_allclose(shown[inner].mean(axis=0), [0.6, 0.8, 0.4], rtol=0.03)
    assert (shown[~inside] == 0).all()


def test_a_room_without_virtual_objects_is_recorded_too_and_a_stopped_recording_goes_on(tmp_path):
    def bare():
        scene = room_with_a_virtual_sphere(3)
        for item in virtual_objects(scene):
            item.user_clear()
            for home in list(item.users_collection):
                home.objects.unlink(item)
        return scene

    job = record_session(bare(), tmp_path / "out", FEW, RecordWishes(), blend_file=tmp_path / "none.blend")
    with contextlib.closing(job), counted_renders() as before:
        while before.count("Xihe Capture") < 2:
            next(job)
    assert not (tmp_path / "out" / "session.json").exists()
    scene = bare()
    with counted_renders() as after:
        record(scene, tmp_path / "out", FEW)
    assert (before + after).count("Xihe Capture") == 3
    capture = open_capture(tmp_path / "out")
    assert [frame.number for frame in capture.frames] == [1, 2, 3] and capture.trigger is not None
    assert load_frame(tmp_path / "out" / "frame_000001.exr").frame == 2
    with pytest.raises(UserError, match="give --at X,Y,Z"):
        record(bare(), tmp_path / "other", FEW, has_truth=True)
    assert not (tmp_path / "other").exists()
    record(bare(), tmp_path / "other", NoisyProbes(**vars(FEW)), has_truth=True, at_m=[(0.0, 0.0, 1.0)])
    (place,) = json.loads((tmp_path / "other" / "truth.json").read_text())["places"]
    assert place["position_m"] == [0, 0, 1] and place["ldr_samples"] == place["hdr_samples"] == 7


def test_the_command_records_and_says_what_it_left(tmp_path, capfd, small_light_probes):
    room_with_a_virtual_sphere(2)
    room = saved(tmp_path / "room.blend")
    typed = ["record", str(room), "--out", str(tmp_path / "out"), "--size", "32x24", "--samples", "1"]
    assert main(typed) == 0
    assert "2 frames in" in capfd.readouterr().out
    assert_refused(xihe_here(*typed, "--at", "0,0,1"), "give --truth as well")
    assert_refused(xihe_here(*typed, "--seed", "3"), "holds a recording with another seed")
