"""The score of the parts of a run, without verdicts."""

from __future__ import annotations

from sfr_loc_map.metrics.figures.details import Details
from sfr_loc_map.metrics.figures.results import CallsResult, MapResult, TrajectoryResult
from sfr_loc_map.metrics.score.score import Score


def score_of_results(
    trajectory: TrajectoryResult, cloud: MapResult | None = None, calls: CallsResult | None = None
) -> Score:
    """Return the score of the results of a trajectory, a map and calls, with their rows and records.

    `metrics.judging.judge.judged_by` adds the verdicts. The warnings of the results are not included.
    """
    cloud = MapResult() if cloud is None else cloud
    calls = CallsResult() if calls is None else calls
    details = Details(trajectory=trajectory.details, map=cloud.details, calls=dict(calls.plots))
    return Score(
        figures=(*trajectory.figures, *cloud.figures, *calls.figures),
        association=trajectory.association,
        truth=trajectory.truth,
        alignment=trajectory.alignment,
        cloud=cloud.cloud,
        calls=calls.records,
        target=calls.target,
        contradiction=trajectory.contradiction,
        errors=trajectory.errors,
        details=None if details == Details() else details,
    )
