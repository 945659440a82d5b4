"""Whose is this folder? A run resumes only on what the same run left there.

The settings of a run, the .blend's content and the versions that shape its numbers are written down before anything
else. A folder with other settings is refused, not mixed and not overwritten.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.errors import UserError
from xihe_blender.outputs import RunOutputs, write_json
from xihe_blender.plan import PrevisPlan
from xihe_blender.previs_settings import PrevisSettings
from xihenet import __version__


def claim_folder(
    outputs: RunOutputs, scene: bpy.types.Scene, file: Path, settings: PrevisSettings, plan: PrevisPlan
) -> dict[str, Any] | None:
    """Make the run's folder, or take it up where the same run stopped.

    Returns the results if that run is already done, else None. UserError if the folder cannot be written, or holds
    something else.
    """
    identity = run_identity(scene, file, settings, plan)
    if outputs.folder.exists() and not outputs.folder.is_dir():
        raise UserError(f"{outputs.folder} is a file: give --out a folder")
    if outputs.settings.exists():
        _check_is_the_same(outputs, identity)
        return _finished(outputs)
    strange = [file for file in (outputs.results, outputs.report, outputs.lit_blend) if file.exists()]
    if strange:
        raise UserError(
            f"{strange[0]} is there and not from a run that can be resumed: choose another folder for --out"
        )
    try:
        write_json(outputs.settings, identity)
    except OSError as error:
        raise UserError(
            f"cannot write to {outputs.folder} ({error.strerror}): choose another folder for --out"
        ) from error
    return None


def run_identity(scene: bpy.types.Scene, file: Path, settings: PrevisSettings, plan: PrevisPlan) -> dict[str, Any]:
    """All that decides a run's numbers, as JSON holds it."""
    identity = {
        "xihe": __version__,
        "blender": bpy.app.version_string,
        "blend_sha256": hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else None,
        "scene": scene.name,
        "settings": asdict(settings),
        # A file of the user's may have changed since.
        "phone": asdict(settings.profile),
        "effort": asdict(settings.effort),
        "frames": plan.frames,
        "size": plan.size,
        "objects": [item.name for item in plan.objects],
    }
    same: dict[str, Any] = json.loads(json.dumps(identity))
    return same


def _check_is_the_same(outputs: RunOutputs, identity: dict[str, Any]) -> None:
    try:
        kept = json.loads(outputs.settings.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        kept = {}
    known = kept if isinstance(kept, dict) else {}
    different = [name for name in identity if known.get(name) != identity[name]]
    if different:
        what = ", ".join(name.replace("_", " ") for name in different)
        raise UserError(
            f"{outputs.folder} holds a run with another {what}: choose another folder for --out, or delete that one"
        )


def _finished(outputs: RunOutputs) -> dict[str, Any] | None:
    if not (outputs.results.exists() and outputs.report.exists() and outputs.lit_blend.exists()):
        return None
    content: dict[str, Any] = json.loads(outputs.results.read_text(encoding="utf-8"))
    return content
