"""The script that Blender is given with `--python`: registers the add-on and plays one of the scenarios.

    blender FILE.blend --python run_scenario.py -- --scenario look --out DIR

A scenario is a module with `scenario(window)`, a generator of `window_steps`, and, if it needs a scene of its own,
`prepare()`, which makes that before the add-on is registered, as if a file were opened.
"""

import argparse
import importlib
import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenario", required=True, help="name of a module in scenarios/")
    parser.add_argument("--out", type=Path, required=True, help="folder for pictures and facts.json")
    parser.add_argument("--site", default="", help="folders with packages for this Python, as in PYTHONPATH")
    parser.add_argument("--add-on", default="checkout", help="checkout, none, or the name of an installed extension")
    parser.add_argument("--run", type=Path, help="folder of a finished run, for scenarios that show one")
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :])
    own = [str(HERE), str(HERE / "scenarios"), str(ROOT / "addon_tests" / "in_blender")]
    sys.path[:0] = [*filter(None, options.site.split(os.pathsep)), *own]
    if options.add_on == "checkout":
        sys.path.insert(0, str(ROOT))
    scenario = importlib.import_module(options.scenario)
    if hasattr(scenario, "prepare"):
        scenario.prepare()
    print(f"scenario {options.scenario}", flush=True)
    enable(options.add_on)
    importlib.import_module("window_steps").play(scenario.scenario, options.out, options.run)


def enable(add_on):
    """The add-on of this checkout, an installed one by its name, or none."""
    if add_on == "checkout":
        from xihe_blender import addon

        addon.register("xihe")
    elif add_on != "none":
        import addon_utils

        assert addon_utils.enable(add_on) is not None, f"{add_on} could not be enabled"


main()
