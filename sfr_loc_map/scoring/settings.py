"""The settings of a score, by the names that `sfr score` and `sfr_loc_map.score` share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict, Unpack

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import ScoreConfig, score_config


class ScoreSettings(TypedDict, total=False):
    """How an estimate is compared with the truth; what is omitted has its default."""

    spacing: int  # frames from one start of a sub-trajectory to the next (10)
    rebase: str  # how error from before a start is kept out: `pose`, `displacement` or `position`
    partial: bool  # whether an estimate of a part of the drive is judged as if it were complete (False)
    frames: str  # what frames are: `truth` poses, or `images` (estimates, with the truth interpolated)
    associate: str  # how an estimate finds its truth: `auto`, `match` or `interpolate`
    max_gap: float  # longest gap of the truth that is interpolated, s (1)
    scored_range: tuple[float, float]  # ranges of the truth that count for coverage, m (0, 10)


FIELDS = {
    "spacing": "trajectory.spacing",
    "rebase": "trajectory.rebase",
    "partial": "trajectory.partial",
    "associate": "trajectory.association.truth",
    "max_gap": "trajectory.association.max_gap_s",
}
"""Settings that are a field of `ScoreConfig`, and its name."""


def score_settings(conditions: Sequence[str] | None, **settings: Unpack[ScoreSettings]) -> ScoreConfig:
    """Return the configuration of a score; ConfigError if a value is out of range, or two contradict each other."""
    values: dict[str, object] = {FIELDS[name]: value for name, value in settings.items() if name in FIELDS}
    if "scored_range" in settings:
        values["map.scored_from_m"], values["map.scored_to_m"] = settings["scored_range"]
    frames = settings.get("frames", "truth")
    if frames not in ("truth", "images"):
        raise ConfigError(f"frames is '{frames}': must be truth or images")
    if frames == "images":
        if settings.get("associate") == "match":
            raise ConfigError("frames 'images' interpolates the truth, associate 'match' does not: omit one")
        values[FIELDS["associate"]] = "interpolate"
    return score_config(conditions, values)
