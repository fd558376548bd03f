"""The page of traceability is that of the clauses and the markers, and no clause of the software is without a test."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def made() -> object:
    """The module that makes the page; it belongs to the site, not to the package."""
    import sys

    spec = importlib.util.spec_from_file_location("traceability", ROOT / "docs" / "_ext" / "traceability.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["traceability"] = module
    spec.loader.exec_module(module)
    return module


def test_the_page_is_up_to_date(made: object) -> None:
    assert made.PAGE.read_text(encoding="utf-8") == made.page(), "run: make traceability"


def test_each_clause_of_the_software_has_code_and_a_test_and_the_others_say_why(made: object) -> None:
    tests = made.verifications()
    for clause in made.CLAUSES:
        if clause.modules:
            assert tests.get(clause.number), f"no test has the marker of clause {clause.number}"
            assert clause.asks
            assert clause.report
            assert all((ROOT / "sfr_loc_map" / module).is_file() for module in clause.modules), clause.number
        else:
            assert clause.note, clause.number
            assert clause.number not in tests


def test_markers_name_clauses_that_exist(made: object) -> None:
    assert set(made.verifications()) <= {clause.number for clause in made.CLAUSES}
