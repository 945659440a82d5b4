"""Do the tests pass inside a whole Blender, with its own Python and NumPy, as they do on the bpy wheel?

    blender --background --factory-startup --python addon_tests/run_in_blender.py -- [pytest arguments]

pytest and what else the tests import are not part of Blender. They come from a folder, `XIHE_TEST_PACKAGES` in the
environment or `build/test_packages/<Python version>`, which `make test-packages` fills. It stands last on the path:
what Blender has of its own, NumPy above all, is what is tested. Without arguments all of `pure` and `in_blender` runs;
the exit code is pytest's. A test that a whole Blender cannot run has a marker that says why, and is left out by it.
"""

import os
import sys
import traceback
from collections import Counter
from pathlib import Path

import bpy

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from xihe_blender.io.blender_output import leave_blender  # noqa: E402
from xihe_blender.lab.workers.processes import EXIT_CRASHED  # noqa: E402

FOLDERS = ("addon_tests/pure", "addon_tests/in_blender")
PYTHON = ".".join(str(number) for number in sys.version_info[:2])
EXIT_NO_PACKAGES = 2


def packages_folder():
    """Where pytest and its like are, whether or not they are."""
    return Path(os.environ.get("XIHE_TEST_PACKAGES") or ROOT / "build" / "test_packages" / PYTHON).resolve()


def why_left_out(item):
    """Why a whole Blender, or this one, cannot run a test; None if it can."""
    mark = item.get_closest_marker("wheel_only")
    if mark is not None:
        return mark.args[0]
    if item.get_closest_marker("needs_denoiser"):
        from xihe_blender.capture.render import can_denoise

        return None if can_denoise(bpy.context.scene) else "this Blender has no OpenImageDenoise"
    return None


class WholeBlender:
    """A pytest plugin: leaves out the tests that cannot run here, and says why."""

    def __init__(self):
        self.left_out = {}

    def pytest_collection_modifyitems(self, config, items):
        reasons = {item: why_left_out(item) for item in items}
        self.left_out = {item: reason for item, reason in reasons.items() if reason}
        config.hook.pytest_deselected(items=list(self.left_out))
        items[:] = [item for item in items if item not in self.left_out]

    def pytest_report_header(self):
        numpy = sys.modules["numpy"] if "numpy" in sys.modules else __import__("numpy")
        return f"Blender {bpy.app.version_string}, NumPy {numpy.__version__} of {Path(numpy.__file__).parent}"

    def pytest_terminal_summary(self, terminalreporter):
        for reason, number in Counter(self.left_out.values()).items():
            terminalreporter.write_line(f"left out: {number} tests: {reason}")


def run(arguments):
    """Run pytest with `arguments`; its exit code."""
    packages = packages_folder()
    if not (packages / "pytest").is_dir():
        print(f"no pytest in {packages}: run `make test-packages BLENDER_PYTHON={PYTHON}`", file=sys.stderr)
        return EXIT_NO_PACKAGES
    sys.path.append(str(packages))
    # For processes that tests start.
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(packages)])
    import pytest

    os.chdir(ROOT)
    has_paths = any(Path(argument.partition("::")[0]).exists() for argument in arguments)
    return int(pytest.main([*arguments, *([] if has_paths else FOLDERS)], plugins=[WholeBlender()]))


if __name__ == "__main__":
    exit_code = EXIT_CRASHED
    try:
        exit_code = run(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])
    finally:
        # Blender itself would end with 0 after an exception.
        if exit_code == EXIT_CRASHED:
            traceback.print_exc()
        leave_blender(exit_code)
