"""Limits and conditions by which a run is judged, from options and the configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import naming_key
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.judging.limits_file import load_limits, parse_limits
from sfr_loc_map.metrics.score.limits import Limits


@dataclass(frozen=True, slots=True)
class Judgement:
    """Limits and conditions by which a run is judged."""

    limits_file: Path | None  #: None without limits, and for limits that were given as a mapping.
    limits: Limits | None  #: None without limits.
    conditions: Sequence[str] | None  #: Conditions of options or of the configuration; None for the default.

    @classmethod
    def of(
        cls, limits: Path | Mapping[str, object] | None, conditions: Sequence[str] | None, config: Configuration
    ) -> Judgement:
        """Return the given limits and conditions, or else those of the configuration.

        `limits` is a limits file or its content. ConfigError for invalid limits, and for an invalid condition of the
        configuration.
        """
        listed = config.sections.get("conditions")
        _check_conditions(config)
        if isinstance(limits, Mapping):
            return cls(None, parse_limits(limits, "limits"), conditions or listed)
        file = limits_file_of(limits, config)
        return cls(file, None if file is None else load_limits(file), conditions or listed)

    @property
    def asked(self) -> tuple[Condition, ...]:
        """The conditions that the user named in options, in the configuration or in the limits."""
        of_limits = () if self.limits is None else self.limits.conditions
        return tuple(map(Condition.parse, (*(self.conditions or ()), *of_limits)))


def limits_file_of(limits: Path | None, config: Configuration) -> Path | None:
    """Return the given limits file, or else that of the configuration; None if there is none."""
    named: str | None = config.sections.get("limits")
    if limits is not None or not named:
        return limits
    return config.folder / named


def _check_conditions(config: Configuration) -> None:
    """Raise ConfigError for an invalid condition of a configuration."""
    with naming_key(f"{config.origin}, conditions"):
        for text in config.sections.get("conditions") or ():
            Condition.parse(text)


def with_conditions(config: ScoreConfig, limits: Limits | None) -> ScoreConfig:
    """Return the settings of a score with the conditions that only the limits name."""
    present = [Condition.parse(text).setting for text in config.trajectory.conditions]
    missing = [] if limits is None else [item for item in limits.conditions if item not in present]
    conditions = (*config.trajectory.conditions, *missing)
    return replace(config, trajectory=replace(config.trajectory, conditions=conditions))
