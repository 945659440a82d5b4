"""Is the error budget right? Its three largest parts beside sessions that are rendered anew with that part perfect.

The budget makes parts perfect on captures that are there. Here each is made perfect in the scene itself, and all is
rendered again with another seed: the path, and the truth, a satin ball that is put into the room and path-traced from
six sides, with its normals. Errors are root mean squares over its surface, in per cent of its brightness.

    field of view   a camera that looks in six directions before every frame of the path
    coverage        a camera that does so at the object's position
    sensor          the perfect phone
    clipping        an exposure at which nothing of the path is clipped
    delay           no network, and an estimate in every frame
    order 2         the nine coefficients that fit the ball best are taken off it: the rest is what order 2 lacks
    sampling, network, hidden lamps    pictures from the object with another seed and four times the samples; with
                    hidden lamps visible to cameras and shades without a shadow hidden from them, and as they are: the
                    difference is added

What the ball shows is taken to order 8, as the budget's is: finer than that is mostly grain of a path-traced ball.

    python addon_tests/bench/error_budget.py OUT SCENE.blend... [--phone NAME] [--network NAME] [--step N] [--all]

In a scene without virtual objects a ball is put at the empty `placement_0`.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from xihe_blender.capture import all_around
from xihe_blender.capture.reference_probe import CONE
from xihe_blender.capture.render import RenderSettings, render_passes, stacked_rgb, working_scene
from xihe_blender.capture.scanner import leave_out_virtual_objects, phone_camera
from xihe_blender.io.budget_results import BudgetResults, ObjectBudget
from xihe_blender.io.exr import read_radiance
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.budget_chain import (
    EVERY_FRAME,
    SessionParts,
    exposure_without_clipping,
    lights_in_force,
    sights_of_path,
)
from xihe_blender.previs.error_budget import error_budget, lights_from_all_around
from xihe_blender.previs.path_renders import render_captures
from xihe_blender.previs.plan import Probe, plan_previs
from xihe_blender.previs.prepare import prepare_run, survey_run
from xihe_blender.previs.run_chain import phone_of_captures
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.sphere_rig import sphere_mesh
from xihe_blender.scene.state import scene_kept
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet.records import RgbdFrame
from xihenet.satin_ball import satin_factors
from xihenet.sh_basis import basis, per_coefficient

N_LOOKS = 7  # frames of the longer path for each of the real one: six directions, then the phone's own
BALL_RADIUS_M, BALL_SAMPLES = 0.002, 64
NEW_SEED = 1
ALL_ORDERS = 8
OF_PICTURES = ("sampling", "network", "hidden_lamps")
Prepare = Callable[[bpy.types.Scene, Probe], None]


@dataclass
class Case:
    """One object of one scene; `light_of` gives the light in force at its moments, {(position, frame): (9, 3)}."""

    file: Path
    out: Path
    settings: PrevisSettings
    budget: BudgetResults

    @property
    def item(self) -> ObjectBudget:
        return self.budget.objects[0]

    def light_of(
        self, name: str, settings: PrevisSettings, prepare: Prepare | None = None, n_looks: int = 1
    ) -> dict[tuple[str, int], np.ndarray]:
        """Of a session that is rendered anew, the scene changed by `prepare`, in scene radiance."""
        out = self.out / name
        shutil.rmtree(out, ignore_errors=True)
        scene = opened(self.file)
        settings = replace(settings, objects=(self.item.name,))
        probes = plan_previs(scene, settings).probes
        if prepare is not None:
            prepare(scene, probes[0])
        if n_looks > 1:
            settings = replace(settings, frames=tuple(longer(settings.frames, n_looks)))
        plan, outputs = plan_previs(scene, settings), RunOutputs(out)
        survey = survey_run(scene, plan, outputs)
        with scene_kept():
            run = run_blocking(prepare_run(scene, plan, survey, outputs, settings, load_estimators(settings)))
            run_blocking(render_captures(run))
        phone, found = phone_of_captures(run, {}), {}
        moments = {last_of(frame, n_looks): frame for frame in self.item.moments}
        parts = SessionParts(sights_of_path(run, phone), run.settings.trigger, phone.link_in_use, run.estimator, {})
        for probe in run.plan.probes:
            for frame, light in lights_in_force(run, probe, parts, list(moments)).items():
                found[probe.name, moments[frame]] = light.sh / run.exposure
        return found


def opened(file: Path) -> bpy.types.Scene:
    """The scene of `file`, with a ball at its first placement if it has no virtual object."""
    scene = open_blend(file)
    if not virtual_objects(scene):
        ball = bpy.data.objects.new("Ball", sphere_mesh("Ball", 0.06 / metres_per_unit(scene), 48, 24))
        ball.location = bpy.data.objects["placement_0"].matrix_world.translation
        virtual_collection(scene, create=True).objects.link(ball)
    return scene


# ------------------------------------------------------------------------------------------------------- longer paths


def last_of(frame: int, n_looks: int) -> int:
    """The frame of the longer path at which the phone looks as it does at `frame` of the real one."""
    return n_looks * frame


def longer(frames: tuple[int, ...] | None, n_looks: int) -> list[int]:
    assert frames is not None
    return [last_of(frame, n_looks) - n_looks + 1 + look for frame in frames for look in range(n_looks)]


def look_everywhere(scene: bpy.types.Scene, frames: tuple[int, ...], place_m: np.ndarray | None) -> None:
    """Six directions before each frame, from the phone's own place or from `place_m`; time goes as much slower."""
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
        for look in range(N_LOOKS):
            turned = pose.copy()
            if look < N_LOOKS - 1:
                turned[:3, :3] = all_around.view_rotation(look)
                turned[:3, 3] = pose[:3, 3] if place_m is None else place_m
            turned[:3, 3] /= metres_per_unit(scene)
            # Curves are read at the slower time; half a frame before, so that no rounding falls on the one before.
            at = (last_of(frame, N_LOOKS) - N_LOOKS + 1 + look - 0.5) / N_LOOKS
            camera.matrix_world = Matrix(turned.tolist())
            half_height = 1.0 if look < N_LOOKS - 1 else intrinsics.height / 2 / intrinsics.fy
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
    scene.frame_start, scene.frame_end = last_of(frames[0], N_LOOKS) - N_LOOKS, last_of(frames[-1], N_LOOKS)


# --------------------------------------------------------------------------------------------------------------- truth


def true_ball(case: Case, probe_m: np.ndarray, frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals (P, 3), what the ball shows there (P, 3) in scene radiance, and the weights (P,) of the pixels."""
    scene = opened(case.file)
    settings = RenderSettings((48, 48), BALL_SAMPLES, NEW_SEED, denoise=False)
    normals, shown, weights = [], [], []
    with working_scene(scene, "Ball", settings) as working:
        leave_out_virtual_objects(working, scene)
        metres = metres_per_unit(scene)
        mesh = sphere_mesh("Satin", BALL_RADIUS_M / metres, 256, 128)
        mesh.materials.append(satin_material())
        ball = bpy.data.objects.new("Satin", mesh)
        ball.location = tuple(probe_m / metres)
        for ray in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
            setattr(ball, f"visible_{ray}", False)
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
    material = bpy.data.materials.new("Satin")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    mix, output = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeOutputMaterial")
    matte, cone = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeBsdfToon")
    cone.component = "DIFFUSE"
    cone.inputs["Size"].default_value, cone.inputs["Smooth"].default_value = CONE, 0.0
    mix.inputs["Fac"].default_value = 0.5
    for place, shader in ((1, matte), (2, cone)):
        shader.inputs["Color"].default_value = (1, 1, 1, 1)
        tree.links.new(shader.outputs[0], mix.inputs[place])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return material


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


def rendered_anew(case: Case, part: str) -> dict[tuple[str, int], np.ndarray]:
    """The light in force with `part` perfect, "" none of them."""
    settings, frames = replace(case.settings, seed=NEW_SEED, exposure=case.budget.exposure), case.settings.frames
    assert frames is not None
    if part == "field_of_view":
        return case.light_of(part, settings, lambda scene, _: look_everywhere(scene, frames, None), N_LOOKS)
    if part == "coverage":

        def from_object(scene: bpy.types.Scene, probe: Probe) -> None:
            look_everywhere(scene, frames, probe.position_m)

        return case.light_of(part, settings, from_object, N_LOOKS)
    if part == "sensor":
        return case.light_of(part, replace(settings, phone="perfect", metering="highlights"))
    if part == "delay":
        return case.light_of(part, replace(settings, network=None, trigger=EVERY_FRAME))
    if part == "clipping":
        kept = RunOutputs(case.out / "budget")
        pictures = [read_radiance(kept.radiance("captured", frame)) for frame in case.budget.frames]
        return case.light_of(
            part, replace(settings, exposure=exposure_without_clipping(pictures, case.budget.exposure))
        )
    return case.light_of("as_it_was", settings)


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
    settings = RenderSettings(tuple(size), 4 * (case.settings.samples or 8), NEW_SEED)
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


def measure(case: Case, parts: list[str]) -> dict[str, float]:
    """The error as it was ("") and with each of `parts` perfect, in per cent of the ball's brightness."""
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
    scale = np.sqrt(np.mean(brightness))
    return {part: 100 * float(np.sqrt(np.mean(found)) / scale) for part, found in squares.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--phone", default="perfect")
    parser.add_argument("--network")
    parser.add_argument("--step", type=int, default=4)
    parser.add_argument("--all", action="store_true", help="all parts, not only the three largest")
    options = parser.parse_args()
    for file in options.scenes:
        scene, out = opened(file), options.out / file.stem
        settings = PrevisSettings(
            preset="draft", size=(128, 96), samples=8, phone=options.phone, network=options.network,
            frames=tuple(range(scene.frame_start, scene.frame_end + 1, options.step)),
        )  # fmt: skip
        name = virtual_objects(scene)[0].name
        settings = replace(settings, objects=(name,))
        budget = run_blocking(error_budget(scene, out / "budget", settings, blend_file=file))
        case = Case(file, out, settings, budget)
        chosen = [part.name for part in case.item.largest_first][: None if options.all else 3]
        anew = measure(case, chosen)
        now = 100 * case.item.relative(case.item.error or 0.0)
        print(f"{file.stem}, {name}: error {now:.1f} %, rendered anew {anew['']:.1f} %", flush=True)
        for part in case.item.largest_first[: len(chosen)]:
            gain = 100 * case.item.relative(part.gain)
            print(f"    {part.name:14} {gain:6.1f} {anew[''] - anew[part.name]:6.1f}", flush=True)


if __name__ == "__main__":
    main()
