"""Calls that were measured on a target, by `sfr score --target`: they belong to the estimate and to its method."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.cli_result import Sfr
from helpers.judge import POSES, Judge
from helpers.scored_drives import COUNT, PERIOD_NS, POSITION, limits, write_calls_of


@pytest.mark.clause("4.2.1")
def test_times_of_a_target_belong_to_the_estimate_by_stamp(judge: Judge) -> None:
    few = judge.calls(judge.estimate.stamps_ns[:50])
    result, score = judge("--target", "board", "--target-timing", few)
    assert (result.code, score["target"]["matched_share"]) == (0, 50 / POSES)
    assert "the times of board cover only 12.5 % of the estimates" in result.err
    other = ("--target", "board", "--target-timing", judge.calls(range(5, 55)))
    result, _ = judge(*other)
    assert result.code == 2
    assert "another run" in result.err.splitlines()[-1]
    result, score = judge(*other, "--target-run", "Tuesday")
    assert (result.code, score["target"]["other_run"]) == (0, "Tuesday")
    assert "another run: Tuesday" in result.err
    assert judge("--target-run", "Tuesday")[0].code == 2  # of no target


def test_times_on_a_target_without_stamps_are_of_no_known_pair(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr
) -> None:
    rules = limits(tmp_path, {**POSITION, "target": {"localisation_max_s": 1.0}})
    times = tmp_path / "times.csv"
    for stamps, code in ((range(COUNT), 0), (None, 3), (range(1, COUNT + 1), 3)):
        rows = ["stamp_ns,processing_time_s,state", *(f"{row * PERIOD_NS},0.1,tracking" for row in stamps or ())]
        if stamps is None:
            rows = ["processing_time_s,state", *["0.1,tracking"] * COUNT]
        times.write_text("\n".join(rows) + "\n")
        options = ["--target", "GR740", "--target-timing", times, "--target-run", "of the kit", "--limits", rules]
        assert sfr("score", *files, *options).code == code, code


ON_TARGET = {"target": {"localisation_p95_s": 1.0}}


def test_times_of_a_target_are_stated_by_its_file(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    timing, score, page = write_calls_of(tmp_path / "t.csv", "mine"), tmp_path / "s.json", tmp_path / "r.html"
    options = ("--limits", limits(tmp_path, {**POSITION, **ON_TARGET}), "--json", score)
    assert sfr("score", *files, *options, "--target", "board", "--target-timing", timing).code == 0
    sfr("report", score, "--test-report", page)
    for text in ("was stated by the file of the target", "The calls on the target have no positions"):
        assert text in page.read_text()


def test_what_a_method_did_wrong_on_the_target_counts(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    rules = limits(tmp_path, ON_TARGET)
    good, bad = (
        write_calls_of(tmp_path / f"{number}.csv", "mine", finding)
        for number, finding in enumerate(("", "leaking: its memory grows"))
    )
    for timing, code in ((good, 0), (bad, 1)):
        done = sfr("score", *files, "--limits", rules, "--target", "board", "--target-timing", timing)
        assert done.code == code, done.err
    assert "the method failed: leaking" in done.err


def test_times_on_a_target_are_of_the_method_that_gave_the_poses(
    tmp_path: Path, files: tuple[Path, Path], sfr: Sfr
) -> None:
    rules, stats = limits(tmp_path, ON_TARGET), write_calls_of(tmp_path / "calls.csv", "mine")
    for name, code in (("mine", 0), ("other", 2)):
        timing = write_calls_of(tmp_path / f"{name}.csv", name)
        options = ("--stats", stats, "--target", "board", "--target-timing", timing)
        done = sfr("score", *files, "--limits", rules, *options)
        assert done.code == code, done.err
    assert "give the calls of one method" in done.err


@pytest.mark.parametrize("text", ["[1]", "{}", "no JSON", '{"schema": "sfr-target/1", "board": 5}'])
def test_what_a_target_says_of_itself_is_refused_in_one_line(judge: Judge, text: str) -> None:
    judge.calls(judge.estimate.stamps_ns, "stats.csv")
    (judge.folder / "target.json").write_text(text)
    result = judge.sfr("score", judge.folder, judge.poses("truth.csv", judge.truth))
    assert result.code == 2
    assert result.err.count("\n") == 1
    assert "target" in result.err


def test_a_score_has_the_calls_of_one_method(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """The mapping call of another method would count as a call of the method that gave the poses."""
    rules = limits(tmp_path, {**POSITION, "timing": {"mapping_call_s": 1.0}})
    stats, mapping = write_calls_of(tmp_path / "calls.csv", "mine"), tmp_path / "mapping.csv"
    for name, code in (("mine", 3), ("other", 2)):  # the mapping pairs of these files are unknown
        header = "stamp_ns,processing_time_s,state,method,method_version,method_kind"
        mapping.write_text(f"{header}\n0,0.1,mapped_set,{name},1,python\n")
        done = sfr("score", *files, "--limits", rules, "--stats", stats, "--stats", mapping)
        assert done.code == code, done.err
    assert "come from 2 methods (mine 1, other 1): give the calls of one method" in done.err


def test_a_score_has_the_calls_of_one_configuration(tmp_path: Path, files: tuple[Path, Path], sfr: Sfr) -> None:
    """The calls of a second configuration would count as calls of the first."""
    header = "stamp_ns,processing_time_s,state,method,method_version,method_kind,method_config_sha256"
    paths = []
    for number, (state, configuration) in enumerate((("tracking", "a"), ("tracking", "b"), ("mapped_set", "c"))):
        paths.append(tmp_path / f"calls_{number}.csv")
        paths[-1].write_text(f"{header}\n{number},0.1,{state},mine,1,python,{configuration * 64}\n")
    done = sfr("score", *files, "--stats", paths[0], "--stats", paths[1])
    assert done.code == 2
    assert "the localisation calls (--stats) come from 2 configurations of the method mine 1: give" in done.err
    assert sfr("score", *files, "--stats", paths[0], "--stats", paths[2]).code != 2, "the mapper has its own settings"
