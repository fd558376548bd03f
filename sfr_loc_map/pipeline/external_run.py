"""A replay with an external node: its poses converted, its answers as the rows of the statistics of calls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.association import UPPER, Estimates, lost_by_covariance
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.convention import converted_estimates
from sfr_loc_map.metrics.method_record import FindingRecord, MethodRecord
from sfr_loc_map.metrics.score import ConventionRecord, ExternalScore
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.scoring import Correction, ScoredDrive, corrected


@dataclass(frozen=True, slots=True, eq=False)
class ExternalRun:
    """What is known of an external node after a replay.

    Attributes:
        method: Its name and version.
        score: How it behaved.
        findings: What was wrong with its answers.
        correction: How its poses are converted.
        log: What its process wrote; empty where it was not started here.
        as_published: Its poses as it published them.
        convention: How they have been converted; None where they have not.
    """

    method: MethodRecord
    score: ExternalScore
    findings: tuple[FindingRecord, ...]
    correction: Correction
    log: str = ""
    as_published: Trajectory | None = None
    convention: ConventionRecord | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What the source knows of a drive.

    Attributes:
        rig: The stereo rig, None where it is not known.
        truth: True poses, None where it has none.
    """

    rig: StereoRig | None
    truth: Trajectory | None


def converted_run(
    estimate: Trajectory, records: Sequence[CallRecord], run: ExternalRun, drive: Drive, config: ScoreConfig
) -> tuple[Trajectory, list[CallRecord], ExternalRun]:
    """Return the poses of an external localiser as poses of RB in DS, a record for each, and what was done.

    Args:
        estimate: Poses as published.
        records: What the node told of its calls, with the covariances of its poses; those of mapping stay as they are.
        run: What is known of it.
        drive: What the source knows.
        config: Settings of the diagnosis.

    Raises:
        ConfigError: If a frame is declared that the rig does not tell.
        MetricsError: If the world frame cannot be aligned.
    """
    if not len(estimate):
        return estimate, list(records), run
    told = {item.stamp_ns: item for item in records if item.state in set(TrackingState)}
    covariance = np.full((len(estimate), len(UPPER[0])), np.nan)
    for row, stamp_ns in enumerate(estimate.stamps_ns.tolist()):
        known = told.get(stamp_ns)
        if known is not None and known.covariance is not None:
            covariance[row] = known.covariance[UPPER]
    lost = lost_by_covariance(covariance)
    given = Estimates.of(estimate, lost, covariance=None if np.isnan(covariance).all() else covariance)
    found, convention = _converted(given, run.correction, drive, config)
    rows = [
        _record(
            told.get(before), stamp_ns, bool(lost[row]), None if found.covariance is None else found.covariance[row]
        )
        for row, (before, stamp_ns) in enumerate(
            zip(estimate.stamps_ns.tolist(), found.trajectory.stamps_ns.tolist(), strict=True)
        )
    ]
    others = [item for item in records if item.state not in set(TrackingState)]
    return found.trajectory, [*rows, *others], replace(run, as_published=estimate, convention=convention)


def _converted(
    given: Estimates, correction: Correction, drive: Drive, config: ScoreConfig
) -> tuple[Estimates, ConventionRecord | None]:
    if drive.truth is not None and len(drive.truth):
        scored, convention = corrected(ScoredDrive(given, drive.truth, drive.rig), correction, config)
        return scored.estimates, convention
    declared = correction.declared
    if not declared.settings:
        return given, None
    found = converted_estimates(given, declared, declared.T_rb_child(drive.rig), None)
    return found, ConventionRecord(declared=declared.settings)


def _record(told: CallRecord | None, stamp_ns: int, lost: bool, covariance: Any) -> CallRecord:  # noqa: ANN401
    """Return the record of one pose; its time is NaN where the node told none."""
    record = told or CallRecord(stamp_ns, float("nan"), TrackingState.TRACKING, None, None)
    full = None
    if covariance is not None and np.isfinite(covariance).all():
        full = np.zeros((6, 6))
        full[UPPER] = full[UPPER[1], UPPER[0]] = covariance
    state = TrackingState.LOST.value if lost else record.state
    return replace(record, stamp_ns=stamp_ns, state=state, covariance=full, step=None)
