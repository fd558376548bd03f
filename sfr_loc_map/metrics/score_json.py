"""Records as JSON and back: one schema for files, for topics and for the report, which is made from it alone.

The type of a field is the only declaration. A field whose default is None or empty is left out while it has that value,
every other is always written, None as null. A field with any default may be absent: files of versions that did not have
it are read. Numbers that are not finite are undefined: null. A class with methods `to_plain` and `from_plain` writes
and reads itself; `object` stands for any JSON. msgspec checks the values.
"""

from __future__ import annotations

import json
import math
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, NamedTuple, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from sfr_loc_map.config import suggestion
from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import parse_json
from sfr_loc_map.metrics.score import Columns, Inline, Key, Score

T = TypeVar("T")
SCHEMA = "sfr-score/1"
MAX_NUMBER, MAX_WHOLE = 1e100, 2**63 - 1
"""Largest numbers: squares and sums of the first stay finite, the other is that of 64 bits."""


class RecordError(ValueError):
    """A JSON value is not what its type says; the message names the place."""


class _Field(NamedTuple):
    """How one field is written and read: `keys` in its owner's object, several (after a prefix) if it is inlined."""

    name: str
    kind: Any
    keys: tuple[str, ...]
    prefix: str | None
    left_out_if_empty: bool
    has_default: bool


@cache
def fields_of(record: type) -> tuple[_Field, ...]:
    """Return how the fields of a record are written."""
    found = []
    hints = get_type_hints(record, include_extras=True)
    for item in fields(cast(Any, record)):
        kind, *notes = get_args(hints[item.name]) if get_origin(hints[item.name]) is Annotated else [hints[item.name]]
        keys: tuple[str, ...] = (item.name,)
        prefix = None
        for note in notes:
            if isinstance(note, Key):
                keys = (note.name,)
            elif isinstance(note, Inline):
                inner = next(part for part in (kind, *get_args(kind)) if is_dataclass(part))
                prefix = note.prefix
                keys = tuple(prefix + key for each in fields_of(cast(type, inner)) for key in each.keys)
        omitted = item.default is None or item.default == () or item.default_factory is not MISSING
        has_default = omitted or item.default is not MISSING
        found.append(_Field(item.name, kind, keys, prefix, omitted, has_default))
    return tuple(found)


def to_plain(value: Any) -> Any:  # noqa: ANN401 - any value of a record
    """Return a record as JSON values: dicts, lists, numbers, words."""
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, str):  # names of files may hold bytes that are no text
        text = value.value if isinstance(value, StrEnum) else value
        return text.encode("utf-8", "backslashreplace").decode("utf-8")
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, Sequence):
        finite = math.isfinite  # most numbers of a score stand in columns
        return [v if type(v) is int or (type(v) is float and finite(v)) else to_plain(v) for v in value]
    if hasattr(value, "to_plain"):
        return value.to_plain()
    plain: dict[str, Any] = {}
    for item in fields_of(cast(Any, type(value))):
        part = getattr(value, item.name)
        if item.left_out_if_empty and (part is None or (isinstance(part, (tuple, Mapping)) and not part)):
            continue
        inner = to_plain(part)
        plain |= {item.keys[0]: inner} if item.prefix is None else {item.prefix + key: v for key, v in inner.items()}
    return plain


def json_line(value: Any) -> str:  # noqa: ANN401 - any record, or dicts and lists of them
    """Return the JSON of a record in one line; numbers in the shortest form that reads back to the same bits."""
    return json.dumps(to_plain(value), allow_nan=False, separators=(",", ":")) + "\n"


def from_plain(kind: type[T], value: Any, place: str = "") -> T:  # noqa: ANN401 - any JSON
    """Return the value of a type from its JSON; `place` is what it is called in messages.

    RecordError if a key is missing or unknown or a value is of another type; one line.
    """
    return cast(T, _read(kind, value, place))


def _read(kind: Any, value: Any, place: str) -> Any:  # noqa: ANN401 - any type expression and a value of it
    origin, parts = get_origin(kind), get_args(kind)
    if kind is object:
        return value
    if origin in (Union, types.UnionType):
        undefined = value is None or (isinstance(value, float) and not math.isfinite(value))
        return None if undefined else _read(next(part for part in parts if part is not types.NoneType), value, place)
    if origin is not None and issubclass(origin, Mapping) and isinstance(value, Mapping):
        return {key: _read(parts[1], item, f"{place}.{key}") for key, item in value.items()}
    if origin is tuple and is_dataclass(parts[0]) and isinstance(value, list):
        return tuple(_read(parts[0], item, place) for item in value)
    try:
        if hasattr(kind, "from_plain"):
            return kind.from_plain(value)
        if is_dataclass(kind):
            record = cast(Any, kind)(**dict(_read_fields(cast(type, kind), value, place)))
            if isinstance(record, Columns):
                record.check()
            return record
        import msgspec  # what writes alone starts without it

        return msgspec.convert(_sensible(value), kind)
    except RecordError:
        raise
    except ValueError as error:  # msgspec's is one
        found = "" if is_dataclass(kind) or len(text := repr(value)) > 40 else f" is {text}"
        raise RecordError(f"{place or 'it'}{found}: {error}") from error


def _read_fields(kind: type, content: Any, place: str) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 - any JSON
    if not isinstance(content, Mapping):
        raise ValueError("an object is needed")
    known = [key for item in fields_of(kind) for key in item.keys]
    if unknown := [key for key in content if key not in known]:
        raise RecordError(f"{place or 'it'} has an unknown key '{unknown[0]}'{suggestion(str(unknown[0]), known)}")
    for item in fields_of(kind):
        present = [key for key in item.keys if key in content]
        if not present and item.has_default:
            continue
        if item.prefix is not None:
            inner = {key.removeprefix(item.prefix): content[key] for key in present}
            yield item.name, _read(item.kind, inner, place)
        elif not present:
            raise RecordError(f"{place or 'it'} has no '{item.keys[0]}'")
        else:
            yield item.name, _read(item.kind, content[present[0]], f"{place}.{present[0]}" if place else present[0])


def _sensible(value: Any) -> Any:  # noqa: ANN401 - any value of JSON
    if isinstance(value, list | tuple):
        return [_sensible(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, int | float) and abs(value) > (MAX_NUMBER if isinstance(value, float) else MAX_WHOLE):
        raise ValueError(f"a number of at most {MAX_NUMBER:g} is needed, a whole number of 64 bits")
    return value


def to_dict(score: Score) -> dict[str, Any]:
    """Return the score as JSON values."""
    return {"schema": SCHEMA, **to_plain(score)}


def to_json(score: Score) -> str:
    """Return the score as text; numbers in the shortest form that reads back to the same bits."""
    return json.dumps(to_dict(score), allow_nan=False, separators=(",", ":")) + "\n"


def from_dict(content: object, origin: str = "score") -> Score:
    """Return the score of JSON values; `origin` is where they come from, for messages.

    InputError if they are not as the schema says: what and where, in one line.
    """
    found = content.get("schema") if isinstance(content, dict) else type(content).__name__
    if not isinstance(content, dict) or found != SCHEMA:
        problem = f"is not a score: sought schema {SCHEMA}, found {found}"
    else:
        try:
            return from_plain(Score, {key: value for key, value in content.items() if key != "schema"})
        except RecordError as error:
            problem = f"is not as {SCHEMA} says: {error}"
    # a stranger's keys cannot break the line
    raise InputError(f"{origin} {' '.join(problem.split())}; give the JSON of sfr score --json")


def from_json(text: str, origin: str = "score") -> Score:
    """Return the score of a text; numbers that are not finite are undefined.

    InputError if it is no JSON or not as the schema says: what and where, in one line.
    """
    try:
        content = parse_json(text, parse_constant=lambda _: None)
    except ValueError as error:
        raise InputError(f"{origin} is no JSON ({error}): give the JSON of sfr score --json") from error
    return from_dict(content, origin)
