"""The extension as one zip that Blender installs: `xihe package --out DIR`. Needs a checkout, and no Blender.

    xihe-<version>.zip
        blender_manifest.toml   the version and the wheel, then the template in `xihe_blender`
        __init__.py             registers from the wheel, so that scripts in Blender can import the packages too
        LICENSE
        wheels/                 this project

There is nothing in it of others, so it is the same for every platform and Python, and the same commit makes the same
bytes, as long as Python compresses alike. Rejected: Blender's own `extension
build`, since it needs a Blender and keeps the times of files; its `validate` is what the tests hold the zip against.
"""

from __future__ import annotations

from pathlib import Path

from xihe_blender.io.outputs import written_whole
from xihe_blender.packaging.project_wheel import CHECKOUT, Contents, packed, project_wheel
from xihenet import __version__

MANIFEST = Path(__file__).parents[1] / "blender_manifest.toml"
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
