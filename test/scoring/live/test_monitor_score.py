"""The live score is that of the file, whatever the order of the messages; what the monitor keeps and saves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.made_scene import NAV_RIG, nav_pair, true_cloud
from helpers.message_bags import write_messages
from helpers.message_orders import CONFIG, COUNT, check_orders, in_order, messages_of, of_file, small_drive
from sfr_loc_map.calls.call_message import decode_call, encode_call
from sfr_loc_map.calls.call_poses import estimates_of
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.calls.growing_calls import stats_of
from sfr_loc_map.errors import InputError, MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.bag.messages import odometry
from sfr_loc_map.io.truth.config import TrackedBodyConfig
from sfr_loc_map.io.truth.conversion import truth_of_rb
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.message_types import STRING
from sfr_loc_map.metrics.config import AssociationConfig, MapScoreConfig, ScoreConfig
from sfr_loc_map.metrics.figures.records import Provenance
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import UPPER, symmetric
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.map.map_score import score_map
from sfr_loc_map.metrics.map.pair_truth import truths_of
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import from_json, to_json
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.nodes.monitor.score_file import ScoreFile
from sfr_loc_map.replay.message_store import ReceivedDrive
from sfr_loc_map.report.deviations import deviations_of
from sfr_loc_map.scoring.live.live_maps import LiveMaps
from sfr_loc_map.scoring.live.live_score import DiscardedInterval, LiveRun
from sfr_loc_map.scoring.live.monitor_score import MonitorScore
from sfr_loc_map.scoring.load_trajectories import load_estimates
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import ESTIMATE, call_topic

OdometryRow = tuple[int, FloatArray, FloatArray, FloatArray]


def test_messages_in_any_order_give_the_score_of_the_file() -> None:
    """Three orders of each of 16 drives; `python -m campaigns message-orders` tries thousands."""
    flags = sum(check_orders(seed, 3) for seed in range(16))
    assert flags > 4


def in_bag(path: Path, rows: Sequence[OdometryRow], calls: Sequence[CallRecord]) -> Estimates:
    entries: list[tuple[str, int, Any]] = []
    for stamp_ns, position, quat, covariance in rows:
        message = odometry(stamp_ns, position, quat)
        message.pose.covariance[:] = covariance.reshape(36)
        entries.append((ESTIMATE, stamp_ns, message))
    for call in calls:
        text = TYPESTORE.types[STRING](encode_call(call))
        entries.append((call_topic(Task.LOCALISATION), call.stamp_ns, text))
    return load_estimates(write_messages(path, entries))


def in_replay(rows: Sequence[OdometryRow], calls: Sequence[CallRecord]) -> Estimates:
    results = ReceivedDrive()
    for stamp_ns, position, quat, covariance in rows:
        results.add_pose((stamp_ns, tuple(position), tuple(quat)), covariance)
    results.calls = {call.stamp_ns: call for call in calls}
    return estimates_of(results.trajectory, stats_of(results.records))


@pytest.mark.parametrize("is_external", [False, True])
def test_bag_replay_and_monitor_have_one_rule_for_the_covariance_of_a_pose(tmp_path: Path, is_external: bool) -> None:
    """The published covariance counts; zeros report nothing, so that the covariance of the call counts there."""
    estimates, truth = small_drive(5)
    poses, covariances = estimates.trajectory, [symmetric(triangle) for triangle in estimates.covariance]
    given = zip(poses.stamps_ns.tolist(), poses.positions, poses.quats_xyzw, covariances, strict=True)
    rows, calls = [], []
    for number, (stamp_ns, position, quat, covariance) in enumerate(given):
        in_odometry, in_call = [(1.0, None), (0.0, 1.0), (1.0, 4.0), (0.0, None), (0.0, 0.0)][number % 5]
        rows.append((stamp_ns, position, quat, in_odometry * covariance))
        of_call = None if in_call is None else in_call * covariance
        call = CallRecord(stamp_ns, 0.1, "tracking", covariance=of_call)
        if not is_external or number % 3:  # an external node need not report its calls
            calls.append(call)
    expected = [[1.0, 1.0, 1.0, np.nan, np.nan][k % 5] * covariances[k][UPPER] for k in range(COUNT)]
    called_ns = {call.stamp_ns for call in calls}
    for k in range(COUNT):
        if k % 5 == 1 and rows[k][0] not in called_ns:
            expected[k][:] = np.nan
    found = in_bag(tmp_path / "bag", rows, calls), in_replay(rows, calls)
    figures = [in_order(of_file(score_trajectory(item, truth, CONFIG))) for item in found]
    for item in found:
        np.testing.assert_array_equal(item.covariance, expected)
        for flags in ("lost", "degraded", "is_lost_known", "is_degraded_known"):
            np.testing.assert_array_equal(getattr(item, flags), getattr(found[0], flags))
    for calls_come_first in (False, True):
        monitor = MonitorScore(ScoreConfig(CONFIG), None)
        messages = [("add_estimate", row) for row in rows]
        messages += [("add_call", (call,)) for call in calls]
        messages.sort(key=lambda item: item[1][0] if item[0] == "add_estimate" else item[1][0].stamp_ns)
        for name, arguments in reversed(messages) if calls_come_first else messages:
            getattr(monitor, name)(*arguments)
        for stamp, position, quat in zip(truth.stamps_ns.tolist(), truth.positions, truth.quats_xyzw, strict=True):
            monitor.add_truth(stamp, position, quat)
        figures.append(in_order(monitor.result()))
    assert any(row.subject == "consistency" or "nees" in row.figure for row in figures[0].figures)
    assert all(score == figures[0] for score in figures)


def test_of_poses_with_one_stamp_the_last_that_came_counts_as_in_a_file() -> None:
    estimates, truth = small_drive(3)
    rng, poses = np.random.default_rng(1), estimates.trajectory
    for _ in range(20):
        rows = rng.permutation([*range(COUNT), rng.integers(COUNT)])
        live, given = scored_live(poses, rows, truth, rng)
        assert in_order(live()) == in_order(of_file(score_trajectory(Estimates.of(given), truth, CONFIG)))
        assert live().association.estimate_duplicates == 1
    live, given = scored_live(poses, rng.integers(0, COUNT, 3 * COUNT), truth, rng)
    for score in (live, lambda: score_trajectory(Estimates.of(given), truth, CONFIG)):
        with pytest.raises(MetricsError, match="two runs"):
            score()


def scored_live(
    poses: Trajectory, rows: IntArray, truth: Trajectory, rng: np.random.Generator
) -> tuple[Callable[[], Score], Trajectory]:
    """The score of a monitor that received rows of poses, each moved, and these."""
    moved = poses.positions[rows] + rng.normal(0, 0.01, (len(rows), 3))
    given = Trajectory(poses.stamps_ns[rows], moved, poses.quats_xyzw[rows])
    monitor = MonitorScore(ScoreConfig(CONFIG), None)
    for stamp, position, quat in zip(given.stamps_ns.tolist(), moved, given.quats_xyzw, strict=True):
        monitor.add_estimate(stamp, position, quat, None)
    for stamp, position, quat in zip(truth.stamps_ns.tolist(), truth.positions, truth.quats_xyzw, strict=True):
        monitor.add_truth(stamp, position, quat)
    return monitor.result, given


def test_what_is_still_in_flight_is_not_missing() -> None:
    """The true poses of the last seconds are not yet due; at the end of the run they are."""
    estimates, truth = small_drive(3)
    monitor, partial = (
        MonitorScore(ScoreConfig(replace(CONFIG, partial=each)), parse_limits({"timing": {"mapping_max_s": 1}}, ""))
        for each in (False, True)
    )
    poses, stamps = estimates.trajectory, estimates.trajectory.stamps_ns
    for each in (monitor, partial):
        for stamp, position, quat in zip(truth.stamps_ns.tolist(), truth.positions, truth.quats_xyzw, strict=True):
            each.add_truth(stamp, position, quat)
        for row in range(COUNT // 2):
            each.add_estimate(int(stamps[row]), poses.positions[row], poses.quats_xyzw[row], None)
    due = monitor.result(LiveRun(in_flight_s=float(stamps[-1] - stamps[COUNT // 2 - 1]) / 1e9))
    assert due.incomplete is None
    assert {item.state for item in due.verdicts} == {"not enough data"}
    ended = monitor.result()
    assert "of the true poses" in ended.incomplete
    assert "incomplete" in [item.state for item in ended.verdicts]
    assert partial.result().incomplete is None


def test_results_of_the_last_seconds_count() -> None:
    """A result that came while its time was still running is not one of another stamp, and its image is due."""
    monitor, poses = MonitorScore(ScoreConfig(CONFIG), None), small_drive(3)[0].trajectory
    for stamp, position, quat in zip(poses.stamps_ns.tolist(), poses.positions, poses.quats_xyzw, strict=True):
        monitor.add_truth(stamp, position, quat)
        monitor.add_estimate(stamp, position, quat, None)
        monitor.add_call(CallRecord(stamp, 0.035, "tracking"))
    score = monitor.result(LiveRun(in_flight_s=1e3))
    judged = {row.part: row for row in score.figures if row.figure == "judged"}
    assert judged["drive"].n == judged["calls localisation"].n == len(poses)
    assert judged["drive"].value == judged["calls localisation"].value == 1.0
    assert not score.incomplete
    assert {row.value for row in score.figures if row.figure == "calls_other"} <= {0.0}


def test_calls_of_a_live_run_are_stated_and_resets_are_a_deviation() -> None:
    """The monitor receives times and memory from any node, and the operator may reset the score after a bad part."""
    limits = parse_limits({"timing": {"localisation_p95_s": 1.0}}, "limits")
    monitor, poses = MonitorScore(ScoreConfig(CONFIG), limits), small_drive(3)[0].trajectory
    for stamp, position, quat in zip(poses.stamps_ns.tolist(), poses.positions, poses.quats_xyzw, strict=True):
        monitor.add_truth(stamp, position, quat)
        monitor.add_estimate(stamp, position, quat, None)
        monitor.add_call(CallRecord(stamp, 0.001, "tracking", peak_rss_bytes=1_000_000))
    for discarded in ((), (DiscardedInterval(3, 7, "~/reset"),)):
        score = monitor.result(LiveRun(discards=len(discarded), discarded=discarded))
        assert score.calls is not None
        assert set(score.calls.clocks.values()) == {score.calls.memory_method} == {"stated by the node"}
        deviations = " ".join(deviations_of(score))
        assert "was stated by the node and not measured from outside" in deviations
        assert "was measured on the host" not in deviations
        assert ("3 to 7 ns (~/reset)" in deviations) == bool(discarded)
    for missed in (0, 7):
        score = monitor.result(LiveRun(missed_estimates=missed))
        assert ("7 estimates published before" in " ".join(deviations_of(score))) == bool(missed)


def test_settings_of_a_live_score_are_deviations_as_those_of_a_file() -> None:
    """Without a provenance, the settings are unknown, which is a deviation as well."""
    association = AssociationConfig(truth="interpolate", max_gap_s=3000.0)
    config = ScoreConfig(replace(CONFIG, association=association), MapScoreConfig(scored_to_m=2.5))
    monitor = MonitorScore(config, parse_limits({"map": {"coverage_min": 0.1}}, "limits"))
    for name, arguments in messages_of(small_drive(3)):
        getattr(monitor, name)(*arguments)
    of_parameters = {"monitor": {"input.queue_depth": 10}}
    score = monitor.result(LiveRun(provenance=Provenance(version="0", configuration=of_parameters)))
    deviations = " ".join(deviations_of(from_json(to_json(score))))
    for text in (
        "The setting trajectory.association.truth is interpolate; the default is auto.",
        "The setting trajectory.association.max_gap_s is 3000; the default is 1.",
        "Coverage counts true points from 0 m to 2.5 m",
    ):
        assert text in deviations
    assert "settings of the score are unknown" not in deviations
    assert "settings of the score are unknown" in " ".join(deviations_of(monitor.result()))


def report(name: str) -> str:
    return f'{{"schema": "sfr-score/2", "warnings": ["{name}"]}}'


def test_the_report_of_a_run_before_is_kept_once(tmp_path: Path) -> None:
    path = tmp_path / "score.json"
    file = ScoreFile(path)
    file.keep_previous()
    assert file.save(report("first")) == path
    file.keep_previous()
    assert not path.exists()
    file.save(report("second"))
    assert (path.read_text(), (tmp_path / "score.before.json").read_text()) == (report("second"), report("first"))
    ScoreFile(path).keep_previous()
    assert (tmp_path / "score.before.json").read_text() == report("second")
    assert len(list(tmp_path.iterdir())) == 1


def test_a_live_score_by_positions_alone_is_that_of_the_file() -> None:
    """A quaternion of zeros carries that there is no attitude; an estimate that has none is refused."""
    estimates, truth = small_drive(3)
    body = TrackedBodyConfig((0.2, 0.1, 1.5), clock_offset_s=0.25, sigma_m=0.01)
    shifted = Trajectory(truth.stamps_ns - 250_000_000, truth.positions, np.zeros((len(truth), 4)))
    offline = score_trajectory(estimates, truth_of_rb(RecordedTruth(shifted, ""), body), CONFIG)
    monitor = MonitorScore(ScoreConfig(CONFIG), None, body)
    for name, arguments in messages_of((estimates, shifted)):
        getattr(monitor, name)(*arguments)
    found = in_order(monitor.result())
    assert found == of_file(offline)
    assert found.number("chord", "mean") is not None
    assert found.number("attitude", "mean") is None
    with pytest.raises(InputError, match="no attitude"):
        monitor.add_estimate(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), None)


def test_a_new_run_forgets_the_contradiction_of_the_run_before() -> None:
    """The second run is as long as the first one, which had conjugated attitudes."""
    s = np.linspace(0.0, 20.0, 200)
    turns = Rotation.from_euler("ZYX", np.column_stack((0.8 * np.sin(0.5 * s), 0.1 * np.sin(s), 0.05 * np.cos(s))))
    truth = Trajectory(np.arange(200) * 100_000_000, np.column_stack((s, np.sin(s), 0.2 * np.sin(s))), turns.as_quat())
    monitor = MonitorScore(ScoreConfig(CONFIG), None)
    contradictions = []
    for quats in (turns.inv().as_quat(), turns.as_quat()):
        monitor.restart()
        for stamp, position, true, given in zip(
            truth.stamps_ns.tolist(), truth.positions, truth.quats_xyzw, quats, strict=True
        ):
            monitor.add_truth(stamp, position, true)
            monitor.add_estimate(stamp, position, given, None)
        contradictions.append(monitor.result().contradiction)
    assert "conjugated" in contradictions[0]
    assert contradictions[1] is None


def test_a_new_run_forgets_which_pairs_the_maps_of_the_run_before_contain() -> None:
    """Two runs have the same stamps; in the second one, a pair is missing from the map."""
    monitor, points = MonitorScore(ScoreConfig(), None), np.zeros((NAV_RIG.height, NAV_RIG.width, 3))
    monitor.map_inputs.set_rig(NAV_RIG)
    expected = []
    for mapped in ((1, 2, 3), (1, 3)):
        monitor.restart()
        for stamp_ns in (1, 2, 3):
            monitor.map_inputs.add_pose(stamp_ns, Transform.identity())
            monitor.map_inputs.add_true_points(stamp_ns, points)
        monitor.add_call(CallRecord(3, 0.1, "fused", pair_stamps_ns=mapped))
        monitor.map_inputs.add_cloud(3, PointCloud.empty())
        expected += [made.expected_pairs for made in monitor.map_inputs.take_complete()]
    assert expected == [3, 3]


@pytest.mark.parametrize("is_fused_late", [False, True])
def test_a_cloud_of_the_run_before_is_not_judged_in_the_new_run(is_fused_late: bool) -> None:
    """The truth of the cloud arrives after the stamps have jumped back. The new run misses its last pair."""
    monitor, points = MonitorScore(ScoreConfig(), None), np.full((NAV_RIG.height, NAV_RIG.width, 3), 2.0)
    maps, fusion = monitor.map_inputs, CallRecord(100, 0.1, "fused", pair_stamps_ns=(100,))
    maps.set_rig(NAV_RIG)
    maps.add_pose(100, Transform.identity())
    maps.add_cloud(100, PointCloud.empty())
    if not is_fused_late:
        monitor.add_call(fusion)
    monitor.restart()
    maps.add_true_points(100, points)
    if is_fused_late:
        monitor.add_call(fusion)
    assert not monitor.score_maps()
    for stamp_ns in (1, 2):
        maps.add_pose(stamp_ns, Transform.identity())
        maps.add_true_points(stamp_ns, points)
    monitor.add_call(CallRecord(1, 0.1, "fused", pair_stamps_ns=(1,)))
    maps.add_cloud(1, PointCloud.empty())
    assert [made.expected_pairs for made in maps.take_complete()] == [1]
    assert maps.unmapped_pairs == 1


@pytest.mark.parametrize("is_first_late", [False, True])
@pytest.mark.parametrize("order", [(1, 2, 3, 4), (3, 4, 1, 2)])
def test_the_pairs_that_a_map_must_contain_are_independent_of_the_order_of_arrival(
    order: tuple[int, ...], is_first_late: bool
) -> None:
    """Pair 3 is missing from the second map. The cloud of the first map may arrive after the second map is scored."""
    monitor, points = MonitorScore(ScoreConfig(), None), np.zeros((NAV_RIG.height, NAV_RIG.width, 3))
    maps = monitor.map_inputs
    maps.set_rig(NAV_RIG)
    for stamp_ns in (1, 2, 3, 4):
        maps.add_pose(stamp_ns, Transform.identity())
    for mapped in ((1, 2), (4,)):
        monitor.add_call(CallRecord(mapped[-1], 0.1, "fused", pair_stamps_ns=mapped))
        if not is_first_late or mapped[-1] == 4:
            maps.add_cloud(mapped[-1], PointCloud.empty())
    expected = {}
    for stamp_ns in order:
        maps.add_true_points(stamp_ns, points)
        expected |= {len(made.truths): made.expected_pairs for made in maps.take_complete()}
    if is_first_late:
        assert (expected, maps.unmapped_pairs) == ({1: 2}, 2)
        maps.add_cloud(2, PointCloud.empty())
        expected |= {len(made.truths): made.expected_pairs for made in maps.take_complete()}
    assert expected == {2: 2, 1: 2}
    assert maps.unmapped_pairs == 0


def test_a_warning_about_the_truth_is_logged_once_in_a_run(caplog: pytest.LogCaptureFixture) -> None:
    """The number of impossible poses grows. After a new run, the warning is logged again."""
    monitor = MonitorScore(ScoreConfig(CONFIG), None)
    for count in (1, 1, 2):
        if count == 2:
            monitor.restart()
        for stamp in range(1, 60):
            monitor.add_truth(stamp * 10**8, (0.1 * stamp, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
            if stamp % 20 == 0:
                monitor.add_truth(stamp * 10**8 + 1, (1e9, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
                monitor.result()
        assert len(caplog.records) == count


def live_maps(stretches: Sequence[float]) -> Score:
    """The score of a live run with a limit of 5 cm and a map of one pair for each stretch of the ranges."""
    limits = {"map": {"point_error_mean_m": 0.05}}
    monitor = MonitorScore(ScoreConfig(), parse_limits(limits, "limits"))
    monitor.map_inputs.set_rig(NAV_RIG)
    made, cloud = nav_pair(0), true_cloud(0)
    for number, stretch in enumerate(stretches):
        stamp_ns = made.pair.stamp_ns + number * 10**9
        monitor.map_inputs.add_pose(stamp_ns, made.T_lm_navsb)
        monitor.map_inputs.add_true_points(stamp_ns, made.truth)
        monitor.add_call(CallRecord(stamp_ns, 0.1, "fused", pair_stamps_ns=(stamp_ns,), fused=False))
        stretched = replace(cloud, xyz=(stretch * cloud.xyz).astype(np.float32), fused=None, pair_stamps_ns=None)
        monitor.map_inputs.add_cloud(stamp_ns, stretched)
        assert monitor.score_maps()
    return from_json(to_json(monitor.result()))


@pytest.mark.clause("4.3.4")
@pytest.mark.parametrize("stretches", [(1.1, 1.001), (1.001, 1.1), (1.001, 1.1, 1.001)])
def test_the_worst_map_of_a_live_run_decides(stretches: tuple[float, ...]) -> None:
    worst, score = live_maps((1.1,)), live_maps(stretches)
    assert live_maps((1.001,)).verdict == "pass"
    assert worst.verdict == score.verdict == "fail"
    assert score.number("point_error", "mean") == worst.number("point_error", "mean")
    assert score.number("maps") == len(stretches)
    assert any(f"worst of {len(stretches)} maps" in each for each in score.caveats)


def test_a_map_without_points_is_worse_than_a_map_within_the_limits() -> None:
    made, cloud = nav_pair(0), true_cloud(0)
    truths = truths_of([made], NAV_RIG)
    maps = LiveMaps(parse_limits({"map": {"point_error_mean_m": 0.05}}, "limits"), partial=False)
    for each in (PointCloud.from_structured(cloud.to_structured()[:0], fused=False), cloud):
        maps.add(score_map(each, truths, ScoreConfig().map, expected_pairs=1))
    assert maps.result is not None
    rows = Score(figures=maps.result.figures)
    assert (rows.number("points"), rows.number("maps")) == (0, 2)


def test_a_pair_that_a_fusion_names_several_times_is_one_pair_of_the_map() -> None:
    """Two pairs are not mapped. The points of the third pair are published once for each pair."""
    monitor, stamps_ns = MonitorScore(ScoreConfig(), None), (1, 2, 3)
    monitor.map_inputs.set_rig(NAV_RIG)
    for stamp_ns in stamps_ns:
        monitor.map_inputs.add_pose(stamp_ns, Transform.identity())
        monitor.map_inputs.add_true_points(stamp_ns, np.full((NAV_RIG.height, NAV_RIG.width, 3), 2.0))
    fusion = CallRecord(3, 0.1, "fused", pair_stamps_ns=(3, 3, 3), fused=False)
    monitor.add_call(fusion)
    ones, pixels = np.ones(3, np.float32), np.zeros(3, np.uint16)
    cloud = PointCloud(np.full((3, 3), 2.0, np.float32), ones, ones, pixels, pixels, np.arange(3, dtype=np.uint8))
    monitor.map_inputs.add_cloud(3, cloud)
    assert monitor.score_maps()
    score = monitor.result()
    assert score.number("pairs_without_cloud", part="count") == 2
    assert score.number("points_repeated", part="count") == 2
    with pytest.raises(InputError, match="a stamp twice"):
        decode_call(encode_call(fusion), Task.MAPPING)


@pytest.mark.parametrize("later", [0, 2])
def test_pairs_after_the_last_map_are_missing_once_the_run_is_over(later: int) -> None:
    """A mapper that ends after its first map is not judged by this map alone."""
    monitor = MonitorScore(ScoreConfig(), None)
    monitor.map_inputs.set_rig(NAV_RIG)
    points = np.full((NAV_RIG.height, NAV_RIG.width, 3), 2.0)
    for stamp_ns in range(1, 3 + later):
        monitor.map_inputs.add_pose(stamp_ns, Transform.identity())
        monitor.map_inputs.add_true_points(stamp_ns, points)
    monitor.add_call(CallRecord(2, 0.1, "fused", pair_stamps_ns=(1, 2)))
    pixels = np.arange(2, dtype=np.uint16)
    ones = np.ones(2, np.float32)
    cloud = PointCloud(np.full((2, 3), 2.0, np.float32), ones, ones, pixels, pixels, np.array([0, 1], np.uint8))
    monitor.map_inputs.add_cloud(2, cloud)
    assert monitor.score_maps()
    for live, missing in ((LiveRun(in_flight_s=5.0), 0), (LiveRun(), later)):
        score = monitor.result(live)
        assert score.number("pairs_without_cloud", part="count") == missing
        assert score.number("judged", "n", part="map") == 2 + missing
        assert (score.incomplete is not None) == bool(missing)


def monitor_with_maps(clouds: Sequence[PointCloud]) -> MonitorScore:
    """A monitor that has received a map of one pair for each cloud."""
    monitor, made = (
        MonitorScore(ScoreConfig(), parse_limits({"map": {"point_error_mean_m": 0.05}}, "limits")),
        nav_pair(0),
    )
    monitor.map_inputs.set_rig(NAV_RIG)
    for number, cloud in enumerate(clouds):
        stamp_ns = made.pair.stamp_ns + number * 10**9
        monitor.map_inputs.add_pose(stamp_ns, made.T_lm_navsb)
        monitor.map_inputs.add_true_points(stamp_ns, made.truth)
        monitor.add_call(CallRecord(stamp_ns, 0.1, "fused", pair_stamps_ns=(stamp_ns,), fused=False))
        monitor.map_inputs.add_cloud(stamp_ns, replace(cloud, fused=None, pair_stamps_ns=None))
        assert monitor.score_maps()
    return monitor


def with_first(cloud: PointCloud, name: str, value: float) -> PointCloud:
    """The cloud with another value of its first point."""
    values = getattr(cloud, name).copy()
    values[0] = value
    return replace(cloud, **{name: values})


@pytest.mark.parametrize("order", ["good bad", "bad good", "bad", "good bad good"])
@pytest.mark.parametrize(("column", "value"), [("u", NAV_RIG.width), ("v", NAV_RIG.height), ("pair", 7)])
def test_the_pairs_of_a_live_map_that_cannot_be_scored_have_no_map(order: str, column: str, value: int) -> None:
    good = true_cloud(0)
    bad = with_first(good, column, value)
    monitor = monitor_with_maps([good if word == "good" else bad for word in order.split()])
    for live in (LiveRun(in_flight_s=5.0), LiveRun()):
        score = from_json(to_json(monitor.result(live)))
        assert score.number("pairs_without_cloud", part="count") == 1
        assert score.incomplete is not None
        assert score.verdict != "pass"
        assert any("cannot be scored" in caveat for caveat in score.caveats)
    monitor.map_inputs.add_cloud(max(monitor.map_inputs.pair_stamps_ns), good)
    if order.endswith("bad"):
        assert monitor.score_maps()
        assert monitor.map_inputs.unmapped_pairs == 0, "the map was published again with valid points"
    monitor.restart()
    assert not monitor.result().caveats


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_points_of_a_live_map_that_are_not_finite_are_counted_as_those_of_a_file(value: float) -> None:
    good = true_cloud(0)
    score = monitor_with_maps([good, with_first(good, "xyz", value)]).result()
    assert score.number("points_not_finite", part="count") == 1
    assert score.number("points_not_finite") == pytest.approx(1.0 / len(good))
    assert score.incomplete is not None
    assert (score.verdict, score.number("pairs_without_cloud", part="count")) == ("incomplete", 0)


@pytest.mark.parametrize(
    ("factor", "is_copy", "is_stationary"), [(1.0, True, False), (0.99, False, False), (0.0, False, True)]
)
def test_a_truth_that_is_the_estimate_or_does_not_move_is_reported(
    factor: float, is_copy: bool, is_stationary: bool
) -> None:
    monitor, noise_m = MonitorScore(ScoreConfig(), None), 1e-4 * is_stationary
    for index in range(100):
        position = np.sqrt(2.0) * np.array([0.03 * index, 0.001 * index, 0.0])
        monitor.add_estimate(10**18 + index * 10**8, position, (0.0, 0.0, 0.0, 1.0), None)
        monitor.add_truth(10**18 + index * 10**8, factor * position + noise_m * (index % 7), (0.0, 0.0, 0.0, 1.0))
    text = " ".join(monitor.result().warnings)
    assert ("equal those of the ground truth" in text) == is_copy
    assert ("the ground truth moves by 0.0006 m" in text) == is_stationary


def test_a_jump_of_the_truth_is_a_caveat_of_the_score() -> None:
    monitor = MonitorScore(ScoreConfig(), None)
    for index in range(60):
        position = np.array([0.05 * index, 0.002 * index, 0.0])
        jumped = position + (20.0 if index >= 30 else 0.0)
        monitor.add_estimate(10**18 + index * 10**9, position, (0.0, 0.0, 0.0, 1.0), None)
        monitor.add_truth(10**18 + index * 10**9, jumped, (0.0, 0.0, 0.0, 1.0))
    assert any("jump" in text for text in monitor.result().caveats)


def test_a_score_of_repeated_true_poses_has_a_caveat() -> None:
    monitor = MonitorScore(ScoreConfig(), None)
    score = monitor.result(LiveRun(repeated_truth=7))
    assert any("(number: 7)" in text for text in score.caveats)
