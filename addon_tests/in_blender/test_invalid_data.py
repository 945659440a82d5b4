"""What a run says of what it could not use: points and pixels by reason, and lights that could not be known."""

import numpy as np
import pytest
from previs_runs import run
from renders import captured
from results_schema import read_strictly
from tiny_scenes import box, empty_scene, light_strength, look_at, material, phone, set_world, sphere

from xihe_blender.addon.panels import result_rows
from xihe_blender.addon.runs_folder import last_run
from xihe_blender.cli.previs import format_summary
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.camera import invalid_pixels
from xihenet.invalid import counted

BALL = np.array([0.0, 0.0, 1.0])
AT_THE_WALL, AT_NOTHING = (0.0, -2.0, 1.0), (0.0, 1.2, 1.0)


def stage(*looks):
    """A bright wall behind a ball, nothing all around; the phone looks at the ball from `looks`, one per frame."""
    scene = empty_scene()
    scene.frame_end = len(looks)
    set_world(scene)
    box(scene, "Wall", (0, 2, 1), (6, 0.1, 4), material("Light", (1.0, 0.8, 0.6), emission=1.0))
    sphere(scene, "Ball", BALL, 0.12, material("Grey", (0.5, 0.5, 0.5)), virtual_collection(scene, create=True))
    camera = phone(scene, AT_THE_WALL, BALL)
    for frame, place in enumerate(looks, start=1):
        look_at(camera, place, BALL, frame)
    return scene


@pytest.fixture(scope="module")
def blinded(tmp_path_factory):
    """Results and folder of a run whose phone sees no surface in its middle frames."""
    out = tmp_path_factory.mktemp("blinded") / "out"
    return run(stage(AT_THE_WALL, AT_NOTHING, AT_NOTHING, AT_THE_WALL), out), out


def probes_of(results):
    return [probe for entry in results["frames"] for probe in entry["probes"]]


def test_a_run_goes_on_with_the_last_light_where_none_can_be_known(blinded):
    results, out = blinded
    assert read_strictly(out / "results.json") == results
    probes = probes_of(results)
    assert [probe["is_valid"] for probe in probes] == [True, False, False, True]
    assert [probe["unknown_because"] for probe in probes] == [None, "nothing_seen", "nothing_seen", None]
    assert [probe["light_frame"] for probe in probes] == [1, 1, 1, 1]
    assert probes[1]["sh"] == probes[2]["sh"] == probes[0]["sh"]
    assert [change["frame"] for change in results["lights"]["Ball"]] == [1]


def test_the_kept_light_is_said_in_words_everywhere(blinded):
    results, out = blinded
    note = next(note for note in results["notes"] if "could not be known" in note)
    assert "Ball" in note and "2" in note and "3" in note and "the light of frame 1 was kept" in note
    assert "no surface was seen" in note
    assert "kept 2 times" in format_summary(results)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "last light kept: no surface was seen from there" in page
    assert "the light of frame 1 was kept" in page
    rows = {name: value for name, value, _ in result_rows(last_run(str(out)))}
    assert rows["Unknown Light"] == "2 times"
    assert rows["No Depth"] == f"{results['summary']['n_invalid_points']:,} points"


def test_every_invalid_point_and_pixel_has_a_reason(blinded):
    results, _ = blinded
    width, height = results["settings"]["size"]
    for entry in results["frames"]:
        (probe,) = entry["probes"]
        assert entry["invalid"] == counted(no_surface=entry["n_invalid_pixels"])
        assert probe["invalid"] == counted(no_surface=probe["n_invalid_points"])
        assert probe["n_invalid_points"] == entry["n_invalid_pixels"]
    assert [entry["n_invalid_pixels"] == width * height for entry in results["frames"]] == [False, True, True, False]
    summary = results["summary"]
    assert summary["invalid"]["points"] == {"no_surface": summary["n_invalid_points"]}
    assert summary["invalid"]["lights"] == {"nothing_seen": 2} and summary["n_unknown_lights"] == 2


def test_before_the_first_light_the_ambient_one_stands_in_and_is_named(tmp_path):
    results = run(stage(AT_NOTHING, AT_THE_WALL), tmp_path / "out")
    blind, seeing = probes_of(results)
    assert (blind["is_valid"], blind["light_frame"]) == (False, None)
    assert (seeing["is_valid"], seeing["light_frame"], seeing["reason"]) == (True, 2, "first")
    assert not np.any(blind["sh"]) and np.any(seeing["sh"])
    assert any("the phone's ambient light was used instead" in note for note in results["notes"])


def test_negative_light_is_counted_where_it_is_taken_for_black():
    scene = stage(AT_THE_WALL)
    light_strength().default_value = -1.0
    # A denoiser would take it for black before anyone can see it.
    frame = captured(scene, (32, 24))
    assert frame.invalid == {"negative_colour": 32 * 24}
    assert not frame.srgb_u8.any() and invalid_pixels(frame) == {}
