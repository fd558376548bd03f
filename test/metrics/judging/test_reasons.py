"""Conditions that a drive never meets are reported before the drive is processed."""

from dataclasses import astuple

import numpy as np
import pytest

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.formulas import path_length_m
from sfr_loc_map.metrics.frames.association import StampedPoses
from sfr_loc_map.metrics.judging.reasons import conditions_beyond
from sfr_loc_map.metrics.trajectory.trajectory_errors import select

COUNT = 11
POSES = Trajectory(
    np.arange(COUNT, dtype=np.int64) * 10**9,
    np.arange(COUNT)[:, None] * [1.0, 0.0, 0.0],
    np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)),
)
"""A drive of 10 m in 10 s."""


def test_a_condition_that_a_drive_meets_within_rounding_is_not_reported() -> None:
    """The tolerance is that of the selection of sub-trajectories."""
    conditions = [Condition.parse(text) for text in ("distance=10", "displacement=10")]
    for short_m, reported in ((5e-10, 0), (1e-6, 2)):
        positions = POSES.positions * (1.0 - 0.1 * short_m)
        drive = Trajectory(POSES.stamps_ns, positions, POSES.quats_xyzw)
        assert len(conditions_beyond(drive, conditions)) == reported
        assert len(select(conditions[0], 1, StampedPoses(*astuple(drive)), path_length_m(positions))[0]) == (
            not reported
        )


@pytest.mark.parametrize("rows", [np.arange(COUNT), np.arange(COUNT)[::-1], np.roll(np.arange(COUNT), 4)])
def test_the_extent_of_a_drive_does_not_depend_on_the_order_of_its_poses(rows: np.ndarray) -> None:
    met = [Condition.parse(text) for text in ("distance=10", "time=10", "frames=10")]
    beyond = [Condition.parse(text) for text in ("distance=10.1", "time=10.1", "frames=11", "displacement=11")]
    assert conditions_beyond(POSES.at_rows(rows), met) == ()
    assert len(conditions_beyond(POSES.at_rows(rows), beyond)) == len(beyond)
