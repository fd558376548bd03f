"""Content of files and names in messages is escaped: messages are printable and bounded."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from helpers.cli_result import Result, Sfr

CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
ESCAPE = "\x1b]0;taken over\x07\x1b[31m"
HEADER = "stamp_ns,rbOriginPos_m_Ds_x,rbOriginPos_m_Ds_y,rbOriginPos_m_Ds_z," + ",".join(
    f"att_q_DsToRb_{i}" for i in (1, 2, 3, 4)
)


def check_line(result: Result) -> None:
    assert result.code == 2
    assert result.err.count("\n") == 1
    assert len(result.err) < 700
    assert not CONTROL.search(result.err)
    assert "fault of the program" not in result.err


@pytest.mark.parametrize(
    "text", [ESCAPE, "x" * 1_000_000, "\0", "\udcff"], ids=["escape", "megabyte", "nul", "surrogate"]
)
def test_an_error_quotes_a_file_in_one_printable_line(text: str, tmp_path: Path, sfr: Sfr) -> None:
    file = tmp_path / "t.csv"
    file.write_text(f"{HEADER}\n{text},0,0,0,0,0,0,1\n", encoding="utf-8", errors="surrogateescape")
    check_line(sfr("score", file, file))
