"""Which wheels of others does the extension bundle, and are these files truly the ones that were tested?

They are listed with their hashes in `bundled_wheels.toml`, and pip fetches them as they are from PyPI: Blender's rules
ask for wheels that nobody has modified. A file with another hash is refused, wherever it comes from. Rejected: whatever
pip resolves on the day of the build, since the same commit would then make another extension.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import copy_whole

TABLE = Path(__file__).with_name("bundled_wheels.toml")


def pinned_wheels() -> dict[str, str]:
    """{file name: SHA-256 in hexadecimal digits} of the wheels to bundle, sorted by name."""
    table: dict[str, str] = tomllib.loads(TABLE.read_text(encoding="utf-8"))["sha256"]
    return dict(sorted(table.items()))


def wheel_files(folder: Path, pinned: Mapping[str, str]) -> list[Path]:
    """The wheels `pinned` (name to hash) in `folder`; those that are missing are fetched into it.

    UserError, naming the file, where one is not what it should be or cannot be fetched; OSError if `folder` cannot be
    written. What is there already is checked before anything is fetched.
    """
    files = [folder / name for name in pinned]
    for file in files:
        if file.exists():
            _check(file, pinned[file.name])
    for file in files:
        if not file.exists():
            _fetch(file, pinned[file.name])
    return files


def _check(file: Path, sha256: str) -> None:
    found = hashlib.sha256(file.read_bytes()).hexdigest()
    if found != sha256:
        raise UserError(
            f"{file} is not the file that {TABLE.name} names (SHA-256 {found[:12]}..., expected {sha256[:12]}...): "
            "delete it, or give another folder with --wheels"
        )


def _fetch(file: Path, sha256: str) -> None:
    """Put `file` into its folder, checked and whole."""
    with tempfile.TemporaryDirectory() as beside:
        done = subprocess.run([*_pip_download(file.name), "--dest", beside], capture_output=True, text=True)
        fetched = Path(beside) / file.name
        if not fetched.exists():
            raise UserError(f"{file.name} cannot be fetched: put it into {file.parent} ({_last_words(done.stderr)})")
        _check(fetched, sha256)
        copy_whole(fetched, file)


def _pip_download(name: str) -> list[str]:
    """The command that fetches the wheel `name`, whatever this machine's own platform and Python are."""
    project, version, python_tag, abi, platform = name.removesuffix(".whl").split("-")
    python = f"{python_tag[2]}.{python_tag[3:]}"
    tags = ["--platform", platform, "--python-version", python, "--implementation", python_tag[:2], "--abi", abi]
    quiet = ["--quiet", "--disable-pip-version-check", "--only-binary=:all:", "--no-deps"]
    return [sys.executable, "-m", "pip", "download", *quiet, *tags, f"{project}=={version}"]


def _last_words(stderr: str) -> str:
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    return lines[-1].removeprefix("ERROR: ") if lines else "pip said nothing"
