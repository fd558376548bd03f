"""The score as JSON: one schema for files, for topics and for the report, which is made from it alone."""

from __future__ import annotations

from typing import Any

from sfr_loc_map.bounded_input import parse_json
from sfr_loc_map.errors import InputError
from sfr_loc_map.metrics.records.json_records import RecordError, from_plain, plain_json_line, to_plain
from sfr_loc_map.metrics.score import Score

SCHEMA = "sfr-score/1"


def to_dict(score: Score) -> dict[str, Any]:
    """Return the score as JSON values."""
    return {"schema": SCHEMA, **to_plain(score)}


def to_json(score: Score) -> str:
    """Return the score as text; numbers in the shortest form that reads back to the same bits."""
    return plain_json_line(to_dict(score))


def from_dict(content: object, origin: str = "score") -> Score:
    """Return the score of JSON values.

    Args:
        content: JSON values.
        origin: Where they come from, for messages.

    Raises:
        InputError: If they are not as the schema says: what and where, in one line.
    """
    found = content.get("schema") if isinstance(content, dict) else type(content).__name__
    if not isinstance(content, dict) or found != SCHEMA:
        raise InputError(
            f"{origin} is not a score: sought schema {SCHEMA}, found {_one_line(found)}; "
            "give the JSON of sfr score --json"
        )
    try:
        return from_plain(Score, {key: value for key, value in content.items() if key != "schema"})
    except RecordError as error:
        problem = _one_line(error)
        raise InputError(f"{origin} is not as {SCHEMA} says: {problem}; give the JSON of sfr score --json") from error


def _one_line(text: object) -> str:
    """Return a text with which a stranger's keys cannot break the line."""
    return " ".join(str(text).split())


def from_json(text: str, origin: str = "score") -> Score:
    """Return the score of a text; numbers that are not finite are undefined.

    Args:
        text: The text.
        origin: Where it comes from, for messages.

    Raises:
        InputError: If it is no JSON or not as the schema says: what and where, in one line.
    """
    try:
        content = parse_json(text, parse_constant=lambda _: None)
    except ValueError as error:
        raise InputError(f"{origin} is no JSON ({error}): give the JSON of sfr score --json") from error
    return from_dict(content, origin)
