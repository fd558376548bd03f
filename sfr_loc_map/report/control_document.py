"""Verification control document as CSV: one row per verdict, with requirement, evidence, compliance and close-out.

The columns follow ECSS-E-ST-10-02C (annex B): the requirement, the method and the evidence of its verification, the
compliance of the item, and the close-out. Only a pass closes a requirement. The requirement stays open if a finding
fails the score (such as a crash of the item under test), or if another row of the requirement is not a pass.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterator, Mapping

from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.several_scores import Common, common_verdict, is_closed, open_requirements
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.deviations import deviations_of
from sfr_loc_map.report.verdict_view import VerdictView, verdict_views

COLUMNS = (
    "requirement",
    "text",
    "clause",
    "item",
    "method",
    "evidence",
    "figure",
    "limit",
    "value",
    "margin",
    "low95",
    "high95",
    "unit",
    "n",
    "independent",
    "compliance",
    "close_out",
    "remarks",
)
COMPLIANCE = {VerdictState.PASS: "compliant", VerdictState.FAIL: "not compliant"}
METHOD = "test"
"""Verification method. Figures of a score come from tests, not from analysis, review of design or inspection."""


def control_csv(scores: Mapping[str, Score], report: str = "") -> str:
    """Return the verification control document of scores, given by file name.

    `report` names the test report with its number and issue. Without a test report the file of the score is the
    evidence. If the scores do not come from one run, or have no common verdict, no requirement is closed.
    """
    common = common_verdict([*scores.values()])
    open_ids = open_requirements([*scores.values()])
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for name, score in scores.items():
        evidence = f"{report}, {name}" if report else name
        for view in verdict_views(score):
            writer.writerow(_row(view, score, evidence, common, open_ids))
    return buffer.getvalue()


def _row(
    view: VerdictView, score: Score, evidence: str, common: Common, open_ids: Collection[str]
) -> dict[str, object]:
    item = view.item
    remarks = (*_of_other_scores(view, common, open_ids), *_findings(score), _remarks(view, score))
    texts = {
        "requirement": item.id or item.name,
        "text": item.text or view.name,
        "clause": view.clause if view.is_defined else "",
        "item": _item_of(score),
        "method": METHOD,
        "evidence": f"{evidence}, {view.key}",
        "figure": view.name,
        "unit": view.unit.of_values,
        "compliance": COMPLIANCE.get(item.state, "not verified"),
        "close_out": "closed" if is_closed(item, score, common, open_ids) else "open",
        "remarks": " ".join(filter(None, remarks)),
    }
    numbers = {
        name: getattr(item, name) for name in ("limit", "value", "margin", "low95", "high95", "n", "independent")
    }
    return {name: printable(text) for name, text in texts.items()} | numbers


def _item_of(score: Score) -> str:
    method = score.method
    return "" if method is None else f"{method.name} {method.version or ''}".strip()


def _of_other_scores(view: VerdictView, common: Common, open_ids: Collection[str]) -> Iterator[str]:
    """Yield why a requirement is open because of other scores or rows."""
    if common.text:
        yield common.text
    elif common.difference:
        yield f"The scores do not come from one run: {common.difference}."
    if view.item.state is VerdictState.PASS and view.item.id in open_ids:
        yield "Another row of this requirement is open."


def _findings(score: Score) -> Iterator[str]:
    """Yield the findings that prevent the close-out of all requirements."""
    for item in score.fatal_findings:
        yield f"The item under test failed: {item}."


def _remarks(view: VerdictView, score: Score) -> str:
    """Return the reason why a requirement is open, or the deviations under which it is closed."""
    if view.item.state is VerdictState.PASS:
        return " ".join(deviations_of(score))
    if view.item.state is VerdictState.FAIL:
        return view.comparison
    return view.reason or score.contradiction or score.incomplete or view.item.state.value
