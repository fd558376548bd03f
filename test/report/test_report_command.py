"""`sfr report`: the page beside the score, tables, names that are refused."""

from pathlib import Path

from typer.testing import CliRunner

from helpers.made_scores import whole_score
from sfr_loc_map.cli.main import app
from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.metrics.score_json import to_json


def test_page_and_tables_in_each_format(tmp_path: Path) -> None:
    score, run = tmp_path / "report.json", CliRunner().invoke
    score.write_text(to_json(whole_score()))
    assert run(app, ["report", str(score)]).exit_code == 1  # one of its limits is missed
    assert (tmp_path / "report.html").read_text().startswith("<!DOCTYPE html>")
    for name, start in (("r.md", "# Score"), ("r.csv", "table,row,column,key,value"), ("r.html", "<!DOC")):
        assert run(app, ["report", str(score), "-o", str(tmp_path / name)]).exit_code == 1
        assert (tmp_path / name).read_text().startswith(start)
    assert isinstance(run(app, ["report", str(score), "-o", "report.pdf"]).exception, OutputError)


def test_a_missing_score_leaves_nothing(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["report", str(tmp_path / "none.json")])
    assert isinstance(result.exception, InputError)
    assert list(tmp_path.iterdir()) == []
