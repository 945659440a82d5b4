"""Tiny wheels with nothing in them, in place of those of PyPI: the tests of packaging need no network."""

import hashlib

from xihe_blender.packaging.archive import packed

NAMES = (
    "light-1.2.3-cp311-cp311-macosx_11_0_arm64.whl",
    "light-1.2.3-cp311-cp311-manylinux_2_28_x86_64.whl",
    "light-1.2.3-cp313-cp313-win_amd64.whl",
)


def tiny_wheel(name):
    """The content of a wheel that pip takes for one."""
    project, version, *tags = name.removesuffix(".whl").split("-")
    info = f"{project}-{version}.dist-info"
    return packed(
        {
            f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {project}\nVersion: {version}\n".encode(),
            f"{info}/WHEEL": f"Wheel-Version: 1.0\nRoot-Is-Purelib: false\nTag: {'-'.join(tags)}\n".encode(),
            f"{info}/RECORD": b"",
            f"{project}.py": name.encode(),
        }
    )


def hash_of(content):
    return hashlib.sha256(content).hexdigest()


def made_up_wheels(folder, names=NAMES):
    """Write the wheels into `folder`; their table of names and hashes."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(tiny_wheel(name))
    return {name: hash_of(tiny_wheel(name)) for name in names}
