"""The catalogue of the hard cases: a line for each, and what makes a case one."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from addon_tests.hard_case import at_most, equal, refused, table, tried

MERGE = Path(__file__).with_name("test_merge.py")


def test_the_catalogue_has_a_line_for_each_case():
    pytest_alone = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--catalogue", str(MERGE)]
    done = subprocess.run(pytest_alone, capture_output=True, text=True, cwd=MERGE.parents[3], check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    n_passed = int(re.search(r"(\d+) passed", done.stdout)[1])
    assert sum(line.startswith("merge ") and line.endswith("| yes") for line in lines) == n_passed >= 15
    assert f"{n_passed} cases, 0 wrong" in lines


def test_a_wrong_case_is_counted():
    row = ["merge", "a case", "1", "2", "3"]
    *_, stages, counts = table([[*row, "yes"], [*row, "NO"]])
    assert stages == "merge 2" and counts == "2 cases, 1 wrong"


@pytest.mark.parametrize(
    ("answer", "must", "is_right"),
    [
        (2.0, equal(2.0), True),
        ([2.0], equal(2.0), False),
        (2.0, at_most(1.0), False),
        (float("nan"), at_most(1.0), False),
        (2.0, refused("no"), False),
    ],
)
def test_an_answer_is_right_only_if_it_is_what_must_come_out(answer, must, is_right):
    assert tried(answer, lambda given: given, must)[1] == is_right


@pytest.mark.parametrize(("words", "is_right"), [("no camera", True), ("no lamp", False)])
def test_a_refusal_is_right_only_if_it_says_why(words, is_right):
    def refuse(given):
        raise ValueError(given)

    assert tried("no camera here", refuse, refused(words))[1] == is_right
    assert not tried("no camera here", refuse, equal("no camera here"))[1]
