"""A run from a script, in a Blender that has the extension; small, so that it takes seconds.

blender --background blend_scenes/cornell_box.blend --python docs/previs_in_blender.py -- out/scripted
"""

import sys
from pathlib import Path

import bpy

from xihe_blender.jobs import run_blocking
from xihe_blender.previs.previs import previs
from xihe_blender.previs.settings import PrevisSettings

out = Path(sys.argv[sys.argv.index("--") + 1])
settings = PrevisSettings(preset="draft", size=(32, 24), frames=(1, 7, 13))
results = run_blocking(previs(bpy.context.scene, out, settings))
print(f"{results['summary']['n_estimates']} estimates, see {out / 'report.html'}")
