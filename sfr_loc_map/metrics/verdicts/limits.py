"""Limits of a requirements file; `metrics.verdicts` judges by them.

The file is YAML. Every key names figure and unit; limits are upper bounds, except `coverage_min`. All parts are
optional; nothing is limited unless the file says so.

    minimum_count: 2                      # fewer values than this: "not enough data"
    trajectory:                           # a list: one entry for each condition
      - condition: distance=5
        position_mean_plus_3sigma_m: 0.1  # {position}_{mean,sigma,mean_plus_3sigma}_m
        attitude_mean_plus_3sigma_deg: 1  # {attitude,heading}_{mean,sigma,mean_plus_3sigma}_deg
    map:                                  # point_error_{mean,sigma,mean_plus_3sigma,p50,p95}_m, coverage_min
      coverage_min: 0.8
    timing:                               # {localisation,mapping,fusion}_{mean,mean_plus_3sigma,p50,p95,p99,max}_s
      localisation_p95_s: 0.5
    memory:                               # {localisation,mapping}_{peak,above_idle}_bytes
      mapping_peak_bytes: 1000000000
    target:                               # the keys of timing and memory, for calls measured on the target
      localisation_p95_s: 2.0
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sfr_loc_map.config import load_yaml
from sfr_loc_map.errors import ConfigError, MetricsError
from sfr_loc_map.metrics.condition import Condition
from sfr_loc_map.metrics.verdicts.limited_figures import (
    MAP_FIGURES,
    MEMORY_FIGURES,
    TIMING_FIGURES,
    TRAJECTORY_FIGURES,
    LimitPart,
)

NAMES: Mapping[LimitPart, Collection[str]] = {
    LimitPart.TRAJECTORY: TRAJECTORY_FIGURES,
    LimitPart.MAP: MAP_FIGURES,
    LimitPart.TIMING: TIMING_FIGURES,
    LimitPart.MEMORY: MEMORY_FIGURES,
    LimitPart.TARGET: [*TIMING_FIGURES, *MEMORY_FIGURES],
}
"""Names of the figures that each part of the file limits."""


@dataclass(frozen=True, slots=True)
class Limit:
    """One limit.

    Attributes:
        part: Part of the score.
        key: Its key in the file.
        limit: Bound in the unit of the key.
        condition: Condition of the sub-trajectories; None outside `trajectory`.
    """

    part: LimitPart
    key: str
    limit: float
    condition: Condition | None = None


@dataclass(frozen=True, slots=True)
class Limits:
    """All limits of a file.

    Attributes:
        limits: In the order of the file.
        minimum_count: Fewer values than this are not enough for a verdict.
    """

    limits: tuple[Limit, ...]
    minimum_count: int = 2

    @property
    def conditions(self) -> list[Condition]:
        """Conditions that are limited, each once."""
        return list(dict.fromkeys(item.condition for item in self.limits if item.condition is not None))


def load_limits(path: Path) -> Limits:
    """Read a limits file.

    Raises:
        ConfigError: If it cannot be read or a key or value is not valid; one line.
    """
    return parse_limits(load_yaml(path), str(path))


def parse_limits(content: Mapping[str, Any], origin: str) -> Limits:
    """Return the limits of a mapping as in the file.

    Args:
        content: The mapping.
        origin: Where it comes from, for messages.

    Raises:
        ConfigError: If a key or value is not valid.
    """
    _check_keys(content, ("minimum_count", *LimitPart), origin)
    minimum = content.get("minimum_count", 2)
    if not isinstance(minimum, int) or isinstance(minimum, bool) or minimum < 2:
        raise ConfigError(f"{origin}: 'minimum_count' is {minimum!r}: a whole number of at least 2 is needed")
    entries = content.get("trajectory", [])
    if not isinstance(entries, list):
        raise ConfigError(
            f"{origin}: 'trajectory' must be a list with one entry for each condition ('- condition: ...')"
        )
    limits: list[Limit] = []
    for number, entry in enumerate(entries, 1):
        limits += _trajectory_limits(entry, f"{origin}: trajectory entry {number}")
    for part in LimitPart:
        if part is not LimitPart.TRAJECTORY:
            limits += _limits_of(part, content.get(part, {}), f"{origin}: '{part}'", None)
    if not limits:
        raise ConfigError(f"{origin}: no limit in it: give at least one under {', '.join(LimitPart)}")
    return Limits(tuple(limits), minimum)


def _trajectory_limits(entry: object, origin: str) -> list[Limit]:
    if not isinstance(entry, Mapping) or not isinstance(entry.get("condition"), str):
        raise ConfigError(f"{origin}: needs 'condition', such as distance=5, and limits beside it")
    try:
        condition = Condition.parse(entry["condition"])
    except MetricsError as error:
        raise ConfigError(f"{origin}: {error}") from error
    rest = {key: value for key, value in entry.items() if key != "condition"}
    return _limits_of(LimitPart.TRAJECTORY, rest, origin, condition)


def _limits_of(part: LimitPart, block: object, origin: str, condition: Condition | None) -> list[Limit]:
    if not isinstance(block, Mapping):
        raise ConfigError(f"{origin}: a mapping of names to limits is needed, found {type(block).__name__}")
    _check_keys(block, NAMES[part], origin)
    for key, value in block.items():
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not 0 <= value < float("inf"):
            raise ConfigError(f"{origin}: '{key}' is {value!r}: a number >= 0 is needed, in the unit of its name")
    return [Limit(part, key, float(value), condition) for key, value in block.items()]


def _check_keys(block: Mapping[str, Any], known: Collection[str], origin: str) -> None:
    for key in block:
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(known)}"
            raise ConfigError(f"{origin}: unknown key '{key}' ({hint})")
