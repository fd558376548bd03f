"""The mapping node over DDS."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import PointCloud2
from stereo_msgs.msg import DisparityImage

from helpers.made_scene import NAV_RIG, nav_pair
from helpers.manager import Capture, LocalNode, Manager
from helpers.node_scenes import calls, disparity_of, params, raw, send_infos, send_pair, sent
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.mapping.config import MappingConfig, TerrainConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.terrain.terrain_grid import terrain_grid
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import Level
from sfr_loc_map.nodes.mapping_node import MappingNode
from sfr_loc_map.nodes.pair_node import PairNode
from sfr_loc_map.ros.grid_messages import elevation_msg, hazard_msg
from sfr_loc_map.ros.point_messages import cloud_from_msg
from sfr_loc_map.ros.statuses import level_of, values_of


def test_pairs_that_wait_for_their_poses_are_dropped_at_a_deactivation(ros: None, capfd: Capture) -> None:
    """As are the poses: a pair of the first activation has no pose in the second."""
    with Manager("mapping_node") as peer, LocalNode(peer, capfd, MappingNode, *params("pose_wait_s:=600.0")) as node:
        disparities = peer.listen(DisparityImage, "mapping/disparity")

        def send_pose(index: int) -> None:
            pose = bag_messages.pose(nav_pair(index).pair.stamp_ns, nav_pair(index).T_lm_navsb)
            peer.publish(PoseStamped, "nav/pose", raw(pose))

        send_infos(peer, "nav", NAV_RIG)
        send_pair(peer, "nav", nav_pair(0).pair)
        peer.until(lambda: not node.node.waits_for().startswith("Waiting for 2 topics"), "the pair")
        assert peer.change(Transition.TRANSITION_DEACTIVATE) == (True, "inactive")
        assert peer.change(Transition.TRANSITION_ACTIVATE) == (True, "active")
        send_infos(peer, "nav", NAV_RIG)
        for index in (0, 1):
            send_pose(index)
        send_pair(peer, "nav", nav_pair(1).pair)
        peer.until(lambda: disparities, "disparity")
        peer.spin(0.2)
        assert [stamp_of(message) for message in disparities] == [nav_pair(1).pair.stamp_ns]


def rows_of(doc: str | None) -> dict[str, tuple[str, ...]]:
    """The cells of the table in a docstring by its first column."""
    lines = [line.strip(" |").split(" | ") for line in (doc or "").splitlines() if line.strip().startswith("| ")]
    return {name: tuple(cells) for name, *cells in lines}


@pytest.mark.parametrize("event", ["activation", "`~/reset`", "new run"])
def test_what_an_event_clears_is_what_the_table_of_the_nodes_states(ros: None, capfd: Capture, event: str) -> None:
    rows = rows_of(PairNode.__doc__)
    column = rows["state"].index(event)
    with Manager("mapping_node") as peer, LocalNode(peer, capfd, MappingNode, *params()) as local:
        node = local.node
        node._matching.add_pair(1, object())
        node._matching.add_pose(10**9, Transform.identity())
        node._pairs.append(object())
        if event == "activation":
            assert peer.change(Transition.TRANSITION_DEACTIVATE) == (True, "inactive")
            assert peer.change(Transition.TRANSITION_ACTIVATE) == (True, "active")
        elif event == "new run":
            node.on_new_run("the stamps have jumped")
        else:
            assert peer.call("mapping_node/reset").success
        done = threading.Event()
        node.worker.enqueue(done.set)
        peer.until(done.is_set, "the worker")
        found = {
            "pairs that wait for a pose": node._matching._waiting,
            "poses of `nav/pose`": node._matching._poses,
            "map in progress": node._pairs,
        }
        assert {name: bool(state) for name, state in found.items()} == {
            name: rows[name][column].startswith("kept") for name in found
        }


def test_a_changed_parameter_applies_to_the_pairs_that_are_received_after_the_change(ros: None, capfd: Capture) -> None:
    with Manager("mapping_node") as peer, LocalNode(peer, capfd, MappingNode, *params("pairs_per_map:=1")) as node:
        clouds = peer.listen(PointCloud2, "mapping/points")
        elevations = peer.listen(PointCloud2, "mapping/elevation")
        before = MappingConfig()
        after = replace(before, max_range_m=6.0, terrain=TerrainConfig(cell_m=0.25))
        free = threading.Event()
        node.node.worker.enqueue(lambda: print(free.wait(30)))
        send_infos(peer, "nav", NAV_RIG)

        def send(index: int) -> None:
            item = nav_pair(index)
            peer.publish(PoseStamped, "nav/pose", raw(bag_messages.pose(item.pair.stamp_ns, item.T_lm_navsb)))
            send_pair(peer, "nav", item.pair)
            peer.until(lambda: node.node.worker.waiting == index + 1, "the pair")

        send(0)
        assert peer.set(mapping__max_range_m=6.0, mapping__terrain__cell_m=0.25) == ""
        send(1)
        free.set()
        peer.until(lambda: len(elevations) == 2, "both maps")
        for index, config in enumerate((before, after)):
            item, mapper = nav_pair(index), Mapper(NAV_RIG, config)
            fused = mapper.fuse([mapper.process(item.pair, item.T_lm_navsb, 0)])
            assert np.array_equal(cloud_from_msg(clouds[index]).to_structured(), fused.cloud.to_structured())
            grid = terrain_grid(fused.cloud, config.terrain, fused.poses_lm_left, fused.random_sigma)
            assert str(elevations[index]) == str(sent(elevation_msg(grid, item.pair.stamp_ns, "lm")))


def test_mapping_makes_disparities_and_clouds_of_sets_of_pairs(ros: None, capfd: Capture) -> None:
    arguments = params("pairs_per_map:=2", "pose_wait_s:=0.6", "health.period_s:=0.1", "health.window_s:=0.5")
    with Manager("mapping_node") as peer, LocalNode(peer, capfd, MappingNode, *arguments):
        clouds = peer.listen(PointCloud2, "mapping/points")
        disparities = peer.listen(DisparityImage, "mapping/disparity")
        send_infos(peer, "nav", NAV_RIG)
        mapper = Mapper(NAV_RIG, MappingConfig())
        maps = [mapper.process(nav_pair(i).pair, nav_pair(i).T_lm_navsb, i % 2) for i in range(3)]

        def send(index: int, pair: StereoPair) -> None:
            pose = bag_messages.pose(pair.stamp_ns, nav_pair(index).T_lm_navsb)
            peer.publish(PoseStamped, "nav/pose", raw(pose))
            send_pair(peer, "nav", pair)

        for index in range(3):
            send(index, nav_pair(index).pair)
            peer.until(lambda index=index: len(disparities) > index, "disparity")
            found = disparity_of(disparities[index])
            assert np.array_equal(found, maps[index].disparity_px, equal_nan=True)
        peer.until(lambda: clouds, "the first cloud")
        expected = mapper.fuse(maps[:2]).cloud.to_structured()
        assert np.array_equal(cloud_from_msg(clouds[0]).to_structured(), expected)
        assert clouds[0].header.frame_id == "lm"
        send_pair(peer, "nav", nav_pair(3).pair)
        peer.refused("no usable nav/pose with its stamp")
        assert peer.call("mapping_node/finish").success
        peer.until(lambda: len(clouds) == 2, "the second cloud")
        topics = {"points": PointCloud2, "elevation": PointCloud2, "hazard": OccupancyGrid}
        late = {name: peer.listen(kind, f"mapping/{name}", latched=True) for name, kind in topics.items()}
        peer.until(lambda: all(late.values()), "the last map for who comes late")
        assert late["points"] == clouds[1:]
        last = mapper.fuse(maps[2:])
        grid = terrain_grid(last.cloud, TerrainConfig(), last.poses_lm_left, last.random_sigma)
        stamp_ns = stamp_of(clouds[1])
        # as text: there are NaN in it
        assert list(map(str, late["elevation"])) == [str(sent(elevation_msg(grid, stamp_ns, "lm")))]
        assert late["hazard"] == [sent(hazard_msg(grid, stamp_ns, "lm"))]
        assert np.array_equal(cloud_from_msg(clouds[1]).to_structured(), last.cloud.to_structured())
        assert not peer.call("mapping_node/finish").success
        told = [values_of(status) for status in calls(peer.diagnostics)]
        states = ["mapped", "mapped", "fused", "mapped_set", "mapped", "fused", "mapped_set"]
        assert [values["state"] for values in told] == states
        seconds = [float(values["processing_time_s"]) for values in told]
        assert (seconds[3], seconds[6]) == (sum(seconds[:3]), sum(seconds[4:6]))

        pair = nav_pair(4).pair  # the right camera looks up a little: all it sees lies a row lower
        send(4, replace(pair, right=np.ascontiguousarray(np.roll(pair.right, 1, axis=0))))
        peer.well(Level.WARN, "vertical disparity")
        peer.until(lambda: level_of(calls(peer.diagnostics)[-1]) is Level.WARN, "the call, which may follow the health")
