"""Limits of a requirements file and the verdicts on them.

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

STATISTICS = ("mean", "sigma", "mean_plus_3sigma")
PASS, FAIL, NOT_ENOUGH = "pass", "fail", "not enough data"

Place = tuple[str, ...]


def _keys(prefixes: Mapping[str, Place], statistics: Collection[str], unit: str) -> dict[str, Place]:
    return {f"{name}_{s}_{unit}": (*place, s) for name, place in prefixes.items() for s in statistics}


TRAJECTORY_KEYS = _keys({"position": ("position_m",)}, STATISTICS, "m") | _keys(
    {"attitude": ("attitude_deg",), "heading": ("heading_deg",)}, STATISTICS, "deg"
)
MAP_KEYS = _keys({"point_error": ("point_error_m",)}, (*STATISTICS, "p50", "p95"), "m") | {
    "coverage_min": ("coverage",)
}
TIMING_KEYS = _keys(
    {name: (f"{name}_s",) for name in ("localisation", "mapping", "fusion")},
    ("mean", "mean_plus_3sigma", "p50", "p95", "p99", "max"),
    "s",
)
MEMORY_KEYS: dict[str, Place] = {
    f"{name}_{kind}_bytes": (f"{name}_{kind}_bytes",)
    for name in ("localisation", "mapping")
    for kind in ("peak", "above_idle")
}
TARGET_KEYS: dict[str, Place] = {key: ("timing", *place) for key, place in TIMING_KEYS.items()}
TARGET_KEYS |= {key: ("memory", *place) for key, place in MEMORY_KEYS.items()}
PARTS: dict[str, dict[str, Place]] = {
    "map": MAP_KEYS,
    "timing": TIMING_KEYS,
    "memory": MEMORY_KEYS,
    "target": TARGET_KEYS,
}


@dataclass(frozen=True, slots=True)
class Limit:
    """One limit.

    Attributes:
        part: `trajectory`, `map`, `timing`, `memory` or `target`.
        key: Its key in the file.
        limit: Bound in the unit of the key.
        condition: Condition of the sub-trajectories; None outside `trajectory`.
    """

    part: str
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
    _check_keys(content, ("minimum_count", "trajectory", *PARTS), origin)
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
    for part, known in PARTS.items():
        block = content.get(part, {})
        limits += _limits_of(part, block, known, f"{origin}: '{part}'", None)
    if not limits:
        raise ConfigError(f"{origin}: no limit in it: give at least one under trajectory, {', '.join(PARTS)}")
    return Limits(tuple(limits), minimum)


def _trajectory_limits(entry: object, origin: str) -> list[Limit]:
    if not isinstance(entry, Mapping) or not isinstance(entry.get("condition"), str):
        raise ConfigError(f"{origin}: needs 'condition', such as distance=5, and limits beside it")
    try:
        condition = Condition.parse(entry["condition"])
    except MetricsError as error:
        raise ConfigError(f"{origin}: {error}") from error
    rest = {key: value for key, value in entry.items() if key != "condition"}
    return _limits_of("trajectory", rest, TRAJECTORY_KEYS, origin, condition)


def _limits_of(
    part: str, block: object, known: Collection[str], origin: str, condition: Condition | None
) -> list[Limit]:
    if not isinstance(block, Mapping):
        raise ConfigError(f"{origin}: a mapping of names to limits is needed, found {type(block).__name__}")
    _check_keys(block, known, origin)
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


def verdicts(limits: Limits, score: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the verdict on each limit: pass, fail, or not enough data.

    A figure passes at its limit; a mean of a signed figure (heading) is taken without its sign. `certain` tells
    whether the 95 % interval lies on one side of the limit, None where there is no interval.

    Args:
        limits: Limits.
        score: Score as in the JSON.
    """
    return [_verdict(limit, limits.minimum_count, score) for limit in limits.limits]


def _verdict(limit: Limit, minimum: int, score: Mapping[str, Any]) -> dict[str, Any]:
    block, place = _block_of(limit, score)
    value, count, interval = _look_up(block, place)
    metric = f"target {limit.key}" if limit.part == "target" else limit.key
    head: dict[str, Any] = {"metric": metric, "limit": limit.limit, "value": value, "ci95": interval}
    if limit.condition is not None:
        head["condition"] = limit.condition.to_plain()
    head |= {"count": count, "verdict": NOT_ENOUGH, "certain": None}
    if value is None or (count is not None and count < minimum):
        return head
    if limit.key == "coverage_min":
        return head | {"verdict": PASS if value >= limit.limit else FAIL}
    certain = None if interval is None else not interval[0] <= limit.limit < interval[1]
    return head | {"verdict": PASS if abs(value) <= limit.limit else FAIL, "certain": certain}


def _block_of(limit: Limit, score: Mapping[str, Any]) -> tuple[Mapping[str, Any], Place]:
    block = score.get(limit.part, {})
    if limit.condition is None:
        return block, PARTS[limit.part][limit.key]
    for part in [block, *block.get("conditions", [])]:
        if part.get("condition") == limit.condition.to_plain():
            return part, TRAJECTORY_KEYS[limit.key]
    return {}, TRAJECTORY_KEYS[limit.key]


def _look_up(block: Mapping[str, Any], place: Place) -> tuple[float | None, int | None, list[float] | None]:
    """Return the figure, the number of values it is made of, and its interval."""
    figure: Any = block
    for key in place[:-1]:
        figure = figure.get(key, {})
    value = figure.get(place[-1])
    count = figure.get("count", block.get("count"))
    return value, count, figure.get(f"{place[-1]}_ci95")
