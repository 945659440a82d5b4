"""What the README tells people to train with is understood by the command line of training."""

import re
import shlex
from pathlib import Path

import pytest

from xihenet.training.__main__ import _parser, with_step

ROOT = Path(__file__).resolve().parents[2]
TYPED = re.findall(r"^xihe train (.*)$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)


def test_the_readme_trains_and_reports():
    assert {with_step(shlex.split(typed))[0] for typed in TYPED} == {"cache", "train", "report"}


@pytest.mark.parametrize("typed", TYPED)
def test_training_commands_of_the_readme_are_understood(typed):
    assert _parser().parse_args(with_step(shlex.split(typed))).run
