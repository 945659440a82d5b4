"""Runs of the panel on disk: which are counted, which are removed, and what is never touched."""

import os
import time
from pathlib import Path

import pytest

from xihe_blender.io.folder_manifest import take_lock
from xihe_blender.io.old_runs import ABANDONED_S, format_old_runs, old_runs, remove_old_runs, runs_in
from xihe_blender.io.outputs import RunOutputs

FIRST, SECOND, THIRD = "room_20260101-101500", "room_20260101-101500_2", "my room_20270101-000000"


def make_run(parent, name, *, has_ended=True, n_bytes=1000):
    folder = parent / name
    settings = RunOutputs(folder, "room").settings
    settings.parent.mkdir(parents=True)
    settings.write_bytes(b" " * n_bytes)
    if has_ended:
        RunOutputs(folder, "room").results.write_text("{}")
    return folder


@pytest.fixture
def runs(tmp_path):
    return [make_run(tmp_path, name) for name in (THIRD, FIRST, SECOND)]


def everything_in(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_runs_are_found_by_what_a_run_writes_and_old_are_those_not_shown(tmp_path, runs):
    assert runs_in(tmp_path) == runs
    assert old_runs(tmp_path, [tmp_path / "." / FIRST, tmp_path / "gone"]) == [runs[0], runs[2]]
    assert runs_in(tmp_path / "nowhere") == []


def test_what_is_no_run_is_never_touched(tmp_path, runs):
    make_run(tmp_path, "by_the_command")
    make_run(tmp_path / "elsewhere", FIRST)
    (tmp_path / "photos_20260101-101500").mkdir()
    (tmp_path / "photos_20260101-101500" / "results.json").write_text("{}")
    (tmp_path / "file_20260101-101500").write_text("mine")
    (tmp_path / "link_20260101-101500").symlink_to(tmp_path / "elsewhere" / FIRST)
    kept = make_run(tmp_path, "shown_20260101-101500")
    before = everything_in(tmp_path)
    assert remove_old_runs(tmp_path, {kept}) == runs
    gone = {run.name for run in runs}
    assert everything_in(tmp_path) == [name for name in before if Path(name).parts[0] not in gone]
    assert remove_old_runs(tmp_path, {kept}) == []


def test_a_run_that_may_be_under_way_is_left_alone_for_a_day(tmp_path):
    folder = make_run(tmp_path, FIRST, has_ended=False)
    assert runs_in(tmp_path) == []
    then = time.time() - 2 * ABANDONED_S
    os.utime(folder / "work", (then, then))
    assert runs_in(tmp_path) == [folder]


def test_a_run_that_another_blender_holds_is_left_alone_however_old_it_is(tmp_path):
    folder = make_run(tmp_path, FIRST, has_ended=False)
    with RunOutputs(folder).lock.open("ab") as lock:
        assert take_lock(lock)
        then = time.time() - 2 * ABANDONED_S
        os.utime(folder / "work", (then, then))
        assert runs_in(tmp_path) == remove_old_runs(tmp_path, []) == []
    assert runs_in(tmp_path) == [folder]


def test_the_space_that_runs_take_is_said(tmp_path):
    assert format_old_runs([]) == "no runs, 0 bytes"
    one = make_run(tmp_path, FIRST, n_bytes=2_300_000)
    assert format_old_runs([one]) == "1 run, 2.3 MB"
    other = make_run(tmp_path, SECOND, n_bytes=20_000_000)
    assert format_old_runs([one, other]) == "2 runs, 22 MB"


def test_a_run_is_measured_once_however_many_there_are(tmp_path, monkeypatch):
    runs = [make_run(tmp_path, f"room_20260101-{k:06d}", n_bytes=1000) for k in range(300)]
    said = format_old_runs(runs)
    looked, rglob = [], Path.rglob
    monkeypatch.setattr(Path, "rglob", lambda *given: looked.append(given) or rglob(*given))
    assert format_old_runs(runs) == said == "300 runs, 301 kB"
    assert not looked
