"""The buffer of odometry: interpolation between messages, gaps, new runs and repeated messages."""

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.nodes.localisation.odometry_buffer import OdometryBuffer

MS = 1_000_000
BEGIN_NS = 1_000_000_000_000
START = Transform(matrix_from_rotvec([0.1, -0.2, 2.0]), np.array([5.0, -3.0, 0.2]))


def pose_at(ms: int) -> Transform:
    turn = matrix_from_rotvec(np.array([0.0, 0.03, 0.4]) * ms / 1000)
    return Transform(START.rotation @ turn, START.translation + ms / 1000)


def filled(period_ms: int = 100, count: int = 11) -> OdometryBuffer:
    prior = OdometryBuffer()
    for ms in range(0, period_ms * count, period_ms):
        prior.add(BEGIN_NS + ms * MS, pose_at(ms))
    return prior


@given(st.integers(0, 1000), st.integers(0, 1000))
def test_between_messages_it_is_interpolated(before_ms: int, now_ms: int) -> None:
    motion = filled().between(BEGIN_NS + before_ms * MS, BEGIN_NS + now_ms * MS, 0.0)
    assert motion.matrix == pytest.approx((pose_at(before_ms).inverse() @ pose_at(now_ms)).matrix, abs=1e-12)


def between(prior: OdometryBuffer, before_ms: int, now_ms: int, wait_s: float = 0.0) -> Transform | None:
    return prior.between(BEGIN_NS + before_ms * MS, BEGIN_NS + now_ms * MS, wait_s)


def test_what_messages_do_not_cover_is_not_known_or_waited_for() -> None:
    prior = filled()
    assert between(prior, -1, 500) is None
    assert between(prior, 500, 1001) is None
    assert OdometryBuffer().between(0, 1, 10.0) is None  # and nobody waits for what never came
    sparse = filled(period_ms=600, count=3)
    assert between(sparse, 0, 600) is not None
    assert between(sparse, 0, 300) is None
    threading.Timer(0.1, lambda: prior.add(BEGIN_NS + 1100 * MS, START)).start()
    assert between(prior, 0, 1050, 60.0) is not None


@pytest.mark.parametrize("position", [[0.0, 0.0, 6e8], [-9e8, 9e8, 0.0]])
def test_a_motion_that_no_rover_makes_is_no_guess(position: list[float]) -> None:
    """The odometry jumps far away, and remains there."""
    prior = filled()
    for ms in (1100, 1200, 1300):
        prior.add(BEGIN_NS + ms * MS, Transform(START.rotation, np.array(position)))
    assert between(prior, 1000, 1200) is None
    motion = between(prior, 1100, 1300)
    assert motion is None or np.abs(motion.translation).max() < 1e-6


def test_a_new_run_clears_the_buffer_and_a_repeated_message_does_not() -> None:
    """The rule is that of the images (`RunOrder`)."""
    prior = filled(count=31)
    for ms in (3000, 2950, 500):  # sent again, late, a single one of another time
        prior.add(BEGIN_NS + ms * MS, START)
        assert between(prior, 2000, 3000) is not None
    for ms in (0, 100, 200):
        prior.add(BEGIN_NS + ms * MS, pose_at(ms))
    assert between(prior, 2000, 3000) is None
    assert between(prior, 0, 200).matrix == pytest.approx((pose_at(0).inverse() @ pose_at(200)).matrix, abs=1e-12)
