"""`sfr replay --external`: a node of another supplier replaces the localisation node over topics."""

# ruff: noqa: E402 - ROS may be absent
from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]

import psutil

from campaigns.misbehaviour import CASES, differences, run_case
from helpers import HELPERS, ROOT
from helpers.cli_result import Sfr
from helpers.made_scene import write_folder
from helpers.processes import Process
from helpers.score_rows import number, rows_about

COMMAND = ("-m", "sfr_loc_map")
NODE = HELPERS / "faulty_external_node.py"
PAIRS = 16
OF_CALLS = {"calls", "memory", "localisation"}  #: Words of the rows about calls.
CONVENTION = ["--convention", "frame=left_optical", "--convention", "world=first_pose"]
SCORED = ["--condition", "frames=2"]


@pytest.mark.slow
def test_a_faulty_node_of_the_optical_frame_is_scored_and_each_fault_named(sfr: Sfr, tmp_path: Path) -> None:
    source, out = write_folder(tmp_path / "source", PAIRS, 0), tmp_path / "out"
    options = ["--external", "localisation", "--command", f"{sys.executable} {NODE}", "--answer-timeout", "2"]
    words = ["replay", str(source), *options, *CONVENTION, *SCORED, "--out", str(out)]
    with Process(tmp_path / "log", *COMMAND, *words) as replay:
        code = replay.popen.wait(150)
    assert code == 1, replay.text
    assert "the method failed: crashed, not finite; incomplete data (" in replay.text
    assert replay.text.count("the estimate covers 56.25 % of the images") == 1
    score = json.loads((out / "report.json").read_text())
    assert score["method"] == {"name": "external_odometry", "version": "1.0", "kind": "external"}
    counts = score["external"]["answers"]
    # 11 pairs reached the node before it crashed at the 12th: the doubled one is answered, two others are not
    assert counts == {
        "pairs": PAIRS,
        "answered": 9,
        "missing": PAIRS - 9,
        "early": 0,
        "late": 0,
        "doubled": 1,
        "other_stamp": 0,
        "other_frame": 1,
        "not_usable": 1,
    }
    assert score["external"]["frames"] == "start -> camera"
    assert score["external"]["ended"] == "ended with exit code 3: out of memory, as it were"
    assert 0.0 < score["external"]["latency_s"]["p50"] < 2.0
    assert score["external"]["process"]["peak_rss_bytes"] > 1e7
    assert number(score, "peak", part="localisation") == score["external"]["process"]["peak_rss_bytes"]
    assert "to the answer" in score["calls"]["clocks"]["localisation"]
    assert number(score, "localisation", "p50") == score["external"]["latency_s"]["p50"]
    assert number(score, "localisation", "p50", part="stated") < number(score, "localisation", "p50")
    kinds = {finding["kind"] for finding in score["findings"]}
    assert kinds == {"crashed", "doubled answer", "another frame", "not finite", "missing answer"}
    for kind in kinds:
        assert f"method external_odometry: {kind}" in replay.text
    assert sfr("report", out / "report.json", "-o", tmp_path / "page.html").code == 1  # a failure, no refusal
    # the same trajectory, converted offline as declared
    published = out / "estimate_as_published.csv"
    words = ["score", published, source, *CONVENTION, *SCORED, "--json", tmp_path / "offline.json", "--overwrite"]
    assert [sfr(*words).code, sfr(*words, "--partial").code] == [3, 0]
    offline = json.loads((tmp_path / "offline.json").read_text())
    of_drive = [item for item in rows_about(score, "completeness") if not OF_CALLS & {*str(item.get("part")).split()}]
    states = ("lost", "degraded")  # the calls of the node tell them, the file of its poses does not: null there
    in_file = [{key: row[key] for key in row if key != "value" or row["figure"] not in states} for row in of_drive]
    assert rows_about(offline, "completeness") == in_file
    assert "the truth is here" not in (out / "external.log").read_text()
    for name in ("position", "attitude", "heading"):
        assert number(score, name, "mean") == pytest.approx(number(offline, name, "mean"), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["early", "restarts"])
def test_no_answer_counts_before_its_question_or_of_a_node_that_crashed(
    sfr: Sfr, tmp_path: Path, own_domain: None, how: str
) -> None:
    (case,) = [item for item in CASES if item.config == how]
    outcome = run_case(case, tmp_path, sfr)
    assert not differences(case, outcome), outcome.said


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--command", "true"], "applies only to an external node"),
        (["--convention", "frame=left"], "applies only to an external node"),
        (["--external", "localisation", "--method", "sfr"], "contradicts --external"),
        (["--external", "mapping"], "the source has no pairs for this task"),
        (["--external", "localisation", "--command", "no-such-program-here"], "cannot start 'no-such-program-here'"),
    ],
)
def test_options_that_cannot_be_are_one_line(sfr: Sfr, tmp_path: Path, words: list[str], problem: str) -> None:
    result = sfr("replay", write_folder(tmp_path / "source", 2, 0), *words)
    assert result.code == 2
    (line,) = result.err.strip().splitlines()
    assert problem in line


@pytest.mark.slow
def test_a_node_that_forks_twice_is_measured_and_ended(sfr: Sfr, tmp_path: Path, own_domain: None) -> None:
    source, out, page = write_folder(tmp_path / "source", PAIRS, 0), tmp_path / "out", tmp_path / "r.html"
    node = f"{sys.executable} {HELPERS / 'misbehaving_node.py'} forks"
    ran = sfr("replay", source, "--external", "localisation", "--command", node, *SCORED, "--out", out)
    assert (out / "report.json").exists(), ran.err
    score = json.loads((out / "report.json").read_text())
    assert score["external"]["process"]["peak_rss_bytes"] > 4e8
    commands = [each.info["cmdline"] for each in psutil.process_iter(["cmdline"])]
    assert node.split() not in commands, "the orphan was left behind"
    sfr("report", out / "report.json", "--test-report", page)
    assert "The external node was not isolated" in page.read_text()


@pytest.mark.slow
def test_the_memory_of_an_unrelated_process_is_not_that_of_the_node(sfr: Sfr, tmp_path: Path, own_domain: None) -> None:
    source, out = write_folder(tmp_path / "source", PAIRS, 0), tmp_path / "out"
    sleep, node = ("-c", "import time; time.sleep(600)"), str(ROOT / "examples" / "external_node.py")
    with Process(tmp_path / "sleep.log", *sleep) as sleeping, Process(tmp_path / "node.log", node):
        pid = sleeping.popen.pid
        watch = ("--watch", pid, "--answer-timeout", "4")
        ran = sfr("replay", source, "--external", "localisation", *watch, *CONVENTION, *SCORED, "--out", out)
    assert ran.code == 2, ran.err
    assert f"'--watch {pid}': the publisher of localisation/odometry belongs to another process" in ran.err
    if (out / "stats.csv").is_file():
        assert ",built-in," not in (out / "stats.csv").read_text(), "the poses are not those of our localiser"
