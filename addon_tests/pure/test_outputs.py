"""Files of a run are whole or not there."""

import contextlib
import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from addon_tests.pure.commands import ROOT
from xihe_blender.errors import UserError
from xihe_blender.io.exr import write_radiance
from xihe_blender.io.outputs import RunOutputs, check_names_differ, cut_stem, write_json
from xihe_blender.lab.batch.grid import planned_units
from xihenet.io.whole_files import written_whole
from xihenet.light.exports import file_names


@pytest.mark.parametrize(("encoding", "printed"), [("cp1252", b"Caf\xe9 \\u2212"), ("utf-8", "Café \u2212".encode())])
def test_what_is_printed_has_the_encoding_of_whoever_reads_it(encoding, printed):
    """Pipes of Windows have another than UTF-8, and not every sign is in it."""
    code = (
        "from xihe_blender.io.blender_output import only_our_output\nwith only_our_output(): print('Caf\\xe9 \\u2212')"
    )
    given = {"cwd": ROOT, "env": os.environ | {"PYTHONIOENCODING": encoding}, "capture_output": True, "timeout": 60}
    assert subprocess.run([sys.executable, "-c", code], **given).stdout.strip() == printed


def test_scenes_whose_names_differ_in_upper_and_lower_case_alone_are_refused():
    check_names_differ([Path("a/room.blend"), Path("b/roof.blend")])
    with pytest.raises(UserError, match="two scenes are named 'Room': results go by name, so rename one"):
        check_names_differ([Path("a/Room.blend"), Path("b/room.blend")])


@pytest.mark.parametrize("n_refusals", [3, 99])
def test_a_file_that_is_read_just_then_is_written_a_moment_later(tmp_path, monkeypatch, n_refusals):
    """As on Windows, where a file that is open cannot be replaced."""
    replace, refused = Path.replace, []

    def refuse(path, target):
        if len(refused) < n_refusals:
            refused.append(path)
            raise PermissionError(errno.EACCES, "refused", str(path))
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", refuse)
    path = tmp_path / "progress.json"
    with contextlib.nullcontext() if n_refusals == 3 else pytest.raises(OSError, match=r"progress\.json"):
        write_json(path, {"done": 1})
    assert [file.name for file in tmp_path.iterdir()] == (["progress.json"] if n_refusals == 3 else [])


def test_radiance_that_the_disk_has_no_room_for_is_not_there_and_named(tmp_path, monkeypatch):
    def cut_short(path, _):
        path.write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("xihe_blender.io.exr.write_exr", cut_short)
    with pytest.raises(OSError, match=r"light\.exr"):
        write_radiance(tmp_path / "light.exr", np.zeros((2, 2, 3), np.float32))
    assert not any(tmp_path.iterdir())


def test_what_is_made_of_a_file_with_a_very_long_name_can_be_written(tmp_path):
    scene = tmp_path / ("é" * 124 + ".blend")
    scene.write_bytes(b"any")
    with written_whole(RunOutputs(tmp_path, scene.stem).lit_blend) as beside:
        beside.touch()
    (tmp_path / planned_units([scene], (0,))[0][0].name).mkdir()
    assert RunOutputs(tmp_path, "room").lit_blend.name == "room_lit.blend"


def test_paths_of_runs_fit_into_those_of_windows():
    folder = Path("C:\\" + 57 * "x") / "xihe_runs" / f"{cut_stem(255 * 'x')}_20261130-105417"
    outputs, name = RunOutputs(folder, 255 * "x"), 255 * "x"
    exported = folder / "exports" / "filament" / f"{file_names([name])[name]}_0001_reflections.hdr"
    for path in (outputs.lit_blend, outputs.probe(999, name, 1), outputs.reflections(999, name, 1), exported):
        assert len(str(path)) + len("..99999") < 260  # With what it is called until it is whole.
