"""Verification control document as CSV: one row per verdict, with requirement, evidence, compliance and close-out.

The columns follow ECSS-E-ST-10-02C (annex B): the requirement, the method and the evidence of its verification, the
compliance of the item, and the close-out. Only a pass closes a requirement. The requirement stays open if a finding
fails the score (such as a crash of the item under test), or if another row of the requirement is not a pass. A remark
states the deviations of its row. The first row of a score also states the deviations of the complete score.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterator, Mapping, Sequence

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.several_scores import Common, common_verdict, is_closed, open_requirements
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.deviations import Deviation, each_deviation
from sfr_loc_map.report.verdict_view import VerdictView, verdict_views
from sfr_loc_map.tables.formats import csv_text

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
        deviations = list(each_deviation(score))
        for index, view in enumerate(verdict_views(score)):
            remarks = [*_remarks(view, score, common, open_ids), *_deviations(view, deviations, is_first=index == 0)]
            is_open = not is_closed(view.item, score, common, open_ids)
            writer.writerow(_row(view, score, evidence, remarks, is_open=is_open))
    return buffer.getvalue()


def _row(view: VerdictView, score: Score, evidence: str, remarks: Sequence[str], *, is_open: bool) -> dict[str, object]:
    item = view.item
    low95, high95 = item.interval or (None, None)
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
        "close_out": "open" if is_open else "closed",
        "remarks": " ".join(remarks),
    }
    numbers: dict[str, object] = {
        "limit": view.limit.value,
        "value": view.value.value,
        "margin": view.margin.value,
        "low95": low95,
        "high95": high95,
        "n": view.count.value,
        "independent": view.independent.value,
    }
    return {**{name: csv_text(text) for name, text in texts.items()}, **numbers}


def _item_of(score: Score) -> str:
    method = score.method
    return "" if method is None else f"{method.name} {method.version or ''}".strip()


def _remarks(view: VerdictView, score: Score, common: Common, open_ids: Collection[str]) -> Iterator[str]:
    """Yield why a requirement is open: other scores or rows, findings, and its verdict."""
    if common.text:
        yield common.text
    elif common.difference:
        yield f"The scores do not come from one run: {common.difference}."
    if view.item.state is VerdictState.PASS and view.item.id in open_ids:
        yield "Another row of this requirement is open."
    for finding in score.fatal_findings:
        yield f"The item under test failed: {finding}."
    if view.item.state is VerdictState.FAIL:
        yield f"{view.comparison}."
    elif view.item.state is not VerdictState.PASS:
        yield f"{view.reason or score.contradiction or score.incomplete or view.item.state.value}."


def _deviations(view: VerdictView, deviations: Sequence[Deviation], *, is_first: bool) -> Iterator[str]:
    """Yield the deviations of a row; the first row of a score has those of the complete score, too."""
    if is_first:
        of_score = [deviation.text for deviation in deviations if deviation.verdict is None]
        yield from (["All rows of this score:", *of_score] if of_score else [])
    yield from (deviation.text for deviation in deviations if deviation.verdict is view.item)
