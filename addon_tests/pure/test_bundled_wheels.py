"""Wheels of others: which are bundled, how they are fetched, and that no other file gets in."""

import tomllib

import pytest

from addon_tests.pure.made_up_wheels import NAMES, hash_of, made_up_wheels, tiny_wheel
from xihe_blender.errors import UserError
from xihe_blender.packaging.bundled_wheels import pinned_wheels, wheel_files
from xihe_blender.packaging.extension import MANIFEST

PLATFORMS = {"manylinux": "linux", "macosx": "macos", "win": "windows"}
MACHINES = {"x86_64": "x64", "amd64": "x64", "arm64": "arm64"}
NEEDS_PIP = pytest.mark.wheel_only("a whole Blender's Python may have no pip")


@pytest.fixture
def shelf(tmp_path, monkeypatch):
    """The only place where pip looks for packages."""
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "shelf"))
    (tmp_path / "shelf").mkdir()
    return tmp_path / "shelf"


@NEEDS_PIP
def test_missing_wheels_are_fetched_whatever_this_machine_is(shelf, tmp_path):
    pinned = made_up_wheels(shelf)
    files = wheel_files(tmp_path / "cache", pinned)
    assert [file.name for file in files] == list(pinned)
    assert all(hash_of(file.read_bytes()) == pinned[file.name] for file in files)


def test_wheels_that_are_there_are_not_fetched_again(shelf, tmp_path):
    pinned = made_up_wheels(tmp_path / "cache")
    assert [file.read_bytes() for file in wheel_files(tmp_path / "cache", pinned)] == [tiny_wheel(n) for n in NAMES]


@NEEDS_PIP
def test_a_wheel_that_cannot_be_fetched_is_named_with_what_pip_says(shelf, tmp_path):
    with pytest.raises(UserError, match=rf"{NAMES[0]} cannot be fetched: put it into .*No matching distribution"):
        wheel_files(tmp_path / "cache", {NAMES[0]: "0" * 64})
    assert not (tmp_path / "cache").exists()


@NEEDS_PIP
def test_a_fetched_file_with_another_hash_is_refused_and_not_kept(shelf, tmp_path):
    made_up_wheels(shelf)
    with pytest.raises(UserError, match=r"is not the file that bundled_wheels\.toml names"):
        wheel_files(tmp_path / "cache", {NAMES[0]: hash_of(b"another")})
    assert not (tmp_path / "cache").exists()


def test_a_file_with_another_hash_is_refused_before_anything_is_fetched(shelf, tmp_path):
    pinned = made_up_wheels(shelf)
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / NAMES[-1]).write_bytes(b"another")
    with pytest.raises(UserError, match=rf"{NAMES[-1]} is not the file .* delete it"):
        wheel_files(tmp_path / "cache", pinned)
    assert [path.name for path in (tmp_path / "cache").iterdir()] == [NAMES[-1]]


def blender_platform(name):
    """What Blender calls the platform of a wheel."""
    tag = name.removesuffix(".whl").split("-")[-1]
    system = next(ours for theirs, ours in PLATFORMS.items() if tag.startswith(theirs))
    return f"{system}-{next(ours for theirs, ours in MACHINES.items() if tag.endswith(theirs))}"


def test_every_platform_of_the_manifest_has_a_wheel_for_each_python_of_its_blenders():
    platforms = tomllib.loads(MANIFEST.read_text(encoding="utf-8"))["platforms"]
    bundled = {(blender_platform(name), name.split("-")[2]) for name in pinned_wheels()}
    wanted = {(platform, python) for platform in platforms for python in ("cp311", "cp313")}
    # Blender 5.1, the first with Python 3.13, has no build for Intel Macs; Debian's 5.2 has Python 3.14.
    assert bundled == wanted - {("macos-x64", "cp313")} | {("linux-x64", "cp314")}


def test_one_version_of_one_package_is_bundled():
    assert len({tuple(name.split("-")[:2]) for name in pinned_wheels()}) == 1
