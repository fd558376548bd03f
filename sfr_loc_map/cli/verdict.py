"""The end of a command that judges: output of the score, and exit codes for verdicts and missing judgements."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sfr_loc_map.atomic import write_text
from sfr_loc_map.cli.output import STANDARD_OUTPUT, say, secondary_output, show, warn
from sfr_loc_map.errors import ConfigError, FailedVerdictError, NotJudgedError
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import VerdictState

if TYPE_CHECKING:
    from sfr_loc_map.calls.call_record import CallRecord
    from sfr_loc_map.geometry.trajectory import Trajectory
    from sfr_loc_map.metrics.figures.records import MethodRecord
    from sfr_loc_map.metrics.score.score import Score


NO_LIMITS = "the score was not judged by limits"


def present(score: Score, json_path: str | None, html: Path | None) -> None:
    """Write and print a score, its verdict and the first item to look at; raise ConfigError if the score is empty."""
    from sfr_loc_map.metrics.stored.score_json import to_dict
    from sfr_loc_map.report.page import write_page
    from sfr_loc_map.report.score_tables import summary_tables

    tables = summary_tables(score)
    if not tables and json_path != STANDARD_OUTPUT:
        raise ConfigError("nothing was scored: give an estimate and its truth")
    show(to_dict(score), json_path, tables)
    if json_path == STANDARD_OUTPUT:
        say_deviations([score], err=True)
    else:
        _say_verdict(score)
    if html is not None:
        with secondary_output():
            write_page(score, html)
    for finding in score.findings:
        warn(f"method {score.method.name if score.method else 'under test'}: {finding}")
    for warning in score.warnings:
        if warning != score.contradiction:  # raised as the error of the command
            warn(warning)


def _say_verdict(score: Score) -> None:
    """Print what was judged, the verdict, and the first item to look at."""
    from sfr_loc_map.report.summary import banner_of, look_first, run_facts

    if score.is_judged and score.contradiction is None:  # a contradiction is raised as the error of the command
        facts = dict(run_facts(score))
        judged = "; ".join(facts[name] for name in ("Drive", "Map") if name in facts)
        limits = None if score.provenance is None else score.provenance.inputs.get("limits")
        by = "" if limits is None else f"; by {limits.path}"
        say(f"judged: {judged}{by}")
        banner = banner_of(score)
        say(f"verdict: {banner.state}. {banner.text}")
    say_deviations([score])
    for item in look_first(score)[:1]:
        say(f"look at this first: {item.what}. {item.why}")


def say_deviations(scores: Sequence[Score], *, err: bool = False) -> None:
    """Print the deviations of judged scores that are not warnings, each once."""
    from sfr_loc_map.report.deviations import deviations_beside_warnings

    for text in dict.fromkeys(text for score in scores for text in deviations_beside_warnings(score)):
        say(f"deviation: {text}", err=err)


def write_junit(scores: Sequence[Score], path: Path) -> None:
    """Write the verdicts as JUnit XML; a score without limits, or a missing common verdict, is an error in the file."""
    from sfr_loc_map.metrics.judging.several_scores import common_verdict
    from sfr_loc_map.report.junit import junit

    named = {f"score {number}": score for number, score in enumerate(scores, 1)}
    judged = {name: score for name, score in named.items() if score.is_judged}
    unjudged = {name: NO_LIMITS for name in named if name not in judged}
    if not unjudged and (reason := common_verdict(scores).text):
        unjudged = {"all scores together": reason}
    write_text(junit(judged, unjudged), path)


def conclude(score: Score, asked: Collection[Condition], *, lenient: bool) -> None:
    """Raise the error that corresponds to a score, which has been written; `asked` are the requested conditions.

    Missed limits and failures of the method take precedence over limits that could not be judged. A contradiction of
    the conventions of estimate and truth is stated after a failure of the method.
    """
    from sfr_loc_map.metrics.judging.reasons import reasons_not_judged

    if score.missed:
        raise FailedVerdictError("; ".join(_failures_of(score)))
    # items without a judgement have no limit if the score passes, such as a requested condition that was never met
    is_pass = score.verdict is VerdictState.PASS
    not_judged(reasons_not_judged(score, asked), lenient=lenient or is_pass)


def _failures_of(score: Score) -> Iterator[str]:
    """Yield why a score fails: failures of the method, the contradiction, incomplete data, and missed limits."""
    from sfr_loc_map.metrics.judging.reasons import names_of_incomplete_scopes
    from sfr_loc_map.report.verdict_view import VerdictView

    if score.fatal_findings:
        yield f"the method failed: {', '.join(item.kind for item in score.fatal_findings)}"
    if score.contradiction is not None:
        yield f"not judged: {score.contradiction}"
    if score.incomplete is not None:
        yield f"incomplete data ({names_of_incomplete_scopes(score)})"
    views = [VerdictView.of(item) for item in score.on_limits if item.state is VerdictState.FAIL]
    if views:
        missed = "; ".join(f"{view.name}: {view.comparison}" for view in views)
        yield f"{len(views)} of {len(score.on_limits)} limits missed: {missed}"


def conclude_all(scores: Mapping[str, Score], *, requires_common_verdict: bool, lenient: bool) -> None:
    """Raise the error that corresponds to the verdicts of scores, by file; missed limits precede missing judgements.

    Scores without limits are ignored, unless a common verdict is required: they then count as not judged.
    """
    from sfr_loc_map.metrics.judging.reasons import reasons_not_judged
    from sfr_loc_map.metrics.judging.several_scores import common_verdict

    def text_of(name: str, reasons: Iterable[str]) -> str:
        text = "; ".join(reasons)
        return f"{name}: {text}" if len(scores) > 1 else text

    judged = {name: score for name, score in scores.items() if score.is_judged}
    failures = [text_of(name, _failures_of(score)) for name, score in judged.items() if score.missed]
    if failures:
        raise FailedVerdictError("; ".join(failures))
    reasons: list[str] = []
    for name, score in judged.items():
        if of_score := reasons_not_judged(score, ()):
            text = text_of(name, of_score)
            if score.verdict is VerdictState.PASS:
                not_judged([text], lenient=True)
            else:
                reasons.append(text)
    if requires_common_verdict:
        without = common_verdict([*scores.values()]).text or (NO_LIMITS if len(judged) < len(scores) else "")
        reasons += [without] if without else []
    not_judged(reasons, lenient=lenient)


def check_conditions(truth: Trajectory | None, conditions: Sequence[str], *, lenient: bool) -> None:
    """Check before the work starts that a drive reaches the conditions."""
    from sfr_loc_map.metrics.judging.reasons import conditions_beyond

    parsed = [Condition.parse(text) for text in conditions]
    if truth is not None:
        not_judged(conditions_beyond(truth, parsed), lenient=lenient)


def not_judged(reasons: Sequence[str], *, lenient: bool) -> None:
    """Raise NotJudgedError with the reasons why something could not be judged, if any; warn if `lenient`."""
    text = f"not judged: {'; '.join(reasons)}"
    if reasons and not lenient:
        raise NotJudgedError(f"{text} (exit 0 with --lenient)")
    if reasons:
        warn(text)


def conclude_findings(method: MethodRecord, records: Sequence[CallRecord]) -> None:
    """Report the findings on a method; raise FailedVerdictError if there are any. All outputs have been written."""
    from sfr_loc_map.calls.call_findings import findings_of

    found = findings_of((record.stamp_ns, record.finding) for record in records)
    for finding in found:
        warn(f"method {method.name}: {finding}")
    if found:
        kinds = ", ".join(finding.kind for finding in found)
        raise FailedVerdictError(f"method {method.name} {method.version}: {kinds}; its results are written")
