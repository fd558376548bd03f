"""`sfr live` of a recording: what cannot be played is said in one line."""

from pathlib import Path

import pytest
from cli_result import Sfr


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [(["nowhere"], "nowhere"), (["empty"], "empty"), (["--rate", "2"], "--rate"), (["--truth", "empty"], "--truth")],
)
def test_what_cannot_be_played_is_refused(
    arguments: list[str], expected: str, sfr: Sfr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    result = sfr("live", "--terminal", *arguments)
    assert result.code == 2
    assert expected in result.err
    assert result.err.count("\n") == 1
