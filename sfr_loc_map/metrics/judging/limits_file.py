"""Reader of the limits file. docs/configuration.md describes the file. A key states figure, statistic and unit."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from msgspec.structs import asdict
from msgspec.structs import replace as struct_replace

from sfr_loc_map.configuration.parameters import suggestion
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import ConfigError, MetricsError
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.figures.catalogue import TOTAL
from sfr_loc_map.metrics.figures.subjects import LimitSection
from sfr_loc_map.metrics.score.limits import (
    BOUND,
    CERTAIN_BOUND,
    COUNT_FOR_VERDICT,
    DEFAULT_TERMS,
    INDEPENDENT_FOR_VERDICT,
    LIMITED_NUMBERS,
    OF_MAP,
    Limit,
    Limits,
    Population,
    Terms,
    fault_of_bound,
    fault_of_terms,
)

REQUIREMENT = {"id": str, "text": str, "certain": bool}  #: Keys of a requirement besides its limits.
TERMS = Terms.__struct_fields__  #: Additional keys of a limit on a tolerance bound.
NEEDED = {str: "a text in quotes is required", bool: "true or false is required"}
OTHER_SECTIONS = {
    name: LimitSection.MAP if limited.figure in OF_MAP else LimitSection.TRAJECTORY
    for name, limited in LIMITED_NUMBERS[LimitSection.COMPLETENESS].items()
}
"""Limits of completeness that are also accepted in another section of the file, with the name of this section."""


def load_limits(path: Path) -> Limits:
    """Read a limits file; ConfigError, of one line, if the file cannot be read or a key or value is invalid."""
    return parse_limits(load_yaml(path), str(path))


def parse_limits(content: Mapping[str, Any], origin: str) -> Limits:
    """Return the limits of a mapping in the form of the file; ConfigError, which names the origin, if it is invalid."""
    _check_keys(content, ("minimum_count", "minimum_independent", "data_set_sha256", *LimitSection), origin)
    minimum = content.get("minimum_count", COUNT_FOR_VERDICT)
    if not isinstance(minimum, int) or isinstance(minimum, bool) or not 2 <= minimum < 1e9:
        raise ConfigError(f"{origin}: 'minimum_count' is {minimum!r}: a whole number from 2 to below 1e9 is required")
    independent = content.get("minimum_independent", INDEPENDENT_FOR_VERDICT)
    if not isinstance(independent, int | float) or isinstance(independent, bool) or not 1 <= independent < 1e9:
        raise ConfigError(f"{origin}: 'minimum_independent' is {independent!r}: a number of at least 1 is required")
    hashes = _data_set_in(content, origin)
    entries = content.get("trajectory", [])
    if not isinstance(entries, list):
        raise ConfigError(
            f"{origin}: a list is required for 'trajectory', one entry per condition ('- condition: ...')"
        )
    limits: list[Limit] = []
    for number, entry in enumerate(entries, 1):
        entry_origin = f"{origin}: trajectory entry {number}"
        if not isinstance(entry, Mapping) or not isinstance(entry.get("condition"), str):
            raise ConfigError(
                f"{entry_origin}: 'condition', such as distance=5, and limits are required in the same entry"
            )
        try:
            condition = Condition.parse(entry["condition"]).setting
        except MetricsError as error:
            raise ConfigError(f"{entry_origin}: {error}") from error
        rest = {key: value for key, value in entry.items() if key != "condition"}
        of_entry = _limits_of(LimitSection.TRAJECTORY, rest, entry_origin, condition)
        if not of_entry:
            raise ConfigError(f"{entry_origin}: the condition {condition} has no limit: give a limit or omit the entry")
        limits += of_entry
    for section in LimitSection:
        if section is not LimitSection.TRAJECTORY:
            blocks = content.get(section, {})
            for block in blocks if isinstance(blocks, list) else [blocks]:
                limits += _limits_of(section, block, f"{origin}: '{section}'", None)
    if not limits:
        raise ConfigError(f"{origin}: no limit is given: give at least one under {', '.join(LimitSection)}")
    _check_unique(limits, origin)
    return Limits(
        limits=tuple(limits), minimum_count=minimum, minimum_independent=float(independent), data_set_sha256=hashes
    )


def _data_set_in(content: Mapping[str, Any], origin: str) -> tuple[str, ...]:
    """Return the hashes of the data set, in lower case; empty without the key. ConfigError if one is malformed."""
    if "data_set_sha256" not in content:
        return ()
    value = content["data_set_sha256"]
    needed = "a list of SHA-256 hashes, each of 64 hexadecimal digits, is required (sfr info SRC shows them)"
    if not isinstance(value, list) or not value:
        raise ConfigError(f"{origin}: 'data_set_sha256' is {value!r:.80}: {needed}")
    for item in value:
        if not isinstance(item, str) or re.fullmatch("[0-9a-fA-F]{64}", item) is None:
            raise ConfigError(f"{origin}: 'data_set_sha256' contains {item!r:.80}: {needed}")
    return tuple(item.lower() for item in value)


def _check_unique(limits: Sequence[Limit], origin: str) -> None:
    """Check that no two limits of a requirement differ only in their bound; ConfigError if they do."""
    bounds: dict[Limit, float] = {}
    for item in limits:
        bound = bounds.setdefault(struct_replace(item, limit=0.0, text=None, certain=False), item.limit)
        if bound != item.limit:
            over = "" if item.condition is None else f" over {item.condition}"
            raise ConfigError(
                f"{origin}: '{item.name}'{over} has two different limits, {bound:g} and {item.limit:g}: give one, or "
                "give each an 'id'"
            )


def _limits_of(section: LimitSection, block: object, origin: str, condition: str | None) -> list[Limit]:
    """Return the limits of a block of a section.

    `id` and `text` of the block apply to all its limits, and `certain` to all except tolerance bounds. An entry
    `{limit: ...}` of a limit can override them.
    """
    if not isinstance(block, Mapping):
        raise ConfigError(f"{origin} contains {block!r:.40}: limits as NAME: NUMBER are required")
    shares = [name for name, other in OTHER_SECTIONS.items() if other is section]
    _check_keys(block, (*LIMITED_NUMBERS[section], *shares, *REQUIREMENT), origin)
    of_all = {key: value for key, value in block.items() if key in REQUIREMENT}
    made = []
    for name, value in block.items():
        if name in REQUIREMENT:
            continue
        entry = value if isinstance(value, Mapping) else {"limit": value}
        if name in shares:
            made.append(_limit_of(LimitSection.COMPLETENESS, name, entry, of_all, origin, None))
        else:
            made.append(_limit_of(section, name, entry, of_all, origin, condition))
    if of_all and not made:
        named = ", ".join(f"{key} {value!r}" for key, value in of_all.items())
        raise ConfigError(f"{origin}: {named} has no limit, so nothing would be judged: give a limit or omit it")
    return made


def _limit_of(
    section: LimitSection,
    name: str,
    entry: Mapping[str, Any],
    of_all: Mapping[str, Any],
    origin: str,
    condition: str | None,
) -> Limit:
    """Return the limit of an entry of a block; `of_all` has the keys of the requirement that the block states."""
    limited = LIMITED_NUMBERS[section][name]
    where = f"{origin}: '{name}'"
    is_bound = limited.statistic == BOUND
    _check_keys(entry, ("limit", *REQUIREMENT, *(TERMS if is_bound else ())), where)
    stated = asdict(_terms_of_bound(entry, where)) if is_bound else {}
    requirement = _requirement_of({**of_all, **entry}, name, origin)
    if is_bound:
        requirement.pop("certain", None)  # `certain` of the block applies to the other limits
    bound: Any = entry.get("limit")
    if (fault := fault_of_bound(limited.figure, bound)) is not None:
        raise ConfigError(f"{where} {fault}")
    limit = Limit(section=section, name=name, limit=float(bound), condition=condition, **requirement, **stated)
    if limit.certain and not limit.can_be_certain:
        raise ConfigError(
            f"{where}: 'certain' requires a 95 % interval, which only limits NAME_{TOTAL}_UNIT of 'trajectory' have: "
            "give 'certain' to these limits"
        )
    return limit


def _terms_of_bound(entry: Mapping[str, Any], origin: str) -> Terms:
    """Return the terms of an entry for a tolerance bound; ConfigError, which names the origin, if they are invalid."""
    if "certain" in entry:
        raise ConfigError(f"{origin}: {CERTAIN_BOUND}")
    if "power" in entry and "good" not in entry:
        raise ConfigError(f"{origin}: 'power' is the power of the sequential test of 'good': give both, or neither")
    try:
        return terms_of(entry)
    except ConfigError as error:
        raise ConfigError(f"{origin}: {error}") from error


def _requirement_of(entry: Mapping[str, Any], name: str, origin: str) -> dict[str, Any]:
    """Return the keys of the requirement in an entry; ConfigError, which names the limit, if a type is wrong."""
    found = {key: entry[key] for key in REQUIREMENT if key in entry}
    if type(found.get("id")) is int:
        found["id"] = str(found["id"])
    for key, value in found.items():
        if not isinstance(value, REQUIREMENT[key]):
            raise ConfigError(f"{origin}: '{key}' of '{name}' is {value!r}: {NEEDED[REQUIREMENT[key]]}")
    return found


def _check_keys(block: Mapping[str, Any], known: Collection[str], origin: str) -> None:
    for key in block:
        if key not in known:
            raise ConfigError(f"{origin}: unknown key '{key}'{suggestion(str(key), known)}")


def terms_of(entry: Mapping[str, Any]) -> Terms:
    """Return the terms of an entry of a limits file, by default `DEFAULT_TERMS`; ConfigError if a term is invalid."""
    given = {name: entry[name] for name in TERMS if name in entry}
    if (fault := fault_of_terms(given)) is not None:
        raise ConfigError(fault)
    word = given.pop("interpretation", DEFAULT_TERMS.interpretation)
    return struct_replace(DEFAULT_TERMS, **given, interpretation=Population(word))
