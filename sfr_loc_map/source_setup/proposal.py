"""Proposal of an `sfr.yaml`: each value with its reason, and the values that cannot be inferred."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.configuration.sections import Configuration, Key
from sfr_loc_map.configuration.yaml_file import yaml_text
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.io.source_config import SourceConfig, copied


class Value(NamedTuple):
    """An inferred value of an `sfr.yaml`."""

    key: Key
    value: object
    reason: str


class TruthComponents(NamedTuple):
    """Components of a pose that the ground truth has."""

    has_attitude: bool = True
    has_height: bool = True
    has_tilt: bool = True  #: Whether the poses have roll and pitch.


@dataclass(frozen=True, slots=True)
class Proposal:
    """An `sfr.yaml` with the reason for each value, the values that only the owner can add, and remarks."""

    source: Path
    configuration: Configuration  #: The sections with all values, and the path of the `sfr.yaml`, if it is known.
    reasons: Mapping[Key, str] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    truth: TruthComponents | None = None  #: Components of the ground truth; None without ground truth.

    def adding(
        self,
        *values: Value,
        missing: Iterable[str] = (),
        remarks: Iterable[str] = (),
        truth: TruthComponents | None = None,
    ) -> Proposal:
        """Return the proposal with further values and texts; a value that the proposal already has is kept.

        A value outside of the range of its parameter is reported as missing.
        """
        sections = copied(self.sections)
        reasons = dict(self.reasons)
        refused: list[str] = []
        for key, value, reason in values:
            if key.value_in(sections) is not None:
                continue
            if problem := _problem_of(key, value):
                refused.append(f"{problem} ({reason})")
                continue
            key.put(value, sections)
            reasons[key] = reason
        return replace(
            self,
            configuration=replace(self.configuration, sections=sections),
            reasons=reasons,
            missing=(*self.missing, *missing, *refused),
            remarks=(*self.remarks, *remarks),
            truth=truth or self.truth,
        )

    @property
    def sections(self) -> Mapping[str, Any]:
        """The sections with all values."""
        return self.configuration.sections

    @property
    def config(self) -> SourceConfig:
        """How the source is read with the proposal."""
        return SourceConfig.of(self.configuration)

    def text(self) -> str:
        """Return the proposal as `sfr.yaml`, each value with its reason."""
        lines = [f"# How every command and node reads '{self.source}': docs/configuration.md."]
        lines += [f"# MISSING: {text}" for text in self.missing] + [f"# {text}" for text in self.remarks]
        for section, values in self.sections.items():
            if not isinstance(values, Mapping):
                lines.append(f"{section}: {yaml_text(values)}  # {self.reasons.get(Key(section), 'given')}")
            elif values:
                lines.append(f"{section}:")
                for name, value in values.items():
                    reason = self.reasons.get(Key(section, name), "given")
                    lines.append(f"  {name}: {yaml_text(value)}  # {reason}")
        return "\n".join(lines) + "\n"


def _problem_of(key: Key, value: object) -> str:
    """Return why the parameter with a key cannot have a value; empty for a valid value or a key of no parameter."""
    config_type = get_type_hints(SourceConfig).get(key.section)
    if not isinstance(config_type, type) or not is_dataclass(config_type):
        return ""
    try:
        build(config_type, {key.name: value}, origin=key.section)
    except ConfigError as error:
        return str(error)
    return ""
