"""A fault that the campaign injects, and what is observed of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sfr_loc_map.fault_injection.harness import Harness


@dataclass(slots=True)
class Outcome:
    """What was observed of a fault; filled step by step.

    Attributes:
        observed: What happened, in words.
        lost: What data was lost, in words.
        recover_s: From the end of the fault (or the restart) to the first valid result, seconds; None where nothing
            had to recover.
        failures: What was not as expected; empty for a pass.
        figures: Numbers for the JSON report.
    """

    observed: list[str] = field(default_factory=list)
    lost: str = "nothing"
    recover_s: float | None = None
    failures: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)

    def expect(self, condition: object, text: str) -> None:
        """Record a failure with this text unless the condition holds."""
        if not condition:
            self.failures.append(text)

    def recovered(self, seconds: float, limit_s: float, what: str) -> None:
        """Record how long the recovery took, and compare it with its limit."""
        self.recover_s = max(self.recover_s or 0.0, seconds)
        self.expect(seconds <= limit_s, f"{what} took {seconds:.1f} s, the limit is {limit_s:g} s")


@dataclass(frozen=True, slots=True)
class Fault:
    """One row of the campaign.

    Attributes:
        name: Its name on the command line.
        fault: What is injected.
        expected: Expected outcome.
        run: Injects it by means of the harness and fills the outcome.
        arguments: ROS arguments of nodes beside the common ones, by node; faults with the same share their processes.
        own_mounts: Whether it mounts file systems and therefore runs in a mount namespace (Linux, root).
        prepare: Called with the folder of logs and saved files before the nodes start.
    """

    name: str
    fault: str
    expected: str
    run: Callable[[Harness, Outcome], None]
    arguments: Mapping[str, Sequence[str]] = field(default_factory=dict)
    own_mounts: bool = False
    prepare: Callable[[Path], None] | None = None
