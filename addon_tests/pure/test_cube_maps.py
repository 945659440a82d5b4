"""Cube maps of glTF files: does a reader that looks up as OpenGL and Babylon.js do get light from where it comes?

`addon_tests/engines/prove.py` has Babylon.js itself read them.
"""

import base64
import json

import numpy as np
import pytest

from addon_tests.pure.test_png import decode_png
from xihenet.light.cube_maps import cube_levels, encode_rgbd
from xihenet.light.environments import disc_picture
from xihenet.light.exports import NamedLight, export_files
from xihenet.panorama import panorama_directions, solid_angles
from xihenet.records import KeyLight, ObjectLight

SH = np.eye(9)[0][:, None] * np.ones(3)
# OpenGL ES 3.0, table 3.21: by face the major axis with its sign, and what s and t grow with.
OPENGL = [row.split() for row in ("+x -z -y", "-x +z -y", "+y +x +z", "-y +x -z", "+z +x -y", "-z -x -y")]


def along(signed_axis, directions):
    return directions[..., "xyz".index(signed_axis[1])] * (1 if signed_axis[0] == "+" else -1)


def unpacked(png):
    """As Babylon.js reads RGBD."""
    rgbd = decode_png(png) / 255
    return rgbd[..., :3] ** 2.2 / rgbd[..., 3:]


def levels_of(document):
    """(6, S, S, 3) of each level of a glTF file, rows as Babylon.js turns them: each face upside down."""
    files = [base64.b64decode(image["uri"].removeprefix("data:image/png;base64,")) for image in document["images"]]
    (light,) = document["extensions"]["EXT_lights_image_based"]["lights"]
    levels = [np.stack([unpacked(files[image])[::-1] for image in faces]) for faces in light["specularImages"]]
    assert light["specularImageSize"] == levels[0].shape[1]
    return levels


def looked_up(faces, directions):
    majors = np.stack([along(major, directions) for major, _, _ in OPENGL])
    face, side = majors.argmax(axis=0), faces.shape[1]
    s, t = (np.choose(face, [along(row[index], directions) for row in OPENGL]) / majors.max(axis=0) for index in (1, 2))
    column, row = (np.minimum((one + 1) / 2 * side, side - 1).astype(int) for one in (s, t))
    return faces[face, row, column]


def coloured(directions):
    """Another colour from everywhere, and up to almost four times as bright as white."""
    return 2 + 1.8 * directions


@pytest.mark.parametrize(
    ("reading", "in_reader"),
    [
        (None, lambda d: np.stack([-d[:, 0], d[:, 2], -d[:, 1]], 1)),
        ("right-handed", lambda d: np.stack([d[:, 0], d[:, 2], d[:, 1]], 1)),
        ("positive", lambda d: np.stack([d[:, 0], d[:, 2], -d[:, 1]], 1)),
    ],
)
def test_every_level_has_the_light_from_where_it_comes_and_as_bright(reading, in_reader):
    panorama = coloured(panorama_directions(128, 256))
    files = export_files([NamedLight("Ball", 1, 0.0, ObjectLight(SH), panorama)], "gltf", reading=reading)
    directions = np.random.default_rng(2).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    levels = levels_of(json.loads(files["Ball_0001.gltf"]))
    assert [faces.shape[1] for faces in levels] == [32, 16, 8, 4]
    for level, faces in enumerate(levels):
        # Babylon.js looks alpha up at log2(32 alpha) / 5 of the last level, on.
        alpha = 0 if level == 0 else 2 ** (5 * level / 3) / 32
        cosine = (np.arange(100_000) + 0.5) / 100_000
        lobe = cosine / (1 - (1 - alpha**2) * (1 + cosine) / 2) ** 2 if alpha else cosine >= cosine[-1]
        kept = (cosine * lobe).sum() / lobe.sum()
        found = looked_up(faces, in_reader(directions))
        # A texel is wide.
        np.testing.assert_allclose(found, 2 + 1.8 * kept * directions, atol=0.08 * 2**level)
        np.testing.assert_allclose(found.mean(), 2, rtol=0.03)
        np.testing.assert_allclose(((found - 2) * directions).sum() / len(directions), 1.8 * kept, rtol=0.05)


def test_light_that_is_the_same_from_everywhere_stays_so():
    for faces in cube_levels(np.full((16, 32, 3), 7.0)):
        np.testing.assert_allclose(faces, 7.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_lamp_keeps_its_light_between_texels(seed):
    direction = np.random.default_rng(seed).normal(size=3)
    lamp = KeyLight(direction / np.linalg.norm(direction), np.array([3.0, 2.0, 1.0]), 0.02, True)
    panorama = disc_picture(lamp, 128)
    faces = cube_levels(panorama)[0]
    places = (np.arange(32) + 0.5) / 16 - 1
    across, down = np.meshgrid(places, places)
    texels = (1 + across**2 + down**2) ** -1.5 / 16**2
    sent = (panorama * solid_angles(128, 256)[..., None]).sum(axis=(0, 1))
    np.testing.assert_allclose((faces * texels[..., None]).sum(axis=(0, 1, 2)), sent, rtol=0.15)


def test_what_is_brighter_than_white_is_unpacked_as_it_was():
    radiance = np.exp(np.random.default_rng(0).uniform(-4, 5, size=(64, 64, 1))) * (1.0, 0.6, 0.3)
    rgbd = encode_rgbd(radiance) / 255
    found = rgbd[..., :3] ** 2.2 / rgbd[..., 3:]
    assert np.abs(found / radiance - 1)[radiance > 0.05].max() < 0.1 and np.abs(found / radiance - 1).mean() < 0.02
    assert encode_rgbd(np.array([[300.0, 0, 0], [0, 0, 0]])).tolist() == [[255, 0, 0, 1], [0, 0, 0, 255]]
