"""Who may import whom, held against the code as it stands."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import xihenet

ROOT = Path(__file__).resolve().parents[2]
BLENDER = {"bpy", "bmesh", "mathutils", "bpy_extras", "xihe_blender"}
TORCH_ROOMS = {"nets", "training", "edge"}


def imported_packages(file):
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("file", sorted((ROOT / "xihenet").rglob("*.py")), ids=lambda file: file.name)
def test_the_science_never_knows_blender(file):
    assert not imported_packages(file) & BLENDER


@pytest.mark.parametrize("file", sorted((ROOT / "xihenet").rglob("*.py")), ids=lambda file: file.name)
def test_torch_stays_in_its_rooms(file):
    if not TORCH_ROOMS & set(file.parts):
        assert "torch" not in imported_packages(file)


def test_importing_the_add_on_imports_neither_torch_nor_openexr_nor_numpy():
    heavy = ["torch", "OpenEXR", "numpy", "bpy"]
    code = f"import sys, xihe_blender, xihe_blender.errors; print([n for n in {heavy} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def test_importing_xihenet_imports_nothing():
    code = "import sys, xihenet; print(sorted(m for m in sys.modules if m == 'numpy' or m.startswith('xihenet')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "['xihenet']"


def test_the_public_names_are_what_type_checkers_are_told():
    tree = ast.parse((ROOT / "xihenet" / "__init__.py").read_text(encoding="utf-8"))
    declared = {
        alias.name: getattr(importlib.import_module(node.module), alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("xihenet.")
        for alias in node.names
    }
    offered = {name for names in xihenet._MODULES.values() for name in names}
    assert declared.keys() == offered
    assert all(getattr(xihenet, name) is declared[name] and name in dir(xihenet) for name in offered)
    assert all(getattr(xihenet, name).__name__ == f"xihenet.{name}" for name in xihenet._MODULES)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = xihenet.nothing


def test_a_session_runs_where_there_is_no_blender():
    code = "import sys, runpy; sys.modules['bpy'] = None; runpy.run_path(sys.argv[1])['main'](sys.argv[2])"
    script, room = ROOT / "docs" / "session_without_blender.py", ROOT / "addon_tests/data/test_rooms/room_000033.npz"
    command = [sys.executable, "-W", "error", "-c", code, str(script), str(room)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0 and done.stdout.count("seen, mean radiance") == 2, done.stderr


def test_importing_the_science_needs_numpy_alone():
    code = (
        "import sys, xihenet.controller, xihenet.metrics, xihenet.estimators as e;"
        "[e.load(n) for n in e.names()];"
        "print(sorted({m.split('.')[0] for m in sys.modules} & {'scipy', 'torch', 'fpsample', 'OpenEXR', 'bpy'}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"
