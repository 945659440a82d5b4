"""Does each engine's own published formula, fed with what we export, give the irradiance that we mean?

The formulas are written here from the engines' sources, see docs/platforms.md; what they are fed with is not used to
write them. `addon_tests/engines/prove.py` renders in the engines themselves.
"""

from dataclasses import replace

import numpy as np
import pytest

from xihenet.light.environments import laid_out
from xihenet.light.key_light import sh_of_key_light
from xihenet.light.platforms import PLATFORMS, coefficients_for, convention_of, main_light_for, soft_light
from xihenet.panorama import panorama_directions
from xihenet.records import KeyLight, ObjectLight
from xihenet.sh import irradiance

SIGNS = np.array([1, -1, 1, -1, 1, -1, 1, -1, 1.0])
K = (0.282095, 0.488603, 0.488603, 0.488603, 1.092548, 1.092548, 0.315392, 1.092548, 0.546274)


def polynomials(n):
    x, y, z = n.T
    return np.stack([np.ones_like(x), y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y], axis=1)


def by_three(c, n):
    """`SphericalHarmonics3.getIrradianceAt` over pi."""
    x, y, z = n.T[..., None]
    first = 0.886227 * c[0] + 2 * 0.511664 * (c[1] * y + c[2] * z + c[3] * x)
    second = 2 * 0.429043 * (c[4] * x * y + c[5] * y * z + c[7] * x * z) + c[6] * (0.743125 * z * z - 0.247708)
    return (first + second + 0.429043 * c[8] * (x * x - y * y)) / np.pi


def by_filament(c, n):
    """The shader's sum over what `irradiance(3)` is given."""
    return polynomials(n) @ c


def by_condon_shortley_radiance(c, n):
    """Unreal's `CalcDiffuseTransfer`, Filament's `radiance(3)`, Babylon's two conversions: signed basis, lobe."""
    lobes = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4], [1, 3, 5])
    return (polynomials(n) * K * SIGNS * lobes) @ c / np.pi


def by_unity(c, n):
    """`SphericalHarmonicsL2.Evaluate`."""
    x, y, z = n.T[..., None]
    first = c[0] - c[6] + c[3] * x + c[1] * y + c[2] * z
    return first + c[4] * x * y + c[5] * y * z + 3 * c[6] * z * z + c[7] * x * z + c[8] * (x * x - y * y)


def by_hello_ar(c, n):
    """`environmental_hdr.frag` of ARCore's Java sample, over pi as its factors are."""
    factors = (0.282095, -0.325735, 0.325735, -0.325735, 0.273137, -0.273137, 0.078848, -0.273137, 0.136569)
    return (polynomials(n) * factors) @ c


def by_sceneform(c, n):
    """The same with coefficients 6 and 7 in each other's place."""
    return by_hello_ar(c[[0, 1, 2, 3, 4, 5, 7, 6, 8]], n)


def by_gltf_in_babylon(c, n):
    """Irradiance coefficients, divided by pi, in a signed basis."""
    return (polynomials(n) * K * SIGNS) @ c / np.pi


def by_gltf_positive(c, n):
    return (polynomials(n) * K) @ c / np.pi


EVALUATIONS = [
    ("three", None, by_three, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("webxr", None, by_three, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("webxr", "condon-shortley", by_condon_shortley_radiance, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("openxr", None, by_three, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("babylon", None, by_condon_shortley_radiance, lambda n: np.stack([-n[:, 0], n[:, 2], -n[:, 1]], 1)),
    # Its shader turns the normal's z round in a right-handed scene (REFLECTIONMAP_OPPOSITEZ).
    ("babylon", "right-handed", by_condon_shortley_radiance, lambda n: np.stack([n[:, 0], n[:, 2], n[:, 1]], 1)),
    ("filament", None, by_filament, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("filament", "radiance", by_condon_shortley_radiance, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("unity", None, by_unity, lambda n: np.stack([n[:, 0], n[:, 2], n[:, 1]], 1)),
    ("unity", "fbx", by_unity, lambda n: np.stack([-n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("unreal", None, by_condon_shortley_radiance, lambda n: np.stack([n[:, 0], -n[:, 1], n[:, 2]], 1)),
    ("arcore", None, by_hello_ar, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("arcore", "positive", by_three, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("arcore", "sceneform", by_sceneform, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("arkit", None, by_three, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("arkit", "unity", by_filament, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
    # Its loader turns objects, and so normals, for a left-handed scene, but not coefficients.
    ("gltf", None, by_gltf_in_babylon, lambda n: np.stack([-n[:, 0], n[:, 2], -n[:, 1]], 1)),
    ("gltf", "right-handed", by_gltf_in_babylon, lambda n: np.stack([n[:, 0], n[:, 2], n[:, 1]], 1)),
    ("gltf", "positive", by_gltf_positive, lambda n: np.stack([n[:, 0], n[:, 2], -n[:, 1]], 1)),
]  # platform, reading, the engine's formula, and Blender's normals in its axes


def normals(rng, n=64):
    found = rng.normal(size=(n, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def stored(light, convention):
    flat = coefficients_for(light, convention)
    return flat.reshape(3, 9).T if convention.by_colour else flat.reshape(9, 3)


@pytest.mark.parametrize(("platform", "reading", "formula", "turned"), EVALUATIONS)
def test_the_engines_formula_gives_the_irradiance(platform, reading, formula, turned):
    rng = np.random.default_rng(7)
    light, n, convention = rng.normal(size=(9, 3)), normals(rng), convention_of(platform, reading)
    found = formula(stored(light, convention), turned(n))
    np.testing.assert_allclose(found, irradiance(light, n) / np.pi, atol=2e-5)


def test_every_reading_is_held_against_a_formula():
    named = {(platform, reading or next(iter(PLATFORMS[platform].readings))) for platform, reading, *_ in EVALUATIONS}
    take_coefficients = {name: one for name, one in PLATFORMS.items() if one.picture is None}
    assert named == {(name, reading) for name, one in take_coefficients.items() for reading in one.readings}


@pytest.mark.parametrize("reading", [(name, reading) for name, one in PLATFORMS.items() for reading in one.readings])
def test_axes_keep_lengths_and_what_is_up(reading):
    convention = convention_of(*reading)
    np.testing.assert_allclose(convention.axes @ convention.axes.T, np.eye(3), atol=1e-12)
    is_z_up = "Z up" in convention.axes_text
    assert (convention.axes @ [0, 0, 1]).tolist() == ([0, 0, 1] if is_z_up else [0, 1, 0])
    assert (np.linalg.det(convention.axes) < 0) == ("left-handed" in convention.axes_text)


KEY = KeyLight(np.array([0.0, -0.6, 0.8]), np.array([2.0, 1.0, 0.5]), 0.1, True)


def test_a_key_light_is_taken_out_as_the_page_of_the_edge_service_says():
    x, y, z = KEY.direction
    polynomials = np.array([1, y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y])
    cosine = np.cos(KEY.angular_radius)
    by_band = np.repeat([2 / (1 + cosine), 1, cosine], [1, 3, 5])
    np.testing.assert_allclose(sh_of_key_light(KEY), np.outer(K * polynomials * by_band, KEY.irradiance), atol=1e-5)


def test_what_is_apart_and_what_is_left_are_the_light_once():
    light = ObjectLight(np.random.default_rng(0).normal(size=(9, 3)), KEY)
    np.testing.assert_allclose(soft_light(light, PLATFORMS["three"]) + sh_of_key_light(KEY), light.sh)
    np.testing.assert_allclose(soft_light(light, PLATFORMS["model-viewer"]), light.sh)
    assert soft_light(replace(light, key=None), PLATFORMS["three"]).tolist() == light.sh.tolist()


def test_the_main_light_points_where_the_engine_has_it():
    light = ObjectLight(np.zeros((9, 3)), KEY)
    to_light = main_light_for(light, convention_of("three"))
    travel = main_light_for(light, convention_of("filament"))
    np.testing.assert_allclose(to_light.direction, (0, 0.8, 0.6))
    np.testing.assert_allclose(travel.direction, (0, -0.8, -0.6))
    assert (to_light.colour, to_light.intensity) == ((1.0, 0.5, 0.25), 2.0)
    np.testing.assert_allclose(main_light_for(light, convention_of("unity")).direction, (0, -0.8, 0.6))
    assert main_light_for(light, convention_of("unity")).intensity == pytest.approx(2 / np.pi)


@pytest.mark.parametrize("brightness", [0.01, 0.5, 1.0, np.pi, 40.0])
def test_a_colour_that_the_engine_takes_to_a_power_comes_out_as_it_was_meant(brightness):
    light = ObjectLight(np.zeros((9, 3)), replace(KEY, irradiance=KEY.irradiance * brightness))
    main = main_light_for(light, convention_of("playcanvas"))
    # PlayCanvas makes the colour linear before it is multiplied from 1 on, and after it below.
    colour, above = np.array(main.colour), main.intensity >= 1
    linear = colour**2.2 * main.intensity if above else (colour * main.intensity) ** 2.2
    np.testing.assert_allclose(linear * np.pi, light.key.irradiance)
    assert colour.max() <= 1 + 1e-12


def test_godot_looks_light_up_in_the_picture_of_usd_where_it_comes_from():
    """Its sky shader's `panorama_coords`, from the direction with +Y up."""
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = directions[:, 0], directions[:, 2], -directions[:, 1]
    u, v = np.arctan2(x, -z) % (2 * np.pi) / (2 * np.pi), np.arccos(y) / np.pi
    picture = laid_out(panorama_directions(256, 512), PLATFORMS["usd"].picture)
    np.testing.assert_allclose(picture[(v * 256).astype(int), (u * 512).astype(int)], directions, atol=0.02)


@pytest.mark.parametrize("key", [None, replace(KEY, irradiance=np.zeros(3))])
def test_where_there_is_no_key_light_there_is_no_main_light(key):
    assert main_light_for(ObjectLight(np.zeros((9, 3)), key), convention_of("three")) is None


@pytest.mark.parametrize(
    ("platform", "reading", "words"),
    [
        ("threejs", None, "there is no platform 'threejs'; choose one of three, babylon"),
        ("unity", "left", "unity has no reading 'left'; choose one of ar-foundation, fbx"),
        ("model-viewer", None, "takes a picture"),
    ],
)
def test_what_there_is_not_is_refused(platform, reading, words):
    with pytest.raises(ValueError, match=words):
        convention_of(platform, reading)


@pytest.mark.parametrize("wrong", [np.zeros((4, 2)), np.full((9, 3), np.nan)])
def test_what_is_no_light_is_refused(wrong):
    with pytest.raises(ValueError, match="spherical harmonics"):
        coefficients_for(wrong, convention_of("unity"))
