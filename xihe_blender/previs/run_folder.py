"""What decides a run's numbers, and is a run in this folder done, to be gone on with, or another's?"""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.io.folder_manifest import FolderManifest
from xihe_blender.io.json_records import Json, from_json
from xihe_blender.io.kept_files import kept_json
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import RunResults
from xihe_blender.previs.plan import PrevisPlan
from xihe_blender.previs.settings import PrevisSettings
from xihenet import __version__


def run_manifest(
    outputs: RunOutputs, scene: bpy.types.Scene, file: Path, settings: PrevisSettings, plan: PrevisPlan
) -> FolderManifest:
    """The manifest of the run's folder, not yet written."""
    leaves = (outputs.results, outputs.report, outputs.lit_blend)
    provenance = run_identity(scene, file, settings, plan)
    return FolderManifest(outputs.folder, outputs.settings, "a run", provenance, leaves)


def run_identity(scene: bpy.types.Scene, file: Path, settings: PrevisSettings, plan: PrevisPlan) -> dict[str, Any]:
    """All that decides a run's numbers."""
    return {
        "xihe": __version__,
        "blender": bpy.app.version_string,
        "blend_sha256": hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else None,
        "scene": scene.name,
        "settings": asdict(settings),
        # A file of the user's may have changed since.
        "phone": asdict(settings.profile),
        "preset": asdict(settings.preset_values),
        "frames": plan.frames,
        "size": plan.size,
        "objects": [item.name for item in plan.objects],
    }


def finished_results(outputs: RunOutputs) -> dict[str, Any] | None:
    """The results of a run that is done; None of one that is not, or whose results are damaged."""
    if not (outputs.results.exists() and outputs.report.exists() and outputs.lit_blend.exists()):
        return None
    return kept_json(outputs.results, _checked_results)


def _checked_results(content: Json) -> dict[str, Any]:
    """The same; TypeError or ValueError if it is not what a run writes."""
    from_json(RunResults, content)
    results: dict[str, Any] = content
    return results
