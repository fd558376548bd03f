"""Score files that were edited, with verdicts that follow from the edited figures: the rest of the file says so."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from helpers.cli_result import Sfr
from helpers.straight_drive import COUNT, PERIOD_NS, POSITION, limits
from sfr_loc_map.metrics.judging.judge import judged_again
from sfr_loc_map.metrics.score_json import decoded, to_json

Edit = Callable[[dict[str, Any]], None]


def without_errors(score: dict[str, Any]) -> None:
    score["errors"] = []
    score["details"] = None


def without_other_frames(score: dict[str, Any]) -> None:
    score["figures"] = [row for row in score["figures"] if row.get("part") != "other frames"]


def without_lost(score: dict[str, Any]) -> None:
    for row in score["figures"]:
        if row["figure"] == "lost":
            row["value"] = 0.0


def without_copies(score: dict[str, Any]) -> None:
    score["figures"] = [row for row in score["figures"] if row["figure"] != "poses_of_truth"]


def without_missing(score: dict[str, Any]) -> None:
    score["figures"] = [row for row in score["figures"] if row["figure"] != "missing"]


def partly_judged(score: dict[str, Any]) -> None:
    for row in score["figures"]:
        if (row["figure"], row.get("part")) == ("judged", "drive"):
            row["value"] = 0.8


def looser(score: dict[str, Any]) -> None:
    score["rules"]["limits"][0]["limit"] = 99.0


def with_fewer_independent(score: dict[str, Any]) -> None:
    score["rules"]["minimum_independent"] = 1.0


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (without_errors, "is limited, but its errors are absent"),
        (without_other_frames, "is limited, but the row position other frames is absent"),
        (without_lost, "lost is 0, of the frames 10 are"),
        (without_copies, "but the row poses_of_truth is absent"),
        (without_missing, "but the row missing is absent"),
        (partly_judged, "judged drive is 0.8, from what is absent follows 1"),
        (looser, "its limits are not those of"),
        (with_fewer_independent, "its limits are not those of"),
    ],
)
def test_an_edited_file_is_refused(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr, edit: Edit, said: str) -> None:
    stats, made, page = tmp_path / "calls.csv", tmp_path / "s.json", tmp_path / "p.html"
    rows = [f"{row * PERIOD_NS},0.1,{'lost' if row < 10 else 'tracking'}" for row in range(COUNT)]
    stats.write_text("\n".join(["stamp_ns,processing_time_s,state", *rows]) + "\n")
    rules = limits(tmp_path, POSITION)
    assert sfr("score", *files, "--limits", rules, "--stats", stats, "--json", made).code == 0
    assert sfr("report", made, "-o", page).code == 0
    content = json.loads(made.read_text())
    edit(content)
    made.write_text(to_json(judged_again(decoded(json.dumps(content)))))
    done = sfr("report", made, "-o", page, "--overwrite")
    assert (done.code, said in done.err) == (2, True), done.err


def test_limits_whose_file_is_absent_or_changed_are_reported(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr
) -> None:
    made, page, rules = tmp_path / "s.json", tmp_path / "p.html", limits(tmp_path, POSITION)
    assert sfr("score", *files, "--limits", rules, "--json", made).code == 0
    assert "were not compared" not in sfr("report", made, "-o", page).err
    rules.write_text(rules.read_text() + "# later\n")
    assert "were not compared" in sfr("report", made, "-o", page, "--overwrite").err
    rules.unlink()
    done = sfr("report", made, "-o", page, "--overwrite")
    assert (done.code, "were not compared" in done.err) == (0, True)
    table = tmp_path / "control.csv"
    sfr("report", made, "--test-report", page, "--control", table, "--overwrite")
    assert all("were not compared" in path.read_text() for path in (page, table)), "a deviation"
