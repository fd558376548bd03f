"""Scores for the tests of the report, computed by the functions of the score from invented runs."""

from functools import cache
from typing import Any

import numpy as np
from msgspec.structs import replace

from helpers.score_rows import complete
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.calls.call_score import score_calls, score_target
from sfr_loc_map.metrics.calls.calls import Calls
from sfr_loc_map.metrics.config import MapScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.details import Details
from sfr_loc_map.metrics.figures.records import InputFile, Provenance
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.judging.judge import judged_by, with_verdicts
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.map.map_score import score_map
from sfr_loc_map.metrics.map.pair_truth import PairTruth
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_dict
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.suite_names import Task

START_NS = 1_700_000_000_123_456_789
LIMITS = {
    "trajectory": [
        {"condition": "distance=5", "position_mean_plus_3sigma_m": 0.000001, "heading_mean_plus_3sigma_deg": 90},
        {"condition": "distance=500", "position_mean_plus_3sigma_m": 0.1},
    ],
    "memory": {"localisation_peak_bytes": 2_000_000_000},
}
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"


def drive(frames: int) -> tuple[Estimates, Trajectory]:
    """Return an estimate and its truth, a bend with steps of 0.1 m.

    The error is a random walk of 1 mm a step and noise of the yaw.
    """
    rng = np.random.default_rng(3)
    stamps = START_NS + np.arange(frames) * 500_000_000
    heading = np.linspace(0.0, 2.0, frames)
    steps = 0.1 * np.column_stack((np.cos(heading), np.sin(heading), 0.2 * np.sin(8 * heading)))
    truth = np.cumsum(steps, axis=0)
    quats = np.column_stack((np.zeros((frames, 2)), np.sin(heading / 2), np.cos(heading / 2)))
    wander = np.cumsum(rng.normal(0, 1e-3, (frames, 3)), axis=0)
    yaw = heading + rng.normal(0, 2e-4, frames)
    estimated_quats = np.column_stack((np.zeros((frames, 2)), np.sin(yaw / 2), np.cos(yaw / 2)))
    covariance = np.zeros((frames, 21))
    covariance[:, [0, 6, 11, 15, 18, 20]] = 1e-6 * np.arange(1, frames + 1)[:, None]
    lost = np.zeros(frames, np.bool_)
    lost[frames // 2 : frames // 2 + 3] = True
    estimates = Estimates.of(Trajectory(stamps, truth + wander, estimated_quats), lost, covariance=covariance)
    return estimates, Trajectory(stamps, truth, quats)


def calls(frames: int, pairs: int) -> Calls:
    """Calls of localiser and mapper."""
    rng = np.random.default_rng(4)
    count = frames + pairs
    stamps = START_NS + np.arange(count) * 500_000_000
    states = ["initialising"] + ["tracking"] * (frames - 1) + ["mapped"] * pairs
    memory = 4e8 + rng.random(count) * 1e7
    keyframe = np.where(np.arange(count) % 5 == 0, 0.02, np.nan)
    stages = {"align": 0.01 * rng.random(count), "keyframe": keyframe}
    return Calls(stamps, 0.03 + 0.01 * rng.random(count), states, memory, memory - 3e8, stages)


def expected_calls(frames: int, pairs: int) -> dict[Task, IntArray]:
    """The pairs that should have one of `calls`."""
    stamps = calls(frames, pairs).stamps_ns
    return {Task.LOCALISATION: stamps[:frames], Task.MAPPING: stamps[frames:]}


def with_rows(figures: tuple[Figure, ...], rows: tuple[Figure, ...]) -> tuple[Figure, ...]:
    """Rows, then those of a table that are about something else."""
    known = {row.keys for row in rows}
    return (*rows, *(row for row in figures if row.keys not in known))


def with_target(score: Score) -> Score:
    """A score with `calls` that were measured on a target."""
    rows, target = score_target(calls(300, 2), "GR740", expected_calls(300, 2), has_stamps=True)
    return replace(score, figures=with_rows(score.figures, rows), target=target)


def cloud(side: int, pairs: int) -> tuple[PointCloud, list[PairTruth]]:
    """Sloping ground before the camera, with errors that grow with the square of the range."""
    rng = np.random.default_rng(5)
    rig = StereoRig(side, side, side * 0.8, side * 0.8, side / 2 - 0.5, side / 2 - 0.5, 0.25)
    u, v = np.meshgrid(np.arange(side), np.arange(side))
    ray = np.stack(((u - rig.cx) / rig.fx, (v - rig.cy) / rig.fy, np.ones(u.shape)), axis=-1)
    depth = 1.5 / np.maximum(ray[..., 1], 0.05)
    points = (ray * depth[..., None]).astype(np.float32)
    points[: side // 2] = np.nan
    truths = [PairTruth(points, Transform(np.eye(3), np.zeros(3)), rig) for _ in range(pairs)]
    rows, columns = np.nonzero(np.isfinite(points).all(axis=2))
    xyz, count = points[rows, columns], len(rows)
    parts = []
    for number in range(pairs):
        sigma = 0.1 * xyz[:, 2] ** 2 / (rig.fx * rig.baseline_m)
        moved = xyz * (1 + sigma * rng.standard_normal(count) / xyz[:, 2])[:, None]
        pixels = columns.astype(np.uint16), rows.astype(np.uint16), np.full(count, number, np.uint8)
        floats = moved.astype(np.float32), sigma.astype(np.float32), np.zeros(count, np.float32)
        parts.append(PointCloud(*floats, *pixels, fused=False))
    return PointCloud.concatenate(parts), truths


@cache
def whole_score(frames: int = 300, side: int = 96, pairs: int = 2) -> Score:
    """A score with every part: trajectory, map, calls, verdicts of all three kinds, provenance with a hostile path."""
    config = TrajectoryScoreConfig(conditions=("distance=5", "distance=500"))
    made = Provenance(
        version="0.1.0",
        inputs={"estimate": InputFile(path=HOSTILE, sha256="0" * 64)},
        configuration={"unknown": None},
        time="2024-02-29T12:00:00+00:00",
    )
    driven = score_trajectory(*drive(frames), config)
    mapped = score_map(*cloud(side, pairs), MapScoreConfig())
    called = score_calls(calls(frames, pairs), expected_calls(frames, pairs))
    rows = (*driven.figures, *mapped.figures, *called.figures)
    score = Score(
        figures=with_rows(complete()[2:], rows),
        association=driven.association,
        truth=driven.truth,
        provenance=made,
        cloud=mapped.cloud,
        calls=called.records,
        details=Details(trajectory=driven.details, map=mapped.details, calls=dict(called.plots)),
    )
    return judged_by(score, parse_limits(LIMITS, "test"))


def half(score: Score) -> Score:
    """The score of an estimate of half of the images."""
    rows = []
    for row in score.figures:
        values = {("missing", None): 0.5, ("missing", "count"): 0.5 * (row.n or 0), ("judged", "drive"): 0.5}
        values["in_gaps", None] = 0.5
        place = (row.figure, row.part)
        rows.append(replace(row, value=values[place]) if place in values else row)
    return with_verdicts(replace(score, figures=tuple(rows)))


def of_map(score: Score) -> Score:
    """The score of the map alone, with its calls."""
    of_drive_alone = {"drive", None}
    rows = [
        row
        for row in without(score, "trajectory").figures
        if row.subject != "completeness" or row.part not in of_drive_alone or row.figure.startswith(("p", "c"))
    ]
    return replace(without(score, "trajectory"), figures=tuple(rows))


def of_drive(score: Score) -> Score:
    """The score of the drive alone, with its calls."""
    rows = [row for row in without(score, "map").figures if row.part != "map"]
    return replace(without(score, "map"), figures=tuple(rows))


def without(score: Score, *subjects: str) -> Score:
    """Return the score without the figures and details of some subjects."""
    gone = {"trajectory": ("association", "truth"), "map": ("cloud",), "timing": ("calls",)}
    absent = dict.fromkeys([name for subject in subjects for name in gone.get(subject, ())])
    figures = tuple(row for row in score.figures if row.subject not in subjects)
    verdicts = tuple(replace(item, row=None) for item in score.verdicts)
    return replace(score, figures=figures, verdicts=verdicts, **absent)


def place_of(score: Score, figure: str, **where: str | None) -> str:
    """The place of a row in the JSON."""
    return f"figures.{score.figures.index(score.figure(figure, **where))}"


def json_of(score: Score) -> dict[str, Any]:
    """The score as JSON values."""
    return to_dict(score)


def dig(value: Any, key: str) -> Any:
    """Return the JSON value at a key such as `figures.0.mean`."""
    for part in key.split("."):
        value = value[int(part) if isinstance(value, list) else part]
    return value
