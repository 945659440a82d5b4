"""The main job: what would a phone on this camera path believe about the light, and how would its objects look?

    camera path -> capture -> unproject -> sample -> merge -> trigger -> encode -> estimate -> apply -> compare

`previs` is a generator that yields progress and returns the results; see `jobs`. It first walks the path: each frame in
which an estimation position is visible is captured, gets its light probes rendered and goes through the controller.
Then it applies the light to the scene's timeline, compares pictures, and writes results and report.

What was rendered is kept in the run's folder, file by file. A run that was stopped goes on from there; the cheap stages
are simply done again, so a resumed run has the numbers of an undisturbed one.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender import results
from xihe_blender.capture import CyclesScanner, meter_exposure, open_scanner
from xihe_blender.compare import Comparer, Comparison, display, error_map, measure, open_comparer
from xihe_blender.exr import read_radiance, write_radiance
from xihe_blender.jobs import Job, Progress
from xihe_blender.lit_blend import apply_lights, save_lit_blend
from xihe_blender.outputs import RunOutputs, write_json, written_whole
from xihe_blender.plan import PrevisPlan, Probe, plan_previs
from xihe_blender.previs_settings import PrevisSettings, load_estimator
from xihe_blender.report import write_report
from xihe_blender.run_folder import claim_folder
from xihe_blender.scene_state import scene_kept
from xihe_blender.truth import LightProbe, open_light_probe, probe_radiance_sh
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import ControllerSettings, XiheController
from xihenet.estimators import EstimateContext, Estimator
from xihenet.metrics import shc_rmse
from xihenet.png import write_png
from xihenet.recording import load_frame, save_frame
from xihenet.records import ArrayF64, ArrayU8, RgbdFrame, StepReport, UnitSphereCloud


def previs(
    scene: bpy.types.Scene, out: Path, settings: PrevisSettings, *, blend_file: Path | None = None, command: str = ""
) -> Job[dict[str, Any]]:
    """Run the chain on `scene` and leave results.json, report.html, pictures and a lit .blend in the folder `out`.

    Parameters
    ----------
    scene : with a camera path and virtual objects; stays as it is, but for worlds and markers named "Xihe ..."
    out : folder of the run, made if needed. The same run is resumed; ValueError-like mistakes are UserError
    settings : what to do
    blend_file : where the scene comes from, for the results; None takes the open file
    command : what the user typed, for the report

    Returns
    -------
    the content of results.json
    """
    plan = plan_previs(scene, settings)
    estimator = load_estimator(settings)
    file = blend_file or Path(bpy.data.filepath or "untitled.blend")
    outputs = RunOutputs(out, file.stem)
    finished = claim_folder(outputs, scene, file, settings, plan)
    if finished is not None:
        yield Progress(1, 1, f"this run is already done; delete {out} to do it again")
        return finished
    with scene_kept():
        yield Progress(0, 1, "metering the exposure")
        exposure = _session_exposure(scene, plan, outputs, settings)
        run = _Run(scene, plan, outputs, settings, exposure, estimator)
        yield from run.walk()
        yield from run.compare()
    yield Progress(run.total, run.total, "applying the light and writing the report")
    estimated = {frame: methods[settings.estimator] for frame, methods in run.lights.items()}
    apply_lights(scene, plan, run.frames, estimated, exposure)
    save_lit_blend(scene, plan, outputs.lit_blend)
    content = results.assemble(scene, file, plan, settings, exposure, run.frames, command=command)
    # The results come last: their presence says that the run is done.
    write_report(content, outputs)
    write_json(outputs.results, content)
    return content


def _session_exposure(scene: bpy.types.Scene, plan: PrevisPlan, outputs: RunOutputs, settings: PrevisSettings) -> float:
    """The exposure that the user gave, that an earlier part of this run metered, or that is metered now."""
    if settings.exposure is not None:
        return settings.exposure
    if not outputs.exposure.exists():
        write_json(outputs.exposure, {"exposure": meter_exposure(scene, plan.frames, settings.seed)})
    return float(json.loads(outputs.exposure.read_text(encoding="utf-8"))["exposure"])


@dataclass
class _Run:
    """The state of one run while it is under way."""

    scene: bpy.types.Scene
    plan: PrevisPlan
    outputs: RunOutputs
    settings: PrevisSettings
    exposure: float
    estimator: Estimator
    frames: list[dict[str, Any]] = field(default_factory=list)
    lights: dict[int, dict[str, dict[str, ArrayF64]]] = field(default_factory=dict)
    """By compared frame, method and virtual object."""

    def __post_init__(self) -> None:
        chain = ControllerSettings(self.settings.trigger, reference_exposure=self.exposure)
        self.controller = XiheController(LocalBackend(self.estimator), chain)
        self.ambient = estimators.load("ambient", self.settings.n_anchors, self.settings.target)
        for probe in self.plan.probes:
            self.controller.add_position(probe.name, probe.position_m)
        self.unseen = UnitSphereCloud.empty(self.settings.n_anchors)
        self.truths: dict[str, dict[str, ArrayF64]] = {}
        """The last rendered truth of each probe, by target."""

    @property
    def methods(self) -> list[str]:
        return list(dict.fromkeys([self.settings.estimator, "ambient", "truth"]))

    @property
    def total(self) -> int:
        """Units of work for the progress: a frame to capture is one, a frame to compare three."""
        return len(self.plan.frames) + 3 * len(range(0, len(self.plan.frames), self.settings.effort.comparison_step))

    def walk(self) -> Iterator[Progress]:
        """Capture the path and run the chain on it."""
        capture = self.settings.capture(self.plan.size)
        with (
            open_scanner(self.scene, capture) as scanner,
            open_light_probe(self.scene, self.settings.truth()) as light_probe,
        ):
            scanner.exposure = self.exposure
            for done, frame in enumerate(self.plan.frames):
                yield Progress(done, self.total, f"capturing frame {frame}")
                self.frames.append(self._walk_frame(frame, scanner, light_probe))

    def _walk_frame(self, frame: int, scanner: CyclesScanner, light_probe: LightProbe) -> dict[str, Any]:
        start = time.perf_counter()
        intrinsics, world_from_camera = scanner.move_to(frame)
        active = self.controller.active(intrinsics, world_from_camera)
        if not active:
            return results.inactive_frame(frame, scanner.time_s)
        seen = [(place, probe) for place, probe in enumerate(self.plan.probes) if probe.name in active]
        captured, panoramas, render_s = self._rendered(frame, scanner, light_probe, seen)
        for name, panorama in panoramas.items():
            self.truths[name] = {t: probe_radiance_sh(panorama, self.exposure, t) for t in ("ldr", "hdr")}
        truth = {name: self.truths[name][self.settings.target] for name in active}
        steps = self.controller.step(captured, truth)
        ambient_sh = self.ambient.estimate(self.unseen, EstimateContext(frame=captured))
        self.lights[frame] = self._lights_in_force(ambient_sh)
        probes = [self._probe_entry(probe, steps[probe.name], ambient_sh) for _, probe in seen]
        work_s = time.perf_counter() - start - render_s
        return results.active_frame(captured, steps, probes, render_s, work_s)

    def _rendered(
        self, frame: int, scanner: CyclesScanner, light_probe: LightProbe, seen: list[tuple[int, Probe]]
    ) -> tuple[RgbdFrame, dict[str, Any], float]:
        """The capture and the panorama of each probe in view: read if an earlier run kept them, else rendered."""
        outputs = self.outputs
        files = {probe.name: outputs.probe(place, probe.name, frame) for place, probe in seen}
        if outputs.times(frame).exists():
            render_s = float(json.loads(outputs.times(frame).read_text(encoding="utf-8"))["render_s"])
            return load_frame(outputs.capture(frame)), {n: read_radiance(f) for n, f in files.items()}, render_s
        captured = scanner.acquire_environment_scan()
        render_s = scanner.render_s
        panoramas = {}
        for _, probe in seen:
            panoramas[probe.name] = light_probe.panorama(probe.position_m, frame)
            render_s += light_probe.render_s
            write_radiance(files[probe.name], panoramas[probe.name])
        save_frame(outputs.capture(frame), captured)
        self._write_picture("captured", frame, captured.srgb_u8)
        write_json(outputs.times(frame), {"render_s": render_s})
        return captured, panoramas, render_s

    def _lights_in_force(self, ambient_sh: ArrayF64) -> dict[str, dict[str, ArrayF64]]:
        """Light of every method on every virtual object: the mean over the object's estimation positions.

        Truth here is the whole light, not clipped, whatever the target: it shows what order 2 can do in the picture.
        A position that was never in view has no light of its own yet and gets the ambient one.
        """
        estimated, truth = {}, {}
        for item in self.plan.objects:
            names = [probe.name for probe in self.plan.probes_of(item.name)]
            estimated[item.name] = np.mean([self._light(name, ambient_sh) for name in names], axis=0)
            truth[item.name] = np.mean([self.truths.get(n, {}).get("hdr", ambient_sh) for n in names], axis=0)
        ambient = {item.name: ambient_sh for item in self.plan.objects}
        return {self.settings.estimator: estimated, "ambient": ambient, "truth": truth}

    def _light(self, probe_name: str, ambient_sh: ArrayF64) -> ArrayF64:
        """The light in force at a position: its last valid estimate, the ambient one until there is any."""
        estimate = self.controller.light(probe_name)
        return ambient_sh if estimate is None else estimate.sh_radiance

    def _probe_entry(self, probe: Probe, step: StepReport, ambient_sh: ArrayF64) -> dict[str, Any]:
        light, truth = self._light(probe.name, ambient_sh), self.truths[probe.name][self.settings.target]
        entry = results.probe_entry(probe, step, light, truth)
        return entry | {"ambient_shc_rmse": shc_rmse(ambient_sh, truth)}

    def compare(self) -> Iterator[Progress]:
        """Render ground truth and methods at every n-th active frame, and at the last."""
        active = [entry for entry in self.frames if entry["active"]]
        chosen = active[:: self.settings.effort.comparison_step]
        if active and chosen[-1] is not active[-1]:
            chosen.append(active[-1])
        done = len(self.plan.frames)
        comparison = self.settings.comparison(self.plan.size)
        with contextlib.ExitStack() as stack:
            comparer = None
            for entry in chosen:
                yield Progress(done, max(self.total, done + 3), f"comparing frame {entry['frame']}")
                if not self.outputs.compared(entry["frame"]).exists():
                    if comparer is None:
                        opened = open_comparer(self.scene, self.plan.objects, self.methods, comparison)
                        comparer = stack.enter_context(opened)
                    self._compare_frame(entry["frame"], comparer)
                entry |= json.loads(self.outputs.compared(entry["frame"]).read_text(encoding="utf-8"))
                done += 3

    def _compare_frame(self, frame: int, comparer: Comparer) -> None:
        compared = comparer.render_comparison(load_frame(self.outputs.capture(frame)), self.lights[frame])
        pictures = self._write_pictures(frame, compared)
        metrics = {
            name: measure(picture, compared.ground_truth, compared.weights)
            for name, picture in compared.methods.items()
        }
        content = {"pictures": pictures, "comparison": metrics, "comparison_render_s": compared.render_s}
        write_json(self.outputs.compared(frame), content)

    def _write_pictures(self, frame: int, compared: Comparison) -> dict[str, str]:
        shown = {"ground_truth": compared.ground_truth, **compared.methods}
        files = {"captured": self.outputs.relative(self.outputs.picture("captured", frame))}
        for kind, picture in shown.items():
            write_radiance(self.outputs.radiance(kind, frame), (picture / self.exposure).astype(np.float32))
            files[kind] = self._write_picture(kind, frame, display(picture))
        for method, picture in compared.methods.items():
            errors = error_map(picture, compared.ground_truth, compared.weights)
            files[f"error_{method}"] = self._write_picture(f"error_{method}", frame, errors)
        return files

    def _write_picture(self, kind: str, frame: int, picture: ArrayF64 | ArrayU8) -> str:
        """Write uint8, or floats in [0, 1], as sRGB; the path as results name it."""
        pixels = picture if picture.dtype == np.uint8 else np.rint(picture * 255).astype(np.uint8)
        path = self.outputs.picture(kind, frame)
        with written_whole(path) as beside:
            write_png(beside, pixels)
        return self.outputs.relative(path)
