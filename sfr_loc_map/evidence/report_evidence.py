"""Additional evidence for a test report, read from the outputs of other commands.

A check without ground truth, the error budget of a suite, and a search for the worst case are shown in this order. This
evidence supports a verdict but never changes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from sfr_loc_map.errors import InputError, naming
from sfr_loc_map.evidence.check_result import SCHEMA as CHECK_SCHEMA
from sfr_loc_map.evidence.check_result import Check, CheckResult
from sfr_loc_map.evidence.check_tables import check_tables
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.inputs import MAX_JSON_BYTES, read_text, refusing
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.stored.score_json import HASH, converted, hash_of_values
from sfr_loc_map.report.test_report import AdditionalEvidence
from sfr_loc_map.suite.pages.search_page import case_table
from sfr_loc_map.suite.pages.tables import budget_tables
from sfr_loc_map.suite.search.record import SCHEMA as SEARCH_SCHEMA
from sfr_loc_map.suite.search.record import SearchRecord, ratio_text
from sfr_loc_map.suite.statistics.budget import Budget
from sfr_loc_map.suite.statistics.summary import SCHEMA as SUITE_SCHEMA

ADVICE = "give the JSON of sfr check, suite.json or search.json"


def read_evidence(paths: Sequence[Path]) -> list[AdditionalEvidence]:
    """Return the evidence of files, in the order of a report.

    InputError for a file of another schema, for a file with the content of another one, and for a check without the
    hash of its values or without a figure of its tables.
    """
    contents = [(path, _read(path)) for path in paths]
    kinds = [*EVIDENCE_OF]
    contents.sort(key=lambda item: kinds.index(item[1]["schema"]))
    found: dict[str, AdditionalEvidence] = {}  # by hash of the file
    for path, content in contents:
        with naming(path), refusing(f"cannot read evidence '{path}'", ADVICE):
            evidence = EVIDENCE_OF[content["schema"]](path, content)
        if evidence.sha256 in found:
            other = found[evidence.sha256].path
            raise InputError(f"evidence '{path}' has the content of '{other}': give each evidence once")
        found[evidence.sha256] = evidence
    return [*found.values()]


def _read(path: Path) -> dict[str, Any]:
    """Return the content of a file with a known schema."""
    with refusing(f"cannot read evidence '{path}'", ADVICE):
        content: dict[str, Any] = msgspec.json.decode(read_text(path, MAX_JSON_BYTES), type=dict[str, Any])
        schema = content.get("schema")
        if not isinstance(schema, str) or schema not in EVIDENCE_OF:
            raise ValueError(f"its schema is {schema!r}: one of {', '.join(EVIDENCE_OF)} is required")
        return content


# ---- a check without ground truth


def evidence_of_check(path: Path, content: dict[str, Any]) -> AdditionalEvidence:
    """Return the evidence of a check; its results are derived again from its figures."""
    if content.get(HASH) != hash_of_values(content):
        raise ValueError(f"its values do not have the hash in {HASH}: repeat the check")
    check = converted(Check, content)
    return AdditionalEvidence(
        heading="Check without ground truth",
        path=str(path),
        sha256=hash_path(path),
        tables=tuple(check_tables(check.figures, check.advice)),
        open_points=tuple(_open_points_of_check(check)),
        results=tuple(_result_texts(check)),
        provenance=check.provenance,
        is_of_recording=True,
    )


def _result_texts(check: Check) -> Iterator[str]:
    """Yield the result of each subject with its number of comparisons."""
    for subject, result in check.results.items():
        text = f"{subject}: {result.value}"
        if subject in check.checked:
            text += f"; {check.checked[subject]} comparisons have enough data"
        yield f"{text}."


def _open_points_of_check(check: Check) -> Iterator[str]:
    """Yield the results that are not consistent, and the subjects that were checked in part."""
    for subject, (enough, count) in check.counts.items():
        if enough < count:
            comparisons = f"{enough} of {count} comparisons have enough data"
            yield f"In the check of the {subject} without ground truth, {comparisons}."
    for subject, result in check.results.items():
        if result is not CheckResult.CONSISTENT:
            yield f"The result of the check of the {subject} without ground truth is '{result.value}'."
    for subject, pairs in check.pairs.items():
        if (of_source := check.pairs_of_source[subject]) > pairs:
            yield f"The check of the {subject} without ground truth covers {pairs} of {of_source} pairs."
    yield from (f"Calibration: {text}." for text in check.calibration)


# ---- the error budget of a suite


def evidence_of_budget(path: Path, content: dict[str, Any]) -> AdditionalEvidence:
    """Return the evidence of `suite.json` of a suite with an error budget."""
    budgets = converted(list[Budget], content.get("budgets"))
    return AdditionalEvidence(
        heading="Error budget",
        path=str(path),
        sha256=hash_path(path),
        tables=tuple(budget_tables(budgets)),
        open_points=tuple(_open_points_of_budgets(budgets)),
    )


def _open_points_of_budgets(budgets: Sequence[Budget]) -> Iterator[str]:
    if not budgets:
        yield "The suite has no error budget."
    for budget in budgets:
        over = label_of(budget.condition)
        if budget.left_out:
            yield f"Drives without a complete result in the error budget over {over}: {budget.left_out}."
        bounds = budget.total.ci95
        if bounds is not None and not bounds[0] <= 1.0 <= bounds[1]:
            yield f"The fractions of the error budget over {over} do not add up to 100 %: sources interact."


# ---- a search for the worst case


def evidence_of_search(path: Path, content: dict[str, Any]) -> AdditionalEvidence:
    """Return the evidence of `search.json`."""
    record = converted(SearchRecord, content)
    return AdditionalEvidence(
        heading="Worst case",
        path=str(path),
        sha256=hash_path(path),
        tables=(case_table(record),),
        open_points=tuple(_open_points_of_search(record)),
    )


def _open_points_of_search(record: SearchRecord) -> Iterator[str]:
    """Yield an open point if any scenario misses the limit."""
    if record.found.fails:
        unchanged = " and in the unchanged scenario" if record.usual.fails else ""
        yield (
            f"The limit is missed in {record.missed} of {len(record.points)} searched scenarios{unchanged}; "
            f"the worst has {ratio_text(record.found.ratio)} ({record.title})."
        )


EVIDENCE_OF: Mapping[str, Callable[[Path, dict[str, Any]], AdditionalEvidence]] = {
    CHECK_SCHEMA: evidence_of_check,
    SUITE_SCHEMA: evidence_of_budget,
    SEARCH_SCHEMA: evidence_of_search,
}
"""Functions that return the evidence of a file and its content by the schema, in the order of a report."""
