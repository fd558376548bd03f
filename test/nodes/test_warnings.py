"""What localiser and mapper find suspicious shows on /diagnostics."""

# ruff: noqa: E402 - ROS may be absent
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from made_scene import LOC_RIG, NAV_RIG, T_RB_LOCSB, loc_pair, nav_pair
from processes import Peer
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from scenes import calls, raw, send_infos, send_pair

from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.io import bag_messages
from sfr_loc_map.nodes.diagnostics import Level, level_of, values_of
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.mapping_node import MappingNode

ROWS = 1
MOUNT = [
    Parameter("T_rb_locsb.translation_m", value=T_RB_LOCSB.translation.tolist()),
    Parameter("T_rb_locsb.quat_xyzw", value=T_RB_LOCSB.file_quat_xyzw.tolist()),
]


def lowered(pair: StereoPair) -> StereoPair:
    """Return a pair whose right camera looks up a little: all it sees lies a row lower."""
    return replace(pair, right=np.ascontiguousarray(np.roll(pair.right, ROWS, axis=0)))


def started(node: ManagedNode, peer: Peer) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(peer.node)
    peer.executor = executor
    node.start()


def healths(diagnostics: list[DiagnosticArray]) -> list[tuple[Level, str, dict[str, str]]]:
    statuses = [s for array in diagnostics for s in array.status if s.name.endswith(": health")]
    return [(level_of(s), s.message, values_of(s)) for s in statuses]


def test_a_suspicious_map_is_a_warning_in_its_call_and_in_the_health(ros: None) -> None:
    node = MappingNode(parameter_overrides=[Parameter("pairs_per_map", value=1)])
    with Peer() as peer:
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        started(node, peer)
        send_infos(peer, "nav", NAV_RIG)
        item = nav_pair(0)
        peer.publish(PoseStamped, "nav/pose", raw(bag_messages.pose(item.pair.stamp_ns, item.T_lm_navsb)))
        send_pair(peer, "nav", lowered(item.pair))
        peer.until(lambda: len(calls(diagnostics)) == 2, "map")
        assert level_of(calls(diagnostics)[0]) is Level.WARN
        peer.until(
            lambda: any(lv is Level.WARN and "vertical disparity" in text for lv, text, _ in healths(diagnostics)),
            "warning",
        )
        node.destroy_node()


def test_offsets_of_the_right_camera_are_figures_and_warned_of(ros: None) -> None:
    node = LocalisationNode(parameter_overrides=MOUNT)
    with Peer() as peer:
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        started(node, peer)
        send_infos(peer, "loc", LOC_RIG)
        for index in range(0, 30, 2):
            send_pair(peer, "loc", lowered(loc_pair(index)))
            peer.until(lambda count=index // 2: len(calls(diagnostics)) > count, "call")
        values = values_of(calls(diagnostics)[-1])
        assert float(values["statistic.vertical_offset_px"]) == pytest.approx(ROWS, abs=0.2)
        assert abs(float(values["statistic.roll_offset_px"])) < 0.3
        assert "statistic.disparity_offset_px" in values
        text = "vertical disparity of more than 0.3 px"
        peer.until(lambda: any(lv is Level.WARN and text in words for lv, words, _ in healths(diagnostics)), "warning")
        last = values["statistic.vertical_offset_px"]
        peer.until(lambda: healths(diagnostics)[-1][2].get("vertical_offset_px") == last, "figure in the health")
        node.destroy_node()
