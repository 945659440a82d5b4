"""Records as JSON: written and read back as they were, refused by name, and described by a schema that is right."""

import ast
import json
from collections import defaultdict
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from xihe_blender.io import run_results
from xihe_blender.io.json_records import ABSENT, INLINE, as_json, from_json, json_schema
from xihe_blender.io.kept_files import kept_json, kept_or_done
from xihe_blender.io.run_results import RunResults
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.batch.results import batch_schema
from xihe_blender.lab.frontier.records import Frontier
from xihenet.io.json_files import parse_json, read_json


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture."""

    file: str
    title: Annotated[str | None, "where it is, and its name"]
    error: float


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A frame
    of a path.

    Not told.
    """

    number: Annotated[int, "of the frame"]
    is_active: bool
    reason: Literal["first", "none"] = "none"
    light: tuple[tuple[float, float], ...] = ()
    place: tuple[int, int] = (0, 0)
    counts: dict[str, int | None] = field(default_factory=dict)
    by_frame: dict[int, float] = field(default_factory=dict)
    by_side: dict[Literal["left", "right"], int] = field(default_factory=dict)
    parameters: dict[str, str | int | float | bool | None] = field(default_factory=dict)
    exposure: float | None = field(default=None, metadata=ABSENT)
    picture: Picture | None = field(default=None, metadata=INLINE)


NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
PICTURES = st.builds(Picture, file=st.text(), title=st.none() | st.text(), error=NUMBERS)
FRAMES = st.builds(
    Frame,
    number=st.integers(),
    is_active=st.booleans(),
    reason=st.sampled_from(["first", "none"]),
    light=st.lists(st.tuples(NUMBERS, NUMBERS)).map(tuple),
    place=st.tuples(st.integers(), st.integers()),
    counts=st.dictionaries(st.text(), st.none() | st.integers()),
    by_frame=st.dictionaries(st.integers(), NUMBERS),
    by_side=st.dictionaries(st.sampled_from(["left", "right"]), st.integers()),
    parameters=st.dictionaries(st.text(), st.none() | st.text() | st.integers() | NUMBERS | st.booleans()),
    exposure=st.none() | NUMBERS,
    picture=st.none() | PICTURES,
)
FRAME = Frame(number=1, is_active=True)


@given(FRAMES)
def test_a_record_comes_back_as_it_was_and_fits_its_schema(frame):
    written = json.loads(json.dumps(as_json(frame), allow_nan=False))
    assert from_json(Frame, written) == frame
    assert ("exposure" in written) == (frame.exposure is not None)
    assert ("file" in written) == (frame.picture is not None)
    Draft202012Validator(json_schema(Frame)).validate(written)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"number": "1"}, "Frame.number"),
        ({"number": True}, "Frame.number"),
        ({"number": 1.0}, "Frame.number"),
        ({"is_active": 1}, "Frame.is_active"),
        ({"reason": "last"}, "Frame.reason"),
        ({"light": [[1.0]]}, r"Frame.light\[0\]"),
        ({"light": 3}, "Frame.light"),
        ({"light": [[1.0, None]]}, r"Frame.light\[0\]\[1\]"),
        ({"place": [1, 2, 3]}, "Frame.place"),
        ({"counts": {"a": "b"}}, "Frame.counts.a"),
        ({"counts": []}, "Frame.counts"),
        ({"by_frame": {"1": "b"}}, "Frame.by_frame.1"),
        ({"parameters": {"a": []}}, "Frame.parameters.a"),
        ({"exposure": "bright"}, "Frame.exposure"),
        ({"exposure": True}, "Frame.exposure"),
        ({"file": "a.png", "title": None, "error": "none"}, "Frame.error"),
    ],
)
def test_what_does_not_belong_is_refused_by_its_name_and_by_the_schema(change, where):
    content = as_json(FRAME) | change
    with pytest.raises(ValueError, match=f"^{where}: .* does not belong there"):
        from_json(Frame, content)
    # For a schema 1.0 is an integer.
    assert change == {"number": 1.0} or not Draft202012Validator(json_schema(Frame)).is_valid(content)


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_what_json_does_not_have_is_refused(number):
    with pytest.raises(ValueError, match=r"^Frame.exposure: "):
        from_json(Frame, as_json(FRAME) | {"exposure": number})
    with pytest.raises(ValueError, match=r"^Frame.light\[1\]\[0\]: "):
        from_json(Frame, as_json(FRAME) | {"light": [[0.0, 1.0], [number, 1.0]]})


def test_a_missing_field_is_refused_and_one_with_a_default_is_not():
    assert from_json(Frame, {"number": 1, "is_active": True}) == FRAME
    with pytest.raises(TypeError, match="is_active"):
        from_json(Frame, {"number": 1})
    with pytest.raises(TypeError, match="title"):
        from_json(Frame, as_json(FRAME) | {"file": "a.png"})
    for content in (None, [], 3, "frame"):
        with pytest.raises(ValueError, match=r"^Frame: "):
            from_json(Frame, content)


def test_what_a_newer_version_adds_is_left_out():
    assert from_json(Frame, as_json(FRAME) | {"weather": "fine"}) == FRAME


def test_the_schema_says_what_the_record_says_of_itself_and_its_fields():
    schema = json_schema(Frame)
    assert schema["properties"]["number"] == {"type": "integer", "description": "of the frame"}
    assert schema["properties"]["title"]["description"] == "where it is, and its name"
    assert schema["description"] == "A frame of a path."


SHIPPED = {
    "results": (json_schema(RunResults), "xihe_blender.io.run_results"),
    "frontier": (json_schema(Frontier), "xihe_blender.lab.frontier.records"),
    "batch": (batch_schema(), "xihe_blender.lab.batch.results"),
}


@pytest.mark.parametrize("name", list(SHIPPED))
def test_the_schema_in_the_docs_is_that_of_the_records_and_describes_every_field(name):
    schema, module = SHIPPED[name]
    shipped = Path(__file__).parents[2] / "docs" / f"{name}.schema.json"
    assert json.loads(shipped.read_text()) == schema, f"run: python -m {module} > docs/{name}.schema.json"
    for name, record in {"": schema, **schema["$defs"]}.items():
        bare = [field for field, of_field in record["properties"].items() if "description" not in of_field]
        assert not bare, (name, bare)


def test_a_run_fills_every_field_of_its_results():
    """A field with a default, which older runs need, would stay at it unseen."""
    filled = defaultdict(set)
    folder = Path(run_results.__file__).parents[1]
    for path in (path for room in ("previs", "compare", "io") for path in (folder / room).glob("*.py")):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call):
                filled[ast.unparse(call.func).split(".")[-1]] |= {keyword.arg for keyword in call.keywords}
    records = [kind for kind in vars(run_results).values() if is_dataclass(kind) and kind.__name__ in filled]
    named = [kind for kind in records if None not in filled[kind.__name__]]  # not by a mapping of all fields
    assert {"ProbeResult", "FrameResult", "Summary"} <= {kind.__name__ for kind in named}
    names = {(kind.__name__, field.name) for kind in named for field in fields(kind) if field.name != "schema_version"}
    assert [name for name in sorted(names) if name[1] not in filled[name[0]] | filled["replace"]] == []


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 200_000, b'{"a":' * 200_000])
def test_what_is_no_json_is_one_kind_of_error_that_names_the_file(tmp_path, content):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.json: expected JSON"):
        read_json(tmp_path / "a.json")


@pytest.mark.parametrize("content", ["{}".encode("utf-16"), '{"a": "é"}'.encode("latin-1")])
def test_json_in_another_encoding_is_told_what_to_do(tmp_path, content):
    """As `>` of Windows' PowerShell writes it, and old editors."""
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.json: expected JSON in UTF-8, .* save it in that encoding"):
        read_json(tmp_path / "a.json")


@pytest.mark.parametrize("n_digits", [1, 20, 307, 308, 309, 400, 10_000])
def test_a_whole_number_of_any_length_is_one_that_a_float_can_hold(n_digits):
    digits = "9" * n_digits
    assert [float(number) for number in parse_json(f"[{digits}, -{digits}]")] == [float(digits), -float(digits)]


@pytest.mark.parametrize("content", ["", "{", "[1]", "null", '{"a": "b"}', '"a"', "[" * 200_000, None])
def test_a_kept_file_that_is_damaged_or_lost_is_made_again(tmp_path, caplog, content):
    path = tmp_path / "kept.json"
    if content is not None:
        path.write_text(content)
    read = lambda found: float(found["a"])  # noqa: E731
    assert kept_json(path, read) is None
    assert caplog.messages == ([] if content is None else [f"{path} is damaged and is made again"])
    path.write_text('{"a": 1.5}')
    assert kept_json(path, read) == 1.5


@pytest.mark.parametrize("content", ["", '{"a": "b"}', "[1]", "{}", '{"a": 1, "b": 2}', None])
def test_a_job_makes_what_is_not_kept_and_nothing_else(tmp_path, content):
    def job():
        steps.append("made")
        yield
        return {"a": 1.5}

    path, steps = tmp_path / "kept.json", []
    if content is not None:
        path.write_text(content)
    for _ in range(2):
        assert run_blocking(kept_or_done(dict[str, float], path, job(), lambda kept: [*kept] == ["a"])) == {"a": 1.5}
    assert steps == ["made"]
