"""A light from one side is on that side: in the picture, the probe, the anchors, and from a rolled and tilted phone."""

import numpy as np
import pytest
from renders import captured
from tiny_scenes import box, empty_scene, material, phone, set_world

from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe
from xihenet.camera import unproject_frame
from xihenet.colour import srgb_to_linear
from xihenet.panorama import panorama_directions
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

PROBE = ProbeSettings(size=144, max_samples=4, noise_target=None)
AXES = [(axis, sign) for axis in range(3) for sign in (1, -1)]
POSITION = (0.3, -0.2, 0.1)


def room_with_one_glowing_side(axis, sign):
    """A 4 m cube that shows nothing but one glowing panel, in the middle of the side at `sign` on `axis`."""
    scene = empty_scene()
    set_world(scene)
    box(scene, "Room", (0, 0, 0), (4, 4, 4), material("Black", (0.0, 0.0, 0.0)), inward=True)
    centre, size = np.zeros(3), np.full(3, 1.5)
    centre[axis], size[axis] = sign * 1.95, 0.02
    box(scene, "Panel", centre, size, material("Glow", (1.0, 1.0, 1.0), emission=0.8))
    return scene


def light_at(scene, position, exposure=1.0):
    """What the reference probe measures there."""
    with open_reference_probe(scene, [position], PROBE) as probe:
        return probe.light_at(0, 1, exposure)


def dominant_direction(sh_radiance):
    """Where most light comes from: the l = 1 coefficients as (x, y, z)."""
    return sh_radiance[[3, 1, 2]].sum(axis=1)


@pytest.mark.parametrize(("axis", "sign"), AXES)
def test_the_probe_knows_the_side_and_its_panorama_shows_it_there(axis, sign):
    light = light_at(room_with_one_glowing_side(axis, sign), POSITION)
    # The panel's centre as the probe sees it: a swapped or mirrored axis would be far off.
    towards = -np.array(POSITION)
    towards[axis] += sign * 1.95
    towards /= np.linalg.norm(towards)
    for direction in map(dominant_direction, (light.measured.ldr, light.measured.hdr)):
        assert direction @ towards / np.linalg.norm(direction) > 0.995
    along = panorama_directions(*light.panorama.shape[:2]) @ towards
    # Straight down is the rim of the mirror ball, where pixels are long and narrow.
    is_down = (axis, sign) == (2, -1)
    bright = light.panorama[along > 0.98]
    assert bright.mean() > 0.6 if is_down else bright.min() > 0.7
    assert light.panorama[along < (0.1 if is_down else 0.5)].max() < 0.01


@pytest.mark.parametrize(("axis", "sign"), AXES)
def test_anchors_know_the_side_from_a_rolled_and_tilted_phone(axis, sign):
    scene = room_with_one_glowing_side(axis, sign)
    panel = np.zeros(3)
    panel[axis] = sign * 1.95
    eye = np.array([0.4, 0.3, -0.35]) - 0.5 * panel / 1.95
    camera = phone(scene, eye, panel)
    camera.rotation_euler.rotate_axis("Z", 0.7)
    camera.rotation_euler.rotate_axis("X", 0.15)
    lattice = AnchorLattice(1280)
    seen = sample_unit_sphere(unproject_frame(captured(scene, (96, 72), samples=4)), POSITION, lattice)
    light = srgb_to_linear(seen.srgb).sum(axis=1)
    centre = (lattice.directions * light[:, None]).sum(axis=0)
    expected = panel - POSITION
    assert centre @ expected / np.linalg.norm(centre) / np.linalg.norm(expected) > 0.99
    bright = lattice.directions[light > 1.0] @ (expected / np.linalg.norm(expected))
    assert len(bright) > 10 and bright.min() > 0.7


def test_under_constant_light_truth_gives_that_light():
    scene = empty_scene()
    set_world(scene, (0.25, 0.5, 0.75))
    light = light_at(scene, POSITION, exposure=1.2)
    expected = np.zeros((9, 3))
    expected[0] = 2 * np.sqrt(np.pi) * np.array([0.25, 0.5, 0.75]) * 1.2
    # Rays on the rim of the mirror ball meet it or not: some thousandths of the light.
    for target in ("ldr", "hdr"):
        np.testing.assert_allclose(light.measured.of(target), expected, atol=2e-2)
    np.testing.assert_allclose(light.panorama, np.broadcast_to([0.25, 0.5, 0.75], light.panorama.shape), rtol=0.3)


def test_a_probe_close_above_a_surface_sees_it():
    scene = empty_scene()
    set_world(scene)
    box(scene, "Glowing floor", (0, 0, -0.5), (10, 10, 1), material("Glow", (1, 1, 1), emission=1.0))
    panorama = light_at(scene, (0, 0, 0.03)).panorama
    middle = len(panorama) // 2
    assert panorama[middle + 3 :].min() > 0.7 and panorama[: middle - 3].max() < 0.05


@pytest.mark.slow
def test_the_targets_differ_only_where_light_is_brighter_than_white():
    scene = room_with_one_glowing_side(0, 1)
    dim, bright = (light_at(scene, POSITION, exposure).measured for exposure in (1.0, 5.0))
    np.testing.assert_allclose(dim.ldr, dim.hdr, atol=0.02 * np.linalg.norm(dim.hdr))
    assert bright.hdr[0, 0] > 2.5 * bright.ldr[0, 0]
    np.testing.assert_allclose(bright.hdr, 5 * dim.hdr, rtol=1e-5, atol=1e-5)
