"""Convert the poses of an external localiser to poses of RB in DS after a replay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sfr_loc_map.calls.call_poses import estimates_of
from sfr_loc_map.calls.call_record import CallRecord, bounded, is_covariance_reported
from sfr_loc_map.calls.growing_calls import stats_of
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.io.sequence import LocSequence, Source
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.conventions.pose_convention import converted_estimates
from sfr_loc_map.metrics.figures.records import ConventionRecord
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import symmetric
from sfr_loc_map.replay.result import ReplayResult
from sfr_loc_map.scoring.conversion import corrected
from sfr_loc_map.scoring.inputs import Correction, DriveToScore
from sfr_loc_map.suite_names import Task


def with_converted_poses(
    result: ReplayResult, source: Source, config: ScoreConfig, correction: Correction
) -> ReplayResult:
    """Return a result in which the poses of an external localiser, and their calls, are converted to RB in DS.

    Each pose requires a call, and a call may have no pose. A time offset moves the stamps of all these calls, so that
    each call keeps the stamp of its pose. A result without an external localiser is returned unchanged.
    """
    published = result.estimate
    run, loc = result.external, source.loc
    if run is None or run.task is not Task.LOCALISATION or loc is None or not len(published):
        return result
    calls = {call.stamp_ns: call for call in result.records if call.task is Task.LOCALISATION}
    estimates = estimates_of(published, stats_of([*calls.values()]))
    estimates, convention = _converted(estimates, loc, config, correction)
    rows = {stamp_ns: row for row, stamp_ns in enumerate(published.stamps_ns.tolist())}
    offset_ns = int(estimates.trajectory.stamps_ns[0] - published.stamps_ns[0])  # declared and diagnosed
    records = [_converted_call(call, estimates, rows.get(call.stamp_ns), offset_ns) for call in calls.values()]
    records += [call for call in result.records if call.task is Task.MAPPING]
    external = replace(run, as_published=published, convention=convention)
    return replace(result, estimate=estimates.trajectory, records=records, external=external)


def _converted(
    estimates: Estimates, loc: LocSequence, config: ScoreConfig, correction: Correction
) -> tuple[Estimates, ConventionRecord | None]:
    """Return converted estimates and the record of the conversion, None if nothing was converted.

    A diagnosis requires true poses.
    """
    truth = loc.ground_truth
    if truth is not None and len(truth):
        drive, convention = corrected(DriveToScore(estimates, truth, loc.rig), correction, config)
        return drive.estimates, convention
    declared = correction.declared
    if not declared.settings:
        return estimates, None
    converted = converted_estimates(estimates, declared, declared.T_rb_child(loc.rig), None)
    return converted, ConventionRecord(declared=declared.settings)


def _converted_call(call: CallRecord, estimates: Estimates, row: int | None, offset_ns: int) -> CallRecord:
    """Return a call with the converted covariance of its pose, `row` of the estimates; the row is None without a pose.

    The offset is added to the stamp. The step of the call is removed, because it is not converted.
    """
    call = replace(call, stamp_ns=call.stamp_ns + offset_ns, covariance=None, step=None)
    if row is None:
        return call
    state = TrackingState.LOST.value if estimates.lost[row] else call.state
    return replace(call, state=state, covariance=_full_covariance(estimates, row))


def _full_covariance(estimates: Estimates, row: int) -> FloatArray | None:
    """Return the covariance `(6, 6)` of a pose; None if unknown.

    The conversion can enlarge numbers. It can also give negative variances if the published matrix is not positive
    semi-definite; the covariance is then unknown.
    """
    if estimates.covariance is None or not np.isfinite(estimates.covariance[row]).all():
        return None
    if not is_covariance_reported(estimates.covariance[row][None]).all():
        return None
    return symmetric(bounded(estimates.covariance[row]))
