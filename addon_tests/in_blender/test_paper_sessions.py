"""The evaluation of the paper walks a scene's path in as many frames as it wants."""

import itertools
from dataclasses import replace

import bpy
import numpy as np
import pytest
from previs_runs import survey, walk
from tiny_scenes import saved, set_world

from xihe_blender.capture.scanner import phone_camera
from xihe_blender.errors import UserError
from xihe_blender.lab.paper.sessions import QUICK_WALK, check_session, open_walk, planned_walk, recorded_session
from xihe_blender.scene.units import seconds_of


def test_a_path_of_few_frames_is_walked_in_more_of_them_over_the_same_places_in_the_same_time(tmp_path):
    walk()
    file = saved(tmp_path / "walk.blend")
    poses, times_s = {}, {}
    for n_between in (1, 4):
        scene = open_walk(file, n_between)
        for frame in range(scene.frame_start, scene.frame_end + 1):
            scene.frame_set(frame)
            where = poses.setdefault(n_between, [])
            where.append(phone_camera(scene)[1])
            times_s.setdefault(n_between, []).append(seconds_of(scene, frame))
    np.testing.assert_allclose(poses[4][::4], poses[1], atol=1e-6)
    np.testing.assert_allclose(times_s[4][::4], times_s[1])
    assert all(np.abs(a - b).max() > 0 for a, b in itertools.pairwise(poses[4]))
    assert len(planned_walk(file, replace(QUICK_WALK, n_frames=20), 0)[3]) == len(poses[4])


def test_a_session_of_a_room_whose_pictures_have_changed_since_is_refused(tmp_path):
    scene = walk(2)
    picture, of_walk = tmp_path / "sky.png", replace(QUICK_WALK, n_frames=2, size=(16, 12))
    picture.write_bytes(b"one")
    set_world(scene).node_tree.nodes.new("ShaderNodeTexEnvironment").image = bpy.data.images.load(str(picture))
    file, folder = saved(tmp_path / "walk.blend"), tmp_path / "session"
    begun = recorded_session(file, folder, of_walk, 0)
    survey(begun)
    begun.close()
    check_session(file, folder, of_walk, 0)
    picture.write_bytes(b"two")
    with pytest.raises(UserError, match="another library, image or other file"):
        check_session(file, folder, of_walk, 0)


def test_a_scene_that_cannot_be_recorded_is_named(tmp_path):
    walk(2).camera = None
    file = saved(tmp_path / "blind.blend")
    with pytest.raises(UserError, match=r"blind\.blend: .* has no camera"):
        check_session(file, tmp_path / "session", QUICK_WALK, 0)
