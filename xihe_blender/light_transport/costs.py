"""Costs of effects in this scene, and what leaving each out would change. Measured, on small renders.

For every effect that a setting switches: the run's plan with that effect on and with it off, all else as planned. Two
views are rendered, the phone's picture and a light probe at the first estimation position, both at one frame; first
all effects in the one, then all in the other. Within an effect the two sides take turns, seed by seed: what else the
machine does then slows both down alike, and both carry nearly the same noise, so that a small difference shows after
few seeds. Rejected: every effect against a bare scene, which says little of a run that has the others on.

Both sides share one scene, whose geometry Cycles keeps between renders until another scene is rendered: in a furnished
room a small picture takes 0.08 s so, and 1.8 s when the scene is built anew; the pixels are the same. A small render
takes a fixed time besides its samples, so in a full run an effect's share is rather larger. Denoising is left out but
where it is itself the question, and light probes are never denoised.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.capture.reference_probe import ProbeSettings, lights_of_cones, open_reference_probe
from xihe_blender.capture.render import RenderSettings, apply_effects, render_passes
from xihe_blender.capture.scanner import first_layer, open_scanner, sized_for
from xihe_blender.jobs import Job, Progress
from xihe_blender.light_transport.plan import cycles_settings
from xihe_blender.scene.state import scene_kept
from xihenet.effects import Change, Effect, EffectCost, Requirement, plan_effects
from xihenet.records import ArrayF64

PROBE_SAMPLES = 2  # rays in each pixel of the reference probe's picture of all light
PICTURE = RenderSettings((48, 36), samples=8, denoise=False)
N_SEEDS, APART_SEEDS, FEWEST_SEEDS = 6, 4, 2

OWN_SCENE = frozenset({"motion blur", "denoising"})
"""Effects that are switched in a scene of their own, without taking turns: motion blur ends the process where geometry
is kept (Blender 4.5), and a denoised picture has other passes."""


@dataclass(frozen=True)
class _Variant:
    """A plan to measure: the run's own, or that with one effect switched; `has_effect` says which way round."""

    plan: Mapping[str, Effect]
    has_effect: bool = False
    denoise: bool = False


@dataclass(frozen=True, eq=False)
class _View:
    """A working scene that renders any variant: mean radiance, and seconds."""

    scene: bpy.types.Scene
    mean: Callable[[ArrayF64], float]

    def render(self, variant: _Variant, seed: int) -> tuple[float, float]:
        apply_effects(self.scene, cycles_settings(variant.plan))
        self.scene.cycles.seed = seed
        rendered = render_passes(self.scene)
        return self.mean(first_layer(rendered)[0].astype(np.float64)), rendered.render_s


Opened = Callable[[_Variant], contextlib.AbstractContextManager[_View]]  # opens one kind of view, set up for a variant


def measure_costs(
    scene: bpy.types.Scene,
    required: Mapping[str, Requirement],
    choices: Mapping[str, str],
    positions: Sequence[ArrayLike],
    frame: int,
    *,
    budget_s: float,
    on_cost: Callable[[str, EffectCost], None] | None,
) -> Job[dict[str, EffectCost]]:
    """What every effect that a setting switches costs and changes; `scene` stays as it is.

    By name of the effect; empty with nothing to look from.

    Parameters
    ----------
    required, choices : what the scene requires and what the user wants; see `plan_effects`
    positions : (K, 3) world, metres; the light probe stands at the first. Empty is legal
    frame : at which to render
    budget_s : seconds, shared among the effects; each that is begun has FEWEST_SEEDS, of the picture alone where time
        ran out before the light probe, and the others have no cost
    on_cost : called with the name of each effect as soon as its cost is known
    """
    variants, deadline = _variants(required, choices), time.perf_counter() + budget_s
    baseline = _Variant(plan_effects(required, choices))
    kinds: dict[str, Opened] = {}
    if scene.camera is not None:
        kinds["picture"] = lambda variant: _picture(scene, variant, frame)
    if len(positions):
        kinds["light"] = lambda variant: _probe(scene, variant, positions[0], frame)
    names = sorted(variants, key=lambda name: name in OWN_SCENE)
    units = [(kind, name) for kind in kinds for name in names if (kind, name) != ("light", "denoising")]
    rounds: dict[str, dict[str, ArrayF64]] = {name: {} for name in variants}
    costs: dict[str, EffectCost] = {}

    def know(name: str) -> None:
        costs[name] = _cost(rounds[name], has_effect=variants[name].has_effect)
        if on_cost is not None:
            on_cost(name, costs[name])

    with scene_kept(), contextlib.ExitStack() as stack:
        shared: dict[str, _View] = {}
        for done, (kind, name) in enumerate(units):
            now = time.perf_counter()
            if now > deadline:
                break
            progress = Progress(done, len(units), f"measuring the cost of {name}")
            yield progress
            if kind not in shared:
                shared[kind] = stack.enter_context(kinds[kind](baseline))
            if name in OWN_SCENE:
                found = _apart(shared[kind], baseline, kinds[kind], variants[name], progress)
            else:
                stop_at = now + (deadline - now) / (len(units) - done)
                found = _in_turns(shared[kind], (baseline, variants[name]), stop_at, progress)
            rounds[name][kind] = yield from found
            if name not in [other for _, other in units[done + 1 :]]:
                know(name)
    for name in names:
        if rounds[name] and name not in costs:
            know(name)
    return costs


def _in_turns(view: _View, sides: tuple[_Variant, _Variant], stop_at: float, progress: Progress) -> Job[ArrayF64]:
    """(seeds, sides, 2) mean radiance and seconds, with as many seeds as there is time for.

    The first round is not counted: the first render of a scene builds it.
    """
    rounds: list[list[tuple[float, float]]] = []
    for seed in range(N_SEEDS + 1):
        found = {side: view.render(sides[side], seed) for side in ((0, 1) if seed % 2 else (1, 0))}
        rounds.append([found[0], found[1]])
        yield progress
        if len(rounds) > FEWEST_SEEDS and time.perf_counter() > stop_at:
            break
    return np.array(rounds[1:])


def _apart(shared: _View, baseline: _Variant, opened: Opened, variant: _Variant, progress: Progress) -> Job[ArrayF64]:
    """As `_in_turns`, one side after the other and in a scene of its own: by turns each render would build a scene."""
    sides = []
    with opened(variant) as own:
        for view, one in ((shared, baseline), (own, variant)):
            renders = []
            for seed in range(APART_SEEDS + 1):
                renders.append(view.render(one, seed))
                yield progress
            sides.append(renders[1:])
    return np.array(sides).swapaxes(0, 1)


def _variants(required: Mapping[str, Requirement], choices: Mapping[str, str]) -> dict[str, _Variant]:
    """The plan with one effect the other way round, for each effect that has settings of two kinds."""
    plan, variants = plan_effects(required, choices), {}
    for name, one in required.items():
        if one.on != one.off:
            # Nothing else is denoised, so that denoising itself is the one to add.
            is_on = name == "denoising" or plan[name].state == "off"
            switched = plan_effects(required, {**choices, name: "on" if is_on else "off"})
            variants[name] = _Variant(switched, is_on, denoise=name == "denoising")
    return variants


def _cost(rounds: Mapping[str, ArrayF64], *, has_effect: bool) -> EffectCost:
    """From the (seeds, sides, 2) of each kind; the sides are the plan and the variant."""
    on, off = (1, 0) if has_effect else (0, 1)
    n_seeds = min(map(len, rounds.values()))
    seconds = np.sum([found[:n_seeds, :, 1] for found in rounds.values()], axis=0)
    shares: ArrayF64 = seconds[:, on] / seconds[:, off] - 1
    changes = {kind: _change(found[:, on, 0], found[:, off, 0]) for kind, found in rounds.items()}
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
        yield _View(probe.scene, lambda cones: float(lights_of_cones([cones.astype(np.float32)])[0, 0].mean()))


@contextlib.contextmanager
def _picture(scene: bpy.types.Scene, variant: _Variant, frame: int) -> Iterator[_View]:
    settings = replace(PICTURE, denoise=variant.denoise, light_transport=cycles_settings(variant.plan))
    with open_scanner(scene, sized_for(scene, settings)) as scanner:
        scanner.scene.frame_set(frame)
        yield _View(scanner.scene, lambda radiance: float(radiance.mean()))
