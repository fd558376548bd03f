"""An estimate is of an image: other stamps than those of the images, and images in short gaps, are deviations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from helpers.made_scene import LOC_RIG
from helpers.scored_drives import COUNT, PERIOD_NS, straight
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.tables.pose_columns import TrajectoryFormat
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.metrics.config import ScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.deviations import deviations_of
from sfr_loc_map.scoring.inputs import DriveToScore, Run, ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.score_run import score_run

CONFIG = ScoreConfig(TrajectoryScoreConfig(conditions=("distance=5",)))
DENSE = straight(10 * COUNT)


def scored(estimate: Trajectory, images_ns: np.ndarray, truth: Trajectory) -> Score:
    return score_run(Run(drive=DriveToScore(Estimates.of(estimate), truth, LOC_RIG, images_ns)), CONFIG, None)


@pytest.mark.parametrize(
    ("shift_ns", "beside"), [(0, 0), (400_000, 0), (-1_000_000, 0), (2_000_000, COUNT - 1), (-400_000_000, COUNT - 1)]
)
def test_estimates_beside_their_images_are_counted(shift_ns: int, beside: int) -> None:
    """Stamps that a file rounded to milliseconds are those of the images."""
    images_ns = straight().stamps_ns * 10
    stamps_ns = images_ns + np.where(np.arange(COUNT) > 0, shift_ns, 0)
    estimate = Trajectory(stamps_ns, straight().positions * 10, straight().quats_xyzw)
    score = scored(estimate, images_ns, DENSE)
    assert score.association is not None
    assert score.association.beside_images == beside
    assert score.association.largest_image_difference_ns == abs(shift_ns)
    stated = [text for text in deviations_of(score) if f"{abs(shift_ns) / 1e6:.4g} ms" in text]
    assert len(stated) == bool(beside)


@pytest.mark.parametrize(
    ("every", "removed", "truth_every", "share"),
    [
        (12, 4, 1, 5 / 12),  # of each 12 images 4 are missing: 5 steps without an image
        (12, 8, 1, 9 / 12),
        (12, 0, 1, 0.0),
        (12, 4, 0, 0.0),  # a ground truth with ten poses for each image: no true pose is evidence of an image
        (12, 4, 4, 0.0),  # a ground truth that is sparser than the images
    ],
)
def test_images_that_are_missing_in_short_gaps_leave_path_without_images(
    every: int, removed: int, truth_every: int, share: float
) -> None:
    truth = straight()
    kept = np.arange(COUNT) % every >= removed
    images_ns = truth.stamps_ns[kept]
    if truth_every == 0:
        poses = straight(10 * COUNT, scale=0.1)
        truth = Trajectory(np.arange(10 * COUNT) * (PERIOD_NS // 10), poses.positions, poses.quats_xyzw)
    elif truth_every > 1:
        truth = Trajectory(*(values[::truth_every] for values in (truth.stamps_ns, truth.positions, truth.quats_xyzw)))
    drive = straight()
    estimate = Trajectory(images_ns, drive.positions[kept], drive.quats_xyzw[kept])
    found = scored(estimate, images_ns, truth).number("path_without_images")
    assert found == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize(
    ("without_stamps", "stated"), [((), 0), (("estimate",), 1), (("truth",), 1), (("estimate", "truth"), 2)]
)
def test_poses_that_are_assigned_by_their_numbers_are_a_deviation(
    tmp_path: Path, without_stamps: tuple[str, ...], stated: int
) -> None:
    """An estimate with rows moved up by one has no delay in the figures."""
    for name in ("estimate", "truth"):
        save_trajectory(tmp_path / f"{name}.kitti", straight(), TrajectoryFormat.KITTI)
    for name in without_stamps:
        (tmp_path / f"{name}.times.txt").unlink()
    run = load_run(ScoreInputs(estimate=tmp_path / "estimate.kitti", truth=tmp_path / "truth.kitti"))
    score = score_run(run, CONFIG, None)
    found = [text for text in deviations_of(score) if "has no stamps" in text]
    assert len(found) == stated
    assert {text[:-1] for text in found} <= set(score.warnings)
