"""Blender's start: what does the enabled add-on add to it? `XIHE_BLENDER=blender python addon_tests/bench/start_up.py`.

Installs the extension for a user of its own, then takes the time that Blender needs to import and register it, in a new
process each time: the add-on is disabled, its modules are forgotten, and it is enabled again.
"""

import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from addon_tests.real_blender.whole_blender import MODULE, WholeBlender  # noqa: E402

N_STARTS = 7
BUDGET_MS = 50


def main():
    with tempfile.TemporaryDirectory() as folder:
        blender = WholeBlender(Path(folder) / "user")
        package = [sys.executable, "-m", "xihe_blender", "package", "--out", folder]
        subprocess.run(package, cwd=ROOT, check=True)
        blender.install(next(Path(folder).glob("*.zip")))
        facts = Path(folder) / "facts.json"
        starts = [blender.facts("timed_start.py", facts, MODULE) for _ in range(N_STARTS)]
    for key in starts[0]:
        times = sorted(start[key] for start in starts)
        print(f"{key}: median {statistics.median(times):.1f} ms, {times[0]:.1f} to {times[-1]:.1f} ms")
    print(f"budget: {BUDGET_MS} ms, {N_STARTS} starts")


if __name__ == "__main__":
    main()
