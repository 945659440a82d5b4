"""One furnished room, built wherever and as large as asked, and what the chain makes of its light end to end.

Everything is placed by hand, not by a parent: places and sizes of objects, the size and the power of the lamp (power
goes with area, the strength of a sun or of an emitting surface does not), the clip planes, the phone's path.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import bpy
import numpy as np
from tiny_scenes import add_lamp, box, empty_scene, look_at, material, phone, set_world, sphere

from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe
from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import meter_exposure, open_scanner
from xihe_blender.jobs import run_blocking
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.backend import LocalBackend
from xihenet.controller import ControllerSettings, XiheController
from xihenet.estimators import load
from xihenet.records import ArrayF64, RgbdFrame
from xihenet.sh import rotate
from xihenet.trigger import TriggerSettings

EYES = ((-1.2, -1.5, 1.5), (-0.3, -1.6, 1.4), (0.9, -1.3, 1.2))
PROBE = (0.0, 0.0, 0.85)
LAMP_W, SUN_STRENGTH, SKY = 60.0, 2.0, (0.3, 0.4, 0.6)
ESTIMATORS = ("projection", "lattice")
SIZE, SAMPLES, PROBE_SIZE, PROBE_SAMPLES, METERING_SAMPLES = (32, 24), 64, 112, 12, 4

EVERY_FRAME = TriggerSettings(theta=0.0, coverage_theta=0.0)
"""Estimates are made in every frame: else a yaw may decide that what was newly seen stays just below a threshold."""

NOISE = {"projection": 0.03, "lattice": 0.05, "truth": 0.02}
"""What another seed changes at most, relative to the norm of the light; and what moving and scaling may change."""

TOLERANCE = {"projection": 0.05, "lattice": 0.18, "truth": 0.02}
"""What a yaw may change: noise, and that the anchors of the unit sphere do not turn with the room."""


@dataclass(frozen=True)
class Placing:
    """Where a room stands: scaled, then turned by `yaw_deg` about +Z, then moved by `offset`, in Blender units."""

    name: str = "as it is"
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    scale: float = 1.0
    metres_per_unit: float = 1.0

    def __str__(self):
        return self.name

    @property
    def rotation(self):
        c, s = np.cos(np.radians(self.yaw_deg)), np.sin(np.radians(self.yaw_deg))
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def __call__(self, point):
        """Where a point of the room as it is goes, in Blender units."""
        moved: ArrayF64 = self.rotation @ (self.scale * np.asarray(point, np.float64)) + self.offset
        return moved

    def turned_back(self, sh_radiance):
        return rotate(sh_radiance, self.rotation.T)


AS_IT_IS = Placing()
FAR = (7071.3, -7071.7, 321.9)
"""10 km from the origin, and on no whole number."""

NOT_TURNED = [
    Placing("10 km away along X", (1e4, 0.0, 0.0)),
    Placing("10 km away on all axes", FAR),
    Placing("1000 times as large, with its unit", scale=1e3, metres_per_unit=1e-3),
    Placing("1000 times as small, with its unit", scale=1e-3, metres_per_unit=1e3),
]
ALL_THREE = [
    Placing("10 km away, turned, 1000 times as large, with its unit", tuple(1e3 * np.array(FAR)), 123.456, 1e3, 1e-3),
    Placing("10 km away, turned, 1000 times as small, with its unit", tuple(1e-3 * np.array(FAR)), -77.7, 1e-3, 1e3),
]
IN_METRES = [Placing("4 km wide", scale=1e3), Placing("4 km wide, 10 km away, turned", FAR, 123.456, 1e3)]
"""Really 1000 times as large: for whoever does not read metres, `projection` and the light probe."""


def furnished_room(placing=AS_IT_IS, *, is_open=False):
    """A furnished room with a lamp and a shining panel, a virtual ball on a table, and a phone that walks by.

    `is_open` takes the walls away and lets the sun and the sky in.
    """
    scene = empty_scene()
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", placing.metres_per_unit
    scene.frame_end = len(EYES)
    scene.cycles.sample_clamp_indirect = 0.0
    set_world(scene, SKY if is_open else (0.0, 0.0, 0.0))
    _furnish(scene, is_open)
    _lamp(scene, "AREA", LAMP_W)
    if is_open:
        _lamp(scene, "SUN", SUN_STRENGTH)
    _place(scene, placing)
    _walk(scene, placing)
    bpy.context.view_layer.update()
    return scene


def _furnish(scene, is_open):
    walls = material("Walls", (0.6, 0.55, 0.5))
    if is_open:
        box(scene, "Floor", (0, 0, -0.05), (8, 8, 0.1), walls)
    else:
        box(scene, "Room", (0, 0, 1.5), (4, 4, 3), walls, inward=True)
    box(scene, "Table", (0, 0, 0.7), (1.2, 0.8, 0.05), material("Wood", (0.35, 0.2, 0.1)))
    box(scene, "Shelf", (-1.7, 0.9, 1.0), (0.4, 1.2, 2.0), material("Green", (0.1, 0.5, 0.2)))
    box(scene, "Chest", (1.2, 1.4, 0.4), (0.9, 0.6, 0.8), material("Red", (0.7, 0.1, 0.1)))
    box(scene, "Panel", (0.3, 1.95, 1.6), (0.8, 0.05, 0.5), material("Light", (0.7, 0.8, 1.0), emission=3.0))
    ball = virtual_collection(scene, create=True)
    sphere(scene, "Ball", PROBE, 0.12, material("Grey", (0.5, 0.5, 0.5)), ball)


def _lamp(scene, kind, energy):
    lamp = add_lamp(scene, kind, (1.1, 0.4, 2.7), energy=energy, color=(1.0, 0.9, 0.75))
    lamp.rotation_euler = (0.2, 0.3, 0.1)
    if kind == "AREA":
        lamp.data.shape, lamp.data.size, lamp.data.size_y = "RECTANGLE", 0.8, 0.5


def _place(scene, placing):
    for item in scene.objects:
        item.location = placing(item.location)
        # Blender's Euler angles turn about Z last.
        item.rotation_euler.z += np.radians(placing.yaw_deg)
        if item.type == "MESH":
            item.scale *= placing.scale
        elif item.data.type == "AREA":
            item.data.size, item.data.size_y = item.data.size * placing.scale, item.data.size_y * placing.scale
            item.data.energy *= placing.scale**2


def _walk(scene, placing):
    camera = phone(scene, placing(EYES[0]), placing(PROBE))
    camera.data.clip_start, camera.data.clip_end = 0.05 * placing.scale, 100 * placing.scale
    for frame, eye in enumerate(EYES, start=1):
        look_at(camera, placing(eye), placing(PROBE), frame)


@dataclass(frozen=True, eq=False)
class SeenLight:
    """What was seen of a room: the frames, and (9, 3) coefficients of scene radiance by estimator and for `truth`."""

    placing: Placing
    frames: list[RgbdFrame]
    lights: Mapping[str, ArrayF64]

    def apart_from(self, known):
        """How far each light, turned back, is from that of the room as it is."""
        turned = {name: self.placing.turned_back(light) for name, light in self.lights.items()}
        return {name: apart(light, known.lights[name]) for name, light in turned.items()}


def see(placing=AS_IT_IS, *, seed=0, estimators=ESTIMATORS, is_open=False):
    """Build the room there, meter and capture its path, run the chain at the ball, and render the light probe."""
    scene = furnished_room(placing, is_open=is_open)
    position_m = placing(PROBE) * placing.metres_per_unit
    exposure = run_blocking(meter_exposure(scene, range(1, len(EYES) + 1), seed, samples=METERING_SAMPLES))
    frames = []
    with open_scanner(scene, RenderSettings(SIZE, SAMPLES, seed, denoise=False)) as scanner:
        scanner.exposure = exposure
        for frame in range(1, len(EYES) + 1):
            scanner.move_to(frame)
            frames.append(scanner.acquire_environment_scan())
    settings = ProbeSettings(PROBE_SIZE, PROBE_SAMPLES, noise_target=None, seed=seed)
    with open_reference_probe(scene, [position_m], settings) as probe:
        truth = probe.light_at(0, len(EYES), exposure).measured.ldr / exposure
    lights = {name: estimated(frames, position_m, name) for name in estimators}
    return SeenLight(placing, frames, lights | {"truth": truth})


def estimated(frames, position_m, estimator):
    """(9, 3) scene radiance that a session believes in after `frames`."""
    settings = ControllerSettings(trigger=EVERY_FRAME, reference_exposure=frames[0].exposure)
    controller = XiheController(LocalBackend(load(estimator)), settings)
    controller.add_position("ball", position_m)
    for frame in frames:
        controller.step(frame)
    light = controller.light("ball")
    assert light is not None
    return light.sh_radiance / light.exposure


def turned_by_hand(seen, yaw_deg, estimator):
    """What `estimator` makes of frames whose poses alone are turned about +Z, turned back: only the anchors differ."""
    placing = Placing(yaw_deg=yaw_deg)
    pose = np.eye(4)
    pose[:3, :3] = placing.rotation
    frames = [replace(frame, world_from_camera=pose @ frame.world_from_camera) for frame in seen.frames]
    return placing.turned_back(estimated(frames, placing(PROBE), estimator))


def apart(light, reference):
    """The norm of the difference over the reference's own."""
    return float(np.linalg.norm(light - reference) / np.linalg.norm(reference))
