"""Our own sessions: what they say of themselves, and four hundred frames do not fill the memory."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from addon_tests.pure.broken_recordings import in_header
from addon_tests.pure.commands import assert_refused, xihe_here
from addon_tests.pure.recordings import walk
from addon_tests.pure.test_estimate_command import read_strictly
from addon_tests.pure.test_long_captures import measured
from xihe_blender.cli.main import main
from xihenet.captures import open_capture
from xihenet.io.recording import SessionFacts, SessionRecorder
from xihenet.records import Intrinsics
from xihenet.trigger import RULES, TriggerSettings

CAMERA = Intrinsics(32, 24, 20.0, 20.0, 16.0, 12.0)


def write_walk(folder, n=3, facts=SessionFacts()):  # noqa: B008, frozen
    recorder = SessionRecorder(folder, facts)
    for frame in walk(CAMERA, n):
        recorder.record(frame)


def test_frames_without_numbers_are_counted(tmp_path):
    recorder = SessionRecorder(tmp_path / "in")
    for frame in walk(CAMERA, 3):
        recorder.record(replace(frame, frame=0))
    assert [frame.read().frame for frame in open_capture(tmp_path / "in").frames] == [0, 1, 2]


def test_what_it_says_of_itself_comes_back_and_time_may_go_backwards(tmp_path, capfd):
    facts = SessionFacts("a room", ("The lens is not known.",), 0.5, TriggerSettings(theta=0.25))
    write_walk(tmp_path / "in", facts=facts)
    in_header(time=-4.0)(tmp_path / "in")
    capture = open_capture(tmp_path / "in")
    assert (capture.notes, capture.reference_exposure, capture.trigger) == (facts.not_known, 0.5, facts.trigger)
    assert [frame.time_s for frame in capture.frames][1] == -4.0
    assert main(["replay", str(tmp_path / "in"), "--at", "0,0,0", "--out", str(tmp_path / "out")]) == 0
    assert "The lens is not known." in capfd.readouterr().err
    written = read_strictly((tmp_path / "out" / "replay.json").read_text())
    assert (written["reference_exposure"], written["source"]) == (0.5, "a room")
    assert written["trigger"] == asdict(facts.trigger)
    assert "A replay: Xihe session (a room)" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    again = xihe_here("replay", tmp_path / "in", "--at", "0,0,0", "--out", tmp_path / "o", "--up", "y")
    assert_refused(again, "leave out --up")


def test_a_replay_leaves_the_report_of_a_run_alone_and_says_what_it_lacks(tmp_path):
    write_walk(tmp_path)
    (tmp_path / "report.html").write_text("of a run")
    at = ("replay", tmp_path, "--at", "0,0,0")
    assert_refused(xihe_here(*at, "--out", tmp_path), "choose another folder for --out")
    assert (tmp_path / "report.html").read_text() == "of a run"
    scored = xihe_here("replay", tmp_path, "--score", "--to", "three", "--out", tmp_path / "out")
    assert_refused(scored, "give --at X,Y,Z as well")
    for _ in "once", "again":
        assert xihe_here(*at, "--out", tmp_path / "out").returncode == 0


def test_the_sessions_own_trigger_is_used_unless_another_is_chosen(tmp_path):
    write_walk(
        tmp_path / "in", n=4, facts=SessionFacts("a room", (), 1.0, TriggerSettings(policy="reference", theta=1.0))
    )
    made = {}
    for name, options in (("own", ()), ("every", ("--trigger", "every-frame"))):
        xihe_here("replay", tmp_path / "in", "--at", "0,0,0", "--out", tmp_path / name, *options)
        written = read_strictly((tmp_path / name / "replay.json").read_text())
        made[name] = len(written["positions"][0]["lights"]), written["trigger"]
    assert made["own"] == (1, asdict(TriggerSettings(policy="reference", theta=1.0)))
    assert made["every"] == (4, asdict(RULES["every-frame"]))


def test_light_carries_the_sessions_exposure_and_white_balance_is_taken_out(tmp_path):
    """Frames of one room, taken with factors of their own, give the light that they give with one."""
    frames, factors = walk(CAMERA, 3), ([1.0, 1.0, 1.0], [0.8, 0.9, 0.85], [0.7, 0.9, 0.6])
    plain, drifted = SessionRecorder(tmp_path / "plain"), SessionRecorder(tmp_path / "drifted")
    for frame, each in zip(frames, factors, strict=True):
        plain.record(frame)
        light = ((frame.srgb_u8 / 255.0) ** 2.2) * each
        dimmed = np.rint(255 * light.clip(0, 1) ** (1 / 2.2)).astype(np.uint8)
        drifted.record(replace(frame, srgb_u8=dimmed, white_balance=each))
    lights = []
    for name in ("plain", "drifted"):
        out = tmp_path / f"{name}_out"
        assert main(["replay", str(tmp_path / name), "--at", "0.4,0.3,-0.5", "--out", str(out)]) == 0
        lights.append(
            np.array(read_strictly((out / "replay.json").read_text())["positions"][0]["lights"][-1]["sh_radiance"])
        )
    # sRGB is no power of 2.2: what is left is some per cent of the light, where it was 30.
    assert np.abs(lights[1] - lights[0]).max() < 0.04 * np.abs(lights[0]).max()


@pytest.mark.slow
def test_four_hundred_frames_stay_on_disk(tmp_path):
    """Held at once they are 54 MB."""
    SessionRecorder(tmp_path).record(*walk(Intrinsics(160, 120, 100.0, 100.0, 80.0, 60.0), 1))
    for number in range(1, 400):
        (tmp_path / f"frame_{number:06d}.exr").hardlink_to(tmp_path / "frame_000000.exr")
    ((n_frames, n_read, grown_mb, *_),) = measured(tmp_path, every=1)
    assert n_frames == n_read == 400 and grown_mb < 30
