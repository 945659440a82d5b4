"""The table of hard cases in Blender: `python -m addon_tests.in_blender.hard_cases`. Exit 1 if one is not right."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from addon_tests.in_blender.hard_cases.blender import CASES
from addon_tests.pure.hard_cases.__main__ import print_cases
from xihe_blender.io.blender_output import blender_output_aside

if __name__ == "__main__":
    with blender_output_aside() as (stdout, _):
        n_wrong = print_cases(CASES, stdout)
    sys.exit(min(n_wrong, 1))
