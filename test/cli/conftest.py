"""Makes the helpers beside the tests importable, and runs `sfr` within the test's process."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from cli_result import Result, Sfr

from sfr_loc_map.cli.main import main


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Callable[[Path], Path]], Path]:
    """`made_once(make)`: the source that `make` writes, made once for all tests, which only read it."""
    made: dict[str, Path] = {}

    def source(make: Callable[[Path], Path]) -> Path:
        if make.__name__ not in made:
            made[make.__name__] = make(tmp_path_factory.mktemp(make.__name__) / "source")
        return made[make.__name__]

    return source


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
