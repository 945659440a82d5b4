"""Records as JSON: a frozen dataclass says once what a file holds, and is written, read and described by it.

Dataclasses, tuples, dicts with names or numbers as keys, `Literal`, `X | None`, arrays and plain values, nested as one
likes. A reader takes what is missing from the defaults and leaves out what it does not know, so that older and newer
files can be read; arrays come as lists of floats, and the record makes arrays of them. What a field holds is
`Annotated`. A field marked ABSENT stays out of the JSON while it is None; the fields of a record marked INLINE stand
among those of the record around it, which is None if none of them does. Not for NaN or Infinity, which JSON does not
have.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

from xihenet.io.json_files import read_json

Json = Any  # what `json.loads` gives
Plain = str | int | float | bool | None
Parameters = dict[str, Plain | tuple[Plain, ...]]
Record = TypeVar("Record")
ABSENT = {"json": "absent"}
INLINE = {"json": "inline"}
Where = tuple[Any, str | int]
"""Around what a value lies, which is again such a pair or None, and its name or place in it: put into words only where
it is asked for."""
Reader = Callable[[Json, Where], Any]
PLAIN = {bool: "boolean", int: "integer", float: "number", str: "string", type(None): "null"}


def as_json(value: object) -> Json:
    """`value`, of records, tuples, lists, dicts, arrays and plain values, as `json.dumps` takes it."""
    if type(value) in PLAIN:
        return value
    if dataclasses.is_dataclass(value):
        content: dict[str, Json] = {}
        for field in dataclasses.fields(value):
            of_field = getattr(value, field.name)
            if of_field is None and field.metadata:
                continue
            content.update(as_json(of_field) if field.metadata == INLINE else {field.name: as_json(of_field)})
        return content
    if isinstance(value, Mapping):
        return {name: as_json(of_one) for name, of_one in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(of_one) for of_one in value]
    return value.tolist() if hasattr(value, "tolist") else value


def from_json(kind: type[Record], content: Json) -> Record:
    """The record that `content` is. TypeError or ValueError where it is not one, with the name of the field."""
    read = _reader(typing.cast(Any, kind))
    return typing.cast(Record, read(content, (None, kind.__name__)))


def read_record(kind: type[Record], path: Path) -> Record:
    """The record in a JSON file. OSError where it cannot be read; TypeError or ValueError as of `from_json`."""
    return from_json(kind, read_json(path))


def json_schema(kind: type) -> dict[str, Json]:
    """A JSON schema (draft 2020-12) of a record, with descriptions."""
    found: dict[str, Json] = {}
    _describe(kind, found)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": kind.__name__,
        **found.pop(kind.__name__),
        "$defs": found,
    }


@functools.cache
def _reader(kind: Any) -> Reader:
    """What reads a value of a kind. Made once: typing takes as long to say what a kind is made of as most take to read.

    The fields of a record are looked at when the first is read, since it may hold others of its kind.
    """
    origin, of = typing.get_origin(kind), typing.get_args(kind)
    if kind is float:
        return _read_number
    if dataclasses.is_dataclass(kind):
        return functools.partial(_read_record, kind)
    if origin in (Union, types.UnionType):
        return functools.partial(_read_one_of, {one: _reader(one) for one in of})
    if origin is Literal:
        return lambda content, where: _checked(content in of, content, where)
    if origin is tuple:
        readers = [_reader(one) for one in of if one is not ...]
        return functools.partial(_read_tuple, readers, of[1:] == (...,), set(readers) == {_read_number})
    if origin in (dict, Mapping):
        return functools.partial(_read_dict, of[0], _reader(of[1]))
    if getattr(origin, "__name__", "") in ("ndarray", "NDArray"):  # the latter from NumPy 2.5 on
        return _read_numbers
    return lambda content, where: _checked(type(content) is kind, content, where)


def _read_number(content: Json, where: Where) -> float:
    is_number = type(content) is float or (isinstance(content, int | float) and not isinstance(content, bool))
    return float(_checked(is_number and math.isfinite(content), content, where))


def _read_tuple(
    readers: list[Reader], is_of_any_length: bool, is_of_floats: bool, content: Json, where: Where
) -> tuple[Any, ...]:
    _checked(isinstance(content, list | tuple), content, where)
    readers = readers * len(content) if is_of_any_length else readers
    _checked(len(readers) == len(content), content, where)
    if is_of_floats and set(map(type, content)) == {float} and all(map(math.isfinite, content)):
        return tuple(content)  # As below, in a tenth of the time.
    return tuple([read(v, (where, i)) for i, (read, v) in enumerate(zip(readers, content, strict=True))])


def _read_dict(of_names: type, read: Reader, content: Json, where: Where) -> dict[Any, Any]:
    _checked(isinstance(content, Mapping), content, where)
    names = [int(name) if of_names is int else name for name in content]
    return {k: read(v, (where, f".{k}")) for k, v in zip(names, content.values(), strict=True)}


def _read_numbers(content: Json, where: Where) -> Any:
    if isinstance(content, list):
        return [_read_numbers(of_one, (where, i)) for i, of_one in enumerate(content)]
    return _read_number(content, where)


def _read_record(kind: Any, content: Json, where: Where) -> Any:
    _checked(isinstance(content, Mapping), content, where)
    given = {}
    for name, read, inner in _fields_of(kind):
        if inner is not None:
            if any(one in content for one in inner):
                given[name] = read(content, where)
        elif name in content:
            given[name] = read(content[name], (where, f".{name}"))
    return kind(**given)


@functools.cache
def _fields_of(kind: Any) -> list[tuple[str, Reader, Collection[str] | None]]:
    """Name and reader of each field, and of one that is INLINE the names that stand there, else None."""
    fields = [(field, _types_of(kind)[field.name]) for field in dataclasses.fields(kind)]
    inner = {field.name: _record_in(of) for field, of in fields if field.metadata == INLINE}
    names = {name: _types_of(record) for name, record in inner.items()}
    return [(one.name, _reader(inner.get(one.name, of)), names.get(one.name)) for one, of in fields]


def _record_in(optional: Any) -> Any:
    """The record of `Record | None`."""
    return next(kind for kind in typing.get_args(optional) if dataclasses.is_dataclass(kind))


def _read_one_of(readers: Mapping[Any, Reader], content: Json, where: Where) -> Any:
    if content is None and type(None) in readers:
        return None
    # True is no number, and 1 stays one where a float would do as well.
    exact = readers.get(type(content))
    for read in (exact,) if exact else [read for kind, read in readers.items() if kind is not type(None)]:
        try:
            return read(content, where)
        except (TypeError, ValueError) as error:
            refusal = error
    raise refusal


def _checked(is_right: bool, content: Json, where: Where) -> Any:
    if not is_right:
        raise ValueError(f"{_format_place(where)}: {str(content)[:80]!r} does not belong there")
    return content


def _format_place(where: Where | None) -> str:
    if where is None:
        return ""
    around, part = where
    return _format_place(around) + (part if isinstance(part, str) else f"[{part}]")


@functools.cache
def _types_of(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def _describe(kind: Any, found: dict[str, Json]) -> dict[str, Json]:
    """A schema of `kind`; records are put into `found`, by name."""
    origin, of = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind):
        name = typing.cast(type, kind).__name__
        if name not in found:
            found[name] = {}
            found[name] = _describe_record(kind, found)
        return {"$ref": f"#/$defs/{name}"}
    if origin in (Union, types.UnionType):
        return {"anyOf": [_describe(one, found) for one in of]}
    if origin is Literal:
        return {"enum": list(of)}
    if origin is tuple and of[1:] == (...,):
        return {"type": "array", "items": _describe(of[0], found)}
    if origin is tuple:
        items = [_describe(one, found) for one in of]
        return {"type": "array", "prefixItems": items, "items": False, "minItems": len(of)}
    if origin is dict:
        return {"type": "object", "additionalProperties": _describe(of[1], found)}
    return {"type": PLAIN[kind]}


def _describe_record(kind: Any, found: dict[str, Json]) -> dict[str, Json]:
    hints = typing.get_type_hints(kind, include_extras=True).items()
    texts = {name: str(hint.__metadata__[0]) for name, hint in hints if hasattr(hint, "__metadata__")}
    fields = dataclasses.fields(kind)
    properties: dict[str, Json] = {}
    for field in fields:
        of_field = _types_of(kind)[field.name]
        if field.metadata == INLINE:
            properties |= _describe_record(_record_in(of_field), found)["properties"]
        else:
            text = {"description": texts[field.name]} if field.name in texts else {}
            properties[field.name] = _describe(of_field, found) | text
    return {
        "description": " ".join(kind.__doc__.split("\n\n")[0].split()),
        "type": "object",
        "properties": properties,
        "required": [field.name for field in fields if not field.metadata],
        "additionalProperties": False,
    }
