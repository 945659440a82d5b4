"""What the README tells people to type exists."""

import re
import shlex
from pathlib import Path

import pytest

from xihe_blender.cli.main import _parser
from xihenet import __version__

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = [
    line.split("#")[0].strip()
    for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    for line in block.splitlines()
    if line.split("#")[0].strip()
]
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("make ")])
def test_make_targets_of_the_readme_exist(command):
    words = [word for word in shlex.split(command)[1:] if "=" not in word]
    assert words and set(words) <= TARGETS


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("xihe ") and not c.startswith("xihe train ")])
def test_xihe_commands_of_the_readme_are_understood(command):
    options = _parser().parse_args(shlex.split(command)[1:])
    scene = getattr(options, "scene", None)
    assert scene is None or not str(scene).startswith("blend_scenes") or (ROOT / scene).exists()


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("blender --command xihe ")])
def test_the_same_holds_inside_blender(command):
    words = shlex.split(command)[3:]
    assert _parser().parse_args(words).command == words[0]


def test_the_readme_names_the_extension_as_it_is_built():
    assert set(re.findall(r"xihe-[\d.]+\.zip", README)) == {f"xihe-{__version__}.zip"}


def test_scripts_of_the_readme_that_blender_runs_exist():
    scripts = [shlex.split(c)[4] for c in COMMANDS if c.startswith("blender --background ")]
    assert scripts and all((ROOT / script).exists() for script in scripts)


def test_the_readme_begins_with_the_two_commands():
    assert [c for c in COMMANDS if c.startswith("make ")][:2] == ["make previs", "make test"]


def test_every_command_of_the_readme_is_of_a_kind_that_is_tested_here():
    assert all(command.split()[0] in ("make", "xihe", "blender") for command in COMMANDS)


def test_files_that_the_readme_links_to_exist():
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_readme_says_why_tests_are_skipped():
    marks = [
        mark
        for file in sorted((ROOT / "addon_tests").rglob("test_*.py"))
        if file != Path(__file__)
        for mark in re.findall(
            r"mark\.(?:skip|xfail).*|\bimportorskip.*|pytest\.skip.*", file.read_text(encoding="utf-8")
        )
    ]
    for mark in marks:
        reason = re.search(r'reason="([^"]+)"', mark)
        assert reason is not None and reason[1] in README, mark
