"""The test report, which a reviewer signs: made from scores alone, in the order of a verification report.

The order is that of the verification report of ECSS-E-ST-10-02C: item, documents, procedure, data, results,
deviations, anomalies, open points, signatures.
"""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import msgspec

from sfr_loc_map.inputs import NS_PER_S, printable
from sfr_loc_map.metrics.catalogue import Subject
from sfr_loc_map.metrics.caveats import reading_caveats, truth_caveats
from sfr_loc_map.metrics.config import CallKind, MapScoreConfig, Rebase, VerdictState, label_of
from sfr_loc_map.metrics.judging.limits import COVERAGE_MIN, MINIMUM_INDEPENDENT
from sfr_loc_map.metrics.judging.several_scores import Common, common_verdict
from sfr_loc_map.metrics.judging.shortfall_kinds import SHORTFALLS
from sfr_loc_map.metrics.records import TargetRecord
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.verdict import Verdict
from sfr_loc_map.report.page import NO_VERDICT, Overall, from_template, overall_of
from sfr_loc_map.report.printed_figure import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, printed_figures
from sfr_loc_map.report.score_tables import NO_INTERVAL, table_of
from sfr_loc_map.report.tables import METRE, OPEN, UNKNOWN, fitting, number, to_html
from sfr_loc_map.report.verdict_view import VerdictView, verdict_views

TABLES = ("headline", "covered", "readings")  #: Tables of figures below the results.
DOCUMENT = "Clarification of performance metrics for SFR Breadboarding"
CLAUSES = {
    "4.1.1": "Sub-trajectories from frame N to the frame N+x at which the condition is met",
    "4.1.2": "Error before the start of a sub-trajectory does not count",
    "4.1.3": "Standard deviation with Bessel's correction",
    "4.2.1": "Time of a localisation call, wall clock on the target",
    "4.2.2": "RAM of a localisation call, by a method that the supplier proposes",
    "4.2.3.1": "3D position error",
    "4.2.3.2": "Attitude error",
    "4.2.3.3": "Heading error",
    "4.3.1": "Time of a mapping call, wall clock on the target",
    "4.3.2": "RAM of a mapping call, by a method that the supplier proposes",
    "4.3.4": "Error of each point of the cloud",
}
OF_SUB_TRAJECTORIES = ("4.1.1", "4.1.2")  #: Clauses that every error of the trajectory follows.
WITH_SIGMA = ("sigma", "mean_plus_3sigma")  #: Statistics that are made of a standard deviation.
STANDARD_DEVIATION = "4.1.3"
STAGES = (CallKind.MAPPING, CallKind.FUSION)  #: Calls that are stages of the mapping call of the document.
NO_CLAUSE = "no_clause"  #: Class of a test case whose figure the document does not define.
SPACING_FRAMES = 10  #: Frames between starts of sub-trajectories, as the document says [4.1.1].


def clauses_used(scores: Sequence[Score]) -> list[str]:
    """Return the clauses that the limited figures of some scores follow, in their order."""
    found = {view.clause for score in scores for view in verdict_views(score)} - {""}
    limited = [item for score in scores for item in score.verdicts]
    if any(item.statistic in WITH_SIGMA for item in limited):
        found.add(STANDARD_DEVIATION)
    if any(item.condition is not None for item in limited):
        found.update(OF_SUB_TRAJECTORIES)
    return sorted(found)


def render_test_report(scores: Sequence[Score], title: str = "", number: str = "", issue: str = "") -> str:
    """Return the report of scores as they were judged as HTML, without script; it prints on A4."""
    common = common_verdict(scores)
    results = [row for index, score in enumerate(scores) for row in _results(score, index)]
    states = [row["view"].item.state.value for row in results]
    overalls = [overall_of(score) for score in scores]
    tables_of_all = [[table_of(item, name) for name in TABLES] for item in scores]
    return from_template(
        "test_report.html.j2",
        title=title or "Test report",
        number=printable(number),
        issue=printable(issue),
        document=DOCUMENT,
        overall=overall_of_all(common, overalls),
        said=[item.text for item in overalls] + ([common.text] if common.text else []),
        counts={word: states.count(word) for word in dict.fromkeys(states)},
        items=[_item(score) for score in scores],
        clauses=[(clause, CLAUSES[clause]) for clause in clauses_used(scores)],
        commands=[score.provenance.command or UNKNOWN if score.provenance else UNKNOWN for score in scores],
        inputs=[
            (number, role, printable(file.path), file.sha256)
            for number, score in enumerate(scores, 1)
            for role, file in (score.provenance.inputs if score.provenance else {}).items()
        ],
        results=results,
        no_interval=NO_INTERVAL,
        tables=[
            "".join(to_html(replace(table, name=f"{table.name}-{n}")) for table in judged_by if table.rows)
            for n, judged_by in enumerate(tables_of_all, 1)
        ],
        drawn=[printed_figures(item) for item in scores],
        size=(WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT),
        deviations=_of_all(scores, deviations_of),
        anomalies=_of_all(scores, _anomalies),
        open_points=_of_all(scores, _open_points),
    )


def overall_of_all(common: Common, overalls: Sequence[Overall]) -> Overall:
    """Return the headline verdict: the worst one, and a pass only if it is common to all scores."""
    if common.text:
        return Overall("no common verdict", common.text, OPEN.css, OPEN.icon)
    return next(item for item in overalls if item.state == (common.state or NO_VERDICT))


def _of_all(scores: Sequence[Score], texts_of: Callable[[Score], Iterator[str]]) -> list[str]:
    """Return the texts about all scores, each once, with the commands it is of where there are several."""
    found: dict[str, list[str]] = {}
    for index, score in enumerate(scores):
        for text in texts_of(score):
            found.setdefault(printable(text), []).append(str(index + 1))
    return [f"Of command {', '.join(of)}: {text}" if len(scores) > 1 else text for text, of in found.items()]


def _item(score: Score) -> dict[str, str]:
    """Return the item under test: what it is, on what it ran, by which clock."""
    made, method, target = score.provenance, score.method, score.target
    facts = {"Item": UNKNOWN, "Version": UNKNOWN}
    if method is not None:
        facts = {"Item": f"{method.name} ({method.kind})", "Version": method.version or UNKNOWN}
        facts["Hash"] = method.sha256 or UNKNOWN
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
    return {name: printable(text) for name, text in facts.items()}


def _results(score: Score, index: int) -> Iterator[dict[str, Any]]:
    """Yield the rows of the results: a view of each verdict, and the command that makes its figure again."""
    for place, view in enumerate(verdict_views(score)):
        yield {
            "id": view.item.id or f"{index + 1}.{place + 1}",
            "text": printable(view.item.text or ""),
            "view": view,
            "command": index + 1,
        }


def _from_the_document(score: Score) -> Iterator[str]:
    """Yield where what was used is not what the document says."""
    drive = score.association
    if drive is not None and drive.spacing_frames != SPACING_FRAMES:
        yield (
            f"Sub-trajectories start every {drive.spacing_frames} frames; the document says {SPACING_FRAMES} [4.1.1]."
        )
    if drive is not None and drive.rebase is not Rebase.DISPLACEMENT:
        figures = []
        for condition in score.conditions:
            used, literal = (
                score.number("position", "mean_plus_3sigma", condition=condition, part=str(part))
                for part in (drive.rebase, Rebase.DISPLACEMENT)
            )
            if used is not None and literal is not None:
                unit = fitting(METRE, used, literal)
                texts = (f"{number(value, unit=unit)} {unit.symbol}" for value in (used, literal))
                figures.append(f"mean + 3 sigma over {label_of(condition)} {', by displacements '.join(texts)}")
        yield (
            f"Errors are compared by the reading '{drive.rebase}'; to the letter the document compares displacements "
            f"[4.2.3.1]{': ' if figures else ''}{'; '.join(figures)}."
        )
    if drive is not None and drive.interpolated:
        gap_s = drive.largest_gap_ns / NS_PER_S
        yield f"{drive.interpolated} frames have an interpolated truth, over gaps of up to {gap_s:.3g} s."
    yield from (f"{text[0].upper()}{text[1:]}." for text in caveats_of(score))
    yield from _of_the_range(score)
    for item in score.verdicts:
        is_of_host = item.subject in (Subject.TIMING, Subject.MEMORY) and not item.is_of_target
        if is_of_host:
            clauses = "4.2.1, 4.3.1" if item.subject is Subject.TIMING else "4.2.2, 4.3.2"
            yield f"{_name(item)} was measured on the host; the document requires the target [{clauses}]."
        if is_of_stage(item):
            yield f"{_name(item)} is of a stage; the call of the document makes one cloud of all pairs [4.3.1]."


def _of_the_range(score: Score) -> Iterator[str]:
    """Yield that a verdict on a map counts other ranges than those of the default."""
    if score.provenance is None or not any(item.subject is Subject.MAP for item in score.verdicts):
        return
    usual = MapScoreConfig()
    used = [score.provenance.configuration.get(f"map.{name}") for name in ("scored_from_m", "scored_to_m")]
    if None not in used and used != [usual.scored_from_m, usual.scored_to_m]:
        yield (
            f"Coverage counts true points from {used[0]:g} m to {used[1]:g} m (--range); the default is "
            f"{usual.scored_from_m:g} m to {usual.scored_to_m:g} m."
        )


def caveats_of(score: Score) -> Iterator[str]:
    """Yield what restricts the meaning of a score, in the words of its warnings."""
    if score.truth is not None:
        yield from truth_caveats(score.truth)
    yield from reading_caveats(score)


def is_of_stage(item: Verdict) -> bool:
    """Return whether a verdict is on the time or the memory of a stage; the kind of call of memory is the part."""
    return item.figure in STAGES or VerdictView.of(item).part.call in STAGES


def _allowed(score: Score) -> Iterator[str]:
    """Yield what the limits allow that is not allowed without them."""
    rules = score.rules
    if rules is None:
        return
    if rules.partial:
        yield "A part of what was expected is judged as if it were the whole (--partial)."
    strict = {kind.figure: kind.most for kind in SHORTFALLS if kind.most is not None}
    for item in rules.limits:
        name = item.name.removesuffix("_max_share")
        if name in strict and item.limit > strict[name]:
            yield f"{item.name} {item.limit:g} is allowed by the limits; without it {strict[name]:g} is."
        if item.name == COVERAGE_MIN and item.limit < 1.0 - strict["pixels_without_point"]:
            yield f"{item.name} {item.limit:g} is less than the {1.0 - strict['pixels_without_point']:g} of other maps."
    if rules.minimum_independent < MINIMUM_INDEPENDENT:
        least = f"{rules.minimum_independent:g}"
        usual = f"{MINIMUM_INDEPENDENT:g}"
        yield f"{least} independent sub-trajectories are enough by the limits; without them {usual} are."


def deviations_of(score: Score) -> Iterator[str]:
    """Yield what a score deviates from the document in, and what of its data is not judged."""
    yield from _from_the_document(score)
    yield from _allowed(score)
    if score.incomplete:
        yield f"What was expected is not complete: {score.incomplete}."
    if (drive := score.association) is not None:
        for count, what in ((drive.lost, "lost"), (drive.degraded, "degraded")):
            if count:
                yield f"{count} of {drive.matched} frames are {what}. They are judged like the others."
        if unmatched := score.number("unmatched", part="count"):
            yield f"{unmatched:.0f} estimates have no truth and are not judged."
        if drive.estimate_duplicates:
            yield f"{drive.estimate_duplicates} estimates were ignored because a later one has the same stamp."
    if without_cloud := score.number("pairs_without_cloud", part="count"):
        yield f"{without_cloud:.0f} of {score.number('pairs'):.0f} mapping pairs have no point in the cloud."
    if without_truth := score.number("points_without_truth", part="count"):
        yield f"{without_truth:.0f} points are where the truth has no surface, and are not judged."
    if score.calls is None and score.association is not None and score.verdicts:
        yield "The calls of the run are unknown, and with them its findings and the states of its poses."
    if score.convention is not None:
        yield f"The poses were converted before: {', '.join(score.convention.declared) or 'as diagnosed'}."


def _anomalies(score: Score) -> Iterator[str]:
    if score.contradiction is not None:
        yield score.contradiction
    yield from map(str, score.findings)
    stated = {score.contradiction, *caveats_of(score)}
    yield from (text for text in score.warnings if text not in stated)


def _open_points(score: Score) -> Iterator[str]:
    for view in verdict_views(score):
        if view.reason:
            yield f"{view.title}: not enough data ({view.reason})."
        elif view.item.certain is False:
            yield f"{view.title}: the 95 % interval spans the limit; more data may change the verdict."
    if score.provenance is None or score.provenance.commit is None:
        yield "The commit of sfr_loc_map is not known: it was not installed from a repository."
    if score.method is None:
        yield "The item under test is not named in the inputs."


def _name(item: Verdict) -> str:
    return VerdictView.of(item).title


# ---- the same for a pipeline


JUNIT = {
    VerdictState.FAIL: ("failure", "failures"),
    VerdictState.NOT_ENOUGH_DATA: ("error", "errors"),
    VerdictState.INCOMPLETE: ("error", "errors"),
    VerdictState.NOT_JUDGED: ("error", "errors"),
}
"""By what is no pass: the element of a test case, and the attribute of a suite that counts them. What is not judged is
an error, so that a pipeline is not green where the command ends with exit code 3."""


def junit(scores: Mapping[str, Score], without: Mapping[str, str] | None = None) -> str:
    """Return the verdicts as JUnit XML, a test case for each limit, and one for what has no score, and why."""
    root = ET.Element("testsuites", name="sfr_loc_map")
    open_ = {n: why for n, s in scores.items() if not s.verdicts and (why := s.contradiction or s.incomplete)}
    for name, reason in {**(without or {}), **open_}.items():
        suite = ET.SubElement(root, "testsuite", name=printable(name), tests="1", failures="0", errors="1", skipped="0")
        case = ET.SubElement(suite, "testcase", classname="sfr.result", name="has a result")
        ET.SubElement(case, "error", message=printable(reason))
    for name, score in ((name, score) for name, score in scores.items() if name not in open_):
        states = [item.state for item in score.verdicts]
        suite = ET.SubElement(root, "testsuite", name=printable(name), tests=str(len(states)), skipped="0")
        for _, counted in JUNIT.values():
            suite.set(counted, str(sum(JUNIT.get(state, ("", ""))[1] == counted for state in states)))
        if score.provenance is not None and score.provenance.time:
            suite.set("timestamp", score.provenance.time[:19])
        for view in verdict_views(score):
            item, state = view.item, view.item.state
            kind = f"sfr.{view.clause if view.is_defined else NO_CLAUSE}"
            case = ET.SubElement(suite, "testcase", classname=kind, name=view.title)
            properties = ET.SubElement(case, "properties")
            facts = {"id": item.id, "text": item.text, "limit": item.limit, "value": item.value}
            facts |= {"margin": item.margin, "certain": item.certain}
            for fact, value in facts.items():
                if value is not None:
                    ET.SubElement(properties, "property", name=fact, value=printable(str(value)))
            if state in JUNIT:
                why = "" if state is VerdictState.FAIL else score.contradiction or score.incomplete
                message = f"{state}: {view.reason or why or view.comparison}"
                ET.SubElement(case, JUNIT[state][0], message=printable(message))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
