"""Recordings that are broken, or odd: each is one line and exit 2 with nothing written, or is read, with a note."""

import shutil

import pytest

from addon_tests.pure.broken_recordings import CASES, NOTE, READ
from addon_tests.pure.recordings import LAYOUTS, as_stray, walk
from xihe_blender.cli.main import main

pytestmark = pytest.mark.wheel_only("a whole Blender's Python has no lzfse and no PyAV")


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """By format, a sound recording of three frames; made once."""
    made = {}

    def of(name):
        if name not in made:
            folder = tmp_path_factory.mktemp("sound")
            frames = walk(CASES[name][1], 3)
            if name == "Stray Scanner":
                made[name] = as_stray(folder, frames, has_intrinsics=False)
            else:
                made[name] = LAYOUTS[name][0](folder, frames)
        return made[name]

    return of


@pytest.mark.parametrize(("name", "case"), [(name, case) for name, (cases, _) in CASES.items() for case in cases])
def test_what_is_broken_is_one_line_and_what_is_odd_is_read(sound, tmp_path, capfd, name, case):
    harm, words = CASES[name][0][case]
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
        assert said.startswith("xihe: ") and said.count("\n") == 1


def test_there_are_twenty_cases_for_each_format():
    assert all(len(cases) >= 20 for cases, _ in CASES.values())
