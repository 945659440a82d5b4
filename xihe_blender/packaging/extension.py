"""The extension as one zip that Blender installs: `xihe package --out DIR`. Needs a checkout, and no Blender.

    xihe-<version>.zip
        blender_manifest.toml   the version and the wheel, then the template beside this file
        __init__.py             registers from the wheel, so that scripts in Blender can import the packages too
        LICENSE
        wheels/                 this project

There is nothing in it of others, so it is the same for every platform and Python, and the same commit makes the same
bytes, as long as Python compresses alike. Rejected: Blender's own `extension build`, since it needs a Blender and keeps
the times of files; its `validate` is what the tests hold the zip against.

The wheel is written here rather than by setuptools: one of plain Python is a zip with three small files added, and
written so it needs neither the network nor a build folder that may hold old files, and is the same to the last byte
every time. What belongs into it is read from pyproject.toml, where setuptools reads it too. It asks for no other
packages: bpy and NumPy are Blender's own. Its version ends in a hash of its contents, as in 0.1.0+4f1d0c9a. Blender
does not unpack a wheel of a version that it has unpacked already, so that otherwise two builds of one version would be
taken for the same.
"""

from __future__ import annotations

import base64
import hashlib
import io
import tomllib
import zipfile
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from xihe_blender.errors import UserError
from xihenet import __version__
from xihenet.io.whole_files import written_whole

CHECKOUT = Path(__file__).resolve().parents[2]
EARLIEST = (1980, 1, 1, 0, 0, 0)
"""Of the times that a zip can tell."""

MANIFEST = Path(__file__).with_name("blender_manifest.toml")
REGISTERS_FROM_THE_WHEEL = '''\
"""Registers Xihe from the wheel of this extension, so that scripts in Blender can import its packages too."""

import sys

VERSION = "{version}"

# After an update without a restart of Blender, what is loaded is still the version before.
if getattr(sys.modules.get("xihenet"), "__version__", VERSION) != VERSION:
    for name in [name for name in sys.modules if name.partition(".")[0] in ("xihenet", "xihe_blender")]:
        del sys.modules[name]

from xihe_blender import addon


def register():
    addon.register(__package__)


def unregister():
    addon.unregister()
'''

Contents = dict[str, bytes]
"""{name inside, with forward slashes: content} of all files of a zip."""


def build_extension(out: Path, *, checkout: Path = CHECKOUT) -> Path:
    """Write the extension into the folder `out`, made if needed, whole or not at all; the path of the zip.

    A zip of the same version is replaced. UserError where `checkout` is none; OSError where a folder cannot be written.
    """
    name, content = project_wheel(checkout)
    generated = f'version = "{__version__}"\nwheels = ["./wheels/{name}"]\n\n'
    contents: Contents = {
        f"wheels/{name}": content,
        # TOML wants single values before its tables: what is known only now stands in front of the template.
        "blender_manifest.toml": (generated + MANIFEST.read_text(encoding="utf-8")).encode(),
        "__init__.py": REGISTERS_FROM_THE_WHEEL.format(version=__version__).encode(),
        "LICENSE": (checkout / "LICENSE").read_bytes(),
    }
    path = out / f"xihe-{__version__}.zip"
    with written_whole(path) as beside:
        beside.write_bytes(packed(contents))
    return path


def packed(contents: Contents) -> bytes:
    """The zip of `contents`, the same to the last byte every time: sorted, without times and owners.

    What is compressed already is stored as it is.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in sorted(contents.items()):
            entry = zipfile.ZipInfo(name, EARLIEST)
            entry.create_system = 3  # Unix, on every system, so that the rights below are understood.
            entry.external_attr = 0o100644 << 16
            entry.compress_type = zipfile.ZIP_STORED if name.endswith((".whl", ".png")) else zipfile.ZIP_DEFLATED
            archive.writestr(entry, content, compresslevel=9)
    return buffer.getvalue()


def project_wheel(checkout: Path) -> tuple[str, bytes]:
    """File name and content of the wheel. UserError where `checkout` is none."""
    if not all((checkout / name).exists() for name in ("pyproject.toml", "LICENSE")):
        raise UserError(f"{checkout} is no checkout of the project: package it from one")
    settings = tomllib.loads((checkout / "pyproject.toml").read_text(encoding="utf-8"))
    project = settings["project"]
    contents = _packages(checkout, settings["tool"]["setuptools"])
    digest = hashlib.sha256()
    for name, content in sorted(contents.items()):
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    version = f"{__version__}+{digest.hexdigest()[:8]}"
    stem = f"{project['name'].replace('-', '_')}-{version}"
    info = f"{stem}.dist-info"
    contents[f"{info}/METADATA"] = _metadata(project, version)
    wheel = "Wheel-Version: 1.0\nGenerator: xihe package\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    contents[f"{info}/WHEEL"] = wheel.encode()
    contents[f"{info}/licenses/LICENSE"] = (checkout / "LICENSE").read_bytes()
    contents[f"{info}/RECORD"] = _record(contents, f"{info}/RECORD")
    return f"{stem}-py3-none-any.whl", packed(contents)


def _packages(checkout: Path, setuptools: dict[str, Any]) -> Contents:
    """Modules and data files of all packages, as setuptools would choose them."""
    included: list[str] = setuptools["packages"]["find"]["include"]
    data: dict[str, list[str]] = setuptools["package-data"]
    files: set[Path] = set()
    for init in checkout.glob("*/**/__init__.py"):
        package = init.parent
        name = ".".join(package.relative_to(checkout).parts)
        if any(fnmatch(name, pattern) for pattern in included):
            files.update(package.glob("*.py"))
            files.update(file for pattern in data.get(name, ()) for file in package.glob(pattern))
    return {file.relative_to(checkout).as_posix(): file.read_bytes() for file in files}


def _metadata(project: dict[str, Any], version: str) -> bytes:
    lines = {
        "Metadata-Version": "2.4",
        "Name": project["name"],
        "Version": version,
        "Summary": project["description"],
        "License-Expression": project["license"],
        "License-File": "LICENSE",
        "Requires-Python": project["requires-python"],
    }
    return "".join(f"{name}: {value}\n" for name, value in lines.items()).encode()


def _record(contents: Contents, own_name: str) -> bytes:
    """Every file with its hash and size, as installers check them; the record itself without."""
    lines = []
    for name, content in sorted(contents.items()):
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        lines.append(f"{name},sha256={digest},{len(content)}")
    return ("\n".join([*lines, f"{own_name},,"]) + "\n").encode()
