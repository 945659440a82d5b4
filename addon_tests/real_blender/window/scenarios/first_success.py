"""From an open room to a lit object in a few clicks, then Undo, Redo, the comparison, saving, and Remove."""

import pathlib
import shutil
import subprocess
import time

import bpy
from bpy_extras.object_utils import world_to_camera_view
from bpy_extras.view3d_utils import location_3d_to_region_2d
from free_window import Heartbeat
from rooms import look_through_camera, make_runs_short, room_to_light

from xihe_blender.addon import placement_map as placement_view
from xihe_blender.addon.overlay import labels_in
from xihe_blender.apply.datablocks import LightOf, placement_map
from xihe_blender.apply.placement_map import MapOf


def prepare():
    room_to_light()


def left_in_file():
    """Everything of a run that is in the file, by kind."""
    kinds = ("worlds", "images", "node_groups", "actions", "scenes", "meshes", "materials")
    left = {kind: sorted(b.name for b in getattr(bpy.data, kind) if b.name.startswith("Xihe ")) for kind in kinds}
    left["markers"] = sorted(m.name for scene in bpy.data.scenes for m in scene.timeline_markers)
    return left


def scenario(w):
    scene = bpy.context.scene
    make_runs_short(scene)
    look_through_camera(w)
    yield from w.open_tab()
    with w.context():
        # What was set up here is what the first Undo goes back to.
        bpy.ops.ed.undo_push(message="Room")
    w.facts["before"] = left_in_file()
    yield from w.picture("1_room")
    yield from w.click_on("xihe.add_virtual_objects", across=0.3)
    yield 0.5
    w.facts["virtual"] = [o.name for o in bpy.data.collections["Xihe Virtual"].objects]
    yield from w.picture("2_virtual")
    job = bpy.context.window_manager.xihe
    yield from w.click_on("xihe.run(")
    yield from w.wait_until(lambda: job.is_running or scene.xihe.run_folder, "the run begins", at_most_s=20)
    yield from w.wait_until(lambda: job.doing or not job.is_running, "the run goes on")
    w.facts["under_way"] = {"is_running": job.is_running, "doing": job.doing, "progress": job.progress}
    w.picture_now("3_running")
    yield from w.wait_until(lambda: not job.is_running, "the run ends")
    yield 1
    w.facts["error"] = job.error
    w.facts["after"] = left_in_file()
    w.facts["folder"] = bpy.context.scene.xihe.run_folder
    yield from w.picture("4_done")
    yield from see_it_lit(w)
    yield from see_the_comparison(w)
    yield from undo_and_redo(w)
    yield from undo_the_lit_scene(w)
    bpy.ops.wm.save_as_mainfile(filepath=str(w.out / "saved.blend"), copy=True)
    yield from see_the_map(w)
    yield from remove(w)


def see_it_lit(w):
    """There, along the timeline, and back."""
    w.window.scene.frame_set(1)
    yield from w.click_on("xihe.show_lit")
    yield 4
    space = w.area.spaces.active
    shown = {"scene": w.window.scene.name, "world": w.window.view_layer.world_override.name}
    w.facts["lit"] = {**shown, "shading": space.shading.type, "view": space.region_3d.view_perspective}
    w.facts["lit"]["floor"] = space.overlay.show_floor
    w.facts["lit"]["colours"] = colours_in_view(w, w.picture_now("4_lit"))
    w.window.scene.frame_set(6)
    yield 4
    w.picture_now("4_lit_later")
    yield from move_the_ball(w)
    w.window.scene.render.filepath = str(w.out / "rendered.png")
    bpy.ops.render.render(write_still=True, scene=w.window.scene.name)
    yield from w.click_on("xihe.show_room")
    yield 1
    w.facts["back"] = {"scene": w.window.scene.name, "shading": space.shading.type}
    w.facts["back"]["floor"] = space.overlay.show_floor
    view = space.region_3d
    view.view_perspective, view.view_rotation, view.view_distance = "PERSP", (0.8, 0.6, 0.0, 0.0), 5.0
    w.facts["from_aside"] = [from_where(view)]
    with w.context():
        bpy.ops.xihe.show_lit()
    yield 0.5
    # As Blender's own menu of scenes does.
    w.window.scene = bpy.data.scenes["Scene"]
    yield 0.5
    w.facts["back_by_menu"] = {"scene": w.window.scene.name, "shading": space.shading.type}
    w.facts["back_by_menu"]["floor"] = space.overlay.show_floor
    w.facts["from_aside"].append(from_where(view))
    view.view_perspective = "CAMERA"
    yield from w.picture("4_back")


def move_the_ball(w):
    """Its light follows, and the window goes on; put back, it has the run's."""
    ball, world = bpy.data.objects["Ball"], bpy.data.worlds["Xihe Ball"]
    heart = Heartbeat()
    start = time.perf_counter()
    ball.location.x += 0.4
    yield from w.wait_until(lambda: LightOf.read(world).live, "the light follows the ball")
    w.facts["followed_s"] = time.perf_counter() - start
    yield 3
    w.facts["follow_freeze_s"] = heart.stop()
    w.facts["live"] = LightOf.read(world).live
    w.picture_now("4_moved")
    ball.location.x -= 0.4
    yield from w.wait_until(lambda: not LightOf.read(world).live, "the light of the run is back")


def colours_in_view(w, screenshot):
    """Mean colours of a part of the captured frame, and of the ball: on the screen, and as the run has them."""
    scene, camera = w.window.scene, w.window.scene.camera
    region = next(region for region in w.area.regions if region.type == "WINDOW")
    view = w.area.spaces.active.region_3d
    frame = [camera.matrix_world @ corner for corner in camera.data.view_frame(scene=scene)]
    right_top, _, left_bottom, _ = (location_3d_to_region_2d(region, view, corner) for corner in frame)
    ball = world_to_camera_view(scene, camera, bpy.data.objects["Ball"].matrix_world.translation)
    pictures = pathlib.Path(bpy.data.scenes["Scene"].xihe.run_folder) / "pictures"
    colours = {}
    for name, kind, middle, size in (("frame", "captured", (0.2, 0.5), 0.3), ("ball", "lattice", ball, 0.05)):
        box = [middle[0] - size / 2, 1 - middle[1] - size / 2, size, size]
        wide, high = right_top.x - left_bottom.x, right_top.y - left_bottom.y
        left, top = region.x + left_bottom.x, w.window.height - region.y - right_top.y
        on_screen = [left + box[0] * wide, top + box[1] * high, size * wide, size * high]
        in_picture = [box[0] * 32, box[1] * 24, size * 32, size * 24]
        seen = mean_colour(screenshot, on_screen)
        colours[name] = [seen, mean_colour(pictures / f"{kind}_0001.png", in_picture)]
    return colours


def mean_colour(picture, box):
    """Red, green and blue, 0 to 1, of a part of a picture: left, top, width and height in pixels."""
    left, top, width, height = (max(1, round(number)) for number in box)
    part = ["-crop", f"{width}x{height}+{left}+{top}", "+repage", "-format", "%[fx:mean.r] %[fx:mean.g] %[fx:mean.b]"]
    done = subprocess.run(["convert", picture, *part, "info:"], capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


def see_the_comparison(w):
    other = next(a for a in w.window.screen.areas if a.type == "PROPERTIES")
    with bpy.context.temp_override(window=w.window, area=other):
        other.type = "IMAGE_EDITOR"
    yield 0.5
    yield from w.click_on("xihe.show_comparison", across=0.3)
    yield 0.5
    w.facts["compared"] = [
        a.spaces.active.image.name
        for a in w.window.screen.areas
        if a.type == "IMAGE_EDITOR" and a.spaces.active.image is not None
    ]
    w.facts["n_windows"] = len(bpy.context.window_manager.windows)
    yield from w.picture("5_comparison")
    w.facts["wipe"] = bpy.context.scene.xihe.wipe
    shown = bpy.data.images["Xihe Comparison"]
    before = shown["xihe_frame"]
    bpy.context.scene.xihe.wipe = 0.2
    w.window.scene.frame_set(1)
    yield from w.wait_until(lambda: shown["xihe_frame"] != before, "the comparison follows", at_most_s=20)
    yield 1
    yield from w.picture("6_wiped")
    folder = pathlib.Path(bpy.context.scene.xihe.run_folder)
    job, heart = bpy.context.window_manager.xihe, Heartbeat()
    yield from w.click_on("xihe.save_side_by_side", across=0.3)
    w.facts["saving"] = job.doing
    yield from w.wait_until(lambda: not job.is_running, "the video is saved")
    w.facts["save_freeze_s"] = heart.stop()
    w.facts["saved"] = sorted(file.name for file in folder.glob("*.mp4"))


def see_the_map(w):
    """Made in steps beside a beating heart; then the mouse rests on its best place."""
    heart = Heartbeat()
    with w.context():
        bpy.ops.xihe.map_places("INVOKE_DEFAULT")
    yield from w.wait_until(placement_map, "the map is made")
    yield 1
    w.facts["map_freeze_s"] = heart.stop()
    item = placement_map()
    index = MapOf.read(item.data).best[0]
    region = next(region for region in w.area.regions if region.type == "WINDOW")
    pixel = location_3d_to_region_2d(region, w.area.spaces.active.region_3d, item.data.polygons[index].center)
    w.move(region.x + pixel.x - 3, region.y + pixel.y)
    yield 0.5
    w.move(region.x + pixel.x, region.y + pixel.y)
    yield 1
    view = placement_view._view
    with w.context(region):
        w.facts["under_mouse"] = [view.under_mouse(bpy.context, item), index]
        words = view.box_of_words(bpy.context, placement_view.format_place(item, index))
        w.facts["words_and_labels"] = [words, *labels_in(region)]
    yield from w.picture("8_map")


def undo_and_redo(w):
    w.move(w.area.x + w.area.width * 0.3, w.area.y + w.area.height * 0.5)
    yield 0.3
    yield from press_until(w, "ctrl+z", lambda: not left_in_file()["worlds"])
    w.facts["undone"] = left_in_file()
    yield from w.picture("7_undone")
    yield from press_until(w, "ctrl+shift+z", lambda: left_in_file() == w.facts["after"])
    w.facts["redone"] = left_in_file()
    yield from w.picture("8_redone")


def from_where(view):
    return [round(number, 4) for number in (*view.view_rotation, *view.view_location, view.view_distance)]


def view_now(w):
    space = w.area.spaces.active
    return [w.window.scene.name, space.shading.type, space.region_3d.view_perspective, space.overlay.show_floor]


def undo_the_lit_scene(w):
    before = view_now(w)
    with w.context():
        bpy.ops.xihe.show_lit("EXEC_DEFAULT", True)
    yield 0.5
    w.facts["views"] = [before, view_now(w)]
    for key, name in (("ctrl+z", "Scene"), ("ctrl+shift+z", "Xihe Lit"), ("ctrl+z", "Scene")):
        yield from press_until(w, key, lambda: w.window.scene.name == name)  # noqa: B023 - asked at once
        yield 0.5
        w.facts["views"].append(view_now(w))


def press_until(w, key, is_there, at_most=5):
    """Changes of the wipe count as steps of their own; how many it took is noted."""
    n = 0
    while not is_there() and n < at_most:
        w.press(key)
        yield 1.0
        n += 1
    w.facts[f"n_{key}"] = n


def remove(w):
    with w.context():
        bpy.ops.xihe.show_lit()
    yield 0.5
    yield from w.click_on("xihe.remove_light", across=0.7)
    yield 0.8
    w.facts["removed"] = left_in_file()
    w.facts["views"].append(view_now(w))
    yield from w.picture("9_removed")
    # The run's own folder is the user's to keep; a test's is not.
    shutil.rmtree(bpy.context.scene.xihe.run_folder)
