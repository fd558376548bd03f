"""Commands that remove the causes of the issues of a recording."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

from sfr_loc_map.configuration.sections import Configuration
from sfr_loc_map.doctor.examination import examine
from sfr_loc_map.doctor.observation import observe
from sfr_loc_map.errors import SfrError
from sfr_loc_map.issues import Cause, Issue
from sfr_loc_map.source_setup.examination import propose_config


def with_fix(source: Path, given: Configuration, issues: list[Issue], words: list[str]) -> list[Issue]:
    """Return the issues, with the command `words` as the fix of each issue that the proposed configuration removes.

    The command writes this configuration. The source is examined with the configuration to determine which issues
    remain.
    """
    try:
        proposal = propose_config(source, given)
        remaining = [issue for issue in examine(observe(source, proposal.config)) if issue.is_blocking]
    except SfrError:
        return issues
    command = shlex.join(words)
    fix = command
    added = {
        name: values for name, values in proposal.sections.items() if values != given.sections.get(name) and values
    }
    if added.keys() - {"conditions"} == {"topics"}:  # remapping is sufficient
        remaps = [word for name, topic in added["topics"].items() for word in ("--remap", f"{topic}:={name}")]
        fix += f"; for a single command: {shlex.join(remaps)}"
    missing = "".join(f"; still missing: {text}" for text in proposal.missing)
    causes = {(issue.cause, issue.where) for issue in remaining}
    if "topics" not in added:  # a source that is still unreadable still has its issues
        broken = {issue.where for issue in remaining if issue.cause is Cause.BROKEN}
        causes |= {(issue.cause, issue.where) for issue in issues if issue.where in broken}
    is_removed = [issue.is_blocking and (issue.cause, issue.where) not in causes for issue in issues]
    return [
        replace(issue, fix=fix + missing, command=command) if removed else issue
        for issue, removed in zip(issues, is_removed, strict=True)
    ]
