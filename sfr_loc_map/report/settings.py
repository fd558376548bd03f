"""Settings of a score that differ from their defaults, and their texts, for the header of a page and the deviations."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from sfr_loc_map.configuration.parameters import flatten
from sfr_loc_map.metrics.conditions import shortest
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.tables.model import UNKNOWN


class ChangedSetting(NamedTuple):
    """A setting that differs from its default. The values are those of the JSON of a score."""

    name: str  #: Dotted name: `trajectory.spacing`.
    value: Any
    default: Any  #: None for a setting of another package.
    is_of_score: bool  #: Whether the setting is one of `ScoreConfig`; other packages record only changed settings.


def setting_text(value: object) -> str:
    """Return a value of the JSON as text: numbers in the shortest exact form, the items of a list, or unknown."""
    if isinstance(value, list):
        return ", ".join(map(setting_text, value))
    if value is None:
        return UNKNOWN
    return shortest(value) if isinstance(value, float) else str(value)


def has_all_settings(score: Score) -> bool:
    """Return whether a score states each setting of `ScoreConfig` that it was made with."""
    return score.provenance is not None and flatten(ScoreConfig()).keys() <= score.provenance.configuration.keys()


def changed_settings(score: Score) -> Iterator[ChangedSetting]:
    """Yield the settings in the provenance of a score that differ from their defaults."""
    if score.provenance is None:
        return
    defaults = to_plain(flatten(ScoreConfig()))
    for name, value in flatten(to_plain(score.provenance.configuration)).items():
        is_of_score = name in defaults
        if not is_of_score or value != defaults[name]:
            yield ChangedSetting(name, value, defaults.get(name), is_of_score)
