"""`sfr report`: the page beside the score, tables on standard output, options that are refused."""

from pathlib import Path

import pytest
from made_scores import whole_score
from typer.testing import CliRunner

from sfr_loc_map.cli.main import app
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.metrics.score_json import to_json


def test_page_and_tables_in_each_format(tmp_path: Path) -> None:
    score, run = tmp_path / "report.json", CliRunner().invoke
    score.write_text(to_json(whole_score()))
    assert run(app, ["report", str(score)]).exit_code == 0
    assert (tmp_path / "report.html").read_text().startswith("<!DOCTYPE html>")
    for form, start in (("md", "# Score"), ("csv", "table,row,column,key,value"), ("pdf-ready", "<!DOC")):
        assert run(app, ["report", str(score), "--format", form]).stdout.startswith(start)
    run(app, ["report", str(score), "-o", str(tmp_path / "r.csv")])
    assert (tmp_path / "r.csv").read_text().startswith("table,"), "the ending says the format"
    for arguments, error in ((["-o", "report.pdf"], ConfigError), (["-o", "absent/report"], ConfigError)):
        assert isinstance(run(app, ["report", str(score), *arguments]).exception, error)


@pytest.mark.parametrize(("arguments", "error"), [([], InputError), (["--format", "pdf"], SystemExit)])
def test_a_missing_score_leaves_nothing(arguments: list[str], error: type[BaseException], tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["report", str(tmp_path / "none.json"), *arguments])
    assert isinstance(result.exception, error)
    assert list(tmp_path.iterdir()) == []
