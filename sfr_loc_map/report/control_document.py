"""Verification control document as CSV: one row per requirement, with evidence, compliance and close-out.

The columns follow ECSS-E-ST-10-02C (annex B): the requirement, the method and the evidence of its verification, the
compliance of the item, and the close-out. Only a pass closes a requirement, and only if no finding fails the score,
such as a crash of the item under test.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping

from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.several_scores import Common, common_verdict, is_closed
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
    evidence. Without a common verdict of the scores, no requirement is closed.
    """
    common = common_verdict([*scores.values()])
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for name, score in scores.items():
        evidence = f"{report}, {name}" if report else name
        for view in verdict_views(score):
            writer.writerow(_row(view, score, evidence, common))
    return buffer.getvalue()


def _row(view: VerdictView, score: Score, evidence: str, common: Common) -> dict[str, object]:
    item = view.item
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
        "close_out": "closed" if is_closed(item, score, common) else "open",
        "remarks": " ".join(filter(None, (common.text, *_findings(score), _remarks(view, score)))),
    }
    numbers = {
        name: getattr(item, name) for name in ("limit", "value", "margin", "low95", "high95", "n", "independent")
    }
    return {name: printable(text) for name, text in texts.items()} | numbers


def _item_of(score: Score) -> str:
    method = score.method
    return "" if method is None else f"{method.name} {method.version or ''}".strip()


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
