"""Frozen dataclasses to plain JSON values and back, checked on reading.

The type of a field is the only declaration. A field is written under its own name or the one given by `Key`; a field
annotated with `Inline` is written into the object of its owner. A field whose default is None or empty is left out
while it has that value, every other field is always written, None as null. A field with any default may be absent:
files of versions that did not have it are read. Numbers that are not finite are undefined: null. A class with methods
`to_plain` and `from_plain` writes and reads itself; `object` stands for any JSON.
"""

from __future__ import annotations

import difflib
import json
import math
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

T = TypeVar("T")
Decode = Callable[[Any, str], Any]


MAX_NUMBER = 1e100
"""Largest number: squares and sums of such stay finite."""
MAX_WHOLE = 2**63


class RecordError(ValueError):
    """A JSON value is not what its type says; the message names the place."""


@dataclass(frozen=True, slots=True)
class Key:
    """Annotation: the key of a field in JSON, where it is not the field's name."""

    name: str


@dataclass(frozen=True, slots=True)
class Inline:
    """Annotation: the keys of a field stand in its owner's object, after a prefix; all absent: the field is None."""

    prefix: str = ""


@dataclass(frozen=True, slots=True)
class _Field:
    """How one field is written and read."""

    name: str
    key: str
    inline: Inline | None
    left_out_if_empty: bool
    has_default: bool
    record: type | None
    decode: Decode

    def names(self) -> list[str]:
        """Return its keys in the owner's object."""
        if self.inline is None or self.record is None:
            return [self.key]
        return [self.inline.prefix + key for item in _fields_of(cast(Any, self.record)) for key in item.names()]

    def left_out_of(self, content: Mapping[str, Any]) -> bool:
        """Tell whether the field has its default because no key of it is there."""
        return self.has_default and not any(key in content for key in self.names())


def to_plain(value: Any) -> Any:  # noqa: ANN401 - any value of a record
    """Return a record as JSON values: dicts, lists, numbers, words."""
    if value is None or isinstance(value, (str, bool, int)):
        return value.value if isinstance(value, StrEnum) else value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, Sequence):
        return [item if type(item) is int else to_plain(item) for item in value]
    if hasattr(value, "to_plain"):
        return value.to_plain()
    return _record_to_plain(value)


def json_line(value: Any) -> str:  # noqa: ANN401 - any record, or dicts and lists of them
    """Return the JSON of a record in one line; numbers in the shortest form that reads back to the same bits."""
    return plain_json_line(to_plain(value))


def plain_json_line(plain: Any) -> str:  # noqa: ANN401 - any JSON values
    """Return the JSON of JSON values in one line."""
    return json.dumps(plain, allow_nan=False, separators=(",", ":")) + "\n"


def from_plain(kind: type[T], value: object, place: str = "") -> T:
    """Return the record of JSON values.

    Args:
        kind: Class of the record.
        value: JSON values.
        place: What the value is called in messages.

    Raises:
        RecordError: If a key is missing or unknown or a value is of another type; one line.
    """
    return cast(T, _decoder(cast(Any, kind))(value, place))


def _record_to_plain(record: Any) -> dict[str, Any]:  # noqa: ANN401 - any dataclass
    plain: dict[str, Any] = {}
    for item in _fields_of(cast(Any, type(record))):
        value = getattr(record, item.name)
        if item.left_out_if_empty and (value is None or (isinstance(value, (tuple, Mapping)) and not value)):
            continue
        if item.inline is None:
            plain[item.key] = to_plain(value)
        else:
            plain |= {item.inline.prefix + key: part for key, part in to_plain(value).items()}
    return plain


@cache
def _fields_of(record: type) -> tuple[_Field, ...]:
    hints = get_type_hints(record, include_extras=True)
    return tuple(_field(item, hints[item.name]) for item in fields(record))


def _omitted(item: Any) -> bool:  # noqa: ANN401 - dataclasses.Field of any type
    """Tell whether the field is left out while it is None or empty."""
    return item.default is None or item.default == () or item.default_factory is not MISSING


def _field(item: Any, hint: Any) -> _Field:  # noqa: ANN401 - dataclasses.Field of any type, any type expression
    kind, notes = (get_args(hint)[0], get_args(hint)[1:]) if get_origin(hint) is Annotated else (hint, ())
    keys = [note.name for note in notes if isinstance(note, Key)]
    inline = next((note for note in notes if isinstance(note, Inline)), None)
    record = next((part for part in (kind, *get_args(kind)) if is_dataclass(part)), None)
    omitted = _omitted(item)
    has_default = omitted or item.default is not MISSING
    key = keys[0] if keys else item.name
    return _Field(item.name, key, inline, omitted, has_default, cast("type | None", record), _decoder(kind))


@cache
def _decoder(kind: Any) -> Decode:  # noqa: ANN401 - any type expression
    """Return the function that reads a value of a type."""
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is object:
        return lambda value, _: value
    if origin in (Union, types.UnionType):
        return _decode_optional(_decoder(next(part for part in arguments if part is not type(None))))
    if origin is tuple:
        return _decode_tuple(arguments)
    if origin is not None and issubclass(origin, Mapping):
        return _decode_mapping(_decoder(arguments[1]))
    if hasattr(kind, "from_plain"):
        return _decode_own(kind)
    if is_dataclass(kind):
        return lambda value, place: _record_from_plain(cast(type, kind), value, place)
    if issubclass(kind, StrEnum):
        return _decode_word(kind)
    return _SCALARS[kind]


def _record_from_plain(kind: type, value: object, place: str) -> Any:  # noqa: ANN401 - of the class given
    content, items = _object(value, place), _fields_of(cast(Any, kind))
    _check_keys(content, [key for item in items for key in item.names()], place)
    chosen = {item.name: _field_value(item, content, place) for item in items if not item.left_out_of(content)}
    try:
        return kind(**chosen)
    except ValueError as error:
        raise RecordError(f"{place or 'it'}: {error}") from error


def _check_keys(content: Mapping[str, Any], known: Sequence[str], place: str) -> None:
    for key in content:
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(known)}"
            raise RecordError(f"{place or 'it'} has an unknown key '{key}' ({hint})")


def _field_value(item: _Field, content: Mapping[str, Any], place: str) -> Any:  # noqa: ANN401 - of the field's type
    if item.inline is not None:
        prefix = item.inline.prefix
        return item.decode({key.removeprefix(prefix): content[key] for key in item.names() if key in content}, place)
    if item.key not in content:
        raise RecordError(f"{place or 'it'} has no '{item.key}'")
    return item.decode(content[item.key], f"{place}.{item.key}" if place else item.key)


def _object(value: object, place: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise _unexpected("an object", value, place)
    return value


def _unexpected(needed: str, value: object, place: str) -> RecordError:
    text = repr(value)
    found = text if len(text) <= 40 else type(value).__name__
    return RecordError(f"{place or 'it'} is {found}: {needed} is needed")


def _decode_optional(inner: Decode) -> Decode:
    def decode(value: Any, place: str) -> Any:  # noqa: ANN401 - any value of JSON
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            return None
        return inner(value, place)

    return decode


def _decode_tuple(arguments: tuple[Any, ...]) -> Decode:
    every, size = _decoder(arguments[0]), None if arguments[-1] is Ellipsis else len(arguments)

    def decode(value: Any, place: str) -> Any:  # noqa: ANN401 - any value of JSON
        if not isinstance(value, (list, tuple)) or (size is not None and len(value) != size):
            raise _unexpected("a list" if size is None else f"a list of {size}", value, place)
        return tuple(every(item, place) for item in value)

    return decode


def _decode_mapping(inner: Decode) -> Decode:
    return lambda value, place: {
        key: inner(item, f"{place}.{key}" if place else key) for key, item in _object(value, place).items()
    }


def _decode_own(kind: Any) -> Decode:  # noqa: ANN401 - a class with `from_plain`
    def decode(value: Any, place: str) -> Any:  # noqa: ANN401 - any value of JSON
        try:
            return kind.from_plain(value)
        except ValueError as error:
            raise RecordError(f"{place}: {error}") from error

    return decode


def _decode_word(kind: type[StrEnum]) -> Decode:
    def decode(value: Any, place: str) -> Any:  # noqa: ANN401 - any value of JSON
        try:
            return kind(value)
        except ValueError as error:
            raise _unexpected(f"one of {', '.join(kind)}", value, place) from error

    return decode


def _number(value: Any, place: str) -> float:  # noqa: ANN401 - any value of JSON
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _unexpected("a number", value, place)
    try:
        sensible = abs(value) <= MAX_NUMBER
    except OverflowError:
        sensible = False
    if not sensible:
        raise _unexpected(f"a number of at most {MAX_NUMBER:g}", value, place)
    return value


def _whole(value: Any, place: str) -> int:  # noqa: ANN401 - any value of JSON
    if isinstance(value, bool) or not isinstance(value, int):
        raise _unexpected("a whole number", value, place)
    if not -MAX_WHOLE <= value < MAX_WHOLE:
        raise _unexpected("a whole number of 64 bits", value, place)
    return value


def _truth_value(value: Any, place: str) -> bool:  # noqa: ANN401 - any value of JSON
    if not isinstance(value, bool):
        raise _unexpected("true or false", value, place)
    return value


def _text(value: Any, place: str) -> str:  # noqa: ANN401 - any value of JSON
    if not isinstance(value, str):
        raise _unexpected("a text", value, place)
    return value


_SCALARS: Mapping[Any, Decode] = {float: _number, int: _whole, bool: _truth_value, str: _text}
