"""Our own sessions: what is broken in one is one line, and a thousand frames do not fill the memory."""

import json
from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.recordings import walk
from addon_tests.pure.test_estimate_command import read_strictly
from addon_tests.pure.test_long_captures import measured
from xihe_blender.cli.main import main
from xihenet.captures import open_capture
from xihenet.exr import exr_attributes, read_exr, write_exr
from xihenet.recording import SessionFacts, SessionRecorder
from xihenet.records import Intrinsics
from xihenet.trigger import TriggerSettings

CAMERA = Intrinsics(32, 24, 20.0, 20.0, 16.0, 12.0)


def write_walk(folder, n=3, facts=SessionFacts()):  # noqa: B008, frozen
    recorder = SessionRecorder(folder, facts)
    for frame in walk(CAMERA, n):
        recorder.record(frame)


def said(**changes):
    """Change what session.json says."""

    def harm(folder):
        path = folder / "session.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))

    return harm


def header(**changes):
    """Change what the second frame's header says; None leaves an entry out."""

    def harm(folder):
        path = folder / "frame_000001.exr"
        entries = {**exr_attributes(path), **changes}
        kept = {name: value for name, value in entries.items() if value is not None}
        write_exr(path, read_exr(path), attributes=kept)

    return harm


def channels(**changes):
    def harm(folder):
        path = folder / "frame_000001.exr"
        found = {**read_exr(path), **changes}
        kept = {name: value for name, value in found.items() if value is not None}
        write_exr(path, kept, attributes=exr_attributes(path))

    return harm


def cut(n):
    def harm(folder):
        path = folder / "frame_000001.exr"
        path.write_bytes(path.read_bytes()[:n])

    return harm


def text(content):
    return lambda folder: (folder / "session.json").write_text(content)


def no_frames(folder):
    for path in folder.glob("*.exr"):
        path.unlink()


def folder_for_a_frame(folder):
    (folder / "frame_000001.exr").unlink()
    (folder / "frame_000001.exr").mkdir()


MIRRORED, STRETCHED = np.diag([-1.0, 1, 1, 1]), np.diag([2.0, 2, 2, 1])
BROKEN = {
    "no JSON": (text("{"), "session.json"),
    "a list": (text("[]"), "expected a JSON object"),
    "another format": (said(format="other"), "expected a JSON object with format"),
    "a later version": (said(version=2), "version: expected 1, got 2"),
    "a negative exposure": (said(reference_exposure=-1), "reference_exposure: expected a positive factor"),
    "a trigger of words": (said(trigger={"magic": 1}), "session.json"),
    "files that are no list": (said(files="frame.exr"), "files: expected a list of texts"),
    "a file elsewhere": (said(files=["../x.exr"]), "lies outside"),
    "a file that is not there": (said(files=["frame_000009.exr"]), "frame_000009.exr"),
    "no frames": (no_frames, "record again"),
    "an empty frame": (cut(0), "frame_000001.exr"),
    "half a header": (cut(60), "frame_000001.exr"),
    "a frame cut short": (cut(900), "frame_000001.exr"),
    "a folder for a frame": (folder_for_a_frame, "frame_000001.exr"),
    "a NaN pose": (header(worldFromCamera=np.full((4, 4), np.nan)), "worldFromCamera: expected finite numbers"),
    "a left-handed pose": (header(worldFromCamera=MIRRORED), "it mirrors"),
    "a pose that scales": (header(worldFromCamera=STRETCHED), "without scale or shear"),
    "no pose": (header(worldFromCamera=None), "worldFromCamera"),
    "a pose of words": (header(worldFromCamera="here"), "worldFromCamera"),
    "no focal length": (header(fx=None), "fx"),
    "a focal length below 0": (header(fx=-5.0), "frame_000001.exr"),
    "no exposure": (header(exposure=0.0), "exposure"),
    "time that is NaN": (header(time=float("nan")), "time: expected a finite number"),
    "a white balance of 0": (header(whiteBalance=np.zeros(3)), "white_balance"),
    "a count of words": (header(invalid="range many"), "frame_000001.exr"),
    "no depth": (channels(Z=None), "frame_000001.exr"),
    "no red": (channels(R=None), "frame_000001.exr"),
    "a NaN colour": (channels(G=np.full((24, 32), np.nan, np.float32)), "a colour is NaN"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_broken_is_one_line_and_nothing_is_written(tmp_path, capfd, case):
    harm, words = BROKEN[case]
    write_walk(tmp_path / "in")
    harm(tmp_path / "in")
    assert main(["replay", str(tmp_path / "in"), "--at", "0,0,0", "--out", str(tmp_path / "out")]) == 2
    err = capfd.readouterr().err
    assert words in err and err.startswith("xihe: ") and err.count("\n") == 1 and not (tmp_path / "out").exists()


def test_what_it_says_of_itself_comes_back_and_time_may_go_backwards(tmp_path, capfd):
    facts = SessionFacts("a room", ("The lens is not known.",), 0.5, TriggerSettings(theta=0.25))
    write_walk(tmp_path / "in", facts=facts)
    header(time=-4.0)(tmp_path / "in")
    capture = open_capture(tmp_path / "in")
    assert (capture.notes, capture.reference_exposure, capture.trigger) == (facts.not_known, 0.5, facts.trigger)
    assert [frame.time_s for frame in capture.frames][1] == -4.0
    assert main(["replay", str(tmp_path / "in"), "--at", "0,0,0", "--out", str(tmp_path / "out")]) == 0
    assert "The lens is not known." in capfd.readouterr().err
    assert read_strictly((tmp_path / "out" / "replay.json").read_text())["reference_exposure"] == 0.5
    assert main(["replay", str(tmp_path / "in"), "--at", "0,0,0", "--out", str(tmp_path / "o"), "--up", "y"]) == 2
    assert "leave out --up" in capfd.readouterr().err


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
def test_a_thousand_frames_stay_on_disk(tmp_path):
    """Held at once they are 134 MB."""
    SessionRecorder(tmp_path).record(*walk(Intrinsics(160, 120, 100.0, 100.0, 80.0, 60.0), 1))
    for number in range(1, 1000):
        (tmp_path / f"frame_{number:06d}.exr").hardlink_to(tmp_path / "frame_000000.exr")
    ((n_frames, n_read, grown_mb, *_),) = measured(tmp_path, every=1)
    assert n_frames == n_read == 1000 and grown_mb < 100
