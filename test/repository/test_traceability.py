"""The page of traceability is up to date, and every clause of the software has a test."""

import traceability

from helpers import ROOT


def test_the_page_is_up_to_date() -> None:
    assert traceability.PAGE.read_text(encoding="utf-8") == traceability.page(), "run: make traceability"


def test_each_clause_of_the_software_has_code_and_a_test_and_the_others_say_why() -> None:
    tests = traceability.verifications()
    for clause in traceability.CLAUSES:
        assert bool(tests.pop(clause.number, None)) == bool(clause.modules), clause.number
        assert (clause.asks and clause.report) if clause.modules else clause.note, clause.number
        assert all((ROOT / "sfr_loc_map" / module).is_file() for module in clause.modules), clause.number
    assert not tests, "these markers name clauses that do not exist"
