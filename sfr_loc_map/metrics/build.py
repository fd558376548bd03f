"""The score from its parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

from sfr_loc_map.metrics.calls.resource_score import ScoredCalls
from sfr_loc_map.metrics.cloud.cloud_error import ScoredMap
from sfr_loc_map.metrics.records.score_details import Details
from sfr_loc_map.metrics.score import (
    AlignedErrors,
    ConventionRecord,
    ExternalScore,
    FindingRecord,
    MemoryScore,
    MethodRecord,
    Provenance,
    Score,
    TargetScore,
)
from sfr_loc_map.metrics.trajectory.trajectory_score import ScoredTrajectory
from sfr_loc_map.metrics.verdicts.limits import Limits
from sfr_loc_map.metrics.verdicts.verdicts import verdicts


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreParts:
    """What a score is put together from; what is absent is None or empty.

    Attributes:
        trajectory: Of an estimate.
        aligned: Of an estimate, beside the figures of the specification.
        map: Of a cloud.
        calls: Of one or several sources of calls, on this host.
        target: Of calls measured elsewhere.
        warnings: One line for each.
        contradiction: Convention mismatch of estimate and truth.
        provenance: What it was made of.
        method: Whose figures these are.
        findings: What that method did wrong.
        external: How an external node behaved.
        convention: How the poses were converted.
    """

    trajectory: ScoredTrajectory | None = None
    aligned: AlignedErrors | None = None
    map: ScoredMap | None = None
    calls: Sequence[ScoredCalls] = ()
    target: TargetScore | None = None
    warnings: tuple[str, ...] = ()
    contradiction: str | None = None
    provenance: Provenance | None = None
    method: MethodRecord | None = None
    findings: tuple[FindingRecord, ...] = ()
    external: ExternalScore | None = None
    convention: ConventionRecord | None = None


def build_score(parts: ScoreParts, limits: Limits | None = None) -> Score:
    """Return the score with its verdicts.

    Args:
        parts: What it is put together from.
        limits: Limits to judge by.
    """
    calls = reduce(ScoredCalls.merged, parts.calls) if parts.calls else None
    score = Score(
        method=parts.method,
        findings=parts.findings,
        external=parts.external,
        convention=parts.convention,
        trajectory=None if parts.trajectory is None else parts.trajectory.score,
        aligned=parts.aligned,
        map=None if parts.map is None else parts.map.score,
        timing=calls.timing if calls is not None and any(calls.timing.kinds()) else None,
        memory=None if calls is None or calls.memory == MemoryScore() else calls.memory,
        target=parts.target,
        verdicts=(),
        warnings=parts.warnings,
        contradiction=parts.contradiction,
        provenance=parts.provenance,
        details=_details(parts, calls),
    )
    return score if limits is None else replace(score, verdicts=verdicts(limits, score))


def _details(parts: ScoreParts, calls: ScoredCalls | None) -> Details | None:
    details = Details(
        calls=None if calls is None else calls.details,
        trajectory=None if parts.trajectory is None else parts.trajectory.details,
        map=None if parts.map is None else parts.map.details,
    )
    return None if details == Details() else details
