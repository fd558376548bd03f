"""Score files that were edited are refused: verdicts that do not follow from figures, rows that are absent."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from helpers.cli_result import Sfr
from helpers.judge import OVER_5_M, Judge
from helpers.scored_drives import COUNT, PERIOD_NS, POSITION, limits
from sfr_loc_map.metrics.judging.judge import with_verdicts
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import from_plain, to_json

Edit = Callable[[dict[str, Any]], None]


def without_errors(score: dict[str, Any]) -> None:
    score["errors"] = []
    score["details"]["trajectory"] = None


def without_calls(score: dict[str, Any]) -> None:
    score["details"]["calls"] = {}


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


def without_share_of_doubled(score: dict[str, Any]) -> None:
    row = next(row for row in score["figures"] if row["figure"] == "doubled" and "part" not in row)
    row["value"] = None


def looser(score: dict[str, Any]) -> None:
    score["rules"]["limits"][0]["limit"] = 99.0


def with_fewer_independent(score: dict[str, Any]) -> None:
    score["rules"]["minimum_independent"] = 1.0


def score_with_calls(folder: Path, files: tuple[Path, Path], sfr: Sfr) -> Path:
    """Write the score of a drive with calls and limits that it meets."""
    stats, made = folder / "calls.csv", folder / "s.json"
    rows = [f"{row * PERIOD_NS},0.1,{'lost' if row < 10 else 'tracking'}" for row in range(COUNT)]
    stats.write_text("\n".join(["stamp_ns,processing_time_s,state", *rows]) + "\n")
    rules = limits(folder, {**POSITION, "timing": {"localisation_p95_s": 1.0}})
    assert sfr("score", *files, "--limits", rules, "--stats", stats, "--json", made).code == 0
    assert sfr("report", made, "-o", folder / "p.html").code == 0
    return made


def test_an_edited_file_is_refused(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    made = score_with_calls(tmp_path, files, sfr)
    given = made.read_text()
    edits = (without_errors, without_calls, without_other_frames, without_lost, without_copies, without_missing)
    for edit in (*edits, partly_judged, without_share_of_doubled, looser, with_fewer_independent):
        content = json.loads(given)
        edit(content)
        made.write_text(json.dumps(content))
        done = sfr("report", made, "-o", tmp_path / "p.html", "--overwrite")
        assert (done.code, "contradicts itself" in done.err) == (2, True), (edit.__name__, done.err)


@pytest.mark.parametrize("edit", [looser, with_fewer_independent])
def test_limits_are_compared_with_their_file(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr, edit: Edit) -> None:
    """The file has a new hash, and its verdicts follow from the edited limits."""
    made = score_with_calls(tmp_path, files, sfr)
    content = json.loads(made.read_text())
    edit(content)
    made.write_text(to_json(with_verdicts(from_plain(Score, content))))
    done = sfr("report", made, "-o", tmp_path / "p.html", "--overwrite")
    assert (done.code, "its limits differ from those in its limits file" in done.err) == (2, True), done.err


def edited(score: dict[str, Any], place: str, value: Any) -> dict[str, Any]:
    """A score with another value at a place, such as `verdicts.0.verdict`."""
    made = json.loads(json.dumps(score))
    at, names = made, place.split(".")
    for name in names[:-1]:
        at = at[int(name)] if isinstance(at, list) else at[name]
    last = int(names[-1]) if isinstance(at, list) else names[-1]
    if value is None:
        del at[last]
    else:
        at[last] = value
    return made


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        ("verdicts.0.verdict", "pass", "verdict of the verdict on position_mean_plus_3sigma_m is 'pass'"),
        ("verdicts.0.value", 0.0005, "value of the verdict on position_mean_plus_3sigma_m is 0.0005"),
        ("verdicts.0.limit", 1.0, "limit of the verdict on position_mean_plus_3sigma_m is 1"),
        ("verdict", "pass", "verdict is 'pass', but the figures give 'fail'"),
        ("rules.limits.0.limit", 1.0, "limit of the verdict on position_mean_plus_3sigma_m is 0.001"),
        ("rules.limits.0.name", "position_mean_m", "name of the verdict on position_mean_plus_3sigma_m is"),
        ("rules.limits.0.name", "position_mode_m", "'position_mode_m' is not a limit of the section 'trajectory'"),
        ("rules.limits.0.condition", "distance=-5", "'distance=-5' is not a condition"),
        ("rules.limits", None, "it has 1 verdicts, but its figures and limits give 0"),
        ("figures.0.mean_plus_3sigma", 0.0005, "|mean| + 3 sigma is"),
        ("verdicts.0", None, "it has 0 verdicts, but its figures and limits give 1"),
    ],
)
def test_a_verdict_that_was_edited_is_refused_and_named(judge: Judge, place: str, value: Any, said: str) -> None:
    result, score = judge(limits=OVER_5_M + "0.001\n")
    assert result.code == 1
    path = judge.folder / "edited.json"
    path.write_text(json.dumps(edited(score, place, value)))
    for options in (("-o", judge.folder / "p.html"), ("--test-report", judge.folder / "t.html")):
        result = judge.sfr("report", path, *options, "--overwrite")
        assert result.code == 2
        assert said in result.err
        assert result.err.count("\n") == 1
    path.write_text(json.dumps(score))
    assert judge.sfr("report", path, "--overwrite").code == 1  # exits as the verdict


def test_a_score_without_its_rows_of_completeness_is_incomplete(judge: Judge) -> None:
    _, score = judge(limits=OVER_5_M + "1\n")
    assert score["verdict"] == "pass"
    of_drive = [row for row in score["figures"] if row["subject"] != "completeness"]
    beside = [row for row in score["figures"] if row["figure"] in ("errors_beyond", "standing")]
    path = judge.folder / "edited.json"
    for kept, words in ((of_drive, "limits give 2"), ([*of_drive, *beside], "limits give 2")):
        path.write_text(json.dumps({**score, "figures": kept}))
        result = judge.sfr("report", path, "--overwrite")
        assert result.code == 2
        assert words in result.err


@pytest.mark.parametrize("changed", ["estimate", "truth", "limits"])
def test_a_score_whose_inputs_were_changed_since_does_not_pass(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr, changed: str
) -> None:
    made, page, rules = tmp_path / "s.json", tmp_path / "p.html", limits(tmp_path, POSITION)
    assert sfr("score", *files, "--limits", rules, "--json", made).code == 0
    paths = dict(zip(("estimate", "truth", "limits"), (*files, rules), strict=True))
    content = paths[changed].read_text()
    paths[changed].write_text(content.replace("5", "4"))
    documents = ("--test-report", page, "--junit", tmp_path / "j.xml", "--control", tmp_path / "c.csv", "--overwrite")
    for options in (("-o", page, "--overwrite"), documents):
        done = sfr("report", made, *options)
        assert (done.code, "was changed since the score was made" in done.err) == (3, True), done.err
    assert 'failures="0" errors="0"' not in (tmp_path / "j.xml").read_text()
    other = tmp_path / "other.json"
    other.write_text(made.read_text())
    assert sfr("report", made, other).code == 0, "a comparison of two scores is not judged"
    paths[changed].write_text(content)
    assert sfr("report", made, *documents).code == 0


def test_limits_whose_file_is_absent_are_reported(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    made, page, rules = tmp_path / "s.json", tmp_path / "p.html", limits(tmp_path, POSITION)
    assert sfr("score", *files, "--limits", rules, "--json", made).code == 0
    rules.write_text(rules.read_text() + "# later\n")
    done = sfr("report", made, "-o", page)
    assert (done.code, "warning" in done.err) == (0, False), "the same limits in another layout"
    rules.unlink()
    done = sfr("report", made, "-o", page, "--overwrite")
    assert (done.code, "were not compared" in done.err) == (0, True)
    table = tmp_path / "control.csv"
    sfr("report", made, "--test-report", page, "--control", table, "--overwrite")
    assert all("were not compared" in path.read_text() for path in (page, table)), "a deviation"


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("findings", [], "its values were changed"),
        ("warnings", ["none"], "its values were changed"),
        ("details", None, "its values were changed"),
        ("truth", None, "its values were changed"),
        ("content_sha256", None, "has no content_sha256"),
        ("content_sha256", "0", "its values were changed"),
    ],
)
def test_a_value_that_no_verdict_depends_on_is_covered_by_the_hash(
    judge: Judge, name: str, value: Any, said: str
) -> None:
    """A finding that prevents no pass is deleted, or a warning, the plots, the record of the truth or the hash."""
    stamps = judge.estimate.stamps_ns
    rows = [f"{stamp},0.1,tracking,mine,1,python,late answer: slow" for stamp in stamps]
    stats = judge.folder / "calls.csv"
    header = "stamp_ns,processing_time_s,state,method,method_version,method_kind,finding"
    stats.write_text("\n".join([header, *rows]) + "\n")
    _, score = judge("--stats", stats)
    assert score["findings"]
    assert score["warnings"]
    path = judge.folder / "edited.json"
    for content, code in ((dict(reversed(score.items())), 0), ({**score, name: value}, 2)):
        path.write_text(json.dumps(content, indent=2))
        done = judge.sfr("report", path, "--overwrite")
        assert done.code == code, done.err
    assert said in done.err
