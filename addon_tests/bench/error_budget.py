"""The error budget: is it right? Its three largest parts beside sessions rendered anew with that part perfect.

The budget makes parts perfect on captures that are there. Here each is made perfect in the scene itself, and all is
rendered again with another seed: the path, and the truth, a satin ball that is put into the room and path-traced from
six sides, with its normals. Errors are root mean squares over its surface, in per cent of its brightness.

    field of view   a camera that looks in six directions before each frame before which the budget looks around; the
                    room stands still meanwhile, and the phone sees with the flaws that it has in that frame: it is not
                    whirled around, which would shear its pictures and lose its track
    coverage        a camera that does so at the object's position, without flaws
    sensor          the perfect phone
    clipping        an exposure at which nothing of the path is clipped
    delay           no network, and an estimate in every frame
    order 2         the nine coefficients that fit the ball best are taken off it: the rest is what order 2 lacks
    sampling, network, hidden lamps    pictures from the object with another seed and four times the samples; with
                    hidden lamps visible to cameras and shades without a shadow hidden from them, and as they are: the
                    difference is added

What the ball shows is taken to order 8, as the budget's is: finer than that is mostly grain of a path-traced ball.

    python addon_tests/bench/error_budget.py OUT SCENE.blend... [--phone NAME] [--network NAME] [--step N]
        [--seeds N] [--anew N]

In a scene without virtual objects a ball is put at the empty `placement_0`. --seeds are those of the budget, --anew
those with which all is rendered anew.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import bpy
import numpy as np
from budget_order import largest, largest_that_are_certain, order_of, print_all, print_case
from given import given
from mathutils import Matrix

from xihe_blender.capture import all_around
from xihe_blender.capture.reference_probe import CONE
from xihe_blender.capture.render import RenderSettings, render_passes, stacked_rgb, working_scene
from xihe_blender.capture.scanner import phone_camera, working_room
from xihe_blender.io.blender_output import only_our_output
from xihe_blender.io.budget_results import BudgetResults, ObjectBudget
from xihe_blender.io.exr import read_radiance
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.props.surfaces import Shader
from xihe_blender.previs.budget_chain import (
    EVERY_FRAME,
    FROM_PATH,
    SessionParts,
    Sight,
    exposure_without_clipping,
    lights_in_use,
    sight,
    sights_of_path,
)
from xihe_blender.previs.error_budget import N_SEEDS, SeedErrors, error_budget, lights_from_all_around, over_seeds
from xihe_blender.previs.plan import Probe, plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run, survey_run
from xihe_blender.previs.run_chain import phone_of_captures, render_captures
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.previs.simulated_phone import SimulatedPhone
from xihe_blender.previs.survey import SceneSurvey
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.sphere_rig import sphere_mesh
from xihe_blender.scene.state import scene_kept, show_to_camera_alone
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet.io.recording import load_frame
from xihenet.records import RgbdFrame
from xihenet.satin_ball import satin_factors
from xihenet.sh_basis import basis, per_coefficient

N_LOOKS = 8  # frames of the longer path for each of the real one: none, six directions, then the phone's own
OWN_LOOK = N_LOOKS - 1
BALL_RADIUS_M, BALL_SAMPLES = 0.002, 64
FIRST_NEW_SEED = 101  # far from those of the budget
ALL_ORDERS = 8
OF_PICTURES = ("sampling", "network", "hidden_lamps")
Prepare = Callable[[bpy.types.Scene, Probe], tuple[int, ...]]
Place = Callable[[Probe], np.ndarray | None]
Lights = dict[tuple[str, int], np.ndarray]


@dataclass
class Session:
    """A session that was rendered anew, of the real path or a longer one."""

    run: PreparedRun
    phone: SimulatedPhone

    def parts(self, sights: list[Sight] | None = None) -> SessionParts:
        sights = sights_of_path(self.run, self.phone) if sights is None else sights
        return SessionParts(sights, self.run.settings.trigger_in_use, self.phone.link_in_use, self.run.estimator, {})


@dataclass
class Case:
    """One object of one scene; `light_of` gives the light in use at its moments, {(position, frame): (9, 3)}."""

    file: Path
    out: Path
    settings: PrevisSettings
    budget: BudgetResults
    seed: int = FIRST_NEW_SEED

    @property
    def item(self) -> ObjectBudget:
        return self.budget.objects[0]

    def rendered(self, name: str, settings: PrevisSettings, prepare: Prepare | None = None) -> Session:
        """A session of the scene as `prepare` changes it, which gives the frames of its path."""
        out = self.out / name
        shutil.rmtree(out, ignore_errors=True)
        scene = opened(self.file)
        settings = replace(settings, objects=(self.item.name,))
        if prepare is not None:
            settings = replace(settings, frames=prepare(scene, plan_previs(scene, settings).probes[0]))
        plan, outputs = plan_previs(scene, settings), RunOutputs(out)
        survey = run_blocking(survey_run(scene, plan, outputs))
        with scene_kept():
            run = run_blocking(prepare_run(scene, plan, survey, outputs, settings, load_estimators(settings)))
            run_blocking(render_captures(run))
        return Session(run, phone_of_captures(run))

    @cached_property
    def anew(self) -> PrevisSettings:
        return replace(self.settings, seed=self.seed, exposure=self.budget.exposure)

    @cached_property
    def as_it_was(self) -> Session:
        """The real path, with nothing perfect."""
        return self.rendered("as_it_was", self.anew)

    def light_of(self, session: Session) -> Lights:
        return self.lights(session.run, session.parts(), {frame: frame for frame in self.item.moments})

    def light_of_looks(self, name: str, place: Place, *, is_phones: bool) -> Lights:
        """With looks around from `place` before the frames of the budget, by the phone or by a perfect camera."""
        real, around = self.as_it_was, self.look_frames()
        frames = real.run.plan.frames

        def prepare(scene: bpy.types.Scene, probe: Probe) -> tuple[int, ...]:
            look_everywhere(scene, frames, place(probe))
            return longer(frames, around)

        long = self.rendered(name, self.anew, prepare).run
        run = replace(long, survey=seen_by_phone_alone(long.survey))
        parts = real.parts(list(sights_of_looks(run, real, is_phones=is_phones)))
        return self.lights(run, parts, {last_of(frame): frame for frame in self.item.moments})

    def lights(self, run: PreparedRun, parts: SessionParts, moments: dict[int, int]) -> Lights:
        """In scene radiance, by position and the frame of the real path that belongs to each of `moments`."""
        return {
            (probe.name, moments[frame]): light.sh / run.exposure
            for probe in run.plan.probes
            for frame, light in lights_in_use(run, probe, parts, list(moments)).items()
        }

    def look_frames(self) -> set[int]:
        """The frames before which the budget looks around."""
        kept = (self.out / "budget" / "work" / "around" / FROM_PATH / "0" / "work").glob("capture_*.exr")
        return {int(file.stem.split("_")[1]) for file in kept}


def opened(file: Path) -> bpy.types.Scene:
    """The scene of `file`, with a ball at its first placement if it has no virtual object."""
    scene = open_blend(file)
    if not virtual_objects(scene):
        ball = bpy.data.objects.new("Ball", sphere_mesh("Ball", 0.06 / metres_per_unit(scene), 48, 24))
        ball.location = bpy.data.objects["placement_0"].matrix_world.translation
        virtual_collection(scene, create=True).objects.link(ball)
    return scene


# ------------------------------------------------------------------------------------------------------- longer paths


def last_of(frame: int) -> int:
    """The frame of the longer path at which the phone looks as it does at `frame` of the real one."""
    return N_LOOKS * frame + OWN_LOOK


def longer(frames: Iterable[int], around: set[int]) -> tuple[int, ...]:
    """With six looks before each of `frames` that is one of `around`."""
    looks = ((range(1, OWN_LOOK) if frame in around else (), frame) for frame in frames)
    return tuple(n for some, frame in looks for n in (*(N_LOOKS * frame + look for look in some), last_of(frame)))


def seen_by_phone_alone(survey: SceneSurvey) -> SceneSurvey:
    """`survey` of a longer path without estimates in frames that are looks around, whatever is in view there."""
    frames = {
        frame: one if frame % N_LOOKS == OWN_LOOK else replace(one, in_view=()) for frame, one in survey.frames.items()
    }
    return replace(survey, frames=frames)


@dataclass(frozen=True)
class OutputsOfFrame(RunOutputs):
    """The outputs of a longer path, where the phone asks for what stands beside a capture of the real one."""

    number: int = 0

    def surfaces(self, frame: int) -> Path:
        return RunOutputs(self.folder).surfaces(self.number)

    def radiance(self, method: str, frame: int) -> Path:
        return RunOutputs(self.folder).radiance(method, self.number)


def sights_of_looks(run: PreparedRun, real: Session, *, is_phones: bool) -> Iterator[Sight]:
    """What the phone of the `real` path sees of the longer one of `run`, with its flaws of the same moment."""
    for number in run.plan.frames:
        captured, frame = load_frame(run.outputs.capture(number)), number // N_LOOKS
        seen = captured
        if is_phones or number % N_LOOKS == OWN_LOOK:
            as_real = replace(captured, frame=frame, time_s=real.run.survey.frames[frame].time_s)
            seen, _ = real.phone.see(as_real, OutputsOfFrame(run.outputs.folder, number=number))
        yield sight(replace(seen, frame=number, time_s=captured.time_s), run.exposure)


def look_everywhere(scene: bpy.types.Scene, frames: Iterable[int], place_m: np.ndarray | None) -> None:
    """Six directions before each frame, from the phone's own place or from `place_m`; the room stands still meanwhile.

    Time goes N_LOOKS times slower. Each curve keeps the value that it has at a frame until the next one.
    """
    for curve in (curve for action in bpy.data.actions for curve in action.fcurves):
        curve.modifiers.new("STEPPED").frame_step = 1.0
    data = bpy.data.cameras.new("Looks")
    data.sensor_fit, data.sensor_height, data.clip_start = "VERTICAL", 24.0, all_around.CLIP_START_M
    camera = bpy.data.objects.new("Looks", data)
    scene.collection.objects.link(camera)
    poses = {}
    with working_scene(
        scene, "Poses", RenderSettings((scene.render.resolution_x, scene.render.resolution_y), 1)
    ) as copy:
        for frame in frames:
            copy.frame_set(frame)
            poses[frame] = phone_camera(copy)
    scene.timeline_markers.clear()
    scene.camera = camera
    for frame, (intrinsics, pose) in poses.items():
        for look in range(1, N_LOOKS):
            turned = pose.copy()
            if look < OWN_LOOK:
                turned[:3, :3] = all_around.view_rotation(look - 1)
                turned[:3, 3] = pose[:3, 3] if place_m is None else place_m
            turned[:3, 3] /= metres_per_unit(scene)
            # Curves are read at the slower time; half a frame before, so that no rounding falls on the one before.
            at = frame + (look - 0.5) / N_LOOKS
            camera.matrix_world = Matrix(turned.tolist())
            half_height = 1.0 if look < OWN_LOOK else intrinsics.height / 2 / intrinsics.fy
            data.lens = 12.0 / half_height
            camera.keyframe_insert("location", frame=at)
            camera.keyframe_insert("rotation_euler", frame=at)
            data.keyframe_insert("lens", frame=at)
    for owner in (camera, data):
        for curve in owner.animation_data.action.fcurves:
            for point in curve.keyframe_points:
                point.interpolation = "CONSTANT"
    scene.render.frame_map_old, scene.render.frame_map_new = 100, 100 * N_LOOKS
    scene.render.fps *= N_LOOKS
    scene.frame_start, scene.frame_end = N_LOOKS * frames[0], last_of(frames[-1])


# --------------------------------------------------------------------------------------------------------------- truth


def true_ball(case: Case, probe_m: np.ndarray, frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals (P, 3), what the ball shows there (P, 3) in scene radiance, and the weights (P,) of the pixels."""
    scene = opened(case.file)
    settings = RenderSettings((48, 48), BALL_SAMPLES, case.seed, denoise=False)
    normals, shown, weights = [], [], []
    with working_room(scene, "Ball", settings) as working:
        metres = metres_per_unit(scene)
        mesh = sphere_mesh("Satin", BALL_RADIUS_M / metres, 256, 128)
        mesh.materials.append(satin_material())
        ball = bpy.data.objects.new("Satin", mesh)
        ball.location = tuple(probe_m / metres)
        show_to_camera_alone(ball)
        data = bpy.data.cameras.new("Ball")
        data.type, data.ortho_scale, data.clip_start = "ORTHO", 2.1 * BALL_RADIUS_M / metres, BALL_RADIUS_M / metres
        camera = bpy.data.objects.new("Ball", data)
        for one in (ball, camera):
            working.collection.objects.link(one)
        working.timeline_markers.clear()
        working.view_layers[0].use_pass_normal = True
        working.camera = camera
        working.frame_set(frame)
        for view in range(all_around.N_VIEWS):
            pose = np.eye(4)
            pose[:3, :3] = all_around.view_rotation(view)
            pose[:3, 3] = (probe_m - 2.5 * BALL_RADIUS_M * -pose[:3, 2]) / metres
            camera.matrix_world = Matrix(pose.tolist())
            passes = render_passes(working).passes
            normal = np.stack([passes[f"Normal.{axis}"] for axis in "XYZ"], axis=-1).reshape(-1, 3).astype(float)
            facing = normal @ pose[:3, 2]
            # Each normal from the side that it faces most, as far as its pixel lies wholly on the ball.
            is_ball = (passes["Depth.Z"].ravel() < 3 * BALL_RADIUS_M) & (np.linalg.norm(normal, axis=1) > 0.99)
            is_own = is_ball & (facing >= np.abs(normal).max(axis=1) - 1e-6)
            normals.append(normal[is_own])
            shown.append(stacked_rgb(passes).reshape(-1, 3)[is_own].astype(float))
            weights.append(1 / facing[is_own])
        bpy.data.meshes.remove(mesh)
        bpy.data.cameras.remove(data)
    weight = np.concatenate(weights)
    return np.concatenate(normals), np.concatenate(shown), weight / weight.sum()


def satin_material() -> bpy.types.Material:
    satin, white = Shader("Satin"), {"Color": (1.0, 1.0, 1.0)}
    matte = satin.add("BsdfDiffuse", white)
    cone = satin.add("BsdfToon", {**white, "Size": CONE, "Smooth": 0.0}, component="DIFFUSE")
    mixed = satin.add("MixShader", {0: 0.5, 1: matte.outputs[0], 2: cone.outputs[0]})
    satin.set(satin.output, {"Surface": mixed.outputs[0]})
    return satin.material


def under(light: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(P, 3) what the ball shows under a light (9, 3)."""
    return basis(normals, 2) @ (light * per_coefficient(satin_factors(2))[:, None])


def fit(normals: np.ndarray, shown: np.ndarray, weights: np.ndarray, order: int) -> np.ndarray:
    """(P, 3) the harmonics up to `order` that come closest to what is shown."""
    table, root = basis(normals, order), np.sqrt(weights)[:, None]
    found: np.ndarray = table @ np.linalg.lstsq(table * root, shown * root, rcond=None)[0]
    return found


def mean_square(values: np.ndarray, weights: np.ndarray) -> float:
    return float((np.square(values).mean(axis=1) * weights).sum())


# --------------------------------------------------------------------------------------------------------------- parts


def rendered_anew(case: Case, part: str) -> Lights:
    """The light in use with `part` perfect, "" none of them."""
    if part == "field_of_view":
        return case.light_of_looks(part, lambda _: None, is_phones=True)
    if part == "coverage":
        return case.light_of_looks(part, lambda probe: probe.position_m, is_phones=False)
    if part == "sensor":
        return case.light_of(case.rendered(part, replace(case.anew, phone="perfect", metering="highlights")))
    if part == "delay":
        return case.light_of(case.rendered(part, replace(case.anew, network=None, trigger=EVERY_FRAME)))
    if part == "clipping":
        kept = RunOutputs(case.out / "budget")
        pictures = [read_radiance(kept.radiance("captured", frame)) for frame in case.budget.frames]
        exposure = exposure_without_clipping(pictures, case.budget.exposure)
        return case.light_of(case.rendered(part, replace(case.anew, exposure=exposure)))
    return case.light_of(case.as_it_was)


def show_lamps(scene: bpy.types.Scene) -> None:
    """To cameras, and what would hide them there but casts no shadow on the object not."""
    for item in scene.objects:
        if item.type == "LIGHT":
            item.visible_camera = True
        elif not item.visible_shadow:
            item.visible_camera = False


def of_pictures(case: Case, part: str, light: np.ndarray, position_m: np.ndarray, frame: int) -> np.ndarray:
    """`light` with `part` perfect, by new pictures from the object, of more samples.

    Of as many pixels: what the nearest point in each direction makes of a picture depends on how fine it is.
    """
    scene, size = opened(case.file), case.budget.settings["size"]
    settings = RenderSettings(tuple(size), 4 * (case.settings.samples or 8), case.seed)
    exposure = case.budget.exposure

    def look() -> list[tuple[RgbdFrame, np.ndarray]]:
        with all_around.open_all_around(scene, settings, exposure=exposure, with_surfaces=False) as around:
            around.scanner.scene.frame_set(frame)
            return [around.look(view, position_m) for view in range(all_around.N_VIEWS)]

    views = look()
    if part == "hidden_lamps":
        show_lamps(scene)
        return light + all_around.light_of_views(look()) - all_around.light_of_views(views)
    estimator, seen = load_estimators(case.settings)[0], all_around.light_of_views(views)
    nearest, means = (
        one / case.budget.exposure for one in lights_from_all_around(estimator, views, case.budget.exposure)
    )
    return light + (means - nearest if part == "sampling" else seen - means)


def measure(case: Case, parts: Iterable[str]) -> SeedErrors:
    """The errors as they were and with each of `parts` perfect, in scene radiance."""
    scene = opened(case.file)
    probes = {
        probe.name: probe for probe in plan_previs(scene, replace(case.settings, objects=(case.item.name,))).probes
    }
    lights = {"": rendered_anew(case, "")}
    for part in parts:
        lights[part] = lights[""] if part in ("order_2", *OF_PICTURES) else rendered_anew(case, part)
    squares: dict[str, list[float]] = {part: [] for part in lights}
    brightness = []
    for (name, frame), _ in lights[""].items():
        position_m = probes[name].at(frame)
        normals, shown, weights = true_ball(case, position_m, frame)
        fitted, shown = fit(normals, shown, weights, 2), fit(normals, shown, weights, ALL_ORDERS)
        brightness.append(mean_square(shown, weights))
        for part, found in lights.items():
            light = found[name, frame]
            if part in OF_PICTURES:
                light = of_pictures(case, part, light, position_m, frame)
            truth = fitted if part == "order_2" else shown
            squares[part].append(mean_square(truth - under(light, normals), weights))
    errors = {part: float(np.sqrt(np.mean(found))) for part, found in squares.items()}
    return SeedErrors(float(np.sqrt(np.mean(brightness))), errors.pop(""), None, errors)


def main() -> None:
    options = given(__doc__, "out", "scenes+", phone="perfect", network=(str, None), step=4, seeds=N_SEEDS, anew=1)
    orders = []
    for file in options.scenes:
        scene, out = opened(file), options.out / file.stem
        settings = PrevisSettings(
            preset="draft", size=(128, 96), samples=8, phone=options.phone, network=options.network,
            frames=tuple(range(scene.frame_start, scene.frame_end + 1, options.step)),
        )  # fmt: skip
        name = virtual_objects(scene)[0].name
        settings = replace(settings, objects=(name,))
        budget = run_blocking(error_budget(scene, out / "budget", settings, n_seeds=options.seeds, blend_file=file))
        (item,) = budget.objects
        names = list(dict.fromkeys(part.name for part in (*largest(item), *largest_that_are_certain(item))))
        cases = [Case(file, out, settings, budget, FIRST_NEW_SEED + number) for number in range(options.anew)]
        anew = over_seeds(item.name, item.moments, [measure(case, names) for case in cases])
        orders.append(order_of(item, anew))
        print_case(file.stem, item, anew, orders[-1])
    print_all(orders)


if __name__ == "__main__":
    with only_our_output():
        main()
