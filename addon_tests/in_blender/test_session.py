"""Placing an object in a live session lights it."""

import bpy
import numpy as np
import pytest
from tiny_scenes import box, room_with_a_virtual_sphere

from xihe_blender.apply.datablocks import NODE_GROUP_NAME
from xihe_blender.apply.session import XiheController
from xihe_blender.apply.sh_worlds import COEFFICIENTS, GAIN
from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import open_scanner
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.sh import dering_for_display


def session():
    return XiheController(LocalBackend(estimators.load("projection", 320)))


def captured(scene):
    with open_scanner(scene, RenderSettings((64, 48), samples=4, denoise=False)) as scanner:
        scanner.move_to(1)
        return scanner.acquire_environment_scan()


def test_a_placed_object_is_lit_by_the_estimate_at_its_position():
    scene = room_with_a_virtual_sphere()
    controller, frame, ball = session(), captured(scene), bpy.data.objects["Ball"]
    controller.step(frame)
    estimate = controller.place_and_estimate_at(ball, (0.3, 0.1, 0.9))
    np.testing.assert_allclose(ball.matrix_world.translation, (0.3, 0.1, 0.9), atol=1e-6)
    np.testing.assert_allclose(estimate.sh_radiance, controller.estimate_at((0.3, 0.1, 0.9)).sh_radiance, atol=1e-6)
    inputs = bpy.data.worlds["Xihe Ball"].node_tree.nodes[NODE_GROUP_NAME].inputs
    np.testing.assert_allclose([inputs[c].default_value[:] for c in COEFFICIENTS], estimate.sh_radiance, rtol=1e-5)
    assert inputs[GAIN].default_value == pytest.approx(1 / estimate.exposure)
    assert "Ball" in controller.step(frame)


def test_a_world_to_be_looked_at_leaves_the_estimate_as_it_is(monkeypatch):
    scene = room_with_a_virtual_sphere()
    controller = session()
    controller.step(captured(scene))
    light = np.vstack([np.ones((1, 3)), np.full((8, 3), 0.9)])
    monkeypatch.setattr(controller.backend.estimator, "estimate", lambda *_: light)
    estimate = controller.place_and_estimate_at(bpy.data.objects["Ball"], (0.3, 0.1, 0.9), is_deringed=True)
    inputs = bpy.data.worlds["Xihe Ball"].node_tree.nodes[NODE_GROUP_NAME].inputs
    np.testing.assert_array_equal(estimate.sh_radiance, light)
    shown = [inputs[c].default_value[:] for c in COEFFICIENTS]
    np.testing.assert_allclose(shown, dering_for_display(light), rtol=1e-6)


def test_an_object_of_the_users_becomes_a_virtual_one_and_a_big_one_gets_several_positions():
    scene = room_with_a_virtual_sphere()
    controller = session()
    controller.step(captured(scene))
    shelf = box(scene, "Shelf", (0, 0, 0), (2.5, 0.2, 0.2))
    estimate = controller.place_and_estimate_at(shelf, (0, 0.2, 1.0))
    assert shelf in virtual_objects(scene) and estimate.is_valid
    assert {name for name in controller.positions if name.startswith("Shelf")} == {"Shelf 1", "Shelf 2", "Shelf 3"}


def test_placing_before_the_first_frame_is_refused():
    room_with_a_virtual_sphere()
    with pytest.raises(ValueError, match="no frame yet"):
        session().place_and_estimate_at(bpy.data.objects["Ball"], (0, 0, 1))


@pytest.mark.parametrize("wrong", [(0, 0), (0, 0, np.inf)])
def test_a_place_that_is_no_point_is_refused(wrong):
    room_with_a_virtual_sphere()
    with pytest.raises(ValueError, match="three finite coordinates"):
        session().place_and_estimate_at(bpy.data.objects["Ball"], wrong)
