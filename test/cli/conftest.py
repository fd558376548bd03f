"""Makes the helpers beside the tests importable, and runs `sfr` within the test's process."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from cli_result import Result, Sfr

from sfr_loc_map.cli.main import main


@pytest.fixture
def sfr(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Sfr:
    """`sfr(...)` as from the shell, without the cost of a process for each."""
    monkeypatch.delenv("SFR_DEBUG", raising=False)

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["sfr", *map(str, arguments)])
        capsys.readouterr()
        code = main()
        return Result(code, *capsys.readouterr())

    return run
