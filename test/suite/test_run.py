"""`run_suite` gives the same results from Python as the command, and runs no job twice."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.made_suites import made_suite
from sfr_loc_map.suite import Store, load_specification, run_suite

pytest.importorskip("distributed", reason="needs the extra [suite]")
LIMITS = {"trajectory": [{"condition": "distance=1", "position_mean_plus_3sigma_m": 1.0}]}


@pytest.mark.slow
def test_a_suite_is_run_from_python(tmp_path: Path) -> None:
    specification = load_specification(made_suite(tmp_path / "made", 2, limits=LIMITS))
    store = Store(tmp_path / "out")
    steps: list[tuple[int, int, str | None]] = []

    def summary_of_run() -> tuple[str | None, int]:
        steps.clear()
        summary = run_suite(
            specification,
            store,
            workers=1,
            progress=lambda done, total, last: steps.append((done, total, None if last is None else last[0].label)),
        )
        return summary.verdict, len(summary.results)

    assert summary_of_run() == ("pass", 2)
    assert [step[:2] for step in steps] == [(0, 2), (1, 2), (2, 2)]
    assert (tmp_path / "out/report.html").is_file()
    assert summary_of_run() == ("pass", 2)
    assert not steps, "nothing is run twice"
