"""Frames that no judged error contains. Faults in them are not a pass, and a choice of starts is not a reason."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from helpers.cli_result import Sfr
from helpers.honest_drives import honest_drive
from helpers.random_drives import as_score
from helpers.scored_drives import COUNT, PERIOD_NS, POSITION, limits, straight
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.completeness.shortfall_kinds import BEYOND_MOST
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.catalogue import ERRORS_BEYOND
from sfr_loc_map.metrics.figures.row_part import OTHER_FRAMES
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.other_frames import largest_usual
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory

LENGTH = 50  #: Frames of a sub-trajectory of 5 m.
STARTS = np.arange(0, COUNT, 10)


def honest() -> Trajectory:
    """Steps that err by 0.2 mm: over 5 m about 2 mm."""
    noise = np.cumsum(np.random.default_rng(4).normal(0.0, 2e-4, (COUNT, 3)), axis=0)
    drive = straight()
    return Trajectory(drive.stamps_ns, drive.positions + noise, drive.quats_xyzw)


def with_wrong(frames: np.ndarray) -> Trajectory:
    """Return the honest estimate, with some frames 1 m off in x and 2 m in z."""
    drive = honest()
    positions = drive.positions.copy()
    positions[frames] += np.array([1.0, 0.0, 2.0])
    return Trajectory(drive.stamps_ns, positions, drive.quats_xyzw)


def between_the_starts() -> np.ndarray:
    """Return the frames at which no judged sub-trajectory of 5 m starts or ends."""
    return np.setdiff1d(np.arange(COUNT), STARTS)


def judged_frames(estimate: Trajectory, folder: Path, sfr: Sfr, *options: str) -> tuple[int, str, dict[str, object]]:
    """Score an estimate of the straight drive by the limit of 50 mm over 5 m."""
    paths, result = (folder / "e.csv", folder / "t.csv"), folder / "s.json"
    save_trajectory(paths[0], estimate)
    save_trajectory(paths[1], straight())
    rules = limits(folder, POSITION)
    done = sfr("score", *paths, "--limits", rules, "--json", result, "--overwrite", *options)
    return done.code, done.out + done.err, json.loads(result.read_text())


@pytest.mark.parametrize("every", [1, 5, 9])
def test_wrong_frames_between_the_starts_are_no_pass(tmp_path: Path, sfr: Sfr, every: int) -> None:
    """The judged figure is that of the right frames alone; that of the others is metres."""
    wrong = between_the_starts()[::every]
    code, text, score = judged_frames(with_wrong(wrong), tmp_path, sfr)
    assert code == 3, text
    assert score["verdict"] == "incomplete"
    assert "because starts are 10 frames apart" in text
    named = {1: "frames 1-9, 11-19, 21-29", 5: "frames 1, 6, 12, 17", 9: "frames 1, 11, 21"}[every]
    assert named in text
    assert "... --partial" not in text, "a part of the frames was judged already"
    assert judged_frames(with_wrong(wrong), tmp_path, sfr, "--partial")[0] == 3


def test_one_wrong_frame_in_a_hundred_and_an_honest_drive_pass(tmp_path: Path, sfr: Sfr) -> None:
    assert judged_frames(honest(), tmp_path, sfr)[0] == 0
    assert judged_frames(with_wrong(between_the_starts()[::100]), tmp_path, sfr)[0] == 0
    sfr("report", tmp_path / "s.json", "--test-report", tmp_path / "r.html")
    assert "have a position error up to 2.24 m, far above" in (tmp_path / "r.html").read_text()


def test_errors_at_other_frames_below_the_factor_are_reported(tmp_path: Path, sfr: Sfr) -> None:
    """The errors at the other frames miss the limit of 50 mm, but not by the factor that makes a score incomplete."""
    estimate = honest()
    estimate.positions[:, 1] += 0.03 * np.arange(COUNT) / LENGTH
    estimate.positions[between_the_starts(), 1] += 0.075
    code, text, score = judged_frames(estimate, tmp_path, sfr)
    assert (code, score["verdict"]) == (0, "pass"), text
    assert "which misses the limit of 0.05 m" in text
    sfr("report", tmp_path / "s.json", "--test-report", tmp_path / "r.html")
    assert "which misses the limit of 0.05 m" in (tmp_path / "r.html").read_text()
    assert "misses the limit" not in judged_frames(honest(), tmp_path, sfr)[1]


@pytest.mark.parametrize("count", [1, 30, 250, 1000])
def test_few_outliers_are_not_the_largest_usual_error(count: int) -> None:
    """At most the fraction `BEYOND_MOST` of the known errors exceeds it, and by at most one error less than allowed."""
    sizes = np.random.default_rng(count).exponential(1.0, count)
    exceeding = int(np.sum(sizes > largest_usual(np.append(sizes, np.nan))))
    assert BEYOND_MOST * count - 1.0 <= exceeding <= BEYOND_MOST * count
    assert largest_usual(np.array([np.nan])) == 0.0


def test_a_limit_may_allow_it_and_a_loose_limit_is_met_by_all_frames(tmp_path: Path, sfr: Sfr) -> None:
    paths = tmp_path / "e.csv", tmp_path / "t.csv"
    save_trajectory(paths[0], with_wrong(between_the_starts()))
    save_trajectory(paths[1], straight())
    allowed = {**POSITION, "completeness": {"errors_beyond_max_share": 1.0}}
    loose = {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 20.0}]}
    for content in (allowed, loose):
        assert sfr("score", *paths, "--limits", limits(tmp_path, content)).code == 0


def test_a_tolerance_bound_needs_the_other_frames_as_well(tmp_path: Path, sfr: Sfr) -> None:
    paths = tmp_path / "e.csv", tmp_path / "t.csv"
    save_trajectory(paths[1], straight())
    bound = {"limit": 0.05, "prob": 0.5, "confidence": 0.5, "interpretation": "temporal"}
    rules = limits(tmp_path, {"trajectory": [{"condition": "distance=5", "position_bound_m": bound}]})
    for estimate, code in ((honest(), 0), (with_wrong(between_the_starts()), 3)):
        save_trajectory(paths[0], estimate)
        done = sfr("score", *paths, "--limits", rules)
        assert done.code == code, done.err


@pytest.mark.parametrize(
    ("name", "outlier_m", "wrong_m"),
    [
        ("position_p50_m", 30.0, 2.2),
        ("position_mean_m", 0.7, 1.0),
        ("position_mean_plus_3sigma_m", 0.053, 0.158),
        ("position_rmse_m", 0.17, 0.4),
    ],
)
def test_one_large_judged_error_does_not_hide_the_errors_at_the_other_frames(
    tmp_path: Path, sfr: Sfr, name: str, outlier_m: float, wrong_m: float
) -> None:
    """The limit allows one large judged error, and no error at the other frames is three times as large."""
    paths = tmp_path / "e.csv", tmp_path / "t.csv"
    save_trajectory(paths[1], straight())
    rules = limits(tmp_path, {"trajectory": [{"condition": "distance=5", name: 0.05}]})
    few, many = between_the_starts()[::100], between_the_starts()
    for wrong, code in ((few, 0), (many, 3)):
        estimate = honest()
        estimate.positions[150, 0] += outlier_m
        estimate.positions[wrong, 1] += wrong_m
        save_trajectory(paths[0], estimate)
        done = sfr("score", *paths, "--limits", rules)
        assert done.code == code, done.out + done.err


def test_one_judged_outlier_does_not_hide_a_twenty_fifth_of_a_long_drive(tmp_path: Path, sfr: Sfr) -> None:
    paths, count = (tmp_path / "e.csv", tmp_path / "t.csv"), 6000
    save_trajectory(paths[1], straight(count))
    rules = limits(tmp_path, {"trajectory": [{"condition": "distance=5", "position_mean_plus_3sigma_m": 0.05}]})
    noise = np.random.default_rng(5).normal(0.0, 1e-3, (count, 3))
    for every, code in ((100, 0), (25, 3)):
        estimate = Trajectory(straight(count).stamps_ns, straight(count).positions + noise, straight(count).quats_xyzw)
        estimate.positions[3000, 0] += 0.2
        estimate.positions[5::every, 1] += 0.5
        save_trajectory(paths[0], estimate)
        done = sfr("score", *paths, "--limits", rules)
        assert done.code == code, done.out + done.err


def test_random_honest_drives_have_no_error_beyond_the_judged_ones() -> None:
    """Of the kinds without outliers: noise, drift, scale, straight."""
    for seed in range(24):
        kind, estimate, truth = honest_drive(seed)
        if kind not in ("noise", "drift", "scale", "straight"):
            continue
        metres = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1).sum() / 12.0
        config = TrajectoryScoreConfig(conditions=(f"distance={metres:.3f}",))
        figures = score_trajectory(Estimates.of(estimate), truth, config).figures
        rows = [row for row in figures if row.figure == ERRORS_BEYOND]
        assert all((row.value or 0.0) <= BEYOND_MOST for row in rows), (seed, kind, rows)
        assert any(row.part == OTHER_FRAMES for row in figures)


def with_stop(drive: Trajectory, frames: int, at: int = COUNT - 1) -> Trajectory:
    """Return a drive with a stop of so many frames at a frame, by default the last one."""
    rows = np.insert(np.arange(COUNT), at, np.full(frames, at))
    return Trajectory(np.arange(COUNT + frames) * PERIOD_NS, drive.positions[rows], drive.quats_xyzw[rows])


@pytest.mark.parametrize(
    ("scale", "frames", "code"),
    [
        (0.99, 0, 1),  # 50 mm over 5 m
        (0.99, 5700, 3),  # diluted to 36 mm
        (0.999, 5700, 0),  # 5 mm over 5 m
    ],
)
def test_a_rover_that_stands_meets_no_limit_for_one_that_moves(
    tmp_path: Path, sfr: Sfr, scale: float, frames: int, code: int
) -> None:
    paths, score, page = (tmp_path / "e.csv", tmp_path / "t.csv"), tmp_path / "s.json", tmp_path / "r.html"
    for path, factor in zip(paths, (scale, 1.0), strict=True):
        save_trajectory(path, with_stop(straight(scale=factor), frames))
    bound = {"limit": 0.04, "prob": 0.9, "confidence": 0.95, "interpretation": "temporal"}
    content = {"condition": "time=5", "position_mean_plus_3sigma_m": 0.04}
    if code == 3:
        content |= {"position_bound_m": bound}
    rules = limits(tmp_path, {"trajectory": [content]})
    done = sfr("score", *paths, "--limits", rules, "--json", score)
    told = done.out + done.err
    assert done.code == code, told
    assert ("% of the sub-trajectories over 5 s have a stationary rover; of the others" in told) == (code == 3), told
    if code == 3:
        assert sfr("score", *paths, "--limits", rules, "--partial").code == 3
        states = {item["name"]: item["verdict"] for item in json.loads(score.read_text())["verdicts"]}
        assert states["position_bound_m"] == "incomplete"
        allowed = limits(tmp_path, {"trajectory": [content], "completeness": {"standing_max_share": 0.96}})
        done = sfr("score", *paths, "--limits", allowed, "--json", score, "--overwrite")
        assert done.code == 0, done.err
    sfr("report", score, "--test-report", page)
    told = re.search(r"9[0-9.]+ % of the \d+ sub-trajectories over 5 s have a stationary rover\.", page.read_text())
    assert bool(told) == (frames > 0)


def test_a_stop_does_not_dilute_errors_over_a_distance(tmp_path: Path, sfr: Sfr) -> None:
    """A scale error of 10 % before a stop, at which many sub-trajectories begin at the same place."""
    paths = (tmp_path / "e.csv", tmp_path / "t.csv")
    drive = straight()
    positions = straight(scale=0.999).positions.copy()
    positions[:100, 0] = positions[100, 0] + 0.9 * (drive.positions[:100, 0] - drive.positions[100, 0])
    estimate = Trajectory(drive.stamps_ns, positions, drive.quats_xyzw)
    rules = limits(tmp_path, {"trajectory": [{"condition": "distance=2", "position_mean_plus_3sigma_m": 0.25}]})
    for frames, code in ((0, 1), (3000, 3)):
        for path, poses in zip(paths, (estimate, drive), strict=True):
            save_trajectory(path, with_stop(poses, frames, at=150))
        done = sfr("score", *paths, "--limits", rules)
        told = done.out + done.err
        assert done.code == code, told
        assert ("over 2 m begin where the previous one begins" in told) == (frames > 0), told


@pytest.mark.parametrize("frames", [0, 150])
def test_a_drive_that_stands_throughout_or_for_a_third_is_judged(tmp_path: Path, sfr: Sfr, frames: int) -> None:
    """A test at standstill, whose truth has noise or has not, and a stop of an honest drive."""
    rng, paths = np.random.default_rng(5), (tmp_path / "e.csv", tmp_path / "t.csv")
    drive = with_stop(straight(scale=0.999), frames) if frames else straight(scale=0.0)
    truth = with_stop(straight(), frames) if frames else drive
    for sigma_m in (0.0, 1e-3):
        noise = [rng.normal(0.0, size, truth.positions.shape) for size in (1e-3, sigma_m)]
        for path, poses, error in zip(paths, (drive, truth), noise, strict=True):
            save_trajectory(path, Trajectory(poses.stamps_ns, poses.positions + error, poses.quats_xyzw))
        rules = limits(tmp_path, {"trajectory": [{"condition": "time=5", "position_mean_plus_3sigma_m": 0.04}]})
        done = sfr("score", *paths, "--limits", rules)
        assert done.code == 0, done.out + done.err


@cache
def score_with_stop() -> Score:
    """Return the score of a scale error of 1 % over 5 s, diluted by a stop."""
    estimate, truth = (with_stop(straight(scale=scale), 5700) for scale in (0.99, 1.0))
    return as_score(score_trajectory(Estimates.of(estimate), truth, TrajectoryScoreConfig(conditions=("time=5",))))


@pytest.mark.parametrize(
    ("position_m", "states", "words"),
    [
        (0.04, ["incomplete", "pass"], "record a longer drive in motion"),  # diluted to 36 mm
        (0.01, ["fail", "pass"], None),  # motion alone does not help
        (0.1, ["pass", "pass"], None),
    ],
)
def test_a_limit_that_is_met_by_standing_changes_no_other_verdict(
    position_m: float, states: list[str], words: str | None
) -> None:
    entry = {"condition": "time=5", "position_mean_plus_3sigma_m": position_m, "heading_mean_plus_3sigma_deg": 1.0}
    score = judged_by(score_with_stop(), parse_limits({"trajectory": [entry]}, "limits"))
    assert [item.state for item in score.on_limits] == states
    assert (words in (score.incomplete or "")) if words else (score.incomplete is None)


def test_errors_at_other_frames_change_no_other_verdict() -> None:
    scored = score_trajectory(Estimates.of(with_wrong(between_the_starts())), straight(), TrajectoryScoreConfig())
    entry = {**POSITION["trajectory"][0], "heading_mean_plus_3sigma_deg": 1.0}
    score = judged_by(as_score(scored), parse_limits({"trajectory": [entry]}, "limits"))
    assert [item.state for item in score.on_limits] == ["incomplete", "pass"]
    assert score.verdict == "incomplete"


def test_errors_of_rounding_size_are_not_far_above_exact_errors() -> None:
    """Rounding of the positions of some frames, whose judged errors are exactly 0."""
    drive = straight()
    positions = drive.positions.copy()
    positions[between_the_starts(), 1] += 7e-18
    estimate = Trajectory(drive.stamps_ns, positions, drive.quats_xyzw)
    scored = score_trajectory(Estimates.of(estimate), drive, TrajectoryScoreConfig())
    assert as_score(scored).number(ERRORS_BEYOND) == 0.0
    assert not scored.unjudged
