"""Commands that remove the causes of the findings of a recording."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

from sfr_loc_map.doctor.examination import examine
from sfr_loc_map.doctor.findings import Finding
from sfr_loc_map.doctor.observation import observe
from sfr_loc_map.errors import SfrError
from sfr_loc_map.source_setup.proposal import propose_config


def with_fix(
    source: Path, sections: dict[str, Any], path: Path | None, findings: list[Finding], words: list[str]
) -> list[Finding]:
    """Return the findings; if the proposed configuration removes one, its fix is the command that writes it (`words`).

    The source is examined with the proposed configuration to determine which findings remain.
    """
    try:
        found = propose_config(source, sections, path)
        remaining = {finding.cause for finding in examine(observe(source, found.config)) if finding.is_blocking}
    except SfrError:
        return findings
    command = shlex.join(words)
    fix = command
    added = {name: values for name, values in found.sections.items() if values != sections.get(name) and values}
    if added.keys() - {"conditions"} == {"topics"}:  # remapping is sufficient
        remaps = [word for name, topic in added["topics"].items() for word in ("--remap", f"{topic}:={name}")]
        fix += f"; for a single command: {shlex.join(remaps)}"
    missing = "".join(f"; still missing: {text}" for text in found.missing)
    is_removed = [finding.is_blocking and finding.cause not in remaining for finding in findings]
    return [
        replace(finding, fix=fix + missing, command=command) if removed else finding
        for finding, removed in zip(findings, is_removed, strict=True)
    ]
