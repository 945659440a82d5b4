"""`xihe frontier`: a small one from end to end, what it keeps, and what of it is known to be damaged."""

import copy
import json
import math
import re
import shutil
from dataclasses import replace
from functools import partial

import bpy
import numpy as np
import pytest
from jsonschema import Draft202012Validator
from results_schema import read_strictly
from scene_snapshot import nothing_changes
from tiny_scenes import key, material, room_with_a_virtual_sphere, saved

from xihe_blender.capture.reference_probe import ProbeSettings
from xihe_blender.errors import UserError
from xihe_blender.io.json_records import as_json, from_json, json_schema
from xihe_blender.io.kept_files import kept_record
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.frontier.choices import LARGE_TABLE, QUICK, compute_choices, render_choices
from xihe_blender.lab.frontier.compute import Light
from xihe_blender.lab.frontier.pictures import LIGHTS, PicturesTaken, are_whole, picture_choices
from xihe_blender.lab.frontier.points import MeasuredScene, family, group, groups, is_whole_scene
from xihe_blender.lab.frontier.records import Frontier, FrontierScene, FrontierSettings, RenderChoice, StudySize
from xihe_blender.lab.frontier.rendering import Round, is_whole_round
from xihe_blender.lab.frontier.study import (
    Prepared,
    are_whole_truths,
    exhaustive_render,
    frontier,
    is_whole,
    survey_scene,
)
from xihe_blender.previs.presets import PRESETS
from xihenet.io.json_files import read_json
from xihenet.pareto import on_front

TINY = StudySize(2, 1, 1, 1, 1, 2, 4, (1, 2), 1)
SMALL = FrontierSettings(is_quick=True, size=(32, 24), study_size=TINY)


@pytest.fixture(scope="module", autouse=True)
def little_to_do():
    """Light probes and pictures of few rays, and not all ways to compute: not asked are how good they are.

    All ways to compute are walked through in `test_frontier_compute`.
    """
    ways = compute_choices(is_quick=True)
    quick = [way for way in ways if way.cells != LARGE_TABLE and way.estimator not in ("xihenet", "pointar")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("xihe_blender.lab.frontier.study.compute_choices", lambda *, is_quick: quick)
        patch.setattr("xihe_blender.lab.frontier.study.ProbeSettings", partial(ProbeSettings, size=24))
        patch.setattr("xihe_blender.lab.frontier.pictures.LADDER", (1, 3))
        for name, samples in (("draft", 1), ("balanced", 2), ("accurate", 4)):
            few = replace(PRESETS[name], comparison_samples=samples, min_samples=samples, max_samples=samples)
            patch.setitem(PRESETS, name, few)
        yield


def test_a_scene_that_is_saved_anew_while_another_is_measured_is_refused(tmp_path, monkeypatch):
    room_with_a_virtual_sphere()
    first, second = (saved(tmp_path / f"{name}.blend") for name in ("first", "second"))

    def measure_scene(file, folder, settings):
        second.write_bytes(first.read_bytes() + b" ")
        yield from ()
        nothing = {"n_walk_frames": 0, "n_places": 0, "views": (), "presets": {}, "exhaustive_samples": 1}
        return MeasuredScene(fronts={}, scene=FrontierScene(name=file.stem, exposure=1.0, size=(4, 4), **nothing))

    monkeypatch.setattr("xihe_blender.lab.frontier.study.measure_scene", measure_scene)
    with pytest.raises(UserError, match=r"second\.blend has changed meanwhile"):
        run_blocking(frontier([first, second], tmp_path / "out", SMALL))


def test_an_object_that_moves_is_estimated_where_it_is_in_a_picture():
    scene = room_with_a_virtual_sphere(2, is_still=True)
    key(scene.objects["Ball"], "location", {1: (0, 0, 0.85), 2: (0.5, 0, 0.85)})
    plan, _ = survey_scene(scene)
    (probe,) = plan.probes
    assert np.linalg.norm(probe.at(2) - probe.at(1)) > 0.4


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A frontier of a tiny scene, whose virtual object glows so that it looks the same under any light."""
    folder = tmp_path_factory.mktemp("frontier")
    room_with_a_virtual_sphere()
    materials = bpy.data.objects["Ball"].data.materials
    materials.clear()
    materials.append(material("Glowing", (0.9, 0.2, 0.1), emission=1.0))
    file = saved(folder / "room.blend")
    run_blocking(frontier([file], folder / "out", SMALL, command="as typed"))
    return folder


def read(folder):
    """A frontier.json as a record; AssertionError where it is not what its schema and design promise."""
    content = read_strictly(folder / "out" / "frontier.json")
    Draft202012Validator(json_schema(Frontier)).validate(content)
    found = from_json(Frontier, content)
    assert as_json(found) == content and {"error_kind", "size", "samples"} <= set(content["points"][0]["settings"])
    for point in found.points:
        assert point.error >= 0 and point.time_ms > 0 and point.spread_ms >= 0
        assert point.preset in {None, "draft", "balanced", "accurate"} and 0 <= point.front_share <= 1
    for each in groups(found.points):
        own = group(found.points, *each)
        assert [p.on_front for p in own] == on_front([p.error for p in own], [p.time_ms for p in own]).tolist()
        labels = {p.label for p in own if p.on_front}
        assert all((p.instead in labels) != p.on_front for p in own)
    return found


@pytest.mark.parametrize(("accurate", "exhaustive"), [(24, 96), (72, 144), (256, 512)])
def test_no_preset_is_held_against_a_render_that_is_noisier_than_itself(accurate, exhaustive):
    presets = {name: RenderChoice((32, 24), n) for name, n in (("draft", 8), ("accurate", accurate))}
    assert exhaustive_render((32, 24), QUICK, presets) == RenderChoice((32, 24), exhaustive)


def test_a_small_frontier_keeps_its_contract(done):
    found = read(done)
    assert found.scenes[0].exhaustive_samples == 8
    kinds = {(front, kind) for _, front, kind in groups(found.points)}
    against = ("coefficients", "irradiance")
    assert {(front, kind) for front in ("render", "compute", "total") for kind in against} <= kinds
    assert {("compute", "coefficients_truth"), ("render", "picture"), ("compute", "picture_truth")} <= kinds
    for front in ("render", "total"):
        for kind in ("coefficients", "picture"):
            named = [p.preset for p in group(found.points, "room", front, kind) if p.preset]
            assert sorted(named) == ["accurate", "balanced", "draft"]
        for kind in ("picture_truth", "ring_truth"):
            own = family(group(found.points, "room", front, kind), ("light",))
            assert tuple(p.settings.light for p in own) == LIGHTS
    assert found.software["command"] == "as typed" and found.answers


def test_pictures_are_held_against_a_ground_truth_that_has_the_objects_in_it(done):
    own = [p for p in read(done).points if p.kind == "picture_truth"]
    assert own and max(p.error for p in own) < 0.1


def test_table_and_report_hold_all_and_ask_for_nothing_else(done):
    lines = (done / "out" / "frontier.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + len(read(done).points) and lines[0].startswith("scene,front,error_kind,label")
    page = (done / "out" / "report.html").read_text(encoding="utf-8")
    assert (
        "How many anchors?" in page
        and "Do objects need a key light and reflections?" in page
        and page.count('class="plot wide"') >= 8
    )
    assert (
        "1 sample at draft, 2 samples at balanced and 4 samples at accurate; in the exhaustive render it has 8." in page
    )
    assert "http://" not in page and "src=" not in page


def test_a_frontier_that_is_done_is_not_measured_again(done):
    before = (done / "out" / "work" / "room" / "measured.json").read_bytes()
    assert run_blocking(frontier([done / "room.blend"], done / "out", SMALL, command="as typed")) == read(done)
    assert (done / "out" / "work" / "room" / "measured.json").read_bytes() == before


HOLLOW = {
    "probes_0003.json": b"{}",
    "round_0003_1.json": b"{}",
    "pictures_0003.json": b'{"choices": {}, "estimators": {}}',
}


def damaged(content, number):
    """The bytes of a file, damaged in a way that depends on the number: empty, cut short, one bit wrong, other JSON."""
    half = len(content) // 2
    flipped = content[:half] + bytes([content[half] ^ 0x80]) + content[half + 1 :]
    return (b"", content[:half], flipped, b'[{"a": 1}]', b"{}")[number % 5]


@pytest.mark.slow
def test_every_damaged_file_is_named_and_made_again_but_once_and_a_stop_leaves_the_scene_alone(done, tmp_path, caplog):
    shutil.copytree(done / "out", tmp_path / "out")
    files = sorted((tmp_path / "out" / "work" / "room").iterdir())
    # Later than the others, so that the second round is rendered with nothing before it that could lead to its noise.
    later = [file for file in files if file.name.startswith(("exhaustive_", "round_0003_0"))]
    first = [file for file in files if file not in later]
    assert len(later) == 2 and any(file.name == "round_0003_1.json" for file in first)
    damage(first)
    job = frontier([done / "room.blend"], tmp_path / "out", SMALL)
    for _ in range(2):  # It looks at the scene, then opens it to measure it.
        next(job)
    said = []
    with nothing_changes():
        for progress in job:
            said.append(progress.doing)
            if "exhaustively" in progress.doing and "comparing" in progress.doing:
                break
        job.close()
    assert "room: measuring the true light at Ball in frame 1" in said  # Ctrl-C is heard between light probes.
    to_come = [file for file in files if file.name.startswith(("measured.json", "pictures_"))]
    made = {file: file.stat().st_mtime_ns for file in first if file not in to_come}
    assert {file.name.partition("_")[0] for file in made} == {"walk", "probes", "round", "prepared.json"}
    assert {file.name.partition("_")[0] for file in to_come} == {"measured.json", "pictures"}
    damage(later)
    run_blocking(frontier([done / "room.blend"], tmp_path / "out", SMALL))
    assert {file: file.stat().st_mtime_ns for file in made} == made
    assert sorted(caplog.messages) == sorted(f"{file} is damaged and is made again" for file in [*files, *to_come])
    undisturbed, again = (read(folder).points for folder in (done, tmp_path))
    assert [(p.label, p.error) for p in undisturbed] == [(p.label, p.error) for p in again]


def damage(files):
    """Each in another way; some are whole files of nothing."""
    for number, file in enumerate(files, start=2):
        file.write_bytes(HOLLOW.get(file.name) or damaged(file.read_bytes(), number))


BROKEN = [
    *[("measured", path, None) for path in [("name",), ("fronts",), ("fronts", "total"), ("views",)]],
    ("measured", ("name",), "another"),
    ("measured", ("fronts", "render", 0, "times_ms"), [1.0]),
    ("measured", ("fronts", "compute", 0, "times_ms"), []),
    ("measured", ("fronts", "compute", 0, "square_errors", "coefficients_truth"), [0.1]),
    ("measured", ("fronts", "total", 0, "square_errors", "coefficients", 0), -0.1),
    *[("prepared", path, None) for path in [("exposure",), ("light_transport",), ("presets",), ("presets", "draft")]],
    *[("prepared", ("exposure",), value) for value in (0, -1.0, [1.0], "bright", math.inf, math.nan)],
    *[("prepared", ("presets", "draft", "samples"), value) for value in (0, 2.5, "4", True, [4])],
    ("prepared", ("light_transport", 0), {}),
    *[("probes", ("Ball",), value) for value in (None, 0.5, [[1.0] * 3] * 9, [[1.0] * 3] * 24 + [[1e999] * 3], "x")],
    ("round", (0,), None),
    *[("round", (0, "ms"), value) for value in (None, "1", -1.0, True)],
    *[("round", (0, "lights", "base"), value) for value in (None, [], 1.0, [[[1.0] * 3] * 9])],
    *[("pictures", ("choices", 0), value) for value in (None, 1.0)],
    *[("pictures", ("choices", 0, "square_errors", "ring_truth"), value) for value in (None, -0.1, "0")],
    *[("pictures", ("estimators", "base"), value) for value in (None, -0.1)],
]


@pytest.fixture(scope="module")
def kept(done):
    """What a frontier keeps, its record, and when it is whole, by the start of the file's name."""
    content = {
        file.name.partition("_")[0].removesuffix(".json"): read_json(file)
        for file in (done / "out" / "work" / "room").glob("*.json")
    }
    presets = from_json(Prepared, content["prepared"]).presets
    choices = render_choices(presets, SMALL.size, TINY, is_quick=True)
    return content, {
        "measured": (MeasuredScene, partial(is_whole_scene, "room")),
        "prepared": (Prepared, is_whole),
        "probes": (dict[str, Light], partial(are_whole_truths, ["Ball"])),
        "round": (Round, partial(is_whole_round, choices, 1)),
        "pictures": (PicturesTaken, partial(are_whole, picture_choices(presets))),
    }


def read_kept(tmp_path, content, kind, whole):
    (tmp_path / "kept.json").write_text(json.dumps(content))
    return kept_record(kind, tmp_path / "kept.json", whole)


def test_what_a_frontier_keeps_can_be_read(kept, tmp_path):
    content, records = kept
    assert set(content) == set(records)
    assert all(read_kept(tmp_path, of_one, *records[name]) is not None for name, of_one in content.items())


@pytest.mark.parametrize(("name", "path", "value"), BROKEN)
def test_json_that_a_frontier_did_not_write_is_known_to_be_damaged(kept, tmp_path, name, path, value):
    content, records = kept
    broken = part = copy.deepcopy(content[name])
    for step in path[:-1]:
        part = part[step_in(part, step)]
    last = step_in(part, path[-1])
    if value is None:
        del part[last]
    else:
        part[last] = value
    assert read_kept(tmp_path, broken, *records[name]) is None


def step_in(part, step):
    """Choices have long names, and 0 stands for the first."""
    return next(iter(part)) if step == 0 and isinstance(part, dict) else step


@pytest.mark.parametrize("content", [None, [], {}, 1, "x", [[1]], {"fronts": 1}, {"choices": {}, "estimators": {}}])
def test_json_of_another_kind_is_known_to_be_damaged(kept, tmp_path, content):
    assert all(read_kept(tmp_path, content, *one) is None for one in kept[1].values())


def test_a_folder_of_another_frontier_and_two_scenes_of_one_name_are_refused(done, tmp_path):
    with pytest.raises(UserError, match="holds a frontier with another seed"):
        run_blocking(frontier([done / "room.blend"], done / "out", replace(SMALL, seed=1)))
    with pytest.raises(UserError, match="two scenes are named 'room'"):
        run_blocking(frontier([done / "room.blend"] * 2, tmp_path / "out", SMALL))
    (tmp_path / "report.html").write_text("of a batch")
    with pytest.raises(UserError, match="not from a frontier"):
        run_blocking(frontier([done / "room.blend"], tmp_path, SMALL))


def test_a_frontier_of_other_weights_is_refused(done, tmp_path):
    shutil.copytree(done / "out", tmp_path / "out")
    provenance = tmp_path / "out" / "work" / "settings.json"
    made = json.loads(provenance.read_text("utf-8"))
    provenance.write_text(json.dumps(made | {"weights": made["weights"] | {"lattice": "of another training"}}), "utf-8")
    with pytest.raises(UserError, match="holds a frontier with another training"):
        run_blocking(frontier([done / "room.blend"], tmp_path / "out", SMALL))


def test_a_frontier_of_another_machine_is_refused(done, monkeypatch):
    other = {"platform": "elsewhere", "processor": "x86_64", "n_cores": 4096}
    monkeypatch.setattr("xihe_blender.lab.frontier.study.machine", lambda: other)
    with pytest.raises(UserError, match="holds a frontier with another machine or render device"):
        run_blocking(frontier([done / "room.blend"], done / "out", SMALL))


def test_a_scene_that_cannot_be_measured_is_named_before_anything_is_measured(done, tmp_path):
    room_with_a_virtual_sphere()
    camera = bpy.context.scene.camera
    camera.animation_data_clear()
    camera.rotation_euler = (math.pi, 0, 0)
    away = saved(tmp_path / "away.blend")
    bpy.data.objects.remove(camera)
    blind = saved(tmp_path / "blind.blend")
    for file, words in ((blind, "has no camera"), (away, "never has a virtual object in view")):
        job = frontier([done / "room.blend", file], tmp_path / "out", SMALL)
        assert next(job).doing == "room: looked at the scene"  # Between the scenes Ctrl-C is heard.
        with pytest.raises(UserError, match=f"{re.escape(str(file))}: .*{words}"):
            run_blocking(job)
    assert not (tmp_path / "out").exists() and read(done)
