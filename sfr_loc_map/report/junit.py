"""Verdicts of scores as JUnit XML for a CI pipeline."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.deviations import deviations_of
from sfr_loc_map.report.verdict_view import VerdictView, verdict_views

NO_CLAUSE = "no_clause"  #: Class of a test case whose figure the specification does not define.
ELEMENTS = {
    VerdictState.FAIL: ("failure", "failures"),
    VerdictState.NOT_ENOUGH_DATA: ("error", "errors"),
    VerdictState.INCOMPLETE: ("error", "errors"),
    VerdictState.NOT_JUDGED: ("error", "errors"),
}
"""Element of a test case, and attribute of the suite that counts this element, for each state except a pass. A limit
that is not judged is an error, so that a pipeline fails if the command ends with exit code 3."""


def junit(
    scores: Mapping[str, Score],
    without: Mapping[str, str] | None = None,
    deviations: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """Return the verdicts as JUnit XML with a test case per limit, and the deviations of each score as properties.

    `without` maps the name of each job without a score to the reason. Each such job has one test case with an error.
    Each score that has no verdicts, and is incomplete or contradictory, has such a test case, too. `deviations` has, by
    name, the deviations of scores that combine several results. These deviations do not follow from the score alone.
    """
    unjudged = dict(without or {})
    for name, score in scores.items():
        reason = score.contradiction or score.incomplete
        if not score.verdicts and reason:
            unjudged[name] = reason
    root = ET.Element("testsuites", name="sfr_loc_map")
    for name, reason in unjudged.items():
        _add_unjudged(root, name, reason)
    for name, score in scores.items():
        if name not in unjudged:
            _add_score(root, name, score, (deviations or {}).get(name) or [*deviations_of(score)])
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _add_unjudged(root: ET.Element, name: str, reason: str) -> None:
    suite = ET.SubElement(root, "testsuite", name=printable(name), tests="1", failures="0", errors="1", skipped="0")
    case = ET.SubElement(suite, "testcase", classname="sfr.result", name="has a result")
    ET.SubElement(case, "error", message=printable(reason))


def _add_score(root: ET.Element, name: str, score: Score, deviations: Sequence[str]) -> None:
    states = [item.state for item in score.verdicts]
    suite = ET.SubElement(root, "testsuite", name=printable(name), tests=str(len(states)), skipped="0")
    for counted in ("failures", "errors"):
        suite.set(counted, str(sum(ELEMENTS.get(state, ("", ""))[1] == counted for state in states)))
    if score.provenance is not None and score.provenance.time:
        suite.set("timestamp", score.provenance.time[:19])
    properties = ET.SubElement(suite, "properties")
    for text in deviations:
        ET.SubElement(properties, "property", name="deviation", value=printable(text))
    count_before_limits = len(score.verdicts) - len(score.on_limits)
    for place, view in enumerate(verdict_views(score)):
        name = view.title if place >= count_before_limits else f"{view.title}, default requirement"
        _add_verdict(suite, view, score, name)


def _add_verdict(suite: ET.Element, view: VerdictView, score: Score, name: str) -> None:
    """Add a test case. Its name is unique: a figure can have a verdict on a limit and a verdict on missing data."""
    item = view.item
    clause = view.clause if view.is_defined else NO_CLAUSE
    case = ET.SubElement(suite, "testcase", classname=f"sfr.{clause}", name=name)
    properties = ET.SubElement(case, "properties")
    values = {
        "id": item.id,
        "text": item.text,
        "limit": view.limit.value,
        "value": view.value.value,
        "margin": view.margin.value,
        "certain": item.certain,
    }
    for key, value in values.items():
        if value is not None:
            ET.SubElement(properties, "property", name=key, value=printable(str(value)))
    if item.state in ELEMENTS:
        element, _ = ELEMENTS[item.state]
        why = "" if item.state is VerdictState.FAIL else score.contradiction or score.incomplete
        ET.SubElement(case, element, message=printable(f"{item.state}: {view.reason or why or view.comparison}"))
