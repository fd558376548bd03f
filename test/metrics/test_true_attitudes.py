"""A truth with incomplete attitudes: its placeholders affect no figure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.config import AlignedErrorConfig, AssociationConfig
from sfr_loc_map.metrics.conventions.convention_diagnosis import diagnose
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention, converted_estimates
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.trajectory.aligned_error import aligned_errors

PERIOD_NS = 100_000_000


def bend_on_slope(count: int = 300, slope_deg: float = 15.0) -> Trajectory:
    """The exact poses of a drive with steps of 0.1 m along a bend on a slope; the first pose is on the slope."""
    heading = np.linspace(0.0, 2.0, count)
    steps = 0.1 * np.column_stack((np.cos(heading), np.sin(heading), np.zeros(count)))
    slope = Rotation.from_euler("y", slope_deg, degrees=True)
    quats = (slope * Rotation.from_euler("z", heading[:, None])).as_quat()
    return Trajectory(np.arange(count) * PERIOD_NS, slope.apply(np.cumsum(steps, axis=0)), quats)


def without_tilt(poses: Trajectory) -> Truth:
    """The truth of the drive with placeholders for roll and pitch."""
    x, y, _ = Rotation.from_quat(poses.quats_xyzw).as_matrix()[:, :, 0].T
    level = Rotation.from_euler("z", np.arctan2(y, x)[:, None]).as_quat()
    return Truth(poses.stamps_ns, poses.positions, level, has_tilt=False)


def without_attitudes(poses: Trajectory) -> Truth:
    """The truth of the drive with positions alone."""
    return Truth(poses.stamps_ns, poses.positions, np.zeros_like(poses.quats_xyzw))


@pytest.mark.parametrize("align", ["none", "origin", "se3"])
@pytest.mark.parametrize("turned_deg", [0.0, 40.0])
def test_an_exact_estimate_has_no_aligned_error_without_true_roll_and_pitch(align: str, turned_deg: float) -> None:
    """The heading of an estimate in another world frame is corrected by the alignment."""
    exact = bend_on_slope()
    yaw = Rotation.from_euler("z", turned_deg if align != "none" else 0.0, degrees=True)
    quats = (yaw * Rotation.from_quat(exact.quats_xyzw)).as_quat()
    estimate = Trajectory(exact.stamps_ns, yaw.apply(exact.positions), quats)
    found = aligned_errors(estimate, without_tilt(exact), AlignedErrorConfig(align=align, rpe_delta="distance=5"))
    score = Score(figures=found.figures)
    for name in ("ape", "rpe"):
        translation, rotation = (score.figure(name, part=part) for part in ("translation", "rotation"))
        assert translation.n > 0
        assert translation.max < 1e-9
        assert (rotation.n, rotation.max) == (0, None)


@pytest.mark.parametrize("incomplete", [without_tilt, without_attitudes])
def test_the_world_frame_is_not_aligned_with_placeholders(incomplete: Callable[[Trajectory], Truth]) -> None:
    exact = bend_on_slope()
    convention = PoseConvention(world="first_pose")
    with pytest.raises(MetricsError, match="world=first_pose requires true attitudes"):
        converted_estimates(Estimates.of(exact), convention, Transform.identity(), incomplete(exact))


@pytest.mark.parametrize("incomplete", [without_tilt, without_attitudes])
def test_an_estimate_is_not_diagnosed_by_placeholders(incomplete: Callable[[Trajectory], Truth]) -> None:
    exact = bend_on_slope()
    found = diagnose(exact, incomplete(exact), AssociationConfig())
    assert found.disagreement == pytest.approx(0.0, abs=1e-9)
    assert found.found is None
