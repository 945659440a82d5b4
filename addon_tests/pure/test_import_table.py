"""Rooms of the two packages, and which of them may import which: what is not in the table is an error, circles too."""

import ast
import functools
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import xihenet
from addon_tests.pure.commands import ROOT, fresh_python

SCENE = {"errors", "io", "scene"}
RENDERED = {*SCENE, "jobs", "capture", "light_transport"}
JOB = {*RENDERED, "apply", "compare", "footage", "report"}
MAY_IMPORT = {
    "errors": set(),
    "jobs": set(),
    "io": {"errors"},
    "scene": {"errors", "io"},
    "capture": SCENE,
    "light_transport": {*SCENE, "jobs", "capture"},
    "apply": SCENE,
    "footage": {*SCENE, "jobs", "apply"},
    "compare": {*SCENE, "capture", "apply"},
    "report": {"io"},
    "viewer": {*SCENE, "report"},
    "previs": JOB,
    "packaging": {"errors", "io"},
    "lab.workers": {"errors", "io", "jobs"},
    "lab.props": set(),
    "lab.rooms": {*JOB, "previs", "lab.workers", "lab.props"},
    "lab.frontier": {*JOB, "previs"},
    "lab.batch": {*JOB, "previs", "lab.workers", "lab.frontier"},
    "lab.paper": {*JOB, "previs"},
    "addon": {*JOB, "previs", "cli", "packaging"},
    "cli": {*JOB, "viewer", "previs", "packaging", "lab.rooms", "lab.frontier", "lab.batch", "lab.paper"},
    "__main__": {"cli"},
}
"""Of `xihe_blender`: for each room, or loose file, those below it that it knows."""

BLENDER = {"bpy", "bmesh", "mathutils", "bpy_extras"}
TORCH_ROOMS = {"nets", "training", "edge"}


@functools.cache
def imported(source: str) -> list[str]:
    """What a file imports, anywhere in it: "numpy.typing.NDArray" for `from numpy.typing import NDArray`."""
    found: list[str] = []
    nodes: list[ast.AST] = [ast.parse(source)]
    for node in nodes:
        if isinstance(node, ast.Import):
            found += (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found += (f"{node.module}.{name.name}" for name in node.names)
        # Statements alone, of which no expression holds any: a tenth of the nodes that `ast.walk` visits.
        for name in ("body", "orelse", "handlers", "finalbody", "cases"):
            nodes += getattr(node, name, ())
    return found


def packages(file: Path) -> set[str]:
    """Top-level packages that a file imports."""
    return {name.split(".")[0] for name in imported(file.read_text(encoding="utf-8"))}


def ours(source: str) -> Iterator[str]:
    """What a file imports of `xihe_blender`, without that word."""
    return (name.removeprefix("xihe_blender.") for name in imported(source) if name.startswith("xihe_blender."))


def room_of(module: str) -> str:
    """The room that a module lies in."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "lab" else parts[0]


def arrows_against_the_table(sources: dict[str, str]) -> list[str]:
    """Imports from one room into another that the table does not allow."""
    return [
        f"{module} imports {other}"
        for module, source in sources.items()
        for other in ours(source)
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


def circle_among(needs: dict[str, set[str]]) -> list[str]:
    """What is left when all has been taken away that needs nothing but what was taken away before."""
    known: set[str] = set()
    while lowest := {name for name, below in needs.items() if name not in known and below <= known}:
        known |= lowest
    return sorted(needs.keys() - known)


def test_the_table_has_no_circles():
    assert not circle_among(MAY_IMPORT)


def test_the_conventions_name_every_room():
    _, table = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8").split("## Who may import whom")
    assert [room for room in MAY_IMPORT if room != "__main__" and not re.search(rf"\b{re.escape(room)}\b", table)] == []


def test_the_conventions_say_where_to_find_every_part_of_xihenet_and_name_files_that_exist():
    page = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    where, _ = page.split("## Where is what")[1].split("## Who may import whom")
    paths = [path for path in (ROOT / "xihenet").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()]
    assert [path.stem for path in paths if path.stem != "__init__" and f"`{path.stem}`" not in where] == []
    by_subject = where.split("what its files are about:")[1].split("Words that look alike")[0]
    lie_there = {path.stem for path in (ROOT / "xihenet").iterdir()}
    assert set(re.findall(r"`(\w+)`", by_subject)) <= lie_there
    names = re.findall(r"`(?:[\w/]+/)?(\w+)\.py`", where)
    assert names and [name for name in names if not any(ROOT.glob(f"xihe*/**/{name}.py"))] == []


def test_modules_of_a_room_have_no_circles():
    sources = our_sources()

    def module_of(name):
        return name if name in sources else name.rpartition(".")[0]

    needs = {name: set(map(module_of, ours(source))) & sources.keys() - {name} for name, source in sources.items()}
    assert not circle_among(needs)


def test_few_files_lie_loose_at_the_top():
    loose = [path.name for path in (ROOT / "xihe_blender").iterdir() if path.is_file()]
    assert len(loose) <= 5, loose


def test_a_module_opens_with_the_noun_that_it_is_about():
    questions = {"What", "How", "Which", "Where", "When", "Why", "Who", "Whose", "By", "Does", "Is", "Are"}
    for path in (*ROOT.glob("xihe*/**/*.py"), *ROOT.glob("addon_tests/bench/*.py")):
        with path.open(encoding="utf-8") as file:
            assert file.readline().removeprefix('"""').split()[0] not in questions, path


def test_the_science_knows_no_blender_and_torch_stays_in_its_rooms():
    for path in (ROOT / "xihenet").rglob("*.py"):
        assert not packages(path) & {*BLENDER, "xihe_blender"}, path
        assert "torch" not in packages(path) or TORCH_ROOMS & set(path.parts), path


def test_only_the_edge_servers_requests_know_tornado():
    knows = {path.name for path in ROOT.glob("xihe*/**/*.py") if "tornado" in packages(path)}
    assert knows == {"requests.py"}
    imports = "import sys, xihenet.edge.client, xihenet.edge.service, xihe_blender.cli.serve"
    assert fresh_python(f"{imports}; print('tornado' in sys.modules)").stdout == "False\n"


def test_only_what_spreads_the_work_knows_dask():
    knows = [path.name for path in (ROOT / "xihe_blender").rglob("*.py") if packages(path) & {"dask", "distributed"}]
    assert knows == ["dask_workers.py"]


def test_the_report_never_asks_for_blender():
    readable = ("budget_results", "json_records", "look_results", "outputs", "placement_results", "run_results")
    of_io = (f"xihe_blender.io.{name}" for name in readable)
    science = (f"xihenet.{name}" for name in ("estimators", "formats", "invalid", "io.whole_files", "svg"))
    own = ("xihe_blender.report", *of_io, *science)
    report = list((ROOT / "xihe_blender" / "report").glob("*.py"))
    assert "page.py" in [path.name for path in report]
    for path in (*report, ROOT / "xihenet" / "formats.py", ROOT / "xihenet" / "svg.py"):
        assert not packages(path) & {*BLENDER, "numpy"}, path
        names = [name for name in imported(path.read_text(encoding="utf-8")) if name.startswith("xihe")]
        assert all(name.startswith(own) for name in names), path


# ---------------------------------------------------------------------------------------------- what an import brings


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        pytest.param("import xihe_blender, xihe_blender.errors", {"torch", "OpenEXR", "numpy", "bpy"}, id="the add-on"),
        pytest.param("import xihe_blender.report.page", {"numpy", "bpy"}, id="the report"),
        pytest.param(
            "import xihenet.controller, xihenet.metrics, xihenet.estimators as e; [e.load(n) for n in e.names()]",
            {"scipy", "torch", "fpsample", "OpenEXR", "bpy"},
            id="the science",
        ),
        pytest.param(
            "import xihe_blender.lab.workers.dask_workers",
            {"bpy", "torch"},
            id="a worker",
            marks=pytest.mark.wheel_only("a whole Blender's Python has no Dask"),
        ),
    ],
)
def test_an_import_brings_nothing_heavy(code, heavy):
    found = f"{heavy} & {{m.split('.')[0] for m in sys.modules}}"
    assert fresh_python(f"import sys; {code}; print({found})").stdout == "set()\n"


def test_importing_xihenet_imports_nothing():
    code = "import sys, xihenet; print(sorted(m for m in sys.modules if m == 'numpy' or m.startswith('xihenet')))"
    assert fresh_python(code).stdout == "['xihenet']\n"


def test_a_session_runs_where_there_is_no_blender():
    script, room = "docs/session_without_blender.py", "addon_tests/data/test_rooms/room_000033.npz"
    code = f"import sys, runpy; sys.modules['bpy'] = None; runpy.run_path('{script}')['main']('{room}')"
    assert fresh_python(code).stdout.count("seen, mean radiance") == 2


def test_help_and_a_star_show_the_public_names():
    code = "from xihenet import *; import pydoc, xihenet; print(pydoc.plain(pydoc.render_doc(xihenet)), XiheController)"
    shown = fresh_python(code).stdout
    assert "class XiheController" in shown and "decide_trigger(" in shown and "TYPE_CHECKING" not in shown


def test_the_public_names_are_what_type_checkers_are_told():
    tree = ast.parse((ROOT / "xihenet" / "__init__.py").read_text(encoding="utf-8"))
    declared = {
        alias.name: getattr(importlib.import_module(node.module), alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("xihenet.")
        for alias in node.names
    }
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == "xihenet"]
    assert {alias.name for node in imports for alias in node.names} == set(xihenet._MODULES)
    offered = {name for names in xihenet._MODULES.values() for name in names}
    assert declared.keys() == offered
    assert all(getattr(xihenet, name) is declared[name] for name in offered)
    assert set(xihenet.__all__) == offered | set(xihenet._MODULES)
    assert {name for name in dir(xihenet) if not name.startswith("__")} == set(xihenet.__all__)
    assert all(getattr(xihenet, name).__name__ == f"xihenet.{name}" for name in xihenet._MODULES)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = xihenet.nothing
