"""Methods under test that misbehave have no pass, and cheaters no truth; all of them: `make misbehaviour`."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_result import Sfr
from misbehaviour import CASES, Case, differences, run_case

DAILY = [case for case in CASES if case.daily]


@pytest.mark.parametrize("case", DAILY, ids=[case.config.replace(" ", "-") for case in DAILY])
def test_what_misbehaves_is_named_and_does_not_pass(case: Case, tmp_path: Path, sfr: Sfr, faulty: Path) -> None:
    outcome = run_case(case, tmp_path, sfr, faulty)
    assert not differences(case, outcome), outcome.said
    if case.kind == "class":
        assert outcome.score["method"]["isolation"] == "files, processes, shared memory"
