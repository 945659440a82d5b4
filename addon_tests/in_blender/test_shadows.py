"""Shadows on what the phone has seen of the room, beside the same scene path-traced with its real floor."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Vector
from tiny_scenes import add_lamp, black_smoke, box, empty_scene, material, phone, set_world, sphere

from addon_tests.pure.made import pose_of
from xihe_blender.apply.datablocks import has_anything
from xihe_blender.apply.shadow_catchers import (
    CATCHER_INDEX,
    make_shadow_catcher,
    remove_shadow_catchers,
    shadow_catchers,
)
from xihe_blender.capture.render import RenderSettings, render_only_part, render_passes
from xihe_blender.capture.scanner import open_scanner
from xihe_blender.compare.methods import blended, composite, open_comparer
from xihe_blender.compare.shadows import (
    BRIGHTEST,
    SHADOW_CHANNELS,
    ring_around,
    ring_rmse,
    shadow_of_all,
    shadow_on,
    surroundings,
    touches_view,
)
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet.camera import pixel_rays, valid_plane_depth
from xihenet.light.key_light import sh_of_key_light
from xihenet.records import Intrinsics, KeyLight, ObjectLight, RgbdFrame

SETTINGS = RenderSettings((64, 48), 32)
TOWARDS_SUN = np.array([0.6, -0.2, 0.75]) / np.linalg.norm([0.6, -0.2, 0.75])
SKY, SUN = 0.2, 2.0
FLAT = np.sqrt(4 * np.pi) * SKY * np.eye(9)[0][:, None] * np.ones(3)


def sunlit(height_m=0.2, wall=False):
    """A grey floor under sun and sky, and a white ball of 0.2 m, its middle `height_m` above it; the phone from -Y."""
    scene = empty_scene()
    set_world(scene, (SKY,) * 3)
    sun = add_lamp(scene, "SUN", energy=SUN, angle=0.1)
    sun.rotation_mode, sun.rotation_quaternion = "QUATERNION", Vector(TOWARDS_SUN).to_track_quat("Z", "Y")
    box(scene, "Floor", (0, 0, -0.05), (8, 8, 0.1), material("Grey", (0.3, 0.3, 0.3)))
    if wall:
        box(scene, "Wall", (-0.35, 0, 0.5), (0.1, 4, 1.0), material("Wall", (0.3, 0.3, 0.3)))
    virtual = virtual_collection(scene, create=True)
    ball = sphere(scene, "Ball", (0, 0, height_m), 0.2, material("White", (0.5, 0.5, 0.5)), virtual)
    phone(scene, (0, -1.8, 1.1), (0, 0, 0.15))
    return scene, ball


def light(exposure):
    key = KeyLight(TOWARDS_SUN, np.full(3, SUN * exposure), 0.05, True)
    return ObjectLight(FLAT * exposure + sh_of_key_light(key), key)


def compared(scene, balls, *, has_surfaces=True, blurred=0.0, settings=SETTINGS):
    with open_scanner(scene, settings) as scanner:
        scanner.move_to(1)
        captured = scanner.acquire_environment_scan()
    noise = np.random.default_rng(0).normal(size=captured.plane_depth_m.shape) * blurred
    captured = replace(captured, plane_depth_m=(captured.plane_depth_m * (1 + noise)).astype(np.float32))
    with open_comparer(scene, balls, ["one"], settings, has_key_light=True) as comparer:
        found = comparer.surfaces_around_objects([captured], 1) if has_surfaces else {}
        truth = comparer.render_ground_truth(1)
        result = comparer.render_methods(
            captured, {"one": {item.name: light(captured.exposure) for item in balls}}, truth, found
        )
    return result, found.get("Ball", [])


@pytest.mark.parametrize(("wall", "blurred"), [(False, 0.0), (True, 0.0), (False, 0.004)])
def test_shadow_is_that_of_the_real_floor(wall, blurred):
    scene, ball = sunlit(wall=wall)
    with_shadow, surfaces = compared(scene, [ball], blurred=blurred)
    without, _ = compared(scene, [ball], has_surfaces=False)
    assert len(surfaces) == 1 + wall and surfaces[0].normal[2] == pytest.approx(1.0, abs=0.01)
    left = ring_rmse(with_shadow.methods["one"], with_shadow.ground_truth, with_shadow.ring)
    all_of_it = ring_rmse(without.methods["one"], without.ground_truth, without.ring)
    assert all_of_it > 0.03 and left < 0.3 * all_of_it
    # Away from the sun, which is on the right.
    darker = (without.methods["one"] - with_shadow.methods["one"]).mean(axis=-1) * with_shadow.ring
    columns = darker.clip(0).sum(axis=0)
    assert columns[:32].sum() > 3 * columns[32:].sum()


@pytest.mark.slow
def test_two_balls_beside_each_other_cast_no_shadow_twice():
    scene, ball = sunlit()
    virtual = virtual_collection(scene)
    other = sphere(scene, "Other", (-0.45, 0.1, 0.2), 0.2, material("White", (0.5, 0.5, 0.5)), virtual)
    bpy.context.view_layer.update()
    with_shadow, _ = compared(scene, [ball, other])
    without, _ = compared(scene, [ball, other], has_surfaces=False)
    left = ring_rmse(with_shadow.methods["one"], with_shadow.ground_truth, with_shadow.ring)
    all_of_it = ring_rmse(without.methods["one"], without.ground_truth, without.ring)
    assert all_of_it > 0.03 and left < 0.2 * all_of_it


@pytest.mark.slow
def test_ball_is_lit_as_without_a_catcher():
    scene, ball = sunlit()
    settings = replace(SETTINGS, samples=64)
    with_shadow, _ = compared(scene, [ball], settings=settings)
    without, _ = compared(scene, [ball], has_surfaces=False, settings=settings)
    inside = with_shadow.weights > 0.99
    assert inside.sum() > 60
    difference = (with_shadow.methods["one"] - without.methods["one"])[inside]
    assert np.abs(difference).mean() < 0.01 * without.methods["one"][inside].mean()


def test_fog_has_no_holes_where_the_floor_is_seen_through_it():
    scene, ball = sunlit()
    tree = ball.data.materials[0].node_tree
    tree.nodes.clear()
    fog, output = tree.nodes.new("ShaderNodeVolumeScatter"), tree.nodes.new("ShaderNodeOutputMaterial")
    fog.inputs["Density"].default_value = 9
    tree.links.new(fog.outputs[0], output.inputs["Volume"])
    over_a_catcher, surfaces = compared(scene, [ball], blurred=0.01)
    alone, _ = compared(scene, [ball], has_surfaces=False)
    # Where it is thinner, none of a pixel's few rays may meet it.
    is_fog = alone.weights > 0.2
    assert surfaces and is_fog.sum() > 200
    assert (over_a_catcher.weights[is_fog] > 0).all()
    np.testing.assert_allclose(over_a_catcher.weights.sum(), alone.weights.sum(), rtol=0.02)


def test_nothing_is_around_a_ball_high_in_the_air_and_nothing_is_left_in_the_file():
    scene, ball = sunlit(height_m=2.5)
    phone(scene, (0, -1.8, 2.2), (0, 0, 2.5))
    result, surfaces = compared(scene, [ball])
    assert surfaces == [] and result.ring.any()
    assert not shadow_catchers() and not has_anything(scene)
    assert not [mesh for mesh in bpy.data.meshes if mesh.name.startswith("Xihe")]


@pytest.mark.parametrize(
    ("looks_at", "f_stop", "has_surfaces"),
    [
        ((0, 0, 0.15), None, True),
        ((0, 0, 0.15), None, False),
        ((0, 0, 0.15), 0.1, False),
        ((-2.5, 0, 0.15), None, False),
    ],
)
def test_a_part_of_the_picture_is_rendered_and_is_as_in_the_whole_one(looks_at, f_stop, has_surfaces):
    scene, ball = sunlit()
    phone(scene, (0, -1.8, 1.1), looks_at)
    depth_of_field = scene.camera.data.dof
    depth_of_field.use_dof, depth_of_field.focus_distance = f_stop is not None, 0.3
    depth_of_field.aperture_fstop = f_stop or 1.0
    settings = replace(SETTINGS, size=(150, 110), samples=4, denoise=False)
    with open_scanner(scene, settings) as scanner:
        scanner.move_to(1)
        captured = scanner.acquire_environment_scan()
    with open_comparer(scene, [ball], ["one"], settings, has_key_light=True) as comparer:
        found = comparer.surfaces_around_objects([captured], 1) if has_surfaces else {}
        part = comparer.render_layers(captured, {"one": {"Ball": light(captured.exposure)}}, found).passes
        # A ball that is blurred beyond the part is rendered as a whole.
        render = comparer.lit.render
        assert render.use_border == (f_stop is None)
        assert not render.use_border or render.border_max_y - render.border_min_y < 0.9
        render.use_persistent_data = False
        render_only_part(comparer.lit, None)
        whole = render_passes(comparer.lit).passes
    np.testing.assert_array_equal(part["Combined.A"], whole["Combined.A"])
    is_near = valid_plane_depth(whole["Depth.Z"])
    np.testing.assert_array_equal(valid_plane_depth(part["Depth.Z"]), is_near)
    is_hit = is_near | (whole["Combined.A"] > 0)
    assert is_hit.any() == (looks_at[0] == 0)
    for name, pixels in whole.items():
        np.testing.assert_array_equal(part[name][is_hit], pixels[is_hit], err_msg=name)


def test_a_catcher_of_ours_is_found_and_removed():
    empty_scene()
    catcher = make_shadow_catcher("Xihe Shadow Ball")
    assert shadow_catchers() == [catcher]
    remove_shadow_catchers([catcher])
    assert not shadow_catchers() and not bpy.data.meshes and not bpy.data.materials


def test_smoke_dims_what_is_behind_it_room_or_object_and_nothing_before_it():
    scene = empty_scene()
    set_world(scene, (SKY,) * 3)
    phone(scene, (0, -3, 0), (0, 0, 0))
    virtual = virtual_collection(scene, create=True)
    box(scene, "Smoke", (0, 0, 0), (1.2, 0.2, 0.8), black_smoke(5.0), virtual)
    for name, x, y in (("Behind", -0.25, 0.5), ("Within", 0, 0.025), ("Z before", 0.25, -0.5)):
        box(scene, name, (x, y, 0), (0.15, 0.05, 0.3), material(name, emission=0.5), virtual)
    result, _ = compared(scene, virtual_objects(scene), has_surfaces=False)
    off = np.abs(result.methods["one"] - result.ground_truth).max(axis=-1) / result.ground_truth.max()
    # Beside all of them, through smoke alone, and in the middle of each box.
    assert off[24, [4, 18, 25, 32, 40]].max() < 0.05


def test_ring_is_near_the_objects_and_none_of_them():
    weights = np.zeros((40, 60))
    weights[10:20, 20:30] = 1.0
    weights[10, 20] = 0.01
    ring = ring_around(weights)
    assert not ring[weights > 0].any()
    rows, columns = np.nonzero(ring)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (5, 24, 15, 34)
    assert ring.sum() == 20 * 20 - 100
    assert ring_around(np.pad([[0.01]], 4)).sum() == 24
    assert not ring_around(np.zeros((4, 4))).any()
    assert ring_rmse(np.ones((4, 4, 3)), np.zeros((4, 4, 3)), np.zeros((4, 4), bool)) is None


def test_ring_error_is_that_of_what_a_display_shows():
    ring = np.ones((2, 2), bool)
    assert ring_rmse(np.full((2, 2, 3), 5.0), np.full((2, 2, 3), 3.0), ring) == 0.0
    assert ring_rmse(np.full((2, 2, 3), 0.5), np.full((2, 2, 3), 0.3), ring) == pytest.approx(0.2)


def test_a_shadow_is_looked_for_within_four_half_diagonals_of_the_middle_and_not_farther_than_3_m():
    corners_m = np.array([[1.0, 2, 3], [1.2, 2.1, 3.2], [1.1, 2.1, 3]])
    middle_m, reach_m = surroundings(corners_m)
    np.testing.assert_allclose(middle_m, [1.1, 2.05, 3.1])
    assert (reach_m, surroundings(9 * corners_m)[1]) == (pytest.approx(0.6), 3.0)


def caught(ratio, depth_m=1.0):
    """A layer of nothing but a catcher, with these ratios (H, W, 3)."""
    passes = {name: np.array(ratio[..., channel], np.float32) for channel, name in enumerate(SHADOW_CHANNELS)}
    return passes | {"Depth.Z": np.full(ratio.shape[:2], depth_m), "Combined.A": np.zeros(ratio.shape[:2])}


def test_a_catcher_multiplies_the_frame_where_it_is_seen_without_speckles_and_unlikely_colours():
    shape, seen = (5, 6, 3), np.ones((5, 6), bool)
    even = np.broadcast_to([0.4, 0.5, 0.6], shape)
    np.testing.assert_allclose(shadow_on(caught(even), seen), even, rtol=1e-6)
    unlikely = shadow_on(caught(np.broadcast_to([-3.0, 0.5, 0.9], shape)), seen)
    np.testing.assert_allclose(unlikely, np.broadcast_to([0.25, 0.5, 0.75], shape))
    for ratio, shown in ((3.0, BRIGHTEST), (-1.0, 0.0), (np.nan, 1.0)):
        np.testing.assert_array_equal(shadow_on(caught(np.full(shape, ratio)), seen), shown)
    for speckle in (0.0, 9.0, np.nan):
        speckled = even.copy()
        speckled[2, 3] = speckled[0, 0] = speckle
        np.testing.assert_allclose(shadow_on(caught(speckled), seen), even, rtol=1e-6)
    # What is not of a catcher has no say in what is.
    is_left = np.arange(30).reshape(5, 6) % 6 < 2
    half = even * is_left[..., None]
    hidden, covered = caught(half), caught(half)
    hidden["Depth.Z"][~is_left], covered["Combined.A"][~is_left] = 1e10, 1.0
    for passes, in_view in ((hidden, seen), (covered, seen), (caught(half), is_left)):
        np.testing.assert_allclose(shadow_on(passes, in_view), np.where(half > 0, half, 1.0), rtol=1e-6)


def test_of_several_shadows_the_darkest_counts_and_of_several_lights_the_brightest():
    shape, seen = (2, 3, 3), np.ones((2, 3), bool)
    for a, b, counts in ((0.5, 0.9, 0.5), (0.9, 0.5, 0.5), (1.0, 1.1, 1.1), (0.9, 1.1, 0.9), (1.15, 1.1, 1.15)):
        layers = {name: caught(np.full(shape, ratio)) for name, ratio in (("a", a), ("b", b), ("not in view", 0))}
        np.testing.assert_allclose(shadow_of_all(layers, {"a": seen, "b": seen, "no layer": seen}), counts, rtol=1e-6)
        assert np.all(shadow_of_all(layers, {}) == 1)


def test_a_ball_touches_the_view_where_it_reaches_over_one_of_its_sides():
    rng, camera = np.random.default_rng(0), Intrinsics(40, 30, 50.0, 45.0, 12.0, 21.0)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pose = pose_of(axes * np.linalg.det(axes), rng.normal(size=3))
    corners = pixel_rays(camera)[[0, 0, -1, -1], [0, -1, -1, 0]]
    corners[:, 0] += np.array([-0.5, 0.5, 0.5, -0.5]) / camera.fx
    corners[:, 1] += np.array([0.5, 0.5, -0.5, -0.5]) / camera.fy
    sides = [
        ((one + other) / 2, np.cross(other, one)) for one, other in zip(corners, np.roll(corners, -1, 0), strict=True)
    ]
    for on_side, outwards in [*sides, (np.zeros(3), np.array([0, 0, 1.0]))]:
        middle_m = pose[:3, :3] @ (on_side + 0.1 * outwards / np.linalg.norm(outwards)) + pose[:3, 3]
        assert touches_view(middle_m, 0.101, camera, pose) and not touches_view(middle_m, 0.099, camera, pose)


def frame_at(depth_m, **known):
    depth_m = np.asarray(depth_m, np.float32)
    height, width = depth_m.shape
    camera = Intrinsics(width, height, 10.0, 10.0, width / 2, height / 2)
    return RgbdFrame(np.zeros((height, width, 3), np.uint8), depth_m, camera, np.eye(4), **known)


def test_objects_are_put_over_the_frame_by_their_alpha_where_nothing_of_the_room_is_before_them():
    background = np.full((3, 9, 3), 0.3)
    room = frame_at(np.full((3, 9), 2.0), exposure=2.0, white_balance=np.array([0.5, 1.0, 1.5]))
    depth_m = np.full((3, 9), 1e10, np.float32)  # None, at a soft edge, but for the first and the last two columns:
    depth_m[:, 0], depth_m[:, 7], depth_m[:, 8] = 1.0, 2.0055, 2.0065
    passes = {"Depth.Z": depth_m, "Combined.A": np.full((3, 9), 0.75, np.float32)}
    passes |= {f"Combined.{channel}": np.full((3, 9), 0.1, np.float32) for channel in "RGB"}
    picture, weights = composite(background, [passes], room)
    np.testing.assert_array_equal(weights, np.broadcast_to([0.75] * 8 + [0], (3, 9)))
    shown = 0.1 * 2.0 * np.array([0.5, 1.0, 1.5]) + 0.25 * 0.3
    np.testing.assert_allclose(picture, np.where(weights[..., None] > 0, shown, background), rtol=1e-6)
    # Behind the room there is nothing of an object, nor at its soft edge; through a window all of it.
    far = passes | {"Depth.Z": np.where(depth_m < 3, 2.5, depth_m)}
    np.testing.assert_array_equal(composite(background, [far], room)[1][1], [0, 0, *[0.75] * 4, 0, 0, 0])
    assert (composite(background, [far], frame_at(np.zeros((3, 9))))[1] == 0.75).all()
    # Two of them cover what they cover together, at most all. What a catcher shows lies on the room, but for 5 %.
    assert (composite(background, [passes, passes], room)[1][:, :8] == 1).all()
    for index, covers in ((CATCHER_INDEX, True), (1, False)):
        for depth in (2.1, 2.25):
            fog = passes | {"Depth.Z": np.full((3, 9), depth), "Object Index.X": np.full((3, 9), index)}
            assert (composite(background, [fog], room)[1] > 0).all() == (covers and depth < 2.2)


def test_a_point_has_most_of_the_light_of_the_nearest_position_and_what_is_no_light_is_not_mixed():
    frame = frame_at(np.full((1, 2), 2.0))
    depth_m = np.array([[2.0, 1e10]], np.float32)
    one = caught(np.full((1, 2, 3), 0.8)) | {"Depth.Z": depth_m, "Combined.R": np.float32([[1, 1]])}
    other = caught(np.array([[[np.nan] * 3, [9.0] * 3]])) | {"Depth.Z": depth_m, "Combined.R": np.float32([[3, 3]])}
    point_m = np.array([-0.1, 0, -2.0])
    away = np.array([0.3, 0, 0]), np.array([0, 0.1, 0])
    mixed = blended([one, other], [point_m + off for off in away], frame)
    ratio = ((0.3**2 + 0.05**2) / (0.1**2 + 0.05**2)) ** 2
    assert mixed["Combined.R"][0] == pytest.approx([(1 + 3 * ratio) / (1 + ratio), 2.0], rel=1e-5)
    said = mixed[SHADOW_CHANNELS[0]][0]
    assert said == pytest.approx([(0.8 + ratio) / (1 + ratio), (0.8 + BRIGHTEST) / 2], rel=1e-5)
    for name in ("Depth.Z", "Combined.A"):
        np.testing.assert_array_equal(mixed[name], one[name])
