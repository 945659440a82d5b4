"""A warning of NumPy is a wrong answer: whoever hides one says why."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
FOLDERS = ("xihenet", "xihe_blender", "addon_tests", "blend_scenes", "docs")
HIDES = re.compile(r"""with np\.errstate\(|\bseterr\(|(simplefilter|filterwarnings)\(["']ignore""")


def test_nothing_hides_a_warning_without_a_comment_on_why():
    files = [file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py")]
    n_hidden = 0
    for file in files:
        content = file.read_text(encoding="utf-8")
        if not HIDES.search(content):
            continue
        lines = content.splitlines()
        for above, line in zip(["", *lines], lines, strict=False):
            if HIDES.search(line):
                n_hidden += 1
                is_told = "#" in line or above.lstrip().startswith("#")
                assert is_told, f"{file}: {line.strip()} hides a warning and does not say why"
    assert n_hidden > 10
