# ruff: noqa: E402 - ROS may be absent
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from nav_msgs.msg import Odometry
from scenes import sent

from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.nodes.messages.fields import byte_array, header_msg


@settings(deadline=None)  # the first call loads the type support
@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_are_exact(stamp_ns: int) -> None:
    assert stamp_of(sent(Odometry(header=header_msg(stamp_ns, "ds")))) == stamp_ns


@pytest.mark.parametrize(
    "values", [np.zeros((0, 3), np.float32), np.arange(12.0).reshape(3, 4)[:, ::2], np.uint8(7)[None]]
)
def test_bytes_are_those_of_the_array_row_by_row(values: np.ndarray) -> None:
    assert byte_array(values).tobytes() == values.tobytes()
