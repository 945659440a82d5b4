"""`xihe export` as a user types it, and the files that it writes, read by others where there is someone."""

import json

import numpy as np
import pytest

from addon_tests.pure.commands import assert_refused, xihe_here
from addon_tests.pure.runs import content, frame, probe
from addon_tests.pure.test_estimate_command import read_strictly, xihe_without_blender
from xihe_blender.cli.main import main
from xihenet.io.exr import write_exr
from xihenet.light.environments import (
    disc_picture,
    encode_hdr,
    environment_picture,
    laid_out,
    laid_out_as_ours,
    rgbe_of,
)
from xihenet.light.exports import (
    NamedLight,
    export_files,
    file_names,
    scaled,
    turn_from_minus_z,
)
from xihenet.light.key_light import sh_of_key_light
from xihenet.light.platforms import PLATFORMS, coefficients_for, convention_of
from xihenet.panorama import panorama_directions, project_panorama, solid_angles
from xihenet.records import KeyLight, ObjectLight, Reflections

EXPOSURE = 1.7
SH = np.random.default_rng(1).normal(size=(9, 3)) * 0.1 + np.eye(9)[0][:, None]
KEY = {"direction": [0.0, -0.6, 0.8], "irradiance": [2.0, 1.0, 0.5], "angular_radius": 0.1, "is_seen": True}
KEY_LIGHT = KeyLight(np.array(KEY["direction"]), np.array(KEY["irradiance"]), 0.1, True)


def light_from(number, **changes):
    return {"frame": number, "sh": (SH * number).tolist(), "key": None, "reflections": None} | changes


@pytest.fixture
def run(tmp_path):
    """A run's folder: a light at frames 1 and 3, the later one with a key light and reflections."""
    picture = panorama_directions(8, 16).astype(np.float32) + 1
    write_exr(tmp_path / "seen.exr", dict(zip("RGB", np.moveaxis(laid_out(picture, "+X"), -1, 0), strict=True)))
    reflected = {"picture": "seen.exr", "seen_share": 0.5}
    lights = [light_from(1), light_from(3, key=KEY, reflections=reflected)]
    frames = [frame(number, probe()) for number in (1, 2, 3, 4)]
    whole = content(
        frames, settings={"light": "sh+key+reflections"}, lights={"Ball": lights, "My Vase": [light_from(2)]}
    )
    (tmp_path / "results.json").write_text(json.dumps(whole))
    return tmp_path


def export(run, *arguments):
    return main(["export", str(run), *map(str, arguments)])


def written(run, target):
    return read_strictly((run / "exports" / target / f"{target}.json").read_text())


def test_it_needs_no_blender(run):
    done = xihe_without_blender("export", run / "results.json", "--to", "three")
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    assert str(run / "exports" / "three" / "three.json") in done.stdout


def test_the_light_in_use_is_written_as_the_platform_has_it(run):
    assert export(run, "--to", "three") == 0
    ball, vase = written(run, "three")["lights"]
    assert (ball["object"], ball["frame"], vase["object"], vase["frame"]) == ("Ball", 3, "My Vase", 2)
    assert ball["mainLight"]["direction"] == pytest.approx([0, 0.8, 0.6]) and vase["mainLight"] is None
    rest = ObjectLight(SH * 3, KEY_LIGHT)
    expected = export_files([NamedLight("Ball", 3, 0, rest)], "three")
    assert ball["sh"] == json.loads(expected["three.json"])["lights"][0]["sh"]


@pytest.mark.parametrize(("frame", "force"), [(1, 1), (2, 1), (3, 3), (4, 3)])
def test_a_frame_has_the_last_light_before_it(run, frame, force):
    assert export(run, "--to", "filament", "--frame", frame, "--objects", "Ball") == 0
    assert [light["frame"] for light in written(run, "filament")["lights"]] == [force]


def test_all_lights_of_the_path_are_written(run):
    assert export(run, "--to", "webxr", "--all") == 0
    lights = written(run, "webxr")["lights"]
    assert [(one["object"], one["frame"]) for one in lights] == [("Ball", 1), ("Ball", 3), ("My Vase", 2)]
    assert lights[1]["time_s"] == pytest.approx(2 / 30)


def test_the_scenes_radiance_is_without_the_exposure(run):
    assert export(run, "--to", "three", "--light", "sh") == 0
    picture = written(run, "three")
    assert export(run, "--to", "three", "--light", "sh", "--units", "scene") == 0
    scene = written(run, "three")
    np.testing.assert_allclose(
        np.array(picture["lights"][0]["sh"]), np.array(scene["lights"][0]["sh"]) * EXPOSURE, rtol=1e-9
    )
    assert "mainLight" in picture["lights"][0] and picture["lights"][0]["mainLight"] is None
    expected = coefficients_for(SH * 3, convention_of("three"))
    np.testing.assert_allclose(picture["lights"][0]["sh"], expected, rtol=1e-9)


def test_reflections_are_written_turned_as_the_engine_reads_them(run):
    assert export(run, "--to", "playcanvas", "--objects", "Ball") == 0
    decoded = read_hdr(run / "exports" / "playcanvas" / "Ball_0003_reflections.hdr")
    true = laid_out((panorama_directions(8, 16) + 1) * EXPOSURE, "-Y")
    np.testing.assert_allclose(decoded, true, atol=EXPOSURE * 2 / 128)


def test_beside_a_picture_without_its_lamp_the_main_light_is_what_is_sure_of_it(run):
    key = KEY | {"is_seen": False, "certainty": 0.2}
    reflected = {"picture": "seen.exr", "seen_share": 0.5, "has_lamp": False}
    lights = {"Ball": [light_from(1, key=key, reflections=reflected)]}
    results = content([frame(1, probe())], settings={"light": "sh+key+reflections"}, lights=lights)
    (run / "results.json").write_text(json.dumps(results))
    intensity, irradiance = {}, {}
    for parts in ("sh+key", "sh+key+reflections"):
        assert export(run, "--to", "openxr", "--light", parts) == 0
        (light,) = written(run, "openxr")["lights"]
        intensity[parts], irradiance[parts] = light["mainLight"]["intensity"], light["sh_total"]
    assert intensity["sh+key+reflections"] == pytest.approx(intensity["sh+key"] / 2)
    assert irradiance["sh+key+reflections"] == irradiance["sh+key"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--to", "threejs"), "invalid choice"),
        (("--to", "three", "--frame", "9"), "has no frame 9: give one from 1 to 4 of its path, of which 4 is nearest"),
        (("--to", "three", "--objects", "Vase"), "has no virtual object 'Vase'; it has Ball, My Vase"),
        (("--to", "three", "--frame", "1"), "'My Vase' has no estimate yet at frame 1"),
        (("--to", "three", "--reading", "x"), "three has no reading 'x'"),
        (("--to", "model-viewer", "--reading", "x"), "takes a picture"),
        (("--to", "three", "--frame", "1", "--all"), "not allowed with"),
    ],
)
def test_what_cannot_be_written_is_one_line_and_no_file(run, arguments, words):
    assert_refused(xihe_here("export", run, *arguments), words)
    assert not (run / "exports").exists()


@pytest.mark.parametrize("name", ["lost.json", "seen.exr"])
def test_a_name_without_a_run_behind_it_is_answered_with_what_to_give(run, name):
    asked = xihe_here("export", run / name, "--to", "three")
    assert_refused(asked, f"{name} is no run: give the run's folder, or the results.json in it")


def test_a_blend_in_place_of_a_run_is_to_be_given_as_a_file(run):
    asked = xihe_here("export", run / "room_lit.blend", "--to", "three")
    assert_refused(asked, "room_lit.blend is no run: give the run's RESULTS.json, or this file by --from")


def test_results_of_another_version_a_lost_picture_and_a_lesser_light_are_one_line(run):
    (run / "seen.exr").unlink()
    assert_refused(xihe_here("export", run, "--to", "three"), "seen.exr cannot be read")
    lesser = content([frame(1, probe())], settings={"light": "sh"}, lights={"Ball": [light_from(1)]})
    (run / "results.json").write_text(json.dumps(lesser))
    asked = xihe_here("export", run, "--to", "three", "--light", "sh+key")
    assert_refused(asked, "run xihe previs again with --light sh+key")
    (run / "results.json").write_text(json.dumps(lesser | {"schema_version": 0}))
    assert_refused(xihe_here("export", run, "--to", "three"), "is not from a run of this version")
    assert not (run / "exports").exists()


def test_files_have_the_letters_of_all_alphabets_and_each_object_has_its_own():
    lamps = ["桌灯", "球", "Lampe ä", "Lampe ö", "Ko\u0308rbis größe", "दीया"]
    names = [*lamps, "Vase 1", "Vase-1", "vase 1", "/..:", "\udc80"]
    found = file_names(names)
    assert list(found.values()) == [
        "桌灯", "球", "Lampe_ä", "Lampe_ö", "Körbis_größe", "दीया",
        "Vase_1", "Vase_1_2", "vase_1_3", "object", "object_2",
    ]  # fmt: skip
    long = file_names(["球" * 80 + end for end in "ab"])
    assert [len(name.encode()) for name in long.values()] == [60, 62]
    files = export_files([NamedLight(name, 1, 0.0, ObjectLight(SH)) for name in names[:8]], "usd")
    entries = json.loads(files["usd.json"])["lights"]
    assert [entry["object"] for entry in entries] == names[:8]
    assert len({entry["environment"] for entry in entries} & files.keys()) == 8


def test_two_lights_of_one_object_and_frame_and_no_light_are_refused():
    lights = [NamedLight("Vase 1", 1, 0.0, ObjectLight(SH))] * 2
    with pytest.raises(ValueError, match="rename one"):
        export_files(lights, "usd")
    with pytest.raises(ValueError, match="at least one light"):
        export_files([], "three")


@pytest.mark.parametrize("platform", PLATFORMS)
def test_every_file_is_written_for_a_light_with_all_its_parts(platform):
    reflections = Reflections(np.full((9, 3), 0.5), 1.0)
    light = NamedLight("Ball", 3, 0.0, ObjectLight(SH, KEY_LIGHT, reflections=reflections), np.ones((8, 16, 3)))
    files = export_files([light], platform)
    written, readings = read_strictly(files[f"{platform}.json"].decode()), list(PLATFORMS[platform].readings)
    (entry,) = written["lights"]
    assert written.get("reading") == (readings[0] if len(readings) > 1 else None)
    assert ("coefficients" in written) == ("sh" in entry)
    assert {entry[part] for part in ("environment", "reflections") if part in entry} <= files.keys()
    assert ("sh" in entry) != ("environment" in entry) and all(files.values())
    assert "".join(name for name in files if name.endswith((".cs", ".js"))) == PLATFORMS[platform].script
    again = scaled(light.light, 2.0)
    assert again.sh.tolist() == (SH * 2).tolist() and again.key.irradiance.tolist() == [4.0, 2.0, 1.0]
    assert (again.reflections.radiance == 1).all()


# ---------------------------------------------------------------------------------------------------------- pictures


def read_hdr(path):
    """A plain reader of what we write, as the format is described: runs of each channel of each row."""
    data = path.read_bytes()
    assert data.startswith(b"#?RADIANCE\n")
    start = data.index(b"\n\n") + 2
    end = data.index(b"\n", start)
    _, height, _, width = data[start:end].split()
    height, width, at = int(height), int(width), end + 1
    rows = np.zeros((height, width, 4), np.uint8)
    for row in rows:
        assert data[at : at + 4] == bytes([2, 2, width >> 8, width & 255])
        at += 4
        for channel in range(4):
            x = 0
            while x < width:
                n = data[at]
                if n > 128:
                    row[x : x + n - 128, channel] = data[at + 1]
                    x, at = x + n - 128, at + 2
                else:
                    row[x : x + n, channel] = list(data[at + 1 : at + 1 + n])
                    x, at = x + n, at + 1 + n
    assert at == len(data)
    exponent = rows[..., 3].astype(int)
    return np.where(exponent[..., None] > 0, rows[..., :3] * 2.0 ** (exponent - 136)[..., None], 0)


@pytest.mark.parametrize("width", [8, 127, 128, 129, 300])
@pytest.mark.parametrize("seed", range(3))
def test_an_hdr_picture_is_read_back_within_its_rounding(tmp_path, width, seed):
    rng = np.random.default_rng(seed)
    picture = np.exp(rng.normal(size=(3, width, 3)) * 4) * (rng.random((3, width, 1)) > 0.2)
    picture[1, : width // 2] = picture[1, 0]
    (tmp_path / "a.hdr").write_bytes(encode_hdr(picture))
    error = np.abs(read_hdr(tmp_path / "a.hdr") - picture).max(axis=-1)
    assert (error <= picture.max(axis=-1) / 128).all()
    assert len(encode_hdr(np.ones((2, 254, 3)))) < 110, "equal neighbours take two bytes for 127 of them"


def test_black_stays_black_and_the_brightest_channel_does_not_overflow():
    assert rgbe_of(np.zeros((1, 3))).tolist() == [[0, 0, 0, 0]]
    assert rgbe_of(np.array([[0.999999, 0, 0]])).tolist() == [[255, 0, 0, 128]]


@pytest.mark.parametrize("dark", [5e-324, 1e-45, 1e-39])
@pytest.mark.parametrize("bright", [1.8e38, 3e38, 1e39, 1e308])
def test_what_the_format_cannot_say_is_black_or_as_bright_as_it_can_say(tmp_path, dark, bright):
    (tmp_path / "a.hdr").write_bytes(encode_hdr(np.array([[[dark] * 3, [bright] * 3] * 4])))
    assert read_hdr(tmp_path / "a.hdr")[0, ::4].tolist() == [[0] * 3] * 2
    assert np.allclose(read_hdr(tmp_path / "a.hdr")[0, 1], 255 * 2.0**119)


@pytest.mark.parametrize(
    "wrong", [np.zeros((4, 4, 3)), np.zeros((4, 16)), np.full((2, 8, 3), np.inf), -np.ones((2, 8, 3))]
)
def test_what_is_no_hdr_picture_is_refused(wrong):
    with pytest.raises(ValueError, match="encode_hdr"):
        encode_hdr(wrong)


def test_a_picture_has_the_light_of_the_coefficients_where_these_are_above_zero():
    light = ObjectLight(np.eye(9)[0][:, None] * np.ones(3) + np.random.default_rng(0).normal(size=(9, 3)) * 0.05)
    with_key = ObjectLight(light.sh + sh_of_key_light(KEY_LIGHT), KEY_LIGHT)
    for one, platform, shown in ((light, "usd", light), (with_key, "usd", light), (with_key, "model-viewer", with_key)):
        picture = environment_picture(one, PLATFORMS[platform])
        np.testing.assert_allclose(project_panorama(picture), shown.sh, atol=5e-3)


@pytest.mark.parametrize("radius", [1e-4, 0.05, 0.5, 2.0])
@pytest.mark.parametrize("direction", [(0, 0, 1), (0.6, 0, -0.8), (0, 1, 0)])
def test_a_disc_in_a_picture_has_the_key_lights_irradiance(direction, radius):
    key = KeyLight(np.array(direction, float), np.array([2.0, 1.0, 0.5]), radius, True)
    picture = disc_picture(key, 64)
    facing = np.maximum(panorama_directions(64, 128) @ key.direction, 0) * solid_angles(64, 128)
    np.testing.assert_allclose((picture * facing[..., None]).sum(axis=(0, 1)), key.irradiance)


@pytest.mark.parametrize("radius", [1e-4, 0.02, 0.1])
def test_a_disc_keeps_its_light_where_an_engine_looks_it_up_for_a_cube_map(radius):
    rng = np.random.default_rng(0)
    found = [
        _in_a_cube_map(KeyLight(d / np.linalg.norm(d), np.ones(3), radius, True)) for d in rng.normal(size=(60, 3))
    ]
    assert np.abs(np.array(found) - 1).max() < 0.06


def _in_a_cube_map(key):
    """The irradiance of its disc after bilinear look-ups at the texels' middles, as in three.js."""
    picture, places = disc_picture(key, 128)[..., 0], (np.arange(64) + 0.5) / 32 - 1
    across, down = np.meshgrid(places, places)
    face = np.stack([np.ones_like(across), across, down], axis=-1).reshape(-1, 3)
    rays = np.concatenate([sign * np.roll(face, axis, axis=1) for axis in range(3) for sign in (1, -1)])
    lengths = np.linalg.norm(rays, axis=1)
    rays /= lengths[:, None]
    column = (np.arctan2(rays[:, 0], rays[:, 1]) / (2 * np.pi) + 0.5) * 256 - 0.5
    row = np.clip(np.arccos(rays[:, 2]) / np.pi * 128 - 0.5, 0, 127)
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    right_share, low_share = column - left, row - top
    upper, lower = picture[top], picture[np.minimum(top + 1, 127)]
    rows = upper * (1 - low_share[:, None]) + lower * low_share[:, None]
    each = np.arange(len(rays))
    shown = rows[each, left % 256] * (1 - right_share) + rows[each, (left + 1) % 256] * right_share
    return (shown * np.maximum(rays @ key.direction, 0) * lengths**-3 / 32**2).sum()


@pytest.mark.parametrize(
    ("platform", "middle", "right"), [("unity", "+X", (0, -1, 0)), ("playcanvas", "-Y", (-1, 0, 0))]
)
def test_the_json_says_where_pictures_look(platform, middle, right, tmp_path):
    panorama = (panorama_directions(8, 16) + 1).astype(float)  # The picture's colour is the direction itself.
    files = export_files([NamedLight("Ball", 1, 0.0, ObjectLight(SH), panorama)], platform)
    assert f"Blender's {middle}, " in read_strictly(files[f"{platform}.json"].decode())["pictures"]
    picture = tmp_path / "picture.hdr"
    picture.write_bytes(files["Ball_0001_reflections.hdr"])
    horizon = read_hdr(picture)[3:5].mean(axis=0) - 1
    axis = {"+X": (1, 0, 0), "-Y": (0, -1, 0)}[middle]
    np.testing.assert_allclose(horizon[7:9].mean(axis=0), axis, atol=0.08)
    np.testing.assert_allclose(horizon[11:13].mean(axis=0), right, atol=0.08)
    without = export_files([NamedLight("Ball", 1, 0.0, ObjectLight(SH))], "unity")
    assert "pictures" not in read_strictly(without["unity.json"].decode())


def test_pictures_turn_there_and_back():
    picture = np.random.default_rng(0).random((4, 8, 3))
    for layout in ("+X", "-Y"):
        assert laid_out_as_ours(laid_out(picture, layout), layout).tolist() == picture.tolist()


@pytest.mark.parametrize("seed", range(8))
def test_a_light_is_turned_from_minus_z_to_where_it_shines(seed):
    travel = np.random.default_rng(seed).normal(size=3)
    travel = np.array([(0, 0, 1.0), (0, 0, -1.0)][seed]) if seed < 2 else travel / np.linalg.norm(travel)
    w, *v = turn_from_minus_z(travel)
    axis, start = np.array(v), np.array([0, 0, -1.0])
    turned = start + 2 * np.cross(axis, np.cross(axis, start) + w * start)
    np.testing.assert_allclose(turned, travel, atol=1e-9)
    assert np.linalg.norm([w, *v]) == pytest.approx(1)


def test_a_light_without_a_key_makes_documents_without_one():
    files = export_files([NamedLight("Ball", 1, 0.0, ObjectLight(SH))], "usd")
    assert b"DistantLight" not in files["Ball_0001.usda"]
    document = read_strictly(
        export_files([NamedLight("Ball", 1, 0.0, ObjectLight(SH))], "gltf")["Ball_0001.gltf"].decode()
    )
    assert "nodes" not in document and document["extensionsUsed"] == ["EXT_lights_image_based"]
