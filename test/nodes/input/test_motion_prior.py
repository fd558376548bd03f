import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.nodes.input.motion_prior import OdometryBuffer

MS = 1_000_000
START = Transform(matrix_from_rotvec([0.1, -0.2, 2.0]), np.array([5.0, -3.0, 0.2]))


def pose_at(ms: int) -> Transform:
    turn = matrix_from_rotvec(np.array([0.0, 0.03, 0.4]) * ms / 1000)
    return Transform(START.rotation @ turn, START.translation + ms / 1000)


def filled(period_ms: int = 100, count: int = 11) -> OdometryBuffer:
    prior = OdometryBuffer()
    for ms in range(0, period_ms * count, period_ms):
        prior.add(ms * MS, pose_at(ms))
    return prior


@given(st.integers(0, 1000), st.integers(0, 1000))
def test_between_messages_it_is_interpolated(before_ms: int, now_ms: int) -> None:
    motion = filled().between(before_ms * MS, now_ms * MS, 0.0)
    assert motion.matrix == pytest.approx((pose_at(before_ms).inverse() @ pose_at(now_ms)).matrix, abs=1e-12)


def test_what_messages_do_not_cover_is_not_known_or_waited_for() -> None:
    prior = filled()
    assert prior.between(-1, 500 * MS, 0.0) is None
    assert prior.between(500 * MS, 1000 * MS + 1, 0.0) is None
    assert OdometryBuffer().between(0, 1, 10.0) is None  # and nobody waits for what never came
    sparse = filled(period_ms=600, count=3)
    assert sparse.between(0, 600 * MS, 0.0) is not None
    assert sparse.between(0, 300 * MS, 0.0) is None
    threading.Timer(0.1, lambda: prior.add(1100 * MS, START)).start()
    assert prior.between(0, 1050 * MS, 60.0) is not None
