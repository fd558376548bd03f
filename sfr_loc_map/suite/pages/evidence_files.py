"""Additional evidence for a test report, read from the outputs of other commands.

A check without ground truth, the error budget of a suite, and a search for the worst case are shown in this order. This
evidence supports a verdict but never changes it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from sfr_loc_map.errors import InputError, naming
from sfr_loc_map.evidence.check_file import CheckFile
from sfr_loc_map.evidence.check_result import SCHEMA as CHECK_SCHEMA
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.inputs import MAX_JSON_BYTES, read_text
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.stored.score_json import HASH, converted, hash_of_values
from sfr_loc_map.report.test_report import AdditionalEvidence
from sfr_loc_map.suite.pages.search_page import case_table
from sfr_loc_map.suite.pages.tables import budget_tables
from sfr_loc_map.suite.search.record import SCHEMA as SEARCH_SCHEMA
from sfr_loc_map.suite.search.record import SearchRecord, ratio_text
from sfr_loc_map.suite.statistics.budget import Budget
from sfr_loc_map.suite.statistics.summary import SCHEMA as SUITE_SCHEMA
from sfr_loc_map.tables.model import Table


class BudgetFile(msgspec.Struct):
    """The displayed part of `suite.json` of a suite with an error budget."""

    heading: ClassVar = "Error budget"
    budgets: list[Budget]

    def tables(self) -> list[Table]:
        """Return a table for each budget."""
        return budget_tables(self.budgets)

    def open_points(self) -> Iterator[str]:
        """Yield the open points of the budgets."""
        if not self.budgets:
            yield "The suite has no error budget."
        for budget in self.budgets:
            over = label_of(budget.condition)
            if budget.left_out:
                yield f"Drives without a complete result in the error budget over {over}: {budget.left_out}."
            bounds = budget.total.ci95
            if bounds is not None and not bounds[0] <= 1.0 <= bounds[1]:
                yield f"The fractions of the error budget over {over} do not add up to 100 %: sources interact."


class SearchFile(SearchRecord, frozen=True, kw_only=True):
    """`search.json`."""

    heading: ClassVar = "Worst case"

    def tables(self) -> list[Table]:
        """Return the worst case as a table."""
        return [case_table(self)]

    def open_points(self) -> Iterator[str]:
        """Yield an open point if any scenario misses the limit."""
        if self.found.fails:
            unchanged = " and in the unchanged scenario" if self.usual.fails else ""
            yield (
                f"The limit is missed in {self.missed} of {len(self.points)} searched scenarios{unchanged}; "
                f"the worst has {ratio_text(self.found.ratio)} ({self.title})."
            )


KINDS: dict[str, type[CheckFile | BudgetFile | SearchFile]] = {
    CHECK_SCHEMA: CheckFile,
    SUITE_SCHEMA: BudgetFile,
    SEARCH_SCHEMA: SearchFile,
}
"""Kinds of evidence by their schema, in the order of a report."""


def read_evidence(paths: Sequence[Path]) -> list[AdditionalEvidence]:
    """Return the evidence of files, in the order of a report.

    InputError for a file of another schema, for a file with the content of another one, and for a check whose results
    do not follow from its figures.
    """
    read = [(path, read_file(path)) for path in paths]
    first_of: dict[str, Path] = {}
    for path in paths:
        sha256 = hash_path(path)
        if sha256 in first_of:
            raise InputError(f"evidence '{path}' has the content of '{first_of[sha256]}': give each evidence once")
        first_of[sha256] = path
    order = [*KINDS.values()]
    read.sort(key=lambda item: order.index(type(item[1])))
    return [evidence_of(path, content) for path, content in read]


def evidence_of(path: Path, content: CheckFile | BudgetFile | SearchFile) -> AdditionalEvidence:
    """Return the evidence of a file; raise InputError if its figures are incomplete."""
    with naming(path):
        return AdditionalEvidence(
            heading=content.heading,
            path=str(path),
            sha256=hash_path(path),
            tables=tuple(table for table in content.tables() if table.rows),
            open_points=tuple(content.open_points()),
            results=tuple(content.result_texts()) if isinstance(content, CheckFile) else (),
            provenance=content.provenance if isinstance(content, CheckFile) else None,
            is_of_recording=isinstance(content, CheckFile),
        )


def read_file(path: Path) -> CheckFile | BudgetFile | SearchFile:
    """Return the content of a file by its schema; raise InputError for an unknown schema."""
    try:
        content = msgspec.json.decode(read_text(path, MAX_JSON_BYTES), type=dict[str, Any])
        schema = content.get("schema")
        kind = KINDS.get(schema) if isinstance(schema, str) else None
        if kind is None:
            raise ValueError(f"its schema is {schema!r}: one of {', '.join(KINDS)} is required")
        if kind is CheckFile and content.get(HASH) != hash_of_values(content):
            raise ValueError(f"its values do not have the hash in {HASH}: repeat the check")
        return converted(kind, content)
    except (OSError, ValueError) as error:
        problem = error.strerror if isinstance(error, OSError) else error
        advice = "give the JSON of sfr check, suite.json or search.json"
        raise InputError(f"cannot read evidence '{path}': {problem}; {advice}") from error
