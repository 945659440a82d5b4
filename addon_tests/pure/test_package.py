"""The extension's zip: what is in it, that it is the same every time, and that nothing half done is left."""

import base64
import csv
import hashlib
import io
import os
import resource
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from addon_tests.pure.commands import assert_refused
from xihe_blender.errors import UserError
from xihe_blender.packaging.extension import build_extension, project_wheel
from xihenet import __version__

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ("xihenet", "xihe_blender", "pyproject.toml", "LICENSE")


def xihe(*arguments, **options):
    command = [sys.executable, "-W", "error", "-m", "xihe_blender", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=100, **options)


def copy_of_the_checkout(folder):
    """What a package is made of, in another place, with other times and in another order."""
    for name in reversed(SOURCES):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, copy_function=shutil.copy)
        else:
            folder.mkdir(exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    return folder


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    return build_extension(tmp_path_factory.mktemp("package"))


@pytest.fixture(scope="module")
def manifest(built):
    with zipfile.ZipFile(built) as archive:
        return tomllib.loads(archive.read("blender_manifest.toml").decode())


@pytest.fixture(scope="module")
def wheel(built):
    with zipfile.ZipFile(built) as archive:
        path = next(name for name in archive.namelist() if name.startswith("wheels/"))
        return path.removeprefix("wheels/"), archive.read(path)


def test_the_zip_holds_manifest_registration_licence_and_one_small_wheel_and_nothing_else(built, wheel):
    with zipfile.ZipFile(built) as archive:
        names = archive.namelist()
    assert built.name == f"xihe-{__version__}.zip"
    assert sorted(names) == sorted(["__init__.py", "LICENSE", "blender_manifest.toml", f"wheels/{wheel[0]}"])
    assert built.stat().st_size < 12_000_000


def test_the_manifest_lists_the_wheel_of_the_zip_and_no_platform(manifest, wheel):
    assert manifest["wheels"] == [f"./wheels/{wheel[0]}"] and "platforms" not in manifest


def test_the_manifest_says_who_it_is_and_asks_for_files_alone(manifest):
    assert (manifest["id"], manifest["version"]) == ("xihe", __version__)
    assert manifest["website"].startswith("https://")
    assert manifest["blender_version_min"] == "4.2.0"
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    assert manifest["permissions"].keys() == {"files"}


@pytest.mark.slow
def test_the_same_input_makes_the_same_bytes_and_another_content_another_version_of_the_wheel(built, wheel, tmp_path):
    checkout = copy_of_the_checkout(tmp_path / "checkout")
    assert build_extension(tmp_path / "out", checkout=checkout).read_bytes() == built.read_bytes()
    with (checkout / "xihenet" / "sh.py").open("a", encoding="utf-8") as file:
        file.write("# Another line.\n")
    (before, hash_before), (after, hash_after) = (name.split("+") for name in (wheel[0], project_wheel(checkout)[0]))
    assert before == after and hash_before != hash_after


def test_the_wheel_holds_every_file_of_both_packages(wheel):
    files = {
        path.relative_to(ROOT).as_posix()
        for package in ("xihenet", "xihe_blender")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    with zipfile.ZipFile(io.BytesIO(wheel[1])) as archive:
        in_wheel = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert in_wheel == files and {"xihenet/py.typed", "xihe_blender/py.typed"} <= files


def test_the_wheel_records_every_file_as_it_is(wheel):
    with zipfile.ZipFile(io.BytesIO(wheel[1])) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    record = next(name for name in contents if name.endswith(".dist-info/RECORD"))
    rows = {name: (digest, size) for name, digest, size in csv.reader(contents[record].decode().splitlines())}
    assert rows.keys() == contents.keys() and rows.pop(record) == ("", "")
    for name, (digest, size) in rows.items():
        padded = digest.removeprefix("sha256=") + "="
        assert base64.urlsafe_b64decode(padded).hex() == hashlib.sha256(contents[name]).hexdigest()
        assert int(size) == len(contents[name])


@pytest.mark.slow
@pytest.mark.wheel_only("a whole Blender's Python may have no pip")
def test_pip_installs_the_wheel_and_it_estimates_light_without_the_checkout(wheel, tmp_path):
    name, content = wheel
    (tmp_path / name).write_bytes(content)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-compile"]
    subprocess.run([*pip, "--target", tmp_path / "site", tmp_path / name], check=True, timeout=100)
    code = "import xihenet.estimators as e, xihe_blender.cli.main; print(xihe_blender.__file__, e.load('lattice').name)"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=100
    )
    assert done.stdout.split() == [str(tmp_path / "site" / "xihe_blender" / "__init__.py"), "lattice"], done.stderr


def test_what_is_no_checkout_is_refused(tmp_path):
    with pytest.raises(UserError, match="is no checkout of the project"):
        project_wheel(tmp_path)


def test_a_zip_that_cannot_be_written_leaves_the_one_before(tmp_path):
    before = tmp_path / f"xihe-{__version__}.zip"
    before.write_bytes(b"the one before")
    code = (
        "import sys, pathlib as p; from xihe_blender.packaging.extension import build_extension;"
        "build_extension(p.Path(sys.argv[1]))"
    )
    limit = 1 << 16
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path],
        cwd=ROOT,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert done.returncode == 1 and "OSError" in done.stderr
    assert before.read_bytes() == b"the one before"
    assert [path.name for path in tmp_path.iterdir()] == [before.name]


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("mine")
    assert_refused(xihe("package", "--out", tmp_path / "file"), "is a file", "--out")
    assert (tmp_path / "file").read_text() == "mine"
