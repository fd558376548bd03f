"""The results of the trajectory, the map and the calls, of which a score consists.

`trajectory.trajectory_score`, `map.map_score` and `calls.call_score` compute them, `scoring.results` adds
warnings, and `scoring.assembly` combines them into a score. A result has no figures if the run has no such data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sfr_loc_map.metrics.figures.details import CallPlots, ErrorRows, MapDetails, TrajectoryDetails
from sfr_loc_map.metrics.figures.records import Alignment, Association, CallRecords, CloudRecord, TargetRun, TruthRecord
from sfr_loc_map.metrics.figures.rows import Figure


@dataclass(frozen=True, slots=True, kw_only=True)
class SubjectResult:
    """The rows, the warnings and the caveats of one subject."""

    figures: tuple[Figure, ...] = ()
    warnings: tuple[str, ...] = ()
    caveats: tuple[str, ...] = ()  #: Further warnings, which are also deviations.


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryResult(SubjectResult):
    """The result of the trajectory."""

    association: Association | None = None  #: None without estimates.
    truth: TruthRecord | None = None  #: None without estimates.
    alignment: Alignment | None = None  #: How APE and RPE were computed; None if they were not requested.
    contradiction: str | None = None  #: Convention mismatch of estimate and truth; None if there is none.
    unjudged: tuple[str, ...] = ()  #: Warnings about unjudged frames (`other frames`) with far larger errors.
    errors: tuple[ErrorRows, ...] = ()  #: All errors of the figures whose tolerance bound is limited.
    details: TrajectoryDetails | None = None  #: Data of the plots; with the frames only if they are requested.


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoredTrajectory(TrajectoryResult):
    """The result of a trajectory with estimates and a truth. All its records are therefore known."""

    association: Association
    truth: TruthRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class MapResult(SubjectResult):
    """The result of the map."""

    cloud: CloudRecord | None = None  #: How the cloud was compared with the ground truth; None without a cloud.
    details: MapDetails | None = None  #: Data of the plots; None if the pixels of the points are unknown.


@dataclass(frozen=True, slots=True, kw_only=True)
class CallsResult(SubjectResult):
    """The result of the calls."""

    records: CallRecords | None = None  #: How times and memory were measured; None without calls on this host.
    plots: Mapping[str, CallPlots] = field(default_factory=dict)  #: Data of the plots by kind of call, if requested.
    target: TargetRun | None = None  #: The target on which calls were measured; None without a target.
