"""The `xihe` command as a user types it: exit codes, what goes to stdout and stderr, Ctrl-C, full disks, mistakes."""

import hashlib
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys

import bpy
import pytest
from previs_runs import N_FRAMES, QuickProbes, files_below, unfinished_files, walk
from results_schema import check_results, read_strictly, without_times
from tiny_scenes import geometry_nodes, saved
from xihe_process import ROOT, output_of_command, typed, xihe

from addon_tests.pure.commands import assert_refused, xihe_here
from xihenet import __version__

DRAFT = ("--preset", "draft", "--size", "32x24", "--samples", "2", "--exposure", "1")
PAGE = resource.getpagesize()
"""Files in memory take whole ones."""

PROFILE = """
name = "Mine"
summary = "Has a mistake"
[range]
source = "a guess"
nearest_m = 0.0
farthest_m = "far"
"""


@pytest.fixture(scope="module", autouse=True)
def quick_probes():
    """Commands in this process render light probes of few rays; comparisons are those of a process of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("xihe_blender.previs.settings.PrevisSettings", QuickProbes)
        yield


def previs(blend, out, *arguments, run=xihe_here):
    return run("previs", blend, "--out", out, *DRAFT, *arguments)


@pytest.mark.slow
@pytest.mark.wheel_only("inside a whole Blender the module is not `bpy` of a wheel")
@pytest.mark.parametrize("has_own_folder", [True, False])
def test_a_command_that_has_blender_ends_at_once_with_its_exit_code(tmp_path, has_own_folder):
    """Where torch is loaded as well, Blender waits for ever on its own way out.

    In a folder with a long name it cannot make one of its own for temporary files.
    """
    folder = tmp_path
    while not has_own_folder and len(str(folder)) < 1013:
        folder /= "x" * min(200, 1013 - len(str(folder)))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "of others").touch()
    code = (
        "import atexit, sys, bpy; from xihe_blender.cli.main import command; atexit.register(print, 'the way out');"
        "sys.argv = ['xihe', 'export', 'nowhere.json', '--to', 'three']; command()"
    )
    with_folder = os.environ | {"TMPDIR": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=with_folder, capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 2 and "nowhere.json" in done.stderr and "the way out" not in done.stdout
    assert [file.name for file in folder.iterdir()] == ["of others"]


@pytest.mark.slow
@pytest.mark.wheel_only("inside a whole Blender the module is not `bpy` of a wheel")
def test_a_command_that_fails_by_an_error_of_ours_ends_at_once_too():
    code = (
        "import atexit, bpy, xihe_blender.cli.main as cli; atexit.register(print, 'the way out');"
        "cli.main = lambda _: 1 / 0; cli.command()"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stdout) == (1, "") and "ZeroDivisionError" in done.stderr


# -------------------------------------------------------------------------------------------------------------- scenes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The scenes as files, and files that are none."""
    folder = tmp_path_factory.mktemp("scenes")
    scene, noise = walk(), random.Random(0)
    # One position instead of three, and no walls between which light takes long: what is rendered takes most of a run.
    for name in ("Board", "Room"):
        bpy.data.objects.remove(bpy.data.objects[name])
    # Makes the saved .blend the largest file of a run; see `SmallDisk`.
    bpy.data.texts.new("Ballast").write("\n".join(noise.randbytes(500).hex() for _ in range(300)))
    content = saved(folder / "walk.blend").read_bytes()
    scene.camera.data.type = "ORTHO"
    saved(folder / "orthographic.blend")
    (folder / "cut_short.blend").write_bytes(content[: len(content) // 2])
    (folder / "header_only.blend").write_bytes(content[:12])
    (folder / "text.blend").write_text("a shopping list")
    (folder / "empty.blend").write_bytes(b"")
    (folder / "folder.blend").mkdir()
    (folder / "mine.toml").write_text(PROFILE)
    return folder


@pytest.fixture(scope="module")
def finished(folder, tmp_path_factory):
    """An undisturbed run: what the command said, and the folder it wrote."""
    before = hashlib.sha256((folder / "walk.blend").read_bytes()).digest()
    out = tmp_path_factory.mktemp("finished") / "out"
    done = previs(folder / "walk.blend", out)
    assert hashlib.sha256((folder / "walk.blend").read_bytes()).digest() == before
    return done, out


# ----------------------------------------------------------------------------------------------------------- a good run


def test_a_run_ends_with_report_results_and_lit_blend(finished):
    done, out = finished
    assert done.returncode == 0, done.stderr
    assert {path.name for path in out.iterdir() if path.is_file()} == {
        "report.html",
        "results.json",
        "session.json",
        "walk_lit.blend",
    }
    results = read_strictly(out / "results.json")
    check_results(results)
    assert results["scene"]["file"] == "walk.blend"
    assert results["software"]["command"].startswith("xihe previs ")
    assert not unfinished_files(out)


def test_stdout_holds_only_the_result(finished):
    done, out = finished
    result, report = done.stdout.splitlines()
    assert re.match(rf"{N_FRAMES - 1} of {N_FRAMES} frames, \d+ estimates; lattice is \d+% \w+ \w+ the ground", result)
    assert report == str(out / "report.html")


def warnings_of(out):
    return [f"xihe: note: {warning}" for warning in read_strictly(out / "results.json")["warnings"]]


def test_stderr_holds_only_the_progress_with_time_left_and_then_the_warnings(finished):
    done, out = finished
    warnings = warnings_of(out)
    lines, last = done.stderr.splitlines()[: -len(warnings)], done.stderr.splitlines()[-len(warnings) :]
    assert warnings and last == warnings
    assert all(re.fullmatch(r" *\d+%  [^,]+(, (\d+ (h|min|s) )+left)?", line) for line in lines), lines
    shares = [int(line.split("%")[0]) for line in lines]
    assert shares == sorted(shares) and shares[0] == 0 and shares[-1] == 100
    told = [line.endswith(" left") for line in lines[:-1]]
    first = told.index(True)
    assert all(told[first:]) and "capturing frame" in lines[first], lines


def test_a_second_call_says_that_the_run_is_done(folder, finished):
    done, out = finished
    before = files_below(out)
    again = previs(folder / "walk.blend", out)
    assert (again.returncode, again.stdout) == (0, done.stdout)
    said, *warnings = again.stderr.splitlines()
    assert "already done" in said and warnings == warnings_of(out)
    assert files_below(out) == before


def test_other_settings_and_a_changed_scene_are_refused_in_the_same_folder(folder, finished, tmp_path):
    before = files_below(finished[1])
    assert_refused(previs(folder / "walk.blend", finished[1], "--seed", 3), "another seed", "--out")
    walk()
    assert_refused(previs(saved(tmp_path / "walk.blend"), finished[1]), "another scene file", "--out")
    assert files_below(finished[1]) == before


def test_frames_objects_estimator_and_exposure_can_be_chosen(folder, tmp_path):
    chosen = "--frames 1:5:4 --objects Ball --estimator ambient --exposure 1.5 --target hdr"
    done = previs(folder / "walk.blend", tmp_path, *chosen.split())
    assert done.returncode == 0, done.stderr
    results = read_strictly(tmp_path / "results.json")
    check_results(results)
    settings = results["settings"]
    assert settings["frames"] == [1, 5] and results["scene"]["virtual_objects"] == ["Ball"]
    assert (settings["estimator"], settings["reference_exposure"], settings["target"]) == ("ambient", 1.5, "hdr")


@pytest.mark.slow
def test_version_and_help_are_no_errors():
    assert xihe("--version").stdout == f"xihe {__version__}\n"
    for arguments in (("--help",), ("previs", "--help")):
        shown = xihe(*arguments)
        assert (shown.returncode, shown.stderr) == (0, "")
        assert "usage: xihe" in shown.stdout


@pytest.mark.slow
def test_a_process_ends_as_it_should_after_a_scene_whose_nodes_import_a_file(tmp_path):
    (tmp_path / "vase.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    scene = walk(2)
    tree, _, end = geometry_nodes()
    node = tree.nodes.new("GeometryNodeImportOBJ")
    node.inputs["Path"].default_value = "//vase.obj"
    tree.links.new(node.outputs[0], end)
    scene.objects["Table"].modifiers.new("Import", "NODES").node_group = tree
    limit = bpy.context.preferences.system.memory_cache_limit
    done = xihe("effects", saved(tmp_path / "walk.blend"), "--plan-only")
    assert done.returncode == 0 and "volumes" in done.stdout, done.stderr
    assert xihe_here("effects", tmp_path / "walk.blend", "--plan-only").returncode == 0
    assert bpy.context.preferences.system.memory_cache_limit == limit


# --------------------------------------------------------------------------------------------------------------- stops


def stopped(blend, out, doing, number):
    """Start a run and send it the signal `number` when it says that it is `doing`; its exit code, stdout and stderr."""
    command = typed("previs", blend, "--out", out, *DRAFT)
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    lines = []
    for line in process.stderr:
        lines.append(line)
        if doing in line:
            process.send_signal(number)
            break
    stdout, rest = process.communicate(timeout=100)
    return process.returncode, output_of_command(stdout), output_of_command("".join(lines) + rest)


def written_before(finished, first_missing, out):
    """Copy to `out` what the finished run had written when it came to the file `first_missing`; what is there."""
    made = files_below(finished[1])
    for path in [path for path in made if made[path] < made[first_missing]]:
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(finished[1] / path, out / path)
    return files_below(out)


def assert_goes_on(folder, finished, out, run=xihe_here):
    """The same command, and it comes to what the undisturbed run came to."""
    done = previs(folder / "walk.blend", out, run=run)
    assert done.returncode == 0, done.stderr
    came_to, undisturbed = (without_times(read_strictly(of / "results.json")) for of in (out, finished[1]))
    for results in (came_to, undisturbed):
        del results["settings"]["truth_size"]  # It is not small in a process of its own.
    assert came_to == undisturbed
    return done


# To its end, `xihe` runs but once in a process of its own, where a warning anywhere is an error: in the last steps.
@pytest.mark.slow
def test_a_run_stopped_by_ctrl_c_goes_on_with_the_same_command(folder, finished, tmp_path):
    out = tmp_path / "out"
    written_before(finished, "radiance/ground_truth_0001.exr", out)
    code, stdout, stderr = stopped(folder / "walk.blend", out, "comparing frame 1", signal.SIGINT)
    assert (code, stdout) == (130, "")
    *progress, last = stderr.splitlines()
    assert last == "xihe: stopped; run the same command again to resume"
    assert all("%  " in line for line in progress)
    assert not unfinished_files(out) and not (out / "results.json").exists()
    before = {path: time for path, time in files_below(out).items() if "work/ground_truth_" not in path}
    assert any(path.startswith("work/times_") for path in before)
    done = assert_goes_on(folder, finished, out, xihe)
    assert done.stdout == finished[0].stdout.replace(str(finished[1]), str(out))
    assert {path: time for path, time in files_below(out).items() if path in before} == before


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_with_the_same_command(folder, finished, tmp_path):
    written_before(finished, "work/capture_0004.exr", tmp_path)
    code, stdout, _ = stopped(folder / "walk.blend", tmp_path, "capturing frame 4", signal.SIGKILL)
    assert (code, stdout) == (-signal.SIGKILL, "")
    assert_goes_on(folder, finished, tmp_path)


def test_a_damaged_piece_of_a_run_is_named_and_made_again(folder, finished, tmp_path):
    shutil.copytree(finished[1], tmp_path / "out")
    damaged = [tmp_path / "out" / name for name in ("results.json", "work/survey.json", "work/sample_count.json")]
    for path in damaged:
        path.write_bytes(path.read_bytes()[:50])
    done = assert_goes_on(folder, finished, tmp_path / "out")
    notes = [line for line in done.stderr.splitlines() if not re.match(r" *\d+%  ", line)]
    damages = [f"xihe: note: {path} is damaged and is made again" for path in damaged]
    assert notes == [*damages, *warnings_of(finished[1])]


# --------------------------------------------------------------------------------------------------------------- disks


class SmallDisk:
    """A file system in memory or, where none may be mounted, a limit on the size of a file."""

    def __init__(self, folder, n_bytes):
        self.folder, self.n_bytes = folder, n_bytes

    def __enter__(self):
        mount = ["mount", "-t", "tmpfs", "-o", f"size={self.n_bytes}", "none", str(self.folder)]
        try:
            self.is_mounted = subprocess.run(mount, capture_output=True).returncode == 0
        except FileNotFoundError:
            self.is_mounted = False
        self.says = "No space left on device" if self.is_mounted else "File too large"
        return self

    def __exit__(self, *_):
        if self.is_mounted:
            subprocess.run(["umount", str(self.folder)], check=True)

    def previs(self, blend, out, largest_file):
        """`previs`, with no file larger than `largest_file` bytes where that takes the place of a full disk."""
        unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
        if not self.is_mounted:
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, unlimited[1]))
        try:
            return previs(blend, out)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)

    def enlarge(self):
        if self.is_mounted:
            subprocess.run(["mount", "-o", f"remount,size={2**30}", str(self.folder)], check=True)


def test_a_full_disk_is_refused_before_anything_is_rendered(folder, tmp_path):
    with SmallDisk(tmp_path, 64 * 1024) as disk:
        if disk.is_mounted:
            (tmp_path / "ballast").write_bytes(bytes(64 * 1024))
        done = disk.previs(folder / "walk.blend", tmp_path / "out", largest_file=1000)
        assert_refused(done, "cannot write to", disk.says, "another folder", after_progress=True)
        assert "capturing" not in done.stderr and "metering" not in done.stderr
        assert not files_below(tmp_path / "out")


@pytest.mark.slow
@pytest.mark.parametrize("full_at", ["work/capture_0002.exr", "walk_lit.blend"])
def test_a_disk_that_fills_up_leaves_nothing_half_written(folder, finished, tmp_path, tmp_path_factory, full_at):
    staged, out = tmp_path_factory.mktemp("staged"), tmp_path / "out"
    pages = sum(-(-(staged / path).stat().st_size // PAGE) for path in written_before(finished, full_at, staged))
    size = (finished[1] / full_at).stat().st_size
    with SmallDisk(tmp_path, (pages + size // 2 // PAGE) * PAGE) as disk:
        before = written_before(finished, full_at, out)
        done = disk.previs(folder / "walk.blend", out, largest_file=size // 2)
        assert_refused(done, str(out), "run the same command again to resume", after_progress=True)
        assert "free some space" in done.stderr or not disk.is_mounted
        assert not any((out / path).exists() for path in (full_at, "results.json")) and not unfinished_files(out)
        disk.enlarge()
        assert_goes_on(folder, finished, out)
        kept = [path for path in before if path.startswith(("work/times", "work/compared", "work/exposure"))]
        assert kept and all(files_below(out)[path] == before[path] for path in kept)
        bpy.ops.wm.open_mainfile(filepath=str(out / "walk_lit.blend"), load_ui=False)


# ------------------------------------------------------------------------------------------------------------ mistakes


MISTAKES = {
    "": {
        "": "COMMAND ... --help",
        "prewiew": "'prewiew' ... --help",
        "previs": "SCENE.blend ... --help",
        "previs scene.blend": "--out ... --help",
        "previs scene.blend --out {out} --unknown": "--unknown ... xihe previs --help",
        "scenes": "action ... --help",
    },
    "previs --out {out} ": {
        "{folder}/nowhere.blend": "no such file",
        "{folder}/folder.blend": "is a folder",
        "{folder}/text.blend": "not a .blend",
        "{folder}/empty.blend": "not a .blend",
        "{folder}/orthographic.blend": "perspective",
        "{folder}/header_only.blend": "cannot be opened",
        "{folder}/cut_short.blend": "cannot be opened",
    },
    "previs {folder}/walk.blend --out {out} ": {
        "--frames 5:1": "A no later than B",
        "--frames a:b": "1:24:2",
        "--frames 1:5:0": "1 or more",
        "--frames 1:6": "choose frames within it",
        "--frames 0:1": "choose frames within it",
        "--frames -3:1": "choose frames within it",
        "--frames 1:99999999999": "last frame",
        "--size 0x0": "4 to 8192",
        "--size 10": "WxH",
        "--size 99999x2": "4 to 8192",
        "--size -3x8": "--size",
        "--objects Nobody": "choose among Ball",
        "--objects ,": "choose among Ball",
        "--estimator oracle": "choose one of",
        "--preset hasty": "draft, balanced, accurate",
        "--target sdr": "ldr",
        "--trigger never": "split ... every-frame",
        "--exposure -1": "positive",
        "--exposure 0": "positive",
        "--exposure inf": "positive",
        "--metering spot": "highlights, key",
        "--exposure nan": "positive",
        "--exposure 1,5": "--exposure ... with a point",
        "--samples 1.5": "--samples ... whole number",
        "--seed -1": "0 to",
        "--seed 2147483648": "0 to",
        "--effect volumes=perhaps": "auto, on or off",
        "--effect noise": "NAME=on",
        "--effect hum=on": "hum ... rolling_shutter ... diffuse bounces ... network",
        "--effect noise=on": "noise ... Perfect phone ... --phone",
        "--effect network=on": "--network",
        "--phone nokia_3310": "nokia_3310 ... ipad_pro_lidar",
        "--phone {folder}/mine.toml": "mine.toml ... farthest_m",
        "--network pigeon": "pigeon ... lte",
        "--cycles-device abacus": "ABACUS ... choose one of CPU",
    },
    "effects {folder}/walk.blend --plan-only ": {
        "--effect noise=on": "choose another --phone",
        "--effect smoke=on": "there is no effect",
        "--frames 1:9": "outside the scene's range",
        "--budget 0": "--budget",
    },
    "frontier --out {out} ": {
        "nowhere.blend": "no such file",
        "{folder}/text.blend": "is not a .blend file",
        "": "SCENE.blend",
        "{folder}/text.blend --seed -1": "seed of -1",
    },
    "paper --out {out} ": {
        "--scenes {folder}/text.blend": "is not a .blend file",
    },
    "dataset build --out {out} ": {
        "--rooms 0": "give 1 to",
        "--rooms many": "--rooms",
        "--rooms 1 --seed -1": "give 0 or more",
        "--rooms 1 --workers 0": "give 1 or more",
        "--rooms 1 --walk 0": "2 to 240",
        "--rooms 1 --walk many": "--walk",
        "--rooms 1 --varied 1.5": "between 0 and 1",
        "--rooms 1 --split dev": "train, validation, test",
        "--rooms 1 --split test": "give more",
        "--rooms 1 --workers 2 --scheduler tcp://here:1": "--workers ... --scheduler ... give one",
    },
    "evaluate {folder}/walk.blend --out {out} ": {
        "--workers 2 --scheduler tcp://here:1": "--workers ... --scheduler ... give one",
    },
}
"""By how a command begins and goes on: what its one line says, with ` ... ` between words."""


@pytest.mark.parametrize(
    ("words", "says"), [(begin + end, says) for begin, of_one in MISTAKES.items() for end, says in of_one.items()]
)
def test_a_mistake_is_one_line_that_names_the_fix_and_leaves_nothing(folder, tmp_path, words, says):
    arguments = [word.format(folder=folder, out=tmp_path / "out") for word in words.split()]
    assert_refused(xihe_here(*arguments), *says.split(" ... "))
    assert not any(tmp_path.iterdir())
