"""Assembly of a score from its parts, with verdicts and warnings, for finished and live runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from msgspec.structs import replace as struct_replace

from sfr_loc_map.calls.call_stats import method_under_test
from sfr_loc_map.configuration.parameters import flatten
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.figures.catalogue import ERRORS_BEYOND
from sfr_loc_map.metrics.figures.records import ConventionRecord, MethodRecord, Provenance
from sfr_loc_map.metrics.judging.incomplete import incompleteness, text_of
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.score.caveats import reading_caveats
from sfr_loc_map.metrics.score.joined_parts import score_of_results
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.scoring.inputs import Run
from sfr_loc_map.scoring.score_parts import ScoreParts

OUTSIDE_SHARE, OUTSIDE_S = 0.5, 0.2
"""A warning is given if the processor time of a method outside its calls exceeds both this fraction of its total
processor time and this number of seconds."""


def with_conditions(config: ScoreConfig, limits: Limits | None) -> ScoreConfig:
    """Return the settings extended by the conditions that only the limits name."""
    present = [Condition.parse(text).setting for text in config.trajectory.conditions]
    missing = [] if limits is None else [item for item in limits.conditions if item not in present]
    conditions = (*config.trajectory.conditions, *missing)
    return replace(config, trajectory=replace(config.trajectory, conditions=conditions))


def score_of_parts(
    run: Run, parts: ScoreParts, provenance: Provenance | None, config: ScoreConfig, limits: Limits | None
) -> Score:
    """Return the score of the parts of a run, with its verdicts and warnings.

    The settings of the score are added to the provenance, so that they have the same names in every score.
    """
    trajectory, surface, calls = parts
    score = struct_replace(
        score_of_results(trajectory, surface, calls),
        provenance=_with_settings(provenance, config),
        method=_method_of(run),
        findings=(*run.item.findings, *(finding for item in run.all_calls for finding in item.findings)),
        processes=next((item.processes for item in run.stats if item.processes is not None), None),
        external=run.item.external,
        convention=run.convention,
    )
    judged = judged_by(score, limits, partial=config.trajectory.partial)
    of_method = _readable_files(judged.method)
    caveats = (*trajectory.caveats, *surface.caveats, *calls.caveats, *run.caveats, *of_method)
    warnings = _warnings(judged, run, parts, caveats)
    return struct_replace(judged, warnings=tuple(warnings), caveats=caveats)


def _with_settings(provenance: Provenance | None, config: ScoreConfig) -> Provenance | None:
    """Return a provenance whose configuration contains the settings of the score by dotted name.

    The values are those of JSON, so that a saved score equals the score that is read from its file.
    """
    if provenance is None:
        return None
    return struct_replace(provenance, configuration=to_plain({**provenance.configuration, **flatten(config)}))


def _warnings(judged: Score, run: Run, parts: ScoreParts, caveats: Sequence[str]) -> Iterator[str]:
    """Yield the warnings of a judged score: about its conversion, its parts, its method and its verdicts."""
    yield from _convention_warnings(judged.convention)
    for part in parts:
        yield from part.warnings
    yield from caveats
    yield from _process_warnings(judged.method, run)
    yield from _partial_warnings(judged)
    yield from reading_caveats(judged)
    if any(item.figure == ERRORS_BEYOND for item in judged.verdicts):
        yield from parts.trajectory.unjudged


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
    return run.item.method or method_under_test(item.method for item in run.all_calls if item.method is not None)


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
