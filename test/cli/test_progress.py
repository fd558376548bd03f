"""Progress of a long command if its standard error is not a terminal."""

from __future__ import annotations

import pytest

from sfr_loc_map.cli.output import counting, progress_bar


@pytest.mark.parametrize("total", [1, 7, 10, 210, 1999])
def test_each_tenth_of_the_work_is_a_line(capsys: pytest.CaptureFixture[str], total: int) -> None:
    with progress_bar("calls") as bar:
        advance = counting(bar, "calls measured", total)
        for _ in range(total):
            advance()
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == min(total, 10)
    assert lines[-1].endswith(f"calls measured: {total} of {total}")
