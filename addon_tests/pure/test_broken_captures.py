"""Recordings that are broken, or odd: each is one line and exit 2 with nothing written, or is read, with a note."""

import math
import shutil

import pytest

from addon_tests.pure.broken_recordings import FORMATS, NOTE, READ
from addon_tests.pure.recordings import layouts, walk
from xihe_blender.cli import replay as replay_command
from xihe_blender.cli.main import main

CASES = [
    pytest.param(*one.values, case, marks=one.marks) for one in layouts(FORMATS) for case in FORMATS[one.values[0]][2]
]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """By format, a sound recording of three frames; made once."""
    made = {}

    def of(name):
        if name not in made:
            write, intrinsics, _ = FORMATS[name]
            made[name] = write(tmp_path_factory.mktemp("sound"), walk(intrinsics, 3))
        return made[name]

    return of


@pytest.mark.parametrize(("name", "case"), CASES)
def test_what_is_broken_is_one_line_and_what_is_odd_is_read(sound, tmp_path, capfd, monkeypatch, name, case):
    monkeypatch.setattr(replay_command, "SHOWN_EVERY_S", math.inf)  # On a busy machine progress would be said too
    harm, words = FORMATS[name][2][case]
    path, out = tmp_path / "in", tmp_path / "out"
    if (whole := sound(name)).is_file():
        path = path.with_suffix(whole.suffix)
        shutil.copy(whole, path)
    else:
        shutil.copytree(whole, path)
    harm(path)
    capfd.readouterr()
    # What is asked is how it is read, for which the estimator that has no weights will do.
    code = main(["replay", str(path), "--at", "0,0,0", "--out", str(out), "--estimator", "projection"])
    said = capfd.readouterr().err
    if words == READ or words.startswith(NOTE):
        assert code == 0 and words.removeprefix(NOTE if words != READ else READ) in said, said
        assert all(line.startswith("xihe: note: ") for line in said.splitlines()) and (out / "replay.json").is_file()
    else:
        assert code == 2 and words in said and not out.exists(), said
        assert said.startswith("xihe: ") and said.count("\n") == 1 and str(path) in said, said
