"""What the docs tell people to train with is understood by the command line of training, and its page is whole."""

import re
import shlex
from pathlib import Path

import pytest

from xihe_blender.cli.document import document
from xihenet.training.__main__ import training_parser, with_step

ROOT = Path(__file__).resolve().parents[2]
TYPED = re.findall(r"^xihe train (.*)$", (ROOT / "docs" / "training.md").read_text(encoding="utf-8"), re.MULTILINE)


def test_the_docs_train_report_and_export():
    assert {with_step(shlex.split(typed))[0] for typed in TYPED} == {"cache", "train", "report", "export"}


@pytest.mark.parametrize("typed", TYPED)
def test_training_commands_of_the_docs_are_understood(typed):
    assert training_parser().parse_args(with_step(shlex.split(typed))).run


def test_the_page_of_the_command_line_has_training_too():
    assert (ROOT / "docs" / "cli.md").read_text(encoding="utf-8") == document()


def test_help_has_the_defaults_of_the_page(capsys):
    with pytest.raises(SystemExit):
        training_parser().parse_args(["train", "--help"])
    assert "clouds in a batch; default: 64" in " ".join(capsys.readouterr().out.split())
