"""Notes what is loaded when Blender has started, and whether the add-on is enabled."""

import sys

# Before anything else: the names, not what this script needs.
LOADED = sorted(sys.modules)

import json  # noqa: E402
from pathlib import Path  # noqa: E402

import bpy  # noqa: E402

out, module = sys.argv[sys.argv.index("--") + 1 :]
facts = {"modules": LOADED, "is_enabled": module in bpy.context.preferences.addons}
Path(out).write_text(json.dumps(facts))
