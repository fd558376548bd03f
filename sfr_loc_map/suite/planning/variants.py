"""Variants of a scenario for an error budget: with all sources of error, with none, with one, and with all but one.

The drives of one seed share terrain, path and light in all variants, so differences are paired by seed. The
errors are evaluated in `suite/statistics/budget.py`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sfr_loc_map.configuration.parameters import build, flatten
from sfr_loc_map.configuration.yaml_file import entries_by_name
from sfr_loc_map.errors import ConfigError, naming_key
from sfr_loc_map.faults.kinds import parse_fault, with_amount
from sfr_loc_map.simulation.config import SimulationConfig

ALL, NONE, ONLY = "all sources", "no source", "only "  #: Names of two variants, and prefix of variants with one source.


@dataclass(frozen=True, slots=True)
class ErrorSource:
    """A source of error: an injected fault, or an error of the simulation that settings can disable."""

    name: str  #: Displayed name, such as `image noise`.
    without: Mapping[str, object] = field(default_factory=dict)  #: Settings that disable the source, by dotted name.
    fault: str = ""  #: The fault as for `--fault`; empty for an error of the simulation.
    sigma: float | None = None  #: Standard deviation of the fault's amount, which is drawn for each seed; None: fixed.

    def fault_of(self, seed: int) -> str:
        """Return the fault in all drives of one seed; empty if the source has no fault."""
        if self.sigma is None:
            return self.fault
        neutral = parse_fault(self.fault).kind.info.neutral
        assert neutral is not None, "parse_budget permits `sigma` only for faults with such an amount"
        draw = np.random.default_rng([seed, *self.name.encode()]).normal(neutral, self.sigma)
        return with_amount(self.fault, draw)


@dataclass(frozen=True, slots=True)
class Variant:
    """A scenario with a subset of its sources of error."""

    name: str  #: Unique name, as `variant_name` returns it.
    active: tuple[ErrorSource, ...]
    inactive: tuple[ErrorSource, ...]

    def settings(self, scenario: Mapping[str, object]) -> dict[str, object]:
        """Return the settings of the simulation."""
        without = {name: value for source in self.inactive for name, value in source.without.items()}
        return {**scenario, **without}

    def faults(self, seed: int) -> str:
        """Return the faults of the drive of one seed, joined by `+`."""
        return "+".join(text for source in self.active if (text := source.fault_of(seed)))


def variants_of(sources: Sequence[ErrorSource]) -> list[Variant]:
    """Return the variants without duplicates: all sources, none, each source alone, and all but each source."""
    names = [source.name for source in sources]
    alone = [{name} for name in names]
    all_but_one = [set(names) - {name} for name in names]
    variants: dict[str, Variant] = {}
    for active in [set(names), set(), *alone, *all_but_one]:
        name = variant_name(active, names)
        on = tuple(source for source in sources if source.name in active)
        off = tuple(source for source in sources if source.name not in active)
        variants[name] = Variant(name, on, off)
    return list(variants.values())


def variant_name(active: Collection[str], names: Sequence[str]) -> str:
    """Return the unique name of the variant with these active sources of error."""
    if len(active) == len(names):
        return ALL
    if not active:
        return NONE
    if len(active) == 1:
        return f"{ONLY}{next(iter(active))}"
    missing = next(name for name in names if name not in active)
    return f"without {missing}"


def parse_budget(content: object, origin: str) -> tuple[ErrorSource, ...]:
    """Return the sources of error in the key `budget` of a suite's file; raise ConfigError if it is invalid."""
    if not isinstance(content, Mapping) or len(content) < 2:
        raise ConfigError(
            f"{origin}: 'budget' requires at least two sources of error, each as NAME: {{fault: KIND}} or "
            "NAME: {without: {SETTING: VALUE}}"
        )
    entries = entries_by_name(content, f"{origin}: 'budget'")
    return tuple(_error_source(name, value, f"{origin}: budget: '{name}'") for name, value in entries.items())


def _error_source(name: str, value: object, origin: str) -> ErrorSource:
    keys = set(value) if isinstance(value, Mapping) else set()
    if not isinstance(value, Mapping) or keys not in ({"without"}, {"fault"}, {"fault", "sigma"}):
        raise ConfigError(
            f"{origin}: give either 'without' (the settings that switch this error off), or 'fault' (with "
            "'sigma' if the amount is random)"
        )
    if "without" in value:
        return ErrorSource(name, without=_settings(value["without"], origin))
    text, sigma = str(value["fault"]), value.get("sigma")
    with naming_key(origin):
        info = parse_fault(text).kind.info
    if sigma is None:
        return ErrorSource(name, fault=text)
    is_positive = isinstance(sigma, int | float) and not isinstance(sigma, bool) and 0.0 < sigma < np.inf
    if not is_positive or not (info.is_signed or info.neutral):
        raise ConfigError(
            f"{origin}: a positive number is required for 'sigma', which applies only to faults whose amount is a "
            "factor or can be negative"
        )
    with naming_key(origin):
        with_amount(text, 0.0)  # refuses an amount in the text
    return ErrorSource(name, fault=text, sigma=float(sigma))


def _settings(value: object, origin: str) -> dict[str, object]:
    known = flatten(SimulationConfig())
    if not isinstance(value, Mapping) or not value or not set(value) <= set(known):
        raise ConfigError(
            f"{origin}: 'without' requires a mapping of settings of a scenario, such as sensor.blur_px, to their "
            f"values without the error; found '{value}'"
        )
    build(SimulationConfig, {**known, **value}, origin=origin)
    return dict(value)


def error_sources_of(variants: Iterable[str]) -> list[str]:
    """Return the names of the sources of error of variants, in the order of the suite's file."""
    return [name.removeprefix(ONLY) for name in dict.fromkeys(variants) if name.startswith(ONLY)]
