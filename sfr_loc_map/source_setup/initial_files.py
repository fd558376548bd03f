"""The initial configuration and limits, which `sfr init` writes."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.configuration.sections import Key
from sfr_loc_map.configuration.yaml_file import to_yaml_lines
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.judging.limits_template import CONDITION, active_limits, is_edited, limits_text
from sfr_loc_map.source_setup.proposal import Proposal, TruthComponents, Value

HEAD = """\
# Parameters of the localiser and the mapper with [unit] (smallest .. largest), at their defaults. Change what you
# need and delete the rest: a missing parameter has its default. The commands that accept this file:
#   sfr localise SRC -o T.csv --config FILE, sfr map SRC -o C.ply --config FILE, sfr replay SRC --config FILE
# The nodes have more parameters: config/localisation.yaml, config/mapping.yaml and config/monitor.yaml of the package.
"""


def configuration_text() -> str:
    """Return the parameters of localiser and mapper at their defaults, each with its description."""
    lines = []
    for name, config_type in (("localisation", LocalisationConfig), ("mapping", MappingConfig)):
        lines += ["", f"{name}:", *to_yaml_lines(config_type, "  ")]
    return HEAD + "\n".join(lines) + "\n"


def initial_limits(proposal: Proposal, path: Path) -> tuple[Value, str | None]:
    """Return the value of a proposal that names the file of limits `path`, and the text of this file.

    The text is None if the user has edited an existing file, which is then kept.
    """
    if path.exists() and is_edited(path.read_text(encoding="utf-8", errors="replace")):
        return Value(Key("limits"), path.name, "the existing file is kept"), None
    conditions = proposal.sections.get("conditions") or [CONDITION]
    truth = proposal.truth or TruthComponents()
    active = active_limits(has_attitude=truth.has_attitude, has_height=truth.has_height, has_tilt=truth.has_tilt)
    text = limits_text(conditions[0], active)
    return Value(Key("limits"), path.name, "placeholders: replace them by your limits"), text
