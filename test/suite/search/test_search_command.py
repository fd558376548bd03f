"""`sfr suite search` on small simulated drives: the found case, its repetition, and invalid files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml

from helpers.cli_result import Sfr, run_sfr
from helpers.made_suites import SMALL_DRIVE, stamps_of

pytest.importorskip("optuna")
LIMIT_M = 0.05
SEARCH = {
    "scenario": "scenario.yaml",
    "set": SMALL_DRIVE,
    "ranges": {
        "baseline": {"fault": "baseline", "range": [0.8, 1.2]},
        "shift": {"fault": "shift", "range": [-0.2, 0.2]},
    },
    "condition": "frames=4",
    "limit": LIMIT_M,
    "points": 4,
    "seed": 4,
    "slices": 2,
    "running": {"spacing": 2},
}


class Searched(NamedTuple):
    file: Path
    out: Path
    result: dict[str, Any]  #: Content of `search.json`.


def written(folder: Path, content: dict[str, object]) -> Path:
    (folder / "scenario.yaml").write_text("{}\n")
    (folder / "search.yaml").write_text(yaml.safe_dump(content))
    return folder / "search.yaml"


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory, scheduler: str) -> Searched:
    """Run a search that finds a miss of the limit."""
    folder = tmp_path_factory.mktemp("search")
    file, out = written(folder, SEARCH), folder / "out"
    done = run_sfr("suite", "search", file, "--out", out, "--scheduler", scheduler, "--json", "-")
    assert done.code == 1, done.err
    return Searched(file, out, json.loads(done.out))


@pytest.mark.slow
def test_a_search_finds_a_baseline_that_misses_the_limit(searched: Searched) -> None:
    result = searched.result
    assert result["schema"] == "sfr-search/2"
    assert result["case"]["ratio"] >= 1.0 > result["usual"]["ratio"]
    assert abs(result["case"]["point"]["baseline"] - 1.0) > 0.02
    assert "Worst case" in (searched.out / "search.html").read_text()


@pytest.mark.slow
def test_a_repeated_search_has_the_same_result_and_runs_no_job(sfr: Sfr, searched: Searched) -> None:
    before = stamps_of(searched.out)
    again = sfr("suite", "search", searched.file, "--out", searched.out, "--workers", 2, "--json", "-")
    assert json.loads(again.out) == searched.result
    assert stamps_of(searched.out) == before


@pytest.mark.slow
def test_the_case_of_a_search_misses_the_limit_with_the_same_ratio_as_a_suite(
    sfr: Sfr, searched: Searched, tmp_path: Path, scheduler: str
) -> None:
    words = ("--out", tmp_path / "out", "--scheduler", scheduler, "--json", "-")
    case = sfr("suite", "run", searched.out / "case.yaml", *words)
    assert case.code == 1, "the case misses the limit of the search"
    (group,) = json.loads(case.out)["groups"]
    value = next(row["mean_plus_3sigma"] for row in group["figures"] if row["figure"] == "position")
    assert value / LIMIT_M == pytest.approx(searched.result["case"]["ratio"], rel=1e-6)


@pytest.mark.parametrize(
    "change",
    [{"ranges": {"sky": [0, 1]}}, {"figure": "speed"}, {"ranges": {"terrain.slope_deg": [9, 1]}}, {"batch": 1}],
    ids=["unknown_setting", "unknown_figure", "reversed_range", "only_uniform_points"],
)
def test_an_invalid_search_is_refused(sfr: Sfr, tmp_path: Path, change: dict[str, object]) -> None:
    assert sfr("suite", "search", written(tmp_path, SEARCH | change), "--out", tmp_path / "out").code == 2
