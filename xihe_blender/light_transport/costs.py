"""Costs of effects in this scene, and what leaving each out would change. Measured, on small renders.

For every effect that a setting switches: the run's plan with that effect on and with it off, all else as planned. Two
views are rendered: a light probe at the first estimation position and the phone's picture, both at one frame.
Interleaved, seed by seed: what else the machine does then slows both sides down alike, and both sides carry nearly the
same noise, so that a small difference shows after few seeds. Rejected: every effect against a bare scene, which says
little of a run that has the others on.

A small render takes a fixed time besides its samples, so in a full run an effect's share is rather larger. Denoising
is left out but where it is itself the question.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.capture.reference_probe import ProbeSettings, light_of_cones, open_reference_probe
from xihe_blender.capture.render import RenderSettings, render_passes
from xihe_blender.capture.scanner import first_layer, open_scanner, sized_for
from xihe_blender.jobs import Job, Progress
from xihe_blender.light_transport.plan import cycles_settings
from xihe_blender.scene.state import scene_kept
from xihenet.effects import Change, Effect, EffectCost, Requirement, plan_effects
from xihenet.records import ArrayF64

PROBE_SAMPLES = 2
"""Rays in each pixel of the reference probe's picture of all light."""

PICTURE = RenderSettings((48, 36), samples=8, denoise=False)
N_SEEDS = 6
BASELINE = "the plan"


@dataclass(frozen=True)
class _Variant:
    """A plan to measure: the run's own, or that with one effect switched; `has_effect` says which way round."""

    plan: Mapping[str, Effect]
    has_effect: bool
    denoise: bool = False


@dataclass(eq=False)
class _View:
    """A working scene that renders one variant; its mean radiance and render time by seed."""

    scene: bpy.types.Scene
    mean: Callable[[ArrayF64], float]
    means: list[float]
    seconds: list[float]

    def render(self, seed: int) -> None:
        self.scene.cycles.seed = seed
        rendered = render_passes(self.scene)
        self.means.append(self.mean(first_layer(rendered)[0].astype(np.float64)))
        self.seconds.append(rendered.render_s)


Views = Mapping[str, _View]
"""By name of the variant."""


def measure_costs(
    scene: bpy.types.Scene,
    required: Mapping[str, Requirement],
    choices: Mapping[str, str],
    positions: Sequence[ArrayLike],
    frame: int,
) -> Job[dict[str, EffectCost]]:
    """What every effect that a setting switches costs and changes; `scene` stays as it is.

    Parameters
    ----------
    required, choices : what the scene requires and what the user wants; see `plan_effects`
    positions : (K, 3) world, metres; the light probe stands at the first. Empty is legal
    frame : at which to render

    Returns
    -------
    costs by name of the effect, without those that no setting of a scene switches; empty with nothing to look from
    """
    variants = _variants(required, choices)
    with scene_kept(), contextlib.ExitStack() as stack:
        kinds: dict[str, Views] = {}
        if len(positions):
            kinds["light"] = {
                n: stack.enter_context(_probe(scene, v, positions[0], frame)) for n, v in variants.items()
            }
        if scene.camera is not None:
            kinds["picture"] = {n: stack.enter_context(_picture(scene, v, frame)) for n, v in variants.items()}
        yield from _render_interleaved(kinds, list(variants))
        switched = [name for name in variants if name != BASELINE and kinds]
        return {name: _cost(kinds, name, has_effect=variants[name].has_effect) for name in switched}


def _variants(required: Mapping[str, Requirement], choices: Mapping[str, str]) -> dict[str, _Variant]:
    """The plan, and it with one effect the other way round for each effect that has settings of two kinds."""
    plan = plan_effects(required, choices)
    variants = {BASELINE: _Variant(plan, has_effect=False)}
    for name, one in required.items():
        if one.on != one.off:
            # Nothing else is denoised, so that denoising itself is the one to add.
            is_on = name == "denoising" or plan[name].state == "off"
            switched = plan_effects(required, {**choices, name: "on" if is_on else "off"})
            variants[name] = _Variant(switched, is_on, denoise=name == "denoising")
    return variants


def _render_interleaved(kinds: Mapping[str, Views], names: Sequence[str]) -> Iterator[Progress]:
    """Every view with every seed, after one round that is not counted: the first render builds Cycles' scene."""
    for seed in range(N_SEEDS + 1):
        for index in range(len(names)):
            # Another one comes first each time, so that none always follows the same one.
            name = names[(index + seed) % len(names)]
            for views in kinds.values():
                yield Progress(seed, N_SEEDS + 1, "measuring with and without each effect")
                views[name].render(seed)
    for view in (view for views in kinds.values() for view in views.values()):
        del view.means[0], view.seconds[0]


def _cost(kinds: Mapping[str, Views], name: str, *, has_effect: bool) -> EffectCost:
    order = (name, BASELINE) if has_effect else (BASELINE, name)
    pairs = {kind: (views[order[0]], views[order[1]]) for kind, views in kinds.items()}
    seconds = [np.sum([pair[side].seconds for pair in pairs.values()], axis=0) for side in (0, 1)]
    changes = {kind: _change(np.array(on.means), np.array(off.means)) for kind, (on, off) in pairs.items()}
    shares = seconds[0] / seconds[1] - 1
    return EffectCost(float(np.median(shares)), _standard_error(shares), changes.get("light"), changes.get("picture"))


def _change(on: ArrayF64, off: ArrayF64) -> Change | None:
    """From the means by seed with and without the effect, paired; None where both are black."""
    scale = on.mean() or off.mean()
    if scale == 0:
        return None
    differences = (off - on) / scale
    return Change(float(differences.mean()), _standard_error(differences))


def _standard_error(values: ArrayF64) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))


@contextlib.contextmanager
def _probe(scene: bpy.types.Scene, variant: _Variant, position_m: ArrayLike, frame: int) -> Iterator[_View]:
    settings = ProbeSettings(128, denoise=False, light_transport=cycles_settings(variant.plan))
    with open_reference_probe(scene, np.array([position_m]), settings) as probe:
        probe.scene.frame_set(frame)
        probe.look_at_cones(0, PROBE_SAMPLES)
        yield _View(probe.scene, lambda cones: float(light_of_cones(cones.astype(np.float32))[0].mean()), [], [])


@contextlib.contextmanager
def _picture(scene: bpy.types.Scene, variant: _Variant, frame: int) -> Iterator[_View]:
    settings = replace(PICTURE, denoise=variant.denoise, light_transport=cycles_settings(variant.plan))
    with open_scanner(scene, sized_for(scene, settings)) as scanner:
        scanner.scene.frame_set(frame)
        yield _View(scanner.scene, lambda radiance: float(radiance.mean()), [], [])
