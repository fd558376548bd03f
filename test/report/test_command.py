from pathlib import Path

import pytest
from made_scores import whole_score
from typer.testing import CliRunner

from sfr_loc_map.cli.main import app
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.metrics.score_json import to_json

RUNNER = CliRunner()


@pytest.fixture
def score(tmp_path: Path) -> Path:
    path = tmp_path / "report.json"
    path.write_text(to_json(whole_score()))
    return path


def test_page_beside_the_score(score: Path) -> None:
    result = RUNNER.invoke(app, ["report", str(score)])
    assert result.exit_code == 0
    assert (score.parent / "report.html").read_text().startswith("<!DOCTYPE html>")


@pytest.mark.parametrize(
    ("form", "start"), [("md", "# Score"), ("csv", "table,row,column,key,value"), ("pdf-ready", "<!DOC")]
)
def test_tables_on_standard_output(score: Path, form: str, start: str) -> None:
    assert RUNNER.invoke(app, ["report", str(score), "--format", form]).stdout.startswith(start)


def test_the_ending_says_the_format(score: Path) -> None:
    RUNNER.invoke(app, ["report", str(score), "-o", str(score.with_suffix(".csv"))])
    assert score.with_suffix(".csv").read_text().startswith("table,")


@pytest.mark.parametrize(
    ("arguments", "error"),
    [(["--format", "pdf"], SystemExit), (["-o", "report.pdf"], ConfigError), (["-o", "absent/report"], ConfigError)],
)
def test_bad_options(score: Path, arguments: list[str], error: type[BaseException]) -> None:
    assert isinstance(RUNNER.invoke(app, ["report", str(score), *arguments]).exception, error)


def test_missing_score(tmp_path: Path) -> None:
    result = RUNNER.invoke(app, ["report", str(tmp_path / "none.json")])
    assert isinstance(result.exception, InputError)
    assert list(tmp_path.iterdir()) == []
