"""The test report for signature, made only from scores, in the order of a verification report.

The order is that of the verification report of ECSS-E-ST-10-02C: item, documents, procedure, data, results,
additional evidence (if there is any), deviations, anomalies, open points, signatures.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.catalogue import CLAUSES, OF_SUB_TRAJECTORIES, STANDARD_DEVIATION
from sfr_loc_map.metrics.figures.records import MethodKind, Provenance, TargetRecord
from sfr_loc_map.metrics.judging.several_scores import Common, common_verdict
from sfr_loc_map.metrics.score.caveats import caveats_of
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.deviations import deviations_of
from sfr_loc_map.report.notes import NO_INTERVAL
from sfr_loc_map.report.page import from_template
from sfr_loc_map.report.printed_plot import DRAWING, PrintedPlot, printed_plots
from sfr_loc_map.report.score_tables import HEADLINE, READINGS, completeness_without_zeros, view_table
from sfr_loc_map.report.summary import NO_VERDICT, Banner, banner_of
from sfr_loc_map.report.verdict_view import OPEN, VerdictView, verdict_views
from sfr_loc_map.tables.model import UNKNOWN, Table

DOCUMENT = "Clarification of performance metrics for SFR Breadboarding"
OF_RECORDING = ("source", "truth", "map_truth", "images")  #: Roles of inputs that identify a recording.
WITH_SIGMA = ("sigma", "mean_plus_3sigma")  #: Statistics that depend on a standard deviation.


def clauses_used(scores: Sequence[Score]) -> list[str]:
    """Return the clauses that apply to the limited figures of scores, sorted."""
    found = {view.clause for score in scores for view in verdict_views(score)} - {""}
    limited = [item for score in scores for item in score.verdicts]
    if any(item.statistic in WITH_SIGMA for item in limited):
        found.add(STANDARD_DEVIATION)
    if any(item.condition is not None for item in limited):
        found.update(OF_SUB_TRAJECTORIES)
    return sorted(found)


def figures_without_clause(scores: Sequence[Score]) -> list[str]:
    """Return the names of the limited figures of scores that no clause defines, each once."""
    return list(dict.fromkeys(view.name for score in scores for view in verdict_views(score) if not view.clause))


class AdditionalEvidence(NamedTuple):
    """Evidence from the output file of another command. It supports the verdicts and never changes them.

    `evidence.report_evidence` reads the files.
    """

    heading: str
    path: str
    sha256: str
    tables: tuple[Table, ...]
    open_points: tuple[str, ...]
    results: tuple[str, ...] = ()  #: Result of each subject of a check.
    provenance: Provenance | None = None  #: Inputs of evidence from a recording; None if unknown.
    is_of_recording: bool = False  #: Whether the evidence is from a recording, which must be that of the scores.

    @property
    def facts(self) -> dict[str, str]:
        """Command, version, time and inputs of the evidence; empty if they are unknown."""
        made = self.provenance
        if made is None:
            return {}
        facts = {"Command": made.command or UNKNOWN, "Version": f"{made.version}, commit {made.commit or UNKNOWN}"}
        facts["Time"] = made.time or UNKNOWN
        return facts | {f"Input {role}": f"{file.path}, SHA-256 {file.sha256}" for role, file in made.inputs.items()}


class ResultRow(NamedTuple):
    """A row of the results."""

    id: str  #: Number of the requirement, or else the numbers of the command and the limit.
    text: str  #: Text of the requirement.
    view: VerdictView
    command: int  #: Number of the command that reproduces the figure, from 1.


class InputRow(NamedTuple):
    """A row of the data: an input of a score."""

    role: str
    path: str
    sha256: str


class ScoreSection(NamedTuple):
    """The parts of the report about one score, which one command of the procedure reproduces."""

    number: int  #: From 1.
    command: str  #: Command line.
    banner: Banner
    item: dict[str, str]  #: Item under test: names and texts.
    inputs: list[InputRow]
    results: list[ResultRow]
    tables: list[Table]
    plots: list[PrintedPlot]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportToSign:
    """The content of a test report, in the order of the report."""

    title: str
    number: str
    issue: str
    banner: Banner
    no_common_verdict: str  #: Why the scores have no common verdict; empty if they have one.
    sections: list[ScoreSection]  #: Item under test, procedure, data and results of each score.
    clauses: list[tuple[str, str]]  #: Clauses of the specification and their texts.
    without_clause: list[str]  #: Limited figures that no clause defines.
    counts: dict[str, int]  #: Number of results by verdict.
    evidence: list[AdditionalEvidence]
    deviations: list[str]
    anomalies: list[str]
    open_points: list[str]


def render_test_report(
    scores: Sequence[Score],
    title: str = "",
    number: str = "",
    issue: str = "",
    evidence: Sequence[AdditionalEvidence] = (),
) -> str:
    """Return the report of judged scores as HTML without scripts, formatted for A4; MetricsError without a score."""
    if not scores:
        raise MetricsError("a test report requires at least one score, found none: give the scores of the test")
    common = common_verdict(scores)
    sections = [_section(score, index) for index, score in enumerate(scores, 1)]
    states = [row.view.item.state.value for section in sections for row in section.results]
    report = ReportToSign(
        title=title or "Test report",
        number=number,
        issue=issue,
        banner=banner_of_all(common, [section.banner for section in sections]),
        no_common_verdict=common.text,
        sections=sections,
        clauses=[(clause, CLAUSES[clause]) for clause in clauses_used(scores)],
        without_clause=figures_without_clause(scores),
        counts={state: states.count(state) for state in dict.fromkeys(states)},
        evidence=[
            item._replace(tables=tuple(_named(f"evidence-{index}", item.tables)))
            for index, item in enumerate(evidence, 1)
        ],
        deviations=_of_all(scores, deviations_of),
        anomalies=_of_all(scores, _anomalies),
        open_points=[
            *_of_all(scores, _open_points),
            *(text for item in evidence for text in (*item.open_points, *_other_recording(item, scores))),
        ],
    )
    return from_template(
        "test_report.html.j2", report=report, document=DOCUMENT, drawing=DRAWING, no_interval=NO_INTERVAL
    )


def _section(score: Score, number: int) -> ScoreSection:
    made = score.provenance
    files = {} if made is None else made.inputs
    return ScoreSection(
        number=number,
        command=UNKNOWN if made is None else made.command or UNKNOWN,
        banner=banner_of(score),
        item=_item(score),
        inputs=[InputRow(role, file.path, file.sha256) for role, file in files.items()],
        results=list(_results(score, number)),
        tables=_named(str(number), [table for table in _tables(score) if table.rows]),
        plots=printed_plots(score),
    )


def _other_recording(evidence: AdditionalEvidence, scores: Sequence[Score]) -> Iterator[str]:
    """Yield that evidence from a recording has no input in common with the scores, or that its inputs are unknown."""
    if not evidence.is_of_recording:
        return
    if evidence.provenance is None:
        yield f"The recording of the evidence '{evidence.path}' is unknown: repeat the command that wrote the file."
        return
    made = [score.provenance for score in scores if score.provenance is not None]
    of_scores = {file.sha256 for item in made for role, file in item.inputs.items() if role in OF_RECORDING}
    of_evidence = {file.sha256 for role, file in evidence.provenance.inputs.items() if role in OF_RECORDING}
    if not of_scores & of_evidence:
        yield (
            f"The evidence '{evidence.path}' and the scores have no recording in common by their hashes: compare the "
            "inputs."
        )


def _tables(score: Score) -> tuple[Table, ...]:
    """Return the tables of figures below the results."""
    return view_table(HEADLINE, score), completeness_without_zeros(score), view_table(READINGS, score)


def _named(suffix: str, tables: Sequence[Table]) -> list[Table]:
    """Return tables whose names, which are anchors of the page, differ from those of the other scores and files."""
    return [replace(table, name=f"{table.name}-{suffix}") for table in tables]


def banner_of_all(common: Common, banners: Sequence[Banner]) -> Banner:
    """Return the headline verdict: the worst verdict of the scores; pass requires that all scores pass."""
    if common.text:
        return Banner("no common verdict", common.text, OPEN.css, OPEN.icon)
    wanted = common.state or NO_VERDICT
    return next(item for item in banners if item.state == wanted)


def _of_all(scores: Sequence[Score], texts_of: Callable[[Score], Iterator[str]]) -> list[str]:
    """Return the texts about all scores without duplicates, with the numbers of their commands if there are several."""
    found: dict[str, list[str]] = {}
    for index, score in enumerate(scores):
        for text in texts_of(score):
            found.setdefault(text, []).append(str(index + 1))
    return [f"Command {', '.join(of)}: {text}" if len(scores) > 1 else text for text, of in found.items()]


def _item(score: Score) -> dict[str, str]:
    """Return the item under test with its platform, clock and settings."""
    made, method, target = score.provenance, score.method, score.target
    facts = {"Item": UNKNOWN, "Version": UNKNOWN}
    if method is not None:
        facts = {"Item": f"{method.name} ({method.kind})", "Version": method.version or UNKNOWN}
        facts["Hash"] = method.sha256 or UNKNOWN
        if method.config_sha256 is not None:
            facts["Hash of its configuration"] = method.config_sha256
        if method.variables is not None:
            facts["Environment variables"] = method.variables
    if target is not None:
        facts["Board"] = target.name
        about = target.about or TargetRecord()
        facts["OS"] = about.os or UNKNOWN
        facts["Clock"] = about.clock or UNKNOWN
        facts["Compiler"] = about.compiler or UNKNOWN
        facts["Build flags"] = about.flags or UNKNOWN
        resolution = about.clock_resolution_s
        facts["Clock resolution"] = UNKNOWN if resolution is None else f"{resolution:g} s"
    if score.calls is not None:
        if score.calls.clocks:
            facts["Clock of the host"] = ", ".join(sorted(set(score.calls.clocks.values())))
        facts["Memory"] = score.calls.memory_method or UNKNOWN
    if made is not None:
        facts["Judged by"] = f"sfr_loc_map {made.version}, commit {made.commit or UNKNOWN}"
        settings = {name: made.configuration[name] for name in sorted(made.configuration)}
        sha256 = hashlib.sha256(msgspec.json.encode(settings)).hexdigest()
        facts["Configuration"] = f"{len(settings)} settings, SHA-256 {sha256}"
        facts["Host"] = ", ".join(f"{name} {value}" for name, value in made.host.items()) or UNKNOWN
        facts["Time"] = made.time or UNKNOWN
    return facts


def _results(score: Score, command: int) -> Iterator[ResultRow]:
    """Yield the rows of the results of a score, one per verdict."""
    for place, view in enumerate(verdict_views(score), 1):
        yield ResultRow(view.item.id or f"{command}.{place}", view.item.text or "", view, command)


def _anomalies(score: Score) -> Iterator[str]:
    """Yield a contradiction, the findings, and the warnings, except the caveats, which are listed as deviations."""
    if score.contradiction is not None:
        yield score.contradiction
    yield from map(str, score.findings)
    stated = {score.contradiction, *caveats_of(score)}
    yield from (text for text in score.warnings if text not in stated)


def _open_points(score: Score) -> Iterator[str]:
    """Yield the limits that are neither met nor missed, the verdicts that may change, and what was not verified."""
    for view in verdict_views(score):
        if view.reason:
            yield f"{view.title}: not enough data ({view.reason})."
        elif view.item.state is VerdictState.NOT_JUDGED:
            yield f"{view.title}: not judged, because estimate and truth contradict each other."
        elif view.item.state is VerdictState.INCOMPLETE:
            yield f"{view.title}: the data is incomplete."
        elif view.item.certain is False:
            yield f"{view.title}: the 95 % interval spans the limit; more data may change the verdict."
    yield (
        "The figures were not computed again from the inputs; the verdicts were derived again from the figures. The "
        "command of the procedure computes the figures."
    )
    if score.provenance is not None and any(role.startswith("stats_") for role in score.provenance.inputs):
        yield (
            "Estimate and calls are files without a signature. They were compared with each other, which does not "
            "detect a change of both."
        )
    if score.figure("restarts") is not None:
        yield (
            "The figures are those of a live run. They do not contain what was published before the monitor was "
            "started, or before it was started again after it had ended."
        )
    if score.active_rules.limits and not score.active_rules.data_set_sha256:
        yield (
            "The limits name no data set. The hashes of the inputs identify the data that were judged: compare them "
            "with those of the agreed data set."
        )
    if score.provenance is None or score.provenance.commit is None:
        yield "The commit of sfr_loc_map is unknown, because sfr_loc_map was not installed from a repository."
    if score.method is None:
        yield "The item under test is not named in the inputs."
    elif score.method.kind in (MethodKind.PYTHON, MethodKind.LIBRARY):
        yield (
            f"It was not verified that the code of {score.method.name}, its configuration, and the files and names of "
            "files of the system and of the interpreter contain no encoded ground truth. Judge the method on a drive "
            "that its supplier does not have."
        )
