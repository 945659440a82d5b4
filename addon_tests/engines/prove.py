"""Exported light: is it right in the engines? A white sphere in each of them, beside the same light in Cycles.

    make prove-exports                                   # or, once the packages are there:
    python addon_tests/engines/prove.py OUT [--engines three,filament]

Needs node, `npm install --no-package-lock` in this folder, and a Chromium: `chromium` on the path, or the one that
$CHROMIUM names. What an engine takes is written by `xihenet.light.exports`, read by the engine's page here, and drawn
without tone mapping from the front and from the back. The error is the mean difference from Cycles over the sphere,
relative to the mean of Cycles. Where an engine clamps what is below black, Cycles is clamped as well. Engines that take
pictures are held against the picture that was exported, in Cycles.

An app of three.js in an emulated WebXR session gets two lights as `webxr_replay.js` gives them.

Then the lights are exported wrong on purpose, and each of these mistakes must be seen in every engine.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.apply.key_suns import apply_key_to_sun, make_key_sun
from xihe_blender.apply.sh_worlds import apply_sh_to_world, make_sh_world
from xihe_blender.capture.render import RenderSettings, render_passes, stacked_rgb, working_scene
from xihenet.light.environments import HEIGHT, encode_hdr, environment_picture, laid_out
from xihenet.light.exports import NamedLight, export_files
from xihenet.light.key_light import rest_of, sh_of_key_light
from xihenet.light.platforms import PLATFORMS
from xihenet.panorama import evaluate_panorama, panorama_directions
from xihenet.records import ArrayF64, KeyLight, ObjectLight

HERE = Path(__file__).parent
ENGINES = ("three", "babylon", "gltf", "filament", "playcanvas", "model-viewer")
BOUND = 0.02
BOUNDS = {"model-viewer": 0.05}
EXCEPTIONS = {("model-viewer", "below_zero"): 0.08}
"""model-viewer blurs the picture by the lobe of a rough surface, which is not quite that of a matt one."""

CLAMPS = {"babylon", "gltf", "filament"}
"""Engines in which a surface that sends back less than nothing is black."""

SIDE = 64
SAMPLES = 256
GLOSSY = {"mirror": 0.0, "rough": 0.56, "rougher": 0.85}
"""Roughness of metal under a glTF file."""

MIDDLE = 0.7
"""Of the radius of a metal sphere, within which its reflection is held against the lobe along the normal."""

WEBXR_OFF = 1e-5
"""Its numbers are float32."""

RIM = 0.95
"""Of the sphere's radius: pixels beyond are at its edge."""

VIEWS = ("front", "back")


def lights_to_prove() -> dict[str, ObjectLight]:
    """Constant light, one from each side, each basis function, one that rings below zero, and three estimates."""
    lights = {"constant": ObjectLight(_grey(0.7))}
    for axis in range(3):
        for sign in (1, -1):
            direction = np.eye(3)[axis] * sign
            lamp = KeyLight(direction, np.array([1.2, 1.0, 0.8]), 0.1, True)
            lights[f"{'-+'[sign > 0]}{'xyz'[axis]}"] = ObjectLight(sh_of_key_light(lamp) + _grey(0.2))
    for index in range(1, 9):
        one = _grey(0.5)
        one[index] = 0.45, 0.3, -0.4
        lights[f"basis_{index}"] = ObjectLight(one)
    ringing = sh_of_key_light(KeyLight(np.array([0.48, -0.6, 0.64]), np.full(3, 1.5), 0.02, True))
    lights["below_zero"] = ObjectLight(ringing - _grey(0.15))
    for name, estimate in json.loads((HERE / "estimates.json").read_text()).items():
        light = ObjectLight(np.array(estimate["sh"]))
        lights[name] = light
        if estimate["key"] is not None:
            # A main light is a point in the engines: Cycles has no penumbra either.
            key = {part: np.array(value) for part, value in estimate["key"].items()} | {"angular_radius": 1e-3}
            lights[f"{name}_key"] = replace(light, key=KeyLight(**key, is_seen=True))
    return lights


def _grey(radiance: float) -> ArrayF64:
    return np.eye(9)[0][:, None] * np.full(3, radiance * np.sqrt(4 * np.pi))


# ------------------------------------------------------------------------------------------------------------ Cycles


@contextmanager
def sphere_in_cycles() -> Iterator[Callable[[ObjectLight, ArrayF64 | None], dict[str, ArrayF64]]]:
    """A function of a light, or of a panorama laid out as Blender's, that draws the sphere in both views."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=256, ring_count=128, radius=1)
    bpy.ops.object.shade_smooth()
    white = bpy.data.materials.new("White")
    white.use_nodes = True
    nodes = white.node_tree.nodes
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    white.node_tree.links.new(diffuse.outputs[0], output.inputs[0])
    bpy.context.object.data.materials.append(white)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2.0
    sun = make_key_sun("Key")
    for item in (camera, sun):
        scene.collection.objects.link(item)
    scene.camera = camera
    worlds = {"sh": make_sh_world("Light"), "picture": _picture_world()}

    def drawn(light: ObjectLight, panorama: ArrayF64 | None) -> dict[str, ArrayF64]:
        scene.world = worlds["sh" if panorama is None else "picture"]
        if panorama is None:
            apply_sh_to_world(scene.world, rest_of(light))
        else:
            _show(scene.world, panorama)
        apply_key_to_sun(sun, light.key)
        pictures = {}
        for view in VIEWS:
            camera.location = (0, -5 if view == "front" else 5, 0)
            camera.rotation_euler = (np.pi / 2, 0, 0 if view == "front" else np.pi)
            with working_scene(scene, "Sphere", RenderSettings((SIDE, SIDE), SAMPLES, denoise=False)) as working:
                pictures[view] = stacked_rgb(render_passes(working).passes).astype(np.float64)
        return pictures

    yield drawn


def _picture_world() -> bpy.types.World:
    world = bpy.data.worlds.new("Picture")
    world.use_nodes = True
    tree = world.node_tree
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    tree.links.new(texture.outputs[0], tree.nodes["Background"].inputs[0])
    return world


def _show(world: bpy.types.World, panorama: ArrayF64) -> None:
    height, width = panorama.shape[:2]
    image = bpy.data.images.new("Panorama", width, height, float_buffer=True)
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = laid_out(panorama, "+X")
    image.pixels.foreach_set(rgba[::-1].ravel())
    image.update()
    world.node_tree.nodes["Environment Texture"].image = image


# ----------------------------------------------------------------------------------------------------------- engines


def browser_of_engines() -> str:
    """The Chromium that draws. SystemExit, in one line, where it, node or an engine is missing."""
    browser = shutil.which(os.environ.get("CHROMIUM") or "chromium") or shutil.which("chromium-browser")
    if shutil.which("node") is None or browser is None:
        sys.exit("the engines need node and a Chromium: install both, or name the browser in $CHROMIUM")
    wanted = json.loads((HERE / "package.json").read_text())["dependencies"]
    missing = [name for name in wanted if not (HERE / "node_modules" / name).is_dir()]
    if missing:
        sys.exit(f"{', '.join(missing)} missing: run npm install --no-package-lock in {HERE}")
    return browser


def start_drawing(out: Path, engines: list[str], lights: list[str]) -> subprocess.Popen[str]:
    """Begin to draw what lies below OUT/lights."""
    browser = browser_of_engines()
    job = {"engines": engines, "lights": lights, "lights_in": str(out), "out": str(out / "drawn"), "side": SIDE}
    (out / "job.json").write_text(json.dumps(job | {"browser": browser}))
    return subprocess.Popen(["node", HERE / "render.mjs", out / "job.json"], stdout=subprocess.PIPE, text=True)


def versions_drawn(drawing: subprocess.Popen[str]) -> dict[str, str]:
    """By engine, once all is drawn."""
    said, _ = drawing.communicate()
    if drawing.returncode != 0:
        sys.exit("prove.py: an engine could not draw; see above")
    versions: dict[str, str] = json.loads(said)
    return versions


def written(out: Path, name: str, engine: str, light: ObjectLight, mistake: Callable[..., None] | None = None) -> None:
    folder = out / "lights" / name / engine
    folder.mkdir(parents=True, exist_ok=True)
    panorama = colours_of_directions(panorama_directions(HEIGHT, 2 * HEIGHT)) if name in GLOSSY else None
    files = export_files([NamedLight("Sphere", 1, 0.0, light, panorama)], engine)
    content = json.loads(files[f"{engine}.json"])
    if PLATFORMS[engine].picture:
        picture = environment_picture(light, PLATFORMS[engine])
        if mistake is not None:
            picture = mistake(picture, None)
        files[content["lights"][0]["environment"]] = encode_hdr(laid_out(picture, PLATFORMS[engine].picture))
    elif mistake is not None:
        sh = np.reshape(content["lights"][0]["sh"], (9, 3))
        content["lights"][0]["sh"] = mistake(None, sh).ravel().tolist()
        if engine == "gltf":
            document = json.loads(files["Sphere_0001.gltf"])
            of_image = document["extensions"]["EXT_lights_image_based"]["lights"][0]
            of_image["irradianceCoefficients"] = mistake(None, sh).tolist()
            files["Sphere_0001.gltf"] = json.dumps(document).encode()
    files[f"{engine}.json"] = json.dumps(content).encode()
    for file, content_of in files.items():
        (folder / file).write_bytes(content_of)


def wrong_in_webxr(out: Path, lights: dict[str, ObjectLight]) -> list[str]:
    """What an app that asks for the light does not get of two lights, a second apart."""
    folder, browser = out / "webxr", json.loads((out / "job.json").read_text())["browser"]
    folder.mkdir(exist_ok=True)
    names = ("living_room_key", "walk_around")
    timed = [NamedLight("Sphere", 1 + number, float(number), lights[name]) for number, name in enumerate(names)]
    for file, content in export_files(timed, "webxr").items():
        (folder / file).write_bytes(content)
    command = ["node", HERE / "webxr.mjs", folder, browser, "3"]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    seen = json.loads(done.stdout or "[]")
    if done.returncode != 0 or len(seen) < len(timed):
        return [f"webxr: the app had {len(seen)} of {len(timed)} lights"]
    wrong = []
    for got, entry in zip(seen, json.loads((folder / "webxr.json").read_text())["lights"], strict=False):
        main = entry["mainLight"] or {"direction": [0, 1, 0], "color": [0, 0, 0], "intensity": 0.0}
        expected = [*entry["sh"], *main["direction"], *(c * main["intensity"] for c in main["color"])]
        off = np.abs(np.array([*got["sh"], *got["direction"], *got["intensity"]]) - expected).max()
        wrong += [f"webxr: the light of frame {entry['frame']} is {off:.2g} off"] * bool(off > WEBXR_OFF)
    print(f"webxr: an app had {len(timed)} lights, each as exported" if not wrong else "webxr")
    return wrong


SIGNS = np.array([1, -1, 1, -1, 1, -1, 1, -1, 1.0])[:, None]
UPSIDE_DOWN = np.array([1, -1, 1, 1, -1, -1, 1, 1, -1.0])[:, None]
MISTAKES: dict[str, Callable[[Any, Any], Any]] = {
    "wrong sign": lambda picture, sh: sh * SIGNS if picture is None else picture[:, ::-1],
    "flipped axis": lambda picture, sh: sh * UPSIDE_DOWN if picture is None else picture[::-1],
    "a factor of pi": lambda picture, sh: (sh if picture is None else picture) / np.pi,
    "6 and 7 swapped": lambda picture, sh: (
        sh[[0, 1, 2, 3, 4, 5, 7, 6, 8]] if picture is None else np.roll(picture, 64, 1)
    ),
    "exposure twice": lambda picture, sh: (sh if picture is None else picture) * 1.38,
}
"""What is exported wrong on purpose; for a picture mirrored, upside down, and a quarter turn in place of the swap."""


def colours_of_directions(directions: ArrayF64) -> ArrayF64:
    """Light from 0.2 to 3.8: red from +X, green from +Y, blue from +Z of Blender's, and brighter than white."""
    return 2 + 1.8 * directions


def wrong_in_cube_maps(out: Path) -> list[str]:
    """Which metal spheres under a glTF file do not reflect `colours_of_directions`, by closed form."""
    wrong = []
    places = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    across, down = np.meshgrid(places, places)
    inside = np.hypot(across, down) < MIDDLE
    for name, roughness in GLOSSY.items():
        for view in VIEWS:
            sign = 1 if view == "front" else -1
            towards = np.sqrt(np.maximum(1 - across**2 - down**2, 0))
            normals = np.stack([across * sign, -towards * sign, -down], axis=-1)
            looks = np.array([0.0, 1.0, 0.0]) * sign
            reflected = looks - 2 * (normals @ looks)[..., None] * normals
            expected = 2 + 1.8 * kept_by_lobe(roughness**2) * reflected
            drawn = np.fromfile(out / "drawn" / "gltf" / f"{name}_{view}.f32", np.float32).reshape(SIDE, SIDE, 3)
            off = float(np.abs(drawn - expected)[inside].mean() / expected[inside].mean())
            print(f"gltf: a {name} metal, {view}: {off:.2%} off")
            wrong += [f"gltf: a {name} metal, {view}, is {off:.2%} off"] * (off > BOUND)
    return wrong


def kept_by_lobe(alpha: float) -> float:
    """How much of light that is linear in direction GGX keeps along the normal: the mean cosine of its lobe."""
    if alpha == 0:
        return 1.0
    cosine = (np.arange(100_000) + 0.5) / 100_000
    lobe = cosine / (1 - (1 - alpha**2) * (1 + cosine) / 2) ** 2
    return float((cosine * lobe).sum() / lobe.sum())


def error_of(out: Path, engine: str, name: str, truth: dict[str, ArrayF64]) -> float:
    """Mean difference over both views of the sphere, relative to the mean of Cycles."""
    places = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    inside = np.hypot(*np.meshgrid(places, places)) < RIM
    differences, levels = [], []
    for view in VIEWS:
        drawn = np.fromfile(out / "drawn" / engine / f"{name}_{view}.f32", np.float32).reshape(SIDE, SIDE, 3)
        true = np.maximum(truth[view], 0) if engine in CLAMPS else truth[view]
        differences.append(np.abs(drawn - true)[inside].mean())
        levels.append(np.abs(true)[inside].mean())
    return float(np.mean(differences) / np.mean(levels))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--engines", type=lambda text: text.split(","), default=list(ENGINES))
    options = parser.parse_args()
    if unknown := set(options.engines) - set(ENGINES):
        parser.error(f"--engines: choose among {', '.join(ENGINES)}, got {', '.join(sorted(unknown))}")
    out, lights = options.out.resolve(), lights_to_prove()
    names = [*lights, *(f"mistake_{number}" for number in range(len(MISTAKES)))]
    by_engine = {}
    for engine in options.engines:
        apart = PLATFORMS[engine].main_light_apart
        by_engine[engine] = [name for name in names if apart or not name.endswith("_key")]
        for name, light in lights.items():
            written(out, name, engine, light)
        for number, mistake in enumerate(MISTAKES.values()):
            written(out, f"mistake_{number}", engine, lights["living_room"], mistake)
        for name in GLOSSY:
            written(out, name, engine, lights["constant"])
    drawing = start_drawing(out, options.engines, [*names, *GLOSSY])
    truths = {}
    with sphere_in_cycles() as drawn:
        for name, light in lights.items():
            truths[name, False] = truths[name, True] = drawn(light, None)
            radiance = evaluate_panorama(rest_of(light), HEIGHT, 2 * HEIGHT)
            if radiance.min() < 0 and any(PLATFORMS[engine].picture for engine in options.engines):
                # Only black is left of what is below zero in a picture, so Cycles sees the picture.
                truths[name, True] = drawn(light, np.maximum(radiance, 0))
    versions = versions_drawn(drawing)
    failed = wrong_in_webxr(out, lights)
    if "gltf" in options.engines:
        failed += wrong_in_cube_maps(out)
    for engine in options.engines:
        is_picture = PLATFORMS[engine].picture is not None
        own = [name for name in by_engine[engine] if name in lights]
        errors = {name: error_of(out, engine, name, truths[name, is_picture]) for name in own}
        caught = {
            mistake: error_of(out, engine, f"mistake_{number}", truths["living_room", is_picture])
            for number, mistake in enumerate(MISTAKES)
        }
        worst, mean = max(errors, key=lambda name: errors[name]), np.mean(list(errors.values()))
        print(
            f"{engine} {versions[engine]}: {len(errors)} lights, mean {mean:.2%}, worst {errors[worst]:.2%} ({worst})"
        )
        with_main = [error for name, error in errors.items() if name.endswith("_key")]
        if with_main:
            print(f"  with a main light apart at most {max(with_main):.2%}")
        print("  mistakes seen as", ", ".join(f"{name} {error:.0%}" for name, error in caught.items()))
        bound = BOUNDS.get(engine, BOUND)
        bounds = {name: EXCEPTIONS.get((engine, name), bound) for name in errors}
        failed += [f"{engine}: {name} is {error:.2%} off" for name, error in errors.items() if error > bounds[name]]
        failed += [f"{engine}: {name} was not seen" for name, error in caught.items() if error <= bound]
    print("\n".join(failed) or "all as they should be")
    sys.stdout.flush()
    os._exit(1 if failed else 0)


if __name__ == "__main__":
    main()
