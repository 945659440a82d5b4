"""Sessions of 2,000 frames: opened and read one frame at a time, whatever their length, in little memory."""

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from addon_tests.pure.recordings import as_nerfstudio, as_record3d, as_tum, walk
from xihenet.captures.reading.values import quaternion_of
from xihenet.records import Intrinsics

ROOT = Path(__file__).resolve().parents[2]
N = 2_000
MOST_MB = 100
TINY = Intrinsics(16, 12, 10.0, 10.0, 8.0, 6.0)
TINY_TUM = Intrinsics(16, 12, 525 / 40, 525 / 40, 8.0, 6.0)
MEASURED = """
import resource, sys
from pathlib import Path
import numpy as np, PIL.Image
from xihenet.captures import open_capture
def most_mb():
    status = Path("/proc/self/status")  # What getrusage says counts what the process had that forked this one.
    if not status.is_file():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return int(dict(line.split(":", 1) for line in status.read_text().splitlines())["VmHWM"].split()[0]) / 1024
before = most_mb()
for path in sys.argv[2:]:
    capture = open_capture(Path(path))
    numbers = [frame.read().frame for frame in capture.frames[:: int(sys.argv[1])]]
    print(len(capture.frames), len(numbers), most_mb() - before)
"""


def measured(*paths, every):
    """A line for each: frames, those read, and MB that the process has grown by until then."""
    command = [sys.executable, "-c", MEASURED, str(every), *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    return [tuple(map(float, line.split())) for line in done.stdout.splitlines()]


def long_nerfstudio(folder):
    """One picture for all frames."""
    as_nerfstudio(folder, walk(TINY, 1))
    said = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps({**said, "frames": said["frames"] * N}))
    return folder


def long_tum(folder):
    """One picture for all frames, and two poses for each."""
    as_tum(folder, walk(TINY_TUM, 1))
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        lines = (folder / name).read_text().splitlines()[1:]
        rows = [(float(line.split()[0]), line.split(maxsplit=1)[1]) for line in lines]
        (folder / name).write_text("".join(f"{at + i / 30:.4f} {said}\n" for i in range(N) for at, said in rows))
    return folder


def long_record3d(folder):
    """A member for each file of each frame, as the app has it."""
    path = as_record3d(folder, walk(TINY, 1))
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    said = json.loads(members["metadata"])
    said["poses"] = [[*quaternion_of(np.eye(3)).tolist(), i * 1e-3, 0.0, 0.0] for i in range(N)]
    said["frameTimestamps"] = [i / 60 for i in range(N)]
    said["perFrameIntrinsicCoeffs"] *= N
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("metadata", json.dumps(said))
        for i in range(N):
            for kind in ("jpg", "depth", "conf"):
                file.writestr(f"rgbd/{i}.{kind}", members[f"rgbd/0.{kind}"])
    return path


@pytest.mark.slow
@pytest.mark.wheel_only("its Python is not sys.executable with these packages")
def test_two_thousand_frames_take_little_memory(tmp_path):
    paths = [make(tmp_path / make.__name__) for make in (long_nerfstudio, long_tum, long_record3d)]
    lines = measured(*paths, every=20)
    assert [line[:2] for line in lines] == [(N, N / 20)] * 3 and max(line[2] for line in lines) < MOST_MB
