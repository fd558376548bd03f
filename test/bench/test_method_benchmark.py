"""`sfr bench localise` and `map` on small sources: accuracy, time and memory, and methods that are missing or fail."""

import json
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers import HELPERS
from helpers.cli_result import Sfr
from helpers.made_scene import NAV_RIG, loc_pair, write_folder
from helpers.score_rows import number
from sfr_loc_map.bench import method_benchmark
from sfr_loc_map.bench.figure_rows import FigureRow, medians, nested, ratios
from sfr_loc_map.bench.method_benchmark import PassResult, compare_methods, run_pass
from sfr_loc_map.bench.trials import LocaliserTrial, MapperTrial, rover_trajectory
from sfr_loc_map.errors import InputError, MethodError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.source_config import source_config
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.methods.method_call import MethodCall
from sfr_loc_map.methods.registry import OURS_IN_TABLES, Method, find_method
from sfr_loc_map.metrics.calls.call_meter import CallUsage
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.records import CallFinding, FindingKind, MethodKind
from sfr_loc_map.runs.drive_start import start_pose, true_start
from sfr_loc_map.suite_names import Task

SCORING = TrajectoryScoreConfig(conditions=("frames=3",), spacing=2)
METHOD = """
import os, sys
class MadeMethod:
    version = "7"
    def __init__(self, setup):
        print("noise on standard output")
        {start}
    def prepare(self, left, right, order):
        {prepare}
        return lambda: (int(left.sum()), int(right.sum()))
    def report(self, answer, order):
        numbers = [*answer, order["since_start_s"]]
        return {{"T_ds_rb": None, "statistics": dict(zip(("left", "right", "since_start_s"), numbers))}}
open_method = MadeMethod
"""
MAPPER = """
from weakref import WeakSet

class Result:
    def __init__(self, disparity_px):
        self.disparity_px = disparity_px

class Mapper:
    def __init__(self, rig, config):
        self.results = WeakSet()
    def process(self, pair, T_lm_navsb, index):
        self.results.add(result := Result(pair.left * 0.0 + 5.0))
        self.statistics = {"index": index, "results": len(self.results)}
        return result
    def fuse(self, results):
        raise AssertionError("a benchmark maps each pair separately")
"""


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 12 pairs and a panorama of two."""
    return write_folder(tmp_path_factory.mktemp("methods") / "source", 12, 2)


def made_method(
    folder: Path, name: str = "made", *, start: str = "pass", prepare: str = "pass", is_paced: bool = False
) -> Method:
    path = folder / f"{name}.py"
    path.write_text(METHOD.format(start=start, prepare=prepare), encoding="utf-8")
    # an absolute path stands for itself
    return Method(name, Task.LOCALISATION, MethodKind.PEER, str(path), is_paced=is_paced)


def trial_of(sequence: Any, rate_hz: float | None = None) -> LocaliserTrial:
    start = start_pose(sequence, "truth").T_ds_rb
    return LocaliserTrial(sequence=sequence, T_ds_rb=start, scoring=SCORING, rate_hz=rate_hz, hidden=())


def test_an_accuracy_is_also_computed_from_true_positions(drive: Path, tmp_path: Path, sfr: Sfr) -> None:
    (config := tmp_path / "sfr.yaml").write_text("truth: {attitude: 'no'}\n")
    loc, known = open_source(drive, source_config(drive, config)).loc, open_source(drive).truth
    assert loc is not None
    assert known is not None
    T_left_rb, T_first = loc.rig.T_rb_left.inverse(), known.pose(0)
    moves = (T_first.inverse() @ known.pose(k) for k in range(len(known)))
    poses = [T_left_rb @ move @ loc.rig.T_rb_left for move in moves]
    trial = LocaliserTrial(sequence=loc, T_ds_rb=true_start(loc).T_ds_rb, scoring=SCORING, rate_hz=None, hidden=())
    found = {row.keys: row.value for row in trial.figures(poses)}
    assert found["accuracy", "frames=3", "position_m"] is not None
    assert sfr("convert", drive, tmp_path / "pairs.sfrp", "--config", config).code == 0
    refused = sfr("bench", "faults", drive, "--config", config, "--condition", "frames=3")
    assert (refused.code, "has only positions: give a source that has true attitudes" in refused.err) == (2, True)


@pytest.mark.slow
def test_localise_shows_ours_and_opencv_with_the_accuracy_of_the_score(drive: Path, tmp_path: Path, sfr: Sfr) -> None:
    out, estimate, scored = (tmp_path / name for name in ("bench.json", "estimate.csv", "score.json"))
    options = ("--condition", "frames=3", "--spacing", 2)
    crashing = f"{HELPERS / 'aborting_class.py'}:Aborting"
    ran = sfr("bench", "localise", drive, "--repeat", 2, *options, "--method", crashing, "--json", out)
    assert ran.code == 1, "a method has failed"
    printed = ran.out
    assert "skipped: orbslam3: no interpreter was given" in printed
    assert "host times" in printed
    result = json.loads(out.read_text())
    assert list(result["failed"]) == [crashing]
    for name, metres in (("ours", 0.01), ("opencv", 0.1)):
        entry = result["entries"][name]
        assert (entry["calls"], entry["lost"], len(entry["runs"])) == (12, 0, 2)
        assert 0 < entry["accuracy"]["frames=3"]["position_m"] < metres
        assert 0 < entry["time_s"]["p50"] <= entry["time_s"]["p95"] <= entry["time_s"]["max"]
        assert 20e6 < entry["memory_bytes"]["peak"] < 1e9
    ours, other = result["entries"]["ours"], result["entries"]["opencv"]
    assert ours["runs"][0]["accuracy"] == ours["runs"][1]["accuracy"]
    assert result["ratios"]["opencv"]["time_s"]["p50"] == pytest.approx(ours["time_s"]["p50"] / other["time_s"]["p50"])
    assert sfr("localise", drive, "-o", estimate, "--start", "truth").code == 0
    assert sfr("score", estimate, drive, *options, "--json", scored).code == 0
    score = json.loads(scored.read_text())
    for name in ("position_m", "attitude_deg", "heading_deg"):
        figure = number(score, name.partition("_")[0], "mean_plus_3sigma")
        assert ours["accuracy"]["frames=3"][name] == pytest.approx(figure, rel=1e-6)


@pytest.mark.slow
def test_map_shows_ours_and_sgbm(drive: Path, tmp_path: Path, sfr: Sfr) -> None:
    assert sfr("bench", "map", drive, "--repeat", 1, "--json", tmp_path / "bench.json").code == 0
    result = json.loads((tmp_path / "bench.json").read_text())
    ours, sgbm = result["entries"]["ours"], result["entries"]["sgbm"]
    assert set(result["missing"]) == {"pandora"}
    assert ours["calls"] == sgbm["calls"] == 2
    assert min(ours["accuracy"]["coverage"], sgbm["accuracy"]["coverage"]) > 0.7
    assert ours["accuracy"]["mean"] < sgbm["accuracy"]["mean"]


def test_a_lost_frame_has_the_last_known_pose_in_the_frame_of_the_rover(drive: Path) -> None:
    sequence = open_source(drive).loc
    assert sequence is not None
    truth = sequence.ground_truth
    start, T_rb_left = truth.pose(0), sequence.rig.T_rb_left
    moved = (start @ T_rb_left).inverse() @ truth.pose(1) @ T_rb_left
    poses = [Transform.identity(), moved, None, *[moved] * 9]
    found = rover_trajectory(poses, sequence, start)
    np.testing.assert_allclose(found.positions[1:3], truth.positions[[1, 1]], atol=1e-9)
    rows = {row.keys: row.value for row in trial_of(sequence).figures(poses)}
    assert rows["lost",] == 1
    assert rows["accuracy", "frames=3", "count"] > 0


def test_images_arrive_at_the_rate_and_output_of_a_method_is_ignored(drive: Path, tmp_path: Path) -> None:
    sequence = open_source(drive).loc
    assert sequence is not None
    assert trial_of(sequence).recorded_rate_hz == pytest.approx(10.0)
    begin_s = time.monotonic()
    passed = run_pass(made_method(tmp_path, is_paced=True), trial_of(sequence, rate_hz=5.0))
    assert time.monotonic() - begin_s > 2.1, "eleven steps of 0.2 s"
    assert passed.version == "7"
    for index, call in enumerate(passed.calls):
        pair, since = loc_pair(index), pytest.approx(0.2 * index)
        own = {"left": int(pair.left.sum()), "right": int(pair.right.sum()), "since_start_s": since}
        assert {name: call.statistics[name] for name in own} == own


def test_pairs_an_hour_apart_are_mapped_separately_without_waiting(drive: Path, tmp_path: Path) -> None:
    """A source has more pairs than a map may have, and the adapter keeps no results of earlier pairs."""
    sequence = open_source(drive).nav
    assert sequence is not None
    pairs = [
        replace(item, pair=replace(item.pair, stamp_ns=hour * 3600 * 10**9))
        for hour, item in enumerate([*sequence.pairs(), *sequence.pairs()])
    ]
    (tmp_path / "mapper.py").write_text(MAPPER)
    method = find_method(f"{tmp_path}/mapper.py:Mapper", Task.MAPPING)
    trial = MapperTrial.of(SimpleNamespace(rig=sequence.rig, pairs=lambda: iter(pairs)), MappingConfig(), ())
    begin_s = time.monotonic()
    passed = run_pass(method, trial)
    assert [(call.statistics["index"], call.statistics["results"]) for call in passed.calls] == [(0.0, 1.0)] * 4
    points = {row.keys: row.value for row in trial.figures(passed.results)}
    assert points["points",] == NAV_RIG.width * NAV_RIG.height
    assert 0.9 < points["accuracy", "coverage"] <= 1.0
    assert time.monotonic() - begin_s < 60.0


def test_more_mapping_pairs_than_the_points_can_number_are_refused(drive: Path) -> None:
    sequence = open_source(drive).nav
    assert sequence is not None
    many = SimpleNamespace(rig=sequence.rig, pairs=lambda: iter([next(sequence.pairs())] * 257))
    with pytest.raises(InputError, match="257 mapping pairs: at most 256"):
        MapperTrial.of(many, MappingConfig(), ())


@pytest.mark.parametrize("place", [0, 5])
def test_times_of_a_pass_are_those_of_the_calls_that_returned(place: int) -> None:
    calls = [MethodCall(CallUsage(0.1)) for _ in range(9)]
    calls.insert(place, MethodCall(findings=(CallFinding(FindingKind.RAISED, "ValueError"),)))
    costs = {row.keys: row.value for row in PassResult("", None, calls, []).costs()}
    times = {name: costs["time_s", name] for name in ("p50", "p95", "max", "first")}
    assert times == {"p50": 0.1, "p95": 0.1, "max": 0.1, "first": 0.1 if place else None}
    assert (costs["calls",], costs["calls_without_time",]) == (10, 1)


def test_a_pass_without_a_returned_call_has_no_times() -> None:
    costs = {row.keys: row.value for row in PassResult("", None, [MethodCall()], []).costs()}
    assert [costs["time_s", name] for name in ("p50", "p95", "max", "first")] == [None] * 4


@pytest.mark.parametrize(
    ("start", "prepare", "words"),
    [
        ("raise ValueError('no vocabulary')", "pass", "ended with exit code 1: ValueError: no vocabulary"),
        ("pass", "if order['since_start_s'] > 0.1: sys.exit('out of memory')", "ended with exit code 1: out of memory"),
    ],
)
def test_a_method_that_fails_is_named_and_the_others_go_on(
    drive: Path, tmp_path: Path, start: str, prepare: str, words: str
) -> None:
    sequence = open_source(drive).loc
    ours, bad = (
        replace(made_method(tmp_path, "good"), name=OURS_IN_TABLES),
        made_method(tmp_path, start=start, prepare=prepare),
    )
    result = compare_methods(trial_of(sequence), [ours, bad], repeat=2).content()
    assert words in result["failed"].pop("made")
    assert not result["failed"]
    assert [entry["calls"] for entry in result["entries"].values()] == [12]
    with pytest.raises(MethodError, match=words):
        compare_methods(trial_of(sequence), [replace(bad, name=OURS_IN_TABLES)])


def test_an_interrupt_counts_the_finished_passes_without_those_of_failed_methods(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = trial_of(open_source(drive).loc)
    ours, bad = (replace(made_method(tmp_path), name=name) for name in (OURS_IN_TABLES, "bad"))
    poses = [Transform.identity()] * 12
    outcomes = [PassResult("", None, [], poses), MethodError("crashed"), KeyboardInterrupt()]

    def next_outcome(*_: object) -> PassResult:
        outcome = outcomes.pop(0)
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    monkeypatch.setattr(method_benchmark, "run_pass", next_outcome)
    monkeypatch.setattr(method_benchmark, "hold", lambda: None)
    content = compare_methods(trial, [ours, bad], repeat=3).content()
    assert content["interrupted"] == "1 of 6 passes"
    assert content["failed"] == {"bad": "crashed"}


def test_rows_become_medians_ratios_and_json() -> None:
    first = [FigureRow(("lost",), 1), FigureRow(("time_s", "p50"), 0.1), FigureRow(("memory_bytes", "peak"), None)]
    other = [FigureRow(("lost",), 2), FigureRow(("time_s", "p50"), 0.3), FigureRow(("memory_bytes", "peak"), 5)]
    ours = medians([first, other])
    assert nested(ours) == {"lost": 1.5, "time_s": {"p50": 0.2}, "memory_bytes": {"peak": 5.0}}
    theirs = [FigureRow(("lost",), 1), FigureRow(("time_s", "p50"), 0.0), FigureRow(("memory_bytes", "peak"), -2.0)]
    assert nested(ratios(ours, theirs)) == {"time_s": {"p50": None}, "memory_bytes": {"peak": 2.5}}
