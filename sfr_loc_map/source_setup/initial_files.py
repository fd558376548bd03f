"""The initial configuration and limits, which `sfr init` writes."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.atomic import write_text
from sfr_loc_map.config_yaml import to_yaml_lines
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.metrics.judging.limits_template import CONDITION, active_limits, is_edited, limits_text
from sfr_loc_map.source_setup.proposal import Proposal

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


def add_limits(proposal: Proposal, limits: Path) -> None:
    """Add a file of limits to a proposed configuration, and write the file unless the user has edited it."""
    is_kept = limits.exists() and is_edited(limits.read_text(encoding="utf-8", errors="replace"))
    proposal.sections["limits"] = limits.name
    proposal.reasons["limits"] = "the existing file is kept" if is_kept else "placeholders: replace them by your limits"
    if is_kept:
        return
    conditions = proposal.sections.get("conditions") or [CONDITION]
    active = active_limits(
        has_attitude=proposal.has_attitude is not False, has_height=proposal.has_height, has_tilt=proposal.has_tilt
    )
    write_text(limits_text(conditions[0], active), limits)
