"""What notes say of a scene that was seen at an exposure which the user chose."""

import math
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from tiny_scenes import add_instance, add_lamp, box, empty_scene, material, phone

from addon_tests.pure import runs
from xihe_blender.io.json_records import from_json
from xihe_blender.io.run_results import FrameResult
from xihe_blender.previs.results_notes import (
    dim_notes,
    exposure_notes,
    faults_seen,
    frame_notes,
    recorded_warnings,
    shining_notes,
    unanswered_notes,
    white_notes,
)
from xihe_blender.previs.settings import PrevisSettings


def notes_of(exposure, radiance, around=None, *, is_chosen=True, target="hdr"):
    """All that is said of the light of a room of one even radiance; `around` is that at the object."""
    mean = (radiance if around is None else around) * exposure
    clipped = min(mean, 1.0)
    truth = [[math.sqrt(4 * math.pi) * (mean if target == "hdr" else clipped)] * 3] + [[0.0] * 3] * 8
    probe = runs.probe(sh_truth=truth, share_above_white=None if mean == 0 else 1 - clipped / mean)
    # As the sensor has it: of an 8-bit picture, clipped at white.
    sensed = np.floor(min(radiance * exposure, 1.0) / 3e-4) * 3e-4 / exposure
    seen = runs.frame(1, probe, captured=True, exposure=exposure, ambient_radiance=[sensed] * 3)
    frames = [from_json(FrameResult, seen)]
    settings = PrevisSettings(exposure=exposure if is_chosen else None, target=target)
    return [
        *faults_seen((), frames, 100, is_chosen=is_chosen),
        *dim_notes(bpy.context.scene, settings, exposure, frames),
        *exposure_notes(settings, exposure, frames),
    ]


@pytest.mark.parametrize("target", ["hdr", "ldr"])
def test_a_room_is_judged_by_its_light_and_not_by_the_exposure_that_was_chosen(target):
    assert notes_of(1.7, 0.4, target=target) == []
    for exposure in (1e-5, 1e-3, 5e-3):
        (black,) = notes_of(exposure, 0.4, target=target)
        assert black.startswith(f"At the chosen exposure of {exposure:g} the phone saw next to nothing")
    assert notes_of(1e-2, 0.4, target=target) == []
    (white,) = notes_of(200.0, 0.4, target=target)
    assert white.startswith("At the chosen exposure of 200 the captures are white")


@pytest.mark.parametrize("is_chosen", [True, False])
def test_a_dim_or_dark_room_and_a_buried_object_are_named_at_any_exposure(is_chosen):
    (dim,) = notes_of(500.0, 1e-3, is_chosen=is_chosen)
    assert "light threshold of 0.01" in dim
    (dark,) = notes_of(2.0, 0.0, is_chosen=is_chosen)
    assert dark.startswith("Neither the phone nor a light probe saw any light")
    (buried,) = notes_of(2.0, 0.4, 0.0, is_chosen=is_chosen)
    assert "is it inside an object?" in buried


@pytest.mark.parametrize(("shares", "words"), [((0.5, 0.504), "50% is brighter"), ((0.2, 0.5), "20% to 50% is")])
def test_light_beyond_white_is_told_as_a_share_or_a_range(shares, words):
    frames = [from_json(FrameResult, runs.frame(1, runs.probe(share_above_white=share))) for share in shares]
    (note,) = white_notes(frames)
    assert words in note


def test_estimates_that_no_edge_service_gave_are_counted_and_others_not():
    lost, other = ({"is_valid": False, "unknown_because": why} for why in ("no_answer", "nothing_seen"))
    frames = [from_json(FrameResult, runs.frame(1, *(runs.probe(**one) for one in (lost, other, {}, lost))))]
    (note,) = unanswered_notes(frames)
    assert note.startswith("The edge service did not answer 2 times: ")
    assert recorded_warnings(SimpleNamespace(survey=SimpleNamespace(faults=())), frames) == [note]
    assert not list(unanswered_notes([from_json(FrameResult, runs.frame(1, runs.probe(**other)))]))


def test_what_of_the_scenes_colour_management_pictures_leave_out_is_named():
    scene = empty_scene()
    scene.view_settings.view_transform = "Standard"
    assert "transform: as the scene has it." in next(frame_notes(scene, ()))
    scene.view_settings.exposure, scene.view_settings.use_curve_mapping = 1.0, True
    assert "the scene's own, exposure and curves, would distort" in next(frame_notes(scene, ()))


def test_pixels_without_a_distance_are_told_with_the_cameras_clip_end():
    scene = empty_scene()
    phone(scene, (0, 0, 1), (0, 1, 1)).data.clip_end = 200
    scene.unit_settings.scale_length = 0.01
    frames = [from_json(FrameResult, runs.frame(1, n_invalid_pixels=7))]
    (note,) = (one for one in frame_notes(scene, frames) if "plane depth" in one)
    assert note.startswith("7 captured pixels") and "beyond the camera's Clip End, 2 m" in note


def test_virtual_objects_that_shine_are_named():
    scene = empty_scene()
    asset = bpy.data.collections.new("Asset")
    box(scene, "Stand", (0, 0, 0), (1, 1, 1), material("Grey"), asset)
    lantern, vase = add_instance(scene, asset), box(scene, "Vase", (0, 0, 0), (1, 1, 1))
    assert not list(shining_notes([lantern, vase]))
    glowing = box(scene, "Neon", (0, 0, 0), (1, 1, 1), material("Glow", emission=2.0))
    flame = add_lamp(scene, collection=asset, energy=0.0).data
    (said,) = shining_notes([lantern, vase, glowing])
    assert said.startswith("Virtual objects that shine: Neon. Their light falls on the room in the ground truth")
    flame.energy = 1.0
    (said,) = shining_notes([lantern, vase])
    assert said.startswith("Virtual objects that shine: Instance.")
