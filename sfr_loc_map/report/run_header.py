"""What the header of a report says of the run: on which data, how long, by which method, with what settings, when."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath

from sfr_loc_map.config import flatten
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.method_record import MethodRecord
from sfr_loc_map.metrics.score import Provenance, Score
from sfr_loc_map.tables.numbers import UNKNOWN, number

TRUTH_ROLES = ("truth", "map_truth")
RESULT_ROLES = ("estimate", "cloud")
_WITHIN_A_DATA_SET = ("groundtruth.csv", "loc", "nav")
"""Names that a data set folder gives its parts."""


def data_set_name(score: Score) -> str:
    """Return the name of the data set that the truth is of, empty where the score does not tell it."""
    for path in _paths(score, TRUTH_ROLES):
        place = PurePath(path)
        while place.name in _WITHIN_A_DATA_SET and place.parent.name:
            place = place.parent
        return place.name
    return ""


def run_facts(score: Score) -> tuple[tuple[str, str], ...]:
    """Return the facts of the header, each with its name; what the score does not know is left out."""
    made = score.provenance
    facts = (
        ("Truth", ", ".join(_paths(score, TRUTH_ROLES))),
        ("Judged", ", ".join(_paths(score, RESULT_ROLES))),
        ("Drive", _drive(score)),
        ("Map", _map(score)),
        ("Method", _method(score.method)),
        ("Poses converted", "yes, see Method under test" if score.convention is not None else ""),
        ("Configuration", _configuration(made)),
        ("Scored", "" if made is None else _scored(made)),
    )
    return tuple((name, text) for name, text in facts if text)


def _paths(score: Score, roles: tuple[str, ...]) -> list[str]:
    """Return the inputs of some roles, each once."""
    inputs = {} if score.provenance is None else score.provenance.inputs
    return list(dict.fromkeys(inputs[role].path for role in roles if role in inputs))


def _drive(score: Score) -> str:
    part = score.trajectory
    if part is None:
        return ""
    return f"{number(part.path_length_m)} m in {number(part.duration_s)} s, {part.matched} stereo pairs with a truth"


def _map(score: Score) -> str:
    part = score.map
    if part is None:
        return ""
    return f"{part.points} points of {part.pairs} stereo {'pair' if part.pairs == 1 else 'pairs'}"


def _method(method: MethodRecord | None) -> str:
    if method is None:
        return "not named in the inputs"
    return f"{method.name} {method.version or 'of unknown version'} ({method.kind})"


def _configuration(made: Provenance | None) -> str:
    """Return the settings that are not the default ones."""
    if made is None or not made.configuration:
        return ""
    changed = changed_settings(made.configuration)
    return "; ".join(f"{name} {_text(value)}" for name, value in changed.items()) or "defaults"


def changed_settings(settings: Mapping[str, object]) -> dict[str, object]:
    """Return the settings of a score that are not its defaults; those of other parts are there only if changed."""
    usual = {name: _plain(value) for name, value in flatten(ScoreConfig()).items()}
    return {name: value for name, value in settings.items() if name not in usual or _plain(value) != usual[name]}


def _plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def _text(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else UNKNOWN if value is None else str(value)


def _scored(made: Provenance) -> str:
    host = ", ".join(f"Python {value}" if name == "python" else value for name, value in made.host.items())
    return f"{made.time or 'time unknown'} by sfr_loc_map {made.version or UNKNOWN}{f' on {host}' if host else ''}"
