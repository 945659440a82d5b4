"""Pictures of a video by number: in order, backwards, and of a file that was cut short."""

import numpy as np
import pytest

from addon_tests.pure.broken_recordings import cut, move_header_to_the_start
from addon_tests.pure.recordings import SMALL, as_stray, walk
from xihenet.captures.reading.video import Video

pytestmark = pytest.mark.wheel_only("a whole Blender's Python has no PyAV")
N = 24


@pytest.fixture(scope="module")
def made():
    return walk(SMALL, N)


def is_of(pixels, frame):
    return np.abs(pixels[::4, ::4].astype(float) - frame.srgb_u8).mean() < 6


@pytest.mark.parametrize("order", [range(N), range(0, N, 5), [3, 3, 4], [N - 1, 0, 7, 6], range(N - 1, -1, -6)])
def test_pictures_come_by_their_number_in_any_order(tmp_path, made, order):
    video = Video(as_stray(tmp_path, made) / "rgb.mp4")
    assert (video.n_frames, video.width, video.height) == (N, 256, 192)
    for number in order:
        assert is_of(video.read(number), made[number])
    video.close()


@pytest.mark.parametrize("lost", [0.1, 0.3, 0.5])
def test_of_a_video_that_is_cut_short_the_pictures_that_are_there_are_the_right_ones(tmp_path, made, lost):
    path = as_stray(tmp_path, made) / "rgb.mp4"
    move_header_to_the_start(path)
    cut("rgb.mp4", round(path.stat().st_size * (1 - lost)))(tmp_path)
    video = Video(path)
    assert 0 < video.n_frames < N
    for number in range(video.n_frames):
        assert is_of(video.read(number), made[number])
    with pytest.raises(ValueError, match=f"it ends before picture {N}"):
        video.read(N)
