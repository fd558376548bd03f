"""Conversion of records to JSON and back by msgspec, with one schema for files, topics and the report.

Numbers that are not finite are written as null. A record that is read is checked against the types of its fields. The
JSON of a score contains the hash of its other values. A change of a value on which no figure and no verdict depends,
such as the deletion of a finding, is therefore also detected. The hash is not a signature.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec.structs import replace

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import MAX_JSON_BYTES, read_text
from sfr_loc_map.metrics.figures.row_part import RowPart
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.score.score import SCHEMA, Score
from sfr_loc_map.metrics.stored.file_check import ContradictionError, checked_score

T = TypeVar("T")
HASH = "content_sha256"  #: Key of the hash of all other values.
UNDEFINED = ("sigma", "mean_plus_3sigma")  #: Statistics of fewer than two sub-trajectories, which are written as null.
GIVE_SCORE = "give the JSON of sfr score --json"
SCORE_AGAIN = "score the estimate again with this version (sfr score EST TRUTH --json S.json)"


class RecordError(ValueError):
    """A JSON value does not have the required type; the message names the field."""


def to_plain(value: Any) -> Any:  # noqa: ANN401 - any record
    """Return a record, or a collection of records, as JSON values: dicts, lists, numbers, strings."""
    return msgspec.json.decode(_encoded(value))


def json_line(value: Any) -> str:  # noqa: ANN401 - any record, or dicts and lists of records
    """Return the JSON of a record in one line, with numbers in the shortest form that is read back bit-identical."""
    return _encoded(value).decode() + "\n"


def from_plain(kind: type[T], value: Any, name: str = "") -> T:  # noqa: ANN401 - any JSON
    """Return the value of a type from its JSON; `name` is the name of the value in messages.

    RecordError, with a message of one line, if a key is missing or unknown, or a value has a wrong type.
    """
    try:
        return converted(kind, value)
    except (msgspec.ValidationError, ValueError) as error:
        raise RecordError(f"{name}: {error}" if name else str(error)) from error


def converted(kind: type[T], value: Any) -> T:  # noqa: ANN401 - any JSON
    """Return the value of a type from its JSON; ValueError if a key is missing or unknown or a type differs."""
    return msgspec.convert(value, kind, dec_hook=_part_of_text)


def to_dict(score: Score) -> dict[str, Any]:
    """Return the score as JSON values, with their hash."""
    found: dict[str, Any] = to_plain(replace(score, content_sha256=None))
    for row in found["figures"]:
        if row["subject"] == Subject.TRAJECTORY and row.get("n") in (0, 1):
            for name in UNDEFINED:
                row.setdefault(name, None)
    return {**found, HASH: hash_of_values(found)}


def to_json(score: Score) -> str:
    """Return the JSON of a score, with numbers in the shortest form that is read back bit-identical."""
    return json_line(to_dict(score))


def hash_of_values(content: Mapping[str, Any]) -> str:
    """Return the hash of the JSON values of a score except the hash itself, independently of the order of the keys."""
    values = {name: value for name, value in content.items() if name != HASH}
    return hashlib.sha256(msgspec.json.encode(values, order="sorted")).hexdigest()


def load_score(path: Path) -> Score:
    """Read a score and check its values; InputError if they contradict each other, or if the file is not a score."""
    try:
        return from_json(read_text(path, MAX_JSON_BYTES), f"'{path}'", needs_hash=True)
    except (OSError, ValueError) as error:
        problem = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"cannot read score '{path}': {problem}; give the JSON of sfr score --json") from error


def from_json(text: str | bytes, origin: str = "score", *, needs_hash: bool = False) -> Score:
    """Return the score of a JSON text; the arguments and errors are those of `from_dict`."""
    try:
        content = msgspec.json.decode(text)
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        problem = " ".join(str(error).split())
        raise InputError(f"{origin} is not JSON ({problem}): give the JSON of sfr score --json") from error
    return from_dict(content, origin, needs_hash=needs_hash)


def from_dict(
    content: Any,  # noqa: ANN401 - any JSON
    origin: str = "score",
    *,
    needs_hash: bool = False,
    advice: str = "",
) -> Score:
    """Return the score of JSON values, without their hash.

    In messages, `origin` names their source, and `advice` states what to do (empty: the commands that make a score).

    InputError if the values do not match the schema or contradict each other, or if their hash differs or is missing
    although `needs_hash` is set. The message, of one line, names fault and field.
    """
    score_again, give_score = advice or SCORE_AGAIN, advice or GIVE_SCORE
    _check_schema(content, origin, score_again, give_score)
    try:
        score = converted(Score, content)
    except (msgspec.ValidationError, ValueError) as error:
        reason = " ".join(str(error).split())  # keys of the file may contain line breaks
        raise InputError(f"{origin} does not match {SCHEMA}: {reason}; {give_score}") from error
    try:
        score = checked_score(score)
    except ContradictionError as error:
        raise InputError(f"{origin} contradicts itself: {error}; {score_again}") from error
    if needs_hash and score.content_sha256 is None:
        raise InputError(f"{origin} has no {HASH}, the hash of its values: {score_again}")
    if score.content_sha256 not in (None, hash_of_values(content)):
        raise InputError(f"{origin} contradicts itself: its values were changed, as {HASH} shows; {score_again}")
    return replace(score, content_sha256=None)


def _check_schema(content: object, origin: str, score_again: str, give_score: str) -> None:
    """Raise InputError if JSON values do not name the schema of a score.

    `score_again` is the advice for a former schema, and `give_score` that for other content.
    """
    if not isinstance(content, dict):
        kind = type(content).__name__
        raise InputError(f"{origin} is not a score: a JSON object is required, found {kind}; {give_score}")
    found = content.get("schema")
    if found == "sfr-score/1":
        raise InputError(f"{origin} is a score of version 0.2 ({found}), which is no longer supported: {score_again}")
    if found != SCHEMA:
        named = " ".join(repr(found).split())[:60]
        raise InputError(f"{origin} is not a score: schema {SCHEMA} is required, found {named}; {give_score}")


def _encoded(value: Any) -> bytes:  # noqa: ANN401 - any record
    try:
        return msgspec.json.encode(value, enc_hook=_text_of_part)
    except UnicodeEncodeError:  # file names may contain bytes that are not UTF-8
        return msgspec.json.encode(_readable(msgspec.to_builtins(value, enc_hook=_text_of_part)))


def _text_of_part(value: object) -> str:
    """Return the JSON of the part of a row, its text; NotImplementedError for a value that JSON does not have."""
    if not isinstance(value, RowPart):
        raise NotImplementedError(f"{type(value)} is not a value of JSON")
    return str(value)


def _part_of_text(kind: type[Any], value: Any) -> Any:  # noqa: ANN401 - any JSON
    """Return the part of a row from its JSON; ValueError if it is not a text.

    If `kind` is not `RowPart`, the value is returned unchanged.
    """
    if kind is not RowPart:
        return value  # msgspec checks its type
    if not isinstance(value, str):
        raise ValueError(f"a text is required, found {type(value).__name__}")
    return RowPart(value)


def _readable(value: Any) -> Any:  # noqa: ANN401 - any JSON value
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode("utf-8")
    if isinstance(value, dict):
        return {_readable(key): _readable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_readable(item) for item in value]
    return value
