"""An object that is bigger than one position can stand for is lit at each of its positions."""

import numpy as np
from renders import captured
from tiny_scenes import box, empty_scene, material, phone, set_world

from xihe_blender.capture.render import RenderSettings
from xihe_blender.compare.methods import open_comparer
from xihe_blender.scene.estimation_positions import estimation_positions
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.light.key_light import mean_light, with_positions
from xihenet.records import ObjectLight

SETTINGS = RenderSettings((64, 48), 16)


def even(radiance):
    return ObjectLight(np.sqrt(4 * np.pi) * np.eye(9)[0][:, None] * np.array(radiance))


def test_a_long_board_is_lit_at_its_ends_as_the_positions_there_are():
    scene = empty_scene()
    set_world(scene, (0.1,) * 3)
    look = material("White", (1, 1, 1))
    board = box(scene, "Board", (0, 0, 1), (2.4, 0.2, 0.2), look, virtual_collection(scene, create=True))
    phone(scene, (0, -3, 1), (0, 0, 1))
    places = estimation_positions(board)
    assert len(places) == 3
    each = {str(k): even([0.1 * k, 0.05, 0.2 - 0.1 * k]) for k in range(3)}
    mean = mean_light(list(each.values()))
    lights = {
        "mean": {"Board": mean},
        "each": {"Board": with_positions(mean, dict(zip(each, places, strict=True)), each)},
    }
    with open_comparer(scene, [board], list(lights), SETTINGS) as comparer:
        passes = comparer.render_layers(captured(scene), lights).layers
        shown = {
            method: np.stack([passes[comparer.layers[method, "Board"]][f"Combined.{c}"] for c in "RGB"], axis=-1)
            for method in lights
        }
        alpha = passes[comparer.layers["each", "Board"]]["Combined.A"]
        assert all(layer.use for layer in comparer.lit.view_layers)
    columns = np.flatnonzero(alpha[24] > 0.99)
    left, middle, right = columns[1], 32, columns[-2]
    expected = {left: (0.0, 0.05, 0.2), middle: (0.1, 0.05, 0.1), right: (0.2, 0.05, 0.0)}
    for column, colour in expected.items():
        np.testing.assert_allclose(shown["each"][24, column], colour, atol=0.02)
        np.testing.assert_allclose(shown["mean"][24, column], (0.1, 0.05, 0.1), atol=0.01)
    # From end to end it changes without a step.
    steps = np.diff(shown["each"][24, columns[1:-1]], axis=0)
    assert (steps[:, 0] > -0.02).all() and steps[:, 0].max() < 0.03
