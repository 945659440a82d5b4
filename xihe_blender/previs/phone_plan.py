"""Effects of a phone that a run of this scene would simulate, before there is one.

A run plans them from its captures; see `phone_capture`. So the path is captured here as well, with few samples:
distances, edges and angles do not depend on their number, and brightness hardly. What needs no capture (how the camera
moves, which lights change, how long the path is) is known either way, and is all there is to go by where nothing may be
rendered, as in the panel: what only a capture could rule out then stays on.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import CyclesScanner, open_scanner, sized_for
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import Job, Progress
from xihe_blender.previs.phone_capture import PhoneCapture
from xihe_blender.previs.plan import DEFAULT_SIZE, PrevisPlan, Probe, planned_frames
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.state import scene_kept
from xihenet.effects import Effect

N_SAMPLES = 4


def plan_phone_effects(
    scene: bpy.types.Scene, positions: Sequence[Sequence[float]], settings: PrevisSettings, *, is_captured: bool
) -> Job[dict[str, Effect]]:
    """The effects of phone and network, as `settings` has them; none for a perfect phone that estimates by itself.

    Parameters
    ----------
    scene : stays as it is
    positions : (K, 3) world, metres: where light is estimated. As in a run, a frame that sees none is not captured
    settings : of the run: phone, network, frames, size, choices
    is_captured : render the path, N_SAMPLES per pixel; else an effect that only captures could rule out is on

    Raises
    ------
    UserError for a scene without a camera, frames outside its range, or choices that the phone does not have
    """
    frames = tuple(planned_frames(scene, settings.frames))
    size = settings.size or sized_for(scene, RenderSettings(DEFAULT_SIZE, samples=1)).size
    probes = tuple(Probe(str(k), "", np.array(position)) for k, position in enumerate(positions))
    plan = PrevisPlan(frames, size, (), probes)
    render = settings.capture(size, N_SAMPLES)
    if not settings.profile.effects and settings.link is None:
        return {}
    with tempfile.TemporaryDirectory() as folder, scene_kept(), open_scanner(scene, render) as scanner:
        phone = PhoneCapture(scene, plan, RunOutputs(Path(folder), "phone"), settings, exposure=1.0)
        phone.prepare(scanner)
        if is_captured and phone.sees:
            yield from _captured(scanner, phone, plan)
        phone.plan()
    return phone.effects


def _captured(scanner: CyclesScanner, phone: PhoneCapture, plan: PrevisPlan) -> Job[None]:
    """A job: have `phone` notice every frame that a run would capture."""
    for done, frame in enumerate(plan.frames):
        yield Progress(done, len(plan.frames), f"looking at frame {frame} as the phone does")
        if frame in phone.delivered and plan.probes_in_view(scanner, frame):
            captured = scanner.acquire_environment_scan()
            phone.keep(scanner, frame)
            phone.notice(captured)
