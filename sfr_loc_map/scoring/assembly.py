"""A score from the results of its subjects, with verdicts and warnings, for finished and live runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec.structs import replace as struct_replace

from sfr_loc_map.calls.call_stats import judged_method
from sfr_loc_map.configuration.parameters import flatten
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.figures.catalogue import ERRORS_BEYOND
from sfr_loc_map.metrics.figures.details import Details
from sfr_loc_map.metrics.figures.records import ConventionRecord, MethodRecord, Provenance
from sfr_loc_map.metrics.figures.results import CallsResult, MapResult, TrajectoryResult
from sfr_loc_map.metrics.judging.incomplete import incompleteness, text_of
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.score.caveats import copies_caveat, reading_caveats
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.scoring.inputs import Run

OUTSIDE_SHARE, OUTSIDE_S = 0.5, 0.2
"""A warning is given if the processor time of a method outside its calls exceeds both this fraction of its total
processor time and this number of seconds."""


def score_of_results(
    run: Run,
    trajectory: TrajectoryResult,
    surface: MapResult,
    calls: CallsResult,
    provenance: Provenance | None,
    config: ScoreConfig,
    limits: Limits | None,
) -> Score:
    """Return the score of the results of a run, with its verdicts and warnings.

    The settings of the score are added to the provenance, so that they have the same names in every score.
    """
    method = _method_of(run)
    details = Details(trajectory=trajectory.details, map=surface.details, calls=dict(calls.plots))
    score = Score(
        figures=(*trajectory.figures, *surface.figures, *calls.figures),
        association=trajectory.association,
        truth=trajectory.truth,
        provenance=_with_settings(provenance, config),
        alignment=trajectory.alignment,
        cloud=surface.cloud,
        calls=calls.records,
        target=calls.target,
        method=method,
        findings=(*run.item.findings, *(finding for item in run.all_calls for finding in item.findings)),
        processes=next((item.processes for item in run.stats if item.processes is not None), None),
        external=run.item.external,
        convention=run.convention,
        caveats=(*trajectory.caveats, *surface.caveats, *calls.caveats, *run.caveats, *_readable_files(method)),
        contradiction=trajectory.contradiction,
        errors=trajectory.errors,
        details=None if details == Details() else details,
    )
    judged = judged_by(score, limits, partial=config.trajectory.partial)
    of_results = (*trajectory.warnings, *surface.warnings, *calls.warnings)
    warnings = _warnings(judged, run, of_results, trajectory.unjudged)
    return struct_replace(judged, warnings=tuple(warnings))


def _with_settings(provenance: Provenance | None, config: ScoreConfig) -> Provenance | None:
    """Return a provenance whose configuration contains the settings of the score by dotted name.

    The values are those of JSON, so that a saved score equals the score that is read from its file.
    """
    if provenance is None:
        return None
    return struct_replace(provenance, configuration=to_plain({**provenance.configuration, **flatten(config)}))


def _warnings(judged: Score, run: Run, of_results: Sequence[str], unjudged: Sequence[str]) -> Iterator[str]:
    """Yield the warnings of a judged score: about its conversion, its results, its method and its verdicts.

    `unjudged` are the warnings about frames at which no judged sub-trajectory starts or ends. They are given only if a
    verdict is about these frames.
    """
    yield from _convention_warnings(judged.convention)
    yield from of_results
    yield from judged.caveats
    yield from filter(None, [copies_caveat(judged)])
    yield from _process_warnings(judged.method, run)
    yield from _partial_warnings(judged)
    yield from reading_caveats(judged)
    if any(item.figure == ERRORS_BEYOND for item in judged.verdicts):
        yield from unjudged


def _partial_warnings(score: Score) -> Iterator[str]:
    """Yield a warning about missing data if the score is judged only because of `--partial`."""
    if not score.active_rules.partial:
        return
    complete_only = struct_replace(score, rules=struct_replace(score.active_rules, partial=False))
    accepted = [item for item in incompleteness(complete_only) if item.kind.partial]
    if (text := text_of(accepted)) is not None:
        yield f"judged although data is missing (--partial): {text}"


def _convention_warnings(convention: ConventionRecord | None) -> Iterator[str]:
    if convention is not None and convention.diagnosed is not None:
        fitted = "; the conversion was fitted to the truth, so the figures are optimistic" if convention.fitted else ""
        yield f"--apply-diagnosis converted the estimate by {convention.diagnosed} before scoring it{fitted}"


def _method_of(run: Run) -> MethodRecord | None:
    """Return the method of a run; a method under test takes precedence over a built-in method."""
    return run.item.method or judged_method(item.method for item in run.all_calls if item.method is not None)


def _readable_files(method: MethodRecord | None) -> Iterator[str]:
    """Yield a caveat if the user permitted the method to read further files."""
    if method is not None and method.readable_files is not None:
        readable = f"SFR_METHOD_FILES, PYTHONPATH or LD_LIBRARY_PATH: {method.readable_files}"
        yield f"it is not verified that the files that {method.name} could read ({readable}) contain no ground truth"


def _process_warnings(method: MethodRecord | None, run: Run) -> Iterator[str]:
    """Yield warnings about the isolation of the method, and about its work between the calls."""
    if method is None:
        return
    if method.can_read_all_files:
        yield (
            f"method {method.name} was not isolated from files and may have read any of them (restrictions in force: "
            f"{method.isolation})"
        )
    for usage in (item.processes for item in run.stats if item.processes is not None):
        outside_s = usage.cpu_outside_s or 0.0
        if outside_s > max(OUTSIDE_SHARE * usage.cpu_s, OUTSIDE_S):
            yield (
                f"the method computes outside its calls: {outside_s:.3g} s of its {usage.cpu_s:.3g} s of processor "
                "time are not measured in a call"
            )
