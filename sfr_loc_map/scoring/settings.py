"""The settings of a score by the names that `sfr score` and `sfr_loc_map.score` share."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TypedDict, Unpack, get_type_hints

import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import ScoreConfig, score_config


class ScoreSettings(TypedDict, total=False):
    """Settings of the comparison of an estimate with the truth. Omitted settings have their defaults."""

    spacing: int  # frames between the starts of sub-trajectories (10)
    rebase: str  # removal of errors from before a start: `pose`, `displacement` or `position`
    partial: bool  # whether an incomplete estimate is judged as if it were complete (False)
    frames: str  # frames: `truth` poses, or `images` (estimates with interpolated truth)
    associate: str  # association of estimates with the truth: `auto`, `match` or `interpolate`
    max_gap: float  # longest gap of the truth that is bridged by interpolation, s (1)
    scored_range: tuple[float, float]  # range interval of the true points that count for coverage, m (0, 10)


FIELDS = {
    "spacing": "trajectory.spacing",
    "rebase": "trajectory.rebase",
    "partial": "trajectory.partial",
    "associate": "trajectory.association.truth",
    "max_gap": "trajectory.association.max_gap_s",
}
"""Settings that are fields of `ScoreConfig`, with the names of the fields."""


def check_known(names: Collection[str], settings: type, subject: str) -> None:
    """Raise ConfigError if a name is not one of the settings of a subject, such as "a score"."""
    known = get_type_hints(settings)
    if unknown := sorted(set(names) - known.keys()):
        raise ConfigError(f"{subject} has no setting '{unknown[0]}': the settings are {', '.join(known)}")


def score_settings(conditions: Sequence[str] | None, **settings: Unpack[ScoreSettings]) -> ScoreConfig:
    """Return the configuration of a score; raise ConfigError for unknown names or wrong values."""
    check_known(settings, ScoreSettings, "a score")
    values: dict[str, object] = {FIELDS[name]: value for name, value in settings.items() if name in FIELDS}
    if "scored_range" in settings:
        values["map.scored_from_m"], values["map.scored_to_m"] = _interval(settings["scored_range"])
    frames = settings.get("frames", "truth")
    if frames not in ("truth", "images"):
        raise ConfigError(f"frames is '{frames}': truth or images is required")
    if frames == "images":
        if settings.get("associate") == "match":
            raise ConfigError(
                "frames 'images' interpolates the truth, but associate 'match' does not: omit one of them"
            )
        values[FIELDS["associate"]] = "interpolate"
    return score_config(conditions, values)


def _interval(scored_range: object) -> tuple[object, object]:
    """Return the two ends of an interval; their values are checked with the other settings."""
    if not isinstance(scored_range, Sequence | np.ndarray) or len(scored_range) != 2 or isinstance(scored_range, str):
        raise ConfigError(f"scored_range is {scored_range!r:.60}: two distances in metres, (FROM, TO), are required")
    first, last = scored_range
    return first, last
