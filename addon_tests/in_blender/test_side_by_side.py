"""A run side by side: its own pictures, labelled, and a video that plays as long as the walk."""

import bpy
import numpy as np
import pytest
from renders import pixels_of_file
from scene_snapshot import nothing_changes
from tiny_scenes import room_with_a_virtual_sphere

from addon_tests.pure import runs
from addon_tests.pure.commands import assert_refused, xihe_here
from xihe_blender.compare.side_by_side import BAR_PX, middle_of_change, save_side_by_side, wiped
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import write_json, write_picture
from xihe_blender.io.run_results import read_results

SIZE = 33, 60
FACTOR = 8
FRAMES = 1, 4, 7, 10
KINDS = "captured", "ground_truth", "projection", "ambient"


@pytest.fixture
def run(tmp_path):
    """A folder with four compared frames of 60x33, of noise: three every 30th of a second apart."""
    rng, frames = np.random.default_rng(5), []
    for number in FRAMES:
        pictures = {kind: f"pictures/{kind}_{number:04d}.png" for kind in KINDS}
        for path in pictures.values():
            write_picture(tmp_path / path, rng.integers(0, 256, (*SIZE, 3), np.uint8))
        frames.append(runs.frame(number, runs.probe(), **{**runs.compared(KINDS), "pictures": pictures}))
    comparison = {name: runs.metrics(0.1) for name in ("projection", "ambient")}
    write_json(tmp_path / "results.json", runs.content(frames, comparison=comparison))
    return tmp_path


def panels(picture):
    """The four pictures of a side by side, and the bars above them, each as its own array."""
    height, width = FACTOR * SIZE[0], FACTOR * SIZE[1]
    rows = [picture[k * (height + BAR_PX) :][: height + BAR_PX] for k in range(2)]
    cells = [row[:, k * width : (k + 1) * width] for row in rows for k in range(2)]
    return [cell[BAR_PX:] for cell in cells], [cell[:BAR_PX] for cell in cells]


@pytest.mark.parametrize(
    ("wipe", "row"),
    [(-1, "tttt"), (0, "tttt"), (0.1, "tttt"), (0.25, "e|tt"), (0.7, "eee|"), (0.95, "eeee"), (1, "eeee"), (9, "eeee")],
)
def test_a_wipe_has_the_estimate_on_its_left_and_its_middle_is_where_most_changes(wipe, row):
    estimate, truth = (np.full((2, 4, 3), value, np.float32) for value in (0.25, 0.5))
    shown = [{"e": 0.25, "t": 0.5, "|": 1.0}[letter] for letter in row]
    assert (wiped(estimate, truth, wipe) == np.array(shown)[:, None]).all()
    truth[:, 1] = estimate[:, 1]
    assert middle_of_change(truth, truth) == 0.5 and middle_of_change(estimate, truth) == 2.5 / 4


def test_every_picture_is_there_unchanged_below_a_label(run):
    results = read_results(run)
    save_side_by_side(results, run)
    for k, frame in enumerate(FRAMES, start=1):
        shown, bars = panels(pixels_of_file(run / "pictures" / f"side_by_side_{frame:04d}.png")[..., :3])
        captured, truth, estimate = (
            pixels_of_file(run / "pictures" / f"{kind}_{frame:04d}.png")[..., :3]
            for kind in ("captured", "ground_truth", "projection")
        )
        large = [part.repeat(FACTOR, 0).repeat(FACTOR, 1) for part in (captured, truth, estimate)]
        for seen, expected in zip(shown, [*large, wiped(large[2], large[1], k / 5)], strict=True):
            np.testing.assert_allclose(seen, expected, atol=1.5 / 255)
        for bar in bars:
            assert bar.max() > 0.9 and bar[:2].max() < 0.1, "a label, inside its bar"
            assert bar[:, -BAR_PX:].max() < 0.1, "which is not cut"


def test_the_video_plays_as_long_as_the_walk(run):
    video = save_side_by_side(read_results(run), run, "ambient")
    clip = bpy.data.movieclips.load(str(video))
    try:
        assert clip.frame_duration == len(FRAMES)
        assert clip.fps == pytest.approx(10.0), "every third frame of 30 a second"
        assert tuple(clip.size) == (2 * FACTOR * SIZE[1], 2 * (FACTOR * SIZE[0] + BAR_PX))
    finally:
        bpy.data.movieclips.remove(clip)


def test_the_open_file_stays_as_it_was(run):
    scene = room_with_a_virtual_sphere(2)
    with nothing_changes():
        save_side_by_side(read_results(run), run)
    assert list(bpy.data.scenes) == [scene]


def test_one_compared_frame_is_enough(run):
    content = read_results(run)
    (run / "results.json").unlink()
    one = [frame for frame in content.frames if frame.frame == 4]
    assert save_side_by_side(type(content)(**{**vars(content), "frames": tuple(one)}), run).is_file()


def test_what_cannot_be_shown_is_said_in_one_line(run):
    results = read_results(run)
    with pytest.raises(UserError, match=r"no pictures of lattice: choose one of projection, ambient"):
        save_side_by_side(results, run, "lattice")
    (run / "pictures" / "captured_0007.png").unlink()
    assert_refused(xihe_here("video", run), "captured_0007.png")
    write_json(run / "results.json", runs.content([runs.frame(1)]))
    assert_refused(xihe_here("video", run), "no compared frames")
    assert not list(run.glob("*.mp4")) and not list(run.glob("pictures/side_by_side*")), "nothing half-written"
