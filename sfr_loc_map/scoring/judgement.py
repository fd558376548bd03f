"""Limits and conditions by which a run is judged, from options and the configuration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.errors import naming_key
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.judging.limits_file import load_limits
from sfr_loc_map.metrics.score.limits import Limits


@dataclass(frozen=True, slots=True)
class Judgement:
    """Limits and conditions by which a run is judged."""

    limits_file: Path | None
    limits: Limits | None  #: Content of the limits file; None without limits.
    conditions: Sequence[str] | None  #: Conditions of options or of the configuration; None for the default.

    @classmethod
    def of(cls, limits_file: Path | None, conditions: Sequence[str] | None, config: Configuration) -> Judgement:
        """Return the given limits and conditions, or else those of the configuration.

        ConfigError for invalid limits, and for an invalid condition of the configuration.
        """
        named, listed = config.sections.get("limits"), config.sections.get("conditions")
        check_conditions_of(config)
        if limits_file is None and named:
            limits_file = config.folder / named
        limits = None if limits_file is None else load_limits(limits_file)
        return cls(limits_file, limits, conditions or listed)

    @property
    def asked(self) -> tuple[Condition, ...]:
        """The conditions that the user named in options, in the configuration or in the limits."""
        of_limits = () if self.limits is None else self.limits.conditions
        return tuple(map(Condition.parse, (*(self.conditions or ()), *of_limits)))


def check_conditions_of(config: Configuration) -> None:
    """Raise ConfigError for an invalid condition of a configuration."""
    with naming_key(f"{config.origin}, conditions"):
        for text in config.sections.get("conditions") or ():
            Condition.parse(text)
