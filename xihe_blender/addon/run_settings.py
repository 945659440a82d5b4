"""What would Run do with this scene? The panel's properties, as the settings and the folder that the work takes.

Imported when an operator runs: it needs the work modules, and they need NumPy.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.addon.choices import FROM_FILE, NO_NETWORK
from xihe_blender.addon.preferences import XihePreferences, preferences
from xihe_blender.effects import Effect
from xihe_blender.effects.command import report_effects
from xihe_blender.effects.overrides import SWITCHED_ELSEWHERE, remembered_overrides
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.phone_capture import PhoneEffect
from xihe_blender.previs_settings import PrevisSettings


def previs_settings(scene: bpy.types.Scene) -> PrevisSettings:
    """The settings of a run on `scene`; UserError for what cannot be run."""
    chosen = scene.xihe
    return PrevisSettings(
        estimator=chosen.estimator,
        preset=chosen.preset,
        target=chosen.target,
        size=tuple(chosen.size) if chosen.use_own_size else None,
        frames=chosen_frames(scene),
        exposure=chosen.exposure if chosen.use_own_exposure else None,
        seed=chosen.seed,
        phone=_phone(scene),
        network=None if chosen.network == NO_NETWORK else chosen.network,
    )


def chosen_frames(scene: bpy.types.Scene) -> tuple[int, ...] | None:
    """Frames of the panel; None for the scene's own. UserError for an empty range or one outside the scene's."""
    chosen = scene.xihe
    if not chosen.use_own_frames:
        return None
    first, last = chosen.frame_start, chosen.frame_end
    if first > last:
        raise UserError(f"Own Frames end at {last}, before they start at {first}: change one of them")
    if first < scene.frame_start or last > scene.frame_end:
        raise UserError(
            f"Own Frames {first} to {last} go beyond the scene's range {scene.frame_start} to {scene.frame_end}: "
            "change one of them"
        )
    return tuple(range(first, last + 1, chosen.frame_step))


def _phone(scene: bpy.types.Scene) -> str:
    """Name of a profile, or path of the user's file: of the scene, or of the preferences where the phone is theirs."""
    if scene.xihe.phone != FROM_FILE:
        return str(scene.xihe.phone)
    user = preferences(bpy.context)
    file = scene.xihe.phone_file or (user.phone_file if user is not None else "")
    if not file:
        raise UserError("Phone is From File, but no file is chosen: choose one, or another phone")
    return str(bpy.path.abspath(file))


def new_run_folder(scene: bpy.types.Scene) -> Path:
    """A new, empty folder for a run, named by the file and the time.

    UserError if it cannot be made. A run from the panel always begins anew: the open file may hold changes that are
    nowhere on disk, and then nothing could tell whether an earlier run was the same.
    """
    parent = runs_folder()
    stem = Path(bpy.data.filepath).stem or "untitled"
    name = f"{stem}_{time.strftime('%Y%m%d-%H%M%S')}"
    try:
        parent.mkdir(parents=True, exist_ok=True)
        return _made_new(parent, name)
    except OSError as error:
        raise UserError(
            f"cannot write to {parent} ({error.strerror}): choose another Runs Folder in the add-on's preferences"
        ) from error


def _made_new(parent: Path, name: str) -> Path:
    """`parent / name`, with a number behind it if that is taken."""
    number = 1
    while True:
        folder = parent / (name if number == 1 else f"{name}_{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
        else:
            return folder


def runs_folder() -> Path:
    """Where runs from the panel are kept: the user's choice, else the extension's own place for files."""
    user = preferences(bpy.context)
    if user is not None and user.cache_folder:
        return Path(bpy.path.abspath(user.cache_folder))
    try:
        return Path(bpy.utils.extension_path_user(XihePreferences.bl_idname, path="runs"))
    except ValueError:
        # Not installed as an extension, as where a script registered the add-on.
        return Path(bpy.utils.user_resource("DATAFILES", path="xihe")) / "runs"


def _is_switchable(effect: Effect | PhoneEffect) -> bool:
    """Whether a setting of the scene switches an effect of light transport, or the phone has that of a phone."""
    if effect.name in SWITCHED_ELSEWHERE:
        return SWITCHED_ELSEWHERE[effect.name] is None
    return bool(effect.parameters)


def planned_rows(scene: bpy.types.Scene) -> list[dict[str, Any]]:
    """What `scene` calls for, effect by effect, as the properties of XiheEffectRow; nothing is rendered.

    An effect of the phone that only captures could rule out is on; the run rules it out.
    """
    remembered = remembered_overrides(scene)
    # What the scene itself calls for; the row adds the user's choice.
    session = previs_settings(scene)
    report = run_blocking(
        report_effects(
            scene,
            session.frames,
            dict.fromkeys(remembered, "auto"),
            phone=session.phone,
            network=session.network,
            is_measured=False,
        )
    )
    return [
        {
            "name": effect.name,
            "called_for": effect.state,
            "reason": effect.reason,
            "is_switchable": _is_switchable(effect),
            "override": remembered.get(effect.name, "auto").upper(),
        }
        for effect in report.effects
    ]
