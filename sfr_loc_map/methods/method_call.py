"""A call of a method under test, and why a call returned no valid result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from sfr_loc_map.errors import MethodError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.calls.call_meter import CallUsage
from sfr_loc_map.metrics.figures.records import FINDING_SEPARATOR, CallFinding, FindingKind


class MethodFailureError(MethodError):
    """A call returned no valid result; `kind` classifies the failure, `ended` is True if the process has ended."""

    def __init__(self, kind: FindingKind, text: str, *, ended: bool = False) -> None:
        super().__init__(text)
        self.kind, self.ended = kind, ended


class NotStartedAgainError(MethodFailureError):
    """A call was not made, because the method was started too often; the earlier failures are the findings."""

    def __init__(self) -> None:
        super().__init__(FindingKind.CRASHED, "not started again")


@dataclass(frozen=True, slots=True, eq=False)
class MethodCall:
    """Resource use, result and findings of one call of a method under test."""

    usage: CallUsage = field(default_factory=lambda: CallUsage(math.nan))  #: NaN if the call did not return.
    findings: tuple[CallFinding, ...] = ()  #: Faults of the method, first the fault that prevented a result.
    reason: str = ""  #: Why the pose is degraded or lost.
    statistics: Mapping[str, float] = field(default_factory=dict)
    covariance: FloatArray | None = None  #: `(6, 6)` covariance of the pose.
    step: FloatArray | None = None  #: `(48,)` uncertainty of the step.

    @property
    def finding(self) -> str:
        """The findings as one text, for the file of the calls."""
        return FINDING_SEPARATOR.join(map(str, self.findings))

    def failed(self, kind: FindingKind, text: str) -> MethodCall:
        """Return this call with the fault because of which it has no valid result."""
        return replace(self, findings=(CallFinding(kind, text), *self.findings), reason=kind.value)
