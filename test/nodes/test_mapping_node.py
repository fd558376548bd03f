"""The mapping node over DDS."""

# ruff: noqa: E402 - ROS may be absent

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from made_scene import NAV_RIG, nav_pair
from nav_msgs.msg import OccupancyGrid
from peers import Capture, LocalNode
from processes import Peer
from scenes import calls, disparity_of, problems, raw, send_infos, send_pair, sent
from sensor_msgs.msg import PointCloud2
from stereo_msgs.msg import DisparityImage

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.io import bag_messages
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.mapping.config import MappingConfig, TerrainConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.terrain.grid import elevation_grid
from sfr_loc_map.nodes.diagnostics import values_of
from sfr_loc_map.nodes.mapping_node import MappingNode
from sfr_loc_map.nodes.messages.point_cloud import cloud_from_msg
from sfr_loc_map.nodes.messages.terrain import elevation_msg, hazard_msg


def send_nav(peer: Peer, index: int, *, pose: bool = True) -> None:
    item = nav_pair(index)
    if pose:
        message = raw(bag_messages.pose(item.pair.stamp_ns, item.T_lm_navsb))
        peer.publish(PoseStamped, "nav/pose", message)
    send_pair(peer, "nav", item.pair)


def test_mapping_makes_disparities_and_clouds_of_sets_of_pairs(ros: None, capfd: Capture) -> None:
    arguments = ["--ros-args", "-p", "pairs_per_map:=2", "-p", "pose_wait_s:=1.0"]
    with Peer() as peer, LocalNode(peer, capfd, MappingNode, *arguments):
        clouds = peer.listen(PointCloud2, "mapping/points")
        disparities = peer.listen(DisparityImage, "mapping/disparity")
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        send_infos(peer, "nav", NAV_RIG)
        mapper = Mapper(NAV_RIG, MappingConfig())
        maps = [mapper.process(nav_pair(i).pair, nav_pair(i).T_lm_navsb, i % 2) for i in range(3)]
        for index in range(3):
            send_nav(peer, index)
            peer.until(lambda index=index: len(disparities) > index, "disparity")
            found = disparity_of(disparities[index])
            assert np.array_equal(found, maps[index].disparity_px, equal_nan=True)
        peer.until(lambda: clouds, "the first cloud")
        expected = mapper.fuse(maps[:2]).cloud.to_structured()
        assert np.array_equal(cloud_from_msg(clouds[0]).to_structured(), expected)
        assert clouds[0].header.frame_id == "lm"
        send_nav(peer, 3, pose=False)
        peer.until(lambda: any("no nav/pose of its stamp" in text for text in problems(diagnostics)), "the bound")
        answer = peer.call("mapping_node/finish")
        assert answer.success
        peer.until(lambda: len(clouds) == 2, "the second cloud")
        topics = {"points": PointCloud2, "elevation": PointCloud2, "hazard": OccupancyGrid}
        late = {name: peer.listen(kind, f"mapping/{name}", latched=True) for name, kind in topics.items()}
        peer.until(lambda: all(late.values()), "the last map for who comes late")
        assert late["points"] == clouds[1:]
        last = mapper.fuse(maps[2:])
        grid = elevation_grid(last.cloud, TerrainConfig(), last.T_lm_left, last.random_sigma)
        stamp_ns = stamp_of(clouds[1])
        # as text: there are NaN in it
        assert list(map(str, late["elevation"])) == [str(sent(elevation_msg(grid, stamp_ns, "lm")))]
        assert late["hazard"] == [sent(hazard_msg(grid, stamp_ns, "lm"))]
        expected = mapper.fuse(maps[2:]).cloud.to_structured()
        assert np.array_equal(cloud_from_msg(clouds[1]).to_structured(), expected)
        assert not peer.call("mapping_node/finish").success
        assert [values_of(status)["state"] for status in calls(diagnostics)] == [
            "mapped",
            "mapped",
            "fused",
            "mapped",
            "fused",
        ]


def test_mapping_of_more_than_three_pairs_is_refused(ros: None) -> None:
    with pytest.raises(ConfigError, match=r"'pairs_per_map' is 4: must lie in 1 \.\. 3"):
        MappingNode(cli_args=["--ros-args", "-p", "pairs_per_map:=4"])
