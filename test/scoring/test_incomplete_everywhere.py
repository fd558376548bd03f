"""No view makes a verdict of an incomplete run: nine views, eleven ways to be incomplete, and the complete run."""

from __future__ import annotations

import functools
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace as replace_struct

from helpers.cli_result import Sfr
from helpers.made_scene import LOC_RIG, NAV_RIG, nav_pair, true_cloud
from helpers.made_suites import JOB
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.calls.growing_calls import stats_of
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_format import SourceFormat
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import PublishedScore
from sfr_loc_map.live.values import state_json
from sfr_loc_map.metrics.comparison import compare_scores
from sfr_loc_map.metrics.config import ScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.map.pair_truth import truths_of
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import from_json, to_json
from sfr_loc_map.replay.replay_score import score_replay
from sfr_loc_map.replay.result import ReplayedMap, ReplayResult
from sfr_loc_map.report.control_document import control_csv
from sfr_loc_map.report.junit import junit
from sfr_loc_map.report.methods_page import methods_tables
from sfr_loc_map.report.page import render_page
from sfr_loc_map.report.score_tables import score_markdown
from sfr_loc_map.report.summary import banner_of
from sfr_loc_map.report.test_report import render_test_report
from sfr_loc_map.scoring.inputs import CloudToScore, DriveToScore, ExpectedPairs, Run
from sfr_loc_map.scoring.live.live_score import LiveRun
from sfr_loc_map.scoring.live.monitor_score import MonitorScore
from sfr_loc_map.scoring.score_run import score_run
from sfr_loc_map.suite.statistics.groups import groups_of
from sfr_loc_map.suite.statistics.scored_job import ScoredJob
from sfr_loc_map.suite.statistics.summary import Summary

COUNT, PERIOD_NS = 401, 100_000_000
STAMPS = 100 * 10**9 + PERIOD_NS * np.arange(COUNT, dtype=np.int64)
NAV = [nav_pair(0), nav_pair(1)]
NAV_STAMPS = [item.pair.stamp_ns for item in NAV]
CONFIG = ScoreConfig(TrajectoryScoreConfig(conditions=("distance=5",)))
LIMITS = parse_limits(
    {
        "trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 100.0}],
        "map": {"point_error_p95_m": 100.0},
        "timing": {"localisation_p95_s": 10.0, "mapping_p95_s": 10.0},
        "memory": {"localisation_peak_bytes": 1e12},
    },
    "test",
)
MISSING = parse_limits({"completeness": {"missing_max_share": 0.6}}, "test")


def drive(noise_m: float = 0.0003, rows: Any = slice(None)) -> Trajectory:
    """60 m along x with an error that walks."""
    noise = np.cumsum(np.random.default_rng(1).normal(0.0, noise_m, (COUNT, 3)), axis=0)
    positions = np.column_stack([0.15 * np.arange(COUNT), np.zeros((COUNT, 2))]) + noise
    return Trajectory(STAMPS[rows], positions[rows], np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))[rows])


def points_of(number: int, every: int = 1) -> PointCloud:
    """The true point of every n-th pixel of a mapping pair."""
    return PointCloud.from_structured(true_cloud(number).to_structured()[::every], fused=False)


def calls(stamps: Any = STAMPS, state: str = "tracking") -> list[CallRecord]:
    return [CallRecord(int(stamp), 0.05, state, peak_rss_bytes=10**8, above_idle_bytes=10**7) for stamp in stamps]


@dataclass(frozen=True)
class Made:
    """A run; as it is, nothing of it is missing."""

    estimate: Trajectory = field(default_factory=drive)
    truth: Trajectory = field(default_factory=lambda: drive(0.0))
    cloud: PointCloud = field(default_factory=lambda: PointCloud.concatenate([points_of(0), points_of(1)]))
    of_localiser: list[CallRecord] = field(default_factory=calls)
    of_mapper: list[CallRecord] = field(default_factory=lambda: calls(NAV_STAMPS, "mapped"))
    nav: tuple[Any, ...] = tuple(NAV)

    @property
    def records(self) -> list[CallRecord]:
        """All calls; that of the fusion names the pairs of the cloud."""
        fusion = replace(calls(NAV_STAMPS[-1:], "fused")[0], pair_stamps_ns=tuple(NAV_STAMPS), fused=False)
        return [*self.of_localiser, *self.of_mapper, fusion]


def in_the_sky() -> Made:
    """Half of the surface has no truth; the cloud has points there all the same."""
    nav = []
    for item in NAV:
        assert item.truth is not None
        truth = item.truth.copy()
        truth[: len(truth) // 2] = np.nan
        nav.append(replace(item, truth=truth))
    return Made(nav=tuple(nav))


COMPLETE = "complete"
RUNS: dict[str, Callable[[], Made]] = {
    COMPLETE: Made,
    "half of the estimates": lambda: Made(estimate=drive(rows=slice(0, COUNT // 2))),
    "every second estimate": lambda: Made(estimate=drive(rows=slice(None, None, 2))),
    "twenty chosen poses": lambda: Made(estimate=drive(rows=slice(None, None, 20))),
    "truth of half of the drive": lambda: Made(truth=drive(0.0, slice(0, COUNT // 2))),
    "times of two calls": lambda: Made(of_localiser=calls(STAMPS[:2])),
    "calls of another run": lambda: Made(of_localiser=calls(STAMPS + 10**12)),
    "calls that are counted twice": lambda: Made(of_localiser=[*calls(), *calls(STAMPS[:1])]),
    "one mapping call of two": lambda: Made(of_mapper=calls(NAV_STAMPS[:1], "mapped")),
    "a mapping pair without points": lambda: Made(cloud=points_of(0)),
    "points where there is no truth": in_the_sky,
    "a few points in all": lambda: Made(cloud=PointCloud.concatenate([points_of(n, 1000) for n in (0, 1)])),
}
"""The complete run, and the ways in which a run is incomplete."""


class Loc:
    """The drive of a source: its images are those of the stamps."""

    def __init__(self, truth: Trajectory) -> None:
        self.stamps_ns, self.rig, self.ground_truth = STAMPS.tolist(), LOC_RIG, truth
        self.missing_ns: list[int] = []

    def __len__(self) -> int:
        return COUNT

    def pairs(self) -> Iterator[Any]:
        return iter(())


class Nav:
    """The mapping pairs of a source."""

    rig = NAV_RIG

    def __init__(self, pairs: tuple[Any, ...]) -> None:
        self._pairs, self.stamps_ns = pairs, [item.pair.stamp_ns for item in pairs]
        self.missing_ns: list[int] = []

    def __len__(self) -> int:
        return len(self._pairs)

    def pairs(self) -> Iterator[Any]:
        return iter(self._pairs)


# ---- the views that score


@functools.cache
def scored(run_name: str) -> Score:
    made = RUNS[run_name]()
    truths = truths_of(list(made.nav), NAV_RIG)
    cloud = CloudToScore(LoadedCloud(made.cloud.xyz.astype(np.float64), made.cloud), truths)
    of_drive = DriveToScore(Estimates.of(made.estimate), made.truth, LOC_RIG, STAMPS)
    stamps = np.array(NAV_STAMPS, np.int64)
    run = Run(stats=[stats_of(made.records)], drive=of_drive, cloud=cloud, expected=ExpectedPairs(nav_stamps_ns=stamps))
    return score_run(run, CONFIG, LIMITS)


def replayed(run_name: str) -> Score:
    made = RUNS[run_name]()
    source = Source(Path(__file__), SourceFormat.FOLDER, Loc(made.truth), Nav(made.nav))
    result = ReplayResult(made.estimate, ReplayedMap(made.cloud, None, tuple(NAV_STAMPS)), made.records)
    return score_replay(source, result, CONFIG, LIMITS)


def saved(run_name: str) -> Score:
    """What the monitor writes to its file, read again; it knows the images of the drive by the truth alone."""
    made = RUNS[run_name]()
    monitor = MonitorScore(CONFIG, LIMITS)
    monitor.map_inputs.set_rig(NAV_RIG)
    for item in made.nav:
        monitor.map_inputs.add_pose(item.pair.stamp_ns, item.T_lm_navsb)
        monitor.map_inputs.add_true_points(item.pair.stamp_ns, item.truth)
    for record in made.records:
        monitor.add_call(record)
    monitor.map_inputs.add_cloud(NAV_STAMPS[-1], replace(made.cloud, fused=None, pair_stamps_ns=None))
    assert monitor.score_maps()
    add_poses(monitor, made)
    return from_json(to_json(monitor.result()))


# ---- the views that show


def of_report(run_name: str) -> str:
    score = from_json(to_json(scored(run_name)))
    state = banner_of(score).state
    assert f"<strong>{state.upper()}</strong>" in render_page(score, plots=False)
    return state


def of_test_report(run_name: str) -> str:
    text = render_test_report([scored(run_name)])
    return next(state for state in ("pass", "incomplete") if f"<strong>{state.upper()}</strong>" in text)


def of_junit(run_name: str) -> str:
    cases = list(ET.fromstring(junit({"score": scored(run_name)})).iter("testcase"))
    assert not any(case.find("failure") is not None for case in cases)
    return "incomplete" if any(case.find("error") is not None for case in cases) else "pass"


def of_suite(run_name: str) -> str | None:
    drives = [ScoredJob(JOB, scored(run_name))]
    groups = tuple(groups_of(drives, LIMITS))
    return Summary(groups=groups, results=tuple(drives), failures=(), refusals=(), code="").verdict


def of_comparison(run_name: str) -> str:
    pairs = compare_scores([scored(COMPLETE), scored(run_name)], ["complete", "other"]).pairs
    return "incomplete" if {pair.outcome.value for pair in pairs} <= {"incomplete"} else "pass"


def of_live_page(run_name: str) -> str:
    state = LiveState()
    state.put(PublishedScore(to_json(scored(run_name)), 1.0))
    return str(state_json(state, 1.0)["live"]["overall"]["state"])


VIEWS: dict[str, Callable[[str], Any]] = {
    "score": lambda run_name: scored(run_name).verdict,
    "replay": lambda run_name: replayed(run_name).verdict,
    "monitor": lambda run_name: saved(run_name).verdict,
    "report": of_report,
    "test report": of_test_report,
    "junit": of_junit,
    "suite": of_suite,
    "compare": of_comparison,
    "live page": of_live_page,
}


@pytest.mark.clause("4.1.1")
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("run_name", RUNS)
def test_every_view_passes_only_the_complete_run(run_name: str, view: str) -> None:
    assert VIEWS[view](run_name) == ("pass" if run_name == COMPLETE else "incomplete")


# ---- partial judging


SHOWN: dict[str, Callable[[Score], str]] = {
    "page": lambda score: render_page(score, plots=False),
    "Markdown": score_markdown,
    "test report": lambda score: render_test_report([score]),
    "control document": lambda score: control_csv({"score": score}),
    "junit": lambda score: junit({"score": score}),
    "live page": lambda score: str(banner_of(score)),
}
"""The views of one score, as their text."""


@pytest.mark.parametrize("view", SHOWN)
def test_every_view_states_that_judging_was_partial(view: str) -> None:
    for partial in (False, True):
        score = judged_by(scored(COMPLETE), LIMITS, partial=partial)
        assert ("--partial" in SHOWN[view](score)) == partial


@pytest.mark.parametrize("allowance", ["partial", "limit"])
def test_a_comparison_judges_completeness_without_partial_judging_and_limits_on_it(allowance: str) -> None:
    """A method that left out its difficult frames is neither better nor the best of a column."""
    allowed = replace_struct(LIMITS, limits=(*LIMITS.limits, *MISSING.limits)) if allowance == "limit" else LIMITS
    part = judged_by(scored("every second estimate"), allowed, partial=allowance == "partial")
    scores, names = [scored(COMPLETE), part], ["complete", "part"]
    assert part.verdict == "pass"
    result = compare_scores(scores, names)
    assert {pair.outcome.value for pair in result.pairs} == {"incomplete"}
    assert "50" in (result.incomplete[1] or "")
    (methods,) = [table for table in methods_tables(scores, names) if table.name == "methods"]
    (row,) = [row for row in methods.rows if row[0].text == "part"]
    assert not any(cell.mark for cell in row)
    assert row[1].text == ("pass, partial" if allowance == "partial" else "pass")


@pytest.mark.parametrize("is_partial", [False, True])
def test_the_commands_state_partial_judging(tmp_path: Path, sfr: Sfr, is_partial: bool) -> None:
    """Of an estimate without its last frames, both in the terminal and in the JUnit file of its stored score."""
    save_trajectory(tmp_path / "e.csv", drive(rows=slice(0, COUNT - 40)))
    save_trajectory(tmp_path / "t.csv", drive(0.0))
    score, xml, limits = (tmp_path / name for name in ("s.json", "s.xml", "limits.yaml"))
    limits.write_text("trajectory: [{condition: distance=5, position_mean_plus_3sigma_m: 100}]\n")
    options = ["--partial"] if is_partial else []
    made = sfr("score", tmp_path / "e.csv", tmp_path / "t.csv", "--limits", limits, "--json", score, *options)
    read = sfr("report", score, "--junit", xml)
    properties = [item.get("value") or "" for item in ET.parse(xml).getroot().iter("property")]
    for done, text in ((made, made.out), (read, read.out), (read, " ".join(properties))):
        assert done.code == (0 if is_partial else 3), done.err
        assert ("(--partial)" in text) == is_partial


def test_dropped_messages_restarts_and_changes_of_publishers_are_incomplete() -> None:
    for dropped, restarts, changes in ((1, 0, {}), (0, 1, {}), (0, 0, {"localisation/odometry": 1})):
        monitor = MonitorScore(CONFIG, LIMITS)
        for stamp, position, quat in zip(STAMPS.tolist(), drive().positions, drive().quats_xyzw, strict=True):
            monitor.add_estimate(stamp, position, quat, None)
            monitor.add_truth(stamp, position, quat)
        score = monitor.result(LiveRun(dropped=dropped, restarts=restarts, publisher_changes=changes))
        assert score.verdict == "incomplete"
        assert ("dropped" in (score.incomplete or "")) == bool(dropped)
        assert ("restarted 1 times" in (score.incomplete or "")) == bool(restarts)
        stated = [text for text in score.warnings if "localisation/odometry had more than one publisher" in text]
        assert len(stated) == len(changes)


def test_a_live_run_without_a_dropped_message_passes_a_limit_on_dropped_messages() -> None:
    of_drive = {"trajectory": [{"condition": "distance=5", "position_mean_m": 10.0}]}
    rules = {"minimum_independent": 1, **of_drive, "completeness": {"dropped_max_share": 0.01}}
    monitor = MonitorScore(CONFIG, parse_limits(rules, "limits"))
    add_poses(monitor, Made())
    score = monitor.result()
    assert (score.verdict, score.number("dropped", part=None), score.number("restarts")) == ("pass", 0.0, 0.0)


@pytest.mark.parametrize("silent", ["mapper", "localiser"])
def test_a_live_run_with_a_silent_node_is_incomplete_at_its_end(silent: str) -> None:
    """The limits are on the part of the other node only. During the run, the first result is awaited."""
    made = Made()
    of_drive = {"trajectory": [{"condition": "distance=5", "position_mean_m": 10.0}]}
    of_map = {"map": {"point_error_mean_m": 10.0}}
    rules = {"minimum_independent": 1, **(of_drive if silent == "mapper" else of_map)}
    monitor = MonitorScore(CONFIG, parse_limits(rules, "limits"))
    monitor.map_inputs.set_rig(NAV_RIG)
    for stamp_ns in STAMPS.tolist():
        monitor.add_image(stamp_ns)
    for item in made.nav:
        monitor.map_inputs.add_pose(item.pair.stamp_ns, item.T_lm_navsb)
        monitor.map_inputs.add_true_points(item.pair.stamp_ns, item.truth)
    if silent == "mapper":
        add_poses(monitor, made)
    else:
        for record in made.records:
            monitor.add_call(record)
        monitor.map_inputs.add_cloud(NAV_STAMPS[-1], replace(made.cloud, fused=None, pair_stamps_ns=None))
        assert monitor.score_maps()
    assert monitor.result(LiveRun(in_flight_s=10.0)).verdict == "pass"
    score = from_json(to_json(monitor.result()))
    assert score.verdict == "incomplete"
    missing = "100 % of the mapping pairs have no point" if silent == "mapper" else f"no pose for any of {COUNT} images"
    assert missing in (score.incomplete or "")


def add_poses(monitor: MonitorScore, made: Made) -> None:
    """Add the estimated and the true poses of a run."""
    for poses, add in ((made.estimate, monitor.add_estimate), (made.truth, monitor.add_truth)):
        for stamp, position, quat in zip(poses.stamps_ns.tolist(), poses.positions, poses.quats_xyzw, strict=True):
            add(stamp, position, quat, None)  # type: ignore[operator]
