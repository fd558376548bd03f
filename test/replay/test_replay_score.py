"""The score of a replay: poses of an external node converted; live, replay and `sfr score` give one map score."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from helpers.made_scene import write_folder
from helpers.score_rows import number
from sfr_loc_map.calls.call_files import load_call_stats, save_stats
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.calls.run_identity import hash_of_pair
from sfr_loc_map.errors import InputError, MetricsError, SfrError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import save_cloud
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import NavSequence, Source
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.methods.registry import record_of_ours
from sfr_loc_map.metrics.config import ScoreConfig, score_config
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention
from sfr_loc_map.metrics.figures.records import (
    REPLAY_RATE,
    AnswerCounts,
    ExternalScore,
    FindingKind,
    FindingRecord,
    MethodKind,
    MethodRecord,
)
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.limits import OF_MAP
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_dict
from sfr_loc_map.replay.external.external_poses import with_converted_poses
from sfr_loc_map.replay.files import ReplayFiles, save_replay
from sfr_loc_map.replay.replay_score import score_replay
from sfr_loc_map.replay.result import ExternalResult, ReplayedMap, ReplayResult
from sfr_loc_map.report.deviations import deviations_of
from sfr_loc_map.report.summary import banner_of
from sfr_loc_map.runs.mapper_run import MapRun, run_mapper
from sfr_loc_map.scoring.inputs import Correction, Run, ScoreInputs
from sfr_loc_map.scoring.live.monitor_score import MonitorScore
from sfr_loc_map.scoring.results import has_external_method
from sfr_loc_map.scoring.score_run import score_files, score_run
from sfr_loc_map.suite_names import Task

OURS = {task: record_of_ours(task) for task in Task}


def mapped(path: Path) -> tuple[Source, MapRun]:
    source = open_source(path)
    return source, run_mapper(source.nav, MappingConfig())


def of_map(score: Score) -> dict[str, Any]:
    """What a score says of a cloud, as JSON values."""
    plain = to_dict(score)
    is_of_map = {"map", "consistency"}
    about = [item for item in plain["figures"] if item["subject"] in is_of_map or item["figure"] in OF_MAP]
    return {"figures": about, "cloud": plain["cloud"]}


def file_score(cloud: Path, source: Path) -> dict[str, Any]:
    return of_map(score_files(ScoreInputs.of(cloud, source), ScoreConfig()))


def live_score(source: Source, run: MapRun, cloud: PointCloud) -> dict[str, Any]:
    """Return the map's score as the monitor makes it of what is published."""
    monitor = MonitorScore(ScoreConfig(), None)
    monitor.map_inputs.set_rig(source.nav.rig)
    for item in source.nav.pairs():
        monitor.map_inputs.add_pose(item.pair.stamp_ns, item.T_lm_navsb)
        monitor.map_inputs.add_true_points(item.pair.stamp_ns, item.truth)
    for record in run.records:
        monitor.add_call(replace(record, fused=cloud.fused if record.state == "fused" else None))
    message = replace(cloud, fused=None, pair_stamps_ns=None)  # it does not say
    monitor.map_inputs.add_cloud(run.maps[-1].stamp_ns, message)
    assert monitor.score_maps()
    return of_map(monitor.result())


@pytest.mark.parametrize("is_fused", [True, False])
def test_live_replay_and_score_of_every_file_format_are_equal_to_the_last_digit(tmp_path: Path, is_fused: bool) -> None:
    source, run = mapped(write_folder(tmp_path / "source", 0, 3))
    cloud = run.fused.cloud if is_fused else run.unfused
    stamps = tuple(item.stamp_ns for item in run.maps)
    result, files = (
        ReplayResult(Trajectory.empty(), ReplayedMap(cloud, None, stamps), run.records),
        ReplayFiles(tmp_path),
    )
    save_replay(result, files)
    replayed = of_map(score_replay(source, result, ScoreConfig(), None))
    assert replayed["cloud"]["kind"] == ("fused" if is_fused else "single pairs")
    assert replayed == file_score(files.cloud, source.path) == live_score(source, run, cloud)
    for name in ("cloud.pcd", "cloud.npz"):
        save_cloud(tmp_path / name, cloud)
        assert file_score(tmp_path / name, source.path) == replayed


@pytest.mark.parametrize("has_pixels", [True, False])
def test_a_point_that_is_not_finite_is_counted_and_not_scored(tmp_path: Path, has_pixels: bool) -> None:
    source, run = mapped(write_folder(tmp_path / "source", 0, 2))
    cloud = run.fused.cloud
    xyz = cloud.xyz.copy()
    xyz[0] = np.nan
    stamps, files = tuple(item.stamp_ns for item in run.maps), ReplayFiles(tmp_path)
    points = ReplayedMap(None, xyz.astype(np.float64), stamps)
    made = ReplayedMap(replace(cloud, xyz=xyz), None, stamps) if has_pixels else points
    result = ReplayResult(Trajectory.empty(), made, [])
    save_replay(result, files)
    replayed = of_map(score_replay(source, result, ScoreConfig(), None))
    assert number(replayed, "points_not_finite") == pytest.approx(1.0 / len(cloud))
    assert replayed == file_score(files.cloud if has_pixels else files.points, source.path)


def test_only_calls_of_a_mapper_from_a_file_without_a_hash_may_belong_to_another_cloud(tmp_path: Path) -> None:
    source, run = mapped(write_folder(tmp_path / "source", 0, 2))
    stamps, files = tuple(item.stamp_ns for item in run.maps), ReplayFiles(tmp_path)
    result = ReplayResult(Trajectory.empty(), ReplayedMap(run.fused.cloud, None, stamps), run.records)
    save_replay(result, files)
    replayed = score_replay(source, result, ScoreConfig(), None, files=files)
    inputs = replace(ScoreInputs.of(files.cloud, source.path), stats=(files.stats,))
    given = score_files(inputs, ScoreConfig())
    save_stats(files.stats, run.records, OURS)  # as in an earlier version
    earlier = score_files(inputs, ScoreConfig())
    found = [any("do not identify a cloud" in text for text in each.warnings) for each in (replayed, given, earlier)]
    assert found == [False, False, True]


def test_a_cloud_is_judged_by_the_truth_of_its_own_pairs(tmp_path: Path) -> None:
    """Of four pairs the first two were refused: the cloud's pairs 0 and 1 are the source's 2 and 3."""
    source = open_source(write_folder(tmp_path / "source", 0, 4))
    mapper = Mapper(source.nav.rig, MappingConfig())
    last = list(source.nav.pairs())[2:]
    cloud = mapper.fuse([mapper.process(item.pair, item.T_lm_navsb, k) for k, item in enumerate(last)]).cloud
    save_cloud(tmp_path / "c.ply", cloud)
    score = file_score(tmp_path / "c.ply", source.path)
    assert (number(score, "pairs"), number(score, "coverage") > 0.8) == (2, True)
    assert number(score, "point_error", "p50") < 0.02
    save_cloud(tmp_path / "d.ply", replace(cloud, pair_stamps_ns=(1, 2)))
    with pytest.raises(InputError, match="give the source of the cloud"):
        file_score(tmp_path / "d.ply", source.path)


def test_a_replay_is_judged_by_the_images_of_its_source(tmp_path: Path) -> None:
    source = open_source(write_folder(tmp_path / "source", 12, 0))
    truth = source.loc.ground_truth
    measured = 1.0001 * truth.positions
    parts = {rows: Trajectory(truth.stamps_ns[:rows], measured[:rows], truth.quats_xyzw[:rows]) for rows in (12, 6, 0)}
    limits = parse_limits(
        {"minimum_independent": 1, "trajectory": [{"condition": "frames=2", "position_mean_m": 1.0}]}, "limits"
    )
    wanted = {12: None, 6: "the estimate covers 50 % of the images", 0: "no pose for any of 12 images"}
    for (rows, estimate), partial in product(parts.items(), (False, True)):
        files = ReplayFiles(tmp_path / f"{rows}-{partial}")
        files.folder.mkdir()
        result = ReplayResult(estimate, ReplayedMap(), [])
        save_replay(result, files)
        config = score_config(["frames=2"], {"trajectory.partial": partial, "trajectory.spacing": 1})
        score = score_replay(source, result, config, limits, files=files)
        why = wanted[rows]
        assert (score.incomplete or "").startswith("" if partial else why or "")
        assert (score.incomplete is None) == (partial or why is None)
        assert bool([text for text in score.warnings if "judged although data is missing" in text]) == (
            partial and why is not None
        )
        of_limit = "not enough data"
        if rows:
            of_limit = "incomplete" if score.incomplete else "pass"
        assert [item.state for item in score.on_limits] == [of_limit]
        assert banner_of(score).state == ("incomplete" if score.incomplete else of_limit)
        if rows:
            offline = score_files(ScoreInputs.of(files.estimate, source.path), config)
            about = ((each.association, each.rows(subject="trajectory")) for each in (offline, score))
            assert next(about) == next(about)
            assert (offline.incomplete, offline.warnings) == (score.incomplete, score.warnings)


def test_a_replay_says_that_pairs_have_no_cloud_and_that_truth_is_sparse(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "source", 12, 3)
    place = path / "loc" / "groundtruth.csv"
    head, *rows = place.read_text().splitlines(keepends=True)
    place.write_text(head + "".join(rows[::5]))
    source = open_source(path)
    stamps = np.asarray(source.loc.stamps_ns)
    estimate = Trajectory(stamps, np.zeros((12, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (12, 1)))
    result = ReplayResult(estimate, ReplayedMap(), [])
    score = score_replay(source, result, score_config(["frames=2"], {}), None)
    assert "100 % of the mapping pairs have no point" in (score.incomplete or "")
    assert any("the truth has only 3 poses for 12 images" in text for text in score.warnings)


def with_nav_pairs(source: Source, pairs: Sequence[PosedStereoPair]) -> Source:
    """Return a source whose mapping pairs can be read only partially, although all are listed."""
    nav = SimpleNamespace(rig=source.nav.rig, stamps_ns=source.nav.stamps_ns, missing_ns=(), pairs=lambda: iter(pairs))
    return replace(source, loc=None, nav=cast("NavSequence", nav))


@pytest.mark.parametrize(
    ("kept", "true", "error"),
    [((0, 1, 2), (0, 1), MetricsError), ((0, 1, 2), (), None), ((0, 2), (0, 2), InputError), ((0, 2), (), InputError)],
)
def test_a_map_is_not_scored_without_notice_if_the_source_lacks_a_pair_or_its_truth(
    tmp_path: Path, kept: tuple[int, ...], true: tuple[int, ...], error: type[SfrError] | None
) -> None:
    source, run = mapped(write_folder(tmp_path / "source", 0, 3))
    pairs = [pair if row in true else replace(pair, truth=None) for row, pair in enumerate(source.nav.pairs())]
    changed = with_nav_pairs(source, [pairs[row] for row in kept])
    stamps_ns = tuple(item.stamp_ns for item in run.maps)
    result = ReplayResult(Trajectory.empty(), ReplayedMap(run.fused.cloud, None, stamps_ns), run.records)
    if error is None:
        assert not score_replay(changed, result, ScoreConfig(), None, read={}).rows(subject="map")
        return
    with pytest.raises(error, match=r"give (the|a) source"):
        score_replay(changed, result, ScoreConfig(), None, read={})


@pytest.mark.parametrize("count", [0, 2, 3])
def test_without_truth_the_pairs_that_are_in_no_cloud_are_counted(tmp_path: Path, count: int) -> None:
    source, run = mapped(write_folder(tmp_path / "source", 0, 3))
    pairs = [replace(pair, truth=None) for pair in source.nav.pairs()]
    untrue = with_nav_pairs(source, pairs)
    stamps_ns = tuple(item.stamp_ns for item in run.maps)[:count]
    result = ReplayResult(Trajectory.empty(), ReplayedMap(run.fused.cloud, None, stamps_ns), run.records)
    score = score_replay(untrue, result, ScoreConfig(), None, read={})
    missing = [row.value for row in score.rows("pairs_without_cloud", part="count")]
    assert missing == ([] if count == 3 else [3 - count])
    assert [row.n for row in score.rows("pairs_without_cloud")] == ([] if count == 3 else [3, 3])


def test_the_calls_of_a_replay_belong_to_its_estimate(tmp_path: Path) -> None:
    source = open_source(write_folder(tmp_path / "source", 12, 0))
    truth, files = source.loc.ground_truth, ReplayFiles(tmp_path / "run")
    estimate = Trajectory(truth.stamps_ns, 0.999 * truth.positions, truth.quats_xyzw)
    calls = [
        CallRecord(pair.stamp_ns, 0.1, "tracking", images_sha256=hash_of_pair(pair)) for pair in source.loc.pairs()
    ]
    result, config = ReplayResult(estimate, ReplayedMap(), calls), score_config(["frames=2"], {})
    files.folder.mkdir()
    save_replay(result, files)
    score = score_replay(source, result, config, None, files=files)
    assert not [text for text in score.warnings if "have no positions" in text]
    inputs = replace(ScoreInputs.of(files.estimate, source.path), stats=(files.stats,))
    assert score.warnings == score_files(inputs, config).warnings


def of_external(
    source: Source,
    calls: list[CallRecord],
    answers: AnswerCounts,
    config: ScoreConfig,
    findings: tuple[FindingRecord, ...] = (),
) -> ReplayResult:
    """The result of a replay to an external localiser whose poses are those of the truth, shortened by 0.1 %."""
    truth = source.loc.ground_truth
    estimate = Trajectory(truth.stamps_ns, 0.999 * truth.positions, truth.quats_xyzw)
    node = ExternalScore(task="localisation", topic="t", frames="odom", answers=answers, latency_s=None)
    run = ExternalResult(MethodRecord(name="n", version=None, kind=MethodKind.EXTERNAL), node, findings)
    return with_converted_poses(ReplayResult(estimate, ReplayedMap(), calls, run), source, config, Correction())


def test_calls_of_an_external_localiser_without_a_pose_are_kept(tmp_path: Path) -> None:
    """The node reports a call for each pair, and publishes a pose for every third pair."""
    source = open_source(write_folder(tmp_path / "source", 12, 0))
    truth, config = source.loc.ground_truth, score_config(["frames=2"], {"trajectory.partial": True})
    calls = [CallRecord(stamp_ns, 0.1, "tracking", covariance=np.eye(6)) for stamp_ns in truth.stamps_ns.tolist()]
    full = of_external(source, calls, AnswerCounts(pairs=12, answered=4), config)
    published = replace(full, estimate=full.estimate[::3], records=calls)
    result = with_converted_poses(published, source, config, Correction())
    assert [call.covariance is None for call in sorted(result.records, key=lambda call: call.stamp_ns)] == [
        number % 3 > 0 for number in range(12)
    ]
    files = ReplayFiles(tmp_path)
    save_replay(result, files)
    scored = score_files(replace(ScoreInputs.of(files.estimate, source.path), stats=(files.stats,)), config)
    assert len(load_call_stats(files.stats).localised_ns) == 12
    assert scored.association.matched == 4


def test_a_time_offset_moves_the_calls_with_their_poses(tmp_path: Path) -> None:
    source = open_source(write_folder(tmp_path / "source", 12, 0))
    stamps_ns, config = source.loc.ground_truth.stamps_ns.tolist(), score_config(["frames=2"], {})
    calls = [CallRecord(stamp_ns, 0.1, "tracking", covariance=np.eye(6)) for stamp_ns in stamps_ns]
    calls[5] = CallRecord(stamps_ns[5], 0.1, "lost")
    made = of_external(source, calls, AnswerCounts(pairs=12, answered=12), config)
    late = Trajectory(made.estimate.stamps_ns + 50_000_000, made.estimate.positions, made.estimate.quats_xyzw)
    moved = [replace(call, stamp_ns=call.stamp_ns + 50_000_000) for call in calls]
    correction = Correction(PoseConvention(time_offset_ns=-50_000_000))
    result = with_converted_poses(replace(made, estimate=late, records=moved), source, config, correction)
    files = ReplayFiles(tmp_path)
    save_replay(result, files)
    inputs = replace(ScoreInputs.of(files.estimate, source.path), stats=(files.stats,))
    wanted = score_replay(source, made, config, None)
    for score in (score_replay(source, result, config, None), score_files(inputs, config)):
        assert score.number("lost") == wanted.number("lost") == 1.0 / 12.0
        assert score.rows("nees") == wanted.rows("nees") != []


@pytest.mark.parametrize("state", [None, "", "tracking"])
def test_the_states_of_an_external_node_that_reports_none_are_unknown(tmp_path: Path, state: str | None) -> None:
    source = open_source(write_folder(tmp_path / "source", 12, 0))
    seconds = math.nan if state is None else 0.1
    calls = [CallRecord(int(stamp), seconds, state or "") for stamp in source.loc.ground_truth.stamps_ns]
    config = score_config(("frames=2",), {})
    result = of_external(source, calls, AnswerCounts(pairs=12, answered=12), config)
    limits = parse_limits({"trajectory": [{"condition": "frames=2", "lost_max_share": 0.0}]}, "limits")
    score = score_replay(source, result, config, limits)
    found = [score.number(name) for name in ("lost", "degraded")]
    assert (found, score.verdict) == (([0.0, 0.0], "pass") if state == "tracking" else ([None, None], "incomplete"))
    assert len(result.records) == 12


def test_the_files_of_a_replay_state_the_method_and_its_errors(tmp_path: Path) -> None:
    """A node that crashed fails by the files of the replay as it does by the replay itself."""
    source = open_source(write_folder(tmp_path / "source", 12, 0))
    stamps_ns = source.loc.ground_truth.stamps_ns.tolist()
    calls = [CallRecord(stamp_ns, 0.1, "tracking") for stamp_ns in stamps_ns]
    kinds = (FindingKind.MISSING, FindingKind.NOT_FINITE, FindingKind.CRASHED)
    findings = tuple(FindingRecord(kind=kind, count=3, first_stamp_ns=stamps_ns[-1], text="why") for kind in kinds)
    config = score_config(["frames=2"], {})
    result = of_external(source, calls, AnswerCounts(pairs=12, answered=12), config, findings)
    files = ReplayFiles(tmp_path)
    save_replay(result, files)
    replayed = score_replay(source, result, config, None, files=files)
    inputs = replace(ScoreInputs.of(files.estimate, source.path), stats=(files.stats,))
    scored = score_files(inputs, config)
    assert scored.method == replayed.method == result.external.method
    assert scored.findings == replayed.findings == findings
    assert scored.verdict == replayed.verdict == "fail"
    save_replay(replace(result, external=None), files)
    assert load_call_stats(files.stats).methods == {Task.LOCALISATION: OURS[Task.LOCALISATION]}


def test_findings_on_an_external_mapper_without_calls_are_in_the_files(tmp_path: Path) -> None:
    """The calls of our localiser, which takes part in the replay, are not attributed to the external mapper."""
    node = ExternalScore(task="mapping", topic="t", frames="lm", answers=AnswerCounts(pairs=3), latency_s=None)
    findings = (
        FindingRecord(kind=FindingKind.CRASHED, count=1, first_stamp_ns=None, text="exit code 3; hanging: no"),
        FindingRecord(kind=FindingKind.MISSING, count=3, first_stamp_ns=7, text="no answer"),
    )
    external = ExternalResult(MethodRecord(name="n", version=None, kind=MethodKind.EXTERNAL), node, findings)
    files = ReplayFiles(tmp_path)
    of_ours = CallRecord(5, 0.1, "tracking", finding="late answer: once")
    for records in ([], [of_ours]):
        result = ReplayResult(Trajectory.empty(), ReplayedMap(), records, external)
        save_replay(result, files)
        stats = load_call_stats(files.stats)
        assert stats.findings[:2] == findings
        assert stats.method == external.method
        assert stats.methods.get(Task.LOCALISATION) == (OURS[Task.LOCALISATION] if records else None)
        assert len(stats.calls.stamps_ns) == len(records)
        assert score_run(Run(stats=[stats]), ScoreConfig()).verdict == "fail"
    assert not any(has_external_method([stats], task) for task in Task)


@pytest.mark.parametrize("doubled", [0, 3])
def test_a_drive_with_several_answers_to_a_pair_is_incomplete(tmp_path: Path, doubled: int) -> None:
    source = open_source(write_folder(tmp_path / "source", 12, 0))
    calls = [CallRecord(int(stamp), 0.1, "tracking") for stamp in source.loc.ground_truth.stamps_ns]
    config = score_config(("frames=2",), {"trajectory.spacing": 1})
    result = of_external(source, calls, AnswerCounts(pairs=12, answered=12, doubled=doubled), config)
    about = {"minimum_independent": 1, "trajectory": [{"condition": "frames=2", "position_mean_m": 1.0}]}
    verdict = score_replay(source, result, config, parse_limits(about, "limits")).verdict
    assert verdict == ("incomplete" if doubled else "pass")
    with pytest.raises(InputError, match="another data set"):
        score_replay(source, result, config, parse_limits({**about, "data_set_sha256": ["0" * 64]}, "limits"))
    accepted = {**about, "completeness": [{"calls_doubled_max_share": 0.3}]}
    assert score_replay(source, result, config, parse_limits(accepted, "limits")).verdict == "pass"


@pytest.mark.parametrize(("rate", "is_limited"), [(0.0, True), (1.0, True), (1.0, False)])
def test_the_rate_of_a_replay_is_a_deviation_of_limited_times_of_a_node(
    tmp_path: Path, rate: float, is_limited: bool
) -> None:
    """Between pairs that are played at a rate, the node can work without an effect on its times."""
    source = open_source(write_folder(tmp_path / "source", 12, 0))
    calls = [CallRecord(int(stamp), 0.1, "tracking") for stamp in source.loc.ground_truth.stamps_ns]
    config = score_config(("frames=2",), {})
    result = of_external(source, calls, AnswerCounts(pairs=12, answered=12), config)
    limits = parse_limits({"timing": {"localisation_p50_s": 1.0}}, "limits") if is_limited else None
    score = score_replay(source, replace(result, rate=rate or None), config, limits)
    assert score.provenance.configuration.get(REPLAY_RATE, 0.0) == rate
    assert any("(--rate)" in text for text in deviations_of(score)) == (rate > 0.0 and is_limited)
