"""Whose folder is it? Nothing is taken up that was made otherwise, and nothing is overwritten."""

import itertools
import json
import os
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xihe_blender.errors import UserError
from xihe_blender.io import folder_manifest
from xihe_blender.io.folder_manifest import END_BYTES, FolderManifest, contents_sha256, differences, take_lock

MADE_WITH = {"xihe": "1.0", "settings": {"seed": 0, "size": (32, 24)}, "frames": (1, 2)}
VALUES = st.one_of(st.integers(), st.none(), st.text(max_size=3), st.lists(st.integers(), max_size=2))
SETTINGS = st.dictionaries(st.sampled_from(["seed", "size", "noise_target"]), VALUES)


def manifest_in(folder, **changed):
    return FolderManifest(
        folder, folder / "work" / "manifest.json", "a run", MADE_WITH | changed, (folder / "results.json",)
    )


def test_a_folder_is_taken_once_and_known_again(tmp_path):
    manifest = manifest_in(tmp_path / "out")
    assert (manifest.check(), manifest.take(), manifest.take(), manifest.check()) == (False, False, True, True)


def test_a_folder_is_held_by_one_at_a_time(tmp_path):
    refused = pytest.raises(UserError, match=r"a run is under way in .*: wait for its end, or choose another")
    with manifest_in(tmp_path).held(), refused, manifest_in(tmp_path).held():
        pass
    with manifest_in(tmp_path).held():
        assert manifest_in(tmp_path).is_held
    assert not manifest_in(tmp_path).is_held


def test_of_two_who_come_at_once_the_second_writes_nothing(tmp_path):
    manifest = manifest_in(tmp_path)
    manifest.file.parent.mkdir()
    with manifest.file.with_name("held").open("ab") as lock:
        assert take_lock(lock)
        with pytest.raises(UserError, match="is under way"), manifest.held():
            pass
    assert not manifest.file.exists()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"settings": {"seed": 1, "size": (32, 24)}}, "a run with another seed:"),
        ({"settings": {"seed": 1, "size": (32, 20)}}, "another seed, size:"),
        ({"settings": {"seed": 0, "size": (32, 24), "noise_target": 0.1}}, "another noise target:"),
        ({"settings": {"seed": 0, "size": (32, 24), "effect_choices": {}}}, "another choice of effects:"),
        ({"frames": (1,)}, "a run with other frames:"),
        ({"xihe": "2.0", "frames": (1,)}, "another version of xihe:"),
        ({"blender": "5.2"}, "another version of Blender:"),
        ({"blend_sha256": "0f"}, "another scene file:"),
        ({"linked_sha256": "0f"}, "another library, image or other file that the scene reads:"),
    ],
)
def test_what_differs_is_named_and_the_claim_stays(tmp_path, changed, words):
    manifest_in(tmp_path).take()
    before = manifest_in(tmp_path).file.read_bytes()
    with pytest.raises(UserError, match=words):
        manifest_in(tmp_path, **changed).take()
    assert manifest_in(tmp_path).file.read_bytes() == before


def test_a_folder_of_another_kind_of_work_is_refused_by_its_name(tmp_path):
    manifest_in(tmp_path, work="a run").take()
    assert manifest_in(tmp_path, work="a run").check()
    with pytest.raises(UserError, match="holds a run, not a map: choose another folder"):
        replace(manifest_in(tmp_path), what="a map").take()


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"null", b"\xff\xfe", b'{"settings": []}', b"[" * 200_000])
def test_a_claim_that_is_damaged_is_said_to_be_damaged(tmp_path, content):
    manifest = manifest_in(tmp_path)
    manifest.file.parent.mkdir()
    manifest.file.write_bytes(content)
    with pytest.raises(
        UserError, match=r"manifest\.json is damaged.*: choose another folder for --out, or delete that"
    ):
        manifest.take()
    assert manifest.file.read_bytes() == content


def test_results_of_somebody_else_are_left_alone(tmp_path):
    (tmp_path / "results.json").write_text("mine")
    with pytest.raises(UserError, match="not from a run"):
        manifest_in(tmp_path).take()
    with pytest.raises(UserError, match="is a file: give --out a folder"):
        manifest_in(tmp_path / "results.json").take()
    with pytest.raises(UserError, match=r"cannot write to .*: choose another folder for --out"):
        manifest_in(tmp_path / "results.json" / "below").take()
    assert [path.name for path in tmp_path.iterdir()] == ["results.json"]


def test_what_is_written_for_the_reader_alone_may_differ(tmp_path):
    manifest_in(tmp_path, software="made on a Monday").take()
    assert manifest_in(tmp_path, software="or a Tuesday").take()


@given(SETTINGS, SETTINGS)
def test_settings_differ_exactly_where_they_do(kept, wanted):
    wanted = json.loads(json.dumps(wanted))
    named = differences({"settings": kept}, {"settings": wanted})
    assert set(named) == {name.replace("_", " ") for name in {*kept, *wanted} if kept.get(name) != wanted.get(name)}


def test_files_of_two_folders_are_known_wherever_each_folder_lies(tmp_path):
    def written(**folders):
        files = [tmp_path / folder / "textures" / name for name, folder in folders.items()]
        for file in files:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(file.name)
        return contents_sha256(map(str, files))

    assert written(sky="a", wood="b") == written(sky="d", wood="c") is not None


def test_content_is_known_by_the_names_of_files_and_what_is_in_them(tmp_path):
    def written(**files):
        for name, content in files.items():
            (tmp_path / "in" / name).mkdir(parents=True, exist_ok=True)
            (tmp_path / "in" / name / "0001.vdb").write_text(content)
        return contents_sha256([str(tmp_path / "in" / "**" / "*"), str(tmp_path / "in" / "a" / "0001.vdb")])

    assert written() is None and contents_sha256([str(tmp_path / (300 * "a"))]) is None
    found = [written(a="one"), written(b="two"), written(a="two", b="one")]
    (tmp_path / "in" / "a" / "0001.vdb").rename(tmp_path / "in" / "a" / "0002.vdb")
    assert len({*found, written()}) == 4


def test_of_many_gigabytes_each_large_file_counts_by_its_ends_size_and_date(tmp_path, monkeypatch):
    folders = (tmp_path / str(number) for number in itertools.count())

    def found(most_read, middle=b"1", end=b"1", text="one", date=1e9):
        folder = next(folders)
        folder.mkdir()
        (folder / "large.vdb").write_bytes(bytes(END_BYTES) + middle + bytes(END_BYTES) + end)
        (folder / "small.vdb").write_text(text)
        for path in folder.iterdir():
            os.utime(path, (date, date))
        monkeypatch.setattr(folder_manifest, "MOST_READ_BYTES", most_read)
        return contents_sha256([str(folder / "*")])

    few, many = 4 * END_BYTES, 2 * END_BYTES
    assert found(few) == found(few, date=2e9) != found(few, middle=b"2"), "read whole, and a copy has any date"
    changes = ({}, {"end": b"2"}, {"end": b"11"}, {"text": "two"}, {"date": 2e9})
    assert len({found(few), *(found(many, **change) for change in changes)}) == 6
    assert found(many) == found(many, middle=b"2"), "the middle is not read"
    assert found(many) == found(many, date=1e9 + 0.3), "not every disk keeps parts of a second"
