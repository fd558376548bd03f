"""The files that `sfr init` writes: a configuration with all parameters, and limits to fill in."""

from __future__ import annotations

from collections.abc import Iterator

from sfr_loc_map.config import to_yaml_lines
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.limits import COVERAGE_MIN, NAMES, LimitPart

_ACTIVE = {
    "position_mean_plus_3sigma_m": ("0.1", "2 % of the distance"),
    "attitude_mean_plus_3sigma_deg": ("1.0", ""),
    "heading_mean_plus_3sigma_deg": ("1.0", ""),
}
_MEANING = {
    LimitPart.MAP: "of a map; a score without one then says: not enough data",
    LimitPart.TIMING: "time of a call on this host, which says nothing of a flight computer",
    LimitPart.MEMORY: "resident memory of the process during a call, on this host",
    LimitPart.TARGET: "calls that were measured on the target (--target, --target-timing)",
}
_EXAMPLES = {"_m": "0.5", "_deg": "1.0", "_s": "1.0", "_bytes": "2000000000"}


def configuration_text() -> str:
    """Return a configuration file of localiser and mapper with the defaults."""
    lines = [
        "# Parameters of localiser and mapper: [unit] (smallest .. largest), at their defaults. Change what you need,",
        "# delete what you do not: a parameter that is missing has its default. Taken by",
        "#   sfr localise SRC -o T.csv --config FILE, sfr map SRC -o C.ply --config FILE, sfr replay SRC --config FILE",
        "# The nodes have more: config/localisation.yaml, config/mapping.yaml and config/monitor.yaml of the package.",
    ]
    for name, config_type in (("localisation", LocalisationConfig), ("mapping", MappingConfig)):
        lines += ["", f"{name}:", *to_yaml_lines(config_type, "  ")]
    return "\n".join(lines) + "\n"


def limits_text() -> str:
    """Return a limits file: those of the trajectory in force, all others to be taken in."""
    lines = [
        "# Limits: PLACEHOLDERS, replace them by those of your own document. Upper bounds, except coverage_min; the",
        "# name of a figure ends in its unit. A line that begins with '#' is not in force. Taken by",
        "#   sfr score EST TRUTH --limits FILE, sfr replay SRC --limits FILE",
        "# Exit code 1 if one is missed, 3 if one cannot be judged.",
        "",
        "# Fewer values than this are not enough data for a verdict. (2 or more)",
        "minimum_count: 2",
        "",
        "# Errors at the end of sub-trajectories: one entry for each condition.",
        "trajectory:",
        "  # distance=METRES, time=SECONDS or frames=NUMBER",
        "  - condition: distance=5",
        *_figures(LimitPart.TRAJECTORY, "    "),
    ]
    for part, meaning in _MEANING.items():
        lines += ["", f"# {meaning[0].upper()}{meaning[1:]}.", f"# {part}:", *_figures(part, "  ", behind="# ")]
    return "\n".join(lines) + "\n"


def _figures(part: LimitPart, indent: str, behind: str = "") -> Iterator[str]:
    """Yield a line for each figure that a part limits; those that are not in force behind a '#'."""
    for name in NAMES[part]:
        value, why = _ACTIVE.get(name, (_example(name), "")) if part is LimitPart.TRAJECTORY else (_example(name), "")
        off = "" if part is LimitPart.TRAJECTORY and name in _ACTIVE else "# "
        start = f"{behind}{indent}" if behind else f"{indent}{off}"
        yield f"{start}{name}: {value}{f'  # {why}' if why else ''}"


def _example(name: str) -> str:
    if name == COVERAGE_MIN:
        return "0.8"
    return next(value for ending, value in _EXAMPLES.items() if name.endswith(ending))
