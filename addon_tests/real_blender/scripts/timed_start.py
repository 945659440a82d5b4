"""Notes the milliseconds that importing and registering the add-on takes, and enabling it as Blender does."""

import importlib
import json
import sys
import time
from pathlib import Path

import addon_utils

OURS = ("xihenet", "xihe_blender")


def forget():
    for name in [name for name in sys.modules if name.partition(".")[0] in OURS or name.startswith(module)]:
        del sys.modules[name]


def timed_ms(do):
    start = time.perf_counter()
    do()
    return (time.perf_counter() - start) * 1000


out, module = sys.argv[sys.argv.index("--") + 1 :]
addon_utils.disable(module)
forget()
facts = {"import and register": timed_ms(lambda: importlib.import_module(module).register())}
sys.modules[module].unregister()
forget()
facts["enable, with what Blender checks of wheels"] = timed_ms(lambda: addon_utils.enable(module))
Path(out).write_text(json.dumps(facts))
