"""The three readings of the document against an oracle of matrices, which shares no code with the package."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from helpers import ROOT
from helpers.random_drives import as_score
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import Reading, TrajectoryScoreConfig
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.trajectory.trajectory_score import parsed_conditions, score_trajectory

SECOND = 1_000_000_000
READINGS = [reading for reading in Reading if not reading.is_fit]


def drive(seed: int, count: int = 60) -> tuple[Trajectory, Trajectory]:
    """A true drive with turns and slopes, and an estimate that drifts in position and attitude."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0.0, 0.08, count))
    tilt = np.cumsum(rng.normal(0.0, 0.01, (count, 2)), axis=0)
    turned = Rotation.from_euler("ZYX", np.column_stack([heading, tilt]))
    step = turned.apply(np.column_stack([rng.uniform(0.05, 0.3, count), np.zeros((count, 2))]))
    true = np.cumsum(step, axis=0)
    drift = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 0.01, (count, 3)), axis=0))
    estimated = drift * turned
    moved = np.cumsum(drift.apply(step) * rng.uniform(0.95, 1.05), axis=0) + rng.normal(0.0, 5.0, 3)
    stamps = np.arange(count, dtype=np.int64) * SECOND // 2
    return Trajectory(stamps, moved, estimated.as_quat()), Trajectory(stamps, true, turned.as_quat())


def ends_of(truth: Trajectory, condition: str, start: int) -> int | None:
    """The first frame at which all parts of a condition hold, tried one by one."""
    for end in range(start + 1, len(truth.stamps_ns)):
        path = np.linalg.norm(np.diff(truth.positions[start : end + 1], axis=0), axis=1).sum()
        straight = np.linalg.norm(truth.positions[end] - truth.positions[start])
        turn = Rotation.from_quat(truth.quats_xyzw[start]).inv() * Rotation.from_quat(truth.quats_xyzw[end])
        done = {
            "distance": path,
            "time": (truth.stamps_ns[end] - truth.stamps_ns[start]) / SECOND,
            "frames": end - start,
            "displacement": straight,
            "turn": np.degrees(turn.magnitude()),
        }
        wanted = (word.split("=") for word in condition.split(","))
        if all(done[name] >= float(value) - 1e-9 for name, value in wanted):
            return end
    return None


def oracle(estimate: Trajectory, truth: Trajectory, spans: list[tuple[int, int]], reading: str) -> dict[str, float]:
    """The figures of one reading over sub-trajectories from frame to frame."""
    errors, angles, headings = [], [], []
    for i, j in spans:
        A, B, C, D = (
            Rotation.from_quat(poses.quats_xyzw[k]).as_matrix() for poses in (truth, estimate) for k in (i, j)
        )
        move, true_move = estimate.positions[j] - estimate.positions[i], truth.positions[j] - truth.positions[i]
        of = lambda R: np.degrees(np.arctan2(R[1, 0], R[0, 0]))  # noqa: E731
        if reading == "pose":
            errors.append(A @ C.T @ move - true_move)
            difference, turned = B.T @ (A @ C.T @ D), of(A @ C.T @ D) - of(B)
        elif reading == "position":
            errors.append(move - true_move)
            difference, turned = B.T @ D, of(D) - of(B)
        else:
            errors.append(move - true_move)
            difference = (A.T @ B).T @ (C.T @ D)
            turned = (of(D) - of(C)) - (of(B) - of(A))
        angles.append(np.degrees(Rotation.from_matrix(difference).magnitude()))
        headings.append((turned + 180.0) % 360.0 - 180.0)
    error = np.array(errors)
    position = np.linalg.norm(error.mean(axis=0)) + 3.0 * np.linalg.norm(error.std(axis=0, ddof=1))
    attitude = np.mean(angles) + 3.0 * np.std(angles, ddof=1)
    return {
        "position": position,
        "attitude": attitude,
        "heading": abs(np.mean(headings)) + 3.0 * np.std(headings, ddof=1),
    }


@pytest.mark.clause("4.1.1", "4.1.2", "4.2.3.1", "4.2.3.2", "4.2.3.3")
@settings(max_examples=10)
@given(
    st.integers(0, 10**6),
    st.sampled_from(
        ["distance=2", "frames=7", "distance=1,time=4", "displacement=1.5", "turn=8", "time=3,turn=5,frames=4"]
    ),
    st.sampled_from([1, 5]),
)
def test_each_reading_is_that_of_the_oracle(seed: int, condition: str, spacing: int) -> None:
    estimate, truth = drive(seed)
    starts = range(0, len(truth.stamps_ns), spacing)
    spans = [(start, end) for start in starts if (end := ends_of(truth, condition, start)) is not None]
    expected = {reading: oracle(estimate, truth, spans, reading) for reading in READINGS}
    for used in READINGS:
        config = TrajectoryScoreConfig(conditions=(condition,), spacing=spacing, rebase=used)
        score = as_score(score_trajectory(Estimates.of(estimate), truth, config))
        assert score.association.reading is used
        for reading in READINGS:
            for name, value in expected[reading].items():
                row = score.figure(name, part=reading)
                assert row.n == len(spans)
                assert row.mean_plus_3sigma == pytest.approx(value, abs=1e-9)
            assert score.figure("position").part == used


def test_several_conditions_read_back() -> None:
    condition = Condition.parse("distance=5,time=10")
    assert condition.setting == "distance=5,time=10"
    assert Condition.parse(condition.setting) == condition
    assert condition.label == "5 m and 10 s"
    assert Condition.parse("time=10,distance=5") == condition, "whatever the order of its parts"
    given = ("time=10,distance=5", "distance=5", "distance=5,time=10", "distance=5.0")
    assert parsed_conditions(TrajectoryScoreConfig(conditions=given)) == [condition, Condition.parse("distance=5")]


def test_the_worked_example_of_the_page_on_rebasing() -> None:
    """60 m straight ahead at 0.1 deg/m: the table of docs/concepts/sub_trajectories.md."""
    along = 0.1 * np.arange(601)
    true = np.column_stack([along, np.zeros((601, 2))])
    drift = Rotation.from_euler("z", 0.1 * along[:, None], degrees=True)
    moved = np.cumsum(drift.apply(np.diff(true, axis=0, prepend=true[:1])), axis=0)
    stamps = np.arange(601, dtype=np.int64) * SECOND // 10
    straight = Trajectory(stamps, true, np.tile([0.0, 0.0, 0.0, 1.0], (601, 1)))
    estimates = Estimates.of(Trajectory(stamps, moved, drift.as_quat()))
    score = as_score(score_trajectory(estimates, straight, TrajectoryScoreConfig()))
    page = (ROOT / "docs/concepts/sub_trajectories.md").read_text()
    assert f"{score.figure('position').n} sub-trajectories of 5 m" in page
    for reading in READINGS:
        position, *angles = (
            score.number(name, "mean_plus_3sigma", part=reading) for name in ("position", "attitude", "heading")
        )
        assert f"| `{reading}` | {position:.3f} | {angles[0]:.2f} | {angles[1]:.2f} |" in page
