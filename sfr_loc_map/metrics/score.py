"""The score: what `sfr score`, `sfr replay` and the monitor node say about a run, as values.

Numbers in brackets are clauses of the specification; docs/metrics.md has the rules in full. N is the start of a
sub-trajectory, N+x its end, n the number of sub-trajectories or values. None is a figure that is undefined (too few
values); a part that is absent is None as well, or empty. `metrics.score_json` writes and reads the JSON, in which every
field stands under its own name unless an annotation says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from sfr_loc_map.metrics.condition import Condition
from sfr_loc_map.metrics.modes import VerdictState
from sfr_loc_map.metrics.records.aligned_records import AlignedError, AlignedErrors, Alignment, ErrorStatistics
from sfr_loc_map.metrics.records.call_records import (
    CallScore,
    MemoryScore,
    PeakMemory,
    StageTime,
    TargetScore,
    TimingScore,
)
from sfr_loc_map.metrics.records.external_record import AnswerCounts, ConventionRecord, ExternalScore, ProcessUsage
from sfr_loc_map.metrics.records.json_records import Inline, Key
from sfr_loc_map.metrics.records.map_records import (
    DisparityStatistic,
    MapScore,
    PairScore,
    PointErrorScore,
    RangeScore,
    SigmaNees,
)
from sfr_loc_map.metrics.records.method_record import FindingRecord, MethodKind, MethodRecord
from sfr_loc_map.metrics.records.score_details import Details
from sfr_loc_map.metrics.records.statistic_records import Interval, IntervalStatistic, SampleStatistic, Statistic
from sfr_loc_map.metrics.records.trajectory_records import (
    AssociationCounts,
    AssociationScore,
    ConditionScore,
    DistanceScore,
    ErrorComponents,
    NeesPart,
    NeesScore,
    TrajectoryScore,
)

__all__ = [
    "AlignedError",
    "AlignedErrors",
    "Alignment",
    "AnswerCounts",
    "AssociationCounts",
    "AssociationScore",
    "CallScore",
    "ConditionScore",
    "ConventionRecord",
    "DisparityStatistic",
    "DistanceScore",
    "ErrorComponents",
    "ErrorStatistics",
    "ExternalScore",
    "FindingRecord",
    "InputFile",
    "Interval",
    "IntervalStatistic",
    "MapScore",
    "MemoryScore",
    "MethodKind",
    "MethodRecord",
    "NeesPart",
    "NeesScore",
    "PairScore",
    "PeakMemory",
    "PointErrorScore",
    "ProcessUsage",
    "Provenance",
    "RangeScore",
    "SampleStatistic",
    "Score",
    "SigmaNees",
    "StageTime",
    "Statistic",
    "TargetScore",
    "TimingScore",
    "TrajectoryScore",
    "Verdict",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The verdict on one limit.

    Attributes:
        metric: Name of the figure as in the limits file, after `target ` for one of the target.
        limit: Upper bound, of `coverage_min` the lower one, in the unit of the name.
        value: The figure, None where it is undefined.
        ci95: Its 95 % interval, None where it has none.
        condition: Condition of the sub-trajectories, None outside the trajectory.
        count: Number of values the figure is made of, None where it is not made of many.
        state: Pass if `|value| <= limit`, of `coverage_min` if `value >= limit`.
        certain: Whether the interval lies on one side of the limit, None where there is no interval.
    """

    metric: str
    limit: float
    value: float | None
    ci95: Interval | None
    condition: Condition | None = None
    count: int | None
    state: Annotated[VerdictState, Key("verdict")]
    certain: bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class InputFile:
    """An input of the score.

    Attributes:
        path: As given.
        sha256: Hash of the content.
        data_sha256: Of a truth the hash of its values, whatever file they were read from; None of other inputs.
    """

    path: str
    sha256: str
    data_sha256: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """What the score was made of.

    Attributes:
        version: Of this suite.
        inputs: Files by role.
        configuration: Settings in force.
        host: Machine, system and Python.
        time: When it was made, ISO 8601.
    """

    version: str
    inputs: Mapping[str, InputFile] = field(default_factory=dict)
    configuration: Mapping[str, object] = field(default_factory=dict)
    host: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """The whole score; parts that are absent are None or empty.

    Attributes:
        method: Whose figures these are; None where nobody has said so.
        findings: What that method did wrong, one for each kind.
        external: How an external node behaved; None where there was none.
        convention: How the poses were converted before they were scored; None where they were not.
        trajectory: Errors of the trajectory.
        aligned: Absolute and relative error (`ape`, `rpe`) of the trajectory; None where no alignment was asked for.
        map: Errors of the map.
        timing: Times of the calls on this host.
        memory: Memory of the calls on this host.
        target: Calls that were measured elsewhere.
        verdicts: One for each limit, in the order of the limits.
        warnings: One line for each.
        contradiction: The convention mismatch by which estimate and truth contradict each other, so that the figures
            of the trajectory judge nothing; None where there is none.
        provenance: What it was made of.
        details: What figures are drawn from.
    """

    method: MethodRecord | None = None
    findings: tuple[FindingRecord, ...] = ()
    external: ExternalScore | None = None
    convention: ConventionRecord | None = None
    trajectory: TrajectoryScore | None = None
    aligned: Annotated[AlignedErrors | None, Inline()] = None
    map: MapScore | None = None
    timing: TimingScore | None = None
    memory: MemoryScore | None = None
    target: TargetScore | None = None
    verdicts: tuple[Verdict, ...]
    warnings: tuple[str, ...] = ()
    contradiction: str | None = None
    provenance: Provenance | None = None
    details: Details | None = None

    @property
    def failed(self) -> tuple[Verdict, ...]:
        """The verdicts that are `fail`."""
        return tuple(item for item in self.verdicts if item.state is VerdictState.FAIL)
