"""What subcommands share that run a method under test."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sfr_loc_map.cli.output import warn
from sfr_loc_map.errors import ConfigError, FailedVerdictError

if TYPE_CHECKING:
    from sfr_loc_map.methods.method import Method, MethodLimits, MethodTask
    from sfr_loc_map.metrics.method_record import MethodRecord
    from sfr_loc_map.pipeline.call_record import CallRecord

OURS = "sfr"
"""Name of the suite's own localiser and mapper, which run in the process of the command."""


def method_of(spec: str, task: MethodTask, config: Path | None) -> Method:
    """Return the method that `--method` names, with the text of `--config`.

    Raises:
        MethodError: If there is none.
        ConfigError: If the file cannot be read.
    """
    from sfr_loc_map.bounded_input import read_text
    from sfr_loc_map.methods.registry import EXTERNAL, find_method

    if spec == EXTERNAL:
        raise ConfigError("'--method external': a node of another program is scored by sfr replay SRC --external TASK")
    try:
        text = "" if config is None else read_text(config)
    except (OSError, ValueError) as error:
        raise ConfigError(f"'--config {config}' cannot be read ({error}): give a text file") from error
    return find_method(spec, task, text)


def method_limits(call_timeout_s: float, memory_mb: int) -> MethodLimits:
    """Return what a method may take.

    Raises:
        ConfigError: If an option is out of range.
    """
    from sfr_loc_map.config import build
    from sfr_loc_map.methods.method import MethodLimits

    values = {"call_timeout_s": call_timeout_s, "memory_mb": memory_mb}
    return build(MethodLimits, values, origin="'--call-timeout', '--memory-limit'")


def conclude_findings(method: MethodRecord, records: Sequence[CallRecord]) -> None:
    """Say what a method did wrong.

    Raises:
        FailedVerdictError: If it did anything wrong; all outputs are written.
    """
    from sfr_loc_map.pipeline.call_stats import findings_of

    found = findings_of([record.finding for record in records], [record.stamp_ns for record in records])
    for finding in found:
        warn(f"method {method.name}: {finding}")
    if found:
        kinds = ", ".join(finding.kind for finding in found)
        raise FailedVerdictError(f"method {method.name} {method.version}: {kinds}; what it gave is written")
