"""What a user requests of a score, by the names that `sfr score`, `sfr replay` and `sfr_loc_map.score` share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import AlignedErrorConfig, ScoreConfig, aligned_error_config, score_config
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.scoring.conversion import converted_run
from sfr_loc_map.scoring.inputs import Correction, Run
from sfr_loc_map.scoring.judgement import with_conditions
from sfr_loc_map.scoring.score_run import score_run

SETTINGS = {
    "trajectory.conditions": "conditions",
    "trajectory.spacing": "spacing",
    "trajectory.rebase": "rebase",
    "trajectory.partial": "partial",
    "trajectory.association.truth": "associate",
    "trajectory.association.max_gap_s": "max_gap",
    "map.scored_from_m": "scored_range",
    "map.scored_to_m": "scored_range",
    "align": "align",
    "max_difference": "max_difference",
    "rpe_delta": "rpe_delta",
}
"""The argument of `ScoreRequest.of` by the name of the setting that the argument gives."""
DEFAULTS = ScoreConfig()


class ScoredRun(NamedTuple):
    """A score and what it was computed from."""

    score: Score
    run: Run  #: The run with poses of RB in DS.


@dataclass(frozen=True, slots=True)
class ScoreRequest:
    """Settings, limits and conversion of a score."""

    config: ScoreConfig = field(default_factory=ScoreConfig)  #: Settings, with the conditions of the limits.
    limits: Limits | None = None  #: Limits by which the score is judged; None: no verdict.
    aligned: AlignedErrorConfig | None = None  #: Settings of APE and RPE; None: they are not computed.
    correction: Correction = field(default_factory=Correction)  #: Conversion of the estimate before it is scored.

    @classmethod
    def of(  # noqa: PLR0913 - the options of the commands and of `sfr_loc_map.score`
        cls,
        conditions: Sequence[str] | None = None,
        limits: Limits | None = None,
        *,
        spacing: int = DEFAULTS.trajectory.spacing,
        rebase: str = DEFAULTS.trajectory.rebase,
        partial: bool = DEFAULTS.trajectory.partial,
        frames: str = "truth",
        associate: str = DEFAULTS.trajectory.association.truth,
        max_gap: float = DEFAULTS.trajectory.association.max_gap_s,
        scored_range: tuple[float, float] = (DEFAULTS.map.scored_from_m, DEFAULTS.map.scored_to_m),
        align: str | None = None,
        max_difference: float | None = None,
        rpe_delta: str | None = None,
        convention: Sequence[str] = (),
        apply_diagnosis: bool = False,
        called: Mapping[str, str] | None = None,
    ) -> Self:
        """Return a request from options, which `sfr_loc_map.score` describes; ConfigError if a value is invalid.

        `called` has the names of the options in messages, such as `--max-gap` for `max_gap`.
        """
        names = {argument: argument for argument in (*SETTINGS.values(), "frames")} | dict(called or {})
        name_of_setting = {setting: names[argument] for setting, argument in SETTINGS.items()}
        if not isinstance(frames, str) or frames not in ("truth", "images"):
            raise ConfigError(f"'{names['frames']}' is {frames!r:.60}: truth or images is required")
        if frames == "images" and isinstance(associate, str) and associate == "match":
            raise ConfigError(
                f"'{names['frames']}' images interpolates the truth, but '{names['associate']}' match does not: omit "
                "one of them"
            )
        scored_from_m, scored_to_m = _interval(scored_range, names["scored_range"])
        settings = {
            "trajectory.spacing": spacing,
            "trajectory.rebase": rebase,
            "trajectory.partial": partial,
            "trajectory.association.truth": "interpolate" if frames == "images" else associate,
            "trajectory.association.max_gap_s": max_gap,
            "map.scored_from_m": scored_from_m,
            "map.scored_to_m": scored_to_m,
        }
        return cls(
            with_conditions(score_config(conditions, settings, name_of_setting), limits),
            limits,
            aligned_error_config(align, {"max_difference": max_difference, "rpe_delta": rpe_delta}, name_of_setting),
            Correction(PoseConvention.parse(convention), apply_diagnosis),
        )

    def scored(self, loaded: Run) -> ScoredRun:
        """Convert a loaded run to poses of RB in DS, score it, and return the score with the converted run.

        Raises MetricsError and InputError as `converted_run` and `score_run` do.
        """
        run = converted_run(loaded, self.config, self.correction)
        score = score_run(run, self.config, self.limits, self.aligned)
        return ScoredRun(score, run)


def _interval(scored_range: object, name: str) -> tuple[object, object]:
    """Return the two ends of an interval; their values are checked with the other settings.

    `name` is that of the option in messages.
    """
    if not isinstance(scored_range, Sequence | np.ndarray) or len(scored_range) != 2 or isinstance(scored_range, str):
        raise ConfigError(f"'{name}' is {scored_range!r:.60}: two distances in metres, (FROM, TO), are required")
    first, last = scored_range
    return first, last
