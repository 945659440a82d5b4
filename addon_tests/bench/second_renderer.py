"""The reference light beside another path tracer, Mitsuba 3, which shares no code with Blender or with us.

    pip install mitsuba  # It compiles with the machine's LLVM, which should be 16 or newer.
    python addon_tests/bench/second_renderer.py [--presets draft,accurate]

A closed room of plain colours, with an area lamp, a point and a spot, which cameras do not see, a sun through a window,
a uniform sky, and a glowing box. At each place the coefficients of all the light that arrives (`hdr`) are held against
Mitsuba's, with the noise that either tells.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
from given import given, words

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "addon_tests" / "in_blender")]

N_BOUNCES, N_RAYS, N_ROUNDS = 16, 200_000, 8
CEILING = (0.8, 0.8, 0.8)
SKY = (0.5, 0.7, 1.1)
AREA_M, SPOT_DEGREES = (0.6, 0.4), 60.0
# Kind, place in metres, direction, colour, and watts; of the sun, watts per square metre.
LAMPS = {
    "area": ("AREA", (-0.8, 0.5, 2.69), (0, 0, -1), (1, 0.85, 0.6), 40),
    "point": ("POINT", (1.2, -1.5, 1.8), (0, 0, -1), (0.4, 0.6, 1), 20),
    "spot": ("SPOT", (0.5, 1.5, 2.5), (-1, -2.5, -2.5), (1, 1, 1), 60),
    "sun": ("SUN", (5, 0, 5), (-0.8, -0.25, -0.62), (1, 0.9, 0.75), 6),
}
# Centre, size and colour in metres. On the east a window is left open, 1.8 m wide and 1.4 m high.
BOXES = {
    "floor": ((0, 0, -0.05), (4.2, 5.2, 0.1), (0.45, 0.35, 0.28)),
    "ceiling": ((0, 0, 2.75), (4.2, 5.2, 0.1), CEILING),
    "west": ((-2.05, 0, 1.35), (0.1, 5.2, 2.7), (0.7, 0.15, 0.12)),
    "south": ((0, -2.55, 1.35), (4, 0.1, 2.7), (0.2, 0.3, 0.75)),
    "north": ((0, 2.55, 1.35), (4, 0.1, 2.7), (0.75, 0.7, 0.3)),
    "below window": ((2.05, 0, 0.4), (0.1, 5.2, 0.8), (0.15, 0.6, 0.2)),
    "above window": ((2.05, 0, 2.45), (0.1, 5.2, 0.5), (0.15, 0.6, 0.2)),
    "window's left": ((2.05, 1.75, 1.5), (0.1, 1.7, 1.4), (0.15, 0.6, 0.2)),
    "window's right": ((2.05, -1.75, 1.5), (0.1, 1.7, 1.4), (0.15, 0.6, 0.2)),
    "shelf": ((0.3, -1.8, 0.55), (1.2, 0.4, 0.05), CEILING),
    "crate": ((-1.2, 1.5, 0.5), (0.7, 0.4, 1.0), (0.6, 0.6, 0.6)),
}
GLOW = ((-1.6, -1.2, 1.4), (0.25, 0.25, 0.3), (1, 0.7, 0.4), 9.0)
PLACES_M = {
    "middle": (0.3, 0.2, 0.9),
    "above the floor": (-0.6, -0.8, 0.15),
    "on the shelf": (0.4, -1.8, 0.73),
    "in the sun": (0.3, -0.45, 0.25),
    "in a corner": (-1.5, 2.2, 2.2),
}


def room_in_blender():
    """The scene, set to render whole paths."""
    from mathutils import Vector
    from tiny_scenes import add_lamp, box, empty_scene, material, set_world

    scene = empty_scene()
    cycles = scene.cycles
    cycles.max_bounces = cycles.diffuse_bounces = N_BOUNCES
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = 0
    for name, (centre, size, colour) in BOXES.items():
        box(scene, name, centre, size, material(name, colour))
    centre, size, colour, strength = GLOW
    box(scene, "glow", centre, size, material("glow", colour, strength))
    for name, (kind, place, towards, colour, strength) in LAMPS.items():
        lamp = add_lamp(scene, kind, place, name, color=colour, energy=strength)
        lamp.rotation_euler = Vector(towards).to_track_quat("-Z", "Y").to_euler()
        if kind == "AREA":
            lamp.data.shape, (lamp.data.size, lamp.data.size_y) = "RECTANGLE", AREA_M
        elif kind == "SUN":
            lamp.data.angle = 0
        else:
            lamp.data.shadow_soft_size = 0
    spot = scene.objects["spot"].data
    spot.spot_size, spot.spot_blend = math.radians(SPOT_DEGREES), 0
    set_world(scene, SKY)
    return scene


def room_in_mitsuba(mitsuba):
    """The same room; axes are Blender's."""
    to_world = mitsuba.ScalarTransform4f

    def rgb(colour, strength=1.0):
        return {"type": "rgb", "value": [channel * strength for channel in colour]}

    def cube(centre, size, colour):
        place = to_world().translate(centre).scale([side / 2 for side in size])
        return {"type": "cube", "to_world": place, "bsdf": {"type": "diffuse", "reflectance": rgb(colour)}}

    centre, size, colour, strength = GLOW
    glow = cube(centre, size, (0, 0, 0)) | {"emitter": {"type": "area", "radiance": rgb(colour, strength)}}
    parts = {"type": "scene", "glow": glow, "sky": {"type": "constant", "radiance": rgb(SKY)}}
    parts |= {name: cube(*one) for name, one in BOXES.items()}
    for name, (kind, place, towards, colour, strength) in LAMPS.items():
        target = [a + b for a, b in zip(place, towards, strict=True)]
        if kind == "AREA":
            width, height = AREA_M
            facing = to_world().look_at(place, target, [0, 1, 0]).scale([width / 2, height / 2, 1])
            light = {"type": "area", "radiance": rgb(colour, strength / (math.pi * width * height))}
            # Cycles' lamps hide nothing: this one has the colour of the ceiling, which is a centimetre above it.
            seen = {"type": "diffuse", "reflectance": rgb(CEILING)}
            parts[name] = {"type": "rectangle", "to_world": facing, "emitter": light, "bsdf": seen}
        elif kind == "SUN":
            parts[name] = {"type": "directional", "direction": towards, "irradiance": rgb(colour, strength)}
        else:
            intensity = rgb(colour, strength / (4 * math.pi))
            parts[name] = {"type": "point", "position": place, "intensity": intensity}
            if kind == "SPOT":
                half, facing = SPOT_DEGREES / 2, to_world().look_at(place, target, [0, 0, 1])
                parts[name] = {"type": "spot", "to_world": facing, "intensity": intensity, "cutoff_angle": half,
                               "beam_width": 0.9999 * half}  # fmt: skip
    return mitsuba.load_dict(parts)


def light_in_mitsuba(mitsuba, drjit, room, place_m):
    """(9, 3) coefficients of all the light at a place, and their noise as a share of their norm.

    Emitters count by samples of their own, all else by rays that start evenly in all directions.
    """
    integrator = mitsuba.load_dict({"type": "path", "max_depth": N_BOUNCES + 2, "rr_depth": 1000})
    side, found = math.isqrt(N_RAYS), []
    for number in range(N_ROUNDS):
        rng = np.random.default_rng(number)
        row, column = np.mgrid[:side, :side].reshape(2, -1)
        z = 1 - 2 * (row + rng.random(side**2)) / side
        angle = 2 * math.pi * (column + rng.random(side**2)) / side
        level = np.sqrt(1 - z**2)
        directions = np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=1)
        origin = mitsuba.Point3f(*place_m)
        rays = mitsuba.RayDifferential3f(mitsuba.Ray3f(origin, mitsuba.Vector3f(directions.T.astype(np.float32))))
        sampler = mitsuba.load_dict({"type": "independent"})
        sampler.seed(number, side**2)
        seen = np.array(integrator.sample(room, sampler, rays)[0]).T
        hit = room.ray_intersect(rays)
        reflected = seen - np.array(hit.emitter(room).eval(hit)).T
        light = harmonics(directions).T @ reflected * 4 * math.pi / side**2
        here = drjit.zeros(mitsuba.SurfaceInteraction3f, side**2)
        here.p = origin
        chance = mitsuba.Point2f(rng.random((2, side**2)).astype(np.float32))
        towards, radiance = room.sample_emitter_direction(here, chance, True)
        directions, radiance = np.array(towards.d).T.astype(float), np.array(radiance).T
        directions[~np.isfinite(directions).all(axis=1)] = (0, 0, 1)  # Their weight is nothing.
        found.append(light + harmonics(directions).T @ radiance / side**2)
    light = np.mean(found, axis=0)
    return light, math.sqrt(np.var(found, axis=0, ddof=1).sum() / N_ROUNDS) / float(np.linalg.norm(light))


def harmonics(directions):
    """(N, 9) the real spherical harmonics of order 2 in unit directions (N, 3), written out."""
    x, y, z = directions.T
    columns = [
        np.full_like(x, 0.5), math.sqrt(3 / 4) * y, math.sqrt(3 / 4) * z, math.sqrt(3 / 4) * x,
        math.sqrt(15) / 2 * x * y, math.sqrt(15) / 2 * y * z,
        math.sqrt(5) / 4 * (3 * z**2 - 1), math.sqrt(15) / 2 * x * z,
        math.sqrt(15) / 4 * (x**2 - y**2),
    ]  # fmt: skip
    return np.stack(columns, axis=1) / math.sqrt(math.pi)


def all_in_mitsuba():
    """Print the light and its noise at each place as JSON."""
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    import drjit

    room = room_in_mitsuba(mitsuba)
    found = [light_in_mitsuba(mitsuba, drjit, room, place) for place in PLACES_M.values()]
    print(json.dumps([(light.tolist(), noise) for light, noise in found]))


def main(presets):
    # In a process of its own: Blender brings another LLVM.
    asked = subprocess.run([sys.executable, __file__, "--mitsuba"], capture_output=True, text=True, check=False)
    if asked.returncode:
        sys.exit(asked.stderr)
    from xihe_blender.capture.reference_probe import open_reference_probe
    from xihe_blender.io.blender_output import only_our_output
    from xihe_blender.previs.settings import PrevisSettings

    with only_our_output():
        scene = room_in_blender()
        for preset in presets:
            with open_reference_probe(scene, list(PLACES_M.values()), PrevisSettings(preset=preset).reference) as probe:
                for index, (name, (truth, noise)) in enumerate(zip(PLACES_M, json.loads(asked.stdout), strict=True)):
                    light = probe.light_at(index, 1).measured
                    off = np.linalg.norm(light.hdr - truth) / np.linalg.norm(truth)
                    mean = light.hdr[0].sum() / np.sum(truth[0]) - 1
                    told = f"noise {light.hdr_noise:.2%}, Mitsuba's {noise:.2%}"
                    print(f"{preset:9s} {name:16s} off by {off:.2%}, its mean light by {mean:+.2%}; {told}", flush=True)


if __name__ == "__main__":
    options = given(__doc__, presets=(words, ["draft", "accurate"]), mitsuba=False)
    if options.mitsuba:
        all_in_mitsuba()
    else:
        main(options.presets)
