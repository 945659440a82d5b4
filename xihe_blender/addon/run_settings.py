"""What would Run do with this scene? The panel's properties, as the settings that the work takes.

Imported when an operator runs: it needs the work modules, and they need NumPy.
"""

from __future__ import annotations

from typing import Any

import bpy

from xihe_blender.addon.choices import FROM_FILE, NO_NETWORK, PHONES_METERING
from xihe_blender.addon.preferences import preferences
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.light_transport import Effect
from xihe_blender.light_transport.overrides import SWITCHED_ELSEWHERE, remembered_overrides
from xihe_blender.previs.effects_report import report_effects
from xihe_blender.previs.phone_capture import PhoneEffect
from xihe_blender.previs.settings import PrevisSettings


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
        metering=None if chosen.metering == PHONES_METERING else chosen.metering,
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
