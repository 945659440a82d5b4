"""A prepared run: what is settled before the first frame is captured, and stays as it is when the run is resumed.

The survey of the path, the exposure, the plan of effects and the numbers of samples. Each is worked out once
and kept in the run's folder, so that a resumed run does the same without looking at the scene again.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import bpy

from xihe_blender.apply.reflection_pictures import required_light
from xihe_blender.capture.reference_probe import ProbeSettings, ReferenceProbe, open_reference_probe
from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import meter_exposure
from xihe_blender.compare.methods import Comparer, OverRecording, open_comparer
from xihe_blender.io.json_records import Json, as_json
from xihe_blender.io.kept_files import kept_json, kept_or_done, kept_record
from xihe_blender.io.outputs import RunOutputs, write_json
from xihe_blender.jobs import Job, Progress, shown
from xihe_blender.light_transport import cycles_settings
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.light_transport.render_reuse import RenderReuse, each_its_own, plan_render_reuse
from xihe_blender.previs.plan import PrevisPlan, Probe, compared_frames
from xihe_blender.previs.sample_count import SampleCount, measure_sample_count
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.simulated_phone import CaptureNeeds, ChosenPhone, choose_phone
from xihe_blender.previs.survey import SceneSurvey, survey_path
from xihenet.effects import Effect, effects_as_json, effects_from_json, plan_effects
from xihenet.estimators import Estimator
from xihenet.io.json_files import read_json
from xihenet.trigger import TriggerSettings

NOISE_MARGIN = 1.5
"""By so much the change of a frame may exceed what the pilot saw: in a room of 48x36 pixels it did by 1.3, as colour is
encoded and the variance falls a little slower than 1/samples."""

PROBE_WORK, TRUTH_WORK, METHODS_WORK = 0.33, 0.75, 0.4
"""Of a reference light, whose pictures are of one size and number in most runs, and of a million samples of the ground
truth and of all methods, where a million samples of a capture are 1: measured in five scenes
(`addon_tests/bench/time_left.py`)."""

METHODS_WORK_WITH_SHADOWS = 1.6
"""The same of all methods where they have suns and shadow catchers: 28 s in place of 7 in `living_room`, Draft."""

FEW_LAYERS = 9
"""Objects times methods, each a view layer, up to which these hold: three each. From there on work rises with them: an
imported model of 68 parts takes minutes for each frame."""


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """All that is known of a run before its chain runs; the stages behind share it.

    `settings` are the user's, with the trigger's theta above the noise of captures and the light that objects call for;
    `estimators` the chosen one, then those that are compared with it. `needs` says what is captured, and kept beside
    captures; `reuse` in which earlier frame a render would come out the same. `has_truth` is false for a recording, of
    which no light probe and no ground truth can be rendered.
    """

    scene: bpy.types.Scene
    plan: PrevisPlan
    survey: SceneSurvey
    outputs: RunOutputs
    settings: PrevisSettings
    estimators: Sequence[Estimator]
    exposure: float
    effects: Mapping[str, Effect]
    sample_count: SampleCount
    phone: ChosenPhone
    needs: CaptureNeeds
    reuse: RenderReuse
    has_truth: bool = True

    def probes_in_view(self, frame: int) -> list[Probe]:
        """Those that the camera sees at `frame`; none if it is not captured."""
        seen = self.survey.frames[frame].in_view if frame in self.needs.delivered else ()
        return [probe for probe in self.plan.probes if probe.name in seen]

    def open_probes(self, places: Sequence[Probe]) -> contextlib.AbstractContextManager[ReferenceProbe]:
        """Light probes at `places`, lit as the objects are that these are of."""
        items = {item.name: item for item in self.plan.objects}
        objects = [items.get(place.object_name) for place in places]
        return open_reference_probe(self.scene, [place.position_m for place in places], self.reference, objects)

    def open_comparer(
        self, methods: Sequence[str], recording: OverRecording | None = None
    ) -> contextlib.AbstractContextManager[Comparer]:
        """Comparisons of `methods` on the virtual objects, with shadows where the run has them."""
        return open_comparer(
            self.scene, self.plan.objects, methods, self.comparison, has_key_light=self.settings.has_key_light,
            recording=recording,
        )  # fmt: skip

    @property
    def estimator(self) -> Estimator:
        return self.estimators[0]

    @property
    def methods(self) -> list[str]:
        """Names of the lights that are compared."""
        truth = ["truth"] * self.has_truth
        return list(dict.fromkeys([self.settings.estimator, *self.settings.others, "ambient", *truth]))

    @property
    def n_renders(self) -> dict[str, int]:
        """Captures and light probes, without those that an earlier frame has already, and comparisons."""
        active = [frame for frame in self.plan.frames if self.probes_in_view(frame)]
        return {
            "capture": sum(source == frame for frame, source in self.reuse.captures.items()),
            "probe": sum(source == frame for (frame, _), source in self.reuse.probes.items()),
            "comparison": len(compared_frames(active, self.settings.preset_values.comparison_step)),
        }

    @cached_property
    def work(self) -> dict[str, float]:
        """Units of work by stage, in order, as far as can be told from numbers of samples; see PROBE_WORK.

        Every step of a run asks for it, and it looks at all frames.
        """
        if not self.has_truth:
            return {"capture": 0.1 * len(self.plan.frames), "methods": float(len(self.plan.frames))}
        n, megapixels = self.n_renders, self.plan.size[0] * self.plan.size[1] / 1e6
        compared = n["comparison"] * megapixels * self.comparison.samples  # Samples, in millions.
        of_methods = METHODS_WORK_WITH_SHADOWS if self.settings.has_key_light else METHODS_WORK
        layers = max(1.0, len(self.plan.objects) * len(self.methods) / FEW_LAYERS)
        return {
            "capture": n["capture"] * megapixels * self.capture.samples,
            "reference light": n["probe"] * PROBE_WORK,
            "ground truth": TRUTH_WORK * compared,
            "methods": of_methods * layers * compared,
        }

    def progress(self, stage: str, done_share: float, doing: str) -> Progress:
        """That a share of `stage` is done, and all stages before it."""
        work = {name: max(units, 1e-9) for name, units in self.work.items()}
        left = dict(itertools.dropwhile(lambda entry: entry[0] != stage, work.items()))
        left[stage] *= 1 - done_share
        total = sum(work.values())
        return Progress(total - sum(left.values()), total, doing, left)

    @property
    def capture(self) -> RenderSettings:
        settings = self.settings.capture(self.plan.size, self.sample_count.capture_samples)
        return replace(settings, light_transport=cycles_settings(self.effects))

    @property
    def reference(self) -> ProbeSettings:
        return replace(self.settings.reference, light_transport=cycles_settings(self.effects))

    @property
    def comparison(self) -> RenderSettings:
        return replace(self.settings.comparison(self.plan.size), light_transport=cycles_settings(self.effects))


def survey_run(scene: bpy.types.Scene, plan: PrevisPlan, outputs: RunOutputs) -> Job[SceneSurvey]:
    """A job: the survey that an earlier part of this run has left in `outputs`, or a new one, not written there."""
    kept = kept_record(SceneSurvey, outputs.survey)
    if kept is not None and tuple(kept.frames) == tuple(plan.frames):
        return kept
    if outputs.survey.exists():
        outputs.survey.unlink()
    return (yield from survey_path(scene, plan))


def prepare_run(
    scene: bpy.types.Scene,
    plan: PrevisPlan,
    survey: SceneSurvey,
    outputs: RunOutputs,
    settings: PrevisSettings,
    loaded: Sequence[Estimator],
    *,
    has_truth: bool = True,
) -> Job[PreparedRun]:
    """A job: work out what an earlier part of this run has not left in `outputs`; `survey` is left there too.

    `loaded` are the estimators, as `load_estimators` has them. Of a recording, of which nothing is rendered and there
    is no truth, no samples are counted.
    """
    if not outputs.survey.exists():
        write_json(outputs.survey, as_json(survey))
    plan = survey.followed(plan)
    exposure = settings.exposure or kept_json(outputs.exposure, positive_exposure)
    if exposure is None:
        metering = meter_exposure(scene, plan.frames, settings.seed, metering=settings.metering_in_force)
        exposure = yield from shown(metering, Progress(0, 1, "metering the exposure"))
        write_json(outputs.exposure, {"exposure": exposure})
    choices = overrides_in_force(scene, settings.effect_choices)
    effects = kept_json(outputs.effects, partial(effects_kept, survey))
    if effects is None:
        write_json(outputs.effects, effects_as_json(plan_effects(survey.required, choices)))
        effects = effects_kept(survey, read_json(outputs.effects))
    count = SampleCount(0)
    if has_truth:
        measuring = measure_sample_count(scene, plan, survey, settings, exposure, cycles_settings(effects))
        told = shown(measuring, Progress(0, 1, "measuring how many samples it takes"))
        count = yield from kept_or_done(SampleCount, outputs.sample_count, told)
    light = required_light(plan.objects) if settings.light == "auto" else settings.light
    settings = replace(settings, light=light, trigger=above_noise(settings.trigger_in_use, count.capture_change))
    phone = choose_phone(scene, survey, settings)
    needs = phone.needs
    reuse = render_reuse(survey, effects, needs, has_truth=has_truth)
    return PreparedRun(
        scene, plan, survey, outputs, settings, loaded, exposure, effects, count, phone, needs, reuse, has_truth
    )


def render_reuse(
    survey: SceneSurvey, effects: Mapping[str, Effect], needs: CaptureNeeds, *, has_truth: bool = True
) -> RenderReuse:
    """Of a run that captures what `needs` asks for; each frame of a recording has a capture of its own."""
    is_reused = has_truth and effects["motion blur"].state != "on"
    states = survey.states if is_reused else each_its_own(survey.frames)
    in_view = {frame: one.in_view for frame, one in survey.frames.items() if frame in needs.captured}
    return plan_render_reuse(states, in_view, survey.moved)


def above_noise(trigger: TriggerSettings, capture_change: float | None) -> TriggerSettings:
    """`trigger` with its theta above what noise alone changes, where that was measured: variances add up.

    The paper's rule stays as it is, and what is to fire at any change.
    """
    if trigger.policy != "split" or trigger.theta == 0:
        return trigger
    return replace(trigger, theta=trigger.theta + NOISE_MARGIN * (capture_change or 0.0))


def positive_exposure(content: Json) -> float:
    """What a run keeps of its metering; ValueError where it is no exposure."""
    exposure = float(content["exposure"])
    if not 0 < exposure < math.inf:
        raise ValueError(f"exposure: expected a positive factor, got {exposure}")
    return exposure


def effects_kept(survey: SceneSurvey, content: Json) -> dict[str, Effect]:
    """The plan of effects that a run keeps; ValueError where it is not of the scene of `survey`."""
    effects = effects_from_json(content)
    if effects.keys() != survey.required.keys():
        raise ValueError(f"effects: expected {', '.join(survey.required)}, got {', '.join(map(str, effects))}")
    return effects
