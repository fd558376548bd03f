"""The record of the trials of the mapper names each constant that cites it."""

import ast
from collections.abc import Iterator
from itertools import pairwise

from helpers import ROOT

TRIALS = "measurements/mapper_trials.md"


def citing_constants() -> Iterator[str]:
    """Yield the names of module constants whose comment or docstring cites the trials."""
    for path in sorted((ROOT / "sfr_loc_map" / "mapping").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines()
        body = ast.parse(text).body
        for statement, following in pairwise(body):
            if not isinstance(statement, ast.Assign):
                continue
            described = lines[statement.lineno - 1 : statement.end_lineno]
            if isinstance(following, ast.Expr):
                described += lines[following.lineno - 1 : following.end_lineno]
            if TRIALS in "\n".join(described):
                yield from (target.id for target in statement.targets if isinstance(target, ast.Name))


def test_the_trials_name_each_constant_that_cites_them() -> None:
    trials = (ROOT / TRIALS).read_text(encoding="utf-8")
    names = list(citing_constants())
    assert len(names) > 25
    assert [name for name in names if f"`{name}`" not in trials] == []
