"""The settings of Run for a scene: the panel's properties, as the settings that the work takes; and a run by them.

Imported when an operator runs: it needs the work modules, and they need NumPy.
"""

from __future__ import annotations

import contextlib
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.addon.background_run import COMMAND
from xihe_blender.addon.choices import FROM_FILE, NO_NETWORK, PHONES_METERING, USUAL_TRIGGER, other_estimator_items
from xihe_blender.addon.preferences import preferences
from xihe_blender.addon.results_in_blender import show_results
from xihe_blender.apply.reflection_pictures import required_light
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import RunResults
from xihe_blender.jobs import Job
from xihe_blender.light_transport.overrides import remember_overrides, remembered_overrides
from xihe_blender.previs.plan import captured_size, planned_frames
from xihe_blender.previs.previs import previs
from xihe_blender.previs.required_effects import effects_of_run
from xihe_blender.previs.settings import PrevisSettings, settings_of
from xihe_blender.scene.blend_file import absolute
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet import estimators
from xihenet.effects import Effect
from xihenet.phone import load_profile, profile_names
from xihenet.trigger import RULES, TriggerSettings

AS_CHOSEN = ("estimator", "preset", "target", "seed")
"""Choices of the panel that a run is told, and remembers, as they are and under the same name."""


def run_and_show(scene: bpy.types.Scene, folder: Path, settings: PrevisSettings) -> Job[None]:
    """A run in this Blender: `previs` into `folder`, new and empty, then its results in the open file.

    One job for the panel's two drivers, modal in a window and blocking in background. If it is stopped or fails, it
    leaves no folder.
    """
    try:
        yield from previs(scene, folder, settings, command=COMMAND)
    finally:
        if not RunOutputs(folder).results.exists():
            shutil.rmtree(folder, ignore_errors=True)
    show_results(scene, folder)


def previs_settings(scene: bpy.types.Scene) -> PrevisSettings:
    """The settings of a run on `scene`; UserError for what cannot be run."""
    return settings_of(choices_of_run(scene))


def choices_of_run(scene: bpy.types.Scene) -> dict[str, Any]:
    """What the panel chooses, by name, for `settings_of`; UserError for frames or a phone that cannot be."""
    chosen = scene.xihe
    return {name: getattr(chosen, name) for name in AS_CHOSEN} | {
        "backend": chosen.edge_server.strip() if chosen.uses_edge_server else None,
        "others": tuple(name for name in estimators.names() if name in chosen.others),
        "light": chosen.light,
        "size": tuple(chosen.size) if chosen.use_own_size else None,
        "frames": chosen_frames(scene),
        "captured": "path" if chosen.captures_path else "in-view",
        "between_estimates": "carried" if chosen.carries_light else "kept",
        "exposure": chosen.exposure if chosen.use_own_exposure else None,
        "metering": None if chosen.metering == PHONES_METERING else chosen.metering,
        "trigger": None if chosen.trigger == USUAL_TRIGGER else chosen.trigger,
        "phone": _phone(scene),
        "network": None if chosen.network == NO_NETWORK else chosen.network,
    }


def choose_as_run(scene: bpy.types.Scene, run: RunResults) -> None:
    """Have the panel choose for `scene` what `run`, made of it, was told, from wherever it was started.

    Not what the panel has no choice for: samples, a noise target, some of the objects, frames at uneven steps. An
    estimator that is not installed here is left out. UserError where the scene has no frames.
    """
    made, frames = run.settings, list(run.settings.frames)
    step = frames[1] - frames[0] if len(frames) > 1 else 1
    is_range = frames == list(range(frames[0], frames[-1] + 1, step))
    is_known = made.phone in profile_names()
    is_phones = made.metering is None or (is_known and made.metering == load_profile(made.phone).metering)
    trigger = TriggerSettings(**made.trigger)  # type: ignore[arg-type]
    choices = {name: getattr(made, name) for name in AS_CHOSEN} | {
        "others": set(made.others) & {item[0] for item in other_estimator_items(None, None)},
        "light": "auto" if made.light == required_light(virtual_objects(scene)) else made.light,
        "uses_edge_server": made.backend is not None,
        "edge_server": made.backend or scene.xihe.edge_server,
        "captures_path": made.captured == "path",
        "carries_light": made.between_estimates == "carried",
        "phone": made.phone if is_known else FROM_FILE,
        "phone_file": "" if is_known else made.phone,
        "network": made.network or NO_NETWORK,
        "use_own_frames": is_range and frames != planned_frames(scene, None),
        "frame_start": frames[0],
        "frame_end": frames[-1],
        "frame_step": step,
        "use_own_size": made.size != captured_size(scene, PrevisSettings()),
        "size": made.size,
        "use_own_exposure": made.metering is None,
        "exposure": made.reference_exposure,
        "metering": PHONES_METERING if is_phones else made.metering,
        "trigger": next((name for name, rule in RULES.items() if rule == trigger), USUAL_TRIGGER),
    }
    for name, value in choices.items():
        # A phone that is chosen again would have the list of effects made anew.
        if getattr(scene.xihe, name) != value:
            with contextlib.suppress(TypeError):
                setattr(scene.xihe, name, value)
    remember_overrides(scene, made.effect_choices)


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
    return absolute(file)


def required_effects(scene: bpy.types.Scene) -> Job[dict[str, Effect]]:
    """A job: what `scene` itself requires, whatever the user has chosen; nothing is rendered.

    An effect of the phone that only captures could rule out is on; the run rules it out.
    """
    settings = replace(previs_settings(scene), effect_choices=dict.fromkeys(remembered_overrides(scene), "auto"))
    return effects_of_run(scene, settings, is_measured=False)
