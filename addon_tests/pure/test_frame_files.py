"""A frame from files: what was written comes back, and what does not fit together is refused."""

import json
import struct
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageCms

from addon_tests.pure.commands import fresh_python
from addon_tests.pure.frame_makers import (
    HEIGHT,
    INTRINSICS,
    LOOKING_ALONG_Y,
    NEEDS_OPENEXR,
    WIDTH,
    box_radiance_and_plane_depth,
    colour_profile,
    png,
    write_by_package,
    write_camera,
    write_channels,
    write_exr,
    write_image,
)
from addon_tests.pure.made import pose_of, random_rotation
from xihenet.camera import encode_exposed, unproject_frame, valid_plane_depth
from xihenet.colour import LUMINANCE, linear_to_srgb, srgb_to_linear
from xihenet.io import exr, frame_files, image_files, openexr_package
from xihenet.io.frame_files import read_camera, read_frame
from xihenet.io.image_files import area_averaged, read_plane_depth
from xihenet.phone.metering import KEY_LUMINANCE

RADIANCE, PLANE_DEPTH_M = box_radiance_and_plane_depth()
MILLIMETRES = np.rint(PLANE_DEPTH_M * 1000).astype(np.uint16)


@pytest.fixture
def camera(tmp_path):
    return read_camera(write_camera(tmp_path / "camera.json"))


@pytest.fixture
def plane_depth(tmp_path):
    return write_image(tmp_path / "plane_depth.png", MILLIMETRES)


# ------------------------------------------------------------------------------------------------------------- OpenEXR


@pytest.mark.parametrize(
    ("colour", "plane_depth"),
    [
        ("{}", "Z"),
        ("Combined.{}", "Depth.V"),
        ("{}", "Depth.Z"),
        ("ViewLayer.Combined.{}", "ViewLayer.Depth.Z"),
        ("Layer.with.dots.Combined.{}", "Layer.with.dots.Depth.V"),
        ("beauty.{}", "beauty.Z"),
    ],
)
def test_an_exr_comes_back_whatever_its_channels_are_called(tmp_path, camera, colour, plane_depth):
    path = write_exr(tmp_path / "frame.exr", RADIANCE, PLANE_DEPTH_M, colour, plane_depth)
    frame = read_frame(path, camera, exposure=0.5)
    np.testing.assert_array_equal(frame.srgb_u8, encode_exposed(RADIANCE, 0.5))
    np.testing.assert_array_equal(frame.plane_depth_m, PLANE_DEPTH_M)
    np.testing.assert_array_equal(frame.world_from_camera, LOOKING_ALONG_Y)
    assert (frame.exposure, frame.intrinsics) == (0.5, INTRINSICS)


def test_other_passes_and_other_layers_do_not_get_in_the_way(tmp_path, camera):
    dark, far = RADIANCE * 0, PLANE_DEPTH_M + 1
    channels = {f"A.Combined.{c}": dark[..., 0] for c in "RGBA"}  # a layer without plane depth
    channels |= {f"B.Combined.{c}": RADIANCE[..., index] for index, c in enumerate("RGB")}
    channels |= {f"B.DiffCol.{c}": dark[..., 0] for c in "RGB"} | {"B.Depth.Z": PLANE_DEPTH_M, "C.Depth.Z": far}
    frame = read_frame(write_channels(tmp_path / "frame.exr", channels), camera, exposure=1)
    np.testing.assert_array_equal(frame.srgb_u8, encode_exposed(RADIANCE, 1))
    np.testing.assert_array_equal(frame.plane_depth_m, PLANE_DEPTH_M)


def write_parts(path, colour, plane_depth_m):
    """One part per pass, as Blender 5.x writes it."""
    import OpenEXR

    passes = {"ViewLayer.Combined": dict(zip("RGB", np.moveaxis(colour, -1, 0), strict=True))}
    passes["ViewLayer.Depth"] = {"Z": plane_depth_m}
    corners = np.array([[0, 0], [WIDTH - 1, HEIGHT - 1]], np.int32)
    display = {"displayWindow": tuple(corners)}
    parts = [
        OpenEXR.Part(dict(display), {f"{name}.{c}": np.ascontiguousarray(v) for c, v in channels.items()}, name)
        for name, channels in passes.items()
    ]
    with OpenEXR.File(parts) as file:
        file.write(str(path))
    return path


@NEEDS_OPENEXR
def test_an_exr_with_a_part_for_each_pass_is_read(tmp_path, camera):
    frame = read_frame(write_parts(tmp_path / "frame.exr", RADIANCE, PLANE_DEPTH_M), camera, exposure=1)
    np.testing.assert_array_equal(frame.srgb_u8, encode_exposed(RADIANCE, 1))
    np.testing.assert_array_equal(frame.plane_depth_m, PLANE_DEPTH_M)


@NEEDS_OPENEXR
def test_parts_of_different_sizes_are_refused(tmp_path, camera):
    path = write_parts(tmp_path / "frame.exr", RADIANCE, PLANE_DEPTH_M[:12, :16])
    with pytest.raises(ValueError, match="colour and plane depth of one size"):
        read_frame(path, camera)


@NEEDS_OPENEXR
@pytest.mark.parametrize("compression", ["ZIP_COMPRESSION", "PIZ_COMPRESSION"])
def test_of_parts_with_channels_of_one_name_the_first_counts(tmp_path, camera, compression):
    import OpenEXR

    parts = []
    for name, step in (("beauty", 1), ("diffuse", 2)):
        colour = dict(zip("RGB", np.moveaxis(step * RADIANCE[::step, ::step], -1, 0), strict=True))
        channels = colour | {"Z": PLANE_DEPTH_M[::step, ::step]}
        whole = np.array([0, 0], np.int32), np.array([WIDTH - 1, HEIGHT - 1], np.int32)
        header = {"compression": getattr(OpenEXR, compression), "displayWindow": whole}
        parts.append(OpenEXR.Part(header, {c: np.ascontiguousarray(v) for c, v in channels.items()}, name))
    with OpenEXR.File(parts) as file:
        file.write(str(path := tmp_path / "frame.exr"))
    np.testing.assert_array_equal(read_frame(path, camera, exposure=1).srgb_u8, encode_exposed(RADIANCE, 1))


def test_a_part_of_a_picture_has_no_intrinsics_of_the_whole_one(tmp_path, camera):
    """Half of it in the middle, which has the field's ratio of width to height."""
    middle = np.s_[HEIGHT // 4 : HEIGHT // 4 + HEIGHT // 2, WIDTH // 4 : WIDTH // 4 + WIDTH // 2]
    path = write_exr(tmp_path / "frame.exr", RADIANCE[middle], PLANE_DEPTH_M[middle])
    content = path.read_bytes()
    window, whole = (struct.pack("<4i", 0, 0, w - 1, h - 1) for w, h in ((WIDTH // 2, HEIGHT // 2), (WIDTH, HEIGHT)))
    display = b"displayWindow\0box2i\0" + struct.pack("<i", 16)
    assert display + window in content
    path.write_bytes(content.replace(display + window, display + whole))
    with pytest.raises(ValueError, match=f"has {WIDTH // 2}x{HEIGHT // 2} pixels of a picture of {WIDTH}x{HEIGHT}"):
        read_frame(path, camera)
    own = write_camera(tmp_path / "own.json", width=WIDTH // 2, height=HEIGHT // 2, cx=12.0, cy=9.0)
    assert read_frame(path, read_camera(own)).intrinsics.cx == 12.0


def write_in(space, colour, path):
    channels = {name: np.full_like(PLANE_DEPTH_M, value) for name, value in zip("RGB", colour, strict=True)}
    exr.write_exr(path, channels | {"Z": PLANE_DEPTH_M}, attributes={"colorInteropID": space})
    return path


@pytest.mark.parametrize(
    ("space", "colour"),
    [
        ("lin_rec709_scene", (1.0, 0.25, 0.05)),
        ("lin_rec2020_scene", (0.7118900, 0.2995500, 0.0831700)),  # As Blender 5.2 renders the same background
        ("lin_ap1_scene", (0.7003500, 0.2999500, 0.0914900)),
    ],
)
def test_an_exr_that_says_in_which_space_its_colour_is_becomes_rec709(tmp_path, camera, space, colour):
    frame = read_frame(write_in(space, colour, tmp_path / "frame.exr"), camera, exposure=1)
    assert frame.srgb_u8[0, 0].tolist() == encode_exposed(np.float32([[(1.0, 0.25, 0.05)]]), 1)[0, 0].tolist()


AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)


@NEEDS_OPENEXR
@pytest.mark.parametrize("space", [*exr.CHROMATICITIES, "AP0"])
@pytest.mark.parametrize("said", [{}, {"colorInteropID": "unknown"}], ids=["no space", "an unknown one"])
def test_an_exr_that_gives_chromaticities_in_place_of_a_space_is_read_by_these(tmp_path, camera, space, said):
    import OpenEXR

    colour = (0.7, 0.3, 0.09)
    channels = {name: np.full_like(PLANE_DEPTH_M, value) for name, value in zip("RGB", colour, strict=True)}
    said = {"chromaticities": exr.CHROMATICITIES.get(space, AP0), **said}
    with OpenEXR.File(said, channels | {"Z": PLANE_DEPTH_M}) as file:
        file.write(str(path := tmp_path / "frame.exr"))
    if space == "AP0":
        with pytest.raises(ValueError, match=r"of primaries at 0\.7347, .* save it in linear Rec\.709"):
            read_frame(path, camera)
        return
    named = read_frame(write_in(space, colour, tmp_path / "named.exr"), camera, exposure=1)
    np.testing.assert_array_equal(read_frame(path, camera, exposure=1).srgb_u8, named.srgb_u8)


@pytest.mark.parametrize("space", ["lin_rec2020_scene", "lin_ap1_scene"])
def test_an_infinite_colour_is_white_in_every_space(tmp_path, camera, space):
    frame = read_frame(write_in(space, (np.inf, np.inf, np.inf), tmp_path / "frame.exr"), camera, exposure=1)
    assert (frame.srgb_u8 == 255).all() and frame.invalid == {"infinite_colour": PLANE_DEPTH_M.size}


def test_an_exr_in_a_space_that_is_not_known_is_refused(tmp_path, camera):
    path = write_in("lin_ap0_scene", (1.0, 0.25, 0.05), tmp_path / "frame.exr")
    with pytest.raises(ValueError, match="its colours are 'lin_ap0_scene': save it in linear"):
        read_frame(path, camera, exposure=1)


@pytest.mark.parametrize("gain", [1e-3, 1.0, 50.0])
def test_an_exr_is_metered_so_that_its_own_brightness_does_not_matter(tmp_path, camera, gain):
    frame = read_frame(write_exr(tmp_path / "frame.exr", RADIANCE * np.float32(gain), PLANE_DEPTH_M), camera)
    luminance = srgb_to_linear(frame.srgb_u8 / 255) @ LUMINANCE
    assert np.exp(np.log(luminance).mean()) == pytest.approx(KEY_LUMINANCE, rel=0.02)


def test_broken_pixels_disturb_neither_metering_nor_the_rest_of_the_frame(tmp_path, camera):
    broken, holes = RADIANCE.copy(), PLANE_DEPTH_M.copy()
    broken[0, :4, 0] = [np.nan, np.inf, -np.inf, -1]
    holes[1, :6] = [np.nan, np.inf, -np.inf, -1, 0, 1e10]
    whole = read_frame(write_exr(tmp_path / "whole.exr", RADIANCE, PLANE_DEPTH_M), camera)
    frame = read_frame(write_exr(tmp_path / "broken.exr", broken, holes), camera)
    assert frame.exposure == pytest.approx(whole.exposure, rel=0.02)
    assert not valid_plane_depth(frame.plane_depth_m[1, :6]).any()
    np.testing.assert_array_equal(frame.plane_depth_m[2:], PLANE_DEPTH_M[2:])


@pytest.mark.parametrize(
    ("channels", "said"),
    [
        ({"Z": PLANE_DEPTH_M}, "expected colour"),
        (dict.fromkeys("RGBA", PLANE_DEPTH_M), "save the Z pass"),
        (dict.fromkeys("RG", PLANE_DEPTH_M) | {"Z": PLANE_DEPTH_M}, "expected colour"),
        (dict.fromkeys("RGB", PLANE_DEPTH_M) | {"Z": PLANE_DEPTH_M * 0}, "no pixel has a valid plane depth"),
        (dict.fromkeys("RGB", PLANE_DEPTH_M) | {"Z": PLANE_DEPTH_M * np.nan}, "no pixel has a valid plane depth"),
        (dict.fromkeys("RGB", PLANE_DEPTH_M) | {"Z": PLANE_DEPTH_M + 1e10}, "no pixel has a valid plane depth"),
        (dict.fromkeys("RGB", PLANE_DEPTH_M * np.nan) | {"Z": PLANE_DEPTH_M}, "the colour is NaN wherever there is"),
        (dict.fromkeys("RGBZ", PLANE_DEPTH_M[:, :20]), "the intrinsics are for 32x24"),
    ],
)
def test_an_exr_that_is_no_frame_is_refused(tmp_path, camera, channels, said):
    with pytest.raises(ValueError, match=said):
        read_frame(write_channels(tmp_path / "frame.exr", channels), camera)


@NEEDS_OPENEXR
@pytest.mark.parametrize("compression", ["PIZ", "DWAA", "RLE", "HTJ2K256", "ZSTD"])
def test_an_exr_of_another_compression_is_read_by_the_openexr_package(tmp_path, camera, compression, monkeypatch):
    values = {c: RADIANCE[..., index] for index, c in enumerate("RGB")} | {"Z": PLANE_DEPTH_M}
    path = write_by_package(tmp_path / "frame.exr", values, compression)
    frame = read_frame(path, camera, exposure=1)
    np.testing.assert_allclose(frame.plane_depth_m, PLANE_DEPTH_M, rtol=1e-2)
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(ValueError, match=f"its compression, {compression}, .*with ZIP compression, or pip install"):
        read_frame(path, camera)


def test_an_exr_takes_no_second_plane_depth(tmp_path, camera):
    path = write_exr(tmp_path / "frame.exr", RADIANCE, PLANE_DEPTH_M)
    with pytest.raises(ValueError, match="brings its own plane depth"):
        read_frame(path, camera, plane_depth=path)


# -------------------------------------------------------------------------------------------------------------- images


def image_frame(tmp_path, camera, colour, plane_depth=MILLIMETRES, **options):
    colour_path = write_image(tmp_path / "colour.png", colour)
    return read_frame(
        colour_path, camera, plane_depth=write_image(tmp_path / "plane_depth.png", plane_depth), **options
    )


def test_images_of_one_size_come_back_byte_by_byte(tmp_path, camera):
    colour = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    frame = image_frame(tmp_path, camera, colour)
    np.testing.assert_array_equal(frame.srgb_u8, colour)
    np.testing.assert_allclose(frame.plane_depth_m, MILLIMETRES / 1000, rtol=1e-6)
    assert frame.exposure == 1.0
    np.testing.assert_allclose(frame.ambient, srgb_to_linear(colour / 255).mean(axis=(0, 1)))


def test_images_and_an_exr_of_the_same_scene_are_the_same_frame(tmp_path, camera):
    exr = read_frame(write_exr(tmp_path / "frame.exr", RADIANCE, PLANE_DEPTH_M), camera, exposure=0.7)
    images = image_frame(tmp_path, camera, encode_exposed(RADIANCE, 0.7), exposure=0.7)
    np.testing.assert_array_equal(images.srgb_u8, exr.srgb_u8)
    np.testing.assert_allclose(images.plane_depth_m, exr.plane_depth_m, atol=5.1e-4)
    np.testing.assert_allclose(images.ambient, exr.ambient)


def test_the_scale_of_the_plane_depth_is_metres_per_unit(tmp_path, camera):
    colour = encode_exposed(RADIANCE, 1)
    in_metres = image_frame(tmp_path, camera, colour, np.full((HEIGHT, WIDTH), 2, np.uint16), depth_scale=1.0)
    assert (in_metres.plane_depth_m == 2).all()
    with pytest.raises(ValueError, match="no pixel has a valid plane depth"):
        image_frame(tmp_path, camera, colour, np.full((HEIGHT, WIDTH), 2, np.uint16), depth_scale=1e300)


def test_plane_depth_of_16_bits_keeps_its_largest_value_and_its_holes(tmp_path, camera):
    plane_depth = np.full((HEIGHT, WIDTH), 65534, np.uint16)
    plane_depth[0], plane_depth[1] = 0, 65535
    frame = image_frame(tmp_path, camera, encode_exposed(RADIANCE, 1), plane_depth)
    np.testing.assert_allclose(frame.plane_depth_m[2:], 65.534, rtol=1e-6)
    assert not frame.plane_depth_m[:2].any() and frame.invalid == {"no_distance": 2 * WIDTH}
    np.testing.assert_array_equal(unproject_frame(frame).grid.openings, np.arange(2 * WIDTH))


@pytest.mark.parametrize("white", [300, 10_000, 65_535])
@pytest.mark.parametrize("is_text", [False, True])
def test_plane_depth_as_pgm_is_what_stands_there_whatever_is_said_to_be_white(tmp_path, white, is_text):
    stored = np.array([[0, 255, 300], [256, 299, white]], np.uint16)
    kind, numbers = ("P2", stored.tolist()) if is_text else ("P5", stored.astype(">u2").tobytes())
    content = str(numbers).translate(str.maketrans("[],", "   ")).encode() if is_text else numbers
    path = tmp_path / "depth.pgm"
    path.write_bytes(f"{kind}\n# of a tool\n3 2\n{white}\n".encode() + content)
    np.testing.assert_array_equal(read_plane_depth(path, 1.0)[0], np.where(stored == 65_535, 0, stored))


@pytest.mark.parametrize("factor", [1, 2, 7.5])
def test_colour_of_another_size_is_averaged_in_linear_light(tmp_path, camera, factor):
    size = (round(HEIGHT * factor), round(WIDTH * factor))
    stripes = np.zeros((*size, 3), np.uint8)
    stripes[::2] = 255
    frame = image_frame(tmp_path, camera, stripes)
    if factor == 2:
        assert (frame.srgb_u8 == round(float(linear_to_srgb(0.5)) * 255)).all()
    share = stripes[..., 0].mean() / 255
    assert srgb_to_linear(frame.srgb_u8 / 255).mean() == pytest.approx(share, abs=3e-3)


def test_intrinsics_of_the_colour_image_serve_the_smaller_plane_depth(tmp_path):
    large = {"width": 320, "height": 240, "fx": 200.0, "fy": 200.0, "cx": 160.0, "cy": 120.0}
    camera = read_camera(write_camera(tmp_path / "camera.json", **large))
    frame = image_frame(tmp_path, camera, np.full((240, 320, 3), 90, np.uint8))
    assert frame.intrinsics == INTRINSICS
    assert (frame.srgb_u8 == 90).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), *(st.integers(1, 9) for _ in range(4)))
def test_area_averaging_equals_averaging_a_finely_repeated_image(seed, height, width, new_height, new_width):
    image = np.random.default_rng(seed).random((height, width, 3))
    fine = image.repeat(new_height, axis=0).repeat(new_width, axis=1)
    expected = fine.reshape(new_height, height, new_width, width, 3).mean(axis=(1, 3))
    strips = np.array_split(image, np.unique(np.random.default_rng(seed).integers(1, height + 1, 3)))
    averaged = area_averaged((strip for strip in strips if len(strip)), height, new_height, new_width)
    np.testing.assert_allclose(averaged, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "mode"), [("tiff", "L"), ("tiff", "RGBA"), ("tiff", "P"), ("tiff", "LA"), ("tiff", "CMYK"), ("jpg", "RGB")]
)
def test_colour_images_of_other_kinds_are_read(tmp_path, camera, plane_depth, kind, mode):
    path = tmp_path / f"colour.{kind}"
    Image.fromarray(np.full((HEIGHT, WIDTH, 3), 102, np.uint8)).convert(mode).save(path)
    frame = read_frame(path, camera, plane_depth=plane_depth)
    assert (np.abs(frame.srgb_u8.astype(int) - 102) <= 1).all()


COLOUR = encode_exposed(RADIANCE, 1)

# Columns: red, green and blue by XYZ, adapted to D50.
SRGB_TO_XYZ = np.array([[0.4361, 0.3851, 0.1431], [0.2225, 0.7169, 0.0606], [0.0139, 0.0971, 0.7141]])
P3_TO_XYZ = np.array([[0.5151, 0.2920, 0.1571], [0.2412, 0.6922, 0.0666], [-0.0011, 0.0419, 0.7841]])


@pytest.mark.parametrize("times", [1, 3])
@pytest.mark.parametrize(("kind", "mode"), [("png", "RGB"), ("png", "P"), ("jpg", "RGB"), ("tiff", "RGB")])
def test_colour_is_what_the_profile_of_an_image_says(tmp_path, camera, plane_depth, kind, mode, times):
    stored = np.full((times * HEIGHT, times * WIDTH, 3), (180, 110, 90), np.uint8)
    path = tmp_path / f"colour.{kind}"
    options = {"quality": 100, "subsampling": 0} if kind == "jpg" else {}
    Image.fromarray(stored).convert(mode, palette=Image.Palette.ADAPTIVE).save(
        path, icc_profile=colour_profile(P3_TO_XYZ, 2.2), **options
    )
    found = read_frame(path, camera, plane_depth=plane_depth).srgb_u8
    wide = (stored[0, 0] / 255) ** 2.2
    expected = 255 * linear_to_srgb(np.linalg.solve(SRGB_TO_XYZ, P3_TO_XYZ @ wide))
    assert expected[0] - stored[0, 0, 0] > 5 and np.abs(found - expected).max() < 2


@pytest.mark.parametrize(
    "profile",
    [
        b"none",
        colour_profile(P3_TO_XYZ, 2.2).replace(b"RGB ", b"\xffGB "),
        ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(),
    ],
)
def test_a_profile_of_srgb_and_one_that_cannot_be_read_change_nothing(tmp_path, camera, plane_depth, profile):
    path = tmp_path / "colour.png"
    Image.fromarray(COLOUR).save(path, icc_profile=profile)
    assert np.array_equal(read_frame(path, camera, plane_depth=plane_depth).srgb_u8, COLOUR)


@pytest.mark.parametrize(
    ("colour", "plane_depth", "options", "said"),
    [
        (COLOUR, MILLIMETRES.astype(np.uint8), {}, "expected a grey image of 16 bits"),
        (COLOUR, COLOUR, {}, "got pixels of mode RGB: save distances as whole numbers"),
        (MILLIMETRES, MILLIMETRES, {}, "expected a colour image of 8 bits"),
        (COLOUR, MILLIMETRES[:, :20], {}, "expected the same ratio"),
        (COLOUR[:20], MILLIMETRES, {}, "expected the same ratio"),
        (COLOUR[:, :20], MILLIMETRES[:, :20], {}, "the intrinsics are for 32x24"),
        (COLOUR, MILLIMETRES * 0, {}, "no pixel has a valid plane depth"),
        (COLOUR, MILLIMETRES, {"depth_scale": 0.0}, "depth scale"),
        (COLOUR, MILLIMETRES, {"depth_scale": np.nan}, "depth scale"),
        (COLOUR, MILLIMETRES, {"exposure": -1.0}, "exposure"),
        (COLOUR, MILLIMETRES, {"exposure": np.inf}, "exposure"),
    ],
)
def test_images_that_are_no_frame_are_refused(tmp_path, camera, colour, plane_depth, options, said):
    with pytest.raises(ValueError, match=said):
        image_frame(tmp_path, camera, colour, plane_depth, **options)


@pytest.mark.parametrize("n_bytes", [0, 5, 30, 60, 150])
def test_an_image_that_is_cut_short_is_refused(tmp_path, camera, plane_depth, n_bytes):
    path = write_image(tmp_path / "colour.png", np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8))
    path.write_bytes(path.read_bytes()[:n_bytes])
    with pytest.raises(ValueError, match=r"colour\.png: expected an image"):
        read_frame(path, camera, plane_depth=plane_depth)


def test_a_photo_that_is_stored_turned_is_refused(tmp_path, camera, plane_depth):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(COLOUR).save(tmp_path / "colour.jpg", exif=exif)
    with pytest.raises(ValueError, match="save it upright"):
        read_frame(tmp_path / "colour.jpg", camera, plane_depth=plane_depth)


def test_a_colour_image_alone_is_refused(tmp_path, camera):
    with pytest.raises(ValueError, match="needs a 16-bit image of plane depth"):
        read_frame(write_image(tmp_path / "colour.png", COLOUR), camera)


def test_files_that_are_missing_are_named(tmp_path, camera):
    colour = write_image(tmp_path / "colour.png", COLOUR)
    with pytest.raises(FileNotFoundError, match=r"none\.exr"):
        read_frame(tmp_path / "none.exr", camera)
    with pytest.raises(FileNotFoundError, match=r"none\.png"):
        read_frame(colour, camera, plane_depth=tmp_path / "none.png")
    with pytest.raises(FileNotFoundError, match=r"none\.json"):
        read_camera(tmp_path / "none.json")


def test_without_pillow_the_extra_to_install_is_named(tmp_path):
    write_image(tmp_path / "colour.png", COLOUR)
    camera = write_camera(tmp_path / "camera.json")
    code = (
        "import sys; sys.modules['PIL'] = None\n"
        "from pathlib import Path; from xihenet.io.frame_files import read_camera, read_frame\n"
        f"colour = Path({str(tmp_path / 'colour.png')!r})\n"
        f"try: read_frame(colour, read_camera(Path({str(camera)!r})), plane_depth=colour)\n"
        "except ImportError as error: print(error)"
    )
    done = fresh_python(code)
    assert "xihe-blender[images]" in done.stdout


# ------------------------------------------------------------------------------------------------------- large pictures


def test_a_colour_image_of_16_bits_is_read_in_8(tmp_path, camera, plane_depth):
    colour = np.random.default_rng(0).integers(0, 65536, (HEIGHT, WIDTH, 3), np.uint16)
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in colour)
    (tmp_path / "colour.png").write_bytes(png(WIDTH, HEIGHT, depth=16, rows=rows))
    frame = read_frame(tmp_path / "colour.png", camera, plane_depth=plane_depth)
    assert np.abs(frame.srgb_u8 - colour / 257).max() <= 1


@pytest.mark.parametrize(("width", "height"), [(10_000, 5_001), (15_000, 15_000), (65_536, 1)])
def test_a_picture_with_too_many_pixels_is_refused_by_its_header(tmp_path, camera, plane_depth, width, height):
    (tmp_path / "colour.png").write_bytes(png(width, height))
    with pytest.raises(ValueError, match=r"colour\.png: .*too many.*at most 50 megapixels"):
        read_frame(tmp_path / "colour.png", camera, plane_depth=plane_depth)
    path = write_exr(tmp_path / "frame.exr", RADIANCE, PLANE_DEPTH_M)
    window = struct.pack("<4i", 0, 0, WIDTH - 1, HEIGHT - 1)
    path.write_bytes(path.read_bytes().replace(window, struct.pack("<4i", 0, 0, width - 1, height - 1)))
    with pytest.raises(ValueError, match=r"frame\.exr: .*too many.*at most 50 megapixels"):
        read_frame(path, camera)


@NEEDS_OPENEXR
def test_what_the_openexr_package_would_unpack_into_gigabytes_is_not_given_to_it(tmp_path, camera, monkeypatch):
    path = write_by_package(tmp_path / "frame.exr", dict.fromkeys("RGBZ", PLANE_DEPTH_M), "RLE")
    monkeypatch.setattr(frame_files, "MOST_VALUES_BY_PACKAGE", 4 * HEIGHT * WIDTH - 1)
    monkeypatch.setattr(openexr_package, "read_by_package", None)
    with pytest.raises(ValueError, match=r"frame\.exr: its compression, RLE.* values: save it with ZIP compression"):
        read_frame(path, camera)


def test_a_large_frame_is_thinned_and_its_points_lie_where_they_lay(tmp_path, camera, monkeypatch):
    exr = write_exr(tmp_path / "frame.exr", RADIANCE, PLANE_DEPTH_M)
    whole = unproject_frame(read_frame(exr, camera, exposure=1)).points_m
    for module in (frame_files, image_files):
        monkeypatch.setattr(module, "MOST_POINTS", HEIGHT * WIDTH // 5)
    thinned = read_frame(exr, camera, exposure=1)
    assert thinned.plane_depth_m.shape == (10, 14) and np.isin(thinned.plane_depth_m, PLANE_DEPTH_M).all()
    apart = np.linalg.norm(whole[:, None] - unproject_frame(thinned).points_m, axis=2).min(axis=0)
    pixel_m = PLANE_DEPTH_M.max() / INTRINSICS.fx
    assert apart.max() < pixel_m
    images = image_frame(tmp_path, camera, encode_exposed(RADIANCE, 1))
    np.testing.assert_allclose(images.plane_depth_m, thinned.plane_depth_m, atol=5.1e-4)
    assert images.intrinsics == thinned.intrinsics


@pytest.mark.slow
def test_a_photo_of_24_megapixels_takes_little_memory(tmp_path):
    camera = write_camera(tmp_path / "camera.json")
    write_image(tmp_path / "plane_depth.png", MILLIMETRES)
    Image.new("RGB", (5664, 4248), (90, 90, 90)).save(tmp_path / "photo.png", compress_level=1)
    code = (
        "from pathlib import Path; from xihenet.io.frame_files import read_camera, read_frame\n"
        f"folder = Path({str(tmp_path)!r})\n"
        "read = lambda name: read_frame(folder / name, camera, plane_depth=folder / 'plane_depth.png')\n"
        f"camera = read_camera(Path({str(camera)!r}))\n"
        "assert (read('photo.png').srgb_u8 == 90).all()\n"
        "print(Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0])"
    )
    done = fresh_python(code)
    # Not resource.getrusage: after a fork its peak is that of this process.
    assert int(done.stdout) < 300_000


# -------------------------------------------------------------------------------------------------------------- camera


def points_of(tmp_path, frame_path, **changes):
    frame = read_frame(frame_path, read_camera(write_camera(tmp_path / "camera.json", **changes)), exposure=1)
    return unproject_frame(frame).points_m


@pytest.mark.parametrize("seed", range(3))
def test_the_same_camera_in_opencv_axes_sees_the_same_points(tmp_path, seed):
    exr = write_exr(tmp_path / "frame.exr", RADIANCE, PLANE_DEPTH_M)
    pose = pose_of(random_rotation(seed), [1, -2, 3])
    opencv_pose = pose @ np.diag([1, -1, -1, 1])  # Its y and z axes point the other way.
    ours = points_of(tmp_path, exr, **posed(pose))
    theirs = points_of(tmp_path, exr, **posed(opencv_pose), convention="opencv")
    np.testing.assert_allclose(theirs, ours, atol=1e-6)


def test_a_world_with_y_up_is_turned_upright(tmp_path):
    # An upright phone of ARKit at the origin looks along its world's -Z, which is Blender's +Y.
    exr = write_exr(tmp_path / "frame.exr", RADIANCE, PLANE_DEPTH_M)
    turned = points_of(tmp_path, exr, **posed(np.eye(4)), up="y")
    np.testing.assert_allclose(turned, points_of(tmp_path, exr), atol=1e-6)
    camera = read_camera(write_camera(tmp_path / "camera.json", up="y"))
    np.testing.assert_array_equal(camera.blender_from_file @ [1, 2, -3], [1, 3, 2])


@pytest.mark.parametrize("up", ["z", "y", "x", "-z", "-y", "-x"])
def test_a_world_with_any_axis_up_is_turned_upright_and_not_mirrored(tmp_path, up):
    turn = read_camera(write_camera(tmp_path / "camera.json", up=up)).blender_from_file
    points_up = np.eye(3)["xyz".index(up[-1])] * (-1 if "-" in up else 1)
    np.testing.assert_array_equal(turn @ points_up, [0, 0, 1])
    np.testing.assert_allclose(turn @ turn.T, np.eye(3))
    assert np.linalg.det(turn) == pytest.approx(1)


def posed(world_from_camera):
    return {"world_from_camera": world_from_camera.tolist()}


def with_entry(row, column, value):
    pose = LOOKING_ALONG_Y.copy()
    pose[row, column] = value
    return pose


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (posed(LOOKING_ALONG_Y[:, [1, 1, 2, 3]]), "singular"),
        (posed(LOOKING_ALONG_Y @ np.diag([2, 2, 2, 1])), "without scale or shear"),
        (posed(LOOKING_ALONG_Y @ np.diag([-1, 1, 1, 1])), "mirrors"),
        (posed(with_entry(0, 1, 0.1)), "without scale or shear"),
        (posed(with_entry(0, 1, 0.002)), "an error of 0.002: write it with four digits or more"),
        (posed(with_entry(0, 3, np.nan)), "world_from_camera: expected finite numbers"),
        (posed(with_entry(3, 0, 1.0)), "transpose it"),
        (posed(np.zeros((4, 4))), r"got \[0.0, 0.0, 0.0, 0.0\]: write the camera's axes and place in the first three"),
        ({"world_from_camera": [[1, 0], [0, 1]]}, "four rows of four numbers"),
        ({"world_from_camera": [[1, 0, 0, 0], [0]]}, "four rows of four numbers"),
        ({"world_from_camera": "identity"}, "four rows of four numbers"),
        ({"world_from_camera": None}, "world_from_camera is missing"),
        ({"fx": None}, "fx is missing"),
        ({"fx": "20"}, "fx: expected a number"),
        ({"fx": np.nan}, "fx: expected a number"),
        ({"cy": np.inf}, "cy: expected a number"),
        ({"fy": 0}, "focal lengths must be positive"),
        ({"width": 32.5}, "whole number"),
        ({"width": np.nan}, "width: expected a number"),
        ({"width": True}, "expected a number"),
        ({"height": 0}, "height: expected a whole number of pixels"),
        ({"convention": "OpenGL"}, "convention: expected 'blender' or 'opencv'"),
        ({"up": ["y"]}, "up: expected 'z' or 'y'"),
        ({"fx": 10**400}, "fx: expected a number"),
        ({"cy": -(10**400)}, "cy: expected a number"),
        ({"width": 10**400}, "width: expected a number"),
        ({"width": 10**300, "height": 10**300}, "width: expected a whole number"),
        ({"world_from_camera": [[10**400] * 4] * 4}, "world_from_camera: expected finite numbers"),
        ({"convension": "opencv"}, "'convension': there is no such key; did you mean 'convention'"),
        ({"FX": 20}, "'FX': there is no such key; did you mean 'fx'"),
        ({"distortion": [0, 0]}, "'distortion': there is no such key; leave it out, and undistort the pictures"),
        ({"k1": -0.2, "k2": 0.05}, "'k1': there is no such key; leave it out, and undistort the pictures"),
        ({"name": "desk"}, "'name': there is no such key; leave it out; there are width"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(tmp_path, changes, said):
    with pytest.raises(ValueError, match=rf"camera\.json: .*{said}"):
        read_camera(write_camera(tmp_path / "camera.json", **changes))


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '"camera"', "\ufeff{}", json.dumps({}), "[" * 200_000])
def test_a_camera_file_without_a_camera_is_refused(tmp_path, text):
    path = tmp_path / "camera.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"camera\.json"):
        read_camera(path)


def test_a_pose_in_single_precision_is_accepted(tmp_path):
    pose = pose_of(random_rotation(5), [1, -2, 3]).astype(np.float32).astype(float)
    camera = read_camera(write_camera(tmp_path / "camera.json", **posed(pose)))
    np.testing.assert_array_equal(camera.world_from_camera, pose)
