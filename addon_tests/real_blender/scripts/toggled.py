"""Notes what is registered before the add-on is enabled, while it is, and after ten times on and off."""

import json
import sys
from pathlib import Path

import addon_utils

sys.path.append(str(Path(__file__).resolve().parents[2] / "in_blender"))

from registered_things import registered

out, module = sys.argv[sys.argv.index("--") + 1 :]
addon_utils.disable(module)
first = registered()
enabled = []
for _ in range(10):
    assert addon_utils.enable(module) is not None
    enabled.append(registered())
    addon_utils.disable(module)
Path(out).write_text(json.dumps({"before": first, "enabled": enabled, "after": registered()}))
