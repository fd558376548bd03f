"""The score of a finished run: the trajectory, the map, time and memory, and the verdicts on them."""

from __future__ import annotations

from collections.abc import Collection

from sfr_loc_map.metrics.config import AlignedErrorConfig, ScoreConfig
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.scoring.assembly import score_of_results
from sfr_loc_map.scoring.conversion import ConventionFinding, convention_mismatch, fitted_unit
from sfr_loc_map.scoring.inputs import Run, ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.provenance import provenance_of
from sfr_loc_map.scoring.results import calls_result, expected_calls, map_result, trajectory_result, with_aligned_errors


def score_files(inputs: ScoreInputs, config: ScoreConfig) -> Score:
    """Return the score of files. The errors are those of `load_run` and `score_run`."""
    return score_run(load_run(inputs), config)


def score_run(
    run: Run,
    config: ScoreConfig,
    limits: Limits | None = None,
    aligned: AlignedErrorConfig | None = None,
    kept_errors: Collection[tuple[str, str]] = (),
) -> Score:
    """Return the score of a run; with `aligned`, also APE and RPE.

    `config` has the conditions of `limits` (`judgement.with_conditions`). All errors are kept for `kept_errors`, and
    for the figures whose tolerance bound is limited. MetricsError if the figures cannot be computed, as
    `score_trajectory`, `score_map`, `score_target` and `aligned_errors` state. InputError if a file was changed while
    it was scored.
    """
    finding = _convention_finding(run, config)
    bounded = frozenset[tuple[str, str]]() if limits is None else limits.bounded_figures
    trajectory = trajectory_result(run, config.trajectory, finding, bounded.union(kept_errors))
    if aligned is not None and run.drive is not None:
        trajectory = with_aligned_errors(trajectory, run.drive, aligned)
    surface = map_result(run, config.map)
    calls = calls_result(run, expected_calls(run))
    provenance = provenance_of(run)  # at the end: refuses files that were changed while they were scored
    return score_of_results(run, trajectory, surface, calls, provenance, config, limits)


def _convention_finding(run: Run, config: ScoreConfig) -> ConventionFinding | None:
    """Return the problem with the convention of a run's poses; None if there is no problem.

    A problem may prevent a verdict. It is a declared factor that is not a unit of length, or the result of a diagnosis
    of all conventions.
    """
    if run.drive is None:
        return None
    finding = fitted_unit(run.convention)
    return convention_mismatch(run.drive, config) if finding is None else finding
