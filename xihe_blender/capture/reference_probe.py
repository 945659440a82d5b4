"""The reference probe: what light really arrives at a position, rendered, within a noise that is told.

Two lights are asked for, and one picture cannot give both.

`hdr` is all the light that arrives. Lamps are hidden from cameras unless the user says otherwise, so a panorama misses
them; made visible, they would be single texels of enormous value. What sees every lamp is a surface, towards which
Cycles samples lamps by themselves. So the camera stands inside a ball of a millimetre that no other ray can see. Its
surface scatters as a cone: a `Toon` closure (diffuse, even within CONE) turns each pixel into the mean of the light in
the cone around the opposite direction, which dims each band of the coefficients by a known factor. It holds sun, point,
spot, area, mesh lights, portals, light groups and, since the ball joins the virtual object's light links, light
linking. A white ball, which scatters as a cosine and leaves a quarter of l = 2, needs some ten times the samples.

`ldr` is what camera rays would see, clipped at white. It comes from pictures of a mirror ball, whose pixels all have
the same solid angle; see `xihenet.clipped_light` for how they are clipped without bias.

Both are rendered picture by picture, each with a seed of its own, until their spread says that the noise is within the
target or the most pictures are reached. Light transport is the capture's, clamps are the scene's: what is held against
the reference is rendered in the same way.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, TypeVar

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.capture.light_links import joined_light_links
from xihe_blender.capture.render import MAX_SEED, Rendered, RenderSettings, render_passes, stacked_rgb
from xihe_blender.capture.scanner import own_camera, working_room
from xihe_blender.scene.shader_nodes import new_material
from xihe_blender.scene.sphere_rig import sphere_mesh
from xihe_blender.scene.state import show_to_camera_alone
from xihe_blender.scene.units import metres_per_unit
from xihenet.clipped_light import clipped_sh, relative_noise
from xihenet.estimators.base import Target
from xihenet.mirror_ball import panorama_of_ball, project_mirror_ball
from xihenet.phone.metering import KEY_LUMINANCE
from xihenet.records import ArrayBool, ArrayF32, ArrayF64

NAME = "Xihe Reference Probe"
CLIP_START_M, CLIP_END_M = 0.001, 1e5
DARKEST_LIGHT = 0.01 * KEY_LUMINANCE * math.sqrt(4 * math.pi * 3)
"""Norm of the coefficients of light at a hundredth of the key. Darker light is held against this."""

CONE = 0.4
"""Size of the `Toon` closure, half the cone's angle over a right angle: 36 degrees, of which l = 2 keeps 0.73. A wider
cone catches a lamp in more pixels, a narrower one keeps more of l = 2 where indirect light is noisy."""

MORE_BLUR = 0.75 / (1 - math.cos(CONE * math.pi / 2))
"""Of the scene's Filter Glossy, for rays of the cone, so that what they meet is blurred as for rays of a matte surface.

The denser rays leave, the less it blurs: 1 / (2 pi (1 - c)) per steradian here, 2 / (3 pi) on average there. What is
blurred is darker: without this the light was 0.7 and 1.5 % too bright in `living_room`, 9 % beside a mirror; with it
0.2 % too dark on average in eleven rooms. What lies behind the first bounce is blurred more as well.
Below LEAST_BLUR a matte surface has only its flat rays blurred, which one value for all rays cannot follow."""

LEAST_BLUR = 0.4

CONE_SEGMENTS = 8
"""Of the ball around the camera. Its shape counts for nothing, but float32 breaks small faces far from the origin: with
128 light was up to 1.8 % too dark 100 km away, with 8 it is within 0.1 %."""

SEED_STEP = 7919
"""Between the seeds of two runs' first pictures: more than a run ever takes."""

BALL_RADIUS_M = 0.0005
ROUNDING = 1.8e-7
"""Of its distance from the origin the ball is this large at least: float32 has one and a half steps in its radius."""

SMALLEST_CLIP = 1e-6
"""Blender units: cameras have no nearer clip start, whatever a unit is."""

MIRROR_SAMPLES = 16
"""In each pixel of the picture of what is reflected, of which some four make one direction of the reflections."""

FEWEST_SAMPLES = 6
"""By fewer nobody could tell the noise: with 4 a disc was off by up to 2.4 times what it told, in 20 seeds."""

ERROR_BESIDE_NOISE: dict[Target, float] = {"ldr": 0.016, "hdr": 0.008}
"""Relative, of a reference light without noise: what lights in eleven rooms were off by against path-traced directions
and baked irradiance, beyond the noise of both (docs/reference_light.md)."""

SEQUENCE_LENGTH = 512
"""Of Cycles' sequence of samples; noise with 2, 64 and 4096 was as much, within its own spread."""

Picture = TypeVar("Picture")

Means = dict[tuple[int, int], ArrayF64]
"""Coefficients of what pictures of cones show, by number of the picture and of the one beside it."""


@dataclass(frozen=True)
class ProbeSettings:
    """How well a reference is rendered.

    Parameters
    ----------
    size : pixels along a side of each picture, one ray in each
    max_samples : pictures of each, at most
    noise_target : relative error of the coefficients that is aimed at; None takes `max_samples`, whatever the noise
    seed : of the run
    denoise : with OpenImageDenoise, where the build has it: one more picture, for what is white, never for what counts
    light_transport : as in RenderSettings
    order : highest band of `ldr`
    aims_at_ldr : whether the target holds for `ldr` too; else FEWEST_SAMPLES pictures of it are taken, whatever the
        noise: in dim rooms they were three quarters of the time
    """

    size: int = 192
    max_samples: int = 32
    noise_target: float | None = 0.06
    seed: int = 0
    denoise: bool = True
    light_transport: tuple[tuple[str, bool | int], ...] = ()
    order: int = 2
    aims_at_ldr: bool = True

    @property
    def max_ldr_samples(self) -> int:
        return self.max_samples if self.aims_at_ldr else min(FEWEST_SAMPLES, self.max_samples)


@dataclass(frozen=True, eq=False)
class MeasuredLight:
    """What was measured of the light at one position, without its pictures; rendering them took `render_s`.

    Parameters
    ----------
    ldr : ((order + 1)^2, 3) radiance coefficients of what camera rays see, clipped at white
    hdr : (9, 3) of all light that arrives; both carry the exposure
    ldr_noise, hdr_noise : their relative noise, which is not all of their error; None where it could not be told
    ldr_samples, hdr_samples : pictures that were taken of each
    """

    ldr: ArrayF64
    hdr: ArrayF64
    ldr_noise: float | None
    hdr_noise: float | None
    ldr_samples: int
    hdr_samples: int
    render_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("ldr", "hdr"):
            light = np.asarray(getattr(self, name), np.float64)
            if light.ndim != 2 or light.shape[1] != 3 or len(light) < 9:
                raise ValueError(f"{name}: expected coefficients (9, 3), got an array of shape {light.shape}")
            object.__setattr__(self, name, light)

    def of(self, target: Target) -> ArrayF64:
        return self.ldr if target == "ldr" else self.hdr

    def noise(self, target: Target) -> float | None:
        return self.ldr_noise if target == "ldr" else self.hdr_noise

    def expected_error(self, target: Target) -> float | None:
        """How far off one target is, relative: by noise and by what is not noise, as squares."""
        noise = self.noise(target)
        return None if noise is None else math.hypot(noise, ERROR_BESIDE_NOISE[target])

    def samples(self, target: Target) -> int:
        return self.ldr_samples if target == "ldr" else self.hdr_samples


@dataclass(frozen=True, eq=False)
class ReferenceLight:
    """The light at one position, and what camera rays see there: scene radiance as a mirror ball, (N, N, 3) float32."""

    measured: MeasuredLight
    ball: ArrayF32

    @property
    def panorama(self) -> ArrayF32:
        """(H, 2H, 3) float32, the same."""
        return panorama_of_ball(self.ball, max(8, len(self.ball) // 4))


@dataclass
class ReferenceProbe:
    """Measures light at places; made by `open_reference_probe`.

    `balls` are one for each, `blur_glossy` is the scene's Filter Glossy.
    """

    scene: bpy.types.Scene
    balls: Sequence[bpy.types.Object]
    positions_m: ArrayF64
    settings: ProbeSettings
    is_denoised: bool
    blur_glossy: float

    def move(self, index: int, position_m: ArrayF64) -> None:
        """Have the `index`-th position at another place from now on."""
        if np.array_equal(position_m, self.positions_m[index]):
            return
        metres = metres_per_unit(self.scene)
        grown = _ball_radius(position_m, metres) / _ball_radius(self.positions_m[index], metres)
        self.positions_m[index], ball = position_m, self.balls[index]
        ball.location, ball.scale = tuple(position_m / metres), grown * ball.scale

    def light_at(self, index: int, frame: int, exposure: float = 1.0) -> ReferenceLight:
        """The light at the `index`-th position in `frame`; `exposure` says where white is."""
        steps = self.light_by_steps(index, frame, exposure)
        while True:
            try:
                next(steps)
            except StopIteration as finished:
                light: ReferenceLight = finished.value
                return light

    def light_by_steps(self, index: int, frame: int, exposure: float = 1.0) -> Generator[None, None, ReferenceLight]:
        """As `light_at`; it can be left before each picture."""
        self.scene.frame_set(frame)
        gain, order = np.float32(exposure), self.settings.order
        views, ldr, ldr_noise = yield from self._measure(
            lambda number: _exposed_view(self.view(index, number), gain),
            lambda views: _lights_seen(views, None, order),
            self.settings.max_ldr_samples,
        )
        smooth = None
        if self.is_denoised:
            yield
            # The same once more, with half as many rays in each pixel as all pictures have: it says what is white.
            rendered = self.view(index, -1, samples=max(2, len(views) // 2), is_denoised=True)
            smooth = _exposed_view(rendered, gain)
            ldr, ldr_noise = _mean_and_noise(_lights_seen(views, smooth.radiance, order))
        known: Means = {}
        cones, hdr, hdr_noise = yield from self._measure(
            lambda number: self.cones(index, number),
            lambda cones: lights_of_cones([finite_rgb(cone.passes, "Combined") for cone in cones], known) * gain,
            self.settings.max_samples,
        )
        seen: ArrayF32 = np.mean([view.radiance for view in views], axis=0) if smooth is None else smooth.radiance
        render_s = 0.0 if smooth is None else smooth.render_s
        render_s += sum(view.render_s for view in views) + sum(cone.render_s for cone in cones)
        measured = MeasuredLight(ldr, hdr, ldr_noise, hdr_noise, len(views), len(cones), render_s)
        return ReferenceLight(measured, seen / gain)

    def _measure(
        self, take: Callable[[int], Picture], lights: Callable[[Sequence[Picture]], ArrayF64], most: int
    ) -> Generator[None, None, tuple[list[Picture], ArrayF64, float | None]]:
        """Picture after picture, until the mean of their lights is good enough or there are `most`; it and its noise.

        `lights` are (n, coefficients, 3) of each picture.
        """
        target = self.settings.noise_target
        taken: list[Picture] = []
        while True:
            # A fifth more at a time: clipping looks at all of them anew.
            n = len(taken)
            enough_to_judge = max(min(FEWEST_SAMPLES, most), n + n // 5, n + 1)
            for number in range(n, min(enough_to_judge, most)):
                yield
                taken.append(take(number))
            light, noise = _mean_and_noise(lights(taken))
            if len(taken) >= most or (target is not None and noise is not None and noise <= target):
                return taken, light, noise

    def view(self, index: int, number: int, *, samples: int = 1, is_denoised: bool = False) -> Rendered:
        """What camera rays see in a mirror ball, from just outside of the ball of the cones."""
        start_m = max(CLIP_START_M, 2 * _ball_radius(self.positions_m[index], metres_per_unit(self.scene)))
        self._look(index, (start_m, CLIP_END_M), samples, is_denoised=is_denoised)
        return self._render(number)

    def mirror_ball(self, index: int, frame: int) -> tuple[ArrayF32, float]:
        """(N, N, 3) what glossy rays see at the `index`-th position in `frame`, as a mirror ball; scene radiance.

        And the seconds of rendering. Lamps are hidden from cameras unless the user says otherwise, but not from
        glossy rays.
        """
        self.scene.frame_set(frame)
        with _seen_as_by_glossy_rays(self.scene):
            rendered = self.view(index, 0, samples=MIRROR_SAMPLES, is_denoised=self.is_denoised)
        return finite_rgb(rendered.passes, "Combined"), rendered.render_s

    def cones(self, index: int, number: int, samples: int = 1) -> Rendered:
        """All light; every other picture is turned over, since a picture tells little of what lies on its rim."""
        self.look_at_cones(index, samples, is_turned=number % 2 == 1)
        return self._render(number)

    def look_at_cones(self, index: int, samples: int = 1, *, is_turned: bool = False) -> None:
        """Set the scene up to render all light: in each pixel of a mirror ball the mean over the cone opposite to it.

        `samples` is the number of rays in each pixel; `is_turned` has the middle of the picture look straight down.
        """
        radius_m = _ball_radius(self.positions_m[index], metres_per_unit(self.scene))
        self._look(index, (radius_m / 4, 2 * radius_m), samples, is_turned=is_turned)
        self.scene.cycles.blur_glossy = MORE_BLUR * self.blur_glossy

    def _look(
        self, index: int, clip_m: tuple[float, float], samples: int, *, is_denoised: bool = False,
        is_turned: bool = False,
    ) -> None:  # fmt: skip
        scene, metres = self.scene, metres_per_unit(self.scene)
        scene.cycles.use_denoising, scene.cycles.blur_glossy = is_denoised, self.blur_glossy
        scene.camera.rotation_euler = (0.0 if is_turned else math.pi, 0.0, 0.0)
        scene.camera.location = tuple(self.positions_m[index] / metres)
        scene.camera.data.clip_start, scene.camera.data.clip_end = (distance / metres for distance in clip_m)
        _take_samples(scene, samples)

    def _render(self, number: int) -> Rendered:
        self.scene.cycles.seed = (self.settings.seed * SEED_STEP + number) % MAX_SEED
        return render_passes(self.scene)


class _View(NamedTuple):
    """What camera rays see, (N, N, 3) exposed, and what of it shines by itself."""

    radiance: ArrayF32
    emission: ArrayF32
    fog: ArrayBool | None  # (N, N, 1) where light was scattered on its way; None where no volume was looked for
    render_s: float


def _exposed_view(rendered: Rendered, gain: np.float32) -> _View:
    passes = rendered.passes
    # From Blender 5 on their names are whole words.
    lamps, sky = ("Emission", "Environment") if "Emission.R" in passes else ("Emit", "Env")
    emission = (finite_rgb(passes, lamps) + finite_rgb(passes, sky)) * gain
    scattered = [name.removesuffix(".R") for name in passes if name.startswith("Volume") and name.endswith(".R")]
    fog = np.any([finite_rgb(passes, name) for name in scattered], axis=(0, -1))[..., None] if scattered else None
    return _View(finite_rgb(passes, "Combined") * gain, emission, fog, rendered.render_s)


def _lights_seen(views: Sequence[_View], smooth: ArrayF32 | None, order: int) -> ArrayF64:
    fogs = [view.fog for view in views if view.fog is not None]
    fog = np.any(fogs, axis=0) if fogs else None
    return clipped_sh([view.radiance for view in views], [view.emission for view in views], smooth, order, fog)


def _mean_and_noise(lights: ArrayF64) -> tuple[ArrayF64, float | None]:
    return lights.mean(axis=0), relative_noise(lights, DARKEST_LIGHT)


def lights_of_cones(pictures: Sequence[ArrayF32], known: Means | None = None) -> ArrayF64:
    """(n, 9, 3) radiance coefficients of the light that each picture of cones was made of; see `means_over_cones`."""
    return means_over_cones(pictures, 2, known) / cone_factors()[:, None]


def means_over_cones(pictures: Sequence[ArrayF32], order: int = 2, known: Means | None = None) -> ArrayF64:
    """(n, (order + 1)^2, 3) coefficients of what each picture of cones (N, N, 3) shows, every other one turned over.

    The mean that is seen in a direction is that of the light around the opposite one. A picture and the one beside it
    tell each other what lies on their rims. `known` keeps the means for later calls with more pictures of the same.
    """
    means, known = [], {} if known is None else known
    for number, picture in enumerate(pictures):
        beside = number ^ 1 if number ^ 1 < len(pictures) else number - 1
        if (number, beside) not in known:
            seen = project_mirror_ball(picture, order, turned=pictures[beside] if beside >= 0 else None)
            known[number, beside] = seen * (turned_over(order)[:, None] if number % 2 else 1)
        means.append(known[number, beside])
    return np.array(means)


@cache
def turned_over(order: int) -> ArrayF64:
    """((order + 1)^2,) what becomes of coefficients when the world is turned by half a turn about X."""
    indices = [(band, m) for band in range(order + 1) for m in range(-band, band + 1)]
    return np.array([(-1.0) ** (band + m) * (-1 if m < 0 else 1) for band, m in indices])


@cache
def cone_factors() -> ArrayF64:
    """(9,) what the cone leaves of each coefficient; odd bands turn their sign, since it lies opposite.

    The mean of Legendre's polynomial P_l over [cos(half angle), 1]: 1, (1 + c) / 2 and c (1 + c) / 2.
    """
    c = math.cos(CONE * math.pi / 2)
    return np.repeat([1.0, -(1 + c) / 2, c * (1 + c) / 2], [1, 3, 5])


@contextlib.contextmanager
def _seen_as_by_glossy_rays(scene: bpy.types.Scene) -> Iterator[None]:
    """Have camera rays see the objects and the world of `scene` that glossy rays see, and no others."""
    seen: list[Any] = [*scene.objects, *([scene.world.cycles_visibility] if scene.world else [])]
    names = {True: ("visible_camera", "visible_glossy"), False: ("camera", "glossy")}
    were = [(one, *names[isinstance(one, bpy.types.Object)]) for one in seen]
    changed = [(one, camera) for one, camera, glossy in were if getattr(one, camera) != getattr(one, glossy)]
    try:
        for one, camera in changed:
            setattr(one, camera, not getattr(one, camera))
        yield
    finally:
        for one, camera in changed:
            setattr(one, camera, not getattr(one, camera))


@contextlib.contextmanager
def open_reference_probe(
    scene: bpy.types.Scene,
    positions_m: ArrayLike,
    settings: ProbeSettings,
    objects: Sequence[bpy.types.Object | None] | None = None,
) -> Iterator[ReferenceProbe]:
    """A reference probe in the room of `scene`, virtual objects left out, for positions (K, 3): world, metres.

    It takes the light links of `objects`, the virtual object that stands at each of them; None for none.
    """
    places = np.array(positions_m, np.float64).reshape(-1, 3)
    rendering = RenderSettings(
        (settings.size, settings.size), 1, settings.seed, settings.denoise, settings.light_transport
    )
    with working_room(scene, NAME, rendering) as working, contextlib.ExitStack() as stack:
        layer = working.view_layers[0]
        layer.use_pass_emit = layer.use_pass_environment = True
        has_volumes = working.cycles.volume_bounces > 0
        layer.cycles.use_pass_volume_direct = layer.cycles.use_pass_volume_indirect = has_volumes
        # A box: with any wider filter pixels on the rim look past the ball more often than they should.
        working.cycles.pixel_filter_type = "BOX"
        seen = own_camera(stack, working, NAME).data
        seen.type = "PANO"
        panorama: Any = seen if hasattr(seen, "panorama_type") else seen.cycles
        panorama.panorama_type = "MIRRORBALL"  # It sees the whole sphere.
        balls = _put_balls(stack, working, places)
        for ball, item in zip(balls, objects or (), strict=False):
            if item is not None:
                stack.enter_context(joined_light_links(scene, ball, item))
        yield ReferenceProbe(working, balls, places, settings, working.cycles.use_denoising, working.cycles.blur_glossy)


def _take_samples(scene: bpy.types.Scene, n: int) -> None:
    """Render so many rays in each pixel: not the first of Cycles' sequence, which always goes through a pixel's middle.

    Each picture has a seed of its own. Those that follow in one sequence resemble each other: their spread said 5 %
    where the error was 8 %. The sequence is of one length, whatever is taken of it: where Cycles keeps its scene, the
    length of the render before decides the noise of the next, and a resumed run would differ by its noise. (Before
    Blender 4.4, which cannot take a part of a sequence, it does.)
    """
    cycles = scene.cycles
    cycles.sample_offset, cycles.samples = 1, n
    if hasattr(cycles, "use_sample_subset"):  # from 4.4 on
        cycles.use_sample_subset, cycles.sample_subset_length = True, n
        cycles.samples = max(SEQUENCE_LENGTH, 1 + n)


def _put_balls(stack: contextlib.ExitStack, scene: bpy.types.Scene, positions_m: ArrayF64) -> list[bpy.types.Object]:
    """Balls that camera rays alone can see, so that they neither shade nor light anything; gone with `stack`."""
    metres = metres_per_unit(scene)
    material = _cone_material()
    stack.callback(bpy.data.materials.remove, material)
    balls = []
    for position in positions_m:
        mesh = sphere_mesh(NAME, _ball_radius(position, metres) / metres, CONE_SEGMENTS, CONE_SEGMENTS // 2)
        # With its mesh the object goes too.
        stack.callback(bpy.data.meshes.remove, mesh)
        mesh.materials.append(material)
        ball = bpy.data.objects.new(NAME, mesh)
        ball.location = tuple(position / metres)
        show_to_camera_alone(ball)
        scene.collection.objects.link(ball)
        balls.append(ball)
    return balls


def _ball_radius(position_m: ArrayF64, metres: float) -> float:
    """In metres, of which a Blender unit has `metres`."""
    return max(BALL_RADIUS_M, ROUNDING * float(np.abs(position_m).max()), 8 * SMALLEST_CLIP * metres)


def _cone_material() -> bpy.types.Material:
    material = new_material(NAME)
    tree = material.node_tree
    tree.nodes.clear()
    cone = tree.nodes.new("ShaderNodeBsdfToon")
    cone.component = "DIFFUSE"
    cone.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    cone.inputs["Size"].default_value, cone.inputs["Smooth"].default_value = CONE, 0.0
    # Not the ball's own normal, which is wrong where float32 rounds its corners.
    tree.links.new(tree.nodes.new("ShaderNodeNewGeometry").outputs["Incoming"], cone.inputs["Normal"])
    tree.links.new(cone.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def finite_rgb(passes: dict[str, ArrayF32], name: str) -> ArrayF32:
    """A pass as a picture; a renderer's broken pixels are black, as they are on a screen."""
    return np.nan_to_num(stacked_rgb(passes, name), copy=False, nan=0.0, posinf=0.0, neginf=0.0)
