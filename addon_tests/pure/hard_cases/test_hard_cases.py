"""The catalogue, run: every case comes out as it must, and its naive version does not."""

import re
from pathlib import Path

import pytest

from addon_tests.pure.hard_cases.__main__ import main
from addon_tests.pure.hard_cases.catalogue import CASES
from addon_tests.pure.hard_cases.hard_case import assert_can_fail, assert_right

ROOT = Path(__file__).resolve().parents[3]
FOLDERS = ("xihenet", "xihe_blender", "addon_tests", "blend_scenes", "docs")
HIDES = re.compile(r"""with np\.errstate\(|\bseterr\(|(simplefilter|filterwarnings)\(["']ignore""")
EVERY_CASE = pytest.mark.parametrize("case", CASES, ids=str)


@EVERY_CASE
def test_hard_case(case):
    assert_right(case)


@EVERY_CASE
def test_the_naive_version_fails(case):
    assert_can_fail(case)


def test_there_are_150_cases_and_each_has_a_name_of_its_own():
    assert len({str(case) for case in CASES}) == len(CASES) >= 150


def test_nothing_hides_a_warning_without_a_comment_on_why():
    files = [file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py")]
    n_hidden = 0
    for file in files:
        lines = file.read_text(encoding="utf-8").splitlines()
        for above, line in zip(["", *lines], lines, strict=False):
            is_told = "#" in line or above.lstrip().startswith("#")
            n_hidden += bool(HIDES.search(line))
            assert is_told or not HIDES.search(line), f"{file}: {line.strip()} hides a warning and does not say why"
    assert n_hidden > 10


def test_the_table_has_a_line_for_each_case_of_a_stage(capsys):
    assert main(["merge"]) == 0
    n_cases = sum(case.stage == "merge" for case in CASES)
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("merge ") and line.endswith("| yes") for line in lines) == n_cases
    assert lines[-1] == f"{n_cases} cases, 0 wrong"
