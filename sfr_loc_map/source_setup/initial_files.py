"""The initial configuration and limits, which `sfr init` writes."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.configuration.yaml_file import to_yaml_lines
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.judging.limits_template import CONDITION, active_limits, is_edited, limits_text
from sfr_loc_map.source_setup.proposal import Proposal, TruthComponents

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


def is_kept(path: Path) -> bool:
    """Return whether a limits file exists that differs from the files of `sfr init`, and is therefore not replaced."""
    return path.is_file() and is_edited(path.read_text(encoding="utf-8", errors="replace"))


def initial_limits(proposal: Proposal) -> str:
    """Return the text of a limits file for a recording: placeholders for what its ground truth can judge."""
    conditions = proposal.sections.get("conditions") or [CONDITION]
    truth = proposal.truth or TruthComponents()
    active = active_limits(has_attitude=truth.has_attitude, has_height=truth.has_height, has_tilt=truth.has_tilt)
    return limits_text(conditions[0], active)
