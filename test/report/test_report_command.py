"""`sfr report`: the page beside the score, tables in each format, and refused names."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from helpers.made_scores import whole_score
from sfr_loc_map.cli.main import app
from sfr_loc_map.errors import ConfigError, InputError, OutputError
from sfr_loc_map.metrics.stored.score_json import to_json


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


@pytest.mark.parametrize(
    ("options", "refused"),
    [
        (("--truth", "truth.csv"), "--truth"),
        (("--align", "se3"), "--align"),
        (("--title", "A test"), "--title"),
        (("--junit", "v.xml", "--number", "TR-7"), "--number"),
        (("--junit", "v.xml", "--json", "all.json"), "--json"),
        (("--control", "v.csv", "-o", "page.html"), "--output"),
    ],
)
def test_an_option_without_effect_is_refused_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], refused: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("score.json").write_text(to_json(whole_score()))
    result = CliRunner().invoke(app, ["report", "score.json", *options])
    assert isinstance(result.exception, ConfigError)
    assert str(result.exception).startswith(f"'{refused}' ")
    assert [path.name for path in tmp_path.iterdir()] == ["score.json"]


def test_a_folder_that_is_no_suite_is_named_beside_a_suite(tmp_path: Path) -> None:
    for name in ("suite", "other"):
        (tmp_path / name).mkdir()
    (tmp_path / "suite" / "plan.json").write_text("{}")
    words = ["report", str(tmp_path / "suite"), str(tmp_path / "other"), "--json", str(tmp_path / "o.json")]
    result = CliRunner().invoke(app, words)
    assert isinstance(result.exception, ConfigError)
    assert f"'{tmp_path / 'other'}' is not" in str(result.exception)


def test_a_comparison_of_suites_is_a_page(tmp_path: Path) -> None:
    for name in ("before", "after"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "plan.json").write_text("{}")
    words = ["report", str(tmp_path / "before"), str(tmp_path / "after"), "-o", str(tmp_path / "page.md")]
    result = CliRunner().invoke(app, words)
    assert isinstance(result.exception, OutputError)
    assert "a name that ends in" in str(result.exception)


def test_a_score_that_is_given_twice_is_refused(tmp_path: Path) -> None:
    score, report = tmp_path / "score.json", tmp_path / "t.html"
    score.write_text(to_json(whole_score()))
    result = CliRunner().invoke(app, ["report", str(score), str(score), "--test-report", str(report)])
    assert isinstance(result.exception, ConfigError)
    assert not report.exists()


def test_refused_evidence_leaves_no_other_output(tmp_path: Path) -> None:
    score, evidence = tmp_path / "score.json", tmp_path / "evidence.json"
    score.write_text(to_json(whole_score()))
    evidence.write_text("{}")
    outputs = [str(tmp_path / name) for name in ("report.html", "verdicts.xml")]
    words = ["report", str(score), "--test-report", outputs[0], "--junit", outputs[1], "--evidence", str(evidence)]
    assert isinstance(CliRunner().invoke(app, words).exception, InputError)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["evidence.json", "score.json"]
