"""Rooms of the two packages, and which of them may import which: what is not in the table is an error, circles too."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCENE = {"errors", "io", "scene"}
RENDERED = {*SCENE, "jobs", "capture", "light_transport"}
JOB = {*RENDERED, "apply", "compare", "report"}
MAY_IMPORT = {
    "errors": set(),
    "jobs": set(),
    "io": {"errors"},
    "scene": {"errors", "io"},
    "capture": SCENE,
    "light_transport": {*SCENE, "jobs", "capture"},
    "apply": SCENE,
    "compare": {*SCENE, "capture", "apply"},
    "report": {"io"},
    "previs": JOB,
    "packaging": {"errors", "io"},
    "lab.workers": {"errors", "io", "jobs"},
    "lab.props": set(),
    "lab.rooms": {*JOB, "previs", "lab.workers", "lab.props"},
    "lab.frontier": {*JOB, "previs"},
    "lab.batch": {*JOB, "previs", "lab.workers", "lab.frontier"},
    # Calibrate measures the presets by the frontier's means.
    "addon": {*JOB, "previs", "lab.frontier", "cli", "packaging"},
    "cli": {*JOB, "previs", "packaging", "lab.rooms", "lab.frontier", "lab.batch"},
    "__main__": {"cli"},
}
"""Of `xihe_blender`: for each room, or loose file, those below it that it knows."""


def imported(source: str) -> Iterator[str]:
    """Modules of `xihe_blender` that a file imports, anywhere in it: "scene.units" for `xihe_blender.scene.units`."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module == "xihe_blender":
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("xihe_blender."):
            for name in node.names:
                inside = f"{node.module}.{name.name}".removeprefix("xihe_blender.")
                is_module = (ROOT / "xihe_blender" / inside.replace(".", "/")).with_suffix(".py").exists()
                yield inside if is_module else node.module.removeprefix("xihe_blender.")
        elif isinstance(node, ast.Import):
            yield from (n.name.removeprefix("xihe_blender.") for n in node.names if n.name.startswith("xihe_blender."))


def room_of(module: str) -> str:
    """The room that a module lies in."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "lab" else parts[0]


def arrows_against_the_table(sources: dict[str, str]) -> list[str]:
    """Imports from one room into another that the table does not allow."""
    return [
        f"{module} imports {other}"
        for module, source in sources.items()
        for other in imported(source)
        if room_of(other) != room_of(module) and room_of(other) not in MAY_IMPORT[room_of(module)]
    ]


def our_sources() -> dict[str, str]:
    folder = ROOT / "xihe_blender"
    paths = [path for path in folder.rglob("*.py") if path.name != "__init__.py" or path.parent != folder]
    modules = {".".join(path.relative_to(folder).with_suffix("").parts): path for path in paths}
    return {name.removesuffix(".__init__"): path.read_text() for name, path in modules.items()}


def test_rooms_import_only_the_rooms_below_them():
    assert not arrows_against_the_table(our_sources())


@pytest.mark.parametrize(
    "line",
    [
        "from xihe_blender.lab.rooms.store import load_room",
        "from xihe_blender import addon",
        "import xihe_blender.cli.main",
    ],
)
def test_an_arrow_against_the_table_is_seen(line):
    assert arrows_against_the_table({**our_sources(), "scene.units": line})


def test_the_table_has_no_circles():
    known: set[str] = set()
    left = dict(MAY_IMPORT)
    while left:
        lowest = {room for room, below in left.items() if below <= known}
        assert lowest, f"a circle among {sorted(left)}"
        known |= lowest
        left = {room: below for room, below in left.items() if room not in known}


def test_the_conventions_name_every_room():
    _, table = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8").split("## Who may import whom")
    assert [room for room in MAY_IMPORT if room != "__main__" and not re.search(rf"\b{re.escape(room)}\b", table)] == []


def test_modules_of_a_room_have_no_circles():
    sources = our_sources()
    needs = {
        name: {other for other in imported(source) if other in sources} - {name} for name, source in sources.items()
    }
    known: set[str] = set()
    while left := {name: below for name, below in needs.items() if name not in known}:
        lowest = {name for name, below in left.items() if below <= known}
        if not lowest:
            break
        known |= lowest
    assert not sorted(left)


def test_few_files_lie_loose_at_the_top():
    loose = [path.name for path in (ROOT / "xihe_blender").iterdir() if path.is_file()]
    assert len(loose) <= 5, loose


def test_the_science_knows_no_blender():
    for path in (ROOT / "xihenet").rglob("*.py"):
        named = {name.split(".")[0] for name in _all_imports(path.read_text())}
        assert not named & {"bpy", "mathutils", "xihe_blender"}, path


def _all_imports(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
