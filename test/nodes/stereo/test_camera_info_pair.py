"""The camera_info messages of both sides are joined only if they belong to one calibration."""

import pytest
from sensor_msgs.msg import CameraInfo

from sfr_loc_map.nodes.stereo.camera_info_pair import CameraInfoPair
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.suite_names import Side


def found_pairs(*messages: tuple[Side, int, float]) -> list[tuple[float, float]]:
    """Return the focal lengths of the joined messages, which are given by side, stamp and focal length."""
    pair = CameraInfoPair()
    joined = []
    for side, stamp_ns, focal in messages:
        both = pair.add(side, CameraInfo(header=header_msg(stamp_ns, side), p=[focal] + [0.0] * 11))
        if both is not None:
            joined.append((float(both[0].p[0]), float(both[1].p[0])))
    return joined


def test_a_lost_message_does_not_mix_two_calibrations() -> None:
    lost = [("left", 1, 5.0), ("right", 1, 5.0), ("right", 2, 5.0), ("left", 3, 6.0), ("right", 3, 6.0)]
    assert found_pairs(*lost) == [(5.0, 5.0), (6.0, 6.0)]


def test_repeated_messages_do_not_mix_two_calibrations() -> None:
    once = [("left", 1, 5.0), ("right", 1, 5.0), ("left", 2, 6.0), ("right", 2, 6.0)]
    twice = [message for message in once for _ in range(2)]
    assert found_pairs(*twice) == [(5.0, 5.0), (6.0, 6.0)]


@pytest.mark.parametrize("stamp_ns", [0, 2])
def test_a_calibration_in_which_one_camera_changes_is_used(stamp_ns: int) -> None:
    """Without stamps, once the other camera has published again."""
    first = [("left", 1, 5.0), ("right", 1, 5.0), ("right", stamp_ns, 5.0), ("left", stamp_ns, 6.0)]
    assert found_pairs(*first) == [(5.0, 5.0), (6.0, 5.0)][: 2 if stamp_ns else 1]
    assert found_pairs(*first, ("right", 3, 5.0))[:2] == [(5.0, 5.0), (6.0, 5.0)]
