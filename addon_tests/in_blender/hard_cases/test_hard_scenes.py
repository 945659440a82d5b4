"""The catalogue's Blender stage, run: every scene comes out as it must, and a naive chain's does not."""

import pytest

from addon_tests.in_blender.hard_cases.blender import CASES, STAGE
from addon_tests.pure.hard_cases import catalogue
from addon_tests.pure.hard_cases.hard_case import assert_can_fail, assert_right

EVERY_CASE = pytest.mark.parametrize("case", CASES, ids=str)


@EVERY_CASE
def test_hard_scene(case):
    assert_right(case)


@EVERY_CASE
def test_the_naive_version_fails(case):
    assert_can_fail(case)


def test_scenes_are_a_stage_of_their_own_with_names_of_their_own():
    assert len({str(case) for case in CASES}) == len(CASES)
    assert {case.stage for case in CASES} == {STAGE}
    assert STAGE not in {case.stage for case in catalogue.CASES}
