"""The mapping node, which fuses up to three stereo pairs with known poses into one cloud.

Messages are received in the executor's thread, where pairs wait for their poses. Only the worker's thread uses the
mapper and changes the map in progress.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import PointCloud2
from stereo_msgs.msg import DisparityImage

from sfr_loc_map.calls.call_record import call_of_fusion, mapping_call, usage_of_stages
from sfr_loc_map.configuration.parameters import param
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.maps import FusedMap, MappedPair
from sfr_loc_map.mapping.terrain.terrain_grid import terrain_grid
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import Level
from sfr_loc_map.metrics.calls.call_meter import CallUsage
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.nodes.lifecycle.runner import run
from sfr_loc_map.nodes.pair_node import PairNode, PairNodeConfig, decoded
from sfr_loc_map.nodes.stereo.missing_input import Input
from sfr_loc_map.nodes.stereo.pose_matching import PoseMatching
from sfr_loc_map.nodes.stereo.stereo_input import ReceivedPair
from sfr_loc_map.ros.grid_messages import elevation_msg, hazard_msg
from sfr_loc_map.ros.image_messages import disparity_msg
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.ros.point_messages import cloud_msg
from sfr_loc_map.ros.pose_messages import transform_from_pose
from sfr_loc_map.ros.qos import profile
from sfr_loc_map.run_order import AGREEING
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import CLOUD, DISPARITY, ELEVATION, HAZARD, NAV_POSE

POSE_DEPTH = 100  #: Queue depth of nav/pose.
DISPARITY_DEPTH = 10  #: Number of disparity images kept for a slow subscriber; clouds and grids are latched.
OVERDUE_S = 0.2  #: Period of the check for pairs that have waited too long for their pose.
ANY_RIG = StereoRig(320, 240, 300.0, 300.0, 159.5, 119.5, 0.1)  #: Rig for checking parameters before the rig is known.


@dataclass(frozen=True, slots=True)
class MappingNodeConfig(PairNodeConfig):
    """Parameters of the mapping node."""

    lm_frame: str = param("lm", doc="Name of the local map frame LM: frame of the cloud.")
    pairs_per_map: int = param(3, unit="pairs", doc="Number of stereo pairs per map.", low=1, high=MAX_PAIRS)
    pose_wait_s: float = param(
        5.0, unit="s", doc="Maximum time that a pair waits for a nav/pose with its stamp.", low=0.0, high=600.0
    )
    mapping: MappingConfig = field(default_factory=MappingConfig)


class CountedPair(NamedTuple):
    """A processed pair of the map in progress, with the time and memory of its processing."""

    result: MappedPair
    usage: CallUsage


class MappingNode(PairNode[MappingNodeConfig]):
    """Publishes the disparity of each stereo pair and the cloud of a set of pairs."""

    task = Task.MAPPING
    live_parameters = ("mapping.",)
    config_type = MappingNodeConfig

    def check_config(self, config: MappingNodeConfig) -> None:
        """Check the frames, and create a mapper to check the parameters; `ANY_RIG` replaces a rig that is unknown."""
        config.check_frame_names(config.lm_frame)
        Mapper(self.rig or ANY_RIG, config.mapping)

    def setup(self) -> None:
        """Load compiled code and create publishers."""
        super().setup()
        self.load_kernels("mapping", "terrain")
        self.meter.mark_idle()
        add_publisher = self.endpoints.add_publisher
        self._cloud = add_publisher(PointCloud2, CLOUD, 1, latched=True)
        self._elevation = add_publisher(PointCloud2, ELEVATION, 1, latched=True)
        self._hazard = add_publisher(OccupancyGrid, HAZARD, 1, latched=True)
        self._disparity = self.endpoints.add_publisher(DisparityImage, DISPARITY, DISPARITY_DEPTH)

    def subscribe(self) -> None:
        """Subscribe and offer services."""
        poses = profile(self.config.input.reliability, POSE_DEPTH)
        self.endpoints.add_subscription(PoseStamped, NAV_POSE, self._on_pose, poses)
        super().subscribe()
        self.add_service("~/finish", self._finish)
        self.add_service("~/reset", self._reset, first=self.forget_waiting)
        self.endpoints.add_timer(OVERDUE_S, self._matching.drop_overdue)

    def reset_state(self) -> None:
        """Create the state of the node, without input and results."""
        super().reset_state()
        config = self.config
        self._poses_received = 0  # since the last `report_periodically`
        self._lm_frame = config.frame(config.lm_frame)
        self._mapping = config.mapping  # parameters of the next pair that the worker processes
        self._pairs: list[CountedPair] = []  # pairs of the map in progress
        self._mapped_rig: StereoRig | None = None  # rig of the last pair that the worker processed
        self._mapper: Mapper | None = None  # with the parameters and the mapped rig; created on demand
        self._matching: PoseMatching[ReceivedPair] = PoseMatching(
            config.input.stamp_tolerance_ns, config.pose_wait_s, self._report_without_pose
        )

    def apply_config(self, config: MappingNodeConfig) -> None:
        """Process the next pairs with changed parameters; pairs of the map in progress are kept."""
        self.worker.enqueue(partial(self._set_mapping, config.mapping))

    def reset_received(self) -> None:
        """Reset the counts of received messages."""
        super().reset_received()
        self._poses_received = 0

    def expects_input(self) -> bool:
        """Return whether a map is in progress. Between maps, no input is expected."""
        return bool(self._pairs)  # the worker may change the list at any time

    def agreeing_stamps(self) -> int:
        """Return how many consecutive pairs after a jump of the stamps start a new run: no more than a map has."""
        return min(AGREEING, self.config.pairs_per_map)

    def inputs(self) -> list[Input]:
        """Return the inputs of the pairs and the poses."""
        return [*super().inputs(), Input({NAV_POSE: PoseStamped}, self._poses_received, self.config.input.reliability)]

    def counts(self) -> dict[str, int]:
        """Return the numbers of messages dropped since the configuration, by cause."""
        return super().counts() | {"dropped_without_pose": self._matching.dropped}

    def restart_after_fault(self) -> None:
        """Start a new map."""
        self._pairs.clear()

    # ---- in the executor's thread

    def on_pair(self, pair: ReceivedPair) -> None:
        """Hold a pair until a pose with its stamp is received, then enqueue it for the worker."""
        self._enqueue(self._matching.add_pair(pair.stamp_ns, pair))

    def on_new_run(self, reason: str) -> None:
        """Start a new map once the pairs received earlier are processed."""
        self.get_logger().warning(f"{reason}: a new map begins")
        self._matching.clear_pairs()
        self.worker.enqueue(self._pairs.clear)

    def forget_waiting(self) -> None:
        """Forget the messages, pairs and poses that wait, and the last stamp."""
        super().forget_waiting()
        self._matching.clear()

    def _on_pose(self, message: PoseStamped) -> None:
        stamp_ns = stamp_of(message)
        self._poses_received += 1
        with self.ignoring_broken():
            self.config.check_message_frame(NAV_POSE, message.header.frame_id, "lm_frame")
            pose = transform_from_pose(message.pose, f"nav/pose of stamp {stamp_ns}")
            self._enqueue(self._matching.add_pose(stamp_ns, pose))

    def _enqueue(self, matched: list[tuple[ReceivedPair, Transform]]) -> None:
        for pair, pose in matched:
            self.worker.enqueue_droppable(partial(self._process, pair, pose))

    def _report_without_pose(self, stamp_ns: int) -> None:
        self.status.error(
            f"pair of stamp {stamp_ns} dropped: no usable nav/pose with its stamp was received within "
            f"{self.config.pose_wait_s} s; publish the pose of NAVSB in LM with the stamp of the pair"
        )

    # ---- in the worker's thread

    def _set_mapping(self, mapping: MappingConfig) -> None:
        self._mapping = mapping
        self._mapper = None

    def _set_rig(self, rig: StereoRig) -> None:
        """Set the rig of the pair to process; a map in progress with different cameras is dropped."""
        if self._mapped_rig is not None and self._mapped_rig.same_cameras(rig):
            return
        if self._mapped_rig is not None:
            self.get_logger().warning("the cameras have changed: a new map begins")
        self._pairs.clear()
        self._mapped_rig = rig
        self._mapper = None

    def _mapper_of_rig(self) -> Mapper:
        """Return the mapper; raise an `SfrError` if there is no pair yet, or if the parameters do not suit the rig."""
        if self._mapped_rig is None:
            raise InputError("no pair was processed yet: publish images and camera_info of both navigation cameras")
        self._mapper = self._mapper or Mapper(self._mapped_rig, self._mapping)
        return self._mapper

    def _reset(self) -> str:
        self._pairs.clear()
        return "a new map begins"

    def _process(self, received: ReceivedPair, pose: Transform) -> None:
        pair, conversion_s = decoded(received)
        self._set_rig(received.rig)
        mapper = self._mapper_of_rig()
        with self.meter.measure() as usage:
            result = mapper.process(pair, pose, len(self._pairs))
        self._pairs.append(CountedPair(result, usage))
        header = header_msg(pair.stamp_ns, received.frame_id)
        disparity = disparity_msg(result.disparity_px, received.rig, mapper.search, header)
        self._disparity.publish(disparity)
        call = mapping_call(pair.stamp_ns, usage, MappingState.MAPPED, result.statistics)
        call = replace(call, times=self.times(received, conversion_s))
        self.publish_call(call, self._reported(result.warnings))
        if len(self._pairs) == self.config.pairs_per_map:
            self._fuse()

    def _fuse(self) -> int:
        """Fuse and publish the map in progress; return the number of points."""
        mapper, pairs = self._mapper_of_rig(), self._pairs.copy()
        self._pairs.clear()
        with self.meter.measure() as usage:
            fused = mapper.fuse([pair.result for pair in pairs])
        stamps_ns = [pair.result.stamp_ns for pair in pairs]
        stamp_ns = stamps_ns[-1]
        self._cloud.publish(cloud_msg(fused.cloud, stamp_ns, self._lm_frame))
        whole = usage_of_stages([*(pair.usage for pair in pairs), usage])
        level = self._reported(fused.warnings)
        for took, state in ((usage, MappingState.FUSED), (whole, MappingState.MAPPED_SET)):
            self.publish_call(call_of_fusion(fused, stamps_ns, took, state), level)
        # The grids follow the call records, so that they do not delay these reports.
        self._publish_terrain(fused, stamp_ns)
        return len(fused.cloud)

    def _publish_terrain(self, fused: FusedMap, stamp_ns: int) -> None:
        try:
            grid = terrain_grid(fused.cloud, self._mapping.terrain, fused.poses_lm_left, fused.random_sigma)
        except SfrError as error:
            self.status.warn(f"this map has no elevation grid and no hazard grid: {error}")
            return
        self._elevation.publish(elevation_msg(grid, stamp_ns, self._lm_frame))
        self._hazard.publish(hazard_msg(grid, stamp_ns, self._lm_frame))

    def _finish(self) -> str:
        pairs = len(self._pairs)
        return f"{self._fuse()} points of {pairs} pairs published"

    def _reported(self, warnings: Sequence[str]) -> Level:
        """Report the warnings of a result, and return the level of its call."""
        for warning in warnings:
            self.status.warn(warning)
        return Level.WARN if warnings else Level.OK


main = partial(run, MappingNode)
